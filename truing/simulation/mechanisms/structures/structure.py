"""Protocol `Structure` of models of a mechanism's structure, and kinematics of a machine (`Machine`) under any model.

A model is one equation per leg (or six, of equilibrium) that is zero if pose and readings are consistent, with exact
derivatives. Forward and inverse kinematics and all calibrations use only these equations.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from truing.estimation.rotation import exp_so3
from truing.simulation.change import Change
from truing.simulation.mechanisms.legs.closures import Legs
from truing.simulation.mechanisms.legs.kinematics import (
    SMALL_STEP,
    Forward,
    bounded_steps,
    forward,
    in_pieces,
    inverse,
    is_batched,
    solve_rows,
)

_MAX_ITERATIONS = 30


@dataclass(frozen=True)
class BeamSection:
    """Stiffness of a circular beam's section: bending k1 = EI (N m^2), axial k2 = ES (N), torsion k3 = GJ (N m^2)."""

    bending: float
    axial: float
    torsion: float


@dataclass(frozen=True)
class Machine:
    """A mechanism with all numbers that a model of its structure may use; arrays may have leading batch axes.

    deformation: K (..., L, L), shift of the attachments along z of the platform per displacement of the actuators
    (telescope report, eq. 2). It is diagonal if each depends on its own actuator only (eq. 1); flexure_length: (...,
    L) m, if
    the joints are flexures; beta: (..., L), the flexures' design parameter (eq. 15), None for 1/4; flexure, tube: their
    sections, if known; load: wrench (..., 6) on the platform at its origin, base axes, N and N m; in_plane: shift of
    attachment i along x and y of the platform per displacement of actuator j, (L, 2, L), which only the kinematic model
    uses; None for none; follows_motion: whether a stiffness model along the motion is wanted.
    """

    legs: Legs
    deformation: NDArray
    flexure_length: NDArray | None = None
    flexure: BeamSection | None = None
    tube: BeamSection | None = None
    load: NDArray = field(default_factory=lambda: np.zeros(6))
    in_plane: NDArray | None = None
    beta: NDArray | None = None
    follows_motion: bool = False

    def delta_bz(self, rho: NDArray) -> NDArray:
        """Return the attachments' shift (..., L), m, along z of the platform at readings rho (..., L), m."""
        return np.einsum("...ij,...j->...i", self.deformation, rho - self.legs.rho0)

    def bent_legs(self, rho: NDArray) -> Legs:
        """Return the legs with their attachments shifted in the platform's plane, as at readings rho (..., L), m."""
        if self.in_plane is None:
            return self.legs
        shift = np.einsum("...iaj,...j->...ia", self.in_plane, rho - self.legs.rho0)
        return self.legs.replace(b=self.legs.b + np.concatenate([shift, 0.0 * shift[..., :1]], -1))

    def by_readings(self) -> NDArray:
        """Return the derivative (..., L, 3, L) of the attachments, platform frame, by the readings."""
        plane = np.zeros((self.legs.count, 2, self.legs.count)) if self.in_plane is None else self.in_plane
        along = self.deformation[..., None, :]
        return np.concatenate([np.broadcast_to(plane, (*along.shape[:-3], *plane.shape[-3:])), along], -2)


@dataclass(frozen=True)
class Closing:
    """Closure residuals: M equations in m that are zero if pose and readings are consistent, and all first derivatives.

    The twist (v; omega) of the platform is in the base frame, R <- exp(omega) R. ``by_parameter`` is the derivative by
    the P parameters of the requested change of the machine.
    """

    value: NDArray  # (B, M)
    by_twist: NDArray  # (B, M, 6)
    by_rho: NDArray  # (B, M, L)
    by_parameter: NDArray  # (B, M, P)


class Structure(Protocol):
    """An immutable model of the structure, identified by its name.

    Changes have the fields a, b, u (..., L, 3, P), l, rho0, flexure_length, beta (..., L, P); deformation (..., L, L,
    P), flexure, tube (..., 3, P) in the order bending, axial, torsion.
    """

    @property
    def name(self) -> str:
        """Unique name of the model."""

    def fits(self, machine: Machine) -> bool:
        """True if the machine has the numbers that this model needs."""

    def close(self, machine: Machine, p: NDArray, R: NDArray, rho: NDArray, change: Change) -> Closing:
        """Return the closure residuals at poses p (B, 3), R (B, 3, 3) and readings rho (B, L), m."""


NO_CHANGE = Change({}, 0)


@dataclass(frozen=True)
class Readings:
    """Readings at a set of poses, and whether the iteration converged."""

    rho: NDArray  # (B, L) m
    converged: NDArray  # (B,) bool


def poses_at(structure: Structure, machine: Machine, rho: NDArray) -> Forward:
    """Return the poses at readings rho (B, L), m, by Newton's method from those of rigid legs on the same platform.

    If the structure does not close, the last pose tried is returned as not converged. Raises ValueError for fewer than
    six legs.
    """
    if is_batched(machine.legs) or machine.deformation.ndim > 2 or machine.load.ndim > 1:
        return _newton(structure, machine, rho)
    return in_pieces(partial(_newton, structure, machine), rho)


def _newton(structure: Structure, machine: Machine, rho: NDArray) -> Forward:
    start = forward(machine.legs, rho, machine.delta_bz(rho))
    p, R, lost, converged = start.p, start.R, ~start.converged, np.zeros(len(rho), bool)
    for _ in range(_MAX_ITERATIONS):
        closing = structure.close(machine, p, R, rho, NO_CHANGE)
        twist, length = bounded_steps(closing.by_twist, -closing.value)
        lost = lost | (length == np.inf)
        p, R = p + twist[..., :3], exp_so3(twist[..., 3:]) @ R
        converged = ~lost & (length < SMALL_STEP * np.abs(machine.legs.l).max(-1))
        if np.all(converged | lost):
            break
    return Forward(p, R, converged)


def readings_at(structure: Structure, machine: Machine, p: NDArray, R: NDArray) -> Readings:
    """Return the readings at poses p (B, 3), R (B, 3, 3) of the platform, by Newton's method from those of rigid legs.

    If no reading leads there, the last one tried is returned as not converged.
    """
    rigid = inverse(machine.legs, p, R)
    rho = np.where(np.isfinite(rigid), rigid, machine.legs.rho0)
    lost = converged = np.zeros(len(rho), bool)
    for _ in range(_MAX_ITERATIONS):
        closing = structure.close(machine, p, R, rho, NO_CHANGE)
        step, length = bounded_steps(closing.by_rho, -closing.value)
        lost, rho = lost | (length == np.inf), rho + step
        converged = ~lost & (length < SMALL_STEP * np.abs(machine.legs.l).max(-1))
        if np.all(converged | lost):
            break
    return Readings(rho, converged)


# Condition number from which the legs do not hold the platform in some direction; motions in m, rad scaled to m.
_SINGULAR = 1e8
_LENGTHS = np.array([1.0, 1.0, 1.0, 0.1, 0.1, 0.1])  # m moved per m, and per rad


@dataclass(frozen=True)
class ReachedPoses:
    """Poses p (B, 3) m, R (B, 3, 3) with the platform's twist (v; omega), base frame, per reading (B, 6, L) and per
    parameter (B, 6, P).

    ``converged``: the legs close and hold the platform.
    """

    p: NDArray
    R: NDArray
    by_rho: NDArray
    by_parameter: NDArray
    converged: NDArray

    def covariance(self, reading_sigma: float, parameters: NDArray) -> NDArray:
        """Return the covariance (B, 6, 6) of the poses from readings of one sigma, m, and from parameters (P, P)."""
        readings = reading_sigma**2 * self.by_rho @ np.swapaxes(self.by_rho, -1, -2)
        return readings + self.by_parameter @ parameters @ np.swapaxes(self.by_parameter, -1, -2)


def reached_poses(structure: Structure, machine: Machine, rho: NDArray, change: Change) -> ReachedPoses:
    """Return the poses at readings rho (B, L), m, with their derivatives by a change of the machine.

    Raises ValueError for fewer than six legs, whose readings do not determine the pose.
    """
    poses = poses_at(structure, machine, rho)
    closing = structure.close(machine, poses.p, poses.R, rho, change)
    fixed = poses.converged & (np.linalg.cond(closing.by_twist / _LENGTHS) < _SINGULAR)
    rows = np.where(fixed[:, None, None], closing.by_twist, np.eye(rho.shape[-1], 6))
    twist = -solve_rows(rows, np.concatenate([closing.by_rho, closing.by_parameter], -1))
    legs = rho.shape[-1]
    return ReachedPoses(poses.p, poses.R, twist[..., :legs], twist[..., legs:], fixed)
