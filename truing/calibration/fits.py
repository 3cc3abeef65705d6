"""Calibration of one model: by errors in variables, or by least squares on the closures (telescope report)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from truing.calibration.calibration_input import CalibrationData, MeasuredPlatform
from truing.calibration.estimation_problem import (
    Case,
    EstimationProblem,
    common_effects,
    free,
    independent_covariance,
    observation_covariance,
    problem_of,
    problem_with_all_parameters,
    survey_rows,
    tolerances,
    widest,
    with_targets,
)
from truing.estimation.design.observability import choose_identifiable
from truing.estimation.errors_in_variables.fit import ErrorsInVariablesFit, Prior, fit_errors_in_variables
from truing.estimation.least_squares.solver import SolverStatus, least_squares
from truing.simulation.mechanisms.calibration_problem import CalibrationProblem, PoseEquations
from truing.simulation.mechanisms.parameters import ParameterSet, full_set, report_set
from truing.simulation.mechanisms.structures.structure import Machine

MAXIMUM_LIKELIHOOD, IMPLICIT = "errors-in-variables", "implicit"
# Iterations after which a calibration counts as not converged.
_ITERATIONS = 200
_NO_REDUNDANCY = "no redundancy: As many parameters as equations: measure more poses."
# A parameter is identifiable if the data hold at least as much information on it as its tolerance.
_IDENTIFIABLE = np.sqrt(0.5)


@dataclass(frozen=True)
class MachineCalibration:
    """One calibration: identified parameters with covariance (P, P), SI, and its status.

    declared (P, P): covariance at the declared noise, while ``covariance`` is enlarged if more noise was found; common
    (K,): estimated errors common to all poses; joint (P + K, P + K): covariance of the errors of both, at the declared
    noise; tolerance (P,): prior sigma, NaN where there is none; identifiable (P,): parameters that the data determine
    better; kept (B,): poses that took part; chi_square, with its freedom: of the closures.
    """

    case: Case
    estimator: str
    problem: CalibrationProblem
    nominal: NDArray
    values: NDArray
    covariance: NDArray
    declared: NDArray
    common: NDArray
    joint: NDArray
    tolerance: NDArray
    identifiable: NDArray
    kept: NDArray
    chi_square: float
    freedom: float
    log_evidence: float
    status: str

    @property
    def parameters(self) -> ParameterSet:
        """Identified parameters."""
        return self.problem.parameters

    @property
    def machine(self) -> Machine:
        """Identified machine."""
        return self.parameters.machine(self.case.nominal, self.values)

    def problem_at(self, measured: MeasuredPlatform) -> CalibrationProblem:
        """Return the same problem at other poses."""
        return problem_of(self.case, self.parameters, measured)

    @property
    def sigma(self) -> NDArray:
        """Standard deviations (P,)."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def pull(self) -> NDArray:
        """Pulls (P,): unit normal if tolerances are right; NaN where a parameter is not identifiable.

        With the tolerance as prior a shift has the variance tolerance^2 - sigma^2, without it their sum.
        """
        sign = -1.0 if self.estimator == MAXIMUM_LIKELIHOOD else 1.0
        variance = np.where(self.identifiable, self.tolerance**2 + sign * self.sigma**2, np.nan)
        return (self.values - self.nominal) / np.sqrt(variance)


def maximum_likelihood(
    data: CalibrationData, fitted: MeasuredPlatform, case: Case, chosen: NDArray
) -> MachineCalibration:
    """Return the calibration by errors in variables over the poses kept (B,), with tolerances and surveys as prior."""
    used = fitted.subset(chosen)
    estimation = problem_with_all_parameters(data, used, case)
    fit = fit_problem(estimation, robust=False)
    # All models are compared on the same data: poses, readings, and the deformation from the targets.
    evidence, count = _log_evidence(fit, estimation.prior), estimation.count
    if (more := with_targets(estimation, data, used, case)) is not None:
        fit = fit_problem(more, fit.values[:count], robust=False)
    covariance = _enlarged_covariance(data, fit, estimation)
    tolerance = (more or estimation).tolerance
    known = np.where(np.isfinite(tolerance), tolerance, widest(estimation.problem.parameters))
    last = len(fit.values) - estimation.common
    indices = np.r_[:count, last : len(fit.values)]
    return MachineCalibration(
        case,
        MAXIMUM_LIKELIHOOD,
        replace(estimation.problem, common=None),
        estimation.problem.start[:count],
        fit.values[:count],
        covariance,
        fit.covariance[:count, :count],
        fit.values[last:],
        fit.covariance[np.ix_(indices, indices)],
        tolerance,
        np.sqrt(np.diag(covariance)) < _IDENTIFIABLE * known,
        chosen,
        fit.leave_one_out.chi_square,
        float(fit.leave_one_out.freedom),
        evidence,
        _end_of_fit(fit.status),
    )


def _enlarged_covariance(data: CalibrationData, fit: ErrorsInVariablesFit, estimation: EstimationProblem) -> NDArray:
    """Return the covariance (P, P) of the machine's parameters, enlarged where more noise was found than declared. The
    survey of the attachments is part of the prior, but was taken by the same instrument, so it is enlarged as well."""
    excess = max(fit.noise_ratio, 1.0)
    if data.surveyed is None or not np.isfinite(excess):
        return fit.covariance_at(excess if np.isfinite(excess) else 1.0)[: estimation.count, : estimation.count]
    rows = survey_rows(data.surveyed, estimation.problem.parameters)
    surveyed = np.zeros_like(fit.information)
    surveyed[: estimation.count, : estimation.count] = rows.T @ np.linalg.solve(data.surveyed.covariance, rows)
    information = (fit.information + surveyed) / excess**2 + fit.prior.information - surveyed
    return np.linalg.inv(information)[: estimation.count, : estimation.count]


def fit_problem(estimation: EstimationProblem, start: NDArray | None = None, *, robust: bool) -> ErrorsInVariablesFit:
    """Return the fit of a problem, started from the machine's parameters (P,) in ``start`` or from the
    nominal ones."""
    values = estimation.problem.start
    if start is not None:
        values = np.concatenate([start, values[len(start) :]])
    return fit_errors_in_variables(
        estimation.problem.constrain,
        estimation.noise,
        values,
        estimation.prior,
        robust=robust,
    )


def _log_evidence(fit: ErrorsInVariablesFit, prior: Prior) -> float:
    """Return the log marginal likelihood, up to a constant that all models of a campaign share."""
    occam = np.linalg.slogdet(fit.information + prior.information)[1] - np.linalg.slogdet(prior.information)[1]
    return -0.5 * float(fit.cost + occam)


def implicit(data: CalibrationData, fitted: MeasuredPlatform, case: Case, chosen: NDArray) -> MachineCalibration:
    """Return the calibration by unweighted least squares on the closures over the poses kept (B,), as in the report."""
    problem = problem_of(case, _implicit_set(data, fitted.subset(chosen), case), fitted.subset(chosen))
    nominal = problem.parameters.values(case.nominal)
    still = np.zeros((int(chosen.sum()), problem.deviations))

    def residuals(values: NDArray) -> tuple[NDArray, NDArray]:
        equations = [problem.constrain(value, still) for value in values]
        return (
            np.stack([equation.value.ravel() for equation in equations]),
            np.stack([equation.by_values.reshape(-1, len(nominal)) for equation in equations]),
        )

    solution = least_squares(residuals, nominal, method="levenberg-marquardt", max_iterations=_ITERATIONS)
    values = solution.x[0]
    at = problem.constrain(values, still)
    freedom = at.value.size - len(nominal)
    ended = _end_of_fit(SolverStatus(solution.status[0])) if freedom > 0 else _NO_REDUNDANCY
    # A fit without convergence, or without degrees of freedom, has no uncertainty.
    variance = np.sum(at.value**2) / freedom if ended == "ok" else np.nan
    covariance = solution.covariance[0] * variance
    used = fitted.subset(chosen)
    declared = _propagated(solution.covariance[0], at, independent_covariance(used, data.reading_sigma))
    moved = _common_error_derivatives(solution.covariance[0], at, common_effects(used))
    declared = declared + moved @ moved.T
    tolerance = tolerances(data, case, problem.parameters)
    return MachineCalibration(
        case,
        IMPLICIT,
        problem,
        nominal,
        values,
        covariance,
        declared if ended == "ok" else covariance,
        np.zeros(moved.shape[1]),
        np.block([[declared, moved], [moved.T, np.eye(moved.shape[1])]]),
        tolerance,
        np.isfinite(np.diag(covariance)),
        chosen,
        float("nan"),
        float(max(freedom, 0)),
        float("nan"),
        ended,
    )


def _propagated(inverse: NDArray, at: PoseEquations, noise: NDArray) -> NDArray:
    """Return the covariance (P, P) of an unweighted fit by noise (B, N, N); ``inverse`` is that of its
    normal matrix."""
    spread = at.by_deviation @ noise @ np.swapaxes(at.by_deviation, -1, -2)
    reported = np.einsum("bmp,bmn,bnq->pq", at.by_values, spread, at.by_values, optimize=True)
    return inverse @ reported @ inverse


def _common_error_derivatives(inverse: NDArray, at: PoseEquations, effects: NDArray) -> NDArray:
    """Return the derivatives (P, K) of an unweighted fit by common errors, whose effects on the platform
    are (B, 6, K)."""
    spread = at.by_deviation[..., :6] @ effects
    return np.asarray(inverse @ np.einsum("bmp,bmk->pk", at.by_values, spread))


def _implicit_set(data: CalibrationData, fitted: MeasuredPlatform, case: Case) -> ParameterSet:
    """Return the parameters of the implicit fit: those of the report for legs like its own, otherwise identifiable
    ones. The latter are a largest set of joints, lengths and kappa that the data determine better than tolerances do,
    the same for every leg."""
    if "u" in case.nominal.legs.closure.geometry:
        return report_set(case.nominal, case.deformation)
    deformation = "none" if case.deformation == "none" else "linear"
    candidates = free(full_set(case.nominal, deformation), data)
    problem = problem_of(case, candidates, fitted)
    at = problem.constrain(problem.start, np.zeros((len(fitted.rho), problem.deviations)))
    noise = observation_covariance(fitted, data.reading_sigma)
    sigma = np.sqrt(np.einsum("bmi,bij,bmj->bm", at.by_deviation, noise, at.by_deviation))
    rows = (at.by_values / sigma[..., None]).reshape(-1, len(candidates))
    tolerance = tolerances(data, case, candidates)
    scales = np.where(np.isfinite(tolerance), tolerance, widest(candidates))
    names = [entry.name for entry in candidates.entries]
    chosen = choose_identifiable(rows, scales, candidates.labels, groups=names).chosen
    return ParameterSet(tuple(entry for entry, reported in zip(candidates.entries, chosen, strict=True) if reported))


def _end_of_fit(status: SolverStatus) -> str:
    return "ok" if status == SolverStatus.CONVERGED else f"{status}: {status.remedy}"
