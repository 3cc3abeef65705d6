"""Position and direction of the straight line closest to points, for a body known only as long and thin.

First algorithm of section 3.1 of the telescope report. A total-least-squares line passes through the barycentre, so
"the direction of the projection of the barycentre on the line" is a zero vector. A line has no roll, so no roll is
given.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from truing.estimation.covariance import symmetric
from truing.estimation.rigid_poses.rigid import FitStatus, check_correspondences, mask_entries, weighted_centroid

_ROUNDING = 1e-12


@dataclass(frozen=True)
class LineFit:
    """A batch of B lines; numbers are NaN if the status is not OK."""

    position: NDArray  # (B, 3) m, barycentre of the points, which lies on the line
    direction: NDArray  # (B, 3) unit vector
    covariance: NDArray  # (B, 6, 6) of (position, small rotation of the direction, zero about it); m and rad
    rms: NDArray  # (B,) m, root of the mean squared distance from the line
    n_used: NDArray  # (B,)
    status: NDArray  # (B,) of FitStatus values

    @property
    def ok(self) -> NDArray:
        """Mask (B,) of entries with numbers."""
        return self.status == FitStatus.OK


def fit_line(points: ArrayLike, along: ArrayLike, weight: ArrayLike | None = None, *, sigma: float) -> LineFit:
    """Return the lines that minimise the sum of squared distances to points (B, N, 3) or (N, 3), in m.

    along (3,) or (B, 3): selects the sense of the direction; weight: (B, N), 0 for a missing point; sigma: standard
    deviation per coordinate in m. Two points determine a line. Status COINCIDENT if the points have no direction,
    AMBIGUOUS if they have more than one. Raises ValueError as `umeyama`.
    """
    y, _, w = check_correspondences(points, points, weight)
    total = np.maximum(w.sum(-1), np.finfo(float).tiny)
    centre = weighted_centroid(y, w, total)
    p = y - centre[:, None]
    spread, axes = np.linalg.eigh(np.einsum("bn,bni,bnj->bij", w, p, p))
    direction = axes[..., 2]
    direction = direction * np.where(np.sum(direction * np.asarray(along), axis=-1) < 0, -1.0, 1.0)[:, None]
    used = np.count_nonzero(w, axis=-1)
    status = _status(used, spread, np.einsum("bn,bni,bni->b", w, y, y))
    ok = status == FitStatus.OK
    covariance = _covariance(p, w, total, axes, spread, ok, sigma)
    off = p - np.einsum("bni,bi->bn", p, direction)[..., None] * direction[:, None]
    rms = np.sqrt(np.einsum("bn,bni,bni->b", w, off, off) / total)
    numbers = [mask_entries(a, ok) for a in (centre, direction, covariance, rms)]
    return LineFit(numbers[0], numbers[1], numbers[2], numbers[3], used, status)


def _status(used: NDArray, spread: NDArray, size: NDArray) -> NDArray:
    conditions = [
        used < 2,
        spread[:, 2] <= _ROUNDING**2 * size,
        spread[:, 2] - spread[:, 1] <= _ROUNDING * spread[:, 2],
    ]
    choices = [FitStatus.TOO_FEW_POINTS, FitStatus.COINCIDENT, FitStatus.AMBIGUOUS]
    return np.select(conditions, [str(c) for c in choices], str(FitStatus.OK))


def _covariance(
    p: NDArray, w: NDArray, total: NDArray, axes: NDArray, spread: NDArray, ok: NDArray, sigma: float
) -> NDArray:
    """Return the covariance (B, 6, 6) by first-order perturbation of the mean and of the scatter's leading eigenvector.
    An error e of one point turns the axis z towards a transverse axis a. The angle is ``w (p_z e_a + p_a e_z) / (l_z -
    l_a)``. The rotation vector is ``z x a`` times that."""
    z = axes[..., 2]
    C = np.zeros((len(p), 6, 6))
    along = np.einsum("bni,bi->bn", p, z)
    J = np.zeros((*p.shape, 3))
    for k in (0, 1):
        a = axes[..., k]
        gap = np.where(ok, spread[:, 2] - spread[:, k], 1.0)
        towards = along[..., None] * a[:, None] + np.einsum("bni,bi->bn", p, a)[..., None] * z[:, None]
        J += np.cross(z, a)[:, None, :, None] * (w / gap[:, None])[..., None, None] * towards[..., None, :]
    share = w / total[:, None]
    C[:, :3, :3] = np.sum(share**2, -1)[:, None, None] * np.eye(3)
    C[:, 3:, 3:] = np.einsum("bnij,bnkj->bik", J, J)
    C[:, 3:, :3] = np.einsum("bnij,bn->bij", J, share)
    C[:, :3, 3:] = np.swapaxes(C[:, 3:, :3], -1, -2)
    return sigma**2 * symmetric(C)
