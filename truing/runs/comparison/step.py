"""From one run to the next: what was judged of the numbers that both have, or why nothing was."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    import pandas as pd

# In so many comparisons of campaigns between which nothing changed a change is told.
FALSE_ALARM = 0.05
# Two questions are asked, and each gets half of it: of a mechanism, each number by itself and all together; of a
# sensor, its compliance and its matrix.
LEVEL = FALSE_ALARM / 2.0
NAMES = ["group", "effect_of", "leg", "parameter"]


@dataclass(frozen=True)
class Step:
    """Rows by NAMES with sigma_difference, z, changed, change, sigma_change, instead and reason; empty where nothing
    could be judged, and then ``why``. ``rebuilt``: more has changed than can be named one by one.
    """

    rows: pd.DataFrame
    why: str = ""
    rebuilt: bool = False


def not_judged(why: str) -> Step:
    """Return the step between two runs whose numbers cannot be held against each other."""
    import pandas as pd

    return Step(pd.DataFrame(columns=[*NAMES, "z", "changed"]), why)


def held_at_zero(shared: NDArray, covariance: NDArray, own: NDArray, effects: list[NDArray]) -> NDArray:
    """Return as a covariance (n, n) by what numbers at ``own`` (n,) would move, were each effect not in the model.

    shared (G,) with covariance (G, G); effects: the places of each one's parameters. What one campaign found, and
    another did not, may be there in both; the other's numbers are then off by as much.
    """
    spread = np.zeros((len(own), len(own)))
    for places in effects:
        gain = np.linalg.solve(covariance[np.ix_(places, places)], covariance[np.ix_(places, own)])
        moved = gain.T @ shared[places]
        spread += np.outer(moved, moved)
    return spread


def beyond_chance(z: NDArray) -> NDArray:
    """Return which of some differences over their sigmas (n,), NaN where not judged, chance does not explain.

    Each by itself; the level is that of all together, whatever their correlations are.
    """
    from scipy.special import ndtr

    judged = np.isfinite(z)
    return judged & (2.0 * ndtr(-np.abs(np.where(judged, z, 0.0))) * max(int(judged.sum()), 1) < LEVEL)
