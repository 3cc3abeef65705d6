"""From a few oriented images to all of them: resection and intersection in turn."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from truing.estimation.bundle.intersection import Bundle, Mask, intersect
from truing.estimation.bundle.network import Array, Index
from truing.estimation.bundle.resection import FEWEST, Resection, resect

_ABREAST = 0.7  # images with so much of the best one's score are oriented in the same round
_HALF = 0.5  # of the points with coordinates must agree
_CELLS = 4  # per side of the format, to judge how points are spread


@dataclass(frozen=True)
class Grown:
    """Images and points of one pose as far as found: the rays with R and centre of their images (NaN where not
    oriented), cell (N,) of the format by number, given (P, 3) coordinates known beforehand (NaN elsewhere), X (P, 3)
    (NaN where not placed), which rays agree (N,) within tolerance_px, the interior (C, 10) in use, and per image tried
    in vain how many points with coordinates it saw and how many of them agreed."""

    rays: Bundle
    cell: Index
    given: Array
    X: Array
    agrees: Mask
    tolerance_px: float
    interior: Array
    failed: dict[int, tuple[int, int]]

    @property
    def oriented(self) -> Mask:
        """Which images (I,) have an orientation."""
        return np.isfinite(self.rays.centre[:, 0])

    def with_images(self, found: dict[int, tuple[Array, Array]]) -> Grown:
        """The same with some images oriented: (R, centre) by number."""
        R, centre = self.rays.R.copy(), self.rays.centre.copy()
        for i, (turn, place) in found.items():
            R[i], centre[i] = turn, place
        return replace(self, rays=replace(self.rays, R=R, centre=centre))


Refine = Callable[[Grown], Grown]


def grow(seed: Grown, rng: np.random.Generator, refine: Refine, most: int | None = None) -> Grown:
    """Return the pose with all images oriented that see enough points; with `most` given, stop at so many images.

    Next come the images that see the most points with coordinates over most of their format. `refine` adjusts what
    stands so far; it is called whenever the number of images has grown by half.
    """
    now, refined = seed, int(seed.oriented.sum())
    while most is None or now.oriented.sum() < most:
        waiting = _next_images(now)
        if not waiting:
            break
        tried = {i: _oriented(now, i) for i in waiting}
        good = {i: (found.R, found.centre) for i, found in tried.items() if isinstance(found, Resection)}
        now = replace(now, failed=now.failed | {i: t for i, t in tried.items() if not isinstance(t, Resection)})
        if good:
            now = intersected(now.with_images(good), rng)
        if now.oriented.sum() >= max(3, 1.5 * refined):
            now, refined = refine(now), int(now.oriented.sum())
    return refine(now) if now.oriented.sum() > refined else now


def intersected(now: Grown, rng: np.random.Generator) -> Grown:
    """Return the pose with all points placed that rays of two oriented images agree on, or that are given."""
    X, agrees = intersect(now.rays, now.tolerance_px, rng)
    as_given = np.isnan(X[:, 0]) & np.isfinite(now.given[:, 0])
    X = np.where(as_given[:, None], now.given, X)
    return replace(now, X=X, agrees=agrees | (as_given[now.rays.point] & now.rays.agree(X, now.tolerance_px)))


def _next_images(now: Grown) -> list[int]:
    """Return the images not yet oriented that come next: the best by number and spread of points with coordinates."""
    rays = now.rays
    usable = np.isfinite(now.X[rays.point, 0]) & np.isfinite(rays.direction[:, 0]) & ~now.oriented[rays.image]
    count = np.bincount(rays.image[usable], minlength=len(rays.R))
    cells = np.unique(np.stack([rays.image[usable], now.cell[usable]]), axis=1)[0]
    spread = np.bincount(cells, minlength=len(rays.R))
    tried = np.zeros(len(rays.R), int)
    tried[list(now.failed)] = [seen for seen, _ in now.failed.values()]
    score = np.where((count >= FEWEST) & (count > tried), np.sqrt(count) * spread, 0.0)
    return [int(i) for i in np.flatnonzero((score > 0) & (score >= _ABREAST * score.max(initial=0.0)))]


def _oriented(now: Grown, image: int) -> Resection | tuple[int, int]:
    """Return the orientation of an image, or how many points with coordinates it sees and how many of them agree."""
    rays = now.rays
    here = np.flatnonzero((rays.image == image) & np.isfinite(now.X[rays.point, 0]) & np.isfinite(rays.direction[:, 0]))
    found = resect(rays.direction[here], now.X[rays.point[here]], float(rays.scale_px[here[0]]), now.tolerance_px)
    if found is None:
        return len(here), 0
    agreeing = int(found.agrees.sum())
    return found if agreeing >= _HALF * len(here) else (len(here), agreeing)


def format_cells(xy_px: Array, width_px: Array, height_px: Array, per_side: int = _CELLS) -> Index:
    """Return the cell (N,) of the format, by number, in which image points xy_px (N, 2) lie."""
    xy = np.nan_to_num(xy_px)
    column = np.clip((xy[:, 0] + 0.5) / width_px * per_side, 0, per_side - 1).astype(int)
    row = np.clip((xy[:, 1] + 0.5) / height_px * per_side, 0, per_side - 1).astype(int)
    return row * per_side + column
