"""Where points seem to be that are seen through air of uneven index, or through a pane of glass: to first order.

Light bends towards the larger index: along a way s from a point X to a projection centre C, at distance L in direction
d, it leaves the chord by y'' = grad n across the ray, and arrives as if the point were moved by - integral of s y''(s)
from 0 to L. An index with a constant gradient moves points as the special conformal map does, the same for all cameras
but for what orientations take up; so only the second derivatives Q of the index show: - Q ((X - O) L^2 / 2 + d L^3 / 3)
about any origin O. A pane of thickness t and index n across the axis of a camera moves points towards it by
t (1 - cos a / sqrt(n^2 - sin^2 a)), a the angle between ray and axis. Born and Wolf, Principles of Optics (7th ed.),
sections 3.2.1 and 3.2.2; Luhmann et al. (3rd ed.), section 3.3.5.
"""

from __future__ import annotations

import numpy as np

from truing.estimation.bundle.network import Array

GLASS = 1.52
# The second derivatives of the index in the axes of a pose's measurement.
PLACES = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
CURVATURES = ("xx", "yy", "zz", "xy", "xz", "yz")


def by_curvature(points: Array, centres: Array, origin: Array) -> Array:
    """Return how far points (N, 3) in m, seen from centres (N, 3), seem to move (N, 3, 6) per second derivative of the
    index, 1/m^2, in the order of CURVATURES; origin (3,): where its gradient is none."""
    away = centres - points
    length = np.linalg.norm(away, axis=-1, keepdims=True)
    moment = (points - origin) * length**2 / 2 + away * length**2 / 3
    found = np.zeros((*points.shape, len(PLACES)))
    for number, (i, j) in enumerate(PLACES):
        found[:, i, number] -= moment[:, j]
        if i != j:
            found[:, j, number] -= moment[:, i]
    return found


def by_thickness(seen: Array) -> Array:
    """Return how far points (N, 3) in a camera's axes seem to move along its axis (N,) per thickness of a pane."""
    cosine = seen[:, 2] / np.linalg.norm(seen, axis=-1)
    return np.asarray(cosine / np.sqrt(GLASS**2 - 1 + cosine**2) - 1)
