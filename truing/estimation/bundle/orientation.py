"""Orientation without adjustment: resection, relative orientation, and intersection of rays.

An image is oriented from points with coordinates, or relative to another image of the same points, both by consensus
(OpenCV). A resection is refined by least squares with bounded influence. Flat points allow several relative
orientations; all are returned. Points are intersected all at once; wrong rays are tolerated.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from truing.arrays import Array, Index, Mask
from truing.estimation.bundle.kernel_arguments import RayPairs, SortedRays
from truing.estimation.rotation import exp_so3, skew

_TRIALS = 12  # pairs of rays tried per point
_STEPS = 4  # Gauss-Newton steps on the image coordinates
LEAST_ANGLE = np.radians(2.0)  # rays that meet at a smaller angle do not determine the depth
FEWEST_POINTS = 4  # three points leave up to four solutions, the fourth chooses one
_SAMPLES = 300
_RESECTION_STEPS = 8
FEWEST_COMMON = 6  # common points: five leave up to ten solutions, the sixth chooses one
_RIVAL = 0.7  # share of the best solution's agreeing points for a rival to be kept


@dataclass(frozen=True)
class Bundle:
    """Rays of oriented images: image (N,) and point (N,) by number, direction (N, 2) as X/Z and Y/Z in the camera's
    frame, scale_px (N,) the principal distance; R (I, 3, 3) and centre (I, 3) of the images, number of points (P)."""

    image: Index
    point: Index
    direction: Array
    scale_px: Array
    R: Array
    centre: Array
    points: int

    def of(self, rays: Array | Index) -> Bundle:
        """Return the same images with some of the rays (mask or numbers)."""
        chosen = (self.image[rays], self.point[rays], self.direction[rays], self.scale_px[rays])
        return Bundle(*chosen, self.R, self.centre, self.points)

    def lines(self) -> Array:
        """Return unit vectors (N, 3) along the rays in the measurement frame."""
        d = np.concatenate([self.direction, np.ones((len(self.direction), 1))], axis=1)
        d = np.einsum("nij,nj->ni", self.R[self.image], d)
        return d / np.linalg.norm(d, axis=1, keepdims=True)

    def ray_distances(self, X: Array) -> tuple[Array, Array]:
        """Return the distance (N, 2) of rays from their points X (P, 3) in ideal pixels, and the depths (N,) of the
        points."""
        in_camera, _ = self._in_camera_frame(X)
        with np.errstate(all="ignore"):
            return (in_camera[:, :2] / in_camera[:, 2:] - self.direction) * self.scale_px[:, None], in_camera[:, 2]

    def agreeing_rays(self, X: Array, tolerance_px: float | Array) -> Mask:
        """Return the rays (N,) that pass their points within the tolerance, with the point in front of the camera."""
        residual_px, depth = self.ray_distances(X)
        with np.errstate(invalid="ignore"):
            return (depth > 0) & (np.einsum("ni,ni->n", residual_px, residual_px) < np.square(tolerance_px))

    def _in_camera_frame(self, X: Array) -> tuple[Array, Array]:
        R = self.R[self.image]
        return np.einsum("nji,nj->ni", R, X[self.point] - self.centre[self.image]), R


def sums(index: Index, values: Array, count: int) -> Array:
    """Return the sums (count, ...) of values (N, ...) that share an index."""
    flat = values.reshape(len(index), int(np.prod(values.shape[1:])))
    total = np.zeros((count, flat.shape[1]))
    for k in range(flat.shape[1]):
        total[:, k] = np.bincount(index, flat[:, k], minlength=count)
    return total.reshape(count, *values.shape[1:])


def nearest_points(bundle: Bundle, weight: Array) -> tuple[Array, Array]:
    """Return the points (P, 3) nearest to their weighted rays, NaN for parallel rays, and the quality of intersection
    (P,).

    The quality is the least eigenvalue of the sum of 1 - d d^T, which is 1 - cos(angle) for two rays.
    """
    A, quality, projector = _crossing(bundle, weight)
    b = sums(bundle.point, np.einsum("nij,nj->ni", projector, bundle.centre[bundle.image]), bundle.points)
    solvable = quality > 1e-9
    X = np.full((bundle.points, 3), np.nan)
    X[solvable] = np.linalg.solve(A[solvable], b[solvable][..., None])[..., 0]
    return X, quality


def _crossing(bundle: Bundle, weight: Array) -> tuple[Array, Array, Array]:
    """Return the sums (P, 3, 3) of 1 - d d^T over the weighted rays of each point; their least eigenvalues (P,); and
    the terms (N, 3, 3)."""
    d = bundle.lines()
    projector = (np.eye(3) - d[:, :, None] * d[:, None, :]) * weight[:, None, None]
    A = sums(bundle.point, projector, bundle.points)
    return A, np.asarray(np.linalg.eigvalsh(A)[:, 0], float), projector


def refine_points(bundle: Bundle, X: Array, weight: Array) -> Array:
    """Return points (P, 3) after Gauss-Newton steps on their rays' image coordinates, weighted (N,)."""
    from truing.estimation.bundle.intersection_kernels import refine_steps

    order = np.argsort(bundle.point, kind="stable")
    points = np.array(X, float)
    with np.errstate(all="ignore"):
        refine_steps(_by_point(bundle.of(order)), weight[order], _STEPS, points)
    return points


def _by_point(rays: Bundle) -> SortedRays:
    """Return rays, which are sorted by point, for the compiled kernels."""
    first = np.searchsorted(rays.point, np.arange(rays.points + 1))
    R, centre = rays.R[rays.image], rays.centre[rays.image]
    return SortedRays(np.ascontiguousarray(rays.direction), rays.scale_px, R, centre, first)


def intersect(bundle: Bundle, tolerance_px: float, rng: np.random.Generator) -> tuple[Array, Mask]:
    """Return the points (P, 3) and the rays that agree; NaN if fewer than two rays agree or their angle is too small.

    For each point several pairs of rays are tried; the pair that most other rays support within the tolerance wins.
    """
    from truing.estimation.bundle.intersection_kernels import try_pairs

    usable = np.isfinite(bundle.direction).all(axis=1) & np.isfinite(bundle.centre[bundle.image]).all(axis=1)
    numbers = np.flatnonzero(usable)
    order = numbers[np.argsort(bundle.point[numbers], kind="stable")]
    rays = bundle.of(order)
    count = np.bincount(rays.point, minlength=bundle.points)
    first = np.cumsum(count) - count
    intersectable = np.flatnonzero(count >= 2)
    best, cost = np.full((bundle.points, 3), np.nan), np.full(bundle.points, np.inf)
    unit_rays, sorted_rays = rays.lines(), _by_point(rays)
    for _ in range(_TRIALS if (count > 2).any() else 1):
        a = rng.integers(0, count[intersectable])
        b = (a + 1 + rng.integers(0, count[intersectable] - 1)) % count[intersectable]
        pairs = RayPairs(intersectable, first[intersectable] + a, first[intersectable] + b)
        try_pairs(unit_rays, sorted_rays, pairs, tolerance_px, best, cost)
    inliers = rays.agreeing_rays(best, tolerance_px)
    for _ in range(2):
        X = refine_points(rays, np.nan_to_num(best), inliers.astype(float))
        inliers = rays.agreeing_rays(X, tolerance_px)
    quality = _crossing(rays, inliers.astype(float))[1]
    is_determined = np.isfinite(best[:, 0]) & (quality > 1 - np.cos(LEAST_ANGLE))
    is_determined &= np.bincount(rays.point, inliers, minlength=bundle.points) >= 2
    X[~is_determined] = np.nan
    is_intersected = np.zeros(len(bundle.image), bool)
    is_intersected[order] = inliers & is_determined[rays.point]
    return X, is_intersected


@dataclass(frozen=True)
class Resection:
    """Orientation of an image: R (3, 3) from camera axes to measurement axes, centre (3,), agreeing points (n,)."""

    R: Array
    centre: Array
    agrees: Mask


def resect(direction: Array, X: Array, scale_px: float, tolerance_px: float) -> Resection | None:
    """Return the orientation of the image that sees points X (n, 3) at X/Z, Y/Z (n, 2), or None if too few agree.

    scale_px: principal distance, which converts the tolerance to directions.
    """
    import cv2

    if len(X) < FEWEST_POINTS:
        return None
    origin, size = np.median(X, axis=0), max(float(np.abs(X - np.median(X, axis=0)).max()), 1e-12)
    local = np.ascontiguousarray((X - origin) / size)
    image = np.ascontiguousarray(direction)
    limit = tolerance_px / scale_px
    try:
        succeeded, rotation_vector, shift, ransac_inliers = cv2.solvePnPRansac(
            local, image, np.eye(3), None,
            iterationsCount=_SAMPLES, reprojectionError=limit, confidence=0.9999, flags=cv2.SOLVEPNP_AP3P,
        )  # fmt: skip
    except cv2.error:
        return None
    if not succeeded or ransac_inliers is None or len(ransac_inliers) < FEWEST_POINTS:
        return None
    best = _refined_motion(cv2.Rodrigues(rotation_vector)[0].T, shift.ravel(), image, local, limit)
    members = np.ravel(ransac_inliers)
    if len(members) > FEWEST_POINTS:
        for rotation_vector, shift in _resect_all_points(local[members], image[members]):
            candidate = _refined_motion(cv2.Rodrigues(rotation_vector)[0].T, shift.ravel(), image, local, limit)
            best = min(best, candidate, key=_bounded_misses)
    R, t, residual, depth = best
    inliers = (depth > 0) & (residual < limit)
    if inliers.sum() < FEWEST_POINTS:
        return None
    return Resection(R, origin - R @ t * size, inliers)


def _resect_all_points(X: Array, direction: Array) -> list[tuple[Array, Array]]:
    """Return orientations from all points at once, as rotation vector and shift; empty if OpenCV reports that the
    points do not determine one."""
    import cv2

    try:
        succeeded, rotations, shifts, _ = cv2.solvePnPGeneric(X, direction, np.eye(3), None, flags=cv2.SOLVEPNP_SQPNP)
    except cv2.error:
        return []
    return list(zip(rotations, shifts, strict=True)) if succeeded else []


def _bounded_misses(relative_pose: tuple[Array, Array, Array, Array]) -> float:
    """Return the sum of an orientation's residuals, each limited to three times the median."""
    residual, depth = relative_pose[2], relative_pose[3]
    median = np.median(residual)
    return float(np.where(depth > 0, np.minimum(residual, 3 * median + 1e-12), 1e3).sum())


def _refined_motion(R: Array, t: Array, direction: Array, X: Array, limit: float) -> tuple[Array, Array, Array, Array]:
    """Return R, t of u = R^T X + t after Gauss-Newton on the points within the limit, the residuals (n,) and depths
    (n,)."""
    for step in range(_RESECTION_STEPS + 1):
        in_camera = X @ R + t
        with np.errstate(all="ignore"):
            a = in_camera[:, :2] / in_camera[:, 2:]
            residual = np.nan_to_num(np.linalg.norm(a - direction, axis=1), nan=1e3, posinf=1e3)
        if step == _RESECTION_STEPS:
            break
        w = ((residual < limit) & (in_camera[:, 2] > 0)).astype(float)
        if w.sum() < 3:
            break
        P = np.zeros((len(X), 2, 3))
        with np.errstate(all="ignore"):
            P[:, 0, 0] = P[:, 1, 1] = 1 / in_camera[:, 2]
            P[:, :, 2] = -a / in_camera[:, 2:]
        P[w == 0] = 0.0
        J = np.concatenate([P, -P @ skew(in_camera - t)], axis=2)
        N = np.einsum("nki,nkj->ij", J, J)
        step_ = np.linalg.lstsq(
            N, np.einsum("nki,nk->i", J, np.where(w[:, None] > 0, direction - a, 0.0)), rcond=1e-12
        )[0]
        t = t + step_[:3]
        R = R @ exp_so3(step_[3:]).T
    return R, t, residual, in_camera[:, 2]


@dataclass(frozen=True)
class ImagePair:
    """Second image relative to the first, with a base of length one: R (3, 3) from the second camera's axes to the
    first's, centre (3,); number of agreeing points, and the median angle (rad) at which their rays meet."""

    R: Array
    centre: Array
    agreeing: int
    angle: float


def common_points(image: Index, point: Index, images: int, points: int) -> Array:
    """Return the number of common points (I, I) of each pair of images."""
    from scipy.sparse import csr_array

    incidence = csr_array((np.ones(len(image)), (image, point)), shape=(images, points))
    incidence.data[:] = 1.0  # a point measured twice in an image counts once
    counts = (incidence @ incidence.T).toarray()
    np.fill_diagonal(counts, 0.0)
    return counts


def relative_orientations(first: Array, second: Array, limit: float) -> list[ImagePair]:
    """Return relative orientations of two images that explain common points at X/Z, Y/Z (n, 2), best first.

    From the essential matrix by five points (Nister 2004) and the homography of flat points (Malis and Vargas 2007);
    both by consensus within the limit (in units of X/Z). Flat fields leave rivals that a third image decides.
    """
    if len(first) < FEWEST_COMMON:
        return []
    orientations = [
        pair for R, t in _motions(first, second, limit) if (pair := _supporting_points(R, t, first, second, limit))
    ]
    orientations.sort(key=lambda pair: -pair.agreeing)
    image_pairs: list[ImagePair] = []
    for pair in orientations:
        is_supported = pair.agreeing >= max(FEWEST_COMMON, _RIVAL * orientations[0].agreeing)
        if is_supported and all(np.abs(pair.R - image_pair.R).max() > 0.02 for image_pair in image_pairs):
            image_pairs.append(pair)
    return image_pairs


def _motions(first: Array, second: Array, limit: float) -> list[tuple[Array, Array]]:
    """Return (R, t) with x2 ~ R x1 + t of all solutions and signs."""
    import cv2

    a, b = np.ascontiguousarray(first), np.ascontiguousarray(second)
    motions: list[tuple[Array, Array]] = []
    try:
        essential, _ = cv2.findEssentialMat(a, b, np.eye(3), cv2.RANSAC, 0.9999, limit)
    except cv2.error:
        essential = None
    for E in [] if essential is None else np.split(essential, len(essential) // 3):
        R1, R2, t = cv2.decomposeEssentialMat(E)
        motions += [(R, sign * t.ravel()) for R in (R1, R2) for sign in (1.0, -1.0)]
    return motions + _motions_of_a_plane(a, b, limit)


def _motions_of_a_plane(a: Array, b: Array, limit: float) -> list[tuple[Array, Array]]:
    import cv2

    try:
        H, _ = cv2.findHomography(a, b, cv2.RANSAC, limit, maxIters=100)
        rotations, shifts = ((), ()) if H is None else cv2.decomposeHomographyMat(H, np.eye(3))[1:3]
    except cv2.error:  # degenerate points
        return []
    return [(R, s * t.ravel()) for R, t in zip(rotations, shifts, strict=True) for s in (1.0, -1.0)]


def _supporting_points(R: Array, t: Array, first: Array, second: Array, limit: float) -> ImagePair | None:
    """Return the motion with the number of points that it explains in front of both cameras; None if the rays are
    nearly parallel."""
    base = np.linalg.norm(t)
    if not base > 1e-9:
        return None
    n = len(first)
    R_second, centre = R.T, -R.T @ t / base
    rays = Bundle(
        np.repeat([0, 1], n), np.tile(np.arange(n), 2), np.concatenate([first, second]), np.ones(2 * n),
        np.stack([np.eye(3), R_second]), np.stack([np.zeros(3), centre]), n,
    )  # fmt: skip
    X, quality = nearest_points(rays, np.ones(2 * n))
    inliers = rays.agreeing_rays(X, limit).reshape(2, n).all(axis=0)
    if not inliers.any():
        return None
    angle = float(np.median(np.arccos(np.clip(1 - quality[inliers], -1.0, 1.0))))
    return ImagePair(R_second, centre, int(inliers.sum()), angle)
