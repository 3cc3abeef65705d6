"""Causes of the structure: exact derivatives, alone and combined, and valid candidates."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from tests.simulation.mechanisms.telescope import LINEAR, MATRIX, sample_model
from tests.tolerance import assert_between, assert_close
from truing.simulation.cause import Parameter, Step
from truing.simulation.change import Change
from truing.simulation.mechanisms.causes.deformation import (
    BaseDeformation,
    FlexureShift,
    InPlanePlatformDeformation,
    LinearPlatformDeformation,
    NonlinearPlatformDeformation,
)
from truing.simulation.mechanisms.causes.drive import ActuatorGain
from truing.simulation.mechanisms.causes.leg_compliance import LegCompliance
from truing.simulation.mechanisms.causes.leg_drift import LegDrift
from truing.simulation.mechanisms.causes.measurement_scale import MeasurementScale
from truing.simulation.mechanisms.causes.warmth import APART, LegThermal, ThermalExpansion
from truing.simulation.mechanisms.model import MechanismModel
from truing.simulation.mechanisms.point_causes import PointCause
from truing.simulation.mechanisms.state import State

STEP = 1e-30
# Cosines of small bends lose digits near 1, some 1e-16 of 1e-5, in value and in derivative.
ROUNDING, OF_COSINES = 1e-12, 1e-9
DRIFT = LegDrift(start_s=0.0, duration_s=3600.0)
SETTLING = LegDrift(legs=(2, 5), start_s=0.0, duration_s=3600.0, tau_s=900.0)
LEANING = (0.28, -0.0, 0.96), 100.0, (0.02, -0.01, 0.1)  # up, kg, m
CAUSES: tuple[PointCause, ...] = (
    LinearPlatformDeformation((3,)),
    NonlinearPlatformDeformation((1, 4), (2,)),
    NonlinearPlatformDeformation((), (2, 3)),
    ThermalExpansion(),
    ThermalExpansion(APART),
    LegThermal(),
    LegThermal((2, 5)),
    InPlanePlatformDeformation(),
    InPlanePlatformDeformation((1, 4)),
    LegCompliance((), *LEANING),
    LegCompliance((2, 5), LEANING[0], 0.0, LEANING[2]),
    BaseDeformation(),
    BaseDeformation("rho2"),
    DRIFT,
    SETTLING,
    SETTLING.refined(),
    FlexureShift(),
)
STACKED = (
    ActuatorGain(),
    SETTLING.refined(),
    ThermalExpansion(APART),
    BaseDeformation("rho2"),
    FlexureShift(),
    InPlanePlatformDeformation((3,)),
    LegCompliance((1,), *LEANING),
    NonlinearPlatformDeformation((1, 2), (3,)),
    MeasurementScale("both"),
)


class LowerJointsFollowHeight(PointCause):
    """A cause outside the catalogue without declared inputs, which may read all of them."""

    id = "lower-joints-follow-everything"
    step = Step.STRUCTURE

    def parameters(self, legs: int) -> tuple[Parameter, ...]:
        return (Parameter("factor", "1", 0.1),)

    def change(self, state: State, values: np.ndarray) -> Change:
        legs = state.legs
        pull = state.rho + state.delta_bz + legs.l * legs.b[..., 0] + legs.a[..., 1] * legs.u[..., 0]
        return Change({"a": (pull[..., None] * np.array([0.0, 1.0, 0.0]))[..., None]}, 1)


def _model(causes: Sequence[PointCause], kind: str = "6-pus", poses: int = 3) -> MechanismModel:
    model = sample_model(np.random.default_rng(3), poses, tuple(causes), kind)
    warm = {"temperature_c": np.linspace(20.0, 26.0, poses), "time_s": np.linspace(0.0, 3600.0, poses)}
    warm["payload_kg"] = np.linspace(50.0, 100.0, poses)
    return model.at(replace(model.conditions, covariates=warm))


def _place(model: MechanismModel) -> tuple[np.ndarray, np.ndarray]:
    """Values of plausible size, not those that the wide prior of effects allows."""
    rng = np.random.default_rng(9)
    shared = rng.normal(size=model.shared_size)
    for cause in model.causes:
        shared[model.layout[cause.key]] *= 0.1
    return shared, rng.normal(size=(len(model.conditions.readings), model.local_size))


def _worst(model: MechanismModel, names: Sequence[str]) -> float:
    """The largest relative difference of derivatives from complex steps, over parts of the unknowns, and local ones."""
    shared, local = _place(model)
    found = model.predict(shared, local)
    worst = 0.0
    for j in np.concatenate([np.arange(model.shared_size)[model.layout[name]] for name in names]):
        expected = model.points(shared + 1j * STEP * (np.arange(len(shared)) == j), local).imag / STEP
        worst = max(worst, float(np.abs(found.by_shared[..., j] - expected).max() / np.abs(expected).max()))
    for j in range(model.local_size):
        expected = model.points(shared, local + 1j * STEP * (np.arange(model.local_size) == j)).imag / STEP
        worst = max(worst, float(np.abs(found.by_local[..., j] - expected).max() / np.abs(expected).max()))
    return worst


@pytest.mark.parametrize("kind", ["6-pus", "ups"])
@pytest.mark.parametrize("cause", CAUSES, ids=lambda cause: cause.key)
def test_derivatives_by_parameters_and_readings_are_those_of_a_complex_step(cause: PointCause, kind: str) -> None:
    limit = OF_COSINES if isinstance(cause, FlexureShift) else ROUNDING
    assert _worst(_model([cause], kind), [cause.key]) < limit


@pytest.mark.slow
def test_derivatives_hold_for_effects_on_top_of_one_another() -> None:
    model = _model(STACKED)
    assert _worst(model, [name for name in model.layout if name != "shape"]) < OF_COSINES


def test_derivatives_by_shapes_hold_where_bodies_grow() -> None:
    model = _model([ThermalExpansion(APART), BaseDeformation()])
    shared, local = _place(model)
    found = model.predict(shared, local).by_shared
    for j in np.arange(model.shared_size)[model.layout["shape"]][::7]:
        expected = model.points(shared + 1j * STEP * (np.arange(len(shared)) == j), local).imag / STEP
        assert_close(found[..., j], expected, atol=1e-12 * np.abs(expected).max(), what="derivative by a shape, m")


def test_a_cause_that_declares_no_inputs_has_exact_derivatives() -> None:
    model = _model([MATRIX, LowerJointsFollowHeight(), LegThermal()])
    assert _worst(model, ["a", "b", "u", "l", *(cause.key for cause in model.causes)]) < ROUNDING


def test_poses_move_as_the_points_do_where_the_flexures_shift() -> None:
    model = _model([FlexureShift(), LINEAR])
    shared, local = _place(model)
    by_shared, _ = model.pose_derivatives(shared, local)
    j = model.layout[FlexureShift().key].start
    nudged = model.state(shared + 1j * STEP * (np.arange(len(shared)) == j), local)
    assert_close(by_shared[:, :3, j], nudged.p.imag / STEP, atol=OF_COSINES * 1e-6, what="position per sigma, m")


def test_uniform_thermal_expansion_is_a_scale_of_the_measurement() -> None:
    """With actuators at zero, a machine that is alpha dT larger is the same machine, seen larger."""
    model = _model([ThermalExpansion()], "ups")
    model = model.at(replace(model.conditions, readings=np.zeros((3, 6))))
    none, local = np.zeros(model.shared_size), np.zeros((3, model.local_size))
    warm = none.copy()
    warm[model.layout[ThermalExpansion().key]] = 1.0  # ten times 1e-5 / K
    scale = 1 + 1e-4 * model.state(none, local).temperature_rise
    seen = model.points(warm, local)
    assert_close(seen, model.points(none, local) * scale[:, None, None], atol=1e-14, what="points, m")


def test_a_drift_is_nothing_at_first_and_whole_at_last() -> None:
    for cause in (DRIFT, SETTLING.refined(), SETTLING):
        model = _model([cause])
        shared, local = np.zeros(model.shared_size), np.zeros((3, model.local_size))
        shared[model.layout[cause.key]] = 0.1
        longer = model.state(shared, local).legs.l - model.nominal.l
        own = np.array(cause.leg_numbers(6)) - 1
        assert_close(longer[0], np.zeros(6), atol=1e-15, what="at first, m")
        assert_close(longer[-1, own], np.full(len(own), 7e-6), atol=1e-15, what="at last, m")
    assert_between(float(longer[1, 1] / 7e-6), 0.87, 0.89, what="share at half time, time constant a quarter")


def test_a_time_constant_is_reported_in_seconds() -> None:
    cause = SETTLING.refined()
    reported = cause.reported(np.array([1e-6, 2e-6, np.log(2.0)]), np.diag([1e-14, 1e-14, 0.01]), 6)
    assert [t.name for t in reported] == ["drift_2", "drift_5", "tau"]
    assert_close([reported[2].value, reported[2].sigma or 0.0], [1800.0, 180.0], atol=1e-9, what="tau and its sigma, s")


def test_candidates_are_those_that_could_show() -> None:
    scene = _model([], poses=9).scene
    cold = replace(scene, covariates={})
    assert not ThermalExpansion().candidates(cold)
    assert not LegThermal().candidates(cold)
    assert not DRIFT.candidates(cold)
    assert [cause.key for cause in BaseDeformation().candidates(cold)] == [
        f"base-deformation driver=rho{leg}" for leg in range(1, 7)
    ]
    rng = np.random.default_rng(1)
    levels = rng.integers(-1, 2, (40, 6)) * 1e-3 + rng.normal(0.0, 2e-6, (40, 6)) + scene.rho0
    few = NonlinearPlatformDeformation().candidates(replace(scene, readings=levels))
    assert {cause.settings()["powers"] for cause in few} == {(2,)}  # three levels tell no cubic term


@pytest.mark.parametrize(
    "cause",
    [
        LinearPlatformDeformation(),
        NonlinearPlatformDeformation(),
        ThermalExpansion(),
        LegThermal(),
        BaseDeformation(),
        LegDrift(),
    ],
    ids=lambda cause: cause.id,
)
def test_candidates_share_a_probability_of_one_and_keep_their_settings(cause: PointCause) -> None:
    scene = replace(_model([], poses=9).scene, span_s=(0.0, 7200.0))
    found = cause.candidates(scene)
    assert len({candidate.key for candidate in found}) == len(found) > 1
    assert_between(sum(candidate.prior(scene) for candidate in found), 1 - 1e-9, 1 + 1e-9, what="sum of shares")
    for candidate in found:
        assert cause.with_settings(**candidate.settings()) == candidate
