"""Expensive steps of the consensus search in NumPy; `robust_kernel.py` has the compiled ones.

Separate module, since the compiled steps fall back on these, and small batches never load numba.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truing.estimation.rigid_poses.rigid import FitStatus, solve_motion

# Standard deviations by which a distance may change: one true pair in two million is lost.
PAIR_LIMIT = 5.0
ANCHORS = 4
# Least share of a point's noise in its residual, if the point alone determines the pose in some direction.
FLOOR = 1e-6


@dataclass(frozen=True)
class Clouds:
    """A batch of poses in the search: x, y (B, N, 3) in m, is_observed (B, N), sigma (B, N) in m, limit (B,) of
    chi-square."""

    x: NDArray
    y: NDArray
    is_observed: NDArray
    sigma: NDArray
    limit: NDArray

    def __getitem__(self, rows: NDArray | slice) -> Clouds:
        return Clouds(self.x[rows], self.y[rows], self.is_observed[rows], self.sigma[rows], self.limit[rows])


def statuses(clouds: Clouds) -> NDArray:
    """Return the statuses (B,) of plain fits to all points, which show defects that no selection of points can
    repair."""
    return solve_motion(clouds.x, clouds.y, clouds.is_observed / clouds.sigma**2).status


def squared_residuals(clouds: Clouds, members: NDArray) -> tuple[NDArray, NDArray]:
    """Return the squared residuals (B, N) of the fit to members, studentised and plain, in units of sigma.

    The fit's own error reduces the residual of a member and enlarges that of any other point. Studentised residuals
    correct this and compare each point with the prediction from all others. Infinite if the members leave the pose
    free.
    """
    weight = members / clouds.sigma**2
    R, t, _, status = solve_motion(clouds.x, clouds.y, weight)
    is_ok = status == FitStatus.OK
    ok = is_ok[:, None]
    R, total = np.where(ok[..., None], R, np.eye(3)), np.where(is_ok, weight.sum(-1), 1.0)
    centre = np.einsum("bn,bni->bi", weight, clouds.x) / total[:, None]
    q = clouds.x - centre[:, None]
    r = np.where(ok[..., None], clouds.y @ R - (t[:, None] @ R), 0.0) - clouds.x
    S = np.einsum("bni,bn,bnj->bij", q, weight, q)
    information = np.trace(S, axis1=1, axis2=2)[:, None, None] * np.eye(3) - S
    A = np.linalg.inv(np.where(ok[..., None], information, np.eye(3))) * ok[..., None]
    plain = np.einsum("bni,bni->bn", r, r) / clouds.sigma**2
    student = _mahalanobis(q, A, is_ok / total, r, clouds.sigma**2, np.where(members, -1.0, 1.0))
    return np.where(ok, student, np.inf), np.where(ok, plain, np.inf)


def _mahalanobis(q: NDArray, A: NDArray, first: NDArray, r: NDArray, noise: NDArray, sign: NDArray) -> NDArray:
    """Return ``r^T (noise + sign (first + [q]x A [q]x^T))^-1 r`` (B, N), by Cramer's rule on components (B, N)."""
    x, y, z = np.moveaxis(q, -1, 0)
    a, b, c, d, e, f = (A[:, i, j, None] for i, j in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)))
    covariance = noise * (1 + FLOOR) + sign * first[:, None]
    m00 = covariance + sign * (d * z * z - 2 * e * y * z + f * y * y)
    m11 = covariance + sign * (a * z * z - 2 * c * x * z + f * x * x)
    m22 = covariance + sign * (a * y * y - 2 * b * x * y + d * x * x)
    m01 = sign * (c * y * z + e * x * z - b * z * z - f * x * y)
    m02 = sign * (b * y * z + e * x * y - c * y * y - d * x * z)
    m12 = sign * (b * x * z + c * x * y - a * y * z - e * x * x)
    k00, k01, k02 = m11 * m22 - m12 * m12, m02 * m12 - m01 * m22, m01 * m12 - m02 * m11
    k11, k12, k22 = m00 * m22 - m02 * m02, m01 * m02 - m00 * m12, m00 * m11 - m01 * m01
    u, v, w = np.moveaxis(r, -1, 0)
    square = k00 * u * u + k11 * v * v + k22 * w * w + 2 * (k01 * u * v + k02 * u * w + k12 * v * w)
    return square / (m00 * k00 + m01 * k01 + m02 * k02)


def same_distances(clouds: Clouds) -> NDArray:
    """Return the graph (B, N, N) of pairs with equal distances in both clouds, 0 for other pairs.

    An edge has weight 1 plus a small amount for better agreement, so that choices do not depend on the order of points.
    """
    a, b = _squared_distances(clouds.x, clouds.is_observed), _squared_distances(clouds.y, clouds.is_observed)
    change = np.square(a - b) / np.maximum(a + b + 2 * np.sqrt(a * b), np.finfo(float).tiny)  # (root a - root b)^2
    variance = np.square(PAIR_LIMIT * clouds.sigma)
    share = (1 - change / (variance[:, :, None] + variance[:, None])).astype(np.float32)
    graph = np.where(share > 0, 1 + np.float32(0.5 / clouds.is_observed.shape[1]) * share, np.float32(0))
    graph *= clouds.is_observed[:, :, None] & clouds.is_observed[:, None]
    index = np.arange(clouds.is_observed.shape[1])
    graph[:, index, index] = 0.0
    return graph


def _squared_distances(points: NDArray, is_observed: NDArray) -> NDArray:
    """Return the squared distances (B, N, N) between points (B, N, 3), from their products about their centre."""
    centre = np.einsum("bn,bni->bi", is_observed, points) / np.maximum(is_observed.sum(-1), 1)[:, None]
    p = points - centre[:, None]
    square = np.einsum("bni,bni->bn", p, p)
    return np.maximum(square[:, :, None] + square[:, None] - 2 * (p @ np.swapaxes(p, 1, 2)), 0.0)


def grow(graph: NDArray, seed: NDArray, taken: NDArray) -> NDArray:
    """Return sets (B, N): anchors, beginning with the seed (B,), and every point connected to all of them.

    Points taken (B, N) by the best set so far come last, since another motion shares at most two of them.
    """
    rows = np.arange(len(seed))
    anchors = np.zeros(graph.shape[:2], bool)
    anchors[rows, seed] = True
    joined, worth = graph[rows, seed] > 0, np.where(taken, 1 / (2 * graph.shape[1]), 1.0)
    for _ in range(ANCHORS - 1):
        votes = (1 + (graph @ joined[..., None].astype(graph.dtype))[..., 0]) * joined * worth
        pick, some = votes.argmax(-1), joined.any(-1)
        anchors[rows, pick] |= some
        joined &= (graph[rows, pick] > 0) | ~some[:, None]
    return anchors | joined
