"""Pulls: shifts of parameters from their prior values, over the shifts expected if the priors are right.

If the model is right, a parameter with prior variance T and posterior variance C shifts by a normal amount of variance
T - C: the information that the data add. Shifts of several parameters have the covariance T - C, which is singular in
directions that the data do not determine; these have no pull.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from truing.inference.arrays import Array, Mask

# A parameter is identifiable if the data reduce its prior variance by at least this share.
IDENTIFIABLE = 0.5
_BAND = 0.95
_INFORMED = 0.01  # share of a prior variance by which the data reduce it at least where they say something


@dataclass(frozen=True)
class Pulls:
    """Pulls (P,), unit normal where model and priors are right; NaN where a parameter is not identifiable.

    ``offset`` (P,): how far the prior of each one is off if it alone is wrong, in the unit of the shifts; this takes
    ``explained`` (P,) from the sum. NaN where the data say next to nothing.
    ``chi_square`` sums up independent identifiable combinations of parameters, ``freedom`` of them. ``lower`` and
    ``upper`` hold 95 % of such sums; ``p_value`` is the probability of a larger one.
    """

    pull: Array
    offset: Array
    explained: Array
    identifiable: Mask  # (P,)
    chi_square: float
    freedom: int
    lower: float
    upper: float
    p_value: float


def pulls(shift: Array, prior: Array, posterior: Array) -> Pulls:
    """Return the pulls of parameters that moved by shift (P,), with prior and posterior covariance (P, P).

    Any units, the same in all three. A combination is identifiable if the data halve its prior variance, like a
    parameter.
    """
    scale = np.sqrt(np.diag(prior))
    gained = (prior - posterior) / np.outer(scale, scale)
    determined = np.diag(gained) >= IDENTIFIABLE
    moved = shift / scale
    single_pulls = np.where(determined, moved / np.sqrt(np.where(determined, np.diag(gained), 1.0)), np.nan)
    informed = np.where(np.diag(gained) >= _INFORMED, np.diag(gained), np.nan)
    # Of all parameters: two may share one determined number, such as a length and a height, with less than half each.
    variances, directions = np.linalg.eigh(gained)
    mask = variances >= IDENTIFIABLE
    total = float(np.sum((directions[:, mask].T @ moved) ** 2 / variances[mask]))
    return Pulls(
        single_pulls,
        moved * scale / informed,
        moved**2 / informed,
        determined,
        total,
        int(mask.sum()),
        *_chi_square_band(total, int(mask.sum())),
    )


def _chi_square_band(total: float, freedom: int) -> tuple[float, float, float]:
    """Return the ends of the 95 % band and the probability of a larger sum; (0, 0, 1) without degrees of freedom."""
    from scipy.special import chdtrc, chdtri

    if not freedom:
        return 0.0, 0.0, 1.0
    outside = (1.0 - _BAND) / 2
    return float(chdtri(freedom, 1.0 - outside)), float(chdtri(freedom, outside)), float(chdtrc(freedom, total))
