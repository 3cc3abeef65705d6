"""Bodies without a mechanism: exact derivatives, observability after the pose fit, and further observability at
rest."""

from __future__ import annotations

import numpy as np
import pytest

from tests.simulation.bodies.body_campaign import body_model
from tests.tolerance import assert_close
from truing.simulation.bodies.causes.deformation import BodyDeformation
from truing.simulation.bodies.causes.drift import BodyDrift
from truing.simulation.bodies.model import BodyModel
from truing.simulation.cause import Cause
from truing.simulation.mechanisms.causes.measurement_scale import MeasurementScale
from truing.simulation.mechanisms.causes.targets import TargetMoved
from truing.simulation.mechanisms.causes.warmth import ThermalExpansion

STEP = 1e-30


def _candidate(model: BodyModel, kind: Cause, *words: str) -> Cause:
    """Return the first candidate whose name holds all words."""
    return next(c for c in kind.candidates(model.scene) if all(word in c.key for word in words))


def _causes(model: BodyModel) -> tuple[Cause, ...]:
    return (
        _candidate(model, BodyDeformation(), "tool elevation_deg elevation_deg*elevation_deg"),
        _candidate(model, BodyDeformation(), "base whole approach"),
        _candidate(model, BodyDrift(), "base whole", "tau").refined(),
        TargetMoved("tool", "T2", 4, 4.0),
        TargetMoved("tool", "M", 5, 5.0).of_corners(model.scene.targets.names[1:4], model.scene.shape[1:4]),
        _candidate(model, BodyDrift(), "base whole", "jump at 5"),
        _candidate(model, BodyDrift(), "tool pattern", "linear from"),
        _candidate(model, ThermalExpansion(), "body=tool"),
        MeasurementScale(),
    )


@pytest.fixture(scope="module", params=["still", "still where the drive is", "led"])
def model(request: pytest.FixtureRequest) -> BodyModel:
    still, levels = request.param != "led", 3 if "drive" in request.param else 1
    plain = body_model(np.random.default_rng(3), 9, (), still=True)
    return body_model(np.random.default_rng(3), 9, _causes(plain), still, levels)


@pytest.fixture
def place(model: BodyModel) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(4)
    return 0.1 * rng.normal(size=model.shared_size), rng.normal(size=(9, model.local_size))


def test_derivatives_by_shared_unknowns_are_those_of_the_points(model: BodyModel, place: tuple) -> None:
    shared, local = place
    found = model.predict(shared, local).by_shared
    for j in range(model.shared_size):
        unit = np.eye(model.shared_size)[j]
        expected = model.points(shared + 1j * STEP * unit, local).imag / STEP
        assert np.abs(found[..., j] - expected).max() <= 1e-11 * np.abs(expected).max(), j


def test_derivatives_by_local_unknowns_are_those_of_the_points(model: BodyModel, place: tuple) -> None:
    shared, local = place
    found = model.predict(shared, local).by_local
    for j in range(model.local_size):
        expected = model.points(shared, local + 1j * STEP * np.eye(model.local_size)[j]).imag / STEP
        assert np.abs(found[..., j] - expected).max() <= 1e-12 * np.abs(expected).max(), j


def test_a_candidate_s_design_is_the_derivative_once_it_is_taken_up(model: BodyModel) -> None:
    plain = model.with_causes(())
    shared, local = np.zeros(plain.shared_size), np.zeros((9, plain.local_size))
    design = plain.design_matrix(shared, local)
    for cause in model.causes:
        own = plain.with_causes((cause,))
        wide = plain.embedded(shared, own)
        by_shared = own.predict(wide, local).by_shared[..., own.layout[cause.key]] / own.effect_sigma(cause)
        scale = np.array([parameter.scale for parameter in cause.parameters(0)])
        expected = (by_shared * scale).reshape(9, 21, -1)
        assert_close(np.broadcast_to(design(cause)["observed"], expected.shape), expected, atol=1e-12, what=cause.id)


def test_a_pattern_holds_no_motion_of_the_body_as_a_whole(model: BodyModel) -> None:
    """Whatever values it has, no shift and no turn of the body explains any part of it."""
    cause = _candidate(model, BodyDeformation(), "tool elevation_deg")
    rng = np.random.default_rng(7)
    values = rng.normal(size=12) * 1e-4
    plain = model.with_causes(())
    state = plain._recording(np.zeros(plain.shared_size), np.zeros((9, plain.local_size))).forward_pass.state
    moved = cause.shift(state, values)["moved"][:, :4]
    arms = model.known.shape[:4] - model.known.shape[:4].mean(0)
    assert_close(moved.sum(1), np.zeros((9, 3)), atol=1e-15, what="shift, m")
    assert_close(np.cross(arms, moved).sum(1), np.zeros((9, 3)), atol=1e-15, what="turn, m^2")
    assert np.abs(moved).max() > 1e-6


def test_the_reported_pattern_is_independent_of_its_rigid_motion(model: BodyModel) -> None:
    cause = _candidate(model, BodyDeformation(), "base elevation_deg")
    values, wide = np.arange(9.0) * 1e-5, np.eye(9)
    rigid = cause._rigid @ np.linalg.pinv(cause._rigid)
    reported = cause.reported(values, wide + 1e6 * rigid, 0)
    again = cause.reported(values + rigid @ np.ones(9), wide, 0)
    for one, other in zip(reported[:-1], again[:-1], strict=True):
        assert one.value == pytest.approx(other.value, abs=1e-9)
        assert one.sigma == pytest.approx(other.sigma, rel=1e-3)
    assert reported[-1].name == "driver"
    assert reported[-1].value == "elevation_deg"


def test_a_drift_ends_at_its_parameters_whatever_its_course(model: BodyModel) -> None:
    plain = model.with_causes(())
    state = plain._recording(np.zeros(plain.shared_size), np.zeros((9, plain.local_size))).forward_pass.state
    for form in ("linear", "tau=14.4", "tau=480"):
        cause = _candidate(model, BodyDrift(), "tool", form)
        values = cause._shape_only @ np.arange(12.0) * 1e-5
        moved = cause.shift(state, values)["moved"][:, :4].reshape(9, 12)
        assert_close(moved[0], np.zeros(12), atol=1e-18, what=f"{form} at first, m")
        assert_close(moved[-1], values, atol=1e-15, what=f"{form} at last, m")


def test_a_drift_that_begins_later_and_a_jump_leave_what_was_before_as_it_was() -> None:
    model = plain = body_model(np.random.default_rng(3), 9)
    state = plain._recording(np.zeros(plain.shared_size), np.zeros((9, plain.local_size))).forward_pass.state
    values = np.arange(1.0, 7.0) * 1e-5
    jump, late = (_candidate(model, BodyDrift(), "base whole", form) for form in ("jump at 5", "linear from"))
    moved = {cause.key: cause.shift(state, values)["moved"][:, 4:].reshape(9, 9) for cause in (jump, late)}
    step, course = np.repeat([0.0, 1.0], [5, 4]), np.maximum(np.arange(9) / 8.0 - 0.2, 0.0) / 0.8
    assert_close(moved[jump.key], np.outer(step, jump._rigid @ values), atol=1e-15, what="jump, m")
    assert_close(moved[late.key], np.outer(course, late._rigid @ values), atol=1e-15, what="late drift, m")


def test_a_body_may_jump_twice_but_drifts_in_one_way() -> None:
    model = body_model(np.random.default_rng(3), 9)
    first, second = (_candidate(model, BodyDrift(), "base whole", f"jump at {n}") for n in (3, 5))
    drift, other = (_candidate(model, BodyDrift(), "base whole", form) for form in ("tau", "linear from"))
    assert first.excludes(first)
    assert not first.excludes(second)
    assert not drift.excludes(first)
    assert drift.excludes(other)


def test_only_a_body_that_should_stand_still_moves_as_a_whole() -> None:
    rng = np.random.default_rng(1)
    still = [c for c in BodyDrift().candidates(body_model(rng, 9).scene) if c.whole]
    assert {c.body for c in still} == {"base"}
    assert not [c for c in BodyDrift().candidates(body_model(rng, 9, still=False).scene) if c.whole]


def test_a_mechanism_s_campaign_is_offered_no_cause_of_bodies() -> None:
    from tests.simulation.mechanisms.telescope import sample_model

    scene = sample_model(np.random.default_rng(5), 3).scene
    assert not BodyDeformation().candidates(scene)
    assert not BodyDrift().candidates(scene)
