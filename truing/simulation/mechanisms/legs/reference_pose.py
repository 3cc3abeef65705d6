"""The home pose, where all readings are at their reference, and how it follows a change of the geometry.

Flexures are straight there, and the platform is as it was made: models of flexures and of stiffness count from it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truing.simulation.change import Change
from truing.simulation.mechanisms.legs.geometry import Legs
from truing.simulation.mechanisms.legs.kinematics import attachment_change, forward, leg_vectors, pose_change, unit


@dataclass(frozen=True)
class Home:
    """Pose p0 (..., 3) m, R0 (..., 3, 3) and legs' directions z0 (..., L, 3), base frame; one leading axis at least."""

    p: NDArray
    R: NDArray
    z: NDArray


@dataclass(frozen=True)
class HomeChange:
    """Derivative of the home pose by P parameters: its twist (v; omega) (..., 6, P), and that of z0 (..., L, 3, P)."""

    twist: NDArray
    z: NDArray


def home_pose(legs: Legs) -> Home:
    """Return where the mechanism of rigid legs stands at its reference readings.

    Raises ValueError for fewer than six legs, whose readings leave the pose open.
    """
    rho0 = np.atleast_2d(legs.rho0)
    home = forward(legs, rho0)
    return Home(home.p, home.R, unit(leg_vectors(legs, home.p, home.R, rho0)))


def home_change(legs: Legs, home: Home, change: Change) -> HomeChange:
    """Return how the home pose follows a change of a, b, u, l and rho0: exact wherever the legs fit together."""
    rho0 = np.atleast_2d(legs.rho0)
    moved = _at_reference(change)
    twist = home_twist(legs, home.p, home.R, change)
    arms = legs.b @ np.swapaxes(home.R, -1, -2)
    upper = _carried(twist, arms) + attachment_change(legs, home.R, moved)
    g = leg_vectors(legs, home.p, home.R, rho0)
    turned = upper - legs.closure.lower_change(legs, rho0, moved)
    across = turned - home.z[..., None] * np.einsum("...li,...lip->...lp", home.z, turned)[..., None, :]
    return HomeChange(twist, across / np.sqrt(np.sum(g * g, -1))[..., None, None])


def home_twist(legs: Legs, p: NDArray, R: NDArray, change: Change) -> NDArray:
    """Return the twist (..., 6, P) of the home pose p (..., 3), R (..., 3, 3) per parameter of a change.

    It does not depend on the deformation.
    """
    return pose_change(legs, p, R, legs.rho0, np.zeros(1), _at_reference(change))


def _at_reference(change: Change) -> Change:
    """Return what a change of the geometry means for rigid legs whose readings stay at their reference."""
    fields = {name: field for name, field in change.fields.items() if name in ("a", "b", "u", "l")}
    driven = {"rho": change.fields["rho0"]} if "rho0" in change.fields else {}
    return Change(fields | driven, change.size)


def _carried(twist: NDArray, arms: NDArray) -> NDArray:
    """Return the motion (..., L, 3, P) of points at arms (..., L, 3) on a body with twists (..., 6, P)."""
    turned = np.cross(twist[..., None, 3:, :], arms[..., None], axis=-2)
    return twist[..., None, :3, :] + turned
