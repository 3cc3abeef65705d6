"""Where a pose's orientation can begin: known coordinates, two images, or a marker; and which beginning was best."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import islice

import numpy as np

from truing.estimation.bundle.growing import Grown, grow, intersected
from truing.estimation.bundle.network import Array, Index, Network
from truing.estimation.bundle.relative_orientation import FEWEST as FEWEST_COMMON
from truing.estimation.bundle.relative_orientation import Pair, common_points, relative_orientations
from truing.estimation.bundle.resection import FEWEST
from truing.estimation.bundle.start_refinement import longer_sides, prepare, refined

_FIELD_WIDTHS = (1.25, 0.85, 1.8, 2.6, 0.6, 4.0)  # principal distance over the longer side, the usual first
_FEW_SEEDS = 1  # beginnings tried with each field width before all are
_PAIRS = 12  # pairs of images whose relative orientation is tried
_BEST_PAIRS = 3  # of them that are grown
_GOOD_PAIR = 0.8  # of their common points agree, at a good angle: with so many such pairs no more are looked at
_TRIAL_IMAGES = 6  # up to which rival seeds are grown before one is chosen
_GOOD_ANGLE = np.radians(15.0)  # of intersection; more is no better to start from
_LEAST_ANGLE = np.radians(2.0)
_CLEAR_IMAGES = 0.6  # of the images that could be are oriented,
_CLEAR_SHARE = 0.6  # of an oriented image's rays agree, and
_CLEAR_PER_SIDE = 5e-4  # they miss by less than this part of the longer side: no rival is looked for
_SCORED_PER_SIDE = 5e-3  # a miss of this part of the longer side counts nothing


def usual_distance(network: Network) -> Array:
    """Return the principal distances (C,) in px of usual lenses."""
    return _FIELD_WIDTHS[0] * longer_sides(network)


def begin(network: Network, interior: Array, corners: Index, size_m: Array) -> Grown:
    """Return a pose, alone in its network, oriented as far as it goes, principal distances tried at several field
    widths where the given ones (C,) are NaN, or free and nothing comes of them."""
    best, best_score = prepare(network, np.nan_to_num(interior, nan=1.0)), -1.0
    for values, most in _interiors(network, interior):
        rng = np.random.default_rng(0)  # the same rays give the same start, whatever else is tried
        trial, score = _best_seed(network, prepare(network, values), corners, size_m, rng, most)
        clear = _is_clear(network, trial)
        if clear or score > best_score:
            best, best_score = trial, score
        if clear:
            break
    return grow(best, np.random.default_rng(0), lambda now: refined(network, now))


def _interiors(network: Network, interior: Array) -> Iterator[tuple[Array, int | None]]:
    """Return the interiors to be tried, each with how many beginnings: as given, then principal distances of several
    field widths, with few beginnings each and, where nothing comes of them, with all."""
    cameras = np.unique(network.image_camera)
    unknown = np.isnan(interior[cameras, 0])
    free = np.array(["c" in network.cameras[k].free for k in cameras], dtype=bool)
    if not unknown.any():
        yield interior, None
    doubtful = cameras[unknown] if unknown.any() else cameras[free]
    for most in (_FEW_SEEDS, None):
        for width in _FIELD_WIDTHS if len(doubtful) else ():
            values = interior.copy()
            values[doubtful, 0] = width * longer_sides(network)[doubtful]
            yield np.nan_to_num(values, nan=1.0), most


def _best_seed(
    network: Network, empty: Grown, corners: Index, size_m: Array, rng: np.random.Generator, most: int | None
) -> tuple[Grown, float]:
    """Return the best of all beginnings, or the first so many, grown to a few images, and its score."""
    best, best_score = empty, 0.0
    for seed in islice(_seeds(network, empty, corners, size_m, rng), most):
        trial = grow(seed, rng, lambda now: refined(network, now), _TRIAL_IMAGES)
        score = _score(network, trial)
        clear = _is_clear(network, trial)
        if clear or score > best_score:
            best, best_score = trial, score
        if clear:
            break
    return best, best_score


def _misses(now: Grown) -> Array:
    off, depth = now.rays.misses(now.X)
    with np.errstate(invalid="ignore"):
        return np.where(depth > 0, np.linalg.norm(off, axis=1), np.nan)


def _score(network: Network, now: Grown) -> float:
    """Return how many rays a beginning explains, those that it explains badly counted less."""
    several = np.bincount(now.rays.point[now.agrees], minlength=now.rays.points) >= 2
    many = (several | np.isfinite(now.given[:, 0]))[now.rays.point]
    limit = _SCORED_PER_SIDE * float(longer_sides(network).max())
    share = 1 - (np.nan_to_num(_misses(now), nan=np.inf) / limit) ** 2
    return float(np.maximum(share, 0.0)[many & now.agrees].sum())


def _is_clear(network: Network, now: Grown) -> bool:
    """Whether a beginning explains nearly all rays of enough images, and closely."""
    image, oriented = now.rays.image, now.oriented
    count = np.bincount(image, minlength=len(oriented))
    mine = oriented[image] & (
        np.bincount(now.rays.point[oriented[image]], minlength=now.rays.points)[now.rays.point] > 1
    )
    wanted = _CLEAR_IMAGES * min(_TRIAL_IMAGES, int((count >= FEWEST_COMMON).sum()))
    if not mine.any() or oriented.sum() < max(wanted, 2):
        return False
    close = float(np.median(_misses(now)[now.agrees])) if now.agrees.any() else np.inf
    return bool(now.agrees[mine].mean() > _CLEAR_SHARE and close < _CLEAR_PER_SIDE * longer_sides(network).max())


def _seeds(network: Network, empty: Grown, corners: Index, size_m: Array, rng: np.random.Generator) -> Iterator[Grown]:
    """Return all beginnings of a pose, the surest first."""
    known = np.full_like(empty.X, np.nan)
    known[network.known.point] = network.known.xyz_m
    yield from _from_coordinates(empty, known)
    yield from _from_pairs(empty, rng)
    square = np.array([[-0.5, -0.5, 0], [0.5, -0.5, 0], [0.5, 0.5, 0], [-0.5, 0.5, 0]])
    images = [_seeing(empty, four) for four in corners]
    for number in np.argsort([-len(seen) for seen in images], kind="stable")[:_BEST_PAIRS]:
        own = np.full_like(empty.X, np.nan)
        own[corners[number]] = square * size_m[number]
        yield from _from_coordinates(empty, own)


def _seeing(now: Grown, points: Index) -> Index:
    """Return the images that see all of some points."""
    hit = np.isin(now.rays.point, points)
    return np.flatnonzero(np.bincount(now.rays.image[hit], minlength=len(now.rays.R)) >= len(points))


def _from_coordinates(empty: Grown, given: Array) -> Iterator[Grown]:
    """Return the beginning from coordinates (P, 3), where an image sees enough of them."""
    seen = empty.rays.image[np.isfinite(given[empty.rays.point, 0])]
    if len(seen) and np.bincount(seen).max() >= FEWEST:
        yield replace(empty, given=given, X=given)


def _from_pairs(empty: Grown, rng: np.random.Generator) -> Iterator[Grown]:
    """Return beginnings from pairs of images, by how many points agree and at which angle their rays meet."""
    sound = np.isfinite(empty.rays.direction[:, 0])
    rays = empty.rays.of(sound)
    shared = np.triu(common_points(rays.image, rays.point, len(rays.R), rays.points))
    order = np.argsort(-shared, axis=None, kind="stable")[:_PAIRS]
    found: list[tuple[float, int, int, list[Pair]]] = []
    for i, j in zip(*np.unravel_index(order, shared.shape), strict=True):
        if shared[i, j] < FEWEST_COMMON:
            break
        a, b = np.flatnonzero(rays.image == i), np.flatnonzero(rays.image == j)
        _, at_a, at_b = np.intersect1d(rays.point[a], rays.point[b], return_indices=True)
        limit = empty.tolerance_px / float(rays.scale_px[a[0]])
        pairs = relative_orientations(rays.direction[a[at_a]], rays.direction[b[at_b]], limit)
        pairs = [pair for pair in pairs if pair.angle > _LEAST_ANGLE]
        if pairs:
            worth = max(pair.agreeing * min(pair.angle / _GOOD_ANGLE, 1.0) for pair in pairs)
            found.append((worth, int(i), int(j), pairs))
        if sum(one[0] > _GOOD_PAIR * shared[one[1], one[2]] for one in found) == _BEST_PAIRS:
            break
    found.sort(key=lambda one: -one[0])
    for _, i, j, pairs in found[:_BEST_PAIRS]:
        for pair in pairs:
            two = empty.with_images({i: (np.eye(3), np.zeros(3)), j: (pair.R, pair.centre)})
            yield intersected(two, rng)
