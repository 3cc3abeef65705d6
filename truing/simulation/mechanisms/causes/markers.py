"""Square markers among the targets of photographs: four corners that hold together, whatever happens to the marker."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from truing.estimation.rotation import skew

# Photographs name the corners of a marker so, after the marker's own name and a point.
_CORNERS = frozenset("0123")
_FEWEST = 3


def markers_of(bodies: Sequence[str], names: Sequence[str]) -> dict[tuple[str, str], tuple[int, ...]]:
    """Return the markers among targets (K,), by body and name: which of the targets are their corners, three or four.

    One that is all of its body is none: it moves as the body does.
    """
    found: dict[tuple[str, str], list[int]] = {}
    for number, (body, name) in enumerate(zip(bodies, names, strict=True)):
        marker, point, corner = name.rpartition(".")
        if point and corner in _CORNERS:
            found.setdefault((body, marker), []).append(number)
    return {
        key: tuple(corners)
        for key, corners in found.items()
        if _FEWEST <= len(corners) <= len(_CORNERS) and len(corners) < list(bodies).count(key[0])
    }


def arms_of(places: NDArray) -> tuple[NDArray, float]:
    """Return where corners (n, 3) sit from their middle, and the root mean square of their distance from it, m."""
    arms = places - places.mean(0)
    return arms, float(np.sqrt(np.mean(np.sum(arms**2, -1))))


def rigid_patterns(markers: Sequence[Sequence[int]], places: NDArray) -> tuple[NDArray, NDArray]:
    """Return the corners (T, n) of markers among places (K, 3), m, and how they follow a marker, (T, n, 3, 6): shifts
    along the axes, and turns about these that move corners by as much in the mean.

    A marker of three corners has its first twice, which then follows nothing the second time.
    """
    corners = np.array([[*own, *own[:1]][: len(_CORNERS)] for own in markers])
    patterns = np.zeros((*corners.shape, 3, 6))
    for number, own in enumerate(markers):
        arms, radius = arms_of(places[list(own)])
        patterns[number, : len(own), :, :3] = np.eye(3)
        patterns[number, : len(own), :, 3:] = -skew(arms) / radius
    return corners, patterns
