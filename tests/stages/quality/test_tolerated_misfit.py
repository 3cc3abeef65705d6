"""The misfit of a chain within its tolerances before calibration is no slip of its readings."""

from __future__ import annotations

import numpy as np

from tests.packaging.source_tree import PROJECT
from tests.simulation.mechanisms.chains.made_arms import arm
from tests.stages.line import settings_of
from tests.tolerance import assert_between
from truing.simulation.mechanisms.chains.tree import JointKind
from truing.stages.common.chain_start import tolerated_misfit

CHAINS = 200


def test_chains_within_their_tolerances_miss_by_less_and_not_by_far_less() -> None:
    settings, tree, rng = settings_of(PROJECT / "sample_data" / "robot"), arm(), np.random.default_rng(7)
    tolerance = settings.mechanism.tolerance
    readings = 0.05 * rng.normal(size=(20, 5))  # a workspace of a few centimetres, of which the misfit is a large part
    moving = np.array([node.kind is not JointKind.FIXED for node in tree.nodes])
    shift, turn = 1e-3 * tolerance.length_mm, np.radians([tolerance.angle_deg] * 2 + [tolerance.offset_deg])
    twists = rng.normal(size=(CHAINS, 1, tree.size, 6)) * np.r_[shift, shift, 0.0, turn] * moving[:, None]
    nominal = tree.frames(readings).t[:, -1]
    misfit = [np.sqrt(np.mean(np.sum((tree.frames(readings, twist).t[:, -1] - nominal) ** 2, -1))) for twist in twists]
    allowed = tolerated_misfit(tree, np.array([tree.size - 1]), readings, settings)
    assert_between(sum(own <= allowed for own in misfit), CHAINS - 4, CHAINS, what="chains within")
    assert_between(allowed / float(np.median(misfit)), 2.0, 5.0, what="allowed over typical")
