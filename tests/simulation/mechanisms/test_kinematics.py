"""Closure, inverse and forward kinematics, and derivatives of the pose, against reference values and laws."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from tests.simulation.mechanisms.telescope import KAPPA, K, readings, telescope, vector
from tests.tolerance import assert_close
from truing.estimation.rotation import exp_so3, log_so3
from truing.simulation.change import Change
from truing.simulation.mechanisms.legs.closures import mechanism
from truing.simulation.mechanisms.legs.kinematics import (
    closure_rows,
    forward,
    inverse,
    inverse_jacobian,
    leg_vectors,
    pose_change,
    reaches,
    solve_rows,
    unit,
    upper_joints,
)
from truing.simulation.mechanisms.structures.kinematic_model import KinematicModel
from truing.simulation.mechanisms.structures.structure import Machine, readings_at

DEFORMATION = {"rigid": np.zeros((6, 6)), "linear": KAPPA * np.eye(6), "matrix": K}
SIZE_M = 0.5  # the largest number involved; what is asked for is 1e-9 of it


def _pose(inputs: dict[str, object]) -> tuple[NDArray, NDArray]:
    return np.array(inputs["p_mm"]) * 1e-3, np.array(inputs["R"])


@pytest.mark.parametrize("deformation", DEFORMATION)
@pytest.mark.parametrize("configuration", [1, 7, 23])
def test_forward_kinematics_reaches_the_reference_poses(deformation: str, configuration: int) -> None:
    inputs, outputs = vector(f"eq5.fk.{deformation}.{configuration}")
    moved = np.array(inputs["drho_mm"])[None] * 1e-3
    reached = forward(telescope(), telescope().rho0 + moved, moved @ DEFORMATION[deformation].T)
    assert reached.converged.all()
    assert_close(reached.p[0] * 1e3, outputs["p_mm"], atol=1e-9 * SIZE_M * 1e3, what="p")
    assert_close(reached.R[0], outputs["R"], atol=1e-9, what="R")


def test_inverse_takes_the_root_ahead_of_the_actuators() -> None:
    inputs, outputs = vector("eq7")
    p, R = _pose(inputs)
    rho = inverse(telescope(), p, R)
    assert_close(rho * 1e3, outputs["rho_mm"], atol=1e-9 * 10.0, what="rho")
    assert_close(unit(leg_vectors(telescope(), p, R, rho)), outputs["z"], atol=1e-9, what="z")


@pytest.mark.parametrize("deformation", ["linear", "matrix"])
def test_inverse_follows_the_deforming_platform(deformation: str) -> None:
    inputs, outputs = vector(f"eq7.{deformation}")
    p, R = _pose(inputs)
    found = readings_at(KinematicModel("6-pus"), Machine(telescope(), DEFORMATION[deformation]), p[None], R[None])
    assert_close(found.rho[0] * 1e3, outputs["rho_mm"], atol=1e-9 * 10.0, what="rho")


@pytest.mark.parametrize("place", ["home", "pose"])
def test_inverse_jacobian_is_that_of_the_reference(place: str) -> None:
    inputs, outputs = vector(f"eq8.{place}")
    found = inverse_jacobian(telescope(), *_pose(inputs), np.array(inputs["rho_mm"]) * 1e-3)
    expected = np.array(outputs["Jinv"]) * [1, 1, 1, 1e-3, 1e-3, 1e-3]
    assert_close(found, expected, atol=1e-9, what="J^-1, m/m and m/rad")


@given(seed=st.integers(0, 2**32 - 1), kind=st.sampled_from(["6-pus", "ups"]), deforming=st.booleans())
def test_forward_and_inverse_undo_each_other(seed: int, kind: str, deforming: bool) -> None:
    rng = np.random.default_rng(seed)
    legs = telescope(kind)
    p = np.array([0.0, 0.0, 0.497]) + rng.uniform(-1e-3, 1e-3, (4, 3))
    R = exp_so3(rng.uniform(-0.01, 0.01, (4, 3)))
    shift = rng.normal(0.0, 3e-5, (4, 6)) * deforming
    reached = forward(legs, inverse(legs, p, R, shift), shift)
    assert reached.converged.all()
    assert_close(reached.p, p, atol=1e-12, what="p, m")
    assert_close(reached.R, R, atol=1e-11, what="R")


FIELDS = {"rho": (6,), "l": (6,), "delta_bz": (6,), "a": (6, 3), "b": (6, 3), "u": (6, 3)}


@pytest.mark.parametrize(
    ("kind", "field"), [*(("6-pus", field) for field in FIELDS), *(("ups", field) for field in FIELDS if field != "u")]
)
def test_pose_derivatives_agree_with_a_complex_step(kind: str, field: str) -> None:
    rng = np.random.default_rng(11)
    legs, rho, shift = telescope(kind), readings(rng, 3), rng.normal(0.0, 2e-5, (3, 6))
    shape = FIELDS[field]
    count, step = int(np.prod(shape)), 1e-30
    found = forward(legs, rho, shift)
    change = Change({field: np.eye(count).reshape(1, *shape, count)}, count)
    twist = pose_change(legs, found.p, found.R, rho, shift, change)
    for j in range(count):
        nudge = (1j * step * np.eye(count)[j]).reshape(shape)
        given_legs = legs.replace(**{field: getattr(legs, field) + nudge}) if hasattr(legs, field) else legs
        moved = forward(
            given_legs, rho + nudge if field == "rho" else rho, shift + nudge if field == "delta_bz" else shift
        )
        turned = log_so3(moved.R @ np.swapaxes(found.R, 1, 2)).imag / step
        expected = np.concatenate([moved.p.imag / step, turned], -1)
        assert_close(twist[..., j], expected, atol=1e-11 * np.abs(expected).max(), what=f"{field} {j}")


def test_row_of_the_observability_jacobian() -> None:
    """Derivatives of f = l - |g| for leg 1, as the report's eq. 34-37 corrected; f's change is -rows of the closure."""
    inputs, outputs = vector("eq37")
    p, R = _pose(inputs)
    legs = telescope()
    rho = legs.rho0 + np.array(inputs["drho_mm"]) * 1e-3
    z = unit(leg_vectors(legs, p, R, rho))
    rows = closure_rows(legs, R[None], z[None])[0]
    assert_close(rows[0, :3], [outputs["ax"], outputs["ay"], outputs["az"]], atol=1e-9, what="a")
    assert_close(-R.T @ z[0], [outputs["bx"], outputs["by"], outputs["bz"]], atol=1e-9, what="b")
    assert_close(z[0] @ legs.u[0], outputs["rho0"], atol=1e-9, what="rho0")


def test_fewer_than_six_legs_leave_the_platform_free() -> None:
    with pytest.raises(ValueError, match="found 5 legs, expected at least 6"):
        solve_rows(np.zeros((1, 5, 6)), np.zeros((1, 5, 1)))


def test_legs_out_of_reach_are_reported_not_to_close() -> None:
    legs = telescope()
    torn = legs.rho0 + np.array([0.4, -0.4, 0.4, -0.4, 0.4, -0.4])
    assert not forward(legs, np.stack([legs.rho0, torn])).converged[1]


def test_a_mechanism_needs_matching_arrays_of_a_known_type() -> None:
    legs = telescope()
    with pytest.raises(ValueError, match="found 'delta', expected one of 6-pus, ups"):
        mechanism("delta", legs.a, legs.b, legs.u, legs.l, legs.rho0)
    with pytest.raises(ValueError, match="found shapes"):
        mechanism("6-pus", legs.a, legs.b[:5], legs.u, legs.l, legs.rho0)


@pytest.mark.parametrize("kind", ["6-pus", "ups"])
def test_newton_doubles_its_digits(kind: str) -> None:
    """Error of each iterate, in the legs' own sizes, below a constant times the square of the one before."""
    legs, rho = telescope(kind), readings(np.random.default_rng(21), 20)
    found = forward(legs, rho)
    p, R = found.p + 5e-3, exp_so3(np.full(3, 0.01)) @ found.R
    errors = []
    for _ in range(4):
        turn = log_so3(R @ np.swapaxes(found.R, 1, 2))
        errors.append(np.abs(np.concatenate([p - found.p, turn * SIZE_M], -1)).max() / SIZE_M)
        short, towards = legs.closure.close(legs, upper_joints(legs, p, R), rho)
        twist = solve_rows(closure_rows(legs, R, -towards), short[..., None])[..., 0]
        p, R = p + twist[:, :3], exp_so3(twist[:, 3:]) @ R
    assert errors[1] < 2 * errors[0] ** 2
    assert errors[2] < 2 * errors[1] ** 2
    assert errors[3] < 1e-14, "from 1 % to rounding in three steps"


def test_a_member_that_cannot_close_leaves_the_others_alone() -> None:
    legs = telescope()
    rho = readings(np.random.default_rng(22), 5)
    alone = forward(legs, rho)
    rho[1] += [0.4, -0.4, 0.4, -0.4, 0.4, -0.4]
    rho[3] = np.nan
    found = forward(legs, rho)
    assert found.converged.tolist() == [True, False, True, False, True]
    assert np.isfinite(found.p[[0, 1, 2, 4]]).all()
    assert np.isfinite(found.R[[0, 1, 2, 4]]).all()
    assert_close(found.p[[0, 2, 4]], alone.p[[0, 2, 4]], atol=1e-15, what="p, m")
    assert reaches(legs, rho).tolist() == found.converged.tolist()


def test_a_singular_member_is_reported_not_to_close() -> None:
    """All joints of the platform on one point: the rows' right half is zero, and nothing says how it turns."""
    legs = telescope()
    b = np.stack([legs.b, np.zeros((6, 3)), legs.b])
    found = forward(legs.replace(b=b), np.broadcast_to(legs.rho0, (3, 6)))
    assert found.converged.tolist() == [True, False, True]
    assert np.isfinite(found.p).all()
    assert_close(found.p[0], forward(legs, legs.rho0[None]).p[0], atol=1e-15, what="p, m")


def test_pieces_of_a_large_batch_are_those_of_a_small_one() -> None:
    legs, rng = telescope(), np.random.default_rng(23)
    rho, shift = readings(rng, 1500), rng.normal(0.0, 2e-5, (1500, 6))
    found, tail = forward(legs, rho, shift), forward(legs, rho[-100:], shift[-100:])
    assert found.converged.all()
    assert found.R.shape == (1500, 3, 3)
    assert_close(found.p[-100:], tail.p, atol=1e-15, what="p, m")


def test_a_platform_whose_frame_is_turned_is_found_all_the_same() -> None:
    legs, rho = telescope(), readings(np.random.default_rng(24), 5)
    for turn in exp_so3(np.random.default_rng(25).normal(0.0, 2.0, (10, 3))):
        found = forward(legs.replace(b=legs.b @ turn), rho)
        assert found.converged.all()
        assert_close(found.p, forward(legs, rho).p, atol=1e-14, what="p, m")


def test_a_place_out_of_reach_has_no_reading() -> None:
    p = np.array([[0.0, 0.0, 0.497], [0.4, 0.0, 0.497]])
    rho = inverse(telescope(), p, np.broadcast_to(np.eye(3), (2, 3, 3)))
    assert np.isfinite(rho[0]).all()
    assert np.isnan(rho[1]).any()


@given(seed=st.integers(0, 2**32 - 1), kind=st.sampled_from(["6-pus", "ups"]), reach=st.floats(0.0, 0.5))
def test_forward_kinematics_reports_convergence_only_of_closed_legs(seed: int, kind: str, reach: float) -> None:
    """Converged means that all legs meet the platform; nothing raises or warns, and no pose is other than a number."""
    legs = telescope(kind)
    rho = legs.rho0 + np.random.default_rng(seed).uniform(-reach, reach, (8, 6))
    found = forward(legs, rho)
    short, _ = legs.closure.close(legs, upper_joints(legs, found.p, found.R), rho)
    assert np.isfinite(found.p).all()
    assert np.isfinite(found.R).all()
    met = np.abs(short[found.converged])
    assert_close(met, np.zeros_like(met), atol=1e-12, what="closing, m")
    assert found.converged.all() or reach > 0.02
