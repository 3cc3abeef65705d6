"""Rigid motion between corresponding points, in closed form, or compiled for many points."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from truing.estimation.rigid_poses.rigid import RigidFit, check_correspondences, solve_misfit, solve_weighted

# Number of points from which compiled code is faster in spite of its loading time (0.4 s).
_WORTH_COMPILED_CODE = 1_000_000


def umeyama(
    source: ArrayLike,
    target: ArrayLike,
    weight: ArrayLike | None = None,
    *,
    with_scale: bool = False,
    sigma: ArrayLike | None = None,
    calls: int = 1,
) -> RigidFit:
    """Return the weighted least-squares rigid motion, never a reflection.

    source, target: (B, N, 3) or (N, 3) in m, broadcast against each other; weight: (B, N) or (N,), 0 for a missing
    point. Two single clouds (N, 3) give a single motion: R (3, 3), t (3,). ``sigma``, in m: standard deviation per
    coordinate of target - R source, scalar, (B, 1) or (B, N). That is the measured cloud's, or ``hypot(sigma_source,
    sigma_target)`` if both have noise. Weights need not be 1/sigma^2; the covariance is that of
    the weighted estimator. Without sigma, it comes from the scatter of residuals with weights as relative 1/variance.
    calls: number of such fits in turn, whose points together make compiled code worth its loading time.
    Raises ValueError for shapes that do not match, negative weights and used points that are not finite.
    Umeyama, IEEE PAMI 13 (1991) 376, eq. 34-43, weighted.
    """
    are_single = np.ndim(source) == np.ndim(target) == 2 and np.ndim(0.0 if weight is None else weight) < 2
    points = max(np.size(source) // 3, np.size(target) // 3, 0 if weight is None else np.size(weight))
    if calls * points >= _WORTH_COMPILED_CODE and not with_scale:
        from truing.estimation.rigid_poses.batched_kernel import solve

        rigid_fit = solve(source, target, weight, sigma=sigma)
    else:
        rigid_fit = solve_weighted(*check_correspondences(source, target, weight), with_scale=with_scale, sigma=sigma)
    return rigid_fit.only if are_single else rigid_fit


def umeyama_misfit(
    source: ArrayLike,
    target: ArrayLike,
    weight: ArrayLike | None = None,
    *,
    with_scale: bool = False,
    calls: int = 1,
) -> tuple[NDArray, NDArray]:
    """Rms (B,) in m and scale (B,) of the motions of `umeyama`, NaN where it has none; clouds and calls as there."""
    if not with_scale and calls * max(np.size(source), np.size(target)) // 3 >= _WORTH_COMPILED_CODE:
        fit = umeyama(source, target, weight)
        return fit.rms, fit.scale
    return solve_misfit(*check_correspondences(source, target, weight), with_scale=with_scale)
