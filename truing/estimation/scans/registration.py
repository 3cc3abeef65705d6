"""Pose of a body from a dense scan of its surface (10^4 to 10^6 points), without targets, labels or start values.

A coarse search on thinned clouds gives all candidate poses: from matched features, principal axes, and symmetries, each
refined by Open3D's point-to-plane ICP. Least squares at full resolution decides between them and gives the covariance.
A surface that leaves a motion free (sphere, cylinder, plane) is refused with the names of these motions; a body that
looks the same in several attitudes is refused with its rivals.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from enum import StrEnum
from itertools import product
from types import ModuleType
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from truing.estimation.rotation import exp_so3, skew
from truing.estimation.scans.scan_fit import NEIGHBOURS, ScanPair, Surface, SurfaceFit, fit_surface
from truing.open3d_library import load_open3d

if TYPE_CHECKING:
    from truing.open3d_library import PointCloud, RegistrationResult

# Points of the scan that are used: beyond, the reference's noise limits a pose, not the scan's.
MAX_POINTS = 200_000
LEAST_OVERLAP = 0.3
# Surfaces further apart than this, relative to their noise, are different surfaces.
MOST_SCATTER = 3.0
# Standard deviations of the difference by which a rival must be worse: exceeded by chance once in a million.
BEATEN = 4.75
# Least overlap: smaller parts of a body, or ten times as much clutter, are not searched.
MOST_SIZE_RATIO = 10.0
_LEAST_POINTS = 10 * NEIGHBOURS
_TRIAL_POINTS, _TRIAL_STEPS = 3_000, 15
_FAR_POINTS = 20_000
# A reference with patches smaller than this many sigma has normals of noise only: it is thinned.
_LEAST_RADIUS = 40.0
_THINNED = 2500
_FEWER = 700
# Poses closer than this are equal: less than the capture range of ICP on a thinned cloud.
_SAME_ANGLE, _SAME_SHIFT = np.radians(6.0), 2.0
_SEARCHES = 3
_SETTLED = 14
# Factor in squared distance by which thinned clouds distinguish a pose from the best, in voxels squared.
_NEARLY, _LEAST_COST = 3.0, 0.01


class ScanStatus(StrEnum):
    """Status of a registration, with the remedy; only OK comes with a pose."""

    OK = "ok"
    TOO_FEW = "too-few-points"
    DEGENERATE = "degenerate"
    AMBIGUOUS = "ambiguous"
    NO_MATCH = "no-match"
    NOT_CONVERGED = "not-converged"

    @property
    def remedy(self) -> str:
        """Advice for the reader of the status, in one sentence."""
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
    """Pose of a reference surface in the frame of a scan; m and rad.

    The covariance assumes independent noise of the points in both clouds. It is enlarged if the heights of neighbouring
    regions scatter by more than that.
    """

    T_measurement_reference: NDArray | None  # (4, 4), None unless the status is OK
    covariance: NDArray | None  # (6, 6) of (p, theta), R <- exp(theta) R, in the scan's frame; m^2, m rad, rad^2
    status: ScanStatus
    unobservable: tuple[str, ...]  # motions of the body, in its own frame, that the surface leaves free
    rivals: NDArray  # (r, 4, 4) other poses that explain the scan as well
    overlap: float  # share of the scan's points on the reference that were used
    rms: float  # m, of the heights of these points above the reference
    noise_ratio: float  # factor on the covariance's standard deviations, at least 1
    n_used: int
    n_points: int

    @property
    def remedy(self) -> str:
        """Advice on the status."""
        return self.status.remedy


def register_scan(points: ArrayLike, reference: ArrayLike, sigma: float | None = None) -> ScanFit:
    """Return the pose of a reference surface (M, 3) in the frame of a scan (N, 3) of it or a part of it; m.

    sigma: standard deviation of a coordinate in both clouds; without it, both are estimated from the scatter about the
    surface. Deterministic. Raises ValueError for invalid shapes and values.
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
    """Return the registration of a scan from a start T_start (4, 4) accurate to a few point spacings.

    Rivals are not searched. Raises ValueError for invalid shapes and values.
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
        raise ValueError(f"{name}: found a non-finite coordinate, expected finite ones: remove missing points")
    return cloud


def _scene(scan: NDArray, surface: NDArray, sigma: float | None) -> tuple[ScanPair, NDArray, NDArray]:
    """Return both clouds about their centroids with their noise, and the centroids (3,), (3,)."""
    from scipy.spatial import cKDTree

    scan_centre, surface_centre = scan.mean(0), surface.mean(0)
    inside, outside = surface - surface_centre, scan - scan_centre
    known = Surface(inside, cKDTree(inside))
    points, radius = _scatter(known)
    noise = (sigma, sigma) if sigma else (points, _scatter(Surface(outside, cKDTree(outside)))[0])
    sample_size = int(len(inside) * min(1.0, (radius / (_LEAST_RADIUS * noise[0])) ** 2))
    if sample_size < len(inside):
        inside = inside[_sample(len(inside), max(sample_size, _TRIAL_POINTS))]
        known = Surface(inside, cKDTree(inside))
    return ScanPair(known, outside, *noise), scan_centre, surface_centre


def _sample(n_points: int, n: int) -> NDArray:
    """Return at most n of the indices of n_points, ascending and reproducible."""
    return np.sort(np.random.default_rng(0).permutation(n_points)[:n])


def _radius(centred: NDArray) -> float:
    return float(np.median(np.linalg.norm(centred, axis=1)))


def _scatter(surface: Surface) -> tuple[float, float]:
    """Return the standard deviation of points about their own surface, at least rounding, and a patch radius; m."""
    patches = surface.patches(_sample(len(surface.points), _FAR_POINTS))
    rounding = 1e-12 * float(np.abs(surface.points).max())
    return max(float(np.sqrt(patches.noise_variance)), rounding), float(np.median(patches.radius))


def _thinned(scene: ScanPair, n: int) -> ScanPair:
    return replace(scene, scan=scene.scan[_sample(len(scene.scan), n)])


def _refined(scene: ScanPair, start: SurfaceFit) -> SurfaceFit:
    """Return the fit of the thinned scan, and if that succeeds, of up to MAX_POINTS."""
    if start.scatter > MOST_SCATTER:
        return start
    fit = fit_surface(_thinned(scene, _FAR_POINTS), start.R, start.t)
    return fit if len(scene.scan) <= _FAR_POINTS else fit_surface(_thinned(scene, MAX_POINTS), fit.R, fit.t)


def _misfit(fit: SurfaceFit) -> float:
    """Return the mean cost of the scan's informative points."""
    return float(np.mean(fit.cost[fit.informative])) if np.any(fit.informative) else np.inf


def _rivals(trial: ScanPair, fits: list[SurfaceFit], best: SurfaceFit) -> Iterator[NDArray]:
    """Yield other poses (4, 4) that the best one does not beat point by point, with odds of a million to one."""
    independent = min(1.0, len(trial.reference) / (3 * len(trial.scan)))
    for fit in fits[1:]:
        if same_pose(_homogeneous(fit.R, fit.t), _homogeneous(best.R, best.t), 0.05 * trial.size):
            continue
        both = fit.informative & fits[0].informative
        worse = fit.cost[both] - fits[0].cost[both]
        if np.sum(worse) * np.sqrt(independent) <= BEATEN * np.sqrt(np.sum((worse - worse.mean()) ** 2)):
            yield _homogeneous(fit.R, fit.t)


def _concluded(
    scene: ScanPair, fit: SurfaceFit, rivals: list[NDArray], scan_centre: NDArray, surface_centre: NDArray
) -> ScanFit:
    status = _status(fit, rivals)
    unobservable = tuple(_motion_words(fit, surface_centre, scene.size)) if status == ScanStatus.DEGENERATE else ()
    moved = np.array([_motion_between_centroids(T, scan_centre, surface_centre) for T in rivals]).reshape(-1, 4, 4)
    T, covariance = None, None
    if status == ScanStatus.OK and fit.covariance is not None:
        shift = np.eye(6)
        shift[:3, 3:] = skew(fit.R @ surface_centre)
        T = _motion_between_centroids(_homogeneous(fit.R, fit.t), scan_centre, surface_centre)
        covariance = shift @ fit.covariance @ shift.T
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


def _motion_between_centroids(T: NDArray, scan_centre: NDArray, surface_centre: NDArray) -> NDArray:
    moved = T.copy()
    moved[:3, 3] = T[:3, 3] + scan_centre - T[:3, :3] @ surface_centre
    return moved


def _motion_words(fit: SurfaceFit, surface_centre: NDArray, body_size: float) -> Iterator[str]:
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


def coarse_poses(reference: NDArray, scan: NDArray, keep: int = 12) -> list[NDArray]:
    """Return up to ``keep`` distinct poses (4, 4) of reference (M, 3) in the frame of the scan (N, 3), best first; m.

    Deterministic: Open3D's generator is seeded, the thinning is not random, and last digits are rounded.
    """
    o3d = load_open3d()
    voxel = max(_voxel_for(o3d, reference), _voxel_for(o3d, scan))
    thin_reference, thin_scan = (_with_normals(o3d, cloud, voxel) for cloud in (reference, scan))
    fewer = thin_scan.uniform_down_sample(max(1, len(thin_scan.points) // _FEWER))
    with o3d.utility.VerbosityContextManager(o3d.utility.VerbosityLevel.Error):
        matched = list(_starts_by_features(o3d, thin_reference, thin_scan, voxel))
    starts = [*matched, *_nearest_starts(o3d, thin_reference, fewer, _starts_by_axes(reference, scan), voxel)]
    converged = _refined_starts(o3d, thin_reference, fewer, starts, voxel)
    turned = _nearest_starts(o3d, thin_reference, fewer, _symmetric(reference, converged[0][1]), voxel)
    alike = _refined_starts(o3d, thin_reference, fewer, turned, voxel)
    distinct = _distinct(sorted([*converged, *alike], key=lambda pair: pair[0]), voxel)[:keep]
    final = _refined_starts(o3d, thin_reference, thin_scan, [T for _, T in distinct], voxel)
    return [T for cost, T in _distinct(final, voxel) if cost <= _NEARLY * final[0][0] + _LEAST_COST]


def _cloud(o3d: ModuleType, points: NDArray) -> PointCloud:
    return o3d.geometry.PointCloud(o3d.utility.Vector3dVector(np.ascontiguousarray(points)))


def _voxel_for(o3d: ModuleType, points: NDArray) -> float:
    """Return the edge in m of voxels of which about _THINNED are occupied: their number is proportional to 1 /
    edge^2."""
    cloud = _cloud(o3d, points)
    voxel = float(np.linalg.norm(np.ptp(points, axis=0))) / 40
    for _ in range(3):
        voxel *= np.sqrt(len(cloud.voxel_down_sample(voxel).points) / min(_THINNED, len(points) / 2))
    return voxel


def _with_normals(o3d: ModuleType, points: NDArray, voxel: float) -> PointCloud:
    """Return the thinned cloud with normals consistent between neighbours and mostly pointing outwards."""
    cloud = _cloud(o3d, points).voxel_down_sample(voxel)
    cloud.estimate_normals(o3d.geometry.KDTreeSearchParamHybrid(2.5 * voxel, 30))
    cloud.orient_normals_consistent_tangent_plane(12)
    normals, centred = np.asarray(cloud.normals), np.asarray(cloud.points) - np.mean(cloud.points, axis=0)
    if np.sum(normals * centred) < 0:
        cloud.normals = o3d.utility.Vector3dVector(-normals)
    return cloud


def _starts_by_features(o3d: ModuleType, reference: PointCloud, scan: PointCloud, voxel: float) -> Iterator[NDArray]:
    """Yield poses from matched fast point feature histograms (Rusu et al., ICRA 2009), by two search methods."""
    search = o3d.geometry.KDTreeSearchParamHybrid(6 * voxel, 100)
    registration = o3d.pipelines.registration
    features = [registration.compute_fpfh_feature(cloud, search) for cloud in (reference, scan)]
    option = registration.FastGlobalRegistrationOption(maximum_correspondence_distance=voxel, iteration_number=64)
    checkers = [
        registration.CorrespondenceCheckerBasedOnEdgeLength(0.9),
        registration.CorrespondenceCheckerBasedOnDistance(1.5 * voxel),
    ]
    for seed in range(_SEARCHES):
        o3d.utility.random.seed(seed)
        yield registration.registration_fgr_based_on_feature_matching(reference, scan, *features, option).transformation
        yield registration.registration_ransac_based_on_feature_matching(
            reference,
            scan,
            *features,
            True,
            1.5 * voxel,
            registration.TransformationEstimationPointToPoint(False),
            3,
            checkers,
            registration.RANSACConvergenceCriteria(20_000, 0.999),
        ).transformation


def _starts_by_axes(reference: NDArray, scan: NDArray) -> Iterator[NDArray]:
    """Yield the 24 poses that align the principal axes."""
    axes = [np.linalg.eigh(np.cov(cloud.T))[1] for cloud in (reference, scan)]
    for turn in _cube_rotations():
        R = axes[1] @ turn @ axes[0].T
        R *= np.linalg.det(R)
        yield _homogeneous(R, scan.mean(0) - R @ reference.mean(0))


def _symmetric(reference: NDArray, T: NDArray) -> Iterator[NDArray]:
    """Yield the pose rotated as for a symmetric body: by parts of a turn about each axis, and upside down."""
    centre, axes = reference.mean(0), np.linalg.eigh(np.cov(reference.T))[1]
    angles = np.unique(np.r_[np.arange(12) / 12, np.arange(8) / 8, np.arange(5) / 5]) * 2 * np.pi
    for k, upside_down, angle in product(range(3), (0.0, np.pi), angles):
        S = exp_so3(upside_down * axes[:, (k + 1) % 3]) @ exp_so3(angle * axes[:, k])
        yield T @ _homogeneous(S, centre - S @ centre)


def _homogeneous(R: NDArray, t: NDArray) -> NDArray:
    """Return the pose (4, 4) of a rotation and a shift."""
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, t
    return T


def _cube_rotations() -> Iterator[NDArray]:
    for permutation in ((0, 1, 2), (1, 2, 0), (2, 0, 1), (0, 2, 1), (2, 1, 0), (1, 0, 2)):
        for signs in product((1.0, -1.0), repeat=3):
            turn = np.eye(3)[list(permutation)] * signs
            if np.linalg.det(turn) > 0:
                yield turn


def _nearest_starts(
    o3d: ModuleType, reference: PointCloud, scan: PointCloud, starts: Iterator[NDArray], voxel: float
) -> list[NDArray]:
    """Return the starts with the smallest distances before refinement."""
    ranked = sorted(
        ((_remaining_distance(o3d, scan, reference, np.linalg.inv(T), voxel), i, T) for i, T in enumerate(starts)),
        key=lambda entry: entry[:2],
    )
    return [T for _, _, T in ranked[:_SETTLED]]


def _remaining_distance(o3d: ModuleType, scan: PointCloud, reference: PointCloud, T: NDArray, voxel: float) -> float:
    """Return the mean square of the scan's distances from the reference, in voxels, each limited to 4."""
    result = o3d.pipelines.registration.evaluate_registration(scan, reference, 4.0 * voxel, T)
    return round(float(result.fitness * (result.inlier_rmse / voxel) ** 2 + (1 - result.fitness) * 16.0), 9)


def _refined_starts(
    o3d: ModuleType, reference: PointCloud, scan: PointCloud, starts: list[NDArray], voxel: float
) -> list[tuple[float, NDArray]]:
    """Return each start refined by ICP, with its remaining distance in voxels, best first."""
    converged = []
    for start in starts:
        # The scan is moved onto the reference: a part of the surface is matched to the whole.
        T = np.linalg.inv(start)
        for reach in (6.0, 2.0):
            T = _rounded(_icp(o3d, scan, reference, T, reach * voxel).transformation, voxel)
        converged.append((_remaining_distance(o3d, scan, reference, T, voxel), np.linalg.inv(T)))
    return sorted(converged, key=lambda pair: pair[0])


def _rounded(T: NDArray, voxel: float) -> NDArray:
    """Return a pose without its last digits, which depend on the order of sums over threads."""
    U, _, Vt = np.linalg.svd(np.round(T[:3, :3], 7))
    rounded = np.eye(4)
    rounded[:3, :3], rounded[:3, 3] = U @ Vt, np.round(T[:3, 3] / (1e-6 * voxel)) * 1e-6 * voxel
    return rounded


def _icp(o3d: ModuleType, source: PointCloud, target: PointCloud, T: NDArray, reach: float) -> RegistrationResult:
    registration = o3d.pipelines.registration
    estimation = registration.TransformationEstimationPointToPlane(registration.TukeyLoss(k=reach))
    return registration.registration_icp(
        source, target, reach, T, estimation, registration.ICPConvergenceCriteria(1e-6, 1e-6, 30)
    )


def _distinct(converged: list[tuple[float, NDArray]], voxel: float) -> list[tuple[float, NDArray]]:
    distinct: list[tuple[float, NDArray]] = []
    for cost, T in converged:
        if not any(same_pose(T, other, _SAME_SHIFT * voxel) for _, other in distinct):
            distinct.append((cost, T))
    return distinct


def same_pose(T: NDArray, other: NDArray, shift: float) -> bool:
    """True if two poses (4, 4) differ by less than 6 degrees and, at their origin, by less than a shift in m."""
    cosine = (np.trace(T[:3, :3].T @ other[:3, :3]) - 1) / 2
    return bool(cosine > np.cos(_SAME_ANGLE) and np.linalg.norm(T[:3, 3] - other[:3, 3]) < shift)
