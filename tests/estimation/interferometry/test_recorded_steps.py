"""Conversion of readings to displacements is exact, and its uncertainty is that of the parts."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from tests.tolerance import assert_between, assert_close
from truing.estimation.interferometry.recorded_steps import (
    angular_rows,
    at_reference_temperature,
    displacement_in_air,
    displacement_sigma,
    linear_rows,
    without_frame_growth,
)
from truing.estimation.rotation import exp_so3

finite = st.floats(-1e-2, 1e-2)


@given(finite, st.floats(0.0, 2.0), st.floats(1.00025, 1.0003), st.floats(1.00025, 1.0003))
def test_displacement_in_air_inverts_the_count_through_air(
    displacement: float, dead: float, n0: float, n: float
) -> None:
    counted = n * (dead + displacement) - n0 * dead
    assert_close(displacement_in_air(counted, n, n0, dead), displacement, atol=1e-14)


def test_dead_path_is_worth_a_micrometre_per_kelvin_and_metre() -> None:
    off = displacement_in_air(0.0, 1.000271 - 0.93e-6, 1.000271, 1.0)
    assert_close(1e6 * off, 0.93, atol=1e-3)
    assert_close(displacement_sigma(1e-2, 1.0, 1e-7, 1e-8), np.hypot(1e-9, 1.01e-8), atol=1e-14)


@given(st.floats(-20.0, 20.0), st.floats(1e-6, 3e-5), st.floats(0.1, 1.0))
def test_a_part_is_as_long_at_20_degrees_as_it_was_made(warmer: float, alpha: float, length: float) -> None:
    seen = length * (1.0 + alpha * warmer)
    back = at_reference_temperature(seen, alpha, 20.0 + warmer, expansion_sigma=1e-6, temperature_sigma=0.1)
    assert_close(back.value, length, atol=1e-15)
    assert_close(back.sigma, length * np.hypot(warmer * 1e-6, alpha * 0.1), atol=1e-14)


def test_growth_of_the_frame_leaves_the_displacement() -> None:
    rng = np.random.default_rng(1)
    alpha = 11.5e-6 + 1e-6 * rng.standard_normal(20000)
    warmer = 0.4 + 0.05 * rng.standard_normal(20000)
    seen = 1e-4 + 0.3 * alpha * warmer
    found = without_frame_growth(seen, 0.3, 11.5e-6, 20.4, 20.0, expansion_sigma=1e-6, temperature_sigma=0.05)
    assert_between(float(np.std(found.value - 1e-4) / found.sigma.mean()), 0.97, 1.03)
    assert_close(found.value.mean(), 1e-4, atol=4e-9)


@given(st.tuples(finite, finite, finite), st.tuples(finite, finite, finite), st.integers(0, 2**31))
def test_rows_are_what_a_beam_sees_of_a_moved_point(d: tuple, r: tuple, seed: int) -> None:
    rng = np.random.default_rng(seed)
    beam, arm = rng.standard_normal(3), rng.uniform(-0.3, 0.3, 3)
    unit = beam / np.linalg.norm(beam)
    moved = np.array(d) + exp_so3(np.array(r)[None])[0] @ arm - arm
    state = np.concatenate([d, r])
    second_order = 0.5 * float(np.dot(r, r)) * float(np.linalg.norm(arm)) + 1e-15
    assert_close(linear_rows(beam, arm) @ state, unit @ moved, atol=1.01 * second_order)
    assert_close(angular_rows(3.0 * beam) @ state, unit @ np.array(r), atol=1e-15)


def test_rows_take_batches_and_abbe_is_its_arm() -> None:
    rows = linear_rows(np.eye(3), np.array([0.0, 0.1, 0.0]))
    assert rows.shape == (3, 6)
    assert_close(rows @ np.array([0, 0, 0, 0, 0, 1e-5]), [-1e-6, 0.0, 0.0], atol=1e-18)
