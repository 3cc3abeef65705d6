"""Maximum-likelihood rigid motion for anisotropic, correlated noise of each point in both clouds.

``target_k = R xi_k + t + f_k``, ``source_k = xi_k + e_k``, with any 3x3 covariances cov(f_k) and cov(e_k). The true
points xi_k are eliminated exactly. Then ``sum r' S^-1 r`` is least, where ``r = target - R source - t`` and ``S =
cov_target + R cov_source R'``. Source: Matei and Meer, CVPR 1999, for the case of 3D points.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from truing.estimation.covariance import apply_rotation, extreme_variances, symmetric
from truing.estimation.rigid_poses.rigid import (
    FitStatus,
    RigidFit,
    check_correspondences,
    solve_weighted,
)
from truing.estimation.rotation import exp_so3, skew

MAX_ITERATIONS = 60
# Squared length of the last step in units of its own covariance: a millionth of a standard deviation.
_SETTLED = 1e-12
# Relative difference of a covariance from a multiple of the identity that counts as rounding.
_ISOTROPIC = 1e-12


def maximum_likelihood(
    source: ArrayLike,
    target: ArrayLike,
    cov_source: ArrayLike,
    cov_target: ArrayLike,
    mask: ArrayLike | None = None,
    start: RigidFit | None = None,
) -> RigidFit:
    """Return the maximum-likelihood motion ``target = R source + t`` with a covariance that includes both clouds.

    source, target: (B, N, 3) or (N, 3) in m; cov_source in the source frame, cov_target in the target frame: (3, 3),
    (N, 3, 3) or (B, N, 3, 3) in m^2, one of the two may be zero; mask: (B, N), False for a missing point. ``start``
    (its OK entries) replaces the isotropic closed form, which is the final result for entries whose covariances are all
    multiples of the identity. Raises ValueError as `umeyama`, and for noise that is not positive definite. Status
    NOT_CONVERGED if the iteration did not converge.
    """
    used = None if mask is None else np.asarray(mask, bool)
    x, y, w = check_correspondences(source, target, used)
    used = w > 0
    C_x, C_y = _covariances(cov_source, cov_target, used)
    variance = (np.trace(C_x, axis1=-2, axis2=-1) + np.trace(C_y, axis1=-2, axis2=-1)) / 3
    sigma = np.sqrt(np.where(used, variance, 1.0))
    closed_form = solve_weighted(x, y, used / sigma**2, sigma=sigma)
    rows = np.flatnonzero(closed_form.ok & ~_all_isotropic(C_x, C_y, used))
    if not rows.size:
        return closed_form
    R, t = _starting_motion(closed_form, start, rows)
    pairs = _PointPairs(x, y, C_x, C_y, used).of(rows)
    return _merged(closed_form, rows, _damped_gauss_newton(pairs, R, t), pairs)


class _PointPairs(NamedTuple):
    """Corresponding points x, y (B, N, 3) with covariances C_x, C_y (B, N, 3, 3), and the mask (B, N) of those used."""

    x: NDArray
    y: NDArray
    C_x: NDArray
    C_y: NDArray
    used: NDArray

    def of(self, entries: NDArray) -> _PointPairs:
        """Return some entries of the batch."""
        return _PointPairs(*(values[entries] for values in self))


class _Solution(NamedTuple):
    """Motion R, t with normal matrix H (B, 6, 6), iterations (B,) and mask of converged entries (B,)."""

    R: NDArray
    t: NDArray
    H: NDArray
    steps: NDArray
    converged: NDArray


def _covariances(cov_source: ArrayLike, cov_target: ArrayLike, used: NDArray) -> tuple[NDArray, NDArray]:
    """Return both covariances as (B, N, 3, 3), with the identity for unused points."""
    covariances, smallest = [], np.zeros(used.shape)
    for name, covariance in (("cov_source", cov_source), ("cov_target", cov_target)):
        C = np.asarray(covariance, np.float64)
        if C.shape[-2:] != (3, 3):
            raise ValueError(f"{name}: found shape {C.shape}, expected (..., 3, 3)")
        C = np.where(used[..., None, None], np.broadcast_to(C, (*used.shape, 3, 3)), np.eye(3))
        if not np.allclose(C, np.swapaxes(C, -1, -2), rtol=1e-9, atol=0.0):
            raise ValueError(f"{name}: found an asymmetric or non-finite matrix, expected covariances")
        smallest_variance, largest_variance = extreme_variances(C)
        if np.any(smallest_variance < -1e-9 * largest_variance):
            raise ValueError(f"{name}: found a negative variance, expected covariances")
        smallest = smallest + np.maximum(smallest_variance, 1e-15 * largest_variance)
        covariances.append(C)
    if np.any(smallest <= 0):
        raise ValueError("cov_source, cov_target: found a point with noise on neither cloud, expected some")
    return covariances[0], covariances[1]


def _all_isotropic(C_x: NDArray, C_y: NDArray, used: NDArray) -> NDArray:
    """Return the mask (B,) of entries whose used covariances are all multiples of the identity."""
    anisotropy = np.zeros(used.shape)
    for C in (C_x, C_y):
        mean = np.trace(C, axis1=-2, axis2=-1)[..., None, None] / 3
        anisotropy = np.maximum(anisotropy, np.max(np.abs(C - mean * np.eye(3)) - _ISOTROPIC * mean, axis=(-1, -2)))
    return np.all((anisotropy <= 0) | ~used, axis=-1)


def _starting_motion(closed_form: RigidFit, start: RigidFit | None, rows: NDArray) -> tuple[NDArray, NDArray]:
    R, t = closed_form.R[rows], closed_form.t[rows]
    if start is None:
        return R, t
    ok = start.ok[rows]
    return np.where(ok[:, None, None], start.R[rows], R), np.where(ok[:, None], start.t[rows], t)


def _damped_gauss_newton(pairs: _PointPairs, R: NDArray, t: NDArray) -> _Solution:
    """Return the solution of Levenberg-Marquardt from a start R, t."""
    R, t = R.copy(), t.copy()
    H, g, cost = _normal_equations(pairs, R, t)
    damping, steps = np.zeros(len(R)), np.zeros(len(R), np.int64)
    converged = np.zeros(len(R), bool)
    for _ in range(MAX_ITERATIONS):
        active = np.flatnonzero(~converged)
        if not active.size:
            break
        step = -np.linalg.solve(_damped(H[active], damping[active]), g[active, :, None])[..., 0]
        R_new, t_new = exp_so3(step[:, 3:]) @ R[active], t[active] + step[:, :3]
        H_new, g_new, cost_new = _normal_equations(pairs.of(active), R_new, t_new)
        is_small = np.einsum("bi,bij,bj->b", step, H[active], step) < _SETTLED
        is_accepted = (cost_new <= cost[active]) | is_small
        accepted = active[is_accepted]
        R[accepted], t[accepted], H[accepted], g[accepted], cost[accepted] = (
            v[is_accepted] for v in (R_new, t_new, H_new, g_new, cost_new)
        )
        damping[active] = np.where(is_accepted, damping[active] / 10, np.maximum(10 * damping[active], 1e-3))
        damping[damping < 1e-6] = 0.0
        steps[active] += 1
        converged[active] = is_small
    return _Solution(R, t, H, steps, converged)


def _damped(H: NDArray, damping: NDArray) -> NDArray:
    diagonal = np.einsum("bii->bi", H)
    return H + damping[:, None, None] * diagonal[:, :, None] * np.eye(6)


def _normal_equations(pairs: _PointPairs, R: NDArray, t: NDArray) -> tuple[NDArray, NDArray, NDArray]:
    """Return the normal matrix (B, 6, 6), the exact gradient (B, 6) and the cost (B,), ``sum r' S^-1 r / 2``. S depends
    on R through the estimated true points ``xi = x + cov_source R' S^-1 r``: the gradient is ``sum J' S^-1 r`` with ``J
    = [-I, [R xi]x]``, without approximation."""
    x, y, C_x, C_y, used = pairs
    Rt = np.swapaxes(R, -1, -2)[:, None]
    rotated_cov = R[:, None] @ C_x @ Rt
    r = np.where(used[..., None], y - x @ Rt[:, 0] - t[:, None], 0.0)
    W = np.linalg.inv(symmetric(C_y + rotated_cov)) * used[..., None, None]
    weighted_residual = apply_rotation(W, r)
    J = np.zeros((*r.shape, 6))
    J[..., :3] = -np.eye(3)
    J[..., 3:] = skew(x @ Rt[:, 0] + apply_rotation(rotated_cov, weighted_residual))
    H = np.einsum("bnki,bnkl,bnlj->bij", J, W, J, optimize=True)
    return (
        symmetric(H),
        np.einsum("bnki,bnk->bi", J, weighted_residual),
        np.einsum("bni,bni->b", r, weighted_residual) / 2,
    )


def _merged(analytic: RigidFit, rows: NDArray, solved: _Solution, pairs: _PointPairs) -> RigidFit:
    """Return the closed-form fits with iterated results in their rows."""
    R, t, H, steps, converged = solved
    squared_residual = np.sum((pairs.y - pairs.x @ np.swapaxes(R, -1, -2) - t[:, None]) ** 2, axis=-1)
    rms = np.sqrt(np.sum(pairs.used * squared_residual, axis=-1) / pairs.used.sum(-1))
    status = np.where(converged, analytic.status[rows], str(FitStatus.NOT_CONVERGED))
    merged = {"R": R, "t": t, "covariance": symmetric(np.linalg.inv(H)), "rms": rms}
    merged |= {"status": status, "iterations": steps}
    closed_form = {name: getattr(analytic, name).copy() for name in merged}
    for name, values in merged.items():
        closed_form[name][rows] = values
    return replace(analytic, **closed_form).masked()
