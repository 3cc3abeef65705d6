"""Maximum likelihood for implicit models in which everything measured carries an error, with bad poses left out.

All poses share the values; each pose has deviations of the truth from what was measured, which are eliminated. The
result is the exact maximum: equations are linearised anew at the values and deviations reached until both have settled.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from truing.estimation.covariance import symmetric
from truing.estimation.errors_in_variables.agreement import Judgement, LinearPoses, agreeing, judge
from truing.estimation.errors_in_variables.descent import Descent, Objective, Prior, column_scale, descend
from truing.estimation.errors_in_variables.elimination import (
    Constraint,
    Eliminated,
    Measured,
    linearise,
    project,
    times,
)
from truing.estimation.least_squares.solver import SolverStatus

# How often the poses that agree may be chosen anew after a fit to those that did.
_SELECTIONS = 10
# Eigenvalue of the information, columns scaled, below which a combination of values is not determined.
_UNDETERMINED = 1e-12
_PLAIN = 0.01  # no need to look, where the sum of the inverse eigenvalues stays below this share of that limit
_TAKES_PART = 1e-5  # share of a value in such a combination
_NEARLY_SETTLED = 1e-9  # squared change of deviations, in sigmas


@dataclass(frozen=True)
class ErrorsInVariablesFit:
    """The values at the maximum and what is known of them; all of it without the poses of weight zero."""

    values: NDArray  # (P,)
    deviations: NDArray  # (B, n) estimated truth minus measured
    weight: NDArray  # (B,) 1, or 0 for a pose that was left out
    chi_square: NDArray  # (B,) what each pose's deviations cost, also of those left out
    residual: NDArray  # (B, m) whitened equations at the maximum
    jacobian: NDArray  # (B, m, P) their derivatives: whitened by the noise of all that was measured
    information: NDArray  # (P, P) what the data alone say of the values, at the declared noise
    covariance: NDArray  # (P, P) of the values at the declared noise; NaN for what is not determined
    prior: Prior
    cost: float  # sum of weight * chi_square, and of the prior's squared distance
    iterations: int
    status: SolverStatus

    @property
    def ok(self) -> bool:
        """Return whether the fit stands at a maximum in which all values are determined."""
        return self.status == SolverStatus.CONVERGED

    def covariance_at(self, noise_ratio: float) -> NDArray:
        """Return the covariance (P, P) where the noise is so many times the declared one; the prior stays as it is."""
        return _covariance(self.information / noise_ratio**2 + self.prior.information)

    @cached_property
    def judgement(self) -> Judgement:
        """Return how each pose stands to the others, with the redundancy that is the freedom of its chi-square."""
        inverse = _inverse_where_determined(self.information + self.prior.information)[0]
        return judge(self.residual, self.jacobian @ inverse @ np.swapaxes(self.jacobian, 1, 2), self.weight > 0)

    @property
    def noise_ratio(self) -> float:
        """Return the noise found in the poses that agree over the declared one; NaN where nothing is left over."""
        freedom = self.judgement.freedom
        return float(np.sqrt(self.judgement.chi_square / freedom)) if freedom > 0 else float("nan")

    @property
    def noise_ratio_sigma(self) -> float:
        """Return the standard deviation of the noise ratio."""
        freedom = self.judgement.freedom
        return self.noise_ratio / float(np.sqrt(2 * freedom)) if freedom > 0 else float("nan")


def fit_errors_in_variables(
    constrain: Constraint,
    covariance: ArrayLike,
    start: ArrayLike,
    prior: Prior | None = None,
    *,
    robust: bool = True,
) -> ErrorsInVariablesFit:
    """Return the values that minimise ``sum d' C^+ d + prior`` with all equations met exactly.

    constrain(values (P,), deviation (B, n)): equations (B, m) with exact derivatives, zero at the truth; covariance
    (B, n, n) of what was measured per pose, singular where something is known exactly; start (P,).
    Poses that do not agree with the others are left out where robust. Raises ValueError for shapes that do not
    match, for covariances or priors that are none, and for equations in which nothing has an error.
    """
    values = np.atleast_1d(np.array(start, float))
    measured = Measured(constrain, _checked_covariance(covariance))
    known = _checked_prior(prior, len(values))
    with np.errstate(all="ignore"):  # where the model has no value at a trial, the trial is rejected
        return _fit(measured, _linearised(measured, values), known, robust)


def _fit(measured: Measured, at: Eliminated, prior: Prior, robust: bool) -> ErrorsInVariablesFit:
    """Return the fit to the poses that agree, chosen anew after each fit until they are the same.

    They are chosen before the first fit too: it would carry gross errors far off, where nothing is linear any more.
    """
    kept, iterations = _agreeing(at, prior) if robust else np.ones(len(at.residual), bool), 0
    for selection in range(_SELECTIONS):
        found = descend(Objective(measured, prior, kept.astype(float)), at)
        at, iterations = _settled(measured, found.at, kept), iterations + found.iterations
        agree = _agreeing(at, prior) if robust else kept
        # late in the search no pose comes back, so that it ends
        agree = agree & kept if 2 * selection > _SELECTIONS else agree
        if np.array_equal(agree, kept):
            break
        used, kept = kept, agree
    else:
        found, kept = replace(found, status=SolverStatus.ITERATION_LIMIT), used
    return _result(measured, replace(found, at=at, iterations=iterations), prior, kept)


def _settled(measured: Measured, at: Eliminated, kept: NDArray) -> Eliminated:
    """Return the model with the deviations settled of poses that were not kept, as far as they do."""
    if kept.all():
        return at
    try:
        return project(measured, at.values, at.settled_pull, np.ones(len(kept)), _NEARLY_SETTLED)
    except np.linalg.LinAlgError:
        return at


def _agreeing(at: Eliminated, prior: Prior) -> NDArray:
    """Return which poses (B,) agree where all are linearised; all of them where the model has no value."""
    if not (np.isfinite(at.residual).all() and np.isfinite(at.jacobian).all()):
        return np.ones(len(at.residual), bool)
    rows = at.jacobian.reshape(-1, len(at.values))
    scale = column_scale(np.diag(np.sum(rows**2, 0)) + prior.information)
    known = prior.information / np.outer(scale, scale)
    return agreeing(LinearPoses(at.residual, at.jacobian / scale, known, prior.pull(at.values) / scale))


def _result(measured: Measured, found: Descent, prior: Prior, kept: NDArray) -> ErrorsInVariablesFit:
    at = found.at
    rows = at.jacobian[kept].reshape(-1, len(at.values))
    information = rows.T @ rows
    covariance = _covariance(information + prior.information)
    deficient = found.status == SolverStatus.CONVERGED and bool(np.isnan(covariance).any())
    return ErrorsInVariablesFit(
        values=at.values,
        deviations=times(measured.covariance, at.settled_pull),
        weight=kept.astype(float),
        chi_square=at.chi_square,
        residual=at.residual,
        jacobian=at.jacobian,
        information=information,
        covariance=covariance,
        prior=prior,
        cost=found.cost,
        iterations=found.iterations,
        status=SolverStatus.RANK_DEFICIENT if deficient else found.status,
    )


def _covariance(information: NDArray) -> NDArray:
    """Return the inverse (P, P) of an information, NaN for the values that it does not determine."""
    inverse, determined = _inverse_where_determined(information)
    return np.where(determined & determined[:, None], inverse, np.nan)


def _inverse_where_determined(information: NDArray) -> tuple[NDArray, NDArray]:
    """Return the inverse (P, P) of an information over what it determines, and which values (P,) it determines."""
    if not np.isfinite(information).all():
        return np.full_like(information, np.nan), np.zeros(len(information), bool)
    scale = column_scale(information)
    scaled = information / np.outer(scale, scale)
    if (inverse := _plain_inverse(scaled)) is not None:
        return inverse / np.outer(scale, scale), np.ones(len(scale), bool)
    strength, axes = np.linalg.eigh(scaled)
    seen = strength > _UNDETERMINED
    root = axes[:, seen] / scale[:, None]
    return (root / strength[seen]) @ root.T, np.abs(axes[:, ~seen]).max(-1, initial=0.0) < _TAKES_PART


def _plain_inverse(matrix: NDArray) -> NDArray | None:
    """Return the inverse of a matrix of unit diagonal, or None where it may be deficient.

    Its trace bounds the least eigenvalue. Eigenvalues would take three times as long, and far longer on two threads.
    """
    try:
        inverse = np.linalg.inv(matrix)
    except np.linalg.LinAlgError:
        return None
    return symmetric(inverse) if 0.0 < np.trace(inverse) < _PLAIN / _UNDETERMINED else None


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
        found = f"mean {prior.mean.shape} and information {prior.information.shape}"
        raise ValueError(f"prior: found {found}, expected ({size},) and ({size}, {size})")
    return prior


def _linearised(measured: Measured, start: NDArray) -> Eliminated:
    """Return the model at the start.

    Raises ValueError where the equations of a pose do not all hold something that was measured with an error.
    """
    poses, size = measured.covariance.shape[:2]
    try:
        return linearise(measured, start, np.zeros((poses, size)))
    except np.linalg.LinAlgError as error:
        raise ValueError(
            "covariance: found a pose whose equations contain combinations without any error, expected noise on each"
        ) from error
