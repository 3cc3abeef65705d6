"""Exchanged labels: pairs of points of a body in one pose that fit once their labels are swapped."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from truing.estimation.rigid_poses.umeyama import umeyama

# A point is at another target's place if its distance is less than this share of that between the two places.
_SHARE = 0.1
# It is also within this many sigma: among many points that are metres off, some come near another place by chance.
_NEAR = 40.0
# Residuals below this many sigma are no reason to search for an exchange.
_LARGE_RESIDUAL = 12.0
# A body of few targets has no consensus after an exchange: every exchange is tried, and must beat all others.
_FEW, _FEWEST = 6, 3
_BETTER_THAN_OTHERS = 5.0


@dataclass(frozen=True)
class Exchange:
    """Two targets of a body, by index, with exchanged labels in a pose, by index."""

    pose: int
    first: int
    second: int


def exchanges(residual: NDArray, points: NDArray, is_observed: NDArray, shape: NDArray, sigma: float) -> list[Exchange]:
    """Return the exchanges among a body's targets.

    residual (B, T, 3): measured minus surveyed places along the body's axes, m, from a robust fit; NaN if missing.
    points (B, T, 3) as measured, is_observed (B, T), shape (T, 3) the survey, sigma of a point, m.
    """
    exchanged = [] if len(shape) < _FEWEST else _exchanged_pairs(residual, is_observed, shape, sigma)
    count = is_observed.sum(1)
    rows = np.flatnonzero((count >= _FEWEST) & (count <= _FEW))
    fit = umeyama(shape, points[rows], is_observed[rows].astype(float))
    bad = rows[~fit.ok | (np.nan_to_num(fit.rms) > _LARGE_RESIDUAL * sigma)]
    for pose in bad[~np.isin(bad, [exchange.pose for exchange in exchanged])]:
        exchange = _best_of_few(points[pose], is_observed[pose], shape, sigma, int(pose))
        exchanged += [] if exchange is None else [exchange]
    return exchanged


def residuals_after_exchange(
    residual: NDArray, points: NDArray, is_observed: NDArray, shape: NDArray, found: list[Exchange]
) -> tuple[NDArray, NDArray]:
    """Return the residuals (B, T, 3) after correcting exchanged labels, and the mask (B,) of poses fitted anew.

    A body of few targets is fitted anew, since its first fit could not be right. Arguments as in `exchanges`.
    """
    corrected, is_refitted = residual.copy(), np.zeros(len(residual), bool)
    for exchange in found:
        pair, exchanged = [exchange.first, exchange.second], [exchange.second, exchange.first]
        corrected[exchange.pose, pair] = residual[exchange.pose, exchanged] + shape[exchanged] - shape[pair]
        if is_observed[exchange.pose].sum() <= _FEW:
            observed = points[exchange.pose].copy()
            observed[pair] = points[exchange.pose, exchanged]
            corrected[exchange.pose] = np.where(
                is_observed[exchange.pose][:, None],
                _survey_deviation(observed, is_observed[exchange.pose], shape),
                np.nan,
            )
            is_refitted[exchange.pose] = True
    return corrected, is_refitted


def _survey_deviation(points: NDArray, is_observed: NDArray, shape: NDArray) -> NDArray:
    """Return a pose's points (T, 3) minus the survey, along the body's axes; from a fit without one of the points if
    that agrees far better than any other."""
    weights = np.repeat(is_observed[None].astype(float), len(shape) + 1, 0)
    weights[np.arange(len(shape)), np.arange(len(shape))] = 0.0
    tried = np.flatnonzero((weights.sum(1) >= _FEWEST) & np.r_[is_observed, True])
    fit = umeyama(shape, np.repeat(points[None], len(tried), 0), weights[tried])
    rms = np.where(fit.ok, np.nan_to_num(fit.rms, nan=np.inf), np.inf)
    ranked = np.argsort(rms)
    best = ranked[0] if len(rms) > 1 and _BETTER_THAN_OTHERS * rms[ranked[0]] < rms[ranked[1]] else -1
    return np.asarray((points - fit.t[best]) @ fit.R[best] - shape)


def _exchanged_pairs(residual: NDArray, is_observed: NDArray, shape: NDArray, sigma: float) -> list[Exchange]:
    """Return pairs of targets that lie at each other's places, for bodies whose other targets determine the pose."""
    off = np.sqrt(np.sum(np.nan_to_num(residual) ** 2, -1))
    pairs = []
    for pose in np.flatnonzero((is_observed & (off > _LARGE_RESIDUAL * sigma)).sum(1) >= 2):
        suspects = np.flatnonzero(is_observed[pose] & (off[pose] > _LARGE_RESIDUAL * sigma))
        for first, second in combinations(suspects, 2):
            shift = shape[second] - shape[first]
            miss = np.array([residual[pose, first] - shift, residual[pose, second] + shift])
            if np.sqrt(np.sum(miss**2, -1)).max() < min(_SHARE * np.sqrt(shift @ shift), _NEAR * sigma):
                pairs.append(Exchange(int(pose), int(first), int(second)))
    return pairs


def _best_of_few(points: NDArray, is_observed: NDArray, shape: NDArray, sigma: float, pose: int) -> Exchange | None:
    """Return the one exchange, if any, with which a pose's few points (T, 3) agree with the survey."""
    present = np.flatnonzero(is_observed)
    pairs = list(combinations(present, 2))
    tried = np.repeat(points[None], len(pairs) + 1, 0)
    for number, (first, second) in enumerate(pairs, 1):
        tried[number, [first, second]] = points[[second, first]]
    fit = umeyama(shape, tried, np.repeat(is_observed[None].astype(float), len(tried), 0))
    rms = np.where(fit.ok, np.nan_to_num(fit.rms, nan=np.inf), np.inf)
    best = int(np.argmin(rms))
    second_best = np.delete(rms, best).min()
    if best == 0 or rms[0] < _LARGE_RESIDUAL * sigma or rms[best] * _BETTER_THAN_OTHERS > second_best:
        return None
    first, second = pairs[best - 1]
    distance = np.sqrt(np.sum((shape[first] - shape[second]) ** 2))
    return Exchange(pose, int(first), int(second)) if rms[best] < _SHARE * distance else None
