"""Pulls: how far parameters moved from where they were believed to be, against how far honest beliefs let them move.

A parameter x with prior variance T and posterior variance C moves, where the model is right, by a normal amount of
variance T - C: what the data have added to what was known. Shifts of several parameters have the covariance T - C too,
which is singular in all directions that the data say nothing of; those have no pull.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from truing.inference.arrays import Array, Mask

# What the data tell has at least this share of its prior variance taken away by them.
TOLD = 0.5
_BAND = 0.95


@dataclass(frozen=True)
class Pulls:
    """Pulls (P,), unit normal where model and beliefs are right; NaN where the data tell less than was believed.

    chi_square sums up independent combinations of the identifiable parameters, ``freedom`` of them; lower and upper
    hold 95 % of such sums, and p_value is the probability of a larger one.
    """

    pull: Array
    identifiable: Mask  # (P,)
    chi_square: float
    freedom: int
    lower: float
    upper: float
    p_value: float


def pulls(shift: Array, prior: Array, posterior: Array) -> Pulls:
    """Return the pulls of parameters that moved by shift (P,), with prior and posterior covariance (P, P).

    Units are any, the same in all three. A combination counts as identifiable as a parameter does: where the data took
    away half of its prior variance.
    """
    scale = np.sqrt(np.diag(prior))
    gained = (prior - posterior) / np.outer(scale, scale)
    determined = np.diag(gained) >= TOLD
    moved = shift / scale
    each = np.where(determined, moved / np.sqrt(np.where(determined, np.diag(gained), 1.0)), np.nan)
    variances, directions = np.linalg.eigh(gained[np.ix_(determined, determined)])
    kept = variances >= TOLD
    total = float(np.sum((directions[:, kept].T @ moved[determined]) ** 2 / variances[kept]))
    return Pulls(each, determined, total, int(kept.sum()), *_chi_square_band(total, int(kept.sum())))


def _chi_square_band(total: float, freedom: int) -> tuple[float, float, float]:
    """Return the ends of the band, and the probability of a larger sum; without any direction there is none."""
    from scipy.special import chdtrc, chdtri

    if not freedom:
        return 0.0, 0.0, 1.0
    outside = (1.0 - _BAND) / 2
    return float(chdtri(freedom, 1.0 - outside)), float(chdtri(freedom, outside)), float(chdtrc(freedom, total))
