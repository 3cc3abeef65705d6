"""Targets on a leg determine the position of their survey; with too few targets, it is undetermined."""

from __future__ import annotations

import numpy as np
import pytest

from tests.simulation.mechanisms.telescope import readings, telescope
from tests.tolerance import assert_close
from truing.estimation.rotation import exp_so3
from truing.inference.observations import Frames
from truing.simulation.mechanisms.measured_mechanism import MeasuredTargets, seated_legs
from truing.simulation.mechanisms.model import nominal_leg_frames
from truing.simulation.targets import LEG, PLATFORM, Targets

LEG_NUMBER, POSES = 2, 5
SHAPE = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.0, 0.1, 0.0], [0.05, 0.05, 0.1]])
ROTATION, SEAT = exp_so3(np.array([0.2, -0.1, 0.3])), np.array([0.02, -0.03, 0.4])


def _measured(kind: str, targets: int = len(SHAPE)):
    """Legs, readings, and exact points of one leg's targets in the base, which is the measurement."""
    legs, rho = telescope(kind), readings(np.random.default_rng(1), POSES)
    frame = nominal_leg_frames(legs, rho)
    on_leg = SHAPE[:targets] @ ROTATION.T + SEAT
    points = frame.origin[:, LEG_NUMBER, None] + on_leg @ np.swapaxes(frame.rotation[:, LEG_NUMBER], -1, -2)
    names = tuple(f"T{k}" for k in range(targets))
    of = Targets(np.full(targets, LEG), np.full(targets, LEG_NUMBER), names, (f"leg{LEG_NUMBER + 1}",) * targets)
    cov = np.zeros((targets, 3, 3))
    is_observed = np.ones((POSES, targets), bool)
    return legs, rho, MeasuredTargets(of, SHAPE[:targets], cov, points, cov[None].repeat(POSES, 0), is_observed, ())


def _seated(kind: str, targets: int = len(SHAPE)):
    legs, rho, measured = _measured(kind, targets)
    base = Frames(np.tile(np.eye(3), (POSES, 1, 1)), np.zeros((POSES, 3)))
    return seated_legs(legs, measured, rho, base, np.ones(POSES, bool))


def test_a_leg_is_seated_as_its_targets_were_measured() -> None:
    found = _seated("6-pus")
    assert found.legs.tolist() == [LEG_NUMBER]
    assert found.dropped == []
    assert_close(found.rotation[LEG_NUMBER], ROTATION, atol=1e-10)
    assert_close(found.seat[LEG_NUMBER], SEAT, atol=1e-10)


@pytest.mark.parametrize(("kind", "targets", "said"), [("6-pus", 2, "fewer than three"), ("ups", 4, "one rigid body")])
def test_targets_that_seat_no_leg_are_dropped_with_the_reason(kind: str, targets: int, said: str) -> None:
    found = _seated(kind, targets)
    assert found.legs.tolist() == []
    assert len(found.dropped) == 1
    assert said in found.dropped[0]


def test_targets_of_legs_that_are_not_seated_are_not_carried() -> None:
    own = Targets(np.array([PLATFORM, LEG, LEG]), np.array([-1, LEG_NUMBER, 0]), ("a", "b", "c"), ("p", "l", "l"))
    assert _seated("6-pus").targets_on_legs(own).tolist() == [True, True, False]
