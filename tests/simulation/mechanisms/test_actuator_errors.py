"""Errors of a pose by its actuators, against solved poses and drawn errors."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from tests.simulation.mechanisms.telescope import telescope
from truing.estimation.rotation import log_so3
from truing.simulation.mechanisms.actuator_errors import QUANTITIES, ActuatorErrors, actuator_errors
from truing.simulation.mechanisms.legs.closures import mechanism
from truing.simulation.mechanisms.legs.kinematics import forward
from truing.simulation.mechanisms.pose_regressors import Placed
from truing.simulation.mechanisms.structures.kinematic_model import KinematicModel
from truing.simulation.mechanisms.structures.structure import Machine

ACCURACY = np.array([1.0, 2.0, 1.0, 0.5, 1.0, 3.0]) * 1e-6


def machine() -> Machine:
    return Machine(telescope(), np.zeros((6, 6)))


def placed(rho: np.ndarray) -> Placed:
    reached = forward(telescope(), rho)
    return Placed(reached.p, reached.R, rho)


def some_readings(count: int = 5) -> np.ndarray:
    return telescope().rho0 + np.random.default_rng(3).uniform(-1.3e-3, 1.3e-3, (count, 6))


def errors(rho: np.ndarray, accuracy: np.ndarray = ACCURACY) -> ActuatorErrors:
    return actuator_errors(KinematicModel("6-pus"), machine(), placed(rho), accuracy)


def solved(rho: np.ndarray, moved: np.ndarray) -> np.ndarray:
    """The six components of the pose error (N, 6) at one configuration, not linearised."""
    there, here = forward(telescope(), rho + moved), forward(telescope(), rho[None])
    turned = log_so3(there.R @ np.swapaxes(here.R, -1, -2))
    return np.concatenate([there.p - here.p, turned], -1)


def test_the_largest_error_is_that_of_the_worst_signs_of_solved_poses() -> None:
    signs = np.array(list(product((-1.0, 1.0), repeat=6)))
    rho = some_readings()
    found = errors(rho).worst
    for k, one in enumerate(rho):
        moved = solved(one, signs * ACCURACY)
        sizes = np.concatenate([np.abs(moved), np.linalg.norm(moved.reshape(-1, 2, 3), axis=-1)], 1).max(0)
        # second order: an error of 1e-4 of a leg's direction
        np.testing.assert_allclose(found[k], sizes, rtol=2e-3)


def test_the_standard_deviation_is_that_of_drawn_errors() -> None:
    rho = some_readings(1)
    drawn = np.random.default_rng(0).uniform(-1.0, 1.0, (20_000, 6)) * ACCURACY
    moved = solved(rho[0], drawn)
    rms = np.sqrt(np.concatenate([np.mean(moved**2, 0), np.sum(moved.reshape(-1, 2, 3) ** 2, -1).mean(0)]))
    # the rms of 20,000 samples scatters by less than 0.5 %
    np.testing.assert_allclose(errors(rho).sigma[0], rms, rtol=0.02)
    assert (errors(rho).sigma < errors(rho).worst).all()


def test_errors_grow_with_the_accuracy_and_shares_do_not_change() -> None:
    rho = some_readings()
    one, ten = errors(rho), errors(rho, 10.0 * ACCURACY)
    np.testing.assert_allclose(ten.worst, 10.0 * one.worst, rtol=1e-12)
    np.testing.assert_allclose(ten.shares, one.shares, rtol=1e-9, atol=1e-15)


def test_shares_add_up_and_an_exact_actuator_has_none() -> None:
    found = errors(some_readings(), np.where(np.arange(6) == 2, 0.0, ACCURACY)).shares
    assert found.shape == (5, len(QUANTITIES), 6)
    np.testing.assert_allclose(found.sum(-1), 1.0, rtol=1e-12)
    assert (found >= 0.0).all()
    assert (found[..., 2] == 0.0).all()


def test_removing_a_leg_s_error_lowers_the_largest_error_along_its_direction_by_its_share() -> None:
    """A component is a sum over legs: its share is what the leg's removal takes away."""
    rho = some_readings()
    whole, rest = errors(rho), errors(rho, np.where(np.arange(6) == 4, 0.0, ACCURACY))
    left = 1.0 - whole.shares[:, :6, 4]
    np.testing.assert_allclose(rest.worst[:, :6], whole.worst[:, :6] * left, rtol=1e-9)


def test_more_legs_than_can_be_combined_are_refused() -> None:
    about = np.linspace(0.0, 2 * np.pi, 13, endpoint=False)
    ring = np.stack([np.cos(about), np.sin(about), 0 * about], -1)
    legs = mechanism("ups", 0.3 * ring, 0.2 * np.roll(ring, 1, 0) + [0, 0, 0.3], None, np.ones(13), np.zeros(13))
    many = replace(machine(), legs=legs, deformation=np.zeros((13, 13)))
    with pytest.raises(ValueError, match="at most 12 legs"):
        actuator_errors(KinematicModel("ups"), many, placed(some_readings(1)), np.ones(13))
