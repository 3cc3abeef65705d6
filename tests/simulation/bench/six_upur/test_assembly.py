"""The chain of a leg, and assembly errors: reference values, and open chains against closed loops."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from numpy.typing import NDArray

from tests.simulation.bench.six_upur.sensors import SEEDS, SETS, STEP, crooked_joints, joints_of, vector
from tests.tolerance import assert_between, assert_close
from truing.estimation.rotation import exp_so3
from truing.simulation.bench.six_upur.assembly import (
    ANGLES,
    CODES,
    DhChain,
    DhErrors,
    angles_between,
    chain_errors,
    closed_loop_error,
    closed_loop_map,
    coefficients_of,
    comprehensive,
    errors_of_sources,
    influence_coefficients,
    joined_links,
    open_chain_error,
    open_chain_map,
    sensor_chains,
)
from truing.simulation.bench.six_upur.geometry import outward
from truing.simulation.bench.six_upur.influence import influence_matrix
from truing.simulation.bench.six_upur.tolerances import assembled

KINDS = ("a", "S", "theta", "alpha")


def crooked_chain(rng: np.random.Generator) -> DhChain:
    numbers = [rng.normal(0.0, size, 7) for size in (0.3, 0.3, 1.0, 1.0)]
    first, last = (vector / np.linalg.norm(vector) for vector in rng.normal(size=(2, 3)))
    origin, tail = rng.normal(size=(2, 3))
    return DhChain(exp_so3(rng.normal(size=3)), *numbers, origin, first, last, tail)


def test_chain_and_coefficients_are_those_of_the_reference() -> None:
    inputs, outputs = vector("eq9")
    numbers = [np.array(inputs[name]) for name in ("a_01_to_67", "S_1_to_7", "theta_1_to_7", "alpha_01_to_67")]
    nothing, along_x = np.zeros(3), np.array([1.0, 0.0, 0.0])  # no imaginary joints
    links = joined_links(DhChain(np.array(inputs["T0"]), *numbers, nothing, along_x, along_x, nothing))
    assert_close(links.P, outputs["P"], atol=1e-14, what="P")
    assert_close(links.T, outputs["T7"], atol=1e-14, what="T7")
    found = influence_coefficients(links)
    for kind in KINDS:
        assert_close(getattr(found, kind)[:3], outputs[f"G_{kind}_P"], atol=1e-14, what=f"G_{kind}, position")
    for kind in ("theta", "alpha"):
        assert_close(getattr(found, kind)[3:], outputs[f"G_{kind}_R"], atol=1e-14, what=f"G_{kind}, rotation")


@given(seed=SEEDS)
def test_coefficients_are_a_complex_step_of_the_chain(seed: int) -> None:
    chain = crooked_chain(np.random.default_rng(seed))
    links = joined_links(chain)
    found = influence_coefficients(links)
    for kind in KINDS:
        for j in range(7):
            nudged = joined_links(replace(chain, **{kind: getattr(chain, kind) + 1j * STEP * np.eye(7)[j]}))
            turn = nudged.T.imag @ links.T.T / STEP
            expected = np.r_[nudged.P.imag / STEP, turn[2, 1], turn[0, 2], turn[1, 0]]
            assert_close(getattr(found, kind)[:, j], expected, atol=1e-13, what=f"{kind} {j}")
            assert_close(turn, -turn.T, atol=1e-13, what="a rotation's derivative")


@given(seed=SEEDS)
def test_frames_of_a_chain_stay_rotations(seed: int) -> None:
    links = joined_links(crooked_chain(np.random.default_rng(seed)))
    assert_close(links.T @ links.T.T, np.eye(3), atol=1e-14, what="T")
    assert_close(np.linalg.det(links.T), 1.0, atol=1e-14, what="handedness")


@pytest.mark.parametrize("name", SETS)
def test_all_legs_of_a_sensor_lead_to_the_platforms_origin(name: str) -> None:
    joints = joints_of(name)
    P = joined_links(sensor_chains(joints)).P
    assert_close(P, np.broadcast_to(joints.origin, (6, 3)), atol=1e-15, what="P")


@given(seed=SEEDS)
def test_legs_of_a_crooked_sensor_lead_there_too_by_way_of_both_joints(seed: int) -> None:
    joints = crooked_joints(np.random.default_rng(seed))
    links = joined_links(sensor_chains(joints))
    assert_close(links.P, np.broadcast_to(joints.origin, (6, 3)), atol=1e-14, what="P")
    lower, upper = links.corner[:, 0], links.corner[:, 5]
    assert_close(lower, joints.lower, atol=1e-14, what="B")
    assert_close(upper, joints.origin + joints.arm, atol=1e-14, what="b")


def test_axes_and_normals_of_leg_1_are_those_of_the_reference() -> None:
    _, outputs = vector("eq11")
    links = joined_links(sensor_chains(joints_of("S")))
    for j in range(6):
        assert_close(links.axis[0, j], outputs[f"S{j + 1}"], atol=1e-15, what=f"S{j + 1}")
    for j, name in enumerate(("a12", "a23", "a34", "a45", "a56"), 1):
        assert_close(links.normal[0, j], outputs[name], atol=1e-15, what=name)
    angles = angles_between(links.normal[0, 1:6], links.axis[0, 1:5])
    expected = np.radians(list(outputs["theta_deg"].values()))
    assert_close(angles, expected, atol=1e-15, what="theta")
    assert_close(ANGLES[1:5], expected, atol=1e-15, what="theta of the chain")


@given(seed=SEEDS)
def test_a_batch_of_chains_gives_the_results_of_single_chains(seed: int) -> None:
    rng = np.random.default_rng(seed)
    some = [crooked_chain(rng) for _ in range(3)]
    together = influence_coefficients(joined_links(_stacked(some)))
    for i, chain in enumerate(some):
        alone = influence_coefficients(joined_links(chain))
        for kind in KINDS:
            assert_close(getattr(together, kind)[i], getattr(alone, kind), atol=1e-14, what=kind)


def _stacked(chains: list[DhChain]) -> DhChain:
    names: list[str] = list(DhChain.__dataclass_fields__)
    arrays: list[NDArray] = [np.stack([getattr(chain, name) for chain in chains]) for name in names]
    return DhChain(*arrays)


def random_errors(rng: np.random.Generator, size: float) -> NDArray:
    return size * rng.normal(size=(6, 5))


def test_both_errors_are_those_of_the_reference() -> None:
    inputs, outputs = vector("eq14")
    joints = joints_of("S")
    errors = np.array([inputs["errors_m"][code] for code in CODES]).T
    chains = chain_errors(coefficients_of(joints), errors_of_sources(errors))
    opened, closed = open_chain_error(chains), closed_loop_error(joints, chains)
    assert_close(opened[:3], outputs["dP_eq14"], atol=1e-18, what="position by eq. 14")
    assert_close(opened[3:], outputs["ddelta_eq14"], atol=0.0, what="attitude by eq. 14")
    assert_close(comprehensive(opened)[0], outputs["norm_dP_eq14"], atol=1e-18, what="its length")
    assert_close(closed[:3], outputs["dP_closed_loop"], atol=1e-17, what="position of the closed loop")
    assert_close(closed[3:], outputs["ddelta_closed_loop_rad"], atol=1e-17, what="attitude of the closed loop")


@given(seed=SEEDS)
def test_maps_are_the_errors_by_leg_and_source(seed: int) -> None:
    rng = np.random.default_rng(seed)
    joints, errors = crooked_joints(rng), random_errors(rng, 1.0)
    chains = chain_errors(coefficients_of(joints), errors_of_sources(errors))
    opened = np.einsum("qik,ik->q", open_chain_map(joints), errors)
    closed = np.einsum("qik,ik->q", closed_loop_map(joints), errors)
    scale = np.abs(closed_loop_error(joints, chains)).max()
    assert_close(opened, open_chain_error(chains), atol=1e-13, what="open chains")
    assert_close(closed, closed_loop_error(joints, chains), atol=1e-12 * scale, what="closed loop")


@given(seed=SEEDS)
def test_lengths_alone_never_turn_open_chains(seed: int) -> None:
    found = open_chain_map(crooked_joints(np.random.default_rng(seed)))
    assert_close(found[3:], np.zeros((3, 6, 5)), atol=0.0, what="attitude")
    assert_close(np.sum(found[:3] ** 2, 0), np.full((6, 5), 1 / 36), atol=1e-15, what="a sixth of each error")


@given(seed=SEEDS)
def test_closed_loops_are_free_of_motions_that_passive_joints_absorb(seed: int) -> None:
    """A twist of an axis that cuts the leg's line changes no length, and moves no platform."""
    rng = np.random.default_rng(seed)
    joints = crooked_joints(rng)
    zero = np.zeros((6, 7))
    twists = zero.copy()
    twists[:, 1:6] = rng.normal(size=(6, 5))  # alpha_12 .. alpha_56: about the joints' own centres
    coefficients = coefficients_of(joints)
    chains = chain_errors(coefficients, DhErrors(zero, zero, twists))
    assert np.abs(open_chain_error(chains)).max() > 1e-3
    assert_close(closed_loop_error(joints, chains), np.zeros(6), atol=1e-12, what="closed loop")


@given(seed=SEEDS)
def test_legs_keep_their_lengths_where_the_platform_is_found(seed: int) -> None:
    rng = np.random.default_rng(seed)
    joints, errors = crooked_joints(rng), random_errors(rng, 1e-4)
    found = assembled(joints, errors[None])[0]
    above, below, low, middle, installed = errors.T
    arm = joints.arm + outward(joints.arm) * above[:, None]
    lower = joints.lower + outward(joints.lower) * below[:, None]
    leg = joints.origin + found[:3] + arm @ exp_so3(found[3:]).T - lower
    assert_close(np.linalg.norm(leg, axis=-1), joints.length + low - middle + installed, atol=1e-14, what="lengths")


@given(seed=SEEDS)
def test_the_first_order_is_a_complex_step_of_the_closure(seed: int) -> None:
    rng = np.random.default_rng(seed)
    joints, errors = crooked_joints(rng), random_errors(rng, 1.0)
    found = assembled(joints, 1j * STEP * errors[None])[0].imag / STEP
    expected = np.einsum("qik,ik->q", closed_loop_map(joints), errors)
    assert_close(found, expected, atol=1e-12 * np.abs(expected).max(), what="slope")


@pytest.mark.parametrize("name", SETS)
def test_the_error_of_first_order_assembly_grows_with_the_square(name: str) -> None:
    rng = np.random.default_rng(3)
    joints, errors = joints_of(name), rng.normal(size=(20, 6, 5))
    off = []
    for size in (1e-5, 1e-4):
        linear = size * np.einsum("qik,nik->nq", closed_loop_map(joints), errors)
        off.append(np.linalg.norm(assembled(joints, size * errors) - linear))
    assert_between(off[1] / off[0], 99.0, 101.0, what="ratio of what is left out")


def test_legs_that_cannot_close_say_so() -> None:
    errors = np.zeros((2, 6, 5))
    errors[1, 0, 4] = 5.0
    found = assembled(joints_of("S"), errors)
    assert_close(found[0], np.zeros(6), atol=1e-15, what="the one without errors")
    assert np.isnan(found[1]).any()


def test_clearances_lengthen_and_shorten_and_nothing_else() -> None:
    found = closed_loop_map(joints_of("S"))
    low, middle, installed = (found[..., CODES.index(code)] for code in ("ECP", "ECU", "IES"))
    assert_close(low, -middle, atol=1e-14, what="ECU against ECP")
    assert_close(low, installed, atol=1e-14, what="IES against ECP")
    lengthening = np.einsum("qi,qj->ij", influence_matrix(joints_of("S")), installed)
    assert_close(lengthening, np.eye(6), atol=1e-13, what="length of each leg by its own error")
