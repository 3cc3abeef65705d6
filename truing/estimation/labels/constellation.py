"""A set of points as labelling sees it: its distances, its size, and how easily its shape arises by accident."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import comb, lgamma, log

import numpy as np
from numpy.typing import NDArray

# A target is beyond 5 sigma (three coordinates) once in 65,000; losing it to the gate costs nothing else.
GATE = 5.0


@dataclass(frozen=True)
class Constellation:
    """Points (N, 3) in m, and the variance (N,) in m^2 of each coordinate of each."""

    points: NDArray
    variance: NDArray

    def __len__(self) -> int:
        return len(self.points)

    @cached_property
    def distances(self) -> NDArray:
        """Distances (N, N) in m."""
        # About the centroid: a difference of squares loses digits in a cloud far from its frame's origin.
        centred = self.points - self.points.mean(0)
        square = np.sum(centred**2, -1)
        product = square[:, None] + square - 2 * centred @ centred.T
        return np.sqrt(np.maximum(product, 0.0))

    @cached_property
    def pairs(self) -> tuple[NDArray, NDArray, NDArray]:
        """Distances of all ordered pairs in ascending order, and their first and second points."""
        first, second = np.nonzero(~np.eye(len(self), dtype=bool))
        length = self.distances[first, second]
        order = np.argsort(length, kind="stable")
        return length[order], first[order], second[order]

    @cached_property
    def extents(self) -> NDArray:
        """Ranges (3,) in m along the principal axes, longest first, none below the width of a gate."""
        _, axes = np.linalg.eigh(np.cov(self.points.T))
        ranges = np.ptp(self.points @ axes[:, ::-1], axis=0)
        return np.maximum(ranges, 2 * GATE * np.sqrt(self.variance.max()))

    @cached_property
    def on_a_line(self) -> bool:
        """Whether no point stands out from the principal axis by more than a gate."""
        centred = self.points - self.points.mean(0)
        axis = np.linalg.svd(centred, full_matrices=False)[2][0]
        across = np.linalg.norm(centred - np.outer(centred @ axis, axis), axis=1)
        return bool(np.all(across <= GATE * np.sqrt(2 * self.variance)))

    @property
    def size(self) -> float:
        """Largest distance in m."""
        return float(self.distances.max())


def log_expected_accidents(cloud: Constellation, survey: Constellation, n_consistent: int) -> float:
    """Return the log of the number of ways in which n_consistent targets are expected to fit by pure accident.

    It counts every choice of targets and points, times the probability that points strewn evenly over the
    cloud's box lie in their gates: the first anywhere, the second on a shell, the third on a ring, the rest in a box.
    Moisan and Stival, Int. J. Computer Vision 57 (2004) 201, carried over from images to rigid bodies.
    """
    N, M, k = len(cloud), len(survey), n_consistent
    width = 2 * GATE * np.sqrt(cloud.variance.max() + survey.variance.max())
    a, b, c = np.maximum(cloud.extents, width)
    L = survey.size
    shell = width * min(2 * np.pi * L, np.pi * b) * min(c, 2 * L) / (a * b * c)
    ring = width**2 * min(2 * np.pi * L, np.pi * c) / (a * b * c)
    box = width**3 / (a * b * c)
    third = box if survey.on_a_line else ring
    ways = log(comb(N, k)) + log(comb(M, k)) + lgamma(k + 1)
    return ways + log(min(shell, 1.0)) + log(min(third, 1.0)) + (k - 3) * log(min(box, 1.0))
