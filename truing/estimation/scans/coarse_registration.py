"""Where a dense scan roughly lies, with no start given: matched features, principal axes, and what symmetry adds.

Every start is settled by point-to-plane ICP (Open3D) on thinned clouds and judged by what it leaves. Those that leave
about as little as the best are all handed back: whether they are rivals is for the full resolution to say.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from truing.estimation.rotation import exp_so3
from truing.open3d_library import load_open3d

_THINNED = 2500
_FEWER = 700
# Poses nearer to each other than this are one pose: less than the catch of ICP on a thinned cloud.
_SAME_ANGLE, _SAME_SHIFT = np.radians(6.0), 2.0
_SEARCHES = 3
_SETTLED = 14
# A thinned cloud tells poses apart that leave three times as much as the best, in voxels squared.
_NEARLY, _LEAST_COST = 3.0, 0.01


def coarse_poses(reference: NDArray, scan: NDArray, keep: int = 12) -> list[NDArray]:
    """Return up to ``keep`` distinct poses (4, 4) of reference (M, 3) in the frame of the scan (N, 3), best first; m.

    Deterministic: Open3D's generator is seeded, the thinning has no chance in it, and last digits are rounded away.
    """
    o3d = load_open3d()
    voxel = max(_voxel_for(o3d, reference), _voxel_for(o3d, scan))
    thin_reference, thin_scan = (_with_normals(o3d, cloud, voxel) for cloud in (reference, scan))
    fewer = _every(thin_scan, max(1, len(thin_scan.points) // _FEWER))
    with o3d.utility.VerbosityContextManager(o3d.utility.VerbosityLevel.Error):
        matched = list(_by_features(o3d, thin_reference, thin_scan, voxel))
    starts = [*matched, *_promising(o3d, thin_reference, fewer, _by_axes(reference, scan), voxel)]
    settled = _settled(o3d, thin_reference, fewer, starts, voxel)
    turned = _promising(o3d, thin_reference, fewer, _symmetric(reference, settled[0][1]), voxel)
    alike = _settled(o3d, thin_reference, fewer, turned, voxel)
    distinct = _distinct(sorted([*settled, *alike], key=lambda pair: pair[0]), voxel)[:keep]
    final = _settled(o3d, thin_reference, thin_scan, [T for _, T in distinct], voxel)
    return [T for cost, T in _distinct(final, voxel) if cost <= _NEARLY * final[0][0] + _LEAST_COST]


def _cloud(o3d: Any, points: NDArray) -> Any:
    return o3d.geometry.PointCloud(o3d.utility.Vector3dVector(np.ascontiguousarray(points)))


def _voxel_for(o3d: Any, points: NDArray) -> float:
    """Return the edge in m of voxels of which about _THINNED hold points: their number goes with the edge's square."""
    cloud = _cloud(o3d, points)
    voxel = float(np.linalg.norm(np.ptp(points, axis=0))) / 40
    for _ in range(3):
        voxel *= np.sqrt(len(cloud.voxel_down_sample(voxel).points) / min(_THINNED, len(points) / 2))
    return voxel


def _with_normals(o3d: Any, points: NDArray, voxel: float) -> Any:
    """Return the thinned cloud with normals that agree with their neighbours' and point outwards on the whole."""
    cloud = _cloud(o3d, points).voxel_down_sample(voxel)
    cloud.estimate_normals(o3d.geometry.KDTreeSearchParamHybrid(2.5 * voxel, 30))
    cloud.orient_normals_consistent_tangent_plane(12)
    normals, centred = np.asarray(cloud.normals), np.asarray(cloud.points) - np.mean(cloud.points, axis=0)
    if np.sum(normals * centred) < 0:
        cloud.normals = o3d.utility.Vector3dVector(-normals)
    return cloud


def _every(cloud: Any, step: int) -> Any:
    return cloud.uniform_down_sample(step)


def _by_features(o3d: Any, reference: Any, scan: Any, voxel: float) -> Iterator[NDArray]:
    """Yield poses from matched fast point feature histograms (Rusu et al., ICRA 2009), by two ways of searching."""
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


def _by_axes(reference: NDArray, scan: NDArray) -> Iterator[NDArray]:
    """Yield the 24 poses that lay principal axes onto principal axes."""
    axes = [np.linalg.eigh(np.cov(cloud.T))[1] for cloud in (reference, scan)]
    for turn in _cube_rotations():
        R = axes[1] @ turn @ axes[0].T
        yield _homogeneous(R * np.linalg.det(R), scan.mean(0), reference.mean(0))


def _symmetric(reference: NDArray, T: NDArray) -> Iterator[NDArray]:
    """Yield the pose turned as a symmetric body could be: by parts of a turn about each axis, and upside down."""
    centre, axes = reference.mean(0), np.linalg.eigh(np.cov(reference.T))[1]
    angles = np.unique(np.r_[np.arange(12) / 12, np.arange(8) / 8, np.arange(5) / 5]) * 2 * np.pi
    for k, upside_down, angle in product(range(3), (0.0, np.pi), angles):
        S = exp_so3(upside_down * axes[:, (k + 1) % 3]) @ exp_so3(angle * axes[:, k])
        yield T @ _homogeneous(S, centre, centre)


def _homogeneous(R: NDArray, target: NDArray, source: NDArray) -> NDArray:
    """Return the pose (4, 4) with rotation R that takes the point source to target."""
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, target - R @ source
    return T


def _cube_rotations() -> Iterator[NDArray]:
    for permutation in ((0, 1, 2), (1, 2, 0), (2, 0, 1), (0, 2, 1), (2, 1, 0), (1, 0, 2)):
        for signs in product((1.0, -1.0), repeat=3):
            turn = np.eye(3)[list(permutation)] * signs
            if np.linalg.det(turn) > 0:
                yield turn


def _promising(o3d: Any, reference: Any, scan: Any, starts: Iterator[NDArray], voxel: float) -> list[NDArray]:
    """Return the starts that leave least as they are."""
    ranked = sorted(
        ((_left_over(o3d, scan, reference, np.linalg.inv(T), voxel), i, T) for i, T in enumerate(starts)),
        key=lambda entry: entry[:2],
    )
    return [T for _, _, T in ranked[:_SETTLED]]


def _left_over(o3d: Any, scan: Any, reference: Any, T: NDArray, voxel: float) -> float:
    """Return the mean square of the scan's distances from the reference, in voxels, none counting for more than 4."""
    result = o3d.pipelines.registration.evaluate_registration(scan, reference, 4.0 * voxel, T)
    return round(float(result.fitness * (result.inlier_rmse / voxel) ** 2 + (1 - result.fitness) * 16.0), 9)


def _settled(o3d: Any, reference: Any, scan: Any, starts: list[NDArray], voxel: float) -> list[tuple[float, NDArray]]:
    """Return what every start leaves, in voxels, and where it settles, best first."""
    settled = []
    for start in starts:
        # The scan is laid onto the reference: a part of the surface looks for the whole, not the other way about.
        T = np.linalg.inv(start)
        for reach in (6.0, 2.0):
            T = _rounded(_icp(o3d, scan, reference, T, reach * voxel).transformation, voxel)
        settled.append((_left_over(o3d, scan, reference, T, voxel), np.linalg.inv(T)))
    return sorted(settled, key=lambda pair: pair[0])


def _rounded(T: NDArray, voxel: float) -> NDArray:
    """Return a pose without the last digits, which depend on the order in which threads add up."""
    U, _, Vt = np.linalg.svd(np.round(T[:3, :3], 7))
    rounded = np.eye(4)
    rounded[:3, :3], rounded[:3, 3] = U @ Vt, np.round(T[:3, 3] / (1e-6 * voxel)) * 1e-6 * voxel
    return rounded


def _icp(o3d: Any, source: Any, target: Any, T: NDArray, reach: float) -> Any:
    registration = o3d.pipelines.registration
    estimation = registration.TransformationEstimationPointToPlane(registration.TukeyLoss(k=reach))
    return registration.registration_icp(
        source, target, reach, T, estimation, registration.ICPConvergenceCriteria(1e-6, 1e-6, 30)
    )


def _distinct(settled: list[tuple[float, NDArray]], voxel: float) -> list[tuple[float, NDArray]]:
    kept: list[tuple[float, NDArray]] = []
    for cost, T in settled:
        if not any(same_pose(T, other, _SAME_SHIFT * voxel) for _, other in kept):
            kept.append((cost, T))
    return kept


def same_pose(T: NDArray, other: NDArray, shift: float) -> bool:
    """Whether two poses (4, 4) differ by less than 6 degrees and, at their origin, by less than a shift in m."""
    cosine = (np.trace(T[:3, :3].T @ other[:3, :3]) - 1) / 2
    return bool(cosine > np.cos(_SAME_ANGLE) and np.linalg.norm(T[:3, 3] - other[:3, 3]) < shift)
