"""Maximum likelihood fit of implicit models with errors in all measurements, without poses that disagree.

A pose is tested against its prediction from the agreeing poses: the chi-square of its equations against their own noise
and that of the prediction, relative to the noise of the others, is an F ratio. The set of agreeing poses is a fixpoint
of this test. It grows from the half that is nearest to a resistant fit, in which the pull of a pose is bounded.

All poses share the values; the deviations of each pose are eliminated. The result is the exact maximum: equations are
linearised at current values and deviations until both converge.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from truing.estimation.covariance import symmetric
from truing.estimation.errors_in_variables.descent import (
    Constraint,
    Descent,
    Eliminated,
    ImplicitModel,
    Objective,
    Prior,
    column_scale,
    descend,
    linearise,
    project,
    times,
)
from truing.estimation.least_squares.solver import SolverStatus

# Probability that a campaign without bad poses loses any pose.
FALSE_ALARM = 0.005
# Least share of a pose's noise in its residual; below it, other data do not test the pose.
_REDUNDANT = 1e-6
_RESISTANT_ROUNDS = 15
_RESISTANT_SETTLED = 0.05
_FREE_ROUNDS = 10  # rounds in which poses may return; afterwards the search must end
_STUDENT = 2.0  # degrees of freedom of Student's t in a resistant fit
# Mean square of the nearest half, in declared variances, above which other halves are tried as well.
_SUSPICIOUS = 9.0
_STARTS, _CONCENTRATIONS = 40, 5
_LEAST_DAMPING = 1e-13
# Maximum number of selections of agreeing poses, one after each fit.
_SELECTIONS = 10
# Eigenvalue of the scaled information below which a combination of values is not determined.
_UNDETERMINED = 1e-12
_SAFE_TRACE_SHARE = 0.01  # eigenvalues are skipped if the sum of the inverse ones is below this share of the limit
_LEAST_SHARE = 1e-5  # share of a value in such a combination
_NEARLY_SETTLED = 1e-9  # squared change of deviations, in sigmas


@dataclass(frozen=True)
class LinearPoses:
    """Whitened equations ``residual + jacobian step`` of each pose, and a prior; columns of about unit length."""

    residual: NDArray  # (B, m)
    jacobian: NDArray  # (B, m, P)
    information: NDArray  # (P, P) of the prior
    slope: NDArray  # (P,) half the gradient of its cost

    def fit(self, weight: NDArray) -> PoseFit:
        """Return the fit with weights (B,) of the poses."""
        size = len(self.slope)
        rows = (weight[:, None, None] * self.jacobian).reshape(-1, size)
        normal = rows.T @ self.jacobian.reshape(-1, size) + self.information + _LEAST_DAMPING * np.eye(size)
        step = -np.linalg.solve(normal, rows.T @ self.residual.ravel() + self.slope)
        return PoseFit(self, weight, normal, self.residual + self.jacobian @ step)

    def squares(self, weights: NDArray) -> NDArray:
        """Return the squared lengths (S, B) of the poses' residuals after fits with weights (S, B)."""
        poses, _, size = self.jacobian.shape
        turned = np.swapaxes(self.jacobian, 1, 2)
        normal = (weights @ (turned @ self.jacobian).reshape(poses, -1)).reshape(-1, size, size)
        normal += self.information + _LEAST_DAMPING * np.eye(size)
        slope = weights @ (turned @ self.residual[..., None])[..., 0] + self.slope
        step = -np.linalg.solve(normal, slope[..., None])[..., 0]
        residual = self.residual + (step @ self.jacobian.reshape(-1, size).T).reshape(-1, *self.residual.shape)
        return np.sum(residual**2, -1)


@dataclass(frozen=True)
class PoseFit:
    """A linear fit with weights of the poses."""

    problem: LinearPoses
    weight: NDArray  # (B,)
    normal: NDArray  # (P, P)
    residual: NDArray  # (B, m)

    @property
    def length(self) -> NDArray:
        """Length (B,) of each pose's residual."""
        return np.sqrt(np.sum(self.residual**2, -1))

    def trimmed(self, count: int) -> float:
        """Return the sum of squares of the `count` poses with the smallest residuals."""
        return float(np.sum(np.sort(np.sum(self.residual**2, -1))[:count]))

    @property
    def distance(self) -> NDArray:
        """Length (B,) of each pose's residual relative to the median."""
        length = self.length
        return length / max(float(np.median(length)), np.finfo(float).tiny)

    def leave_one_out(self) -> LeaveOneOutPrediction:
        """Return the test of each pose against the others, for weights that are 0 or 1."""
        jacobian = self.problem.jacobian
        follows = jacobian @ np.linalg.inv(self.normal) @ np.swapaxes(jacobian, 1, 2)
        return leave_one_out(self.residual, follows, self.weight > 0)


@dataclass(frozen=True)
class LeaveOneOutPrediction:
    """Prediction of each pose from the other poses of a set."""

    surprise: NDArray  # (B,) chi-square of the pose against the prediction, at the declared noise
    tested: NDArray  # (B,) degrees of freedom of the surprise
    redundancy: NDArray  # (B,) sum of the redundancy numbers of the pose's equations
    p_value: NDArray  # (B,) probability of at least this surprise for a good pose
    chi_square: float  # of the set
    freedom: float  # of the set

    @property
    def passes(self) -> NDArray:
        """Mask (B,) of poses that agree with the set."""
        return self.p_value >= FALSE_ALARM / len(self.p_value)


def leave_one_out(residual: NDArray, follows: NDArray, used: NDArray) -> LeaveOneOutPrediction:
    """Return the test of each pose against the fitted set, used (B,).

    residual (B, m): whitened; follows (B, m, m): covariance of each pose's equations due to the fitted values.
    """
    sign = np.where(used, -1.0, 1.0)[:, None, None]
    spread, axes = np.linalg.eigh(np.eye(residual.shape[1]) + sign * follows)
    along = np.einsum("bmk,bm->bk", axes, residual) ** 2
    is_observed = spread > _REDUNDANT
    surprise = np.sum(np.divide(along, spread, out=np.zeros_like(along), where=is_observed), -1)
    redundancy = residual.shape[1] - np.einsum("bmm->b", follows) * used
    chi_square, freedom = float(np.sum(residual[used] ** 2)), float(redundancy[used].sum())
    tested = is_observed.sum(-1)
    return LeaveOneOutPrediction(
        surprise,
        tested,
        redundancy,
        _p_values(surprise, tested, used, chi_square, freedom),
        chi_square,
        freedom,
    )


def _p_values(surprise: NDArray, tested: NDArray, used: NDArray, chi_square: float, freedom: float) -> NDArray:
    """Return the p-values (B,) of surprises relative to the noise of the set without the pose itself."""
    from scipy.special import fdtrc

    level_of_others = np.maximum(chi_square - used * surprise, np.finfo(float).tiny)
    left = freedom - used * tested
    open_to_test = (left > 0.5) & (tested > 0)
    left, count = np.where(open_to_test, left, 1.0), np.maximum(tested, 1)
    with np.errstate(over="ignore"):  # the others have no residual: the ratio is infinite
        ratio = surprise / count / (level_of_others / left)
    return np.where(open_to_test, fdtrc(count, left, ratio), 1.0)


def agreeing_poses(problem: LinearPoses) -> NDArray:
    """Return the mask (B,) of agreeing poses."""
    nearest_half = _nearest_half(problem)
    for k in range(2 * _FREE_ROUNDS + len(nearest_half)):
        passes = problem.fit(nearest_half.astype(float)).leave_one_out().passes
        mask = passes if k < _FREE_ROUNDS else passes & nearest_half
        if np.array_equal(mask, nearest_half):
            break
        nearest_half = mask
    return nearest_half


def _nearest_half(problem: LinearPoses) -> NDArray:
    """Return the half of the poses (B,) nearest to its own fit, with further poses within the noise of this half."""
    from scipy.special import chdtrc, chdtri

    poses, equations, size = problem.jacobian.shape
    enough = min(poses, (poses + -(-size // equations) + 1) // 2)
    core = _smallest_residual_weights(_resistant(problem).length, enough)
    if problem.fit(core).trimmed(enough) > _SUSPICIOUS * enough * equations:
        core = _nearest_of_many(problem, core, enough)
    assessed = problem.fit(core).leave_one_out()
    tested = np.maximum(assessed.tested, 1)
    level = np.median(assessed.surprise / chdtri(tested, 0.5))
    return (core > 0) | (chdtrc(tested, assessed.surprise / level) >= FALSE_ALARM / poses)


def _smallest_residual_weights(length: NDArray, count: int) -> NDArray:
    """Return weights (..., B) that keep the poses with the smallest residuals."""
    weight = np.zeros_like(length)
    np.put_along_axis(weight, np.argsort(length, -1, kind="stable")[..., :count], 1.0, -1)
    return weight


def _nearest_of_many(problem: LinearPoses, core: NDArray, enough: int) -> NDArray:
    """Return the best-fitting half (B,) among those reached from fits to few poses (Rousseeuw and Van Driessen,
    1999)."""
    poses, equations, size = problem.jacobian.shape
    few = min(poses, -(-size // equations) + 1)
    drawn = _smallest_residual_weights(np.random.default_rng(0).random((_STARTS, poses)), few)
    weights = np.concatenate([core[None], drawn])
    for _ in range(_CONCENTRATIONS):
        weights = _smallest_residual_weights(problem.squares(weights), enough)
    trimmed = np.sort(problem.squares(weights), -1)[:, :enough].sum(-1)
    return np.asarray(weights[np.argmin(trimmed)])


def _resistant(problem: LinearPoses) -> PoseFit:
    """Return a resistant fit: first with least sum of residual lengths, then with decreasing influence."""
    fit = problem.fit(np.ones(len(problem.residual)))
    for weights in (_median_weights, _student_weights):
        for _ in range(_RESISTANT_ROUNDS):
            fit, before = problem.fit(weights(fit)), fit.weight
            if np.all(np.abs(fit.weight - before) <= _RESISTANT_SETTLED * fit.weight):
                break
    return fit


def _median_weights(fit: PoseFit) -> NDArray:
    """Return the weights (B,) whose fit has the least sum of residual lengths."""
    return 1 / np.maximum(fit.distance, 0.1)


def _student_weights(fit: PoseFit) -> NDArray:
    """Return the weights (B,) of Student's t with one dimension per equation."""
    equations = fit.residual.shape[1]
    return (_STUDENT + equations) / (_STUDENT + equations * fit.distance**2)


@dataclass(frozen=True)
class ErrorsInVariablesFit:
    """Fitted values with covariance and test statistics; poses of weight zero are excluded from all of it."""

    values: NDArray  # (P,)
    deviations: NDArray  # (B, n) estimated truth minus measured
    weight: NDArray  # (B,) 1, or 0 for an excluded pose
    chi_square: NDArray  # (B,) cost of each pose's deviations, including excluded poses
    residual: NDArray  # (B, m) whitened equations at the maximum
    jacobian: NDArray  # (B, m, P) their derivatives, whitened by the noise of all measurements
    information: NDArray  # (P, P) information of the data alone, at the declared noise
    covariance: NDArray  # (P, P) of the values at the declared noise; NaN if not determined
    prior: Prior
    cost: float  # sum of weight * chi_square, plus the prior's squared distance
    iterations: int
    status: SolverStatus

    @property
    def ok(self) -> bool:
        """True if the fit is a maximum that determines all values."""
        return self.status == SolverStatus.CONVERGED

    def covariance_at(self, noise_ratio: float) -> NDArray:
        """Return the covariance (P, P) for a noise `noise_ratio` times the declared one; the prior is not scaled."""
        return _covariance(self.information / noise_ratio**2 + self.prior.information)

    @cached_property
    def leave_one_out(self) -> LeaveOneOutPrediction:
        """Test of each pose against the others; its redundancy is the freedom of the pose's chi-square."""
        inverse = _inverse_where_determined(self.information + self.prior.information)[0]
        return leave_one_out(self.residual, self.jacobian @ inverse @ np.swapaxes(self.jacobian, 1, 2), self.weight > 0)

    @property
    def noise_ratio(self) -> float:
        """Noise of the agreeing poses relative to the declared one; NaN without redundancy."""
        freedom = self.leave_one_out.freedom
        return float(np.sqrt(self.leave_one_out.chi_square / freedom)) if freedom > 0 else float("nan")


def fit_errors_in_variables(
    constrain: Constraint,
    covariance: ArrayLike,
    start: ArrayLike,
    prior: Prior | None = None,
    *,
    robust: bool = True,
) -> ErrorsInVariablesFit:
    """Return the values that minimise ``sum d' C^+ d + prior`` with all equations satisfied exactly.

    constrain(values (P,), deviation (B, n)): equations (B, m) with exact derivatives, zero at the truth; covariance (B,
    n, n): of each pose's measurements, singular for exact ones; start (P,). If robust, poses that do not agree with the
    others are excluded. Raises ValueError for shapes that do not match, for invalid covariances or priors, and for
    equations without any error.
    """
    values = np.atleast_1d(np.array(start, float))
    measured = ImplicitModel(constrain, _checked_covariance(covariance))
    known = _checked_prior(prior, len(values))
    with np.errstate(all="ignore"):  # trials at which the model has no value are rejected
        return _fit(measured, _linearised(measured, values), known, robust)


def _fit(measured: ImplicitModel, at: Eliminated, prior: Prior, robust: bool) -> ErrorsInVariablesFit:
    """Return the fit to the agreeing poses, which are selected again after each fit until the set is stable. The first
    selection precedes the first fit, since gross errors would move that fit out of the linear range."""
    poses, iterations = _agreeing_poses(at, prior) if robust else np.ones(len(at.residual), bool), 0
    for selection in range(_SELECTIONS):
        descent = descend(Objective(measured, prior, poses.astype(float)), at)
        at, iterations = _with_converged_deviations(measured, descent.at, poses), iterations + descent.iterations
        agree = _agreeing_poses(at, prior) if robust else poses
        # late in the search no pose may return, so that it ends
        agree = agree & poses if 2 * selection > _SELECTIONS else agree
        if np.array_equal(agree, poses):
            break
        used, poses = poses, agree
    else:
        descent, poses = replace(descent, status=SolverStatus.ITERATION_LIMIT), used
    return _result(measured, replace(descent, at=at, iterations=iterations), prior, poses)


def _with_converged_deviations(measured: ImplicitModel, at: Eliminated, used: NDArray) -> Eliminated:
    """Return the model with the deviations of excluded poses converged, as far as possible."""
    if used.all():
        return at
    try:
        return project(measured, at.values, at.closing_pull, np.ones(len(used)), _NEARLY_SETTLED)
    except np.linalg.LinAlgError:
        return at


def _agreeing_poses(at: Eliminated, prior: Prior) -> NDArray:
    """Return the mask (B,) of agreeing poses, all linearised; all of them if the model has no value."""
    if not (np.isfinite(at.residual).all() and np.isfinite(at.jacobian).all()):
        return np.ones(len(at.residual), bool)
    rows = at.jacobian.reshape(-1, len(at.values))
    scale = column_scale(np.diag(np.sum(rows**2, 0)) + prior.information)
    known = prior.information / np.outer(scale, scale)
    return agreeing_poses(LinearPoses(at.residual, at.jacobian / scale, known, prior.pull(at.values) / scale))


def _result(measured: ImplicitModel, descent: Descent, prior: Prior, used: NDArray) -> ErrorsInVariablesFit:
    at = descent.at
    rows = at.jacobian[used].reshape(-1, len(at.values))
    information = rows.T @ rows
    covariance = _covariance(information + prior.information)
    deficient = descent.status == SolverStatus.CONVERGED and bool(np.isnan(covariance).any())
    return ErrorsInVariablesFit(
        values=at.values,
        deviations=times(measured.covariance, at.closing_pull),
        weight=used.astype(float),
        chi_square=at.chi_square,
        residual=at.residual,
        jacobian=at.jacobian,
        information=information,
        covariance=covariance,
        prior=prior,
        cost=descent.cost,
        iterations=descent.iterations,
        status=SolverStatus.RANK_DEFICIENT if deficient else descent.status,
    )


def _covariance(information: NDArray) -> NDArray:
    """Return the inverse (P, P) of an information, NaN for undetermined values."""
    inverse, determined = _inverse_where_determined(information)
    return np.where(determined & determined[:, None], inverse, np.nan)


def _inverse_where_determined(information: NDArray) -> tuple[NDArray, NDArray]:
    """Return the inverse (P, P) of an information on its determined space, and the mask (P,) of determined values."""
    if not np.isfinite(information).all():
        return np.full_like(information, np.nan), np.zeros(len(information), bool)
    scale = column_scale(information)
    scaled = information / np.outer(scale, scale)
    if (inverse := _plain_inverse(scaled)) is not None:
        return inverse / np.outer(scale, scale), np.ones(len(scale), bool)
    strength, axes = np.linalg.eigh(scaled)
    is_observed = strength > _UNDETERMINED
    root = axes[:, is_observed] / scale[:, None]
    return (root / strength[is_observed]) @ root.T, np.abs(axes[:, ~is_observed]).max(-1, initial=0.0) < _LEAST_SHARE


def _plain_inverse(matrix: NDArray) -> NDArray | None:
    """Return the inverse of a matrix of unit diagonal, or None if it may be rank deficient. The trace of the inverse
    bounds the least eigenvalue. Eigenvalues would take three times as long, and far longer on two threads."""
    try:
        inverse = np.linalg.inv(matrix)
    except np.linalg.LinAlgError:
        return None
    return symmetric(inverse) if 0.0 < np.trace(inverse) < _SAFE_TRACE_SHARE / _UNDETERMINED else None


def _checked_covariance(covariance: ArrayLike) -> NDArray:
    C = np.asarray(covariance, float)
    if C.ndim != 3 or C.shape[1] != C.shape[2] or not C.size:
        raise ValueError(f"covariance: found shape {C.shape}, expected (B, n, n), one matrix per pose")
    if not np.all(np.abs(C - np.swapaxes(C, 1, 2)) <= 1e-9 * np.abs(C)):
        raise ValueError("covariance: found an asymmetric or non-finite matrix, expected covariances")
    return symmetric(C)


def _checked_prior(prior: Prior | None, size: int) -> Prior:
    if prior is None:
        return Prior(np.zeros(size), np.zeros((size, size)))
    if prior.mean.shape != (size,) or prior.information.shape != (size, size):
        actual = f"mean {prior.mean.shape} and information {prior.information.shape}"
        raise ValueError(f"prior: found {actual}, expected ({size},) and ({size}, {size})")
    return prior


def _linearised(measured: ImplicitModel, start: NDArray) -> Eliminated:
    """Return the model at the start. Raises ValueError if an equation of a pose contains no measurement with an
    error."""
    poses, size = measured.covariance.shape[:2]
    try:
        return linearise(measured, start, np.zeros((poses, size)))
    except np.linalg.LinAlgError as error:
        raise ValueError(
            "covariance: found a pose whose equations contain combinations without any error, expected noise on each"
        ) from error
