"""Normal equations of one pose, solved by elimination of its images or its points, whichever leaves less.

The blocks of what is eliminated are small and independent of each other; what is kept is dense, with a Cholesky
decomposition. Ends of bars are always kept, since bars tie points to each other. A distance d with variance s^2 enters
with the smaller of its own information and a weight r that suits the points; what is left of its information, a
variance t = 1 / (1 / s^2 - r), by a multiplier k:

    (N + r a a^T) x + a k = n + r a w,    a^T x - t k = w,

the same equations as of the whole information, sound down to s = 0, where the distance is a constraint. Freedoms of
the datum are tied down by a term in their own directions, which changes nothing else.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from truing.estimation.bundle.datum import Freedom
from truing.estimation.bundle.layout import Layout
from truing.estimation.bundle.network import Array, Index
from truing.estimation.bundle.normal_equations import NormalEquations


@dataclass(frozen=True)
class Ties:
    """Distances of a pose as rows: points first and second (q,) within the pose, by_point (q, 3) of the second,
    by_common (q, c), misclosure w (q,) in m, weight r (q,) in m^-2, and the variance t (q,) in m^2 that is left to
    multipliers, infinite where none is needed."""

    first: Index
    second: Index
    by_point: Array
    by_common: Array
    misclosure: Array
    weight: Array
    variance: Array


@dataclass(frozen=True)
class Blocks:
    """A pose's equations: independent blocks (b, d, d) to eliminate and their rows (b d, k + c + 1) by what is kept,
    the common unknowns and the right side; what is kept (k, k), with its border (k, c + 1) by the same; places (b d,)
    and (k,) of both within the pose's unknowns, images before points; freedoms (k, f), rows (q, k) of distances."""

    own: Array
    own_rows: Array
    kept: Array
    kept_border: Array
    own_places: Index
    kept_places: Index
    freedoms: Array
    rows: Array


def blocks_of(equations: NormalEquations, layout: Layout, pose: int, free: Freedom, ties: Ties) -> Blocks:
    """Return the equations of a pose, in the order of what is eliminated and what is kept."""
    i = slice(layout.image_start[pose], layout.image_start[pose + 1])
    p = slice(layout.point_start[pose], layout.point_start[pose + 1])
    images, points, rows = equations.images[i], equations.points[p], equations.image_rows[pose]
    m, n = len(rows), 3 * len(points)
    of_points = equations.point_rows[p].reshape(n, -1)
    freedoms = np.concatenate([free.images.reshape(m, free.count), free.points.reshape(n, free.count)])
    tied_rows = _rows(ties, m, n)
    if n <= m:
        kept = np.arange(m, m + n)
        own = np.arange(m)
        return Blocks(images, rows, _diagonal(points), of_points, own, kept, freedoms[kept], tied_rows[:, kept])
    ends = np.zeros(len(points), bool)
    ends[ties.first] = ends[ties.second] = True
    tied, loose = np.repeat(ends, 3), np.repeat(~ends, 3)
    kept = np.concatenate([np.arange(m), m + np.flatnonzero(tied)])
    dense = np.zeros((len(kept), len(kept)))
    dense[:m, :m] = _diagonal(images)
    dense[m:, m:] = _diagonal(points[ends])
    dense[:m, m:] = rows[:, :n][:, tied]
    dense[m:, :m] = rows[:, :n][:, tied].T
    beside = np.zeros((int(loose.sum()), len(kept) + of_points.shape[1]))
    beside[:, :m] = rows[:, :n][:, loose].T
    beside[:, len(kept) :] = of_points[loose]
    border = np.concatenate([rows[:, n:], of_points[tied]])
    own = m + np.flatnonzero(loose)
    return Blocks(points[~ends], beside, dense, border, own, kept, freedoms[kept], tied_rows[:, kept])


def _rows(ties: Ties, m: int, n: int) -> Array:
    """Return distances (q, m + n) by the unknowns of the pose."""
    rows = np.zeros((len(ties.first), m + n))
    each = np.arange(len(ties.first))[:, None]
    rows[each, m + 3 * ties.second[:, None] + np.arange(3)] += ties.by_point
    rows[each, m + 3 * ties.first[:, None] + np.arange(3)] -= ties.by_point
    return rows


def _diagonal(blocks: Array) -> Array:
    """Return blocks (b, d, d) as one matrix (b d, b d)."""
    b, d, _ = blocks.shape
    dense = np.zeros((b, d, b, d))
    dense[np.arange(b), :, np.arange(b), :] = blocks
    return dense.reshape(b * d, b * d)


class EliminatedPose:
    """A pose's unknowns as a function of the common ones: x = x0 - x1 c, and what is left for these."""

    def __init__(self, blocks: Blocks, ties: Ties, damping: float) -> None:
        """Eliminate; damping adds this part of the diagonal. Raises LinAlgError where a block has free directions."""
        self.blocks = blocks
        from truing.estimation.bundle.accumulation_kernel import forward

        k = len(blocks.kept)
        self.root, self.reduced = np.empty_like(blocks.own), np.empty_like(blocks.own_rows)
        if not forward(blocks.own, blocks.own_rows, damping, self.root, self.reduced):
            raise np.linalg.LinAlgError("a block that is not positive definite")
        product = self.reduced.T @ self.reduced
        weighted = blocks.rows.T * ties.weight
        kept = _damped(blocks.kept, damping) - product[:k, :k] + weighted @ blocks.rows
        tie_border = np.concatenate([ties.by_common, ties.misclosure[:, None]], -1)
        border = blocks.kept_border - product[:k, k:] + weighted @ tie_border
        basis = np.linalg.qr(blocks.freedoms)[0]
        kept += np.trace(kept) / max(k, 1) * basis @ basis.T
        self.factor = cho_factor(kept, lower=True, check_finite=False)
        needed = np.isfinite(ties.variance)
        rows, side = blocks.rows[needed], tie_border[needed]
        solved = cho_solve(self.factor, np.concatenate([border, rows.T], -1), check_finite=False)
        self.by_rows = solved[:, border.shape[1] :]
        self.pinned = np.diag(ties.variance[needed]) + rows @ self.by_rows
        multipliers = np.linalg.solve(self.pinned, rows @ solved[:, : border.shape[1]] - side)
        self.kept = solved[:, : border.shape[1]] - self.by_rows @ multipliers
        self.multipliers = np.zeros((len(needed), border.shape[1]))
        self.multipliers[needed] = multipliers
        self.common = _left_for_common(product[k:, k:], ties, tie_border, border, self.kept, side, multipliers)

    def back(self, common: Array) -> tuple[Array, Array]:
        """Return the changes of the pose's unknowns, images before points, and the multipliers (q,)."""
        step = np.append(-common, 1.0)
        kept = self.kept @ step
        k = len(kept)
        b, d, _ = self.blocks.own.shape
        own = (self.reduced[:, k:] @ step - self.reduced[:, :k] @ kept).reshape(b, d)
        x = np.empty(len(self.blocks.own_places) + k)
        x[self.blocks.kept_places] = kept
        x[self.blocks.own_places] = np.einsum("bji,bj->bi", self.root, own).ravel()
        return x, self.multipliers @ step


def _left_for_common(
    product: Array, ties: Ties, tie_border: Array, border: Array, kept: Array, side: Array, multipliers: Array
) -> Array:
    """Return what the pose adds to the equations (c, c + 1) of the common unknowns."""
    c = ties.by_common.shape[1]
    own = (ties.by_common.T * ties.weight) @ tie_border - product[:c]
    return own - border[:, :c].T @ kept - side[:, :c].T @ multipliers


def _damped(matrix: Array, damping: float) -> Array:
    """Return matrices with their diagonal enlarged by a part of it."""
    damped = matrix.copy()
    each = np.arange(matrix.shape[-1])
    damped[..., each, each] *= 1 + damping
    return damped
