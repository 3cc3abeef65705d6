"""A platform on elastic legs: stiffness, compliance, and leg forces (force-sensor paper, eq. 24-28).

The platform is rigid. Wrenches and displacements are at its origin in axes of the fixed frame; the compliance is that
of the unloaded geometry.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truing.estimation.rotation import skew
from truing.simulation.bench.six_upur.elements import LegElement, LegParts, leg_parts
from truing.simulation.bench.six_upur.geometry import JointCentres, leg_axes

# An eigenvalue of a leg's compliance below this share of the largest is rounding.
_RIGID = 1e-13


@dataclass(frozen=True)
class ElasticSensor:
    """A sensor on elastic legs.

    leg_transport: J_F (..., 6, 6, 6), wrench at the origin by the wrench at a leg's end in the leg's axes (eq. 25);
    leg_stiffness: J_F K J_F' (..., 6, 6, 6); compliance (..., 6, 6), SI.
    """

    joints: JointCentres
    parts: LegParts
    leg_transport: NDArray
    leg_stiffness: NDArray
    compliance: NDArray

    def displacement(self, wrench: NDArray) -> NDArray:
        """Return displacements (..., 6), m and rad, under wrenches (..., 6) (eq. 28)."""
        return np.einsum("...ij,...j->...i", self.compliance, wrench)

    @property
    def leg_wrenches(self) -> NDArray:
        """Wrench of each leg (..., 6, 6, 6), at the origin, by the wrench on the platform; their sum is 1."""
        return self.leg_stiffness @ self.compliance[..., None, :, :]

    @property
    def axial_forces(self) -> NDArray:
        """Forces (..., 6, 6) along the legs, tension positive, by the wrench on the platform.

        For joints without stiffness this is 1 / G.
        """
        return np.einsum("...li,...lij->...lj", self.joints.direction, self.leg_wrenches[..., :3, :])


def elastic_sensor(joints: JointCentres, elements: Sequence[LegElement]) -> ElasticSensor:
    """Return a sensor whose six legs are made of the same elements.

    Raises ValueError if elements do not fit the legs, or leave them rigid in some direction.
    """
    parts = leg_parts(elements, joints.length)
    J_F = end_transport(joints.arm, leg_axes(joints.direction))
    leg_stiffness = J_F @ np.linalg.inv(_leg_compliance(parts, joints)) @ np.swapaxes(J_F, -1, -2)
    return ElasticSensor(joints, parts, J_F, leg_stiffness, np.linalg.inv(leg_stiffness.sum(-3)))


def end_transport(arm: NDArray, axes: NDArray) -> NDArray:
    """Return J_F (..., 6, 6) of legs that end at arm (..., 3), m from the origin, with axes (..., 3, 3) (eq. 25).

    Its transpose converts the platform's displacement to that of the leg's end (eq. 24 as corrected; printed as its
    inverse).
    """
    upper = np.concatenate([axes, np.zeros_like(axes)], -1)
    return np.concatenate([upper, np.concatenate([skew(arm) @ axes, axes], -1)], -2)


def _leg_compliance(parts: LegParts, joints: JointCentres) -> NDArray:
    """Return the legs' compliance (..., 6, 6, 6), which must be positive definite for its inverse to exist."""
    compliance = parts.compliance.sum(-3)
    lever = np.ones((*joints.length.shape, 6))
    lever[..., 3:] = joints.length[..., None].real
    scaled = lever[..., None] * compliance.real * lever[..., None, :]
    values = np.linalg.eigvalsh(scaled)
    if np.any(values[..., 0] <= _RIGID * values[..., -1]):
        raise ValueError(
            f"elements: found a direction in which a leg of {', '.join(parts.names)} is rigid, "
            "expected elements that together give along and about all three axes"
        )
    return compliance
