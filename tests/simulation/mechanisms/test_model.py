"""Points of all bodies: exact derivatives by all unknowns, and unknowns of the survey."""

from __future__ import annotations

import numpy as np
import pytest

from tests.simulation.mechanisms.telescope import KAPPA, LINEAR, MATRIX, K, sample_model, sample_targets, telescope
from tests.tolerance import assert_between, assert_close
from truing.estimation.rotation import skew
from truing.simulation.cause import Effect
from truing.simulation.inputs import APPROACH, OWN_DRIVE
from truing.simulation.mechanisms.causes.deformation import FlexureShift
from truing.simulation.mechanisms.causes.nonparametric import NonparametricMechanismEffect as Nonparametric
from truing.simulation.mechanisms.forward_pass import simulate
from truing.simulation.mechanisms.model import MechanismModel
from truing.simulation.targets import BASE, PLATFORM, shape_unknowns

STEP = 1e-30
DRIVEN = Nonparametric(columns=(OWN_DRIVE,), centres=(0.0,), half_ranges=(1.3e-3,), degree=3)
TIMED = Nonparametric(columns=("time_s",), centres=(1800.0,), half_ranges=(1800.0,), degree=2)


@pytest.fixture(scope="module")
def model() -> MechanismModel:
    return sample_model(np.random.default_rng(5), 3, (MATRIX, DRIVEN, TIMED))


@pytest.fixture(scope="module")
def place(model: MechanismModel) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(6)
    shared = rng.normal(size=model.shared_size)
    for cause in model.causes:  # plausible sizes, not those that a wide prior allows
        shared[model.layout[cause.key]] *= 0.1
    return shared, rng.normal(size=(3, model.local_size))


def _worst(found: np.ndarray, expected: np.ndarray) -> float:
    return float(np.abs(found - expected).max() / np.abs(expected).max())


def test_derivatives_by_shared_unknowns_agree_with_a_complex_step(model: MechanismModel, place: tuple) -> None:
    shared, local = place
    found = model.predict(shared, local).by_shared
    for j in range(model.shared_size):
        nudged = shared + 1j * STEP * (np.arange(len(shared)) == j)
        assert _worst(found[..., j], model.points(nudged, local).imag / STEP) < 1e-12, j


def test_derivatives_hold_for_legs_of_variable_length_too() -> None:
    rng = np.random.default_rng(8)
    hexapod = sample_model(rng, 2, (LINEAR,), kind="ups")
    shared, local = rng.normal(size=hexapod.shared_size) * 0.1, rng.normal(size=(2, hexapod.local_size))
    found = hexapod.predict(shared, local).by_shared
    for name in ("a", "b", "l", LINEAR.key):
        for j in range(*hexapod.layout[name].indices(len(shared))):
            nudged = shared + 1j * STEP * (np.arange(len(shared)) == j)
            assert _worst(found[..., j], hexapod.points(nudged, local).imag / STEP) < 1e-12, (name, j)


def test_derivatives_by_local_unknowns_agree_with_a_complex_step(model: MechanismModel, place: tuple) -> None:
    shared, local = place
    found = model.predict(shared, local).by_local
    for j in range(model.local_size):
        nudged = local + 1j * STEP * (np.arange(model.local_size) == j)
        assert _worst(found[..., j], model.points(shared, nudged).imag / STEP) < 1e-12, j


def test_derivatives_of_the_pose_agree_with_those_of_points(model: MechanismModel, place: tuple) -> None:
    """A platform target that no survey noise moves follows from the platform's twist alone."""
    shared, local = place
    by_shared, by_local = model.pose_derivatives(shared, local)
    state, found = model.state(shared, local), model.predict(shared, local)
    away = np.flatnonzero((model.targets.body == PLATFORM) & (model.targets.leg < 0))[0]
    arm = (found.values[:, away] - state.p)[:, None]
    reach = np.concatenate([np.broadcast_to(np.eye(3), (3, 3, 3)), -skew(arm)[:, 0]], -1)
    kept = np.setdiff1d(np.arange(model.shared_size), np.r_[model.layout["shape"], model.layout["seat"]])
    assert_close((reach @ by_shared)[..., kept], found.by_shared[:, away][..., kept], atol=1e-15, what="shared, m")
    assert_close((reach @ by_local)[..., :6], found.by_local[:, away, :, :6], atol=1e-18, what="actuators, m")


def test_targets_on_the_base_stand_still_and_attachments_move_by_their_shift(model: MechanismModel) -> None:
    none, local = np.zeros(model.shared_size), np.zeros((3, model.local_size))
    deformed = none.copy()
    deformed[model.layout[MATRIX.key]] = K.ravel() / model.effect_sigma(MATRIX)
    before, after = (model.points(x, local) for x in (none, deformed))
    assert_close(after[:, model.targets.body == BASE], before[:, model.targets.body == BASE], atol=0.0, what="base")
    state = model.state(deformed, local)
    seat = np.einsum("bji,bkj->bki", state.R, after[:, model.targets.at_attachment] - state.p[:, None])
    shift = state.delta_rho @ K.T
    assert_close(seat - telescope().b, shift[..., None] * [0.0, 0.0, 1.0], atol=1e-15, what="shift, m")


def test_the_signature_of_a_cause_is_its_derivative_per_plausible_scale(model: MechanismModel, place: tuple) -> None:
    """Of K, which follows what the drive's effects make of the readings and which nothing follows."""
    shared, local = place
    scale = np.array([parameter.scale for parameter in MATRIX.parameters(6)])
    expected = (
        model.predict(shared, local).by_shared[..., model.layout[MATRIX.key]] / model.effect_sigma(MATRIX) * scale
    )
    (name, design), *others = model.design_matrix(shared, local)(MATRIX).items()
    assert not others
    found = model.pathways(shared, local)[name] @ design[:, None]
    assert_close(found, expected, atol=1e-18, what="points per plausible scale, m")


def test_a_diagonal_matrix_deforms_as_the_linear_model_does() -> None:
    legs = telescope()
    rho = legs.rho0 + np.random.default_rng(3).uniform(-1.3e-3, 1.3e-3, (5, 6))
    linear = simulate(legs, rho, [Effect(LINEAR, np.full(6, KAPPA))])
    matrix = simulate(legs, rho, [Effect(MATRIX, (KAPPA * np.eye(6)).ravel())])
    assert_close(linear.delta_bz, matrix.delta_bz, atol=1e-20, what="shift, m")
    assert_close(linear.delta_bz, KAPPA * (rho - legs.rho0), atol=1e-20, what="shift, m")
    assert_close(linear.p, matrix.p, atol=1e-15, what="p, m")


def test_an_unnamed_effect_follows_its_covariate_and_nothing_else() -> None:
    legs = telescope()
    rho = np.tile(legs.rho0, (3, 1))
    values = np.arange(1.0, 7.0) * 1e-6
    covariates = {"warmth": np.array([10.0, 20.0, 30.0]), APPROACH: np.array([[1.0] * 6, [-1.0] * 6, [1.0] * 6])}
    timed = simulate(
        legs,
        rho,
        [
            Effect(
                Nonparametric(columns=("warmth",), centres=(20.0,), half_ranges=(10.0,), degree=1),
                values,
            )
        ],
        covariates,
    )
    assert_close(timed.delta_rho, np.outer([-1.0, 0.0, 1.0], values), atol=1e-18, what="rho, m")
    backlash = simulate(
        legs,
        rho,
        [Effect(Nonparametric(columns=(APPROACH,), centres=(0.0,), half_ranges=(1.0,), degree=1), values)],
        covariates,
    )
    assert_close(backlash.delta_rho, np.outer([1.0, -1.0, 1.0], values), atol=1e-18, what="rho, m")


def test_a_survey_that_defines_a_frame_leaves_no_rigid_motion_unknown() -> None:
    rng, targets = np.random.default_rng(2), sample_targets()
    survey = rng.normal(0.0, 0.1, (len(targets.body), 3))
    unknown = shape_unknowns(targets, survey, np.tile(np.eye(3) * 25e-12, (len(survey), 1, 1)))
    base = targets.body == BASE
    rigid = np.concatenate([np.broadcast_to(np.eye(3), (base.sum(), 3, 3)), -skew(survey[base])], -1).reshape(-1, 6)
    modes = unknown.modes[base].reshape(3 * base.sum(), -1)
    assert_close(rigid.T @ modes, np.zeros((6, modes.shape[1])), atol=1e-18, what="rigid part, m")
    assert np.linalg.matrix_rank(modes, tol=1e-9) == 3 * base.sum() - 6


def test_the_shape_of_a_survey_that_is_noisier_along_one_axis_is_what_its_frame_leaves_of_the_noise() -> None:
    rng, targets = np.random.default_rng(3), sample_targets()
    survey, base = rng.normal(0.0, 0.1, (len(targets.body), 3)), targets.body == BASE
    noise = np.diag([25.0, 25.0, 900.0]) * 1e-12
    modes = shape_unknowns(targets, survey, np.tile(noise, (len(survey), 1, 1))).modes[base].reshape(3 * base.sum(), -1)
    rigid = np.concatenate([np.broadcast_to(np.eye(3), (base.sum(), 3, 3)), -skew(survey[base])], -1).reshape(-1, 6)
    left = np.eye(len(rigid)) - rigid @ np.linalg.pinv(rigid)  # less the unweighted least-squares motion
    expected = left @ np.kron(np.eye(base.sum()), noise) @ left.T
    assert_close(modes @ modes.T, expected, atol=1e-20, what="covariance of the shape, m2")


def test_targets_outside_the_frame_carry_the_noise_of_the_frame() -> None:
    """Monte Carlo: survey all targets, put the frame on those without leg, and look at the others."""
    rng, targets = np.random.default_rng(4), sample_targets(per_body=6)
    survey, sigma, draws = rng.normal(0.0, 0.1, (len(targets.body), 3)), 5e-6, 4000
    unknown = shape_unknowns(targets, survey, np.tile(np.eye(3) * sigma**2, (len(survey), 1, 1)))
    free, seats = (targets.body == PLATFORM) & (targets.leg < 0), targets.at_attachment
    motions = np.concatenate([np.broadcast_to(np.eye(3), (len(survey), 3, 3)), -skew(survey)], -1)
    noise = rng.normal(0.0, sigma, (draws, *survey.shape))
    fitted = noise[:, free].reshape(draws, -1) @ np.linalg.pinv(motions[free].reshape(-1, 6)).T
    left = (noise - np.einsum("kij,dj->dki", motions, fitted))[:, seats].reshape(draws, -1)
    whitened = np.linalg.solve(unknown.attachment_factor, left.T)
    # Sum of squares of draws x 18 unit normals: relative standard deviation sqrt(2 / 72000) = 0.53 %.
    assert_between(float(np.mean(whitened**2)), 1 - 4 * 0.0053, 1 + 4 * 0.0053, what="whitened variance")


def test_unknowns_are_kept_by_name_when_causes_come_and_go(model: MechanismModel, place: tuple) -> None:
    shared, _ = place
    plain = model.with_causes(())
    there = plain.embedded(model.embedded(shared, plain), model)
    for name, part in model.layout.items():
        kept = shared[part] if name in plain.layout else np.zeros(part.stop - part.start)
        assert_close(there[part], kept, atol=0.0, what=name)


def test_unknowns_and_geometry_are_two_ways_to_say_the_same(model: MechanismModel, place: tuple) -> None:
    shared, _ = place
    values = {effect.cause.key: effect.values for effect in model.effects(shared)}
    back = model.unknowns(model.legs(shared), values)
    kept = np.setdiff1d(np.arange(model.shared_size), np.r_[model.layout["shape"], model.layout["seat"]])
    assert_close(back[kept], shared[kept], atol=1e-9, what="unknowns, prior sigmas")


def test_flexures_are_straight_at_the_reference_of_the_machine_and_not_of_its_drawing() -> None:
    model = sample_model(np.random.default_rng(8), 5, (FlexureShift(),))
    shared, local = np.zeros(model.shared_size), np.zeros((5, model.local_size))
    for name in ("a", "b", "l"):
        place = model.layout[name]
        shared[place] = np.random.default_rng(9).standard_normal(place.stop - place.start)
    shared[model.layout[FlexureShift().key]] = 0.2
    found = model.state(shared, local)
    expected = simulate(model.legs(shared), model.conditions.readings, model.effects(shared))
    assert_close(found.p, expected.p, atol=1e-13, what="position")
    assert_close(found.R, expected.R, atol=1e-12, what="rotation")


def test_derivatives_by_geometry_include_the_reference_directions_of_flexures() -> None:
    rng = np.random.default_rng(10)
    model = sample_model(rng, 3, (FlexureShift(), LINEAR))
    shared, local = 0.3 * rng.standard_normal(model.shared_size), 0.3 * rng.standard_normal((3, model.local_size))
    found = model.predict(shared, local).by_shared
    for direction in rng.standard_normal((4, model.shared_size)):
        expected = model.points(shared + 1j * STEP * direction, local + 0j).imag / STEP
        assert _worst(found @ direction, expected) < 1e-9
