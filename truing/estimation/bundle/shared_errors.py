"""What the errors of the points of one pose have in common: a few patterns, and a covariance of each point's own."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from truing.estimation.bundle.network import Array
from truing.estimation.rotation import rigid_motions

# A pattern in which points err together is told where its variance is so many times that of points by themselves.
_TOGETHER = 2.0


@dataclass(frozen=True)
class SharedErrors:
    """Patterns (p, 3, E), m, by numbers of variance one, and what is left of each point's covariance (p, 3, 3)."""

    patterns: Array
    own: Array


def shared_errors(covariance: Array, points: Array, most: int) -> SharedErrors:
    """Return the patterns, at most so many, of a covariance (3 p, 3 p) in m^2 of points (p, 3) that move together.

    Shifts and turns of all points, which a pose leaves free, are none of them. Patterns are the eigenvectors of what is
    left, in units of the points' own standard deviation, whose values stand out.
    """
    count = len(points)
    arms = points - points.mean(0)
    moved = rigid_motions(arms).reshape(3 * count, 6)
    held = np.linalg.qr(moved / np.linalg.norm(moved, axis=0))[0]
    left = covariance - held @ (held.T @ covariance)
    left = left - (left @ held) @ held.T
    sigma = np.sqrt(max(float(np.mean(np.diagonal(left))), 0.0))  # of hopeless networks, rounding is all that is left
    values, vectors = np.linalg.eigh((left + left.T) / 2)
    usual = float(np.median(values[6:])) if count > 2 else sigma**2
    chosen = np.arange(len(values))[::-1][:most]
    chosen = chosen[values[chosen] > _TOGETHER * usual]
    patterns = vectors[:, chosen] * np.sqrt(values[chosen] - usual)
    each = np.arange(count)
    blocks = (left - patterns @ patterns.T).reshape(count, 3, count, 3)[each, :, each]
    return SharedErrors(patterns.reshape(count, 3, -1), blocks)
