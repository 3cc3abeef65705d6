"""Choice of the points of a large pose whose correlations with each other are written.

All pairs of 26,000 points are 350 million rows. In a pose of more than `MOST_PAIRED` points, pairs are written of the
points that bodies of the campaign name, or, if these are too many or none, of points spread over each body. Standard
deviations are those of all points alike, and the fit of poses uses points with correlations only.
"""

from __future__ import annotations

import numpy as np

from truing.arrays import Array, Index
from truing.estimation.bundle.network import NamedNetwork

MOST_PAIRED = 1000  # points of a pose of which all pairs are written: 500,000 rows
SPREAD = 300  # points of a larger pose, over all its bodies, if those asked for are too many or none
_LEAST_OF_BODY = 30


def paired_points(named: NamedNetwork, numbers: Index, xyz: Array, surveyed: frozenset[str]) -> Index:
    """Places (n,) among the points of a pose, by number (p,) with xyz (p, 3) in m, of those whose pairs are written."""
    if len(numbers) <= MOST_PAIRED:
        return np.arange(len(numbers))
    bodies = named.bodies[numbers]
    asked = np.flatnonzero((bodies != "") | np.array([name in surveyed for name in named.points[numbers]]))
    if len(asked) and len(asked) <= MOST_PAIRED:
        return asked
    asked = asked if len(asked) else np.arange(len(numbers))
    names = list(dict.fromkeys(bodies[asked].tolist()))
    most = max(SPREAD // len(names), _LEAST_OF_BODY)
    return np.sort(np.concatenate([_spread(asked[bodies[asked] == name], xyz, most) for name in names]))


def _spread(places: Index, xyz: Array, most: int) -> Index:
    """Places of at most so many points, each the furthest from those before it."""
    if len(places) <= most:
        return places
    own = xyz[places]
    chosen, distance = [], np.linalg.norm(own - own.mean(axis=0), axis=1)
    for number in range(most):
        chosen.append(int(np.argmax(distance)))
        to_last = np.linalg.norm(own - own[chosen[-1]], axis=1)
        distance = np.minimum(distance, to_last) if number else to_last
    return places[chosen]
