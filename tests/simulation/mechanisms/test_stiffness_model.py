"""The stiffness model: reference values, equilibrium under load, energy, and linearisation error."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from tests.simulation.mechanisms.flexure_telescope import (
    FLEXURE,
    TABLE_3,
    TUBE,
    TUBE_M,
    crooked,
    flexure_telescope,
    pose,
    vector,
)
from tests.simulation.mechanisms.telescope import K
from tests.tolerance import assert_between, assert_close
from truing.estimation.rotation import log_so3
from truing.simulation.change import Change
from truing.simulation.mechanisms.legs.kinematics import forward, reference_pose
from truing.simulation.mechanisms.structures.beams import assembled, condensed
from truing.simulation.mechanisms.structures.catalogue import departure, structures
from truing.simulation.mechanisms.structures.kinematic_model import JacobianModel
from truing.simulation.mechanisms.structures.stiffness_model import (
    StiffnessModel,
    at_rest,
    balance,
    chain_of,
    compliance,
    unbalanced,
)
from truing.simulation.mechanisms.structures.structure import BeamSection, Machine, poses_at, readings_at

MODEL = StiffnessModel()
SEEDS = st.integers(0, 2**32 - 1)
IN_N_MM = np.repeat([1.0, 1e3], 3)


def _error_um(machine: Machine, moved: NDArray = TABLE_3) -> NDArray:
    """By how much the model misses readings at the poses that rigid legs lead to, um."""
    rho = machine.legs.rho0 + moved
    reached = forward(machine.legs, rho)
    return (readings_at(MODEL, machine, reached.p, reached.R).rho - rho) * 1e6


def test_along_the_motion_the_error_of_linearity_is_gone_and_at_the_pose_it_changes_its_sign() -> None:
    machine = flexure_telescope()
    rho = machine.legs.rho0 + TABLE_3
    at_reference, along, at_pose = (departure(StiffnessModel("", share), machine, rho) for share in (0.0, 0.5, 1.0))
    rms = [float(np.sqrt(np.mean(part**2))) * 1e6 for part in (at_reference, along, at_pose)]
    assert_between(rms[0], 25.0, 35.0, what="at the reference, um")
    assert_between(rms[1], 0.1, 0.6, what="along the motion, um")  # what flexures really cost, as in the beam model
    assert_close(at_pose + at_reference, np.zeros_like(at_pose), atol=0.06 * np.abs(at_reference).max())


def test_the_model_along_the_motion_is_offered_on_request_alone() -> None:
    names = [model.name for model in structures(replace(flexure_telescope(), follows_motion=True))]
    assert names == ["6-pus", "jacobian", "beam", "stiffness", "stiffness-along"]
    assert "stiffness-along" not in {model.name for model in structures(flexure_telescope())}


def test_readings_and_loads_are_those_of_the_reference() -> None:
    inputs, outputs = vector("eq29")
    machine, (p, R) = flexure_telescope(), pose(inputs)
    asked = readings_at(MODEL, machine, p, R)
    found = balance(machine, at_rest(machine), p, R, asked.rho)
    assert asked.converged.all()
    assert_close((asked.rho[0] - machine.legs.rho0) * 1e3, outputs["drho_mm"], atol=1e-9, what="drho, mm")
    expected = np.array(outputs["nodal_load_b_prime_N_Nmm"])
    scale = np.repeat([np.abs(expected[:, :3]).max(), np.abs(expected[:, 3:]).max()], 3)
    assert_close(found.load[0] * IN_N_MM / scale, expected / scale, atol=1e-9, what="loads")
    root = found.balanced[0, :1] * machine.legs.u[0]  # u_a', which the strain counts from
    displaced = found.strain[0, 0, :3] + root
    assert_close(displaced * 1e3, outputs["db_prime_leg1_mm"], atol=1e-9, what="displacement of b', mm")
    lever = np.array(outputs["M_leg1"])[3:, :3]
    assert_close([lever[2, 1], lever[0, 2], lever[1, 0]], found.arm[0, 0] * 1e3, atol=1e-9 * 130.0, what="arm, mm")


def test_unbalanced_forces_are_those_of_the_reference() -> None:
    inputs, outputs = vector("eq33")
    machine = flexure_telescope()
    rho = machine.legs.rho0 + np.array(inputs["drho_mm"])[None] * 1e-3
    found, expected = unbalanced(machine, *pose(inputs), rho)[0] * IN_N_MM, np.array(outputs["f"])
    scale = np.repeat([np.abs(expected[:3]).max(), np.abs(expected[3:]).max()], 3)
    assert_close(found / scale, expected / scale, atol=1e-9, what="f")


def test_linear_legs_cost_what_the_reference_says_over_table_3() -> None:
    found = _error_um(flexure_telescope())
    assert_between(np.sqrt(np.mean(found**2)), 30.55, 30.65, what="rms, um")
    assert_between(np.abs(found).max(), 86.5, 87.5, what="maximum, um")


def test_the_stiffness_model_departs_from_the_linear_model_by_the_resistance_of_flexures() -> None:
    machine = flexure_telescope()
    linear = departure(JacobianModel(), machine, machine.legs.rho0 + TABLE_3) * 1e6
    assert_between(np.sqrt(np.mean((_error_um(machine) - linear) ** 2)), 4.5, 5.5, what="rms, um")


def test_flexures_change_errors_by_less_than_half_a_micrometre() -> None:
    machine = flexure_telescope()
    thin = replace(FLEXURE, bending=FLEXURE.bending / 1e2, torsion=FLEXURE.torsion / 1e2)
    plain, soft = _error_um(machine), _error_um(replace(machine, flexure=thin))
    assert_between(np.sqrt(np.mean((plain - soft) ** 2)), 0.0, 0.5, what="um")


def test_legs_on_soft_flexures_err_from_rigid_ones_by_second_order_only() -> None:
    soft = replace(
        flexure_telescope(), flexure=BeamSection(1e-9 * FLEXURE.bending, FLEXURE.axial, 1e-9 * FLEXURE.torsion)
    )
    near, far = (np.sqrt(np.mean(_error_um(soft, reach * TABLE_3) ** 2)) for reach in (0.05, 0.1))
    assert_between(float(far / near), 3.95, 4.05, what="error at twice the reach")


@pytest.mark.parametrize("kind", ["6-pus", "ups"])
def test_readings_asked_for_balance_the_platform(kind: str) -> None:
    machine = replace(crooked(np.random.default_rng(1), kind), deformation=K)
    rho = machine.legs.rho0 + TABLE_3[:6]
    reached = forward(machine.legs, rho)
    asked = readings_at(MODEL, machine, reached.p, reached.R)
    before = np.abs(unbalanced(machine, reached.p, reached.R, rho)).max()
    after = np.abs(unbalanced(machine, reached.p, reached.R, asked.rho)).max()
    assert before > 10.0
    assert after < 1e-8 * before  # legs of 1e7 N/m, readings known to 1e-16 of a length of 1 m and some rounding


@pytest.mark.parametrize("kind", ["6-pus", "ups"])
def test_the_balance_is_linear_in_the_readings(kind: str) -> None:
    machine = replace(crooked(np.random.default_rng(2), kind), deformation=np.zeros((6, 6)))
    rho = machine.legs.rho0 + TABLE_3[:1]
    reached = forward(machine.legs, rho)
    zero, one, two = (unbalanced(machine, reached.p, reached.R, rho + step * 1e-3) for step in (0, 1, 2))
    assert_close(two - 2 * one + zero, np.zeros((1, 6)), atol=1e-13 * np.abs(two).max(), what="bend, N and N m")


def test_eq_29_holds_in_full_for_a_displaced_root() -> None:
    """Loads from displacement of b' less that of the root are K21 u_a' + K22 u_b'."""
    rng = np.random.default_rng(3)
    stiffness = condensed(assembled(chain_of(flexure_telescope())))
    root, end = np.zeros((6, 6)), rng.normal(0.0, 1e-3, (6, 6))
    root[:, :3] = rng.normal(0.0, 1e-3, (6, 3))
    full = stiffness[:, 6:, :6] @ root[..., None] + stiffness[:, 6:, 6:] @ end[..., None]
    found = stiffness[:, 6:, 6:] @ (end - root)[..., None]
    assert_close(found, full, atol=1e-11 * np.abs(full).max(), what="P")


def test_a_leg_that_grows_is_a_leg_whose_root_moves() -> None:
    """An actuator in the tube: loads of a tube strained by its own elongation, its ends held."""
    longer_m = 1e-4
    whole = assembled(chain_of(flexure_telescope()))[0]
    pushed = np.zeros(24)
    pushed[[6, 12]] = np.array([-1.0, 1.0]) * TUBE.axial / TUBE_M * longer_m  # c' back, d' ahead
    inner = slice(6, 18)
    settled = np.linalg.solve(whole[inner, inner], pushed[inner])
    by_growth = whole[18:, inner] @ settled
    by_root = condensed(whole)[6:, 0] * longer_m
    assert by_root[0] < -1.0, "it takes a pull towards the root to hold the end"
    assert_close(by_growth, by_root, atol=1e-11 * np.abs(by_root).max(), what="load at b'")


@pytest.mark.parametrize("kind", ["6-pus", "ups"])
def test_a_reading_moves_the_root_along_the_actuator_or_along_the_leg(kind: str) -> None:
    legs = crooked(np.random.default_rng(4), kind).legs
    rest = at_rest(replace(flexure_telescope(kind), legs=legs))
    expected = {"6-pus": legs.u, "ups": rest.reference.z}[kind]
    assert_close(rest.drive, np.broadcast_to(expected, rest.drive.shape), atol=1e-15, what="m per m")


def test_a_load_presses_the_platform_where_it_points() -> None:
    machine = flexure_telescope()
    at = machine.legs.rho0[None]
    rest = poses_at(MODEL, machine, at)
    for axis, load in enumerate(np.eye(6)):
        loaded = poses_at(MODEL, replace(machine, load=load), at)
        moved = np.concatenate([loaded.p - rest.p, log_so3(loaded.R @ np.swapaxes(rest.R, -1, -2))], -1)[0]
        assert loaded.converged.all()
        assert moved[axis] > 0
        expected = compliance(machine, rest.p, rest.R, at)[0, :, axis]
        assert_close(moved, expected, atol=1e-4 * np.abs(expected).max(), what="twist")


@given(seed=SEEDS, kind=st.sampled_from(["6-pus", "ups"]))
def test_work_equals_stored_energy_at_the_reference_pose(seed: int, kind: str) -> None:
    machine = replace(crooked(np.random.default_rng(seed), kind), load=np.zeros(6))
    reference, at = reference_pose(machine.legs), machine.legs.rho0[None]
    found = compliance(machine, reference.p, reference.R, at)[0]
    size = np.repeat([1.0, 10.0], 3)  # a lever of 0.1 m
    scaled = found * np.outer(size, size)
    assert_close(scaled, scaled.T, atol=1e-9 * np.abs(scaled).max(), what="asymmetry")
    assert np.linalg.eigvalsh(scaled).min() > 0
    load = np.random.default_rng(seed).normal(size=6) / size
    twist = found @ load
    rest = at_rest(machine)
    arm = balance(machine, rest, reference.p, reference.R, at).arm[0]
    strain = np.concatenate([twist[:3] + np.cross(twist[3:], arm), np.tile(twist[3:], (6, 1))], -1)
    stored = 0.5 * np.einsum("li,lij,lj", strain, rest.stiffness[0], strain)
    assert_close(0.5 * load @ twist, stored, atol=1e-9 * stored, what="energy, J")


def test_compliance_is_the_change_of_the_pose_with_the_load() -> None:
    machine = replace(crooked(np.random.default_rng(5), "6-pus"), deformation=K)
    rho = machine.legs.rho0 + TABLE_3[:3]
    plain = poses_at(MODEL, machine, rho)
    found = compliance(machine, plain.p, plain.R, rho)
    for axis, step in enumerate(np.diag([1.0] * 3 + [0.1] * 3)):
        ahead, behind = (poses_at(MODEL, replace(machine, load=machine.load + sign * step), rho) for sign in (1, -1))
        turned = log_so3(ahead.R @ np.swapaxes(behind.R, -1, -2))
        slope = np.concatenate([ahead.p - behind.p, turned], -1) / (2 * step[axis])
        scale = np.abs(found[..., axis]).max()
        assert_close(slope, found[..., axis], atol=1e-5 * scale, what=f"twist per load {axis}")


def test_stiffness_can_hardly_be_known_from_poses() -> None:
    """Without load all sections together are free; each alone stays unknown to its own size at 5 um of noise."""
    machine = flexure_telescope()
    rho = machine.legs.rho0 + TABLE_3
    reached = forward(machine.legs, rho)
    own = np.array([[part.bending, part.axial, part.torsion] for part in (FLEXURE, TUBE)])
    flexure, tube = np.diag(own.ravel()).reshape(2, 3, 6)
    by_share = MODEL.close(
        machine, reached.p, reached.R, rho, Change({"flexure": flexure, "tube": tube}, 6)
    ).by_parameter
    assert_close(by_share.sum(-1), np.zeros(rho.shape), atol=1e-8 * np.abs(by_share).max(), what="all together, m")
    sigma = 5e-6 / np.sqrt(np.sum(by_share**2, (0, 1)))
    assert sigma.min() > 1.0
