"""Test whether residuals of a sum of responses to single load axes follow loads along several axes at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from truing.arrays import Array, Index, Mask

_MOST_ROWS = 400  # as many as whole runs hold, of the first ones
_DRAWS = 4000
_FEWEST_FREE = 4
_ZERO = 1e-10
_DEGREES = (2, 3)


def is_combined(load: Array) -> Mask:
    """Return True for rows (N,) that load several axes at once, from loads (N, 6)."""
    return np.asarray(np.count_nonzero(load, axis=1) > 1)


@dataclass(frozen=True)
class ShareOfProducts:
    """Share of residuals along products of loads, and the shares (D,) that normal noise would have by chance."""

    found: float
    by_chance: Array


def p_of_products(shares: Sequence[ShareOfProducts]) -> float:
    """Return the p-value of the residuals of some channels together, if they are noise; NaN for none."""
    if not shares:
        return float("nan")
    found, by_chance = sum(one.found for one in shares), sum(one.by_chance for one in shares)
    return float((1 + np.count_nonzero(by_chance >= found)) / (1 + _DRAWS))


def share_of_products(
    standardized: Array, removed: Array, load: Array, run: Index, seed: int = 0
) -> ShareOfProducts | None:
    """Return the part of a channel's residuals that follows products of loads; None where too few rows are free.

    Variance-component score test against normal noise that lost the same columns. The products are of degree two and
    three, of loads along two axes or more. ``standardized`` (N,): residuals over their noise, of any common
    scale; ``removed`` (N, P): columns that were fitted, over the noise; ``load`` (N, 6), ``run`` (N,) in ascending
    order; ``seed`` of the draws by chance.
    """
    rows = _first_runs(run)
    residual, lost, load = standardized[rows], removed[rows], load[rows]
    left = np.linalg.svd(lost, full_matrices=False)
    basis = left[0][:, left[1] > _ZERO * left[1].max(initial=0.0)]
    if len(residual) - basis.shape[1] < _FEWEST_FREE:
        return None
    residual = residual - basis @ (basis.T @ residual)
    largest = np.abs(load).max(axis=0, initial=0.0)
    share = load[:, largest > 0.0] / largest[largest > 0.0]
    kernel = np.zeros((len(residual), len(residual)))
    for degree in _DEGREES:
        likeness = (share @ share.T) ** degree - (share**degree) @ (share**degree).T
        likeness = likeness - basis @ (basis.T @ likeness)
        likeness = likeness - (likeness @ basis) @ basis.T
        kernel += likeness / max(float(np.trace(likeness)), np.finfo(float).tiny)
    square = float(residual @ residual)
    if square <= 0.0:
        return None
    found = float(residual @ kernel @ residual) / square
    # The residuals lie in the complement of what was removed; the kernel has its other eigenvalues there.
    free = len(residual) - basis.shape[1]
    values = np.sort(np.linalg.eigvalsh(kernel))[::-1][:free]
    noise = np.random.default_rng(seed).chisquare(1.0, (_DRAWS, free))
    return ShareOfProducts(found, (noise @ values) / noise.sum(axis=1))


def _first_runs(run: Index) -> Index:
    """Return the rows of the first whole runs, at most 400; the first rows where one run holds more."""
    ends = np.append(np.flatnonzero(np.diff(run)) + 1, len(run))
    within = ends[ends <= _MOST_ROWS]
    return np.arange(within[-1] if len(within) else min(len(run), _MOST_ROWS))
