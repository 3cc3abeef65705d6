"""Rigid fits of the same clouds by other libraries; none of them takes weights here.

Each factory imports its library, so that one that is not installed costs nothing but its row.
"""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace

import numpy as np

Fit = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]  # source, target (B, N, 3) -> R, t


def _one_by_one(fit: Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]) -> Fit:
    """Return a fit of batches from one of single poses."""

    def fits(source: np.ndarray, target: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        R, t = np.empty((len(source), 3, 3)), np.empty((len(source), 3))
        for k in range(len(source)):
            R[k], t[k] = fit(source[k], target[k])
        return R, t

    return fits


def scipy() -> Fit:
    from scipy.spatial.transform import Rotation

    def fit(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        centre_x, centre_y = x.mean(0), y.mean(0)
        R = Rotation.align_vectors(y - centre_y, x - centre_x)[0].as_matrix()
        return R, centre_y - R @ centre_x

    return _one_by_one(fit)


def open3d() -> Fit:
    from truing.open3d_library import load_open3d

    library = load_open3d()
    estimate = library.pipelines.registration.TransformationEstimationPointToPoint()
    cloud, vector = library.geometry.PointCloud, library.utility.Vector3dVector

    def fit(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        pairs = library.utility.Vector2iVector(np.repeat(np.arange(len(x), dtype=np.int32)[:, None], 2, axis=1))
        T = estimate.compute_transformation(cloud(vector(x)), cloud(vector(y)), pairs)
        return T[:3, :3], T[:3, 3]

    return _one_by_one(fit)


def opencv() -> Fit:
    import cv2

    def fit(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        R = cv2.estimateAffine3D(x, y, force_rotation=True)[0][:, :3]
        # its translation belongs to the scale that it estimates besides
        return R, y.mean(0) - R @ x.mean(0)

    return _one_by_one(fit)


def gtsam() -> Fit:
    from gtsam import Pose3

    def fit(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        T = Pose3.Align(y.T, x.T).matrix()
        return T[:3, :3], T[:3, 3]

    return _one_by_one(fit)


def pycolmap() -> Fit:
    from pycolmap import estimate_rigid3d

    def fit(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        T = estimate_rigid3d(x, y).matrix()
        return T[:, :3], T[:, 3]

    return _one_by_one(fit)


def evo() -> Fit:
    from evo.core.geometry import umeyama_alignment

    return _one_by_one(lambda x, y: umeyama_alignment(x.T, y.T)[:2])


def roma() -> Fit:
    import os

    import roma as library
    import torch

    torch.set_num_threads(int(os.environ.get("OMP_NUM_THREADS", "1")))

    def fits(source: np.ndarray, target: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        with torch.no_grad():
            R, t = library.rigid_points_registration(torch.from_numpy(source), torch.from_numpy(target))
        return R.numpy(), t.numpy()

    return fits


FITS: dict[str, Callable[[], Fit]] = {
    "scipy align_vectors": scipy,
    "Open3D point-to-point": open3d,
    "OpenCV estimateAffine3D": opencv,
    "gtsam Pose3.Align": gtsam,
    "pycolmap estimate_rigid3d": pycolmap,
    "evo umeyama_alignment": evo,
    "roma (batched)": roma,
}


def teaser(noise_bound: float) -> Fit:
    """Return TEASER++ with exact maximum clique, rotation by GNC-TLS, and no scale; noise_bound in m."""
    import teaserpp_python as library

    solver = library.RobustRegistrationSolver
    settings = solver.Params()
    chosen = SimpleNamespace(
        noise_bound=noise_bound,
        cbar2=1.0,
        estimate_scaling=False,
        rotation_estimation_algorithm=solver.ROTATION_ESTIMATION_ALGORITHM.GNC_TLS,
        rotation_gnc_factor=1.4,
        rotation_max_iterations=100,
        rotation_cost_threshold=1e-12,
    )
    for name, value in vars(chosen).items():
        setattr(settings, name, value)

    def fit(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        one = solver(settings)
        one.solve(x.T, y.T)
        solution = one.getSolution()
        return solution.rotation, solution.translation

    return _one_by_one(fit)
