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
from scipy.linalg.blas import dsyrk
from scipy.linalg.lapack import dpotrf, dpotrs

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
    """A pose's equations: independent blocks (b, d, d) to eliminate and their rows (b d, w) by what is kept, the common
    unknowns and the right side, w = k + c + 1; the whole (w, w) of these three, of which the upper triangle is filled;
    places (b d,) and (k,) of both within the pose's unknowns, images before points; freedoms (k, f), and rows (q, k) of
    distances."""

    own: Array
    own_rows: Array
    whole: Array
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
        kept, own = np.arange(m, m + n), np.arange(m)
        whole = np.zeros((rows.shape[1],) * 2)
        _put_diagonal(whole, 0, points)
        whole[:n, n:] = of_points
        return Blocks(images, rows, whole, own, kept, freedoms[kept], tied_rows[:, kept])
    ends = np.zeros(len(points), bool)
    ends[ties.first] = ends[ties.second] = True
    tied, loose = np.repeat(ends, 3), np.repeat(~ends, 3)
    kept, own = np.concatenate([np.arange(m), m + np.flatnonzero(tied)]), m + np.flatnonzero(loose)
    k = len(kept)
    whole = np.zeros((k + of_points.shape[1],) * 2)
    _put_diagonal(whole, 0, images)
    _put_diagonal(whole, m, points[ends])
    whole[:m, m:k] = rows[:, :n][:, tied]
    whole[:m, k:], whole[m:k, k:] = rows[:, n:], of_points[tied]
    beside = np.zeros((len(own), len(whole)))
    beside[:, :m] = rows[:, :n][:, loose].T
    beside[:, k:] = of_points[loose]
    return Blocks(points[~ends], beside, whole, own, kept, freedoms[kept], tied_rows[:, kept])


def _rows(ties: Ties, m: int, n: int) -> Array:
    """Return distances (q, m + n) by the unknowns of the pose."""
    rows = np.zeros((len(ties.first), m + n))
    each = np.arange(len(ties.first))[:, None]
    rows[each, m + 3 * ties.second[:, None] + np.arange(3)] += ties.by_point
    rows[each, m + 3 * ties.first[:, None] + np.arange(3)] -= ties.by_point
    return rows


def _put_diagonal(whole: Array, start: int, blocks: Array) -> None:
    """Put blocks (b, d, d) along the diagonal from start."""
    b, d, _ = blocks.shape
    places = start + np.arange(b * d).reshape(b, d)
    whole[places[:, :, None], places[:, None, :]] = blocks


class EliminatedPose:
    """A pose's unknowns as a function of the common ones: x = x0 - x1 c, and what is left for these."""

    def __init__(self, blocks: Blocks, ties: Ties, damping: float) -> None:
        """Eliminate, in place of the blocks' whole; damping adds this part of the diagonal.

        Raises LinAlgError where a block has free directions.
        """
        from truing.estimation.bundle.accumulation_kernel import forward

        self.blocks = blocks
        k, whole = len(blocks.kept_places), blocks.whole
        self.kept_diagonal = np.diagonal(whole)[:k].copy()
        self.root, self.reduced = np.empty_like(blocks.own), np.empty_like(blocks.own_rows)
        if not forward(blocks.own, blocks.own_rows, damping, self.root, self.reduced):
            raise np.linalg.LinAlgError("a block that is not positive definite")
        whole[np.arange(k), np.arange(k)] *= 1 + damping
        _add_products(whole, self.reduced, -1.0)
        tie_rows = np.concatenate([blocks.rows, ties.by_common, ties.misclosure[:, None]], -1)
        _add_products(whole, np.concatenate([tie_rows * np.sqrt(ties.weight)[:, None], _held(blocks, whole)]), 1.0)
        # Column by column, as LAPACK has it, the upper triangle is the lower one.
        factor, fault = dpotrf(whole[:k, :k].T, lower=1)
        if fault:
            raise np.linalg.LinAlgError("what is kept is not positive definite")
        self.factor = factor
        tie_rows = tie_rows[np.isfinite(ties.variance)]
        solved = dpotrs(factor, np.concatenate([whole[:k, k:], tie_rows[:, :k].T], -1), lower=1)[0]
        width = len(whole) - k
        self.by_rows = solved[:, width:]
        self.pinned = np.diag(ties.variance[np.isfinite(ties.variance)]) + tie_rows[:, :k] @ self.by_rows
        multipliers = np.linalg.solve(self.pinned, tie_rows[:, :k] @ solved[:, :width] - tie_rows[:, k:])
        self.kept = solved[:, :width] - self.by_rows @ multipliers
        self.multipliers = np.zeros((len(ties.variance), width))
        self.multipliers[np.isfinite(ties.variance)] = multipliers
        left = whole[k:-1, k:]
        left[:, :-1] = np.triu(left[:, :-1]) + np.triu(left[:, :-1], 1).T
        self.common = left - whole[:k, k:-1].T @ self.kept - tie_rows[:, k:-1].T @ multipliers

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


def _add_products(whole: Array, rows: Array, factor: float) -> None:
    """Add the products (w, w) of rows (r, w), times a factor, to the upper triangle."""
    if len(rows):
        dsyrk(factor, rows.T, 1.0, whole.T, lower=1, overwrite_c=1)


def _held(blocks: Blocks, whole: Array) -> Array:
    """Return rows (f, w) that tie down the freedoms, as firmly as what is kept is held on average."""
    k, f = blocks.freedoms.shape
    rows = np.zeros((f, len(whole)))
    norm = np.linalg.norm(blocks.freedoms, axis=0)
    rows[:, :k] = np.sqrt(np.trace(whole[:k, :k]) / max(k, 1)) * (blocks.freedoms / norm).T
    return rows
