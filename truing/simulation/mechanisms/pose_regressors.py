"""Rows of the calibration's Jacobian, leg by leg, as a function of the configuration, for the choice of configurations.

A configuration is six coordinates x of the platform's displacement from the reference pose: (p - p0; log R R0^T) =
scale @ x. Readings follow from the mechanism's closure, for any number of legs from six on.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truing.estimation.rotation import exp_so3, left_jacobian_so3, log_so3, skew
from truing.simulation.change import Change
from truing.simulation.mechanisms.legs.kinematics import ReferencePose, reference_pose
from truing.simulation.mechanisms.parameters import ParameterSet
from truing.simulation.mechanisms.structures.structure import Machine, Structure, readings_at

# Complex step, far below rounding of any real part: it has no cancellation.
_STEP = 1e-40


@dataclass(frozen=True)
class Placed:
    """Configurations: poses p (..., 3) m, R (..., 3, 3) and readings rho (..., L) m."""

    p: NDArray
    R: NDArray
    rho: NDArray


@dataclass(frozen=True)
class PoseRegressors:
    """Rows of the observability Jacobian, leg by leg (telescope report, eq. 37), over configurations x (B, 6).

    change: derivative of the machine by q parameters of every leg at once, arrays (L, 3, q) and (L, q); scale (6, 6):
    displacement per coordinate, m and rad.
    """

    structure: Structure
    machine: Machine
    change: Change
    reference: ReferencePose
    scale: NDArray

    def at(self, x: NDArray) -> Placed:
        """Return the configurations at coordinates x (B, 6)."""
        moved = x @ self.scale.T
        p, R = self.reference.p + moved[..., :3], exp_so3(moved[..., 3:]) @ self.reference.R
        return Placed(p, R, readings_at(self.structure, self.machine, p, R).rho)

    def coordinates(self, placed: Placed) -> NDArray:
        """Return the coordinates (B, 6) of poses, the inverse of `at`."""
        turned = log_so3(placed.R @ np.swapaxes(self.reference.R, -1, -2))
        return np.linalg.solve(self.scale, np.concatenate([placed.p - self.reference.p, turned], -1).T).T

    def rows(self, placed: Placed) -> NDArray:
        """Return the derivative (B, L, q) of each leg's closure equation by its own parameters."""
        closing = self.structure.close(self.machine, placed.p, placed.R, placed.rho, self.change)
        return closing.by_parameter

    def rows_and_changes(self, x: NDArray) -> tuple[NDArray, NDArray]:
        """Return the rows (B, L, q) and their exact derivative (B, L, q, 6) by the coordinates, by a complex step."""
        placed = self.at(x)
        twist, rho = self._motion(x, placed)
        turned = (np.eye(3) + 1j * _STEP * skew(np.swapaxes(twist[:, 3:], 1, 2))) @ placed.R[:, None]
        moved = Placed(
            placed.p[:, None] + 1j * _STEP * np.swapaxes(twist[:, :3], 1, 2),
            turned,
            placed.rho[:, None] + 1j * _STEP * np.swapaxes(rho, 1, 2),
        )
        rows = self.rows(moved)
        return rows[:, 0].real, np.moveaxis(rows.imag, 1, -1) / _STEP

    def quantities(self, x: NDArray) -> tuple[NDArray, NDArray]:
        """Return the limited quantities (B, 6 + L) and their derivative (B, 6 + L, 6) by the coordinates.

        First the displacement from the reference in m and rad, then the readings minus their reference in m.
        """
        placed = self.at(x)
        moved = np.concatenate([x @ self.scale.T, placed.rho - self.machine.legs.rho0], -1)
        by_pose = np.broadcast_to(self.scale, (len(x), 6, 6))
        return moved, np.concatenate([by_pose, self._motion(x, placed)[1]], 1)

    def _motion(self, x: NDArray, placed: Placed) -> tuple[NDArray, NDArray]:
        """Return the twist (B, 6, 6) of the platform and the change (B, L, 6) of the readings per coordinate."""
        turning = left_jacobian_so3(x @ self.scale[3:].T) @ self.scale[3:]
        twist = np.concatenate([np.broadcast_to(self.scale[:3], turning.shape), turning], 1)
        closing = self.structure.close(self.machine, placed.p, placed.R, placed.rho, Change({}, 0))
        return twist, -np.linalg.solve(closing.by_rho, closing.by_twist @ twist)


def leg_by_leg(machine: Machine, parameters: ParameterSet) -> Change:
    """Return one change of q columns that moves all legs at once, each by its own q parameters in their order.

    Raises ValueError for shared parameters, and for different numbers of parameters per leg.
    """
    owners = np.array([entry.leg for entry in parameters.entries])
    unknowns = [np.flatnonzero(owners == leg) for leg in range(machine.legs.count)]
    if np.any(owners < 0) or len({len(columns) for columns in unknowns}) != 1:
        raise ValueError(
            "parameters: found shared ones, or different numbers per leg; expected the same number of each"
        )
    fields = parameters.change(machine).fields
    legs = {
        name: np.stack([field[i, ..., columns] for i, columns in enumerate(unknowns)]) for name, field in fields.items()
    }
    return Change({name: np.moveaxis(field, 1, -1) for name, field in legs.items()}, len(unknowns[0]))


def pose_regressors(
    structure: Structure, machine: Machine, parameters: ParameterSet, pose_range: NDArray, reading_range: NDArray
) -> PoseRegressors:
    """Return the regressors, with coordinates scaled so that the limits are about equally far in every direction.

    pose_range (6,) m and rad, reading_range (L,) m: half ranges, infinite without limit. Raises ValueError if they
    leave the platform unbounded in some direction, for fewer than six legs, and as `leg_by_leg`.
    """
    change = leg_by_leg(machine, parameters)
    reference = reference_pose(machine.legs)
    plain = PoseRegressors(structure, machine, change, reference, np.eye(6))
    normals = plain.quantities(np.zeros((1, 6)))[1][0] / np.concatenate([pose_range, reading_range])[:, None]
    gram = normals.T @ normals
    lever = np.repeat([1.0, np.sqrt(np.mean(machine.legs.b**2) * 3)], 3)  # m per rad, to compare the eigenvalues
    values = np.linalg.eigvalsh(gram / np.outer(lever, lever))
    if not values[0] > 1e-12 * values[-1]:
        raise ValueError("pose and reading limits that bound the platform in all six directions")
    scale = np.linalg.inv(np.linalg.cholesky(gram).T)
    return PoseRegressors(structure, machine, change, reference, scale)
