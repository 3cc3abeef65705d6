"""The pose of a body from a dense scan of its surface (10^4 to 10^6 points), without targets, labels or a start.

A coarse search hands over all poses that could be, least squares at full resolution decides between them, and the
covariance of the decision comes with it. A surface that does not resist some motion (a sphere, a cylinder, a plane) is
refused with these motions named, a body that looks the same in several attitudes with its rivals.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np
from numpy.typing import ArrayLike, NDArray

from truing.estimation.rotation import skew
from truing.estimation.scans.coarse_registration import coarse_poses, same_pose
from truing.estimation.scans.local_surface import NEIGHBOURS, Surface
from truing.estimation.scans.scan_fit import Scene, SurfaceFit, fit_surface

# Points of the scan that enter: beyond them the reference's noise, not the scan's, is what limits a pose.
MAX_POINTS = 200_000
LEAST_OVERLAP = 0.3
# Surfaces that lie apart by more than this, relative to their noise, are not the same surface.
MOST_SCATTER = 3.0
# Standard deviations of the difference by which a rival must be worse: less happens by chance once in a million.
BEATEN = 4.75
# A scan of a tenth of a body, or a body amid ten times as much clutter, is not looked for.
MOST_SIZE_RATIO = 10.0
_LEAST_POINTS = 10 * NEIGHBOURS
_TRIAL_POINTS, _TRIAL_STEPS = 3_000, 15
_FAR_POINTS = 20_000
# Patches of a reference so dense that they are smaller than this many sigma have noise for normals: it is thinned.
_LEAST_RADIUS = 40.0


class ScanStatus(StrEnum):
    """How a registration ended; anything but OK comes without a pose, and ``remedy`` says what to do about it."""

    OK = "ok"
    TOO_FEW = "too-few-points"
    DEGENERATE = "degenerate"
    AMBIGUOUS = "ambiguous"
    NO_MATCH = "no-match"
    NOT_CONVERGED = "not-converged"

    @property
    def remedy(self) -> str:
        """One sentence for the person who reads the status."""
        return _REMEDIES[self]


_REMEDIES = {
    ScanStatus.OK: "Nothing to do.",
    ScanStatus.TOO_FEW: f"A dense scan and its reference need {_LEAST_POINTS} points each: use targets instead.",
    ScanStatus.DEGENERATE: "The surface slides along itself: scan features that resist it, or put targets on the body.",
    ScanStatus.AMBIGUOUS: "The surface looks the same in several attitudes: scan a feature that breaks the symmetry.",
    ScanStatus.NO_MATCH: "The scan fits the reference nowhere: check units, the body, and that they overlap by "
    "a third.",
    ScanStatus.NOT_CONVERGED: "The fit did not settle: check for outliers and for parts that moved.",
}


@dataclass(frozen=True)
class ScanFit:
    """The pose of a reference surface in the frame of a scan; m and rad.

    The covariance assumes noise that is independent from point to point in both clouds, and is enlarged where the
    heights of neighbouring regions scatter by more than that.
    """

    T_measurement_reference: NDArray | None  # (4, 4), None where the status is not OK
    covariance: NDArray | None  # (6, 6) of (p, theta), R <- exp(theta) R, in the scan's frame; m^2, m rad, rad^2
    status: ScanStatus
    unobservable: tuple[str, ...]  # motions of the body, in its own frame, that the surface does not resist
    rivals: NDArray  # (r, 4, 4) other poses that explain the scan as well
    overlap: float  # share of the scan's points that lie on the reference and entered
    rms: float  # m, of the heights of these points over it
    noise_ratio: float  # by which the covariance's standard deviations were enlarged, 1 where they were not
    n_used: int
    n_points: int

    @property
    def remedy(self) -> str:
        """What to do about the status."""
        return self.status.remedy


def register_scan(points: ArrayLike, reference: ArrayLike, sigma: float | None = None) -> ScanFit:
    """Return the pose of a reference surface (M, 3) in the frame of a scan (N, 3) that may see a part of it; m.

    sigma is the standard deviation of a coordinate in both clouds; without it both are taken from how their points
    scatter about the surface. Deterministic. Raises ValueError for shapes and values that cannot be.
    """
    scan, surface = _checked(points, "points"), _checked(reference, "reference")
    if min(len(scan), len(surface)) < _LEAST_POINTS:
        return _refused(ScanStatus.TOO_FEW, len(scan))
    scene, scan_centre, surface_centre = _scene(scan, surface, sigma)
    if not 1 / MOST_SIZE_RATIO < _radius(scene.scan) / _radius(scene.reference) < MOST_SIZE_RATIO:
        return _refused(ScanStatus.NO_MATCH, len(scan))
    trial = _thinned(scene, _TRIAL_POINTS)
    starts = coarse_poses(scene.reference, scene.scan)
    fits = sorted((fit_surface(trial, T[:3, :3], T[:3, 3], _TRIAL_STEPS) for T in starts), key=_misfit)
    best = _refined(scene, fits[0])
    rivals = [] if len(best.free) else list(_rivals(trial, fits, best))
    return _concluded(scene, best, rivals, scan_centre, surface_centre)


def refine_scan(points: ArrayLike, reference: ArrayLike, T_start: ArrayLike, sigma: float | None = None) -> ScanFit:
    """Return what `register_scan` does, from a pose T_start (4, 4) that is known to a few times the points' spacing.

    No rivals are looked for. Raises ValueError for shapes and values that cannot be.
    """
    scan, surface = _checked(points, "points"), _checked(reference, "reference")
    if min(len(scan), len(surface)) < _LEAST_POINTS:
        return _refused(ScanStatus.TOO_FEW, len(scan))
    scene, scan_centre, surface_centre = _scene(scan, surface, sigma)
    T = np.asarray(T_start, np.float64)
    start = fit_surface(_thinned(scene, _TRIAL_POINTS), T[:3, :3], T[:3, :3] @ surface_centre + T[:3, 3] - scan_centre)
    return _concluded(scene, _refined(scene, start), [], scan_centre, surface_centre)


def _checked(points: ArrayLike, name: str) -> NDArray:
    cloud = np.asarray(points, np.float64)
    if cloud.ndim != 2 or cloud.shape[1] != 3:
        raise ValueError(f"{name}: found shape {cloud.shape}, expected (N, 3)")
    if not np.all(np.isfinite(cloud)):
        raise ValueError(f"{name}: found a non-finite coordinate, expected points that were seen")
    return cloud


def _scene(scan: NDArray, surface: NDArray, sigma: float | None) -> tuple[Scene, NDArray, NDArray]:
    """Return both clouds about their centroids with their noise, and the centroids (3,), (3,)."""
    from scipy.spatial import cKDTree

    scan_centre, surface_centre = scan.mean(0), surface.mean(0)
    inside, outside = surface - surface_centre, scan - scan_centre
    known = Surface(inside, cKDTree(inside))
    found, radius = _scatter(known)
    noise = (sigma, sigma) if sigma else (found, _scatter(Surface(outside, cKDTree(outside)))[0])
    kept = int(len(inside) * min(1.0, (radius / (_LEAST_RADIUS * noise[0])) ** 2))
    if kept < len(inside):
        inside = inside[_sample(len(inside), max(kept, _TRIAL_POINTS))]
        known = Surface(inside, cKDTree(inside))
    return Scene(known, outside, *noise), scan_centre, surface_centre


def _sample(n_points: int, n: int) -> NDArray:
    """Return at most n of the indices of n_points, ascending, the same at every call."""
    return np.sort(np.random.default_rng(0).permutation(n_points)[:n])


def _radius(centred: NDArray) -> float:
    return float(np.median(np.linalg.norm(centred, axis=1)))


def _scatter(surface: Surface) -> tuple[float, float]:
    """Return the standard deviation of points about their own surface, never below rounding, and a patch radius; m."""
    patches = surface.patches(_sample(len(surface.points), _FAR_POINTS))
    rounding = 1e-12 * float(np.abs(surface.points).max())
    return max(float(np.sqrt(patches.noise_variance)), rounding), float(np.median(patches.radius))


def _thinned(scene: Scene, n: int) -> Scene:
    return replace(scene, scan=scene.scan[_sample(len(scene.scan), n)])


def _refined(scene: Scene, start: SurfaceFit) -> SurfaceFit:
    """Return the fit of the scan, first thinned, then as a whole up to MAX_POINTS, where it is a fit at all."""
    if start.scatter > MOST_SCATTER:
        return start
    fit = fit_surface(_thinned(scene, _FAR_POINTS), start.R, start.t)
    return fit if len(scene.scan) <= _FAR_POINTS else fit_surface(_thinned(scene, MAX_POINTS), fit.R, fit.t)


def _misfit(fit: SurfaceFit) -> float:
    """Return the mean cost of the scan's points, those that say nothing left out."""
    return float(np.mean(fit.cost[fit.judged])) if np.any(fit.judged) else np.inf


def _rivals(trial: Scene, fits: list[SurfaceFit], best: SurfaceFit) -> Iterator[NDArray]:
    """Yield other poses (4, 4) that the best one does not beat point by point, to odds of a million to one."""
    independent = min(1.0, len(trial.reference) / (3 * len(trial.scan)))
    for fit in fits[1:]:
        if same_pose(_pose(fit), _pose(best), 0.05 * trial.size):
            continue
        both = fit.judged & fits[0].judged
        worse = fit.cost[both] - fits[0].cost[both]
        if np.sum(worse) * np.sqrt(independent) <= BEATEN * np.sqrt(np.sum((worse - worse.mean()) ** 2)):
            yield _pose(fit)


def _pose(fit: SurfaceFit) -> NDArray:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = fit.R, fit.t
    return T


def _concluded(
    scene: Scene, fit: SurfaceFit, rivals: list[NDArray], scan_centre: NDArray, surface_centre: NDArray
) -> ScanFit:
    status = _status(fit, rivals)
    unobservable = tuple(_named(fit, surface_centre, scene.size)) if status == ScanStatus.DEGENERATE else ()
    moved = np.array([_from_centroids(T, scan_centre, surface_centre) for T in rivals]).reshape(-1, 4, 4)
    T, covariance = None, None
    if status == ScanStatus.OK and fit.covariance is not None:
        shift = np.eye(6)
        shift[:3, 3:] = skew(fit.R @ surface_centre)
        T, covariance = _from_centroids(_pose(fit), scan_centre, surface_centre), shift @ fit.covariance @ shift.T
    return ScanFit(
        T,
        covariance,
        status,
        unobservable,
        moved,
        float(np.mean(fit.used)),
        fit.rms,
        max(fit.noise_ratio, 1.0),
        int(np.count_nonzero(fit.used)),
        len(fit.used),
    )


def _status(fit: SurfaceFit, rivals: list[NDArray]) -> ScanStatus:
    if np.mean(fit.used) < LEAST_OVERLAP or fit.scatter > MOST_SCATTER:
        return ScanStatus.NO_MATCH
    if len(fit.free):
        return ScanStatus.DEGENERATE
    if rivals:
        return ScanStatus.AMBIGUOUS
    return ScanStatus.OK if fit.converged else ScanStatus.NOT_CONVERGED


def _from_centroids(T: NDArray, scan_centre: NDArray, surface_centre: NDArray) -> NDArray:
    moved = T.copy()
    moved[:3, 3] = T[:3, 3] + scan_centre - T[:3, :3] @ surface_centre
    return moved


def _named(fit: SurfaceFit, surface_centre: NDArray, body_size: float) -> Iterator[str]:
    """Yield the free motions in words: pure translations first, then rotations about an axis of the body's frame."""
    shift, turn = fit.free[:, :3] @ fit.R, fit.free[:, 3:] @ fit.R
    mix, _, _ = np.linalg.svd(turn)
    for weights in mix.T[::-1]:
        v, w = weights @ shift, weights @ turn
        if np.linalg.norm(w) * body_size <= 0.02 * np.linalg.norm(v):
            yield f"translation along {_direction(v)}"
        else:
            through = 1000 * (np.cross(w, v) / (w @ w) + surface_centre)
            yield f"rotation about {_direction(w)} through ({through[0]:.2f}, {through[1]:.2f}, {through[2]:.2f}) mm"


def _direction(v: NDArray) -> str:
    v = v / np.linalg.norm(v)
    v = np.round(v * np.sign(v[np.argmax(np.abs(v))]), 3) + 0.0
    return f"({v[0]:.3f}, {v[1]:.3f}, {v[2]:.3f})"


def _refused(status: ScanStatus, n_points: int) -> ScanFit:
    return ScanFit(None, None, status, (), np.empty((0, 4, 4)), 0.0, 0.0, 1.0, 0, n_points)
