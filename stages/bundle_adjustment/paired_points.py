"""Choice of the points of a large pose whose correlations with each other are written.

All pairs of 26,000 points are 350 million rows. Of a pose with more than `MOST_PAIRED` points, pairs are written of the
points that bodies of the campaign name. If these are too many or none, points spread over the object are paired, the
same in all poses. Standard deviations are written for all points; poses are fitted to points with correlations.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from truing.arrays import Array, Index
from truing.estimation.bundle.network import NamedNetwork

MOST_PAIRED = 1000  # points of a pose of which all pairs are written: 500,000 rows
SPREAD = 300  # points of a larger pose, if those that bodies name are too many or none
_LEAST_OF_BODY = 30
_IN_POSES = 0.5  # share of the poses that see a point, for it to be preferred


def paired_points(
    named: NamedNetwork, numbers: Mapping[int, Index], points: Array, surveyed: frozenset[str]
) -> dict[int, Index]:
    """Places (n,) among the adjusted points of each pose of those whose pairs are written.

    numbers: per pose those of its adjusted points (p,); points (P, 3) in m; surveyed: names of targets of bodies.
    """
    large = [pose for pose, number in numbers.items() if len(number) > MOST_PAIRED]
    chosen = _names(named, [numbers[pose] for pose in large], points, surveyed) if large else frozenset()
    return {
        pose: np.flatnonzero([name in chosen for name in named.points[number]])
        if pose in large
        else np.arange(len(number))
        for pose, number in numbers.items()
    }


def _names(named: NamedNetwork, poses: list[Index], points: Array, surveyed: frozenset[str]) -> frozenset[str]:
    """Names of the points of large poses whose pairs are written."""
    names_of_pose = [numbers[_is_named(named, numbers, surveyed)] for numbers in poses]
    most = max(len(numbers) for numbers in names_of_pose)
    if 0 < most <= MOST_PAIRED:
        return frozenset(name for numbers in names_of_pose for name in named.points[numbers])
    candidates = max(names_of_pose if most else poses, key=len)
    seen = Counter(name for numbers in poses for name in named.points[numbers])
    often = np.array([seen[name] >= _IN_POSES * len(poses) for name in named.points[candidates]])
    candidates = candidates[often] if often.sum() >= SPREAD else candidates
    bodies = named.bodies[candidates]
    each = max(SPREAD // len(set(bodies.tolist())), _LEAST_OF_BODY)
    parts = [_spread(points[candidates[bodies == body]], each) for body in dict.fromkeys(bodies.tolist())]
    groups = [candidates[bodies == body] for body in dict.fromkeys(bodies.tolist())]
    return frozenset(name for group, part in zip(groups, parts, strict=True) for name in named.points[group[part]])


def _is_named(named: NamedNetwork, numbers: Index, surveyed: frozenset[str]) -> NDArray[np.bool_]:
    of_survey = np.array([name in surveyed for name in named.points[numbers]], dtype=bool)
    return np.asarray((named.bodies[numbers] != "") | of_survey)


def _spread(xyz: Array, most: int) -> Index:
    """Places of a limited number of points (n, 3), each the furthest from those before it."""
    if len(xyz) <= most:
        return np.arange(len(xyz))
    chosen, distance = [], np.linalg.norm(xyz - xyz.mean(axis=0), axis=1)
    for number in range(most):
        chosen.append(int(np.argmax(distance)))
        to_last = np.linalg.norm(xyz - xyz[chosen[-1]], axis=1)
        distance = np.minimum(distance, to_last) if number else to_last
    return np.array(chosen)
