"""Match circles without a code across the images of an oriented network.

A circle seen in one image lies on a line in any other image (epipolar line, Longuet-Higgins 1981). Pairs within the
tolerance predicted from all covariances are intersected and searched in every image. The hypothesis that most images
support becomes a point; an image point claimed by two points belongs to neither (Maas 1992, for particles).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from truing.arrays import Array, Index, Mask
from truing.estimation.bundle.camera import Camera, directions
from truing.estimation.bundle.orientation import Bundle, nearest_points, refine_points, sums
from truing.estimation.rotation import skew

NO_PARTNER = "no other image shows a circle on its line of sight"
TOO_FEW = "too few images agree on a point"
AMBIGUOUS = "claimed by more than one point"
NOT_ORIENTED = "its image has no orientation"
MATCHED = ""
_PARTNERS = 6  # images with which an image's circles are paired
_FEWEST = 3  # images in which a point needs circles
_ALPHA = 0.001  # share of true partners that a single test loses
_GOOD_ANGLE = (np.radians(4.0), np.radians(60.0))  # between viewing directions of a pair


@dataclass(frozen=True)
class Circles:
    """Centres of circles without a code in the images of one pose: image (M,) by number, xy_px (M, 2), cov_px2 (M, 2,
    2)."""

    image: Index
    xy_px: Array
    cov_px2: Array


@dataclass(frozen=True)
class OrientedImages:
    """Images of one pose with their cameras: camera (I,) by number, R (I, 3, 3), centre (I, 3) in m (NaN if not
    oriented); covariance (I, 6, 6) of (centre, theta), interior (C, 10); box (2, 3) in m of the search."""

    cameras: Sequence[Camera]
    interior: Array
    camera: Index
    R: Array
    centre: Array
    covariance: Array
    box_m: Array


@dataclass(frozen=True)
class Matched:
    """Points found: point (M,) of each circle by number or -1, xyz_m (K, 3), cov_m2 (K, 3, 3); and per circle the
    reason (M,) for having no point, "" if it has one."""

    point: Index
    xyz_m: Array
    cov_m2: Array
    reason: tuple[str, ...]


def match_uncoded(circles: Circles, images: OrientedImages) -> Matched:
    """Return the points of circles without a code, for one pose."""
    usable = np.flatnonzero(np.isfinite(images.centre[circles.image, 0]))
    usable_circles = Circles(circles.image[usable], circles.xy_px[usable], circles.cov_px2[usable])
    rays = _circle_rays(usable_circles, images)
    pairs = _epipolar_pairs(rays, images)
    claims, has_partner = _hypotheses(pairs, rays, images)
    undisputed, contested = _undisputed(claims, len(usable))
    members = _members(undisputed)
    X, cov = _intersected_points(rays, images, members, len(undisputed))
    point = np.full(len(circles.image), -1, np.int64)
    reason = np.full(len(circles.image), NOT_ORIENTED, dtype=object)
    reason[usable] = np.where(contested, AMBIGUOUS, np.where(has_partner, TOO_FEW, NO_PARTNER))
    point[usable[members.circle]] = members.point
    reason[usable[members.circle]] = MATCHED
    return Matched(point, X, cov, tuple(reason.tolist()))


@dataclass(frozen=True)
class _CircleRays:
    """Circles as rays: image (M,), direction (M, 2) and its covariance (M, 2, 2), including that of the image's
    orientation."""

    image: Index
    direction: Array
    covariance: Array


@dataclass(frozen=True)
class _Members:
    """Pairs of a circle (L,) and its point (L,), both by number."""

    circle: Index
    point: Index


def _circle_rays(circles: Circles, images: OrientedImages) -> _CircleRays:
    camera = images.camera[circles.image]
    direction = directions(images.cameras, images.interior, camera, circles.xy_px)
    d = np.concatenate([direction, np.ones((len(direction), 1))], axis=1)
    middle = images.box_m.mean(axis=0)
    depth = np.einsum("nij,ni->nj", images.R[circles.image], middle - images.centre[circles.image])[:, 2:]
    J = _orientation_slope(images.R[circles.image], d * depth)
    variance = circles.cov_px2 / images.interior[camera, 0][:, None, None] ** 2
    return _CircleRays(circles.image, direction, variance + J @ images.covariance[circles.image] @ J.transpose(0, 2, 1))


def _orientation_slope(R: Array, u: Array) -> Array:
    """Return the derivatives (n, 2, 6) of X/Z, Y/Z of u = R^T (X - centre) by (centre, theta) of the image."""
    P = _projection_slope(u)
    Rt = R.transpose(0, 2, 1)
    return np.concatenate([-P @ Rt, P @ skew(u) @ Rt], axis=2)


def _projection_slope(u: Array) -> Array:
    """Return the derivative (n, 2, 3) of X/Z, Y/Z by u (n, 3)."""
    P = np.zeros((len(u), 2, 3))
    P[:, 0, 0] = P[:, 1, 1] = 1 / u[:, 2]
    P[:, :, 2] = -u[:, :2] / u[:, 2:] ** 2
    return P


def _partners(images: OrientedImages) -> list[tuple[int, int]]:
    """Return the pairs of images (i, j) whose rays meet at a good angle, a few per image."""
    view_direction: Array = images.box_m.mean(axis=0) - images.centre
    view_direction = view_direction / np.linalg.norm(view_direction, axis=1, keepdims=True)
    angle = np.arccos(np.clip(np.nan_to_num(view_direction @ view_direction.T, nan=1.0), -1.0, 1.0))
    has_good_angle = (angle > _GOOD_ANGLE[0]) & (angle < _GOOD_ANGLE[1])
    order = np.argsort(np.where(has_good_angle, angle, np.inf), axis=1)[:, :_PARTNERS]
    chosen = {(min(i, int(j)), max(i, int(j))) for i in range(len(order)) for j in order[i] if has_good_angle[i, j]}
    return sorted(chosen)


def _epipolar_pairs(rays: _CircleRays, images: OrientedImages) -> Index:
    """Return pairs of circles (L, 2) of different images whose rays meet within their tolerance."""
    from scipy.special import chdtri

    critical, pairs = float(chdtri(1, _ALPHA)), [np.empty((0, 2), np.int64)]
    groups = {int(i): np.flatnonzero(rays.image == i) for i in np.unique(rays.image)}
    homogeneous = np.concatenate([rays.direction, np.ones((len(rays.direction), 1))], axis=1)
    for i, j in _partners(images):
        if i not in groups or j not in groups:
            continue
        a, b = groups[i], groups[j]
        baseline = images.R[j].T @ (images.centre[i] - images.centre[j])
        E = skew(baseline) @ images.R[j].T @ images.R[i]
        lines_in_j, lines_in_i = (
            homogeneous[a] @ E.T,
            homogeneous[b] @ E,
        )  # epipolar lines of a in image j, of b in image i
        misclosure = lines_in_j @ homogeneous[b].T
        variance = np.einsum("ai,bij,aj->ab", lines_in_j[:, :2], rays.covariance[b], lines_in_j[:, :2], optimize=True)
        variance += np.einsum("bi,aij,bj->ab", lines_in_i[:, :2], rays.covariance[a], lines_in_i[:, :2], optimize=True)
        passing = np.argwhere(misclosure**2 < critical * variance)
        pairs.append(np.stack([a[passing[:, 0]], b[passing[:, 1]]], axis=1))
    return np.concatenate(pairs)


def _rays(circle_rays: _CircleRays, images: OrientedImages, members: _Members, points: int) -> Bundle:
    image = circle_rays.image[members.circle]
    scale = images.interior[images.camera[image], 0]
    return Bundle(
        image,
        members.point,
        circle_rays.direction[members.circle],
        scale,
        images.R,
        np.nan_to_num(images.centre),
        points,
    )


def _intersected_points(
    circle_rays: _CircleRays, images: OrientedImages, members: _Members, points: int
) -> tuple[Array, Array]:
    """Return points (K, 3) from their members' rays and their covariance (K, 3, 3)."""
    rays = _rays(circle_rays, images, members, points)
    ones = np.ones(len(members.circle))
    X = refine_points(rays, np.nan_to_num(nearest_points(rays, ones)[0]), ones)
    u = np.einsum("nji,nj->ni", rays.R[rays.image], X[rays.point] - rays.centre[rays.image])
    with np.errstate(all="ignore"):
        J = _projection_slope(u) @ rays.R[rays.image].transpose(0, 2, 1)
    W = np.linalg.inv(circle_rays.covariance[members.circle])
    N = sums(rays.point, np.nan_to_num(J.transpose(0, 2, 1) @ W @ J), points)
    trace = np.einsum("pii->p", N)[:, None, None]
    is_singular = ~(np.linalg.det(N / np.where(trace > 0, trace, 1.0)) > 1e-15)
    N[is_singular] = np.eye(3)
    cov = np.asarray(np.linalg.inv(N), float)
    X[is_singular] = np.nan
    return X, cov


def _hypotheses(pairs: Index, rays: _CircleRays, images: OrientedImages) -> tuple[Index, Mask]:
    """Return the circle (H, I) of each hypothetical point in each image (-1: none), with duplicates merged, and the
    circles (M,) that have any partner."""
    has_partner = np.zeros(len(rays.image), bool)
    members = _Members(pairs.ravel(), np.repeat(np.arange(len(pairs)), 2))
    X, cov = _intersected_points(rays, images, members, len(pairs))
    with np.errstate(invalid="ignore"):
        is_in_box = np.all((X - images.box_m[0]) * (images.box_m[1] - X) >= 0, axis=1)
    has_partner[pairs[is_in_box].ravel()] = True
    claims = _found_in_all(X[is_in_box], cov[is_in_box], rays, images)
    for _ in range(2):
        claims = np.unique(claims[(claims >= 0).sum(axis=1) >= _FEWEST], axis=0)
        X, cov = _intersected_points(rays, images, _members(claims), len(claims))
        claims = _found_in_all(X, cov, rays, images)
    claims = np.unique(claims[(claims >= 0).sum(axis=1) >= _FEWEST], axis=0)
    return claims, has_partner


def _members(claims: Index) -> _Members:
    point, image = np.nonzero(claims >= 0)
    return _Members(claims[point, image], point.astype(np.int64))


def _found_in_all(X: Array, cov: Array, rays: _CircleRays, images: OrientedImages) -> Index:
    """Return the circle (H, I) found in each image at the predicted position of the points (H, 3), -1 if none."""
    from scipy.spatial import cKDTree
    from scipy.special import chdtri

    critical = float(chdtri(2, _ALPHA))
    claims = np.full((len(X), len(images.R)), -1, np.int64)
    for i in np.unique(rays.image):
        circles_of_image = np.flatnonzero(rays.image == i)
        u = (X - images.centre[i]) @ images.R[i]
        in_front = np.flatnonzero(u[:, 2] > 0)
        predicted = u[in_front, :2] / u[in_front, 2:]
        _, nearest = cKDTree(rays.direction[circles_of_image]).query(predicted)
        circle = circles_of_image[nearest]
        J = _projection_slope(u[in_front]) @ images.R[i].T
        S = J @ cov[in_front] @ J.transpose(0, 2, 1) + rays.covariance[circle]
        residual = rays.direction[circle] - predicted
        passing = np.einsum("hi,hi->h", residual, np.linalg.solve(S, residual[..., None])[..., 0]) < critical
        claims[in_front[passing], i] = circle[passing]
    return claims


def _undisputed(claims: Index, circles: int) -> tuple[Index, Mask]:
    """Return the accepted hypotheses (K, I), and the circles (M,) claimed by more than one. Two hypotheses that share
    circles in two images are the same point; the better supported one is kept. A circle shared by two points is
    assigned to the better supported one, or to neither if they are equal; points with too few circles are dropped."""
    from scipy.sparse import csr_array

    support = (claims >= 0).sum(axis=1)
    order = np.lexsort((*claims.T[::-1], -support)) if len(claims) else np.empty(0, int)
    claims, support = claims[order], support[order]
    members = _members(claims)
    B = csr_array((np.ones(len(members.circle)), (members.point, members.circle)), shape=(len(claims), circles))
    common_circles = (B @ B.T).tocoo()
    is_duplicate = (common_circles.data >= 2) & (common_circles.row > common_circles.col)  # the other one has priority
    is_accepted = np.ones(len(claims), bool)
    is_accepted[common_circles.row[is_duplicate]] = False
    contested = np.zeros(circles, bool)
    while True:
        is_candidate = is_accepted[members.point]
        weight = np.where(is_candidate, support[members.point], 0)
        best_support = np.zeros(circles, np.int64)
        np.maximum.at(best_support, members.circle, weight)
        is_best = is_candidate & (weight == best_support[members.circle])
        is_sole = np.bincount(members.circle[is_best], minlength=circles)[members.circle] == 1
        circle_count = np.bincount(members.point[is_best & is_sole], minlength=len(claims))
        is_rejected = is_accepted & (circle_count < _FEWEST)
        if not is_rejected.any():
            break
        is_rejected &= support == support[is_rejected].min()
        contested[claims[is_rejected][claims[is_rejected] >= 0]] = True
        is_accepted &= ~is_rejected
    claimants = np.bincount(members.circle[is_accepted[members.point]], minlength=circles)
    undisputed = np.where((claims >= 0) & (claimants[np.maximum(claims, 0)] > 1), -1, claims)[is_accepted]
    contested |= claimants > 1
    return undisputed[(undisputed >= 0).sum(axis=1) >= _FEWEST], contested
