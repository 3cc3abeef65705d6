"""The errors-in-variables calibration by other libraries: functions from the problem to a solver without arguments.

What can be done once for a kind of problem (graphs, sparsity) is done before the clock starts; each factory imports its
library, so that one that is not installed costs nothing but its row.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from benchmarks.errors_in_variables_problem import (
    POSE_SIGMA,
    READING_SIGMA,
    TOLERANCE,
    Joint,
    reading_slopes,
    residuals,
)

Solver = Callable[[], tuple[np.ndarray, np.ndarray]]  # values (42,) in tolerances, poses (B, 6) in sigmas


def _split(unknowns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return unknowns[:42], unknowns[42:].reshape(-1, 6)


def _stacked(problem: Joint, unknowns: np.ndarray) -> np.ndarray:
    return np.concatenate([part.ravel() for part in residuals(problem, *_split(unknowns))])


def _dense(problem: Joint) -> Callable[[np.ndarray], np.ndarray]:
    """Return a function that fills the whole Jacobian."""
    poses = len(problem.p)
    J = np.zeros((12 * poses + 42, 42 + 6 * poses))
    own = J[: 6 * poses, 42:].reshape(poses, 6, poses, 6)
    shared = J[6 * poses : 12 * poses, :42].reshape(poses, 6, 42)
    each = J[6 * poses : 12 * poses, 42:].reshape(poses, 6, poses, 6)
    pose = np.arange(poses)
    own[pose, :, pose] = problem.whitener
    J[12 * poses :, :42] = np.eye(42)

    def fill(unknowns: np.ndarray) -> np.ndarray:
        shared[...], each[pose, :, pose] = reading_slopes(problem, *_split(unknowns))
        return J.copy()

    return fill


def scipy_lm(problem: Joint) -> Solver:
    """Return scipy's Levenberg-Marquardt on the dense Jacobian."""
    from scipy.optimize import least_squares

    start, jacobian = np.zeros(42 + 6 * len(problem.p)), _dense(problem)

    def solve() -> tuple[np.ndarray, np.ndarray]:
        return _split(least_squares(lambda x: _stacked(problem, x), start, jacobian, method="lm").x)

    return solve


def scipy_trf(problem: Joint) -> Solver:
    """Return scipy's trust region on the sparse Jacobian."""
    from scipy.optimize import least_squares
    from scipy.sparse import csr_array

    start, jacobian = np.zeros(42 + 6 * len(problem.p)), _dense(problem)
    rows, columns = np.nonzero(jacobian(start + 1e-3))

    def sparse(x: np.ndarray) -> csr_array:
        J = jacobian(x)
        return csr_array((J[rows, columns], (rows, columns)), shape=J.shape)

    def solve() -> tuple[np.ndarray, np.ndarray]:
        return _split(least_squares(lambda x: _stacked(problem, x), start, sparse, method="trf").x)

    return solve


def ceres_whole(problem: Joint) -> Solver:
    """Return pyceres with a single residual of everything."""
    return _ceres(problem, _whole)


def ceres_pose_by_pose(problem: Joint) -> Solver:
    """Return pyceres with a residual per pose, which it eliminates."""
    return _ceres(problem, _pose_by_pose)


def _ceres(problem: Joint, formulate: Callable) -> Solver:
    import pyceres

    def solve() -> tuple[np.ndarray, np.ndarray]:
        x, e = np.zeros(42), [np.zeros(6) for _ in problem.p]
        posed, options = pyceres.Problem(), pyceres.SolverOptions()
        formulate(pyceres, problem, posed, options, x, e)
        options.logging_type = pyceres.LoggingType.SILENT
        options.function_tolerance, options.max_num_iterations = 1e-7, 50
        summary = pyceres.SolverSummary()
        pyceres.solve(options, posed, summary)
        return x, np.array(e)

    return solve


def _whole(pyceres, problem: Joint, posed, options, x: np.ndarray, e: list[np.ndarray]) -> None:  # type: ignore[no-untyped-def]
    """One residual of everything, evaluated at once by NumPy."""
    poses, jacobian = len(e), _dense(problem)

    class Whole(pyceres.CostFunction):
        def __init__(self) -> None:
            super().__init__()
            self.set_num_residuals(12 * poses + 42)
            self.set_parameter_block_sizes([42] + [6] * poses)

        def Evaluate(self, parameters, out, jacobians):  # type: ignore[no-untyped-def]
            unknowns = np.concatenate(parameters)
            out[:] = _stacked(problem, unknowns)
            if jacobians is not None:
                J = jacobian(unknowns)
                for k, block in enumerate(jacobians):
                    if block is not None:
                        block[:] = J[:, :42].ravel() if k == 0 else J[:, 36 + 6 * k : 42 + 6 * k].ravel()
            return True

    posed.add_residual_block(Whole(), None, [x, *e])
    options.linear_solver_type = pyceres.LinearSolverType.DENSE_NORMAL_CHOLESKY


def _pose_by_pose(pyceres, problem: Joint, posed, options, x: np.ndarray, e: list[np.ndarray]) -> None:  # type: ignore[no-untyped-def]
    """One residual per pose, and the values' own; Schur complement over the poses."""

    class Pose(pyceres.CostFunction):
        def __init__(self, n: int) -> None:
            super().__init__()
            self.set_num_residuals(12)
            self.set_parameter_block_sizes([42, 6])
            part = slice(n, n + 1)
            self.one = Joint(
                problem.legs, problem.p[part], problem.R[part], problem.rho[part], problem.covariance[part]
            )

        def Evaluate(self, parameters, out, jacobians):  # type: ignore[no-untyped-def]
            at = parameters[0], parameters[1][None]
            out[:6], out[6:] = (part[0] for part in residuals(self.one, *at)[:2])
            if jacobians is not None:
                by_values, by_pose = reading_slopes(self.one, *at)
                for block, above, below in zip(
                    jacobians, (np.zeros((6, 42)), self.one.whitener[0]), (by_values[0], by_pose[0]), strict=True
                ):
                    if block is not None:
                        block[:] = np.concatenate([above, below]).ravel()
            return True

    class Values(pyceres.CostFunction):
        def __init__(self) -> None:
            super().__init__()
            self.set_num_residuals(42)
            self.set_parameter_block_sizes([42])

        def Evaluate(self, parameters, out, jacobians):  # type: ignore[no-untyped-def]
            out[:] = parameters[0]
            if jacobians is not None and jacobians[0] is not None:
                jacobians[0][:] = np.eye(42).ravel()
            return True

    for n, pose in enumerate(e):
        posed.add_residual_block(Pose(n), None, [x, pose])
    posed.add_residual_block(Values(), None, [x])
    options.linear_solver_type = pyceres.LinearSolverType.DENSE_SCHUR


def casadi_exact(problem: Joint) -> Solver:
    """Return ipopt with the Hessian that casadi derives."""
    return _casadi(problem, gauss_newton=False)


def casadi_gauss_newton(problem: Joint) -> Solver:
    """Return ipopt with J'J as the Hessian."""
    return _casadi(problem, gauss_newton=True)


def _casadi(problem: Joint, gauss_newton: bool) -> Solver:
    """Ipopt on the sum of squares, with casadi's own Hessian, or with J'J in its place."""
    import casadi as ca

    x, e = ca.SX.sym("x", 42), ca.SX.sym("e", 6, len(problem.p))
    unknowns, residual = ca.vertcat(x, ca.vec(e)), ca.vertcat(x, *_casadi_poses(ca, problem, x, e))
    options = {"print_time": False, "ipopt": {"print_level": 0, "sb": "yes", "tol": 1e-3}}
    if gauss_newton:
        J, factor = ca.jacobian(residual, unknowns), ca.SX.sym("factor")
        none = ca.SX.sym("none", 0)
        options["hess_lag"] = ca.Function("hess_lag", [unknowns, none, factor, none], [factor * ca.triu(J.T @ J)])
    solver = ca.nlpsol("solver", "ipopt", {"x": unknowns, "f": 0.5 * ca.sumsqr(residual)}, options)

    def solve() -> tuple[np.ndarray, np.ndarray]:
        return _split(np.array(solver(x0=np.zeros(unknowns.numel()))["x"]).ravel())

    return solve


def _casadi_poses(ca, problem: Joint, x, e) -> list:  # type: ignore[no-untyped-def]
    """Return the residuals of poses and readings as expressions."""
    parts, values = [], problem.start + ca.DM(TOLERANCE) * x
    for n in range(len(problem.p)):
        twist = ca.DM(POSE_SIGMA) * e[:, n]
        parts.append(ca.DM(problem.whitener[n]) @ e[:, n])
        K, t = ca.skew(twist[3:]), ca.sumsqr(twist[3:])
        R = ca.SX.eye(3) + (1 - t / 6 + t**2 / 120) * K + (0.5 - t / 24 + t**2 / 720) * (K @ K)
        for leg in range(6):
            v = values[7 * leg : 7 * leg + 7]
            u = ca.vertcat(v[4], v[5], ca.sqrt(1 - v[4] ** 2 - v[5] ** 2))
            a, b = ca.vertcat(v[0:2], problem.legs.a[leg, 2]), ca.vertcat(v[2:4], problem.legs.b[leg, 2])
            h = problem.p[n] + twist[:3] + R @ (ca.DM(problem.R[n]) @ b) - a
            along = ca.dot(h, u)
            rho = along - ca.sqrt(along**2 - ca.sumsqr(h) + v[6] ** 2)
            parts.append((rho - problem.rho[n, leg]) / READING_SIGMA)
    return parts


PEERS: dict[str, Callable[[Joint], Solver]] = {
    "casadi ipopt, its own Hessian": casadi_exact,
    "casadi ipopt, J'J supplied": casadi_gauss_newton,
    "pyceres, pose by pose": ceres_pose_by_pose,
    "pyceres, all at once": ceres_whole,
    "scipy lm, analytic": scipy_lm,
    "scipy trf, analytic, sparse": scipy_trf,
}
