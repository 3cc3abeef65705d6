"""Two images of the same points without coordinates: relative orientation, with its rivals where the points lie
flat."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from truing.estimation.bundle.intersection import Bundle, nearest_points
from truing.estimation.bundle.network import Array, Index

FEWEST = 6  # common points: five give up to ten solutions, the sixth chooses
_RIVAL = 0.7  # of the best solution's agreeing points: what has so many stays in the race


@dataclass(frozen=True)
class Pair:
    """The second image as seen from the first, its base one long: R (3, 3) turns the second camera's axes into the
    first's, centre (3,); how many points agree, and the median angle (rad) at which their rays meet."""

    R: Array
    centre: Array
    agreeing: int
    angle: float


def common_points(image: Index, point: Index, images: int, points: int) -> Array:
    """Return how many points (I, I) each pair of images has in common."""
    from scipy.sparse import csr_array

    seen = csr_array((np.ones(len(image)), (image, point)), shape=(images, points))
    seen.data[:] = 1.0  # a point measured twice in an image is one
    shared = (seen @ seen.T).toarray()
    np.fill_diagonal(shared, 0.0)
    return shared


def relative_orientations(first: Array, second: Array, limit: float) -> list[Pair]:
    """Return orientations of an image relative to another that explain common points at X/Z, Y/Z (n, 2), best first.

    From the essential matrix by five points (Nister 2004) and from the homography of flat points (Malis and Vargas
    2007), both by consensus within the limit (in units of X/Z). Flat fields leave rivals that a third image decides.
    """
    if len(first) < FEWEST:
        return []
    found = [pair for R, t in _motions(first, second, limit) if (pair := _judged(R, t, first, second, limit))]
    found.sort(key=lambda pair: -pair.agreeing)
    kept: list[Pair] = []
    for pair in found:
        strong = pair.agreeing >= max(FEWEST, _RIVAL * found[0].agreeing)
        if strong and all(np.abs(pair.R - other.R).max() > 0.02 for other in kept):
            kept.append(pair)
    return kept


def _motions(first: Array, second: Array, limit: float) -> list[tuple[Array, Array]]:
    """Return (R, t) with x2 ~ R x1 + t, of all solutions and signs."""
    import cv2

    a, b = np.ascontiguousarray(first), np.ascontiguousarray(second)
    motions: list[tuple[Array, Array]] = []
    try:
        essential, _ = cv2.findEssentialMat(a, b, np.eye(3), cv2.RANSAC, 0.9999, limit)
    except cv2.error:
        essential = None
    for E in [] if essential is None else np.split(essential, len(essential) // 3):
        one, other, t = cv2.decomposeEssentialMat(E)
        motions += [(R, sign * t.ravel()) for R in (one, other) for sign in (1.0, -1.0)]
    return motions + _motions_of_a_plane(a, b, limit)


def _motions_of_a_plane(a: Array, b: Array, limit: float) -> list[tuple[Array, Array]]:
    import cv2

    try:
        H, _ = cv2.findHomography(a, b, cv2.RANSAC, limit, maxIters=100)
        turns, shifts = ((), ()) if H is None else cv2.decomposeHomographyMat(H, np.eye(3))[1:3]
    except cv2.error:  # points that determine none
        return []
    return [(R, s * t.ravel()) for R, t in zip(turns, shifts, strict=True) for s in (1.0, -1.0)]


def _judged(R: Array, t: Array, first: Array, second: Array, limit: float) -> Pair | None:
    """Count the points that a motion explains, in front of both cameras; None where rays hardly meet."""
    base = np.linalg.norm(t)
    if not base > 1e-9:
        return None
    n = len(first)
    turn, centre = R.T, -R.T @ t / base
    rays = Bundle(
        np.repeat([0, 1], n), np.tile(np.arange(n), 2), np.concatenate([first, second]), np.ones(2 * n),
        np.stack([np.eye(3), turn]), np.stack([np.zeros(3), centre]), n,
    )  # fmt: skip
    X, meet = nearest_points(rays, np.ones(2 * n))
    agrees = rays.agree(X, limit).reshape(2, n).all(axis=0)
    if not agrees.any():
        return None
    angle = float(np.median(np.arccos(np.clip(1 - meet[agrees], -1.0, 1.0))))
    return Pair(turn, centre, int(agrees.sum()), angle)
