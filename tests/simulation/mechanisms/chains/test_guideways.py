"""Guideway errors act at the carriage: a rotation does not shift it, and a shift does not rotate it."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from tests.tolerance import assert_close
from truing.estimation.rotation import exp_so3, log_so3
from truing.simulation.mechanisms.chains.guideways import SHIFT, TURN, GuidewayError
from truing.simulation.mechanisms.chains.tree import JointKind, Node, Tree

READINGS = np.linspace(-0.3, 1.7, 41)[:, None]


def slide(axis: np.ndarray) -> Tree:
    rng = np.random.default_rng(8)
    base = Node("", "base", -1, np.eye(3), np.zeros(3))
    at = exp_so3(rng.normal(size=3)), rng.normal(size=3)
    return Tree((base, Node("x", "carriage", 0, *at, JointKind.PRISMATIC, axis, "x", -1.0, 0.1)), ("x",))


def moved(cause: GuidewayError, tree: Tree, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Shift and rotation vector (B, 3) of the carriage by the error, in the frame of its nominal place."""
    machine = SimpleNamespace(tree=tree, readings=READINGS)
    twists = cause.twists(machine) @ values  # type: ignore[arg-type]
    plain, off = tree.frames(READINGS), tree.frames(READINGS, twists)
    back = np.swapaxes(plain.R[:, 1], -1, -2)
    shift = (back @ (off.t[:, 1] - plain.t[:, 1])[..., None])[..., 0]
    return shift, log_so3(back @ off.R[:, 1])


@pytest.mark.parametrize("axis", [np.array([1.0, 0.0, 0.0]), np.array([0.8, 0.6, 0.0])])
def test_a_turn_leaves_the_place_of_the_carriage(axis: np.ndarray) -> None:
    cause = GuidewayError(joint="x", error=TURN, axis="z", degree=3, low=-0.3, high=1.7)
    values = 1e-6 * np.array([30.0, -20.0, 15.0])
    shift, turn = moved(cause, slide(axis), values)
    x = READINGS[:, 0] - 0.7
    legendre = np.stack([x, 1.5 * x**2 - 0.5, 2.5 * x**3 - 1.5 * x], -1)  # over a travel of 2 m
    assert_close(turn, (legendre @ values)[:, None] * np.array([0.0, 0.0, 1.0]), atol=1e-15)
    assert np.abs(shift).max() < 1e-8  # of second order: 65 urad over 2 m would be 130 um


@pytest.mark.parametrize("axis", [np.array([1.0, 0.0, 0.0]), np.array([0.8, 0.6, 0.0])])
def test_a_shift_is_at_right_angles_to_the_travel_and_turns_nothing(axis: np.ndarray) -> None:
    cause = GuidewayError(joint="x", error=SHIFT, axis="y", degree=2, low=-0.3, high=1.7)
    shift, turn = moved(cause, slide(axis), np.array([25e-6]))
    assert_close(turn, np.zeros_like(turn), atol=1e-15)
    assert_close(shift @ axis, np.zeros(len(shift)), atol=1e-15)
    x = READINGS[:, 0] - 0.7
    assert_close(np.linalg.norm(shift, axis=1), 25e-6 * np.abs(1.5 * x**2 - 0.5), atol=1e-15)


def test_the_largest_shift_is_measured_from_the_line_through_both_ends() -> None:
    cause = GuidewayError(joint="x", error=SHIFT, axis="y", degree=2, low=0.0, high=2.0)
    *_, largest = cause.reported(np.array([20e-6]), np.array([[1e-12]]), 0)
    # Legendre's second polynomial runs from 1 over -1/2 to 1: a bow of 1.5
    assert (largest.name, largest.unit) == ("largest", "mm")
    assert_close(np.array([largest.value, largest.sigma]), np.array([0.030, 0.0015]), atol=1e-9)


def test_forms_of_one_motion_exclude_each_other_and_others_do_not() -> None:
    bow = GuidewayError(joint="x", error=SHIFT, axis="y", degree=2)
    assert bow.excludes(replace(bow, degree=5))
    assert not bow.excludes(replace(bow, axis="z"))
    assert not bow.excludes(replace(bow, error=TURN))
    assert not bow.excludes(replace(bow, joint="y"))
