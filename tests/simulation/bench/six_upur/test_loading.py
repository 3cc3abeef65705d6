"""Applied loads: moments of eccentric forces, and unevenly shared loads of two units."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.simulation.bench.six_upur.sensors import SEEDS, STEP
from tests.tolerance import assert_close
from truing.simulation.bench.six_upur.loading import (
    AXES,
    UnitForces,
    eccentric_wrench,
    imbalance,
    imbalanced_wrench,
    share_wrench,
    two_units,
    wrench_of,
)

LOADS = np.array([-9000.0, -1000.0, 0.0, 1000.0, 9000.0])
NUMBERS = st.floats(-0.5, 0.5)


@pytest.mark.parametrize("axis", AXES)
def test_a_load_on_its_line_is_that_load_alone(axis: str) -> None:
    found = eccentric_wrench(axis, LOADS)
    assert_close(found[:, AXES.index(axis)], LOADS, atol=0.0, what=axis)
    assert np.count_nonzero(found) == 4


@given(seed=SEEDS)
def test_a_force_off_its_line_is_seen_without_moment_from_where_it_acts(seed: int) -> None:
    offset = np.random.default_rng(seed).normal(size=3)
    for axis in AXES[:3]:
        wrench = eccentric_wrench(axis, LOADS, offset, force_per_m=offset)
        there = wrench[:, 3:] - np.cross(offset, wrench[:, :3])
        assert_close(there, np.zeros((5, 3)), atol=1e-12 * 9000, what="moment where the force acts")


def test_a_torque_brings_a_force_along_and_no_offset_matters() -> None:
    found = eccentric_wrench("my", LOADS, offset_m=(1.0, 2.0, 3.0), force_per_m=(0.1, 0.0, -0.2))
    assert_close(found, LOADS[:, None] * [0.1, 0.0, -0.2, 0.0, 1.0, 0.0], atol=1e-12, what="wrench")


@given(arm=NUMBERS, pushing=NUMBERS, pulling=NUMBERS)
def test_units_are_the_imbalance_that_they_say(arm: float, pushing: float, pulling: float) -> None:
    units = two_units("fz", (arm, 0.0, 0.0), pushing, pulling)
    found = imbalanced_wrench("fz", LOADS, units.imbalance("fz"), 1e4)
    assert_close(found, units.wrench(LOADS), atol=1e-9, what="wrench")
    excess = np.where(LOADS < 0.0, pulling, pushing)
    expected = wrench_of("fz", LOADS)
    expected[:, 4] = -2.0 * arm * excess * LOADS
    assert_close(units.wrench(LOADS), expected, atol=1e-9, what="moment of the couple")


def test_units_that_lean_bring_forces_along() -> None:
    lean = np.array([[0.05, 0.0, 0.5], [0.05, 0.0, 0.5]])
    units = UnitForces(np.array([[0.4, 0, 0], [-0.4, 0, 0]]), lean, lean * [0.0, 0.0, 1.0])
    assert_close(units.wrench(np.array([1000.0, -1000.0]))[:, 0], [100.0, 0.0], atol=1e-12, what="sideways")
    assert_close(units.imbalance("fz").asymmetry[0], 0.1, atol=1e-15, what="asymmetry")


def test_only_an_asymmetry_has_an_even_part() -> None:
    growing = imbalance(ratio=0.1, growth=0.3)
    even = [
        imbalanced_wrench("fz", LOADS, found, 9000.0) + imbalanced_wrench("fz", -LOADS, found, 9000.0)
        for found in (growing, imbalance(asymmetry=0.1))
    ]
    assert_close(even[0], np.zeros((5, 6)), atol=1e-12, what="of a ratio that grows")
    assert_close(even[1], np.broadcast_to(0.1 * np.abs(LOADS)[:, None], (5, 6)), atol=1e-12, what="of an asymmetry")


def test_wrenches_are_linear_in_what_describes_the_imbalance() -> None:
    for name in ("ratio", "asymmetry", "growth"):
        nudged = imbalanced_wrench("fz", LOADS, imbalance(**{name: 1j * STEP}), 9000.0).imag / STEP
        whole = imbalanced_wrench("fz", LOADS, imbalance(**{name: 1.0}), 9000.0) - wrench_of("fz", LOADS)
        assert_close(nudged, whole, atol=1e-12 * 9000, what=name)


def test_unknown_axes_are_refused() -> None:
    with pytest.raises(ValueError, match="found 'z', expected one of fx, fy"):
        wrench_of("z", 1.0)
    with pytest.raises(ValueError, match="found 'z', expected one of fx, fy"):
        two_units("z", (0.1, 0.0, 0.0))
    with pytest.raises(ValueError, match=r"arm of mx: .* expected one across"):
        two_units("mx", (0.1, 0.0, 0.0))


@pytest.mark.parametrize(
    ("axis", "arm", "along"), [("mx", (0, 0.6, 0), 2), ("my", (0.5, 0, 0), 2), ("mz", (0, -0.4, 0), 0)]
)
@given(pushing=NUMBERS, pulling=NUMBERS)
def test_units_of_a_torque_bring_a_force_and_keep_the_torque(axis, arm, along, pushing, pulling) -> None:
    """A couple of F1 and F2 on arms a: torque a (F1 + F2) as recorded, force F1 - F2 of 2 excess / a of it."""
    units = two_units(axis, arm, pushing, pulling)
    excess = np.where(LOADS < 0.0, pulling, pushing)
    first = two_units(axis, arm, 0.5, 0.5).wrench(1.0)[along]  # all of the load on the first unit
    assert_close(abs(first), 1.0 / np.linalg.norm(arm), atol=1e-12, what="force of the whole torque")
    expected = wrench_of(axis, LOADS)
    expected[:, along] = 2.0 * excess * first * LOADS
    assert_close(units.wrench(LOADS), expected, atol=1e-9, what="wrench")
    assert_close(imbalanced_wrench(axis, LOADS, units.imbalance(axis), 1e4), expected, atol=1e-9, what="imbalance")


def test_the_couple_of_a_torque_turns_the_right_way_round() -> None:
    """About z by units at +y and -y: the first pushes towards -x."""
    assert_close(share_wrench("mz", (0.0, 0.5, 0.0)), [-4.0, 0, 0, 0, 0, 0], atol=1e-12, what="per excess")
    assert_close(share_wrench("fz", (0.5, 0.0, 0.0)), [0, 0, 0, 0, -1.0, 0], atol=1e-12, what="per excess")
