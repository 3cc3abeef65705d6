"""A link that warms up beside the recorded temperature is reported by its length, not as a jump of a joint."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.simulation.mechanisms.chains import made_arms
from tests.simulation.mechanisms.chains.made_arms import campaign
from tests.tolerance import assert_close
from truing.inference.forward_search import Settings
from truing.inference.observations import Epochs, Frames, Observations
from truing.inference.selection import CauseDiagnosis, CauseSelection
from truing.simulation.catalogue import catalogue_of_chains
from truing.simulation.mechanisms.chains.link_causes import LinkGrowth
from truing.simulation.mechanisms.chains.model import ChainModel
from truing.simulation.mechanisms.chains.nonparametric import NonparametricChainEffect
from truing.simulation.mechanisms.chains.notations import tree_of_rows

POSES, NOISE_M = 60, 2e-5
LONGER_M = 1e-5


def _points_by_length(model: ChainModel, shared: NDArray, row: int, name: str) -> NDArray:
    """Change of the points (B, K, 3) by a unit of ``a`` or ``d`` of a row of Denavit and Hartenberg."""
    rows = list(made_arms.ROWS)
    rows[row] = replace(rows[row], **{name: getattr(rows[row], name) + LONGER_M})
    longer = tree_of_rows(rows, model.tree.readings)
    nodes = [replace(own, R=new.R, t=new.t) for own, new in zip(model.tree.nodes, longer.nodes, strict=True)]
    local = np.zeros((POSES, 0))
    tree = type(model.tree)(tuple(nodes), model.tree.readings)
    return np.asarray((replace(model, tree=tree).points(shared, local) - model.points(shared, local)) / LONGER_M)


def _diagnosed(seed: int, course: NDArray, row: int, name: str) -> CauseDiagnosis:
    """Diagnosis of an arm whose length in a row follows a course (B,), m."""
    rng = np.random.default_rng(seed)
    model = campaign(rng, POSES, 3)
    model = replace(model, known=replace(model.known, gear_orders=dict.fromkeys(model.tree.readings, ())))
    shared = 0.3 * rng.normal(size=model.shared_size) * (np.arange(model.shared_size) > 5)
    moved = course[:, None, None] * _points_by_length(model, shared, row, name)
    seen = model.points(shared, np.zeros((POSES, 0))) + moved
    seen = seen + rng.normal(0.0, NOISE_M, seen.shape)
    covariance = np.broadcast_to(NOISE_M**2 * np.eye(3), (*seen.shape, 3))
    measured = Observations(seen, covariance, np.ones(seen.shape[:2], bool))
    still = Frames(np.tile(np.eye(3), (POSES, 1, 1)), np.zeros((POSES, 3)), free=False)
    epochs = Epochs(measured, model.conditions, still)
    return CauseSelection(model, epochs, None, Settings(0.05, 200, 1)).run(list(catalogue_of_chains().values()))


@pytest.mark.slow
@pytest.mark.parametrize(("row", "name", "link"), [(1, "a", "link link2"), (3, "d", "link link4")])
def test_a_link_that_warms_up_is_reported_by_its_length_over_time(row: int, name: str, link: str) -> None:
    time_s = 60.0 * np.arange(POSES)
    diagnosis = _diagnosed(2, 1.2e-4 * (1.0 - np.exp(-time_s / 700.0)), row, name)
    found = [verdict for verdict in diagnosis.verdicts if verdict.verdict == "found"]
    assert [(v.cause.id, v.cause.subject) for v in found] == [("unexplained", link)]
    assert set(found[0].cause.columns) <= {"time_s", "order"}


def test_a_length_is_moved_by_its_amplitude_along_the_link() -> None:
    model = campaign(np.random.default_rng(1), POSES, 3)
    lengths = [c for c in NonparametricChainEffect().candidates(model.scene) if c.length_of]
    assert {column for cause in lengths for column in cause.columns} == {"time_s"}  # of which the order is a copy
    straight = next(c for c in lengths if c.length_of == "link2" and c.columns == ("time_s",) and c.degree == 1)
    assert straight.subject == "link link2"
    alike = LinkGrowth(link="link2").shared_with(model.scene)
    assert straight.shared_with(model.scene) == alike
    (amplitude,) = straight.parameters(5)
    assert amplitude.unit == "mm"
    machine = model.scene.inputs_of_machine
    moved = straight.twists(machine)
    assert moved is not None
    at = np.argmax(np.abs(moved).sum((0, 2, 3)))
    lengths_moved = np.linalg.norm(moved[:, at, :3, 0], axis=1)
    time_s = machine.conditions.covariates["time_s"]
    assert_close(lengths_moved, np.abs(2.0 * (time_s - time_s.mean()) / np.ptp(time_s)), atol=0.05, what="course")
