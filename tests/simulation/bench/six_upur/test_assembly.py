"""Assembly errors: reference values, open chains against closed loops, and closed loops without linearising."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from numpy.typing import NDArray

from tests.simulation.bench.six_upur.sensors import SEEDS, SETS, STEP, crooked_joints, joints_of, vector
from tests.tolerance import assert_between, assert_close
from truing.estimation.rotation import exp_so3
from truing.simulation.bench.six_upur.assembly import (
    CODES,
    DhErrors,
    chain_errors,
    closed_loop_error,
    closed_loop_map,
    coefficients_of,
    comprehensive,
    errors_of_sources,
    open_chain_error,
    open_chain_map,
)
from truing.simulation.bench.six_upur.geometry import outward
from truing.simulation.bench.six_upur.influence import influence_matrix
from truing.simulation.bench.six_upur.tolerances import assembled


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
def test_closed_loops_do_not_feel_what_passive_joints_take_up(seed: int) -> None:
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
def test_what_the_first_order_leaves_out_grows_with_the_square(name: str) -> None:
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
