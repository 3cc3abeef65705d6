"""Joint centres of a 6-UPUR sensor, and the axes of its legs (force-sensor paper, eq. 11)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truing.schemas.faults import Unfit

_UP = np.array([0.0, 0.0, 1.0])
# A leg that leans less than this has no horizontal normal of its own, rad.
_VERTICAL = 1e-9


@dataclass(frozen=True)
class JointCentres:
    """Joint centres of six legs, m, all in axes of the fixed frame.

    lower: B (..., 6, 3) from the fixed frame's origin; arm: from the platform's origin to the upper joints b
    (..., 6, 3); origin: of the platform (..., 3), in the fixed frame.
    """

    lower: NDArray
    arm: NDArray
    origin: NDArray

    @property
    def leg(self) -> NDArray:
        """Legs b - B (..., 6, 3), m."""
        return self.origin[..., None, :] + self.arm - self.lower

    @property
    def length(self) -> NDArray:
        """Lengths (..., 6) of the legs, m."""
        return _length(self.leg)

    @property
    def direction(self) -> NDArray:
        """Unit vectors S (..., 6, 3) of the legs, from the base to the platform."""
        return self.leg / self.length[..., None]

    def displaced(self, shift: NDArray, R: NDArray) -> JointCentres:
        """Return the joints with the platform moved by shift (..., 3), m, and turned by R (..., 3, 3) about its origin.

        Not eq. 31 as printed, which turns the platform about the origin of the base.
        """
        return JointCentres(self.lower, self.arm @ np.swapaxes(R, -1, -2), self.origin + shift)


def joint_centres(lower: NDArray, upper: NDArray, height: float) -> JointCentres:
    """Return the unloaded sensor: B (6, 3) in the fixed frame, b (6, 3) in the platform's, which is parallel, m.

    Raises ValueError for other shapes and for joints of one leg that coincide.
    """
    lower, upper = np.asarray(lower, float), np.asarray(upper, float)
    if lower.shape != (6, 3) or upper.shape != (6, 3):
        raise Unfit("joint centres", f"shapes {lower.shape} and {upper.shape}", "shape (6, 3) of both")
    centres = JointCentres(lower, upper, height * _UP)
    if np.any(centres.length == 0.0):
        raise Unfit("legs", f"lengths {centres.length.tolist()} m", "joints B and b at different points")
    return centres


def outward(points: NDArray) -> NDArray:
    """Return the horizontal unit vectors (..., 3) from the z axis to points (..., 3); along x for a point on it."""
    flat = points * (1.0 - _UP)
    size = _length(flat)[..., None]
    on_axis = size.real == 0.0
    return np.where(on_axis, np.eye(3)[0], flat / np.where(on_axis, 1.0, size))


def leg_axes(direction: NDArray) -> NDArray:
    """Return the axes (..., 3, 3), columns x, y, z, of legs along z: x = s1 is horizontal, y = z cross x = -s2.

    direction: unit vectors (..., 3). s1 and s2 are the axes of the paper's universal joints (eq. 11). For a vertical
    leg, s1 is the fixed frame's x.
    """
    across = np.cross(_UP, direction)
    size = _length(across)[..., None]
    upright = size.real < _VERTICAL
    # Orthogonal to the leg to first order as well, so that complex steps give the derivatives of the axes.
    aside = np.eye(3)[0] - direction * direction[..., :1]
    x = np.where(upright, aside, across / np.where(upright, 1.0, size))
    return np.stack([x, np.cross(direction, x), direction], -1)


def _length(vectors: NDArray) -> NDArray:
    """Return lengths (...) of vectors (..., 3), real or complex."""
    return np.sqrt(np.sum(vectors * vectors, -1))
