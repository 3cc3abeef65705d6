"""Heavy tails as the unnamed rival of a cause by which some measurements scatter more than others.

A name says that everything in one place scatters more. A few large errors anywhere may look the same. So the size of
each error is Student's t, with any number of degrees of freedom, and the name must be needed next to it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from truing.inference.arrays import Array, Integers, Mask

_FREEDOMS = (1.0, 1.5, 2.0, 3.0, 5.0, 8.0, 15.0, 1e3)  # the last is a normal distribution
_STEPS = 30
_FEWEST_REPEATS = 4
# Log likelihood ratios: a place must be needed by the first, and tails there must not exceed the second.
_NEEDED, HEAVY = float(np.log(20.0)), 5.0


def is_of_place(errors: Array, selected: Mask, tried: int) -> bool:
    """Return True if errors (B, K, d) are larger in places ``selected`` (B, K) than heavy tails explain, and normal
    there.

    The place was chosen among ``tried`` ones: a few large errors lie somewhere together by chance. Tails are those of
    single coordinates, or of all coordinates of an epoch together. The channels concerned are compared at other epochs,
    or with other channels if all of their epochs are concerned.
    """
    needed, tails = [], []
    for square, size, inside in _squares(errors, selected):
        needed.append(log_odds_of_place(square, size, inside))
        tails.append(log_odds_of_tails(square[inside], size))
    return min(needed) > _NEEDED + math.log(max(tried, 1)) and max(tails) < HEAVY


def has_heavy_tails(errors: Array, selected: Mask) -> bool:
    """Return True if errors (B, K, d) have heavy tails in places ``selected`` (B, K), or where these are compared."""
    tails = [
        log_odds_of_tails(square[chosen], size)
        for square, size, inside in _squares(errors, selected)
        for chosen in (inside, np.ones_like(inside))
    ]
    return max(tails) >= HEAVY


def _squares(errors: Array, selected: Mask) -> Iterator[tuple[Array, int, Mask]]:
    """Yield squares (n,) of errors (B, K, d), their number of coordinates, and the mask (n,) of the selected ones.

    Squares are those of single coordinates, then of epochs where whole epochs may have larger errors.
    """
    always = bool(np.all(selected.all(0) | ~selected.any(0)))
    channels = np.ones(selected.shape[1], bool) if always else selected.any(0)
    squares, inside = errors[:, channels] ** 2, selected[:, channels]
    yield squares.ravel(), 1, np.repeat(inside.ravel(), errors.shape[2])
    known = np.isfinite(squares)
    if not always and (size := int(known.any(0).sum())) > 1:
        mean_squares = np.where(known, squares, 0.0).sum((1, 2)) / np.maximum(known.sum((1, 2)), 1) * size
        mean_squares[~known.any((1, 2))] = np.nan
        yield mean_squares, size, np.asarray(inside.any(1))


def p_value_of_repeats(errors: Array, selected: Mask, repeats: Integers) -> float:
    """Return the p-value of the F test of equal means at repeats of a command, of errors (B, K, d) in places
    ``selected`` (B, K).

    ``repeats`` (B,): number of each epoch's command, -1 for none. Random errors differ at each repeat.
    """
    from scipy.special import fdtrc

    between, within, freedom = 0.0, 0.0, [0, 0]
    for channel in np.flatnonzero(selected.any(0)):
        at = selected[:, channel] & (repeats >= 0) & np.isfinite(errors[:, channel]).all(1)
        if not at.any():
            continue
        rows, (_, number, count) = errors[at, channel], np.unique(repeats[at], return_inverse=True, return_counts=True)
        means = np.stack([np.bincount(number, column) for column in rows.T], -1) / count[:, None]
        within += float(np.sum((rows - means[number]) ** 2))
        between += float(np.sum(count[:, None] * (means - rows.mean(0)) ** 2))
        freedom[0] += (len(count) - 1) * rows.shape[1]
        freedom[1] += (len(rows) - len(count)) * rows.shape[1]
    if min(freedom) < _FEWEST_REPEATS or within <= 0.0:
        return 1.0
    return float(fdtrc(*freedom, between / freedom[0] / (within / freedom[1])))


def log_odds_of_place(square: Array, size: int, selected: Mask) -> float:
    """Return the log likelihood ratio of a separate scale in one place, next to heavy tails of any shape.

    ``square`` (n,): squares of errors of ``size`` coordinates each, NaN where unknown; ``selected`` (n,): True in the
    place."""
    known = np.isfinite(square)
    inside, outside = square[known & selected], square[known & ~selected]
    if not len(inside) or not len(outside):
        return 0.0
    separate = [log_likelihood(inside, size, nu) + log_likelihood(outside, size, nu) for nu in _FREEDOMS]
    together = [log_likelihood(square[known], size, nu) for nu in _FREEDOMS]
    return max(separate) - max(together)


def log_odds_of_tails(square: Array, size: int) -> float:
    """Return the log likelihood ratio of heavy tails over a normal distribution, both with a scale of their own."""
    known = square[np.isfinite(square)]
    likelihoods = [log_likelihood(known, size, nu) for nu in _FREEDOMS] if len(known) else [0.0]
    return max(likelihoods) - likelihoods[-1]


def log_odds_of_large(square: Array, size: int) -> float:
    """Return the log likelihood ratio of heavy tails over a normal distribution of the scale that most errors have.

    Large errors count whole, so that ratios of errors of different sizes compare."""
    known = square[np.isfinite(square)]
    if not len(known):
        return 0.0
    # Median of chi-square by Wilson and Hilferty, Proc. Natl. Acad. Sci. 17 (1931) 684.
    scale = max(float(np.median(known)) / (size * (1.0 - 2.0 / (9.0 * size)) ** 3), 1e-300)
    normal = -len(known) * size / 2.0 * math.log(2.0 * scale) - float(np.sum(known)) / (2.0 * scale)
    return max(log_likelihood(known, size, nu) for nu in _FREEDOMS) - normal


def log_likelihood(square: Array, size: int, freedom: float) -> float:
    """Return the log likelihood of errors of Student's t at the likeliest scale, up to a constant of their number."""
    scale = float(np.mean(square)) / size
    for _ in range(_STEPS):
        scale = float(np.mean((freedom + size) / (freedom + square / max(scale, 1e-300)) * square)) / size
    scale = max(scale, 1e-300)
    log_constant = (
        math.lgamma((freedom + size) / 2.0) - math.lgamma(freedom / 2.0) - size / 2.0 * math.log(freedom * scale)
    )
    return len(square) * log_constant - (freedom + size) / 2.0 * float(np.sum(np.log1p(square / (freedom * scale))))
