"""Positions of a target on its body over a campaign: one position, or several one after the other."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from truing.estimation.rotation import rigid_motions

# Number of successive points that agree, for a position of the target.
RUN = 3
# Two points of one position are closer than this many times the spread of a coordinate.
_SAME = 8.0
# A change of position by this many spreads is certain.
_CERTAIN = 40.0
_MEDIAN_LENGTH = 1.538  # of three unit normals


def median_places(positions: NDArray, known: NDArray) -> NDArray:
    """Return the medians (K, 3) of positions (B, K, 3), m, over known ones (B, K); NaN without any."""
    ever = np.asarray(known.any(0))
    values = np.where(known[..., None], positions, np.nan)
    values[:, ~ever] = 0.0
    return np.where(ever[:, None], np.nanmedian(values, 0), np.nan)


def looseness(shape: NDArray, trusted: NDArray) -> NDArray:
    """Return the uncertainty of each point's (B, K) position on its body relative to that of its coordinates.

    The pose of the body follows from its trusted points (B, K), whose positions are shape (K, 3), m; 1 for these
    themselves.
    """
    middle = shape.mean(0)
    radius = max(float(np.sqrt(np.mean(np.sum((shape - middle) ** 2, -1)))), 1e-300)
    moves = rigid_motions((shape - middle) / radius)
    normal = np.einsum("bk,kip,kiq->bpq", trusted.astype(float), moves, moves)
    variance = np.einsum("kip,bpq,kiq->bk", moves, np.linalg.pinv(normal, rcond=1e-12, hermitian=True), moves) / 3
    return np.where(trusted, 1.0, np.sqrt(1.0 + variance))


def isolated_points(
    positions: NDArray, known: NDArray, order: NDArray, sigma: float, loose: NDArray | float = 1.0
) -> NDArray:
    """Return the mask (B, K) of known points that are in no three successive, agreeing points in time.

    positions (B, K, 3) in the body's frame, m; order (B,) in time; sigma: declared, m, per coordinate; loose (B, K):
    relative uncertainty of a position. The tolerance is the same for all targets, so that a target that moves in every
    pose agrees nowhere.
    """
    limits = _SAME * spread_in_time(positions, known, order, sigma) * np.broadcast_to(loose, known.shape)
    lonely = known.copy()
    for target, rows in _in_time(known, order):
        agree = _runs(positions[rows, target], limits[rows, target])
        for step in range(RUN):
            lonely[rows[step : step + len(agree)][agree], target] = False
    return lonely


def position_changes(
    positions: NDArray, known: NDArray, order: NDArray, sigma: float, loose: NDArray | float = 1.0
) -> list[tuple[int, int]]:
    """Return (pose, target) from which on a target certainly has another position: three points agree on either
    side."""
    spreads = spread_in_time(positions, known, order, sigma) * np.broadcast_to(loose, known.shape)
    result = []
    for target, rows in _in_time(known, order):
        values, spread = positions[rows, target], spreads[rows, target]
        agree = _runs(values, _SAME * spread)
        far = np.linalg.norm(np.diff(values, axis=0), axis=-1) > _CERTAIN * np.maximum(spread[1:], spread[:-1])
        first = np.arange(RUN, len(rows) - RUN + 1)
        changed = first[far[first - 1] & agree[first - RUN] & agree[first]] if len(first) else first
        result += [(int(rows[at]), target) for at in changed]
    return result


def displaced_points(
    positions: NDArray,
    known: NDArray,
    order: NDArray,
    sigma: float,
    changes: list[tuple[int, int]],
    loose: NDArray | float = 1.0,
) -> NDArray:
    """Return the mask (B, K) of known points certainly away from their target's position at the time, given the
    changes."""
    limits = _CERTAIN * spread_in_time(positions, known, order, sigma) * np.broadcast_to(loose, known.shape)
    stray = np.zeros_like(known)
    for target, rows in _in_time(known, order):
        firsts = sorted(order[pose] for pose, changed in changes if changed == target)
        piece = np.searchsorted(firsts, order[rows], side="right")
        for piece_number in np.unique(piece):
            rows_of_piece = rows[piece == piece_number]
            off = np.linalg.norm(
                positions[rows_of_piece, target] - np.median(positions[rows_of_piece, target], axis=0), axis=-1
            )
            stray[rows_of_piece, target] = off > limits[rows_of_piece, target]
    return stray


def spread_in_time(positions: NDArray, known: NDArray, order: NDArray, sigma: float) -> float:
    """Return the spread of a coordinate, m, from distances of successive points, at least the declared one."""
    steps = [np.diff(positions[rows, target], axis=0) for target, rows in _in_time(known, order) if len(rows) > 1]
    if not steps:
        return sigma
    return max(sigma, float(np.median(np.linalg.norm(np.concatenate(steps), axis=-1))) / _MEDIAN_LENGTH / np.sqrt(2.0))


def _in_time(known: NDArray, order: NDArray) -> Iterator[tuple[int, NDArray]]:
    """Yield each target with the poses that know its position, in the order of time."""
    in_time = np.argsort(order, kind="stable")
    for target in range(known.shape[1]):
        yield target, in_time[known[in_time, target]]


def _runs(values: NDArray, limits: NDArray) -> NDArray:
    """Return the indices among n values (n, 3) at which three agree to within their limits (n,), (n - 2,)."""
    if len(values) < RUN:
        return np.zeros(0, bool)
    near = np.linalg.norm(np.diff(values, axis=0), axis=-1) <= np.maximum(limits[1:], limits[:-1])
    ends = np.linalg.norm(values[2:] - values[:-2], axis=-1) <= np.maximum(limits[2:], limits[:-2])
    return np.asarray(near[:-1] & near[1:] & ends)
