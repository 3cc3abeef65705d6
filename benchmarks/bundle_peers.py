"""Adjustments of the same network by other libraries: each factory prepares the problem once and returns a solver."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.sparse import coo_array

from benchmarks.bundle_problem import FORMAT, FREE, SIGMA_PX, Problem, with_radial
from truing.estimation.bundle.camera import PARAMETERS
from truing.estimation.bundle.network import NetworkState, linearise, project
from truing.estimation.rotation import exp_so3

Solver = Callable[[], NetworkState]

_CENTRE = (np.array(FORMAT) - 1) / 2
_TOLERANCE = 1e-9  # relative change of the sum of squares at which a library may stop


def _camera_from_world(state: NetworkState) -> np.ndarray:
    """Return rotations and shifts (I, 3, 4) that bring points into camera axes."""
    turned = state.R.transpose(0, 2, 1)
    return np.concatenate([turned, -turned @ state.centre[:, :, None]], -1)


def _looking_from(state: NetworkState, matrices: np.ndarray) -> NetworkState:
    """Return the state with images given by (I, 3, 4)."""
    R = matrices[:, :, :3].transpose(0, 2, 1)
    return replace(state, R=R, centre=-np.einsum("nij,nj->ni", R, matrices[:, :, 3]))


def _reconstruction(problem: Problem):  # type: ignore[no-untyped-def]
    """Return a reconstruction with all rays, and what sets it back to the start."""
    import pycolmap

    network, start = problem.network, problem.start
    found = pycolmap.Reconstruction()
    params = [start.interior[0, 0], *_CENTRE, 0.0, 0.0]
    camera = pycolmap.Camera(camera_id=1, model="RADIAL", width=FORMAT[0], height=FORMAT[1], params=params)
    found.add_camera_with_trivial_rig(camera)
    rays, tracks = network.rays, [pycolmap.Track() for _ in start.points]
    for i, matrix in enumerate(_camera_from_world(start)):
        rows = np.flatnonzero(rays.image == i)
        for place, p in enumerate(rays.point[rows]):
            tracks[p].add_element(i + 1, place)
        image = pycolmap.Image(name=str(i), keypoints=rays.xy_px[rows], camera_id=1, image_id=i + 1)
        found.add_image_with_trivial_frame(image, pycolmap.Rigid3d(matrix))
    numbers = [found.add_point3D(xyz, track) for xyz, track in zip(start.points, tracks, strict=True)]
    poses = [pycolmap.Rigid3d(matrix) for matrix in _camera_from_world(start)]

    def reset() -> None:
        found.cameras[1].params = params
        for i, pose in enumerate(poses):
            found.frames[i + 1].rig_from_world = pose
        for number, xyz in zip(numbers, start.points, strict=True):
            found.points3D[number].xyz = xyz

    def state() -> NetworkState:
        matrices = np.array([found.images[i + 1].cam_from_world().matrix() for i in range(len(poses))])
        f, _, _, k1, k2 = found.cameras[1].params
        points = np.array([found.points3D[number].xyz for number in numbers])
        return with_radial(_looking_from(replace(start, points=points), matrices), f, k1, k2)

    return found, reset, state


def _adjuster(found, threads: int):  # type: ignore[no-untyped-def]
    """Return pycolmap's adjustment of all images: points eliminated, a dense decomposition of what is left, which is
    faster here than what it chooses for more than fifty images; two images hold the datum, without strain."""
    import pycolmap

    options = pycolmap.BundleAdjustmentOptions()
    options.refine_principal_point = False
    options.print_summary = False
    options.ceres.max_num_images_direct_dense_cpu_solver = 100
    solver = options.ceres.solver_options
    solver.num_threads = threads
    solver.function_tolerance, solver.gradient_tolerance = _TOLERANCE, 0.0
    config = pycolmap.BundleAdjustmentConfig()
    for number in found.images:
        config.add_image(number)
    config.fix_gauge(pycolmap.BundleAdjustmentGauge.TWO_CAMS_FROM_WORLD)
    return pycolmap.create_default_ceres_bundle_adjuster(options, config, found)


def pycolmap_solver(problem: Problem, threads: int, covariance: bool) -> Solver:
    """Return pycolmap's adjustment; with its covariance of points, images and camera where asked for."""
    import pycolmap

    found, reset, state = _reconstruction(problem)

    def solve() -> NetworkState:
        reset()
        adjuster = _adjuster(found, threads)
        adjuster.solve()
        if covariance and pycolmap.estimate_ba_covariance(pycolmap.BACovarianceOptions(), found, adjuster) is None:
            raise RuntimeError("pycolmap found no covariance")
        return state()

    return solve


def pyceres_solver(problem: Problem, threads: int) -> Solver:
    """Return ceres alone, by its own bindings, on the problem that pycolmap posed once."""
    import pyceres

    found, reset, state = _reconstruction(problem)
    adjuster = _adjuster(found, threads)
    options = pyceres.SolverOptions()
    options.linear_solver_type = pyceres.LinearSolverType.DENSE_SCHUR
    options.num_threads = threads
    options.minimizer_progress_to_stdout = False
    options.function_tolerance, options.gradient_tolerance = _TOLERANCE, 0.0

    def solve() -> NetworkState:
        reset()
        pyceres.solve(options, adjuster.problem, pyceres.SolverSummary())
        return state()

    return solve


def gtsam_solver(problem: Problem, threads: int) -> Solver:
    """Return gtsam's Levenberg-Marquardt; it takes its number of threads from how it was built."""
    import gtsam

    network, start = problem.network, problem.start
    noise = gtsam.noiseModel.Isotropic.Sigma(2, SIGMA_PX)
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    rays = network.rays
    for i, p, xy in zip(rays.image.tolist(), rays.point.tolist(), rays.xy_px, strict=True):
        key = gtsam.symbol("x", i), gtsam.symbol("p", p), gtsam.symbol("k", 0)
        graph.add(gtsam.GeneralSFMFactor2Cal3Bundler(xy, noise, *key))
    for i, (R, centre) in enumerate(zip(start.R, start.centre, strict=True)):
        values.insert(gtsam.symbol("x", i), gtsam.Pose3(gtsam.Rot3(R), centre))
    for p, xyz in enumerate(start.points):
        values.insert(gtsam.symbol("p", p), xyz)
    values.insert(gtsam.symbol("k", 0), gtsam.Cal3Bundler(start.interior[0, 0], 0.0, 0.0, *_CENTRE))
    parameters = gtsam.LevenbergMarquardtParams.CeresDefaults()
    parameters.setRelativeErrorTol(_TOLERANCE)
    parameters.setAbsoluteErrorTol(0.0)

    def solve() -> NetworkState:
        best = gtsam.LevenbergMarquardtOptimizer(graph, values, parameters).optimize()
        images = [best.atPose3(gtsam.symbol("x", i)) for i in range(len(start.R))]
        points = np.array([best.atPoint3(gtsam.symbol("p", p)) for p in range(len(start.points))])
        R, centre = np.array([x.rotation().matrix() for x in images]), np.array([x.translation() for x in images])
        camera = best.atCal3Bundler(gtsam.symbol("k", 0))
        found = replace(start, points=points, R=R, centre=centre)
        return with_radial(found, camera.fx(), camera.k1(), camera.k2())

    return solve


def scipy_solver(problem: Problem, threads: int) -> Solver:
    """Return scipy's trust region with our exact derivatives as a sparse matrix; BLAS has the threads."""
    from scipy.optimize import least_squares

    network, start = problem.network, problem.start
    rays, images = network.rays, len(start.R)
    at_points, at_camera = 6 * images, 6 * images + start.points.size
    free = [PARAMETERS.index(name) for name in FREE]
    size = np.array([1e3, 1e-9, 1e-16])  # what one unit of each interior element is
    columns = np.concatenate(
        [
            6 * rays.image[:, None] + np.arange(6),
            at_points + 3 * rays.point[:, None] + np.arange(3),
            np.broadcast_to(at_camera + np.arange(3), (rays.count, 3)),
        ],
        -1,
    )
    row = np.broadcast_to(np.arange(2 * rays.count).reshape(-1, 2, 1), (rays.count, 2, 12)).ravel()
    column = np.broadcast_to(columns[:, None], (rays.count, 2, 12)).ravel()

    def state(x: np.ndarray) -> NetworkState:
        change = x[:at_points].reshape(-1, 6)
        interior = start.interior.copy()
        interior[0, free] += size * x[at_camera:]
        return NetworkState(
            interior,
            exp_so3(change[:, 3:]) @ start.R,
            start.centre + change[:, :3],
            start.points + x[at_points:at_camera].reshape(-1, 3),
            start.bar_length_m,
        )

    def residuals(x: np.ndarray) -> np.ndarray:
        return ((project(network, state(x), rays.image, rays.point) - rays.xy_px) / SIGMA_PX).ravel()

    def jacobian(x: np.ndarray) -> coo_array:
        from truing.estimation.rotation import left_jacobian_so3

        at = linearise(network, state(x), rays.image, rays.point)
        by_image = at.by_image.copy()
        by_image[..., 3:] = by_image[..., 3:] @ left_jacobian_so3(x[:at_points].reshape(-1, 6)[:, 3:])[rays.image]
        terms = np.concatenate([by_image, at.by_point, at.by_interior[..., free] * size], -1) / SIGMA_PX
        return coo_array((terms.ravel(), (row, column)), shape=(2 * rays.count, at_camera + 3)).tocsr()

    def solve() -> NetworkState:
        tolerance = {"ftol": _TOLERANCE, "xtol": 1e-15, "gtol": 1e-15}
        x = least_squares(residuals, np.zeros(at_camera + 3), jacobian, x_scale="jac", **tolerance).x
        return state(x)

    return solve


PEERS: dict[str, Callable[[Problem, int], Solver]] = {
    "pycolmap": lambda problem, threads: pycolmap_solver(problem, threads, False),
    "pycolmap with covariance": lambda problem, threads: pycolmap_solver(problem, threads, True),
    "pyceres, dense Schur complement": pyceres_solver,
    "gtsam": gtsam_solver,
    "scipy trf, sparse": scipy_solver,
}
