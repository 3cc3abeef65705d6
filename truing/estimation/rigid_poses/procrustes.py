"""Joint estimate of a body's poses and its shape: generalised Procrustes analysis with covariances, and start values.

``y_bk = R_b (xi_k + u_bk) + t_b + f_bk`` with any 3x3 cov(f). u is the deformation of target k, of unknown variance
tau_k^2 per coordinate. A survey is one observation of the shape. Without a survey, inner constraints keep the frame of
the first approximation (Baarda's S-transformation; Goodall, J. R. Stat. Soc. B 53 (1991) 285).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from truing.estimation.covariance import apply_rotation, symmetric
from truing.estimation.rigid_poses.rigid import FitStatus, RigidFit
from truing.estimation.rigid_poses.robust import consensus
from truing.estimation.rigid_poses.shape_poses import (
    inverse_noise,
    pose_equations,
    residuals_on_shape,
    shape_coupling,
)
from truing.estimation.rigid_poses.umeyama import umeyama
from truing.estimation.rotation import exp_so3, rigid_motions

# Noise ratios that are tried to include poses: bodies may flex by more than their noise.
_RATIOS = (1.0, 3.0, 10.0, 30.0)
_STARTS, _ALIKE = 5, 200  # poses that are tried as the start, of so many that share most targets
_REFINEMENTS = 10
_SHAPE_SETTLED = 0.01  # relative to the noise
_TURNS = 3
# Distance, in standard deviations per coordinate of one point, up to which two noisy points are equal.
_LIMIT = 6.0
MAX_ITERATIONS = 50
MAX_VARIANCE_ROUNDS = 100
_SETTLED = 1e-10
# Relative change of a target's standard deviation, noise included, that has no relevant effect on the efficiency.
_VARIANCE_SETTLED = 1e-2


def common_shape(points: NDArray, mask: NDArray, sigma: float) -> NDArray:
    """Return the shape (N, 3), in m, of targets in connected poses; NaN for the others.

    points (B, N, 3) in m, mask (B, N), sigma: standard deviation per coordinate of a point, in m. Starts from the pose
    that shares most targets with the others, or from another one if few poses agree with that. The others are added by
    consensus with the shape, those with most common targets first. Each target is put at its median over the poses,
    where most poses saw it if it was moved. Axes of the start's measurement frame, origin at the mean of its targets.
    All NaN if no pose has three targets.
    """
    points = np.where(mask[..., None], points, 0.0)
    common_targets = mask.astype(float) @ mask.sum(axis=0)  # targets in common with each pose, summed over all poses
    connectable = np.flatnonzero((mask.sum(axis=1) >= 3) & (common_targets > 0.0))
    if not connectable.size or sigma <= 0.0:
        return np.full(points.shape[1:], np.nan)
    by_common_targets = connectable[np.argsort(-common_targets[connectable], kind="stable")]
    starts = by_common_targets[np.unique(np.linspace(0, min(len(by_common_targets), _ALIKE) - 1, _STARTS).astype(int))]
    best: _Agreeing | None = None
    for first in starts:  # a gross error in the first pose would make all others disagree
        agreeing = _agreeing_from(int(first), points, mask, sigma)
        best = agreeing if best is None or agreeing.agreed.sum() > best.agreed.sum() else best
        if 2 * best.agreed.any(axis=1).sum() > len(connectable):
            break
    assert best is not None
    shape, known = best.shape, best.known
    return np.where(known[:, None], _refined(shape, known, points, mask, best.agreed, best.needed), np.nan)


@dataclass(frozen=True)
class _Agreeing:
    """A shape (N, 3), m, its known targets (N,), the points (B, N) that agree with it, and the noise that these need,
    m."""

    shape: NDArray
    known: NDArray
    agreed: NDArray
    needed: float


def _agreeing_from(start: int, points: NDArray, mask: NDArray, sigma: float) -> _Agreeing:
    """Return the shape of one pose, renewed with all poses that agree."""
    known, required_sigma = mask[start].copy(), sigma
    shape = np.where(known[:, None], points[start] - points[start][known].mean(axis=0), 0.0)
    agreed = np.zeros_like(mask)
    agreed[start] = known
    for ratio in _RATIOS:
        while _add_agreeing_poses(shape, known, points, mask, agreed, ratio * sigma):
            required_sigma = ratio * sigma
            shape, known = _renewed(shape, known, points, mask, agreed, required_sigma)
    return _Agreeing(shape, known, agreed, required_sigma)


def _add_agreeing_poses(
    shape: NDArray, known: NDArray, points: NDArray, mask: NDArray, agreed: NDArray, sigma: float
) -> bool:
    """Add to agreed (B, N) the poses with at least half as many agreeing targets as the best one; return whether any
    were added."""
    rows = np.flatnonzero(~agreed.any(axis=1) & ((mask & known).sum(axis=1) >= 3))
    if not rows.size:
        return False
    source = np.broadcast_to(shape, points[rows].shape)
    inlier, status = consensus(source, points[rows], mask[rows] & known, sigma * np.sqrt(2.0))
    count = np.where(status == FitStatus.OK, inlier.sum(axis=1), 0)
    agreeing = (count > 0) & (2 * count >= count.max())
    agreed[rows[agreeing]] = inlier[agreeing]
    return bool(agreeing.any())


def _renewed(
    shape: NDArray, known: NDArray, points: NDArray, mask: NDArray, agreed: NDArray, sigma: float
) -> tuple[NDArray, NDArray]:
    """Return the medians (N, 3) over the agreeing poses in the frame of the shape, and the mask of known ones (N,).
    Updates agreed (B, N)."""
    rows = np.flatnonzero(agreed.any(axis=1))
    fit, agreed[rows] = _agreeing_motions(shape, points[rows], mask[rows] & known, agreed[rows], sigma)
    observed = mask[rows] & fit.ok[:, None]
    in_body = (points[rows] - fit.t[:, None]) @ fit.R
    renewed = shape.copy()
    for k in np.flatnonzero(observed.any(axis=0)):
        values = in_body[observed[:, k], k]
        # an odd number of values, so that the median is one of them, not the middle between two places
        renewed[k] = np.median(values[: len(values) - 1 + len(values) % 2], axis=0)
    alignment, _ = _agreeing_motions(renewed, shape[None], known[None], known[None], sigma)
    return (alignment.apply(renewed)[0] if alignment.ok[0] else renewed), known | observed.any(axis=0)


def _agreeing_motions(
    shape: NDArray, points: NDArray, usable: NDArray, agreed: NDArray, sigma: float
) -> tuple[RigidFit, NDArray]:
    """Return the motions of the agreeing points, and the mask (B, N) of these, by turns."""
    for _ in range(_TURNS):
        fit = umeyama(shape, points, agreed)
        residual = np.linalg.norm(points - fit.apply(shape), axis=-1)
        agreed = np.where(fit.ok[:, None], usable & (residual <= _LIMIT * sigma), agreed)
    return umeyama(shape, points, agreed), agreed


def _refined(shape: NDArray, known: NDArray, points: NDArray, mask: NDArray, agreed: NDArray, sigma: float) -> NDArray:
    """Return the shape (N, 3) after updates to convergence."""
    for _ in range(_REFINEMENTS):
        renewed, _ = _renewed(shape, known, points, mask, agreed, sigma)
        change = np.median(np.linalg.norm((renewed - shape)[known], axis=-1))
        shape = renewed
        if change < _SHAPE_SETTLED * sigma:
            break
    return shape


@dataclass(frozen=True)
class ProcrustesFit:
    """Poses of B measurements and the shape of N targets; undetermined targets and poses are NaN."""

    poses: RigidFit
    shape: NDArray  # (N, 3) m, body frame
    shape_covariance: NDArray  # (3N, 3N) m^2, zero for undetermined targets
    deformation: NDArray  # (N,) m, standard deviation tau of each target's own movement, per coordinate
    status: FitStatus
    iterations: int


@dataclass(frozen=True)
class _ObservedPoints:
    """Observations: y (B, N, 3) with cov (B, N, 3, 3) if is_observed (B, N), and the survey's weight (N, 3, 3)."""

    y: NDArray
    cov: NDArray
    is_observed: NDArray
    survey: NDArray
    survey_cov: NDArray
    surveyed: NDArray

    def weights(self, tau: NDArray) -> tuple[NDArray, NDArray]:
        """Return inverse covariances (B, N, 3, 3) and (N, 3, 3), zero without an observation."""
        return inverse_noise(self.cov, tau, self.is_observed), inverse_noise(self.survey_cov, tau, self.surveyed)


@dataclass(frozen=True)
class _State:
    R: NDArray
    t: NDArray
    shape: NDArray


@dataclass(frozen=True)
class _Normal:
    """Normal equations with the poses eliminated: poses (B, 6, 6), coupling (B, 6, 3N), gradients, reduced (3N, 3N)."""

    pose: NDArray
    carried: NDArray  # pose^-1 coupling
    pose_gradient: NDArray
    shape_gradient: NDArray
    reduced: NDArray


def generalised_procrustes(
    points: NDArray,
    cov: NDArray,
    mask: NDArray,
    survey: NDArray | None = None,
    survey_cov: NDArray | None = None,
    *,
    shape: NDArray | None = None,
    deforming: bool = True,
) -> ProcrustesFit:
    """Return the joint least-squares estimate of poses and shape, with the covariance of both.

    points (B, N, 3) in m, cov (B, N, 3, 3) in m^2, mask (B, N); survey (N, 3) with survey_cov (N, 3, 3), NaN rows for
    targets without. Without survey the frame is that of ``shape`` (N, 3), a first approximation, with NaN rows for
    targets to leave out; by default that of `common_shape`. ``deforming``: estimate the variance of each target's own
    movement, which reduces the weight of targets that deform. Mask gross errors beforehand. Raises ValueError for
    shapes that do not match.
    """
    problem, state, has_pose, known = _prepare(points, cov, mask, survey, survey_cov, shape)
    if not has_pose.any():
        return _undetermined_fit(problem, has_pose)
    is_datum_free = not problem.surveyed.any()
    tau = np.zeros(problem.y.shape[1])
    noise = np.sqrt(np.trace(problem.cov[problem.is_observed].mean(axis=0)) / 3)
    iterations = 0
    for _ in range(MAX_VARIANCE_ROUNDS):
        state, normal, covariance, steps, converged = _solve(problem, state, tau, known, is_datum_free)
        iterations += steps
        renewed = _deformation(problem, state, normal, covariance) if deforming else tau
        has_settled = bool(
            np.all(np.abs(renewed - tau) < _VARIANCE_SETTLED * np.hypot(noise, np.maximum(tau, renewed)))
        )
        if has_settled or not converged:
            break
        tau = renewed
    status = FitStatus.OK if converged and has_settled else FitStatus.NOT_CONVERGED
    outcome = _Outcome(has_pose, known, status, iterations)
    return _result(problem, state, normal, covariance, tau, outcome)


def _prepare(
    points: NDArray,
    cov: NDArray,
    mask: NDArray,
    survey: NDArray | None,
    survey_cov: NDArray | None,
    shape: NDArray | None,
) -> tuple[_ObservedPoints, _State, NDArray, NDArray]:
    """Return the problem reduced to its connected part, a start, and the masks of included poses (B,) and targets
    (N,)."""
    mask = np.asarray(mask, bool)
    count = mask.shape[1]
    if points.shape != (*mask.shape, 3) or cov.shape != (*mask.shape, 3, 3):
        raise ValueError(f"found points {points.shape}, cov {cov.shape} for mask {mask.shape}, expected (B, N, ...)")
    if survey is None or survey_cov is None:
        surveyed = np.zeros(count, bool)
        survey, survey_cov = np.zeros((count, 3)), np.zeros((count, 3, 3))
        shape = common_shape(points, mask, typical_sigma(cov, mask)) if shape is None else shape
        known = np.isfinite(shape).all(axis=-1)
        shape = np.where(known[:, None], shape, 0.0)
    else:
        surveyed = np.isfinite(survey).all(axis=-1)
        survey, survey_cov = np.nan_to_num(survey), np.nan_to_num(survey_cov)
        shape, known = _extended(survey, surveyed, points, mask)
    mask = mask & known & _connected(mask & known, surveyed)[:, None]
    fit = umeyama(shape, np.where(mask[..., None], points, 0.0), mask)
    observed = mask & fit.ok[:, None]
    known = known & (observed.any(axis=0) | surveyed)
    R = np.where(fit.ok[:, None, None], fit.R, np.eye(3))
    state = _State(R, np.where(fit.ok[:, None], fit.t, 0.0), shape)
    y, C = np.where(observed[..., None], points, 0.0), np.where(observed[..., None, None], cov, np.eye(3))
    return _ObservedPoints(y, C, observed, survey, survey_cov, surveyed), state, fit.ok, known


def _connected(observed: NDArray, surveyed: NDArray) -> NDArray:
    """Return the poses (B,) connected by three common targets each, starting from the survey or from the pose with most
    targets."""
    connected = surveyed if surveyed.any() else observed[int(np.argmax(observed.sum(axis=1)))]
    while True:
        poses = (observed & connected).sum(axis=1) >= 3
        extended = connected | (observed & poses[:, None]).any(axis=0)
        if np.array_equal(extended, connected):
            return poses
        connected = extended


def typical_sigma(cov: NDArray, mask: NDArray) -> float:
    """Return the median standard deviation per coordinate, in m, of points (B, N) with covariances (B, N, 3, 3); 0 for
    none."""
    return float(np.sqrt(np.median(np.trace(cov[mask], axis1=-2, axis2=-1)) / 3)) if mask.any() else 0.0


def _extended(survey: NDArray, surveyed: NDArray, points: NDArray, mask: NDArray) -> tuple[NDArray, NDArray]:
    """Return the survey extended by targets that only the poses have seen, and the mask of known targets."""
    fit = umeyama(survey, np.where(mask[..., None], points, 0.0), (mask & surveyed).astype(np.float64))
    observed = mask & fit.ok[:, None]
    added = observed.any(axis=0) & ~surveyed
    shape = survey.copy()
    if added.any():
        in_body = np.where(observed[..., None], (points - fit.t[:, None]) @ fit.R, np.nan)
        shape[added] = np.nanmedian(in_body[:, added], axis=0)
    return shape, surveyed | added


def _solve(
    problem: _ObservedPoints, state: _State, tau: NDArray, known: NDArray, is_datum_free: bool
) -> tuple[_State, _Normal, NDArray, int, bool]:
    """Return the Gauss-Newton solution for given tau, its normal equations and the shape's covariance (3N, 3N)."""
    W, W_survey = problem.weights(tau)
    unknown = np.repeat(~known, 3)
    for step in range(1, MAX_ITERATIONS + 1):
        normal = _normal(problem, state, W, W_survey)
        covariance = _shape_covariance(normal.reduced, state.shape, known, unknown, is_datum_free)
        gradient = normal.shape_gradient - np.einsum("bi,bij->j", normal.pose_gradient, normal.carried)
        d_shape = -covariance @ gradient
        pose_step = np.linalg.solve(normal.pose, normal.pose_gradient[..., None])[..., 0]
        d_pose = -pose_step - normal.carried @ d_shape
        squared_step = np.einsum("bi,bij,bj->", pose_step, normal.pose, pose_step) + gradient @ covariance @ gradient
        state = _State(exp_so3(d_pose[:, 3:]) @ state.R, state.t + d_pose[:, :3], state.shape + d_shape.reshape(-1, 3))
        if squared_step < _SETTLED:
            return state, normal, covariance, step, True
    return state, normal, covariance, MAX_ITERATIONS, False


def _normal(problem: _ObservedPoints, state: _State, W: NDArray, W_survey: NDArray) -> _Normal:
    R = state.R
    r = residuals_on_shape(problem.y, problem.is_observed, state.shape, R, state.t)
    pose, JW = pose_equations(state.shape, R, W, problem.is_observed)
    coupling = shape_coupling(JW, R)
    Rt = np.swapaxes(R, -1, -2)[:, None]
    information = np.sum(Rt @ W @ R[:, None], axis=0) + W_survey
    carried = np.linalg.solve(pose, coupling)
    reduced = block_diag(*information) - np.tensordot(coupling, carried, axes=([0, 1], [0, 1]))
    survey_residual = np.where(problem.surveyed[:, None], state.shape - problem.survey, 0.0)
    gradient = -np.sum(apply_rotation(Rt, apply_rotation(W, r)), axis=0) + apply_rotation(W_survey, survey_residual)
    return _Normal(pose, carried, np.sum(apply_rotation(JW, r), axis=1), gradient.ravel(), symmetric(reduced))


def _shape_covariance(
    reduced: NDArray, shape: NDArray, known: NDArray, unknown: NDArray, is_datum_free: bool
) -> NDArray:
    """Return the inverse (3N, 3N) of the reduced normal matrix, with inner constraints if the datum is free."""
    mean_information = np.trace(reduced) / max(3 * known.sum(), 1)
    regular = reduced + np.diag(np.where(unknown, mean_information, 0.0))
    inner_constraints = np.zeros((len(reduced), len(reduced)))
    if is_datum_free:
        G = rigid_motions(shape)
        G = np.where(unknown[:, None], 0.0, G.reshape(-1, 6))
        basis = np.linalg.svd(G / np.linalg.norm(G, axis=0), full_matrices=False)[0]
        inner_constraints = basis @ basis.T
    inverse = np.linalg.inv(regular + mean_information * inner_constraints) - inner_constraints / mean_information
    return symmetric(np.where(unknown[:, None] | unknown, 0.0, inverse))


def _deformation(problem: _ObservedPoints, state: _State, normal: _Normal, covariance: NDArray) -> NDArray:
    """Return tau (N,): scatter of each target beyond its noise, corrected for the redundancy of the fit."""
    arm = state.shape @ np.swapaxes(state.R, -1, -2)
    r = residuals_on_shape(problem.y, problem.is_observed, state.shape, state.R, state.t)
    noise = np.trace(problem.cov, axis1=-2, axis2=-1)
    excess = np.sum(r**2, axis=-1) - noise + _fitted_share(state, normal, covariance, arm)
    count = np.maximum(3 * problem.is_observed.sum(axis=0), 1)
    return np.sqrt(np.maximum(np.sum(excess * problem.is_observed, axis=0) / count, 0.0))


def _fitted_share(state: _State, normal: _Normal, covariance: NDArray, arm: NDArray) -> NDArray:
    """Return the trace (B, N), in m^2, of the covariance of the fitted points, by which the fit reduces residuals.
    Poses move by ``dp = -X dxi + e``; cov(e) = pose^-1, independent of the shape's dxi. The fitted point moves by ``J e
    - (J X + R E_k) dxi``."""
    J = -rigid_motions(arm)
    through_poses = normal.carried @ covariance
    pose_cov = np.linalg.inv(normal.pose) + through_poses @ np.swapaxes(normal.carried, -1, -2)
    pose_shape_cov = through_poses.reshape(len(arm), 6, -1, 3)
    pose_share = np.einsum("bnij,bjk,bnik->bn", J, pose_cov, J, optimize=True)
    cross_share = np.einsum("bij,bknj,bnik->bn", state.R, pose_shape_cov, J, optimize=True)
    return pose_share + np.diagonal(covariance).reshape(-1, 3).sum(-1) + 2 * cross_share


class _Outcome(NamedTuple):
    """Masks of determined poses (B,) and targets (N,), with status and number of iterations."""

    has_pose: NDArray
    known: NDArray
    status: FitStatus
    iterations: int


def _result(
    problem: _ObservedPoints,
    state: _State,
    normal: _Normal,
    covariance: NDArray,
    tau: NDArray,
    outcome: _Outcome,
) -> ProcrustesFit:
    has_pose, known, status, iterations = outcome
    pose_covariance = np.linalg.inv(normal.pose) + normal.carried @ covariance @ np.swapaxes(normal.carried, -1, -2)
    squared_residual = np.sum((problem.y - state.shape @ np.swapaxes(state.R, -1, -2) - state.t[:, None]) ** 2, axis=-1)
    count = problem.is_observed.sum(axis=1)
    rms = np.sqrt(np.sum(squared_residual * problem.is_observed, axis=1) / np.maximum(count, 1))
    status_of_pose = np.where(has_pose, str(status), str(FitStatus.TOO_FEW_POINTS))
    ones, steps = np.ones(len(has_pose)), np.full(len(has_pose), iterations)
    poses = RigidFit(
        state.R, state.t, ones, symmetric(pose_covariance), 0 * ones, rms, count, status_of_pose, steps
    ).masked()
    shape = np.where(known[:, None], state.shape, np.nan)
    return ProcrustesFit(poses, shape, covariance, np.where(known, tau, np.nan), status, iterations)


def _undetermined_fit(problem: _ObservedPoints, has_pose: NDArray) -> ProcrustesFit:
    """Return the result if no pose shares three targets with any other."""
    count, targets = problem.is_observed.sum(axis=1), problem.y.shape[1]
    status = np.full(len(has_pose), str(FitStatus.TOO_FEW_POINTS))
    empty = np.full((len(has_pose), 6, 6), np.nan)
    ones, zeros = np.ones(len(has_pose)), np.zeros(len(has_pose), np.int64)
    poses = RigidFit(empty[:, :3, :3], empty[:, 0, :3], ones, empty, ones, ones, count, status, zeros).masked()
    return ProcrustesFit(
        poses,
        np.full((targets, 3), np.nan),
        np.zeros((3 * targets, 3 * targets)),
        np.full(targets, np.nan),
        FitStatus.TOO_FEW_POINTS,
        0,
    )
