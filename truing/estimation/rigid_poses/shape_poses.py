"""Poses of a body on the shape that many poses have in common, one pose independent of the others.

The poses of `generalised_procrustes` minimise its sum of squares for its shape, so each follows from the shape alone.
Its covariance has a part of the pose's own points, and one of the shape.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truing.estimation.covariance import apply_rotation, symmetric
from truing.estimation.rotation import exp_so3, rigid_motions

MAX_ITERATIONS = 50
_SETTLED = 1e-10  # squared length of a step in units of its own covariance


@dataclass(frozen=True)
class JointShape:
    """Shape (N, 3) in m of N targets, zero if unknown, with covariance (3N, 3N) in m^2 and their own movement tau (N,)
    in m; known (N,)."""

    shape: NDArray
    covariance: NDArray
    tau: NDArray
    known: NDArray


def inverse_noise(cov: NDArray, tau: NDArray, used: NDArray) -> NDArray:
    """Return the inverse covariances (..., N, 3, 3) of points that move by tau (N,) of their own, zero if not used."""
    regular = np.where(used[..., None, None], cov + (tau**2)[:, None, None] * np.eye(3), np.eye(3))
    return np.linalg.inv(symmetric(regular)) * used[..., None, None]


def residuals_on_shape(y: NDArray, is_observed: NDArray, shape: NDArray, R: NDArray, t: NDArray) -> NDArray:
    """Return measured minus fitted points (B, N, 3) in the target frame, zero if not seen."""
    return np.where(is_observed[..., None], y - shape @ np.swapaxes(R, -1, -2) - t[:, None], 0.0)


def pose_equations(shape: NDArray, R: NDArray, W: NDArray, is_observed: NDArray) -> tuple[NDArray, NDArray]:
    """Return the normal matrices (B, 6, 6) of poses, the identity without points, and ``J' W`` (B, N, 6, 3) of each
    point's residual."""
    J = -rigid_motions(shape @ np.swapaxes(R, -1, -2))
    JW = np.swapaxes(J, -1, -2) @ W
    free = np.where(is_observed.any(axis=1), 0.0, 1.0)
    return np.sum(JW @ J, axis=1) + free[:, None, None] * np.eye(6), JW


def shape_coupling(JW: NDArray, R: NDArray) -> NDArray:
    """Return the part (B, 6, 3N) of the normal matrix between poses and shape."""
    return np.swapaxes(-JW @ R[:, None], 1, 2).reshape(len(R), 6, 3 * JW.shape[1])


def poses_on_shape(
    joint: JointShape, y: NDArray, cov: NDArray, is_observed: NDArray, R: NDArray, t: NDArray
) -> tuple[NDArray, NDArray, NDArray]:
    """Return R (B, 3, 3), t (B, 3) and the mask (B,) of converged poses, from a start.

    y (B, N, 3) in m with cov (B, N, 3, 3), of the points is_observed (B, N), which must determine each pose.
    """
    R, t, converged = R.copy(), t.copy(), np.zeros(len(R), bool)
    W = inverse_noise(cov, joint.tau, is_observed)
    for _ in range(MAX_ITERATIONS):
        a = np.flatnonzero(~converged)
        if not a.size:
            break
        normal, JW = pose_equations(joint.shape, R[a], W[a], is_observed[a])
        r = residuals_on_shape(y[a], is_observed[a], joint.shape, R[a], t[a])
        gradient = np.sum(apply_rotation(JW, r), axis=1)
        step = -np.linalg.solve(normal, gradient[..., None])[..., 0]
        small = np.einsum("bi,bij,bj->b", step, normal, step) < _SETTLED
        moved = a[~small]
        R[moved], t[moved] = exp_so3(step[~small, 3:]) @ R[moved], t[moved] + step[~small, :3]
        converged[a] = small
    return R, t, converged


def covariance_on_shape(joint: JointShape, cov: NDArray, is_observed: NDArray, R: NDArray) -> NDArray:
    """Return the covariance (B, 6, 6) of poses, from the noise of their own points and that of the shape."""
    normal, JW = pose_equations(joint.shape, R, inverse_noise(cov, joint.tau, is_observed), is_observed)
    inverse = np.linalg.inv(normal)
    carried = inverse @ shape_coupling(JW, R)
    return symmetric(inverse + carried @ joint.covariance @ np.swapaxes(carried, -1, -2))
