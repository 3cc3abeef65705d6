"""Errors of drives and instruments, and displaced targets, agree between the generator and ``truing.simulation``."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from tests.blind.exact_machines import MACHINES, assert_alike
from tests.blind.generator import effects as hidden
from tests.blind.generator.campaign import Campaign
from truing.simulation.cause import Cause
from truing.simulation.mechanisms.causes.drive import ActuatorBacklash, ActuatorGain, PeriodicError
from truing.simulation.mechanisms.causes.measurement_scale import BOTH, CONSTANT, PER_KELVIN, MeasurementScale
from truing.simulation.mechanisms.causes.targets import TargetMoved, TargetsSwapped

ONE, SOME = np.ones(6), np.array([0.0, 1.0, 0.0, 0.0, -1.0, 0.0])
PHASE = np.array([0.3, -1.2, 2.0, 3.0, -2.5, 0.0])
WAVES = np.stack([np.cos(PHASE), np.sin(PHASE)], -1)
SWAPPED = (3, 7, 12)

Build = Callable[[list[hidden.Effect]], Campaign]
CASES: dict[str, tuple[hidden.Effect, Cause, Any]] = {
    "gain": (hidden.ActuatorGain(0.01 * ONE), ActuatorGain(), 0.01 * ONE),
    "gain, some": (hidden.ActuatorGain(0.01 * SOME), ActuatorGain((2, 5)), [0.01, -0.01]),
    "backlash": (hidden.Backlash(0.02 * ONE), ActuatorBacklash(), 2e-5 * ONE),
    "backlash, one": (hidden.Backlash(0.02 * np.eye(6)[2]), ActuatorBacklash((3,)), [2e-5]),
    "periodic": (hidden.PeriodicError(0.01 * ONE, 0.7, PHASE), PeriodicError((), 0.7), 1e-5 * WAVES.ravel()),
    "periodic, some, free": (
        hidden.PeriodicError(0.01 * SOME, 1 / 0.52, PHASE),
        PeriodicError((2, 5), 2.0, 400.0, free=True),
        [*(1e-5 * WAVES[1]), *(-1e-5 * WAVES[4]), 400.0 * np.arctanh(0.05)],
    ),
    "scale": (hidden.MeasurementScale(5e-5), MeasurementScale(CONSTANT), [5e-5]),
    "scale per kelvin": (hidden.MeasurementScale(0.0, 2e-5), MeasurementScale(PER_KELVIN), [2e-5]),
    "both scales": (hidden.MeasurementScale(5e-5, 2e-5), MeasurementScale(BOTH), [5e-5, 2e-5]),
}


@pytest.mark.parametrize("machine", MACHINES, ids=lambda machine: machine.__name__)
@pytest.mark.parametrize("name", CASES)
def test_an_effect_moves_all_targets_alike(name: str, machine: Build) -> None:
    effect, cause, values = CASES[name]
    assert_alike(machine([effect]), lambda *_: cause, np.asarray(values))


@pytest.mark.parametrize("machine", MACHINES, ids=lambda machine: machine.__name__)
@pytest.mark.parametrize("body", ["base", "platform", "leg3"])
def test_a_moved_target_is_elsewhere_alike(body: str, machine: Build) -> None:
    marks = machine([]).marks
    if not len(marks.of(body)):
        pytest.skip("this machine's legs carry no targets")
    target = marks.name[marks.of(body)[2]]
    campaign = machine([hidden.TargetMoved(body, target, (0.1, -0.2, 0.3), 9)])
    rank = float(campaign.schedule.rank[campaign.schedule.pose.index(9)])
    cause = TargetMoved(body, target, 9, rank)
    assert_alike(campaign, lambda *_: cause, np.array([1e-4, -2e-4, 3e-4]))


@pytest.mark.parametrize("machine", MACHINES, ids=lambda machine: machine.__name__)
def test_exchanged_labels_are_exchanged_alike(machine: Build) -> None:
    marks = machine([]).marks
    first, second = (marks.name[place] for place in marks.of("platform")[[1, 6]])
    campaign = machine([hidden.TargetsSwapped("platform", (first, second), SWAPPED)])
    ranks = tuple(float(campaign.schedule.rank[campaign.schedule.pose.index(pose)]) for pose in SWAPPED)
    cause = TargetsSwapped("platform", (first, second), SWAPPED, ranks)
    assert_alike(campaign, lambda *_: cause, np.zeros(0), largest=1.0)
