"""The calibrations of a campaign: every model of the structure under every model of deformation, by two estimators."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from stages.calibration_data import Deformation, Gathered, Measured, SurveyedAttachments
from truing.estimation.errors_in_variables import ErrorsInVariablesFit, Prior, fit_errors_in_variables
from truing.estimation.identifiable_set import choose_identifiable
from truing.estimation.least_squares import SolverStatus, least_squares
from truing.simulation.calibration_problem import CalibrationProblem
from truing.simulation.parameters import ParameterSet, full_set, report_set
from truing.simulation.point_model import FREE_DIRECTION, FREE_LENGTH_M
from truing.simulation.structure import Machine, Structure

DEFORMATIONS = ("none", "linear", "matrix")
MAXIMUM_LIKELIHOOD, IMPLICIT = "errors-in-variables", "implicit"
# What nothing is known of: a deformation coefficient may still be this large.
_FREE_DEFORMATION = 0.1
# A calibration that has not settled by then will not.
_ITERATIONS = 200
# A parameter counts as identified where the data say at least as much of it as its tolerance does.
_TOLD = np.sqrt(0.5)


@dataclass(frozen=True)
class Case:
    """A model of the structure under a model of deformation, and the machine that its nominal values stand for."""

    structure: Structure
    deformation: str
    nominal: Machine


@dataclass(frozen=True)
class Calibration:
    """One calibration: parameters identified with covariance (P, P), in SI, and how it ended.

    tolerance (P,): one sigma of what was known before, NaN where nothing was; identifiable (P,): what the data tell
    better; kept (B,): poses that took part, of those that it was asked to fit; chi_square with its freedom: of their
    closing against the noise.
    """

    case: Case
    estimator: str
    problem: CalibrationProblem
    nominal: NDArray
    values: NDArray
    covariance: NDArray
    tolerance: NDArray
    identifiable: NDArray
    kept: NDArray
    chi_square: float
    freedom: float
    log_evidence: float
    status: str

    @property
    def parameters(self) -> ParameterSet:
        """Return what was identified."""
        return self.problem.parameters

    @property
    def machine(self) -> Machine:
        """Return the machine as identified."""
        return self.parameters.machine(self.case.nominal, self.values)

    def problem_at(self, measured: Measured) -> CalibrationProblem:
        """Return the same problem at other poses."""
        return _problem(self.case, self.parameters, measured)

    @property
    def sigma(self) -> NDArray:
        """Return the standard deviations (P,)."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def pull(self) -> NDArray:
        """Return the pulls (P,): unit normal where tolerances are honest; NaN where the data do not tell.

        With the tolerance as prior a shift has the variance tolerance^2 - sigma^2, without it their sum.
        """
        sign = -1.0 if self.estimator == MAXIMUM_LIKELIHOOD else 1.0
        variance = np.where(self.identifiable, self.tolerance**2 + sign * self.sigma**2, np.nan)
        return (self.values - self.nominal) / np.sqrt(variance)


def cases(gathered: Gathered, structures: tuple[Structure, ...]) -> Iterator[Case]:
    """Return every model that the machine's numbers and the deformation stage allow."""
    for structure in structures:
        for deformation in DEFORMATIONS:
            if deformation != "matrix" or "matrix" in gathered.deformations:
                yield Case(structure, deformation, _deforming(gathered.machine, deformation, gathered.deformations))


def _deforming(machine: Machine, deformation: str, known: Mapping[str, Deformation]) -> Machine:
    """Return the machine with the deformation as the targets on the attachments show it; none where they do not."""
    if deformation == "none" or deformation not in known:
        return machine
    return replace(machine, deformation=np.nan_to_num(known[deformation].K))


def observation_covariance(measured: Measured, problem: CalibrationProblem, reading_sigma: float) -> NDArray:
    """Return the covariance (B, n, n) of all that was measured per pose, in the order of the problem's deviations."""
    legs = measured.rho.shape[1]
    covariance = np.zeros((len(measured.rho), problem.deviations, problem.deviations))
    covariance[:, :6, :6] = measured.platform.covariance
    covariance[:, 6 : 6 + legs, 6 : 6 + legs] = np.eye(legs) * reading_sigma**2
    return covariance


def maximum_likelihood(gathered: Gathered, fitted: Measured, case: Case) -> Calibration:
    """Return the calibration by errors in variables, with tolerances, survey and deformation as prior."""
    parameters = _free(full_set(case.nominal, case.deformation, rho0="rho0" in gathered.tolerance), gathered)
    problem = _problem(case, parameters, fitted)
    covariance = observation_covariance(fitted, problem, gathered.reading_sigma)
    nominal = problem.parameters.values(case.nominal)
    tolerance = tolerances(gathered, case, problem.parameters)
    prior = _prior(gathered.surveyed, problem.parameters, nominal, tolerance)
    fit = fit_errors_in_variables(problem.constrain, covariance, nominal, prior)
    found = fit.covariance_at(max(fit.noise_ratio, 1.0))
    wide = np.where(np.isfinite(tolerance), tolerance, widest(problem.parameters))
    return Calibration(
        case,
        MAXIMUM_LIKELIHOOD,
        problem,
        nominal,
        fit.values,
        found,
        tolerance,
        np.sqrt(np.diag(found)) < _TOLD * wide,
        fit.weight > 0,
        fit.judgement.chi_square,
        float(fit.judgement.freedom),
        _log_evidence(fit, prior),
        _ending(fit.status),
    )


def _problem(case: Case, parameters: ParameterSet, measured: Measured) -> CalibrationProblem:
    return CalibrationProblem(
        case.structure, case.nominal, parameters, measured.platform.p, measured.platform.R, measured.rho
    )


def _free(parameters: ParameterSet, gathered: Gathered) -> ParameterSet:
    """Return the parameters without those that a tolerance of zero declares exact."""
    exact = {name for name, sigma in gathered.tolerance.items() if sigma == 0}
    return ParameterSet(tuple(e for e in parameters.entries if e.name.partition("_")[0] not in exact))


def tolerances(gathered: Gathered, case: Case, parameters: ParameterSet) -> NDArray:
    """Return one sigma (P,) of what is known of each parameter beforehand; NaN where nothing is."""
    known = gathered.deformations.get(case.deformation)
    found = np.full(len(parameters), np.nan)
    for i, entry in enumerate(parameters.entries):
        head = entry.name.partition("_")[0]
        if head in gathered.tolerance:
            found[i] = gathered.tolerance[head]
        elif known is not None and (entry.name == "kappa" or head.startswith("K")):
            found[i] = known.sigma.ravel()[_place(entry.name, entry.leg, len(known.K))]
    return np.where(found > 0, found, np.nan)


def _place(name: str, leg: int, legs: int) -> int:
    """Return where a deformation's coefficient stands in K, row by row."""
    column = leg if name == "kappa" else int(name.replace("_", "")[1 + len(str(leg + 1)) :]) - 1
    return leg * legs + column


def widest(parameters: ParameterSet) -> NDArray:
    """Return a sigma (P,) that says nothing, and keeps the equations well scaled."""
    heads = [entry.name.partition("_")[0] for entry in parameters.entries]
    wide = {"u": FREE_DIRECTION, "a": FREE_LENGTH_M, "b": FREE_LENGTH_M, "l": FREE_LENGTH_M, "rho0": FREE_LENGTH_M}
    return np.array([wide.get(head, _FREE_DEFORMATION) for head in heads])


def _prior(
    surveyed: SurveyedAttachments | None, parameters: ParameterSet, nominal: NDArray, tolerance: NDArray
) -> Prior:
    """Return what tolerances and the survey of the attachments say of the parameters beforehand."""
    sigma = np.where(np.isfinite(tolerance), tolerance, widest(parameters))
    information = np.diag(sigma**-2.0)
    if surveyed is None:
        return Prior(nominal, information)
    weighted = information @ nominal
    rows = survey_rows(surveyed, parameters)
    inverse = np.linalg.inv(surveyed.covariance)
    information = information + rows.T @ inverse @ rows
    mean = np.linalg.solve(information, weighted + rows.T @ inverse @ surveyed.b.ravel())
    return Prior(mean, information)


def survey_rows(surveyed: SurveyedAttachments, parameters: ParameterSet) -> NDArray:
    """Return the derivative (3A, P) of the surveyed places of the attachments by the parameters."""
    rows = np.zeros((3 * len(surveyed.legs), len(parameters)))
    for i, entry in enumerate(parameters.entries):
        if entry.name.startswith("b_"):
            own = np.flatnonzero(surveyed.legs == entry.leg)
            rows[3 * own + "xyz".index(entry.name[2]), i] = 1.0
    return rows


def _log_evidence(fit: ErrorsInVariablesFit, prior: Prior) -> float:
    """Return the log of the marginal likelihood, up to what all models of a campaign share."""
    occam = np.linalg.slogdet(fit.information + prior.information)[1] - np.linalg.slogdet(prior.information)[1]
    return -0.5 * float(fit.cost + occam)


def implicit(gathered: Gathered, fitted: Measured, case: Case, kept: NDArray) -> Calibration:
    """Return the calibration by least squares on the closure alone, over the poses kept (B,): the report's own way."""
    problem = _problem(case, _implicit_set(gathered, fitted.chosen(kept), case), fitted.chosen(kept))
    nominal = problem.parameters.values(case.nominal)
    still = np.zeros((int(kept.sum()), problem.deviations))

    def residuals(values: NDArray) -> tuple[NDArray, NDArray]:
        found = [problem.constrain(one, still) for one in values]
        return (
            np.stack([one.value.ravel() for one in found]),
            np.stack([one.by_values.reshape(-1, len(nominal)) for one in found]),
        )

    solution = least_squares(residuals, nominal, method="levenberg-marquardt", max_iterations=_ITERATIONS)
    values = solution.x[0]
    at = problem.constrain(values, still)
    freedom = max(at.value.size - len(nominal), 1)
    scatter = float(np.sqrt(np.sum(at.value**2) / freedom))
    covariance = solution.covariance[0] * scatter**2
    tolerance = tolerances(gathered, case, problem.parameters)
    return Calibration(
        case,
        IMPLICIT,
        problem,
        nominal,
        values,
        covariance,
        tolerance,
        np.isfinite(np.diag(covariance)),
        kept,
        float("nan"),
        float(freedom),
        float("nan"),
        _ending(SolverStatus(solution.status[0])),
    )


def _implicit_set(gathered: Gathered, fitted: Measured, case: Case) -> ParameterSet:
    """Return what the report identifies of legs as it has them, on actuators of their own; of others what can be.

    That is a largest set of joints, lengths and kappa that the data tell better than their tolerances do, the same
    for every leg.
    """
    if "u" in case.nominal.legs.closure.geometry:
        return report_set(case.nominal, case.deformation)
    deformation = "none" if case.deformation == "none" else "linear"
    candidates = _free(full_set(case.nominal, deformation), gathered)
    problem = _problem(case, candidates, fitted)
    at = problem.constrain(problem.start, np.zeros((len(fitted.rho), problem.deviations)))
    noise = observation_covariance(fitted, problem, gathered.reading_sigma)
    sigma = np.sqrt(np.einsum("bmi,bij,bmj->bm", at.by_deviation, noise, at.by_deviation))
    rows = (at.by_values / sigma[..., None]).reshape(-1, len(candidates))
    tolerance = tolerances(gathered, case, candidates)
    scales = np.where(np.isfinite(tolerance), tolerance, widest(candidates))
    names = [entry.name for entry in candidates.entries]
    chosen = choose_identifiable(rows, scales, candidates.labels, groups=names).chosen
    return ParameterSet(tuple(entry for entry, told in zip(candidates.entries, chosen, strict=True) if told))


def _ending(status: SolverStatus) -> str:
    return "ok" if status == SolverStatus.CONVERGED else f"{status}: {status.remedy}"
