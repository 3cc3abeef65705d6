"""Comparison of two surveys of a body: targets that moved, relative to a common motion, with correction for many
tests."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from truing.arrays import Array, Index, Mask
from truing.estimation.quality import holm_adjusted
from truing.estimation.rigid_poses.rigid import FitStatus
from truing.estimation.rigid_poses.robust import consensus
from truing.estimation.rigid_poses.umeyama import umeyama
from truing.estimation.rotation import rigid_motions, skew

FALSE_ALARM = 0.01  # probability that any target of an unchanged body is called moved
_CONTRADICTED = 0.01  # p-value of the others' scatter, below which it replaces the declared noise
_FLOOR = 1e-6  # least share of a target's noise in its residual, if it alone determines the frame in some direction
_ROUNDS = 20


@dataclass(frozen=True)
class SurveyComparison:
    """Differences of T targets between two surveys, in the frame of the first, SI.

    shift (T, 3): later minus earlier position, relative to the unmoved others, with cov (T, 3, 3); p_value (T,): of
    each alone; moved (T,): by all tests together. status: ok, or the reason for no result. chi_square and freedom: of
    the unmoved targets. R (3, 3), t (3,): from the first frame to that of the later survey.
    """

    shift: Array
    cov: Array
    p_value: Array
    moved: Mask
    status: str
    chi_square: float
    freedom: int
    R: Array
    t: Array
    frame_cov: Array

    def place(self, points: ArrayLike, cov: ArrayLike) -> tuple[Array, Array]:
        """Return points (N, 3) of the later survey in the first frame, with covariance (N, 3, 3) including that of the
        frame.

        cov (N, 3, 3): of the points.
        """
        in_first_frame = (np.asarray(points, float) - self.t) @ self.R
        jacobian = rigid_motions(in_first_frame)
        return in_first_frame, self.R.T @ np.asarray(cov, float) @ self.R + jacobian @ self.frame_cov @ np.swapaxes(
            jacobian, 1, 2
        )


def compare_surveys(
    before: ArrayLike, cov_before: ArrayLike, after: ArrayLike, cov_after: ArrayLike, known: ArrayLike, alarm: float
) -> SurveyComparison:
    """Compare two surveys (T, 3) of one body in different frames; cov (T, 3, 3), known (T,): declared as moved.

    The unmoved targets are the largest set that follows one rigid motion. Each target is compared with the motion of
    the unmoved others, with three degrees of freedom; Holm's correction keeps the probability of any false finding at
    ``alarm``. The noise is the declared one, unless the unmoved others contradict it.
    """
    x, y = np.asarray(before, float), np.asarray(after, float)
    Vx, Vy, is_stated = np.asarray(cov_before, float), np.asarray(cov_after, float), np.asarray(known, bool)
    largest_sigma = np.sqrt(np.linalg.eigvalsh(Vx + Vy)[:, -1])
    consistent, status = _largest_set(x, y, ~is_stated, largest_sigma)
    if status != FitStatus.OK:
        return _without_result(len(x), str(status))
    for _ in range(_ROUNDS):
        comparison = _comparison_with_others(x, Vx, y, Vy, consistent, alarm, is_stated)
        if comparison.status != FitStatus.OK or (~comparison.moved == consistent).all():
            break
        consistent = ~comparison.moved
    return comparison


def _largest_set(x: Array, y: Array, usable: Mask, sigma: Array) -> tuple[Mask, str]:
    if usable.sum() < 3:
        return usable, str(FitStatus.TOO_FEW_POINTS)
    consistent, status = consensus(x[None], y[None], usable[None], sigma[None])
    return consistent[0], str(status[0])


def _without_result(count: int, status: str) -> SurveyComparison:
    no_shift, no_cov = np.full((count, 3), np.nan), np.full((count, 3, 3), np.nan)
    return SurveyComparison(
        no_shift, no_cov, np.ones(count), np.zeros(count, bool), status, 0.0, 0, *(np.full(s, np.nan) for s in _SHAPES)
    )


_SHAPES = ((3, 3), 3, (6, 6))


def _comparison_with_others(
    x: Array, Vx: Array, y: Array, Vy: Array, mask: Mask, alarm: float, is_stated: Mask
) -> SurveyComparison:
    """Return the comparison of every target with the motion of the kept ones other than itself."""
    fit = umeyama(x[None], y[None], mask[None] / np.trace(Vx + Vy, axis1=1, axis2=2)[None])
    if not fit.ok[0]:
        return _without_result(len(x), str(fit.status[0]))
    R, t = fit.R[0], fit.t[0]
    difference = (y - t) @ R - x
    V = Vx + R.T @ Vy @ R
    jacobian, weight = rigid_motions(x), np.linalg.inv(V) * mask[:, None, None]
    motion_cov = np.linalg.inv(np.einsum("tia,tij,tjb->ab", jacobian, weight, jacobian))
    motion = motion_cov @ np.einsum("tia,tij,tj->a", jacobian, weight, difference)
    residual = difference - jacobian @ motion
    cov_of_motion = jacobian @ motion_cov @ np.swapaxes(jacobian, 1, 2)
    covariance = V * (1.0 + _FLOOR) + np.where(mask, -1.0, 1.0)[:, None, None] * cov_of_motion
    inverse = np.linalg.inv(covariance)
    square = np.einsum("ti,tij,tj->t", residual, inverse, residual)
    chi_square = float(np.einsum("ti,tij,tj->", residual, weight, residual))
    freedom = 3 * int(mask.sum()) - 6
    p = _p_values(square, chi_square - np.where(mask, square, 0.0), freedom - 3 * mask)
    # the prediction of a kept target must not use it: restore its own part of the residual
    restored = np.where(mask[:, None, None], V @ inverse, np.eye(3))
    shift = (restored @ residual[..., None])[..., 0]
    cov = np.where(mask[:, None, None], V @ inverse @ V, covariance)
    is_moved = is_stated.copy()
    is_moved[~is_stated] = holm_adjusted(p[~is_stated]) <= alarm
    small_rotation = motion[3:]
    rotation = R @ (np.eye(3) + skew(small_rotation))
    return SurveyComparison(
        shift,
        cov,
        p,
        is_moved,
        str(FitStatus.OK),
        chi_square,
        freedom,
        _nearest_rotation(rotation),
        t + R @ motion[:3],
        motion_cov,
    )


def _p_values(square: Array, sum_of_others: Array, freedom: Index) -> Array:
    """Return p-values (T,) by the declared noise, or by the scatter of the others if that contradicts it."""
    from scipy.special import chdtrc, fdtrc

    freedom_or_one = np.maximum(freedom, 1)
    scatter = np.maximum(sum_of_others, 0.0) / freedom_or_one
    contradicted = (freedom > 0) & (chdtrc(freedom_or_one, np.maximum(sum_of_others, 0.0)) < _CONTRADICTED)
    return np.where(contradicted, fdtrc(3, freedom_or_one, square / 3.0 / np.maximum(scatter, 1.0)), chdtrc(3, square))


def _nearest_rotation(matrix: Array) -> Array:
    u, _, v = np.linalg.svd(matrix)
    return np.asarray(u @ np.diag([1.0, 1.0, np.linalg.det(u @ v)]) @ v, float)
