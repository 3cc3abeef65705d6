"""Points from rays of oriented images: intersection of all points at once, tolerant of wrong rays."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from truing.estimation.bundle.network import Array, Index, Mask

_TRIALS = 12  # pairs of rays tried per point
_STEPS = 4  # of Gauss and Newton on the image coordinates
LEAST_ANGLE = np.radians(2.0)  # rays that meet at less say nothing of the depth


@dataclass(frozen=True)
class Bundle:
    """Rays of oriented images: image (N,) and point (N,) by number, direction (N, 2) as X/Z and Y/Z in the camera's
    frame, scale_px (N,) the principal distance; R (I, 3, 3) and centre (I, 3) of the images, how many points (P)."""

    image: Index
    point: Index
    direction: Array
    scale_px: Array
    R: Array
    centre: Array
    points: int

    def of(self, rays: Array | Index) -> Bundle:
        """The same images with some of the rays (mask or numbers)."""
        chosen = (self.image[rays], self.point[rays], self.direction[rays], self.scale_px[rays])
        return Bundle(*chosen, self.R, self.centre, self.points)

    def lines(self) -> Array:
        """Unit vectors (N, 3) along the rays in the measurement frame."""
        d = np.concatenate([self.direction, np.ones((len(self.direction), 1))], axis=1)
        d = np.einsum("nij,nj->ni", self.R[self.image], d)
        return d / np.linalg.norm(d, axis=1, keepdims=True)

    def misses(self, X: Array) -> tuple[Array, Array]:
        """How far (N, 2) the rays miss their points X (P, 3), in ideal pixels, and the points' depths (N,)."""
        seen, _ = self._seen(X)
        with np.errstate(all="ignore"):
            return (seen[:, :2] / seen[:, 2:] - self.direction) * self.scale_px[:, None], seen[:, 2]

    def agree(self, X: Array, tolerance_px: float | Array) -> Mask:
        """Which rays (N,) pass their points within the tolerance, the point in front of the camera."""
        off, depth = self.misses(X)
        with np.errstate(invalid="ignore"):
            return (depth > 0) & (np.einsum("ni,ni->n", off, off) < np.square(tolerance_px))

    def _seen(self, X: Array) -> tuple[Array, Array]:
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
    """Return the points (P, 3) nearest to their weighted rays, NaN where the rays are parallel, and how well rays
    meet (P,): the least eigenvalue of the sum of 1 - d d^T, which is 1 - cos(angle) for two rays."""
    d = bundle.lines()
    across = (np.eye(3) - d[:, :, None] * d[:, None, :]) * weight[:, None, None]
    A = sums(bundle.point, across, bundle.points)
    b = sums(bundle.point, np.einsum("nij,nj->ni", across, bundle.centre[bundle.image]), bundle.points)
    meet = np.asarray(np.linalg.eigvalsh(A)[:, 0], float)
    solvable = meet > 1e-9
    X = np.full((bundle.points, 3), np.nan)
    X[solvable] = np.linalg.solve(A[solvable], b[solvable][..., None])[..., 0]
    return X, meet


def refine_points(bundle: Bundle, X: Array, weight: Array) -> Array:
    """Return points (P, 3) after Gauss-Newton steps on their rays' image coordinates, weighted (N,)."""
    for _ in range(_STEPS):
        seen, R = bundle._seen(X)
        with np.errstate(all="ignore"):
            a = seen[:, :2] / seen[:, 2:]
            J = (R[:, :, :2] - R[:, :, 2:] * a[:, None, :]) / seen[:, 2, None, None] * bundle.scale_px[:, None, None]
        v = (bundle.direction - a) * bundle.scale_px[:, None]
        sound = np.isfinite(J).all(axis=(1, 2)) & (weight > 0)
        w = np.where(sound, weight, 0.0)
        J, v = np.where(sound[:, None, None], J, 0.0), np.where(sound[:, None], v, 0.0)
        N = sums(bundle.point, np.einsum("nik,njk,n->nij", J, J, w), bundle.points)
        b = sums(bundle.point, np.einsum("nik,nk,n->ni", J, v, w), bundle.points)
        size = np.einsum("pii->p", N)
        solvable = np.linalg.det(N / np.where(size > 0, size, 1.0)[:, None, None]) > 1e-12
        step = np.zeros_like(X)
        step[solvable] = np.linalg.solve(N[solvable], b[solvable][..., None])[..., 0]
        X = X + step
    return X


def intersect(bundle: Bundle, tolerance_px: float, rng: np.random.Generator) -> tuple[Array, Mask]:
    """Return the points (P, 3), NaN where fewer than two rays agree or none meet at an angle, and which rays agree.

    Per point several pairs of its rays are tried; the pair that most other rays pass within the tolerance wins.
    """
    usable = np.isfinite(bundle.direction).all(axis=1) & np.isfinite(bundle.centre[bundle.image]).all(axis=1)
    numbers = np.flatnonzero(usable)
    order = numbers[np.argsort(bundle.point[numbers], kind="stable")]
    rays = bundle.of(order)
    count = np.bincount(rays.point, minlength=bundle.points)
    first = np.cumsum(count) - count
    many = np.flatnonzero(count >= 2)
    best, cost = np.full((bundle.points, 3), np.nan), np.full(bundle.points, np.inf)
    for _ in range(_TRIALS if (count > 2).any() else 1):
        a = rng.integers(0, count[many])
        b = (a + 1 + rng.integers(0, count[many] - 1)) % count[many]
        pair = rays.of(np.concatenate([first[many] + a, first[many] + b]))
        X, _ = nearest_points(pair, np.ones(2 * len(many)))
        off, depth = rays.misses(X)
        with np.errstate(invalid="ignore"):
            square = np.einsum("ni,ni->n", off, off) / tolerance_px**2
            square = np.where((depth > 0) & (square < 1), square, 1.0)
        now = np.bincount(rays.point, square, minlength=bundle.points)
        better = np.isfinite(X[:, 0]) & (now < cost)
        best[better], cost[better] = X[better], now[better]
    agrees = rays.agree(best, tolerance_px)
    for _ in range(2):
        X = refine_points(rays, np.nan_to_num(best), agrees.astype(float))
        agrees = rays.agree(X, tolerance_px)
    meet = nearest_points(rays, agrees.astype(float))[1]
    placed = np.isfinite(best[:, 0]) & (meet > 1 - np.cos(LEAST_ANGLE))
    placed &= np.bincount(rays.point, agrees, minlength=bundle.points) >= 2
    X[~placed] = np.nan
    whole = np.zeros(len(bundle.image), bool)
    whole[order] = agrees & placed[rays.point]
    return X, whole
