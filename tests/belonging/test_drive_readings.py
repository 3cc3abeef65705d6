"""Readings of a rotary drive against the rotation of a body: slips are named; a body that does not follow is no
slip."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from truing.belonging.drive_tests import DrivenBody, relate_drive
from truing.belonging.relation import RelationState, SlipKind

AXIS = np.array([0.2, -0.3, 0.93])
COMMANDS = np.array([0, 10, 25, 40, 60, 75, 90, 80, 65, 50, 30, 20, 5, 0], float)
Slip = Callable[[np.ndarray], np.ndarray]


def _driven(commands: np.ndarray = COMMANDS, gear: float = 1.0, wobble_deg: float = 0.01) -> DrivenBody:
    wobble = np.deg2rad(wobble_deg) * np.random.default_rng(5).normal(size=(len(commands), 3))
    turned = Rotation.from_rotvec(wobble) * Rotation.from_rotvec(np.deg2rad(gear * commands)[:, None] * AXIS)
    names = tuple(f"P{pose}" for pose in range(len(commands)))
    return DrivenBody(
        "mirror", "elevation_deg", (turned * Rotation.random(random_state=1)).as_matrix(), commands, names
    )


def _unit(values: np.ndarray) -> np.ndarray:
    return np.asarray(np.deg2rad(values))


def _exchanged(values: np.ndarray) -> np.ndarray:
    values[[3, 8]] = values[[8, 3]]
    return values


def _frozen(values: np.ndarray) -> np.ndarray:
    values[8:] = values[8]
    return values


def _misread(values: np.ndarray) -> np.ndarray:
    values[4] = 6.0
    return values


@pytest.mark.parametrize(
    ("slip", "kind"),
    [
        (_unit, SlipKind.UNIT),
        (lambda values: np.roll(values, 1), SlipKind.ROWS_SHIFTED),
        (_exchanged, SlipKind.ROWS_EXCHANGED),
        (_frozen, SlipKind.FROZEN),
        (_misread, SlipKind.STRAY),
    ],
)
def test_a_slip_of_the_readings_is_named(slip: Slip, kind: SlipKind) -> None:
    body = _driven()
    found = relate_drive([replace(body, readings=slip(body.readings.copy()))])
    assert found.state is RelationState.FAILS
    assert [slip.kind for slip in found.slips] == [kind]


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_body_that_follows_agrees_whatever_the_sign_of_the_drive(sign: float) -> None:
    body = _driven()
    assert relate_drive([replace(body, readings=sign * body.readings + 7.0)]).state is RelationState.OK


@pytest.mark.parametrize("gear", [0.0, 0.3, 3.0])
def test_a_body_that_does_not_follow_is_not_tested(gear: float) -> None:
    assert relate_drive([_driven(gear=gear)]).state is RelationState.NOT_TESTED


def test_a_body_that_turns_at_random_is_not_tested() -> None:
    body = _driven()
    turned = Rotation.random(len(COMMANDS), random_state=3).as_matrix()
    assert relate_drive([replace(body, rotations=turned)]).state is RelationState.NOT_TESTED
