"""Weight on the legs of a mechanism: up direction, mass of the platform, and tensions of the legs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truing.simulation.mechanisms.legs.closures import Legs
from truing.simulation.mechanisms.legs.kinematics import closure_rows, forward, leg_vectors, unit
from truing.simulation.mechanisms.state import State

GRAVITY = 9.80665  # m/s^2


@dataclass(frozen=True)
class Weight:
    """Up direction, a unit vector (3,) of the base frame; mass on the legs, kg, None if unknown or given by a
    column; centre of gravity (3,), m, platform frame."""

    up: tuple[float, float, float]
    mass_kg: float | None = None
    centre: tuple[float, float, float] = (0.0, 0.0, 0.0)


def platform_gravity(legs: Legs, rho: NDArray, up: tuple[float, float, float]) -> NDArray:
    """Return the direction of gravity (B, 3) in the platform's frame, for rigid legs at readings (B, L)."""
    return np.asarray(-np.asarray(up) @ forward(legs, rho).R)


def weight_wrench(weight: Weight, R: NDArray, mass_kg: NDArray | float) -> NDArray:
    """Return the weight (B, 6), N and N m, of masses (B,), kg, about the origin of a platform with rotations R (B, 3,
    3); base frame."""
    force = np.asarray(mass_kg)[..., None] * (-GRAVITY * np.asarray(weight.up))
    arm = R @ np.asarray(weight.centre)
    force = np.broadcast_to(force, arm.shape)
    return np.concatenate([force, np.cross(arm, force)], -1)


def tensions(state: State, up: tuple[float, float, float], centre: tuple[float, float, float]) -> NDArray:
    """Return the tension (B, 6), N per kg, of six legs that carry a mass with its centre in the platform's frame, m.

    Joints transmit only forces along the legs.
    """
    z = unit(leg_vectors(state.legs, state.p, state.R, state.rho, state.delta_bz))
    rows = closure_rows(state.legs, state.R, z, state.delta_bz)
    force = -GRAVITY * np.asarray(up)
    arm = state.R @ np.asarray(centre)
    wrench = np.concatenate([np.broadcast_to(force, arm.shape), np.cross(arm, force)], -1)
    return np.asarray(np.linalg.solve(np.swapaxes(rows, -1, -2), wrench[..., None])[..., 0])
