"""Gross errors among points of the same target over the poses, told from what happens to a target and stays.

A target that was moved is elsewhere in all poses that follow; a gross error is alone. So a point is right where it
agrees with others of its target before or after it in time.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

# Of so many poses before, or after, so many must agree; of the second and the last but one, both neighbours will do.
_NEIGHBOURS, _AGREE = 3, 2
# Points agree within so many of the target's own spread from pose to pose; one that is suspect already, within fewer.
_REACH, _SUSPECT_REACH = 12.0, 3.5
# Suspects scatter more, being no part of the fit that they are judged by; they agree within this share of how far off
# they are: no two gross errors do.
_ALIKE = 0.25


def alone_in_time(values: NDArray, order: NDArray, suspect: NDArray, least: float = 1e-6) -> NDArray:
    """Return which points (B, T) agree with no others of their target just before or just after them.

    values (B, T, d): where each target was, less where it should be, along the body's axes, m; NaN where it was not
    seen. order (B,): the poses' ranks in time. suspect (B, T): points that another test rejected. least (m): targets
    scatter by no less than this. A target seen in fewer than four poses tells nothing: only its suspects count.
    """
    alone = np.zeros(suspect.shape, bool)
    known = np.isfinite(values).all(-1)
    in_time = np.argsort(order, kind="stable")
    for target in range(values.shape[1]):
        rows = in_time[known[in_time, target]]
        own, doubted = values[rows, target], suspect[rows, target]
        alone[rows, target] = doubted if len(rows) <= _NEIGHBOURS else _alone(own, doubted, least)
    return alone


def _alone(own: NDArray, doubted: NDArray, least: float) -> NDArray:
    """Return which of a target's points (N, d), in time order, are alone."""
    from scipy.special import chdtri

    steps = _lengths(np.diff(own, axis=0))
    median = float(np.sqrt(chdtri(own.shape[1], 0.5)))  # length of as many unit normals
    spread = max(float(np.median(steps)) / median / np.sqrt(2.0), least)
    reach = np.sqrt(2.0) * spread * np.where(doubted, _SUSPECT_REACH, _REACH)
    reach = np.maximum(reach, doubted * _ALIKE * _lengths(own))
    agree, between = np.zeros((2, len(own)), int), np.zeros(len(own), bool)
    for distance in range(1, _NEIGHBOURS + 1):
        near = _lengths(own[distance:] - own[:-distance])
        agree[0, distance:] += near <= reach[distance:]
        agree[1, :-distance] += near <= reach[:-distance]
        if distance == 1:
            between |= agree.all(0)
    between[2:-2] = False
    return np.asarray((agree < _AGREE).all(0) & ~between)


def _lengths(vectors: NDArray) -> NDArray:
    return np.sqrt(np.sum(vectors**2, -1))
