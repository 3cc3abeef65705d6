"""Causes in the generator and in ``truing.simulation``, written twice from the same words, do the same to all points.

Three machines: the telescope, another geometry photographed in another order, and a hexapod of variable legs; no noise.
They may differ by a tenth of the noise, and differ by rounding: of the hexapod's readings, found by rounds, 1e-9 m.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from tests.blind.exact_machines import (
    MACHINES,
    TENTH_OF_NOISE_M,
    as_drawn,
    assert_alike,
    model_of,
    other,
    points_of,
)
from tests.blind.generator import effects as hidden
from tests.blind.generator.campaign import Campaign
from tests.blind.generator.telescope import PUBLISHED_K
from tests.tolerance import assert_between
from truing.simulation.cause import Cause
from truing.simulation.mechanisms.causes.deformation import (
    BaseDeformation,
    FlexureShift,
    LinearPlatformDeformation,
    MatrixPlatformDeformation,
    NonlinearPlatformDeformation,
)
from truing.simulation.mechanisms.causes.leg_drift import LegDrift
from truing.simulation.mechanisms.causes.warmth import APART, LegThermal, ThermalExpansion

ONE, SOME = np.ones(6), np.array([0.0, 1.0, 0.0, 0.0, -1.0, 0.0])
# What is hidden; the cause, where it needs the campaign's times from start and duration in s; values in SI.
CASES: dict[str, tuple[hidden.Effect, Callable[[float, float], Cause], Any]] = {
    "linear": (hidden.LinearDeformation(0.01 * ONE), lambda *_: LinearPlatformDeformation(), 0.01 * ONE),
    "linear, some": (
        hidden.LinearDeformation(0.01 * SOME),
        lambda *_: LinearPlatformDeformation((2, 5)),
        [0.01, -0.01],
    ),
    "matrix": (hidden.MatrixDeformation(PUBLISHED_K), lambda *_: MatrixPlatformDeformation(), PUBLISHED_K.ravel()),
    "nonlinear": (
        hidden.NonlinearDeformation(0.01 * ONE, 0.002 * ONE, -0.0001 * ONE),
        lambda *_: NonlinearPlatformDeformation((), (2, 3)),
        np.concatenate([0.01 * ONE, 2.0 * ONE, -100.0 * ONE]),
    ),
    "expansion": (hidden.ThermalExpansion(1.2e-5, 1.2e-5, 1.2e-5), lambda *_: ThermalExpansion(), [1.2e-5]),
    "expansion apart": (
        hidden.ThermalExpansion(1.2e-5, 2.3e-5, -1e-6),
        lambda *_: ThermalExpansion(APART),
        [1.2e-5, 2.3e-5, -1e-6],
    ),
    "legs warm": (hidden.LegThermal(2e-5 * ONE), lambda *_: LegThermal(), [2e-5]),
    "legs warm, some": (hidden.LegThermal(2e-5 * SOME), lambda *_: LegThermal((2, 5)), [2e-5, -2e-5]),
    "base, temperature": (
        hidden.BaseDeformation("temperature", 0.003, -0.002, 0.004),
        lambda *_: BaseDeformation(),
        [3e-6, -2e-6, 4e-6],
    ),
    "base, actuator": (
        hidden.BaseDeformation("rho3", 0.01, 0.02, -0.01),
        lambda *_: BaseDeformation("rho3"),
        [0.01, 0.02, -0.01],
    ),
    "drift": (
        hidden.LegDrift(0.02 * ONE),
        lambda start, duration: LegDrift((), start, duration),
        2e-5 * ONE,
    ),
    "settling": (
        hidden.LegDrift(0.02 * SOME, tau=1500.0),
        lambda start, duration: LegDrift((2, 5), start, duration, 1500.0),
        [2e-5, -2e-5],
    ),
}


@pytest.mark.parametrize("machine", MACHINES, ids=lambda machine: machine.__name__)
@pytest.mark.parametrize("name", CASES)
def test_an_effect_moves_all_targets_alike(name: str, machine: Callable[[list[hidden.Effect]], Campaign]) -> None:
    effect, make, values = CASES[name]
    assert_alike(machine([effect]), make, np.asarray(values))


def test_flexures_shift_their_joints_alike() -> None:
    assert_alike(as_drawn([hidden.FlexureShift(40.0)]), lambda *_: FlexureShift(), np.array([0.04]))


def test_effects_on_top_of_one_another_do_the_same_together() -> None:
    """To a tenth of the noise: where a target grows and its base bends, each of the two counts from where it sat."""
    alone = [CASES[name] for name in ("expansion apart", "base, actuator", "settling", "linear, some")]
    campaign = other([effect for effect, _, _ in alone])
    span = campaign.schedule.time_s.min(), np.ptp(campaign.schedule.time_s)
    model = model_of(campaign, None).with_causes([make(*span) for _, make, _ in alone])
    values = np.concatenate([np.asarray(values) for _, _, values in alone])
    measured = campaign.record.points / 1e3
    gap = np.abs(points_of(model, values, measured) - measured)
    assert_between(float(gap.max()), 0.0, TENTH_OF_NOISE_M, what="difference, m")
