"""Least-squares fit of a scan to a reference surface, with covariance: last step of a registration.

Chen and Medioni, Image and Vision Computing 10 (1992) 145, with paraboloids instead of tangent planes: a curved surface
departs from its tangent plane by more than the remaining noise of a dense scan; from a paraboloid through the
neighbours it does not. The paraboloid fit is a linear smoother, so the weight of each neighbour in a height is known.
The noise of both clouds is independent from point to point. Its propagation through the smoothing is exact, including
the correlation of neighbouring heights, which share neighbours.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from truing.estimation.rotation import exp_so3, rigid_motions

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

_GATE = 4.5
# Converged once a step is below this share of its own standard deviation.
_SETTLED = 0.1
# Before convergence heights scatter more than this, relative to their noise: the gate widens with them.
_ON_THE_WAY = 1.5
# A direction is unobservable if its information is below this multiple of the spurious one from errors of the normals.
_FEIGNED = 4.0
# Errors of normals that are not noise, rad: misfit of paraboloids to a smooth surface.
_SHAPE_ERROR = 1e-3
_BLOCKS_PER_SIDE = 6
_FEWEST = 12
_FULL_STEPS = 6
# Variances of patches, averaged over a neighbourhood, differ by chance by less than this factor.
_CLEARLY = 2.0
NEIGHBOURS = 14
_COEFFICIENTS = 6
# Median of chi-square with 8 degrees of freedom, over 8: converts a median of variances to their mean.
_MEDIAN_OF_VARIANCE = 0.9180
# A patch with this many times the median scatter is invalid: an edge, a border of two parts, clutter.
_ROUGH = 5.0
# Within this share of a patch's radius a point is over the surface, beyond it is next to the surface.
_OVER, _BESIDE = 0.7, 1.5
_CHUNK = 20_000


@dataclass(frozen=True)
class ScanPair:
    """Surface of the reference (M, 3) and scan (N, 3), both about their centroids; m. Noise along the normals in m."""

    surface: Surface
    scan: NDArray
    sigma_reference: float
    sigma_scan: float

    @property
    def reference(self) -> NDArray:
        """Points (M, 3) of the reference."""
        return self.surface.points

    @property
    def size(self) -> float:
        """Diagonal in m of the reference's box."""
        return float(np.linalg.norm(np.ptp(self.reference, axis=0)))


@dataclass(frozen=True)
class SurfaceFit:
    """Result of least squares: motion of the reference into the scan's frame, with statistics."""

    R: NDArray  # (3, 3) R_measurement_reference
    t: NDArray  # (3,) m
    covariance: NDArray | None  # (6, 6) of (t, theta), R <- exp(theta) R, in the scan's frame; None if a motion is free
    free: NDArray  # (d, 6) motions (t, theta) that the surface leaves free
    used: NDArray  # (N,) scan points over a smooth part of the reference, and within the gate
    cost: NDArray  # (N,) squared height over its noise, limited at the gate; next to the surface, that limit
    informative: NDArray  # (N,) whether the cost is informative: over the surface or next to it
    rms: float  # m, of their heights
    scatter: float  # robust, of the heights over the surface, relative to their noise
    noise_ratio: float  # the same for sums over regions; scales the covariance if above 1
    converged: bool


@dataclass(frozen=True)
class _View:
    heights: Heights
    patches: Patches
    which: NDArray  # (N,) patch below each scan point
    J: NDArray  # (N, 6) minus the derivative of the heights with respect to (t, theta)
    used: NDArray  # (N,)
    cost: NDArray  # (N,)
    scatter: float


def fit_surface(scene: ScanPair, R: NDArray, t: NDArray, max_steps: int = 40) -> SurfaceFit:
    """Return the motion near a start R (3, 3), t (3,) with the least scan heights over the reference."""
    view, converged, steps = _view(scene, R, t), False, 0
    while steps < max_steps and not converged and np.count_nonzero(view.used) >= _FEWEST:
        information, motions = _motions(scene, view, t)
        height = view.heights.height[view.used]
        along = np.where(information > _FEIGNED, motions @ (view.J[view.used].T @ height) / information, 0.0)
        # Points that change their patch at every step cause a cycle: ever shorter steps end in its middle.
        along *= min(1.0, _FULL_STEPS / (steps + 1))
        converged = bool(information @ along**2 <= 6 * _SETTLED**2 * np.mean(height**2))
        delta = along @ motions
        R, t, steps = exp_so3(delta[3:]) @ R, t + delta[:3], steps + 1
        view = _view(scene, R, t)
    return _surface_fit(scene, R, t, view, converged)


def _view(scene: ScanPair, R: NDArray, t: NDArray) -> _View:
    inside = (scene.scan - t) @ R
    _, nearest = scene.surface.tree.query(inside, workers=workers_for(len(inside)))
    anchors, which = np.unique(nearest, return_inverse=True)
    patches = scene.surface.patches(anchors)
    heights = heights_over(patches, which, inside, scene.sigma_scan)
    normal = heights.normal @ R.T
    relative = np.abs(heights.height) / _noise(scene, heights)
    scatter = float(np.median(relative[heights.over])) / 0.6745 if np.any(heights.over) else np.inf
    gate = _GATE * (scatter if scatter > _ON_THE_WAY else 1.0)
    J = np.concatenate([normal, np.cross(scene.scan - t, normal)], axis=1)
    cost = np.where(heights.beside, _GATE, np.minimum(relative, _GATE)) ** 2
    return _View(heights, patches, which, J, heights.over & (relative <= gate), cost, scatter)


def _noise(scene: ScanPair, heights: Heights) -> NDArray:
    """Return the standard deviation (N,) in m of each height."""
    return np.sqrt(scene.sigma_scan**2 + scene.sigma_reference**2 * np.sum(heights.share**2, -1))


def _surface_fit(scene: ScanPair, R: NDArray, t: NDArray, view: _View, converged: bool) -> SurfaceFit:
    used, heights = view.used, view.heights
    height = heights.height[used]
    rms = float(np.sqrt(np.mean(height**2))) if np.any(used) else 0.0
    information, motions = _motions(scene, view, t) if np.count_nonzero(used) >= _FEWEST else (np.zeros(6), np.eye(6))
    free, covariance, ratio = motions[information <= _FEIGNED], None, 1.0
    if len(free) == 0:
        J, middle = view.J[used], _gradient_covariance(scene, view)
        inverse = np.linalg.inv(J.T @ J)
        ratio = _noise_ratio(scene.scan[used], J, height, middle)
        covariance = max(ratio, 1.0) ** 2 * inverse @ middle @ inverse
    return SurfaceFit(
        R,
        t,
        covariance,
        free,
        used,
        view.cost,
        heights.over | heights.beside,
        rms,
        view.scatter,
        ratio,
        converged,
    )


def _gradient_covariance(scene: ScanPair, view: _View) -> NDArray:
    """Return the covariance (6, 6) of J^T heights: noise of the scan, and of the reference through its smoothing. The
    error of a neighbour is the same vector in every height that uses it, projected on that height's normal."""
    from scipy.sparse import csr_array

    J, share = view.J[view.used], view.heights.share[view.used]
    neighbours = view.patches.neighbours[view.which[view.used]]
    rough = _roughness(scene, view, neighbours)
    rows = np.arange(0, share.size + 1, share.shape[1])
    mixing = csr_array((share.ravel(), neighbours.ravel(), rows), shape=(len(J), len(scene.reference)))
    pulled = (mixing.T @ (J[:, :, None] * J[:, None, :3]).reshape(len(J), 18)).reshape(-1, 6, 3)
    scene_variance = scene.sigma_reference**2 + rough
    return scene.sigma_scan**2 * J.T @ J + np.einsum("m,mik,mjk->ij", scene_variance, pulled, pulled, optimize=True)


def _roughness(scene: ScanPair, view: _View, neighbours: NDArray) -> NDArray:
    """Return the variance (M,) in m^2 of the surface about paraboloids in excess of its noise. It is shape, not noise,
    but acts like noise of the reference on a scan with other sample positions."""
    variance = np.repeat(view.patches.variance[view.which[view.used]], neighbours.shape[1])
    count = np.bincount(neighbours.ravel(), minlength=len(scene.reference))
    local = np.bincount(neighbours.ravel(), variance, len(scene.reference)) / np.maximum(count, 1)
    noise = scene.sigma_reference**2
    return np.where(local > _CLEARLY * noise, local - noise, 0.0)


def _noise_ratio(scan: NDArray, J: NDArray, height: NDArray, middle: NDArray) -> float:
    """Return the ratio of J^T heights to their noise, with errors of one region added up; 1 if not significant. Sums
    over regions of a sixth of the scan are compared with their covariance; below four standard deviations of the
    comparison the declared noise is kept."""
    cell = np.floor((scan - scan.min(0)) / (np.ptp(scan, axis=0).max() / _BLOCKS_PER_SIDE)).astype(int)
    _, block = np.unique(cell @ [1, 100, 10_000], return_inverse=True)
    sums = np.stack([np.bincount(block, J[:, i] * height) for i in range(6)], -1)
    inverse = np.linalg.inv(middle)
    size = np.bincount(block, np.einsum("ni,ij,nj->n", J, inverse, J))
    size = size / size.sum()
    ratio_squared = float(np.einsum("bi,ij,bj->", sums, inverse, sums)) / 6 / (1 - np.sum(size**2))
    return float(np.sqrt(ratio_squared)) if ratio_squared > 1 + 4 * np.sqrt(np.sum(size**2) / 3) else 1.0


def _motions(scene: ScanPair, view: _View, t: NDArray) -> tuple[NDArray, NDArray]:
    """Return information (6,) and motions (6, 6), rows (t, theta), that are decoupled, weakest first. Information is a
    multiple of the spurious one from errors of the normals, which is about 1 for a motion that slides along the
    surface. Gelfand et al., 3DIM (2003) 260, with errors of the normals as the unit."""
    points = scene.scan[view.used]
    centre = points.mean(0)
    arm = points - centre
    # Rotations in units that move the typical point by as much as a unit translation.
    scale = np.r_[np.ones(3), np.full(3, 1 / np.sqrt(np.mean(np.sum(arm**2, -1))))]
    normal = view.J[view.used, :3]
    J = np.concatenate([normal, np.cross(arm, normal)], axis=1) * scale
    move = rigid_motions(arm) * scale
    across = (move - normal[:, :, None] * J[:, None]).reshape(-1, 6)
    tilt = view.heights.slope_variance[view.used] * scene.sigma_reference**2 + _SHAPE_ERROR**2
    feigned = across.T @ (np.repeat(tilt, 3)[:, None] * across)
    feigned += 1e-9 * np.trace(feigned) * np.eye(6)
    half = np.linalg.inv(np.linalg.cholesky(feigned))
    information, directions = np.linalg.eigh(half @ J.T @ J @ half.T)
    motions = directions.T @ half * scale
    motions[:, :3] -= np.cross(motions[:, 3:], centre - t)
    return information, motions


@dataclass(frozen=True)
class Patches:
    """Paraboloids at A anchors of a cloud; m."""

    neighbours: NDArray  # (A, k) points of the cloud in the fit of each
    centre: NDArray  # (A, 3)
    frame: NDArray  # (A, 3, 3) columns: two tangents and the normal
    radius: NDArray  # (A,) distance of the farthest neighbour
    smoother: NDArray  # (A, 6, k) from the neighbours' heights to the coefficients
    coefficients: NDArray  # (A, 6) of 1, u, v, u^2, u v, v^2 with u, v in units of the radius
    variance: NDArray  # (A,) m^2, of the neighbours about the paraboloid

    @property
    def noise_variance(self) -> float:
        """Variance in m^2 of the cloud along its normal, in the median patch."""
        return float(np.median(self.variance)) / _MEDIAN_OF_VARIANCE

    def smooth(self, least: float) -> NDArray:
        """Return the mask (A,) of anchors on a surface that a paraboloid describes, to a relevant variance, m^2."""
        return self.variance <= _ROUGH * max(float(np.median(self.variance)), least)

    def at(self, rows: NDArray) -> Patches:
        """Return the patches of some rows."""
        return Patches(*(getattr(self, patch_field.name)[rows] for patch_field in fields(self)))

    def joined_with(self, others: Patches) -> Patches:
        """Return these patches followed by others."""
        pairs = ((getattr(self, patch_field.name), getattr(others, patch_field.name)) for patch_field in fields(self))
        return Patches(*(np.concatenate(pair) for pair in pairs))


@dataclass
class Surface:
    """A cloud (M, 3) with its search tree and a cache of fitted paraboloids; m."""

    points: NDArray
    tree: cKDTree
    _fitted: Patches | None = field(default=None, init=False, repr=False)
    _row: NDArray = field(init=False, repr=False)  # (M,) row of each point in the cache, -1 if not fitted

    def __post_init__(self) -> None:
        self._row = np.full(len(self.points), -1)

    def patches(self, anchors: NDArray) -> Patches:
        """Return the paraboloids at the anchors (A,), different indices of points."""
        missing = anchors[self._row[anchors] < 0]
        if self._fitted is None:
            self._fitted = fit_patches(self.points, self.tree, missing)
            self._row[missing] = np.arange(len(missing))
        elif len(missing):
            self._row[missing] = len(self._fitted.variance) + np.arange(len(missing))
            self._fitted = self._fitted.joined_with(fit_patches(self.points, self.tree, missing))
        return self._fitted.at(self._row[anchors])


@dataclass(frozen=True)
class Heights:
    """N points relative to the patches below them; m."""

    height: NDArray  # (N,) signed distance from the surface
    normal: NDArray  # (N, 3) of the surface below each point
    share: NDArray  # (N, k) derivative of the height by each neighbour's error along the normal
    slope_variance: NDArray  # (N,) variance of one tangential component of the normal, per variance of the noise
    over: NDArray  # (N,) whether the point is over its patch, and the patch is smooth
    beside: NDArray  # (N,) whether the point is clearly next to the surface


def fit_patches(points: NDArray, tree: cKDTree, anchors: NDArray) -> Patches:
    """Return paraboloids at the anchors (A,), indices of points (M, 3); tree is the cKDTree of the points."""
    chunks = [_fit_chunk(points, tree, anchors[s : s + _CHUNK]) for s in range(0, max(len(anchors), 1), _CHUNK)]
    return Patches(*(np.concatenate(column) for column in zip(*chunks, strict=True)))


def heights_over(patches: Patches, which: NDArray, points: NDArray, sigma: float) -> Heights:
    """Return heights of points (N, 3) over their patches number which (N,), in the frame of the patches' cloud.

    sigma in m: the points' own noise; a patch rough by less than that is smooth enough.
    """
    radius = patches.radius[which]
    u, v, w = np.einsum("ni,nij->jn", points - patches.centre[which], patches.frame[which])
    u, v = u / radius, v / radius
    c = patches.coefficients[which]
    ones, zero = np.ones_like(u), np.zeros_like(u)
    basis = np.stack([ones, u, v, u * u, u * v, v * v], -1)
    along_u = np.stack([zero, ones, zero, 2 * u, v, zero], -1) / radius[:, None]
    along_v = np.stack([zero, zero, ones, zero, u, 2 * v], -1) / radius[:, None]
    slope = np.stack([-np.sum(along_u * c, -1), -np.sum(along_v * c, -1), ones], -1)
    secant = np.linalg.norm(slope, axis=1)
    smoother = patches.smoother[which]
    share = np.einsum("ni,nik->nk", basis, smoother) / secant[:, None]
    tilt = [np.sum(np.einsum("ni,nik->nk", d, smoother) ** 2, -1) for d in (along_u, along_v)]
    normal = np.einsum("nij,nj->ni", patches.frame[which], slope / secant[:, None])
    away, height = u * u + v * v, (w - np.sum(basis * c, -1)) / secant
    over = (away <= _OVER**2) & patches.smooth(sigma**2)[which]
    return Heights(height, normal, share, (tilt[0] + tilt[1]) / 2, over, away > _BESIDE**2)


def workers_for(n_queries: int) -> int:
    """Return the number of threads for a tree query: starting threads costs more than a few thousand queries."""
    return -1 if n_queries >= _CHUNK else 1


def _fit_chunk(points: NDArray, tree: cKDTree, anchors: NDArray) -> tuple[NDArray, ...]:
    distance, neighbours = tree.query(points[anchors], k=NEIGHBOURS, workers=workers_for(len(anchors)))
    near = points[neighbours]
    centre = near.mean(1)
    offset = near - centre[:, None]
    _, axes = np.linalg.eigh(np.swapaxes(offset, 1, 2) @ offset)
    frame, radius = axes[:, :, ::-1], np.maximum(distance[:, -1], np.finfo(float).tiny)
    u, v, w = np.moveaxis(offset @ frame, -1, 0)
    u, v = u / radius[:, None], v / radius[:, None]
    basis = np.stack([np.ones_like(u), u, v, u * u, u * v, v * v], -1)
    # The ridge, 1e-9 of the neighbours' weight, only matters for duplicate points.
    normal_matrix = np.swapaxes(basis, 1, 2) @ basis + 1e-9 * NEIGHBOURS * np.eye(_COEFFICIENTS)
    smoother = np.linalg.solve(normal_matrix, np.swapaxes(basis, 1, 2))
    coefficients = np.einsum("aik,ak->ai", smoother, w)
    residual = w - np.einsum("aki,ai->ak", basis, coefficients)
    variance = np.sum(residual**2, -1) / (NEIGHBOURS - _COEFFICIENTS)
    return neighbours, centre, frame, radius, smoother, coefficients, variance
