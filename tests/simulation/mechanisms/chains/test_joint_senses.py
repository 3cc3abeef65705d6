"""Senses of several joints, and a coupling, are named together if single slips do not explain the data."""

from __future__ import annotations

import numpy as np
import pytest

from truing.arrays import Array, Mask
from truing.simulation.mechanisms.chains.column_slips import ColumnSlipKind
from truing.simulation.mechanisms.chains.conditions import ChainConditions
from truing.simulation.mechanisms.chains.joint_senses import senses_that_join
from truing.simulation.mechanisms.chains.start_values import StartValues
from truing.simulation.mechanisms.chains.tree import JointKind, Node, Tree

COUNT = 40
TURNS = np.random.default_rng(8).uniform(-0.9, 0.9, (COUNT, 3))
Y, Z = np.array([0.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.0])
REACHES = ((Z, [0.05, 0.0, 0.3]), (Y, [0.0, 0.0, 0.5]), (Y, [0.4, 0.03, 0.1]))


def turned(axis: Array, angles: Array) -> Array:
    """Rotations (B, 3, 3) about a unit axis, by Rodrigues' formula."""
    K = np.cross(np.eye(3), -axis)
    return np.eye(3) + np.sin(angles)[:, None, None] * K + (1.0 - np.cos(angles))[:, None, None] * (K @ K)


def tip(readings: Array) -> Array:
    """Tip (B, 3), m, of an arm of three joints, written out apart from the package."""
    place, R = np.zeros((COUNT, 3)), np.tile(np.eye(3), (COUNT, 1, 1))
    for k, (axis, reach) in enumerate(REACHES):
        R = R @ turned(axis, readings[:, k])
        place = place + R @ np.array(reach)
    return place


MEASURED = tip(TURNS) + 1e-4 * np.random.default_rng(9).normal(size=(COUNT, 3))
ARM = Tree(
    tuple(
        Node(f"j{k}", f"l{k}", k - 1, np.eye(3), np.zeros(3), JointKind.REVOLUTE, axis, f"j{k}")
        for k, (axis, _) in enumerate(REACHES)
    ),
    ("j0", "j1", "j2"),
)


def start_of(chosen: Mask, given: ChainConditions) -> StartValues:
    errors = (MEASURED - tip(given.readings))[chosen][:, None]
    eye, zero = np.eye(3)[None], np.zeros((1, 3))
    return StartValues(eye, zero, zero, eye, float(np.sqrt(np.mean(errors**2))), float(np.std(MEASURED)), errors)


def conditions_at(readings: Array) -> ChainConditions:
    reference, none = np.tile(np.eye(3), (COUNT, 1, 1, 1)), np.zeros(COUNT, int)
    return ChainConditions(readings, {}, tuple(range(COUNT)), none, reference, np.zeros(COUNT))


@pytest.mark.parametrize("own", [(0, 2), (1, 2), (0, 1, 2), (1,)])
@pytest.mark.parametrize(
    ("sign", "kind"), [(0.0, None), (1.0, ColumnSlipKind.SUBTRACTED), (-1.0, ColumnSlipKind.ADDED)]
)
def test_every_combination_of_senses_and_a_coupling_is_undone(
    own: tuple[int, ...], sign: float, kind: ColumnSlipKind | None
) -> None:
    recorded = TURNS.copy()
    recorded[:, list(own)] *= -1.0
    recorded[:, 2] += sign * recorded[:, 1]
    found = senses_that_join(ARM, conditions_at(recorded), start_of)
    assert found is not None
    assert found.corrected(recorded) == pytest.approx(TURNS)
    assert (found.reversed_readings, found.coupling) == (own, kind)
    assert found.after < 2e-4


def test_readings_of_other_poses_are_joined_by_no_senses() -> None:
    recorded = TURNS[np.random.default_rng(3).permutation(COUNT)]
    assert senses_that_join(ARM, conditions_at(recorded), start_of) is None


def test_senses_are_not_named_where_as_many_other_changes_are_as_good() -> None:
    """A fit that sees neither of two joints takes either sense of both."""
    recorded = TURNS * [1.0, -1.0, -1.0]

    def one_changed(chosen: Mask, given: ChainConditions) -> StartValues:
        changed = np.any(given.readings != recorded, axis=0).sum()
        return StartValues(**{**vars(start_of(chosen, given)), "rms": 1e-5 if changed == 1 else 0.3})

    assert senses_that_join(ARM, conditions_at(recorded), one_changed) is None
