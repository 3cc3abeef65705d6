"""Causes in the generator and in ``truing.simulation``, written independently, move all points equally.

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
    hexapod,
    model_of,
    other,
    points_of,
)
from tests.blind.generator import effects as hidden
from tests.blind.generator.campaign import Campaign
from tests.blind.generator.telescope import PUBLISHED_K
from tests.tolerance import assert_between
from truing.simulation.bodies.causes.gravity import GravitySag
from truing.simulation.bodies.causes.jump import BodyJump
from truing.simulation.cause import Cause
from truing.simulation.mechanisms.causes.deformation import (
    BaseDeformation,
    FlexureShift,
    InPlanePlatformDeformation,
    LinearPlatformDeformation,
    MatrixPlatformDeformation,
    NonlinearPlatformDeformation,
)
from truing.simulation.mechanisms.causes.leg_compliance import LegCompliance
from truing.simulation.mechanisms.causes.leg_drift import LegDrift
from truing.simulation.mechanisms.causes.warmth import APART, LegThermal, ThermalExpansion
from truing.simulation.mechanisms.causes.zero_shift import ActuatorZeroShift

ONE, SOME = np.ones(6), np.array([0.0, 1.0, 0.0, 0.0, -1.0, 0.0])
# What is hidden; the cause, where it needs the campaign's times from start and duration in s; values in SI.
CASES: dict[str, tuple[hidden.Effect, Callable[[float, float], Cause], Any]] = {
    "linear": (hidden.LinearDeformation(0.01 * ONE), lambda *_: LinearPlatformDeformation(), 0.01 * ONE),
    "linear, some": (
        hidden.LinearDeformation(0.01 * SOME),
        lambda *_: LinearPlatformDeformation((2, 5)),
        [0.01, -0.01],
    ),
    "in plane": (
        hidden.InPlaneDeformation(0.01 * ONE, -0.02 * ONE),
        lambda *_: InPlanePlatformDeformation(),
        np.concatenate([0.01 * ONE, -0.02 * ONE]),
    ),
    "in plane, some": (
        hidden.InPlaneDeformation(0.01 * SOME, 0.03 * SOME),
        lambda *_: InPlanePlatformDeformation((2, 5)),
        [0.01, -0.01, 0.03, -0.03],
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


@pytest.mark.parametrize("machine", MACHINES, ids=lambda machine: machine.__name__)
def test_an_actuators_zero_shifts_alike(machine: Callable[[list[hidden.Effect]], Campaign]) -> None:
    """Poses count from their place in time."""
    schedule = machine([]).schedule
    pose = schedule.pose[int(np.argsort(schedule.time_s)[len(schedule.pose) // 2])]
    rank = float(schedule.rank[schedule.pose.index(pose)])
    one, all_of_them = np.where(np.arange(6) == 3, -0.02, 0.0), np.linspace(-0.025, 0.025, 6)
    for amount, legs in ((one, (4,)), (all_of_them, ())):
        campaign = machine([hidden.ActuatorZeroShift(amount, pose)])
        assert_alike(campaign, lambda *_, legs=legs: ActuatorZeroShift(legs, pose, rank), amount[amount != 0] / 1e3)


@pytest.mark.parametrize("machine", MACHINES, ids=lambda machine: machine.__name__)
@pytest.mark.parametrize("body", ["platform", "base"])
def test_all_targets_of_a_body_are_displaced_alike(
    body: str, machine: Callable[[list[hidden.Effect]], Campaign]
) -> None:
    plain = machine([])
    pose = plain.schedule.pose[int(np.argsort(plain.schedule.time_s)[len(plain.schedule.pose) // 2])]
    rank = float(plain.schedule.rank[plain.schedule.pose.index(pose)])
    own = list(plain.marks.of(body))
    names, places = tuple(plain.marks.name[k] for k in own), plain.surveyed[own] / 1e3
    shift, turn = (0.02, -0.03, 0.01), (1e-5, 2e-5, -3e-5)
    cause = BodyJump(body, names, tuple(places.ravel()), from_pose=pose, from_order=rank)
    campaign = machine([hidden.BodyJump(body, shift, turn, pose)])
    assert_alike(campaign, lambda *_: cause, np.array([*(1e-3 * np.array(shift)), *turn]))


UP, CENTRE = np.array([0.28, 0.0, 0.96]), np.array([12.0, -7.0, 60.0])


@pytest.mark.parametrize("machine", MACHINES, ids=lambda machine: machine.__name__)
def test_legs_give_way_alike_under_what_they_carry(machine: Callable[[list[hidden.Effect]], Campaign]) -> None:
    """The generator hangs masses on the legs; the model is given the mass, and which way is up."""
    count = len(machine([]).readings)
    effect = hidden.LegCompliance(2e-4 * np.abs(SOME), np.full(count, 35.0), CENTRE, UP)
    assert_alike(
        machine([effect]), lambda *_: LegCompliance((2, 5), tuple(UP), 35.0, tuple(CENTRE / 1e3)), np.full(2, 2e-7)
    )


def test_targets_of_a_platform_sag_alike() -> None:
    """The generator counts them from the level platform."""
    plain = hexapod([])
    own = plain.marks.of("platform")
    names, places = tuple(plain.marks.name[k] for k in own), plain.surveyed[own] / 1e3
    sags = np.linspace(-0.2, 0.3, len(own))
    campaign = hexapod([hidden.GravitySag(tuple(zip(names, sags.tolist(), strict=True)), UP)])
    cause = GravitySag("platform", names, tuple(places.ravel()), middle=tuple(-UP), up=tuple(UP))
    assert_alike(campaign, lambda *_: cause, sags / 1e3)


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
