"""Each effect of the generator acts as the campaign format defines it, checked by independent relations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from tests.blind.generator.campaign import Campaign, draw_campaign
from tests.blind.generator.effects import (
    ActuatorGain,
    Backlash,
    BaseDeformation,
    Effect,
    FlexureShift,
    LegDrift,
    LegThermal,
    LinearDeformation,
    MeasurementScale,
    NonlinearDeformation,
    PeriodicError,
    TargetMoved,
    TargetsSwapped,
    ThermalExpansion,
)
from tests.blind.generator.layout import DataFaults, Layout, Noise, Surroundings, noiseless
from tests.blind.generator.quaternions import Array, fit_motion, rotate, unit
from tests.blind.generator.schedule import published_moves
from tests.tolerance import assert_between, assert_close

EXACT = Layout(
    name="exact",
    noise=noiseless(Noise()),
    faults=DataFaults(0.0, 0.0),
    surroundings=Surroundings(frame_turn_rad=0.0, frame_shift_mm=0.0, positioning_mm=0.0, temperature_step_c=0.5),
)
ONE = np.ones(6)


def draw(*effects: Effect, layout: Layout = EXACT) -> Campaign:
    return draw_campaign(layout, published_moves(), effects, np.random.default_rng(5))


PLAIN = draw()


def distances(campaign: Campaign, body: str) -> Array:
    """All distances between a body's targets, pose by pose, mm."""
    points = campaign.record.points[:, campaign.marks.of(body)]
    first, second = np.triu_indices(points.shape[1], 1)
    return np.linalg.norm(points[:, first] - points[:, second], axis=-1)


def shape_change(campaign: Campaign, body: str) -> float:
    """The largest change that the effects make to a body's shape, mm."""
    return float(np.abs(distances(campaign, body) - distances(PLAIN, body)).max())


@pytest.mark.parametrize(
    "effects",
    [[ActuatorGain(0.01 * ONE)], [Backlash(0.01 * ONE)], [PeriodicError(0.01 * ONE, 0.7, ONE)], [LegDrift(0.1 * ONE)]],
    ids=lambda effects: effects[0].id,
)
def test_actuator_effects_move_the_platform_and_bend_no_body(effects: Sequence[Effect]) -> None:
    changed = draw(*effects)
    assert np.abs(changed.truth.position - PLAIN.truth.position).max() > 0.005
    for body in ("base", "platform", "leg1", "leg6"):
        assert shape_change(changed, body) < 1e-9


def test_a_linear_deformation_and_an_actuator_gain_give_nearly_the_same_poses() -> None:
    """To first order only what the legs see differs: the shift in z of an attachment is a shorter stroke below it."""
    kappa = 0.012 * ONE
    deformed, gained = draw(LinearDeformation(kappa)), draw(ActuatorGain(-kappa))
    effect = np.abs(deformed.truth.position - PLAIN.truth.position).max()
    apart = np.abs(deformed.truth.position - gained.truth.position).max()
    assert_between(apart / effect, 0.0, 0.05, what="difference of the poses, relative to the effect")
    assert shape_change(deformed, "platform") > 0.001
    assert shape_change(gained, "platform") < 1e-9


def test_common_growth_and_a_growing_scale_look_the_same() -> None:
    """They differ by what does not grow, the actuators' 12 mm, and by its leverage on the pose (below ten)."""
    alpha = 2.3e-5
    grown, scaled = draw(ThermalExpansion(alpha, alpha, alpha)), draw(MeasurementScale(scale_per_k=alpha))
    heat = np.abs(PLAIN.schedule.heat).max()
    actuators = 12.0 * alpha * heat
    assert np.abs(scaled.record.points - PLAIN.record.points).max() > 20 * actuators
    apart = np.abs(grown.record.points - scaled.record.points).max()
    assert_between(apart, 0.0, 10 * actuators, what="difference, mm")


def test_heat_in_the_legs_alone_lengthens_them_and_leaves_the_bodies() -> None:
    alpha = 2e-5
    warm = draw(LegThermal(alpha * ONE))
    for body in ("base", "platform"):
        assert shape_change(warm, body) < 1e-9
    expected = distances(PLAIN, "leg2") * (1 + alpha * PLAIN.schedule.heat[:, None])
    assert_close(distances(warm, "leg2"), expected, atol=1e-9, what="distances along the leg, mm")


def test_a_drift_reaches_its_size_at_the_last_pose_and_lengthens_one_leg_only() -> None:
    drifted = draw(LegDrift(np.array([0, 0, 0.2, 0, 0, 0.0])))
    settled = draw(LegDrift(np.array([0, 0, 0.2, 0, 0, 0.0]), tau=1000.0))
    for campaign in (drifted, settled):
        longer = _leg_lengths(campaign) - _leg_lengths(PLAIN)
        assert_close(longer[:, [0, 1, 3, 4, 5]], np.zeros((46, 5)), atol=1e-9)
        assert_close(longer[[0, -1], 2], [0.0, 0.2], atol=1e-9, what="drift, mm")
    halfway = (_leg_lengths(drifted) - _leg_lengths(PLAIN))[23, 2], (_leg_lengths(settled) - _leg_lengths(PLAIN))[23, 2]
    assert halfway[0] < 0.12 < 0.19 < halfway[1]


def _leg_lengths(campaign: Campaign) -> Array:
    """Distances (N, 6) between the feet of the legs, as their targets show them, and the attachments' targets."""
    marks, points = campaign.marks, campaign.record.points
    lengths = []
    for leg in range(1, 7):
        own, seat = marks.of(f"leg{leg}"), marks.on_leg.index(leg)
        reference = np.broadcast_to(campaign.surveyed[own], points[:, own].shape)
        foot = fit_motion(reference, points[:, own])[1]
        lengths.append(np.linalg.norm(points[:, seat] - foot, axis=-1))
    return np.stack(lengths, axis=1)


def test_backlash_lags_behind_the_movement() -> None:
    lagging = draw(Backlash(0.02 * ONE))
    behind = lagging.truth.drho - PLAIN.truth.drho
    first = PLAIN.truth.drho[1] - PLAIN.truth.drho[0]
    moved = np.abs(first) > 0.1
    assert_close(behind[1, moved], -0.02 * np.sign(first[moved]), atol=1e-12, what="lag, mm")
    assert_close(np.abs(behind), 0.02 * np.ones((46, 6)), atol=1e-12)


def test_a_periodic_error_comes_back_after_a_pitch() -> None:
    error = PeriodicError(0.01 * ONE, 0.5, np.linspace(0, 2, 6))
    drho = np.linspace(-1, 1, 6)[None]
    once, again = (error.drive(d, None) - d for d in (drho, drho + 0.5))  # type: ignore[arg-type]
    assert_close(once, again, atol=1e-12)
    assert np.ptp(once) > 0.005


def test_a_nonlinear_deformation_without_its_curvature_is_the_linear_one() -> None:
    kappa = 0.012 * ONE
    straight = draw(NonlinearDeformation(kappa, 0 * ONE, 0 * ONE))
    assert_close(straight.record.points, draw(LinearDeformation(kappa)).record.points, atol=0.0)
    bent = draw(NonlinearDeformation(kappa, 0.005 * ONE, 0.003 * ONE)).truth
    expected = 0.012 * bent.drho + 0.005 * bent.drho**2 + 0.003 * bent.drho**3
    assert_close(bent.delta_bz, expected, atol=1e-9, what="shift, mm")


def test_a_bowl_moves_joints_and_targets_of_the_base_alike() -> None:
    """A bowl of q at the mean joint radius: the base's targets show r^2 / R^2 of it, less their least-squares frame."""
    bowl = 0.5
    bent = draw(BaseDeformation("rho2", 0.0, 0.0, bowl))
    own = bent.marks.of("base")
    q = PLAIN.truth.drho[:, 1:2]
    place, radius = PLAIN.surveyed[own], np.mean(np.linalg.norm(PLAIN.truth.built.a[:, :2], axis=1))
    lifted = PLAIN.record.points[:, own].copy()
    lifted[..., 2] += q * bowl * np.sum(place[:, :2] ** 2, axis=1) / radius**2
    turn, shift = fit_motion(bent.record.points[:, own], lifted)
    laid = rotate(turn[:, None], bent.record.points[:, own]) + shift[:, None]
    assert_close(laid, lifted, atol=1e-9, what="base targets, mm")
    assert shape_change(bent, "platform") < 1e-9


def test_flexures_of_ten_millimetres_stay_below_the_figure_of_the_reference() -> None:
    """Over table 3 they change a reading by 0.54 um at most on the nominal machine, hence a leg by hardly more."""
    legs = _leg_lengths(draw(FlexureShift(10.0))) - _leg_lengths(PLAIN)
    assert_between(np.abs(legs).max(), 0.3e-3, 0.75e-3, what="change of the distance between the joints, mm")


def test_a_moved_target_is_elsewhere_from_its_pose_on_and_nothing_else_moves() -> None:
    layout = replace(EXACT, surroundings=replace(EXACT.surroundings, shuffled=True))
    plain, moved = draw(layout=layout), draw(TargetMoved("platform", "P03", (0.3, 0.0, 0.4), 17), layout=layout)
    change = np.linalg.norm(moved.record.points - plain.record.points, axis=-1)
    column = list(plain.marks.name).index("P03")
    late = plain.schedule.rank >= plain.schedule.rank[plain.schedule.pose.index(17)]
    assert_close(change[:, column], np.where(late, 0.5, 0.0), atol=1e-9, what="shift of the target, mm")
    assert_close(np.delete(change, column, axis=1), np.zeros((46, change.shape[1] - 1)), atol=1e-12)


def test_swapped_targets_are_in_each_other_s_place() -> None:
    swapped = draw(TargetsSwapped("base", ("B02", "B09"), (4, 5)))
    first, second = (list(PLAIN.marks.name).index(name) for name in ("B02", "B09"))
    for row, pose in enumerate(PLAIN.schedule.pose):
        there = (second, first) if pose in (4, 5) else (first, second)
        assert_close(swapped.record.points[row, [first, second]], PLAIN.record.points[row, list(there)], atol=0.0)


def test_a_wrong_scale_bar_scales_every_body_alike() -> None:
    scaled = draw(MeasurementScale(scale=2e-4))
    for body in ("base", "platform", "leg4"):
        assert_close(
            distances(scaled, body) / distances(PLAIN, body), 1.0002 * np.ones_like(distances(PLAIN, body)), atol=1e-12
        )
    assert_close(unit(scaled.record.points), unit(PLAIN.record.points), atol=1e-12, what="directions")
