"""From which source each row of a fit comes, and what its errors give to the sizes that were found."""

from __future__ import annotations

from collections.abc import Mapping, Set
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truing.estimation.diagnosis.whitening import Whitened

# Sources beside the kinds of shared unknowns, which bring their own names.
POINTS, READINGS, EARLIER = "points", "readings", "earlier"
PLAUSIBLE, WIDE = "plausible", "wide"


@dataclass(frozen=True)
class Given:
    """What one source gives to the covariance (P, P) of some parameters, SI, and what a fit leaves of its rows."""

    source: str
    covariance: NDArray
    freedom: float


def rows_by_source(
    whitened: Whitened, layout: Mapping[str, slice], causes: Set[str], readings: slice
) -> dict[str, NDArray]:
    """Return which rows (N,) of a whitened problem are of each source; every row is of one.

    Priors of causes are ``PLAUSIBLE`` sizes, those that are no knowledge ``WIDE``, others are called as in the layout.
    """
    problem = whitened.problem
    poses, height = problem.residual.shape
    tall = height + problem.local_value.shape[1]
    first, extra = poses * tall, len(problem.extra_residual)
    places = np.arange(len(whitened.rows))
    within, of_pose = places % tall, places < first
    shared = places - first - extra
    # What measurements of a pose share is an error of theirs, though it has an unknown of its own.
    of_points = np.concatenate([np.ones(height, bool), problem.local_known])
    of_points[height + readings.start : height + readings.stop] = False
    found = {
        POINTS: of_pose & of_points[within],
        READINGS: of_pose & (within >= height + readings.start) & (within < height + readings.stop),
        EARLIER: ~of_pose & (shared < 0),
        PLAUSIBLE: np.zeros(len(places), bool),
    }
    known = np.concatenate([np.zeros(first + extra, bool), problem.shared_known])
    for name, own in layout.items():
        mine = (shared >= own.start) & (shared < own.stop)
        if name in causes:
            found[PLAUSIBLE] |= mine
        else:
            found[name] = mine & known
    found[WIDE] = ~np.any(list(found.values()), axis=0)
    return {name: own for name, own in found.items() if own.any()}
