"""Information of the data on the parameters: observability, absorption, and uncertainty budget by source."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from truing.calibration.calibration_input import CalibrationData, MeasuredPlatform
from truing.calibration.estimation_problem import (
    Case,
    EstimationProblem,
    cases,
    is_deformation,
    kind,
    observation_covariance,
    problem_of,
    problem_with_all_parameters,
    survey_rows,
    widest,
    with_targets,
)
from truing.calibration.fits import MAXIMUM_LIKELIHOOD, MachineCalibration, fit_problem
from truing.calibration.model_cases import screened_poses
from truing.estimation.design.absorption import Absorption, absorb
from truing.estimation.design.observability import Observability, observe
from truing.estimation.errors_in_variables.fit import ErrorsInVariablesFit
from truing.estimation.uncertainty_budget import Source, beyond_declared, linear_estimate
from truing.simulation.mechanisms.calibration_problem import CalibrationProblem
from truing.simulation.mechanisms.parameters import (
    LegParameter,
    ParameterSet,
    deformation_set,
    full_set,
    is_in_plane,
)
from truing.simulation.mechanisms.structures.catalogue import structures
from truing.simulation.mechanisms.structures.kinematic_model import KinematicModel

# Plausible shift of an attachment per displacement, where no target measures it.
_PLAUSIBLE_KAPPA = 0.01
Array = NDArray[np.float64]
TARGETS = Source("targets and their survey, through the poses", "B")
READINGS = Source("readings of the actuators", "B")
SURVEYED = Source("survey of the attachments", "B")
WIDE = Source("parameters about which nothing is declared", "B")
COMMON = Source("cameras, scale bars and frames of the survey, common to all poses", "B")
_TOLERANCES = {
    "a": "lower joints",
    "b": "upper joints",
    "u": "directions of the actuators",
    "l": "lengths of the legs",
    "rho0": "reference readings",
    "flexure_length": "lengths of the flexures",
    "beta": "beta of the flexures",
}


@dataclass(frozen=True)
class LinearisedMeasurements:
    """Derivatives (N, Q) of all measurements, in standard deviations, by the unknowns and by the entries of K."""

    jacobian: NDArray
    by_K: NDArray


def linear(
    dataset: CalibrationData, estimation: EstimationProblem, values: NDArray, measured: MeasuredPlatform
) -> LinearisedMeasurements:
    """Return the derivatives of all measurements by the unknowns of a problem at given values, and by the entries of K
    (L L).

    The rows of the closures come first, then those of the survey of the attachments.
    """
    problem = estimation.problem
    size = len(problem.parameters)
    entries = deformation_set(problem.nominal, "matrix")
    bent = replace(problem, parameters=entries, nominal=problem.machine(values))
    still = np.zeros((len(measured.rho), problem.deviations))
    at = problem.constrain(values, still)
    by_K = bent.constrain(np.concatenate([bent.start[: len(entries)], values[size:]]), still).by_values
    factor = np.linalg.cholesky(at.by_deviation @ estimation.noise @ np.swapaxes(at.by_deviation, -1, -2))
    rows = np.linalg.solve(factor, np.concatenate([at.by_values, by_K[..., : len(entries)]], -1))
    rows = rows.reshape(-1, rows.shape[-1])
    if dataset.surveyed is not None:
        known = survey_rows(dataset.surveyed, problem.parameters)
        known = np.linalg.solve(np.linalg.cholesky(dataset.surveyed.covariance), known)
        rows = np.concatenate([rows, np.pad(known, ((0, 0), (0, rows.shape[1] - size)))])
    return LinearisedMeasurements(rows[:, : -len(entries)], rows[:, -len(entries) :])


def observe_model(dataset: CalibrationData, fitted: MeasuredPlatform, chosen: MachineCalibration) -> Observability:
    """Return the observability of the chosen model's parameters by all measurements, targets on legs and attachments
    included."""
    estimation = _full_problem(dataset, fitted, chosen.case)
    values = np.concatenate([chosen.values, estimation.problem.start[estimation.count :]])
    seen = linear(dataset, estimation, values, fitted).jacobian
    bent = np.array([is_deformation(entry) for entry in chosen.parameters.entries])
    scales, units = _scales(dataset.tolerance, chosen.parameters), chosen.parameters.units
    seen = _with_shifts_known(_with_common_known(seen, estimation), estimation)
    jacobian = _orthogonal_to_others(seen, estimation.count) * units
    return observe(jacobian, np.where(bent, _PLAUSIBLE_KAPPA, scales) / units, chosen.parameters.labels)


def _full_problem(dataset: CalibrationData, measured: MeasuredPlatform, case: Case) -> EstimationProblem:
    estimation = problem_with_all_parameters(dataset, measured, case)
    return with_targets(estimation, dataset, measured, case) or estimation


def _with_common_known(jacobian: NDArray, estimation: EstimationProblem) -> NDArray:
    """Return the derivatives with additional prior rows of errors common to all poses."""
    known = np.zeros((estimation.common, jacobian.shape[1]))
    known[:, jacobian.shape[1] - estimation.common :] = np.eye(estimation.common)
    return np.concatenate([jacobian, known])


def _with_shifts_known(jacobian: NDArray, estimation: EstimationProblem) -> NDArray:
    """Return the derivatives with a row for each coefficient that shifts in the platform's plane determined before."""
    entries = estimation.problem.parameters.entries
    indices = [i for i, entry in enumerate(entries) if is_in_plane(entry)]
    known = np.zeros((len(indices), jacobian.shape[1]))
    known[np.arange(len(indices)), indices] = 1.0 / estimation.tolerance[indices]
    return np.concatenate([jacobian, known])


def _orthogonal_to_others(jacobian: NDArray, count: int) -> NDArray:
    """Return the first ``count`` columns without their projection on the other columns, which are unknown."""
    if count == jacobian.shape[1]:
        return jacobian
    basis_of_others = np.linalg.qr(jacobian[:, count:])[0]
    return jacobian[:, :count] - basis_of_others @ (basis_of_others.T @ jacobian[:, :count])


def observe_legs(dataset: CalibrationData, fitted: MeasuredPlatform) -> list[Observability]:
    """Return the observability of each leg's parameters: joints, direction, length, reference reading and kappa."""
    machine = dataset.machine
    parameters = full_set(machine, "linear", rho0=True)
    problem = CalibrationProblem(
        KinematicModel(machine.legs.closure.name), machine, parameters, fitted.platform.p, fitted.platform.R, fitted.rho
    )
    at = problem.constrain(problem.start, np.zeros((len(fitted.rho), problem.deviations)))
    noise = observation_covariance(fitted, dataset.reading_sigma)
    sigma = np.sqrt(np.einsum("bmi,bij,bmj->bm", at.by_deviation, noise, at.by_deviation))
    scale = _scales(dataset.tolerance, parameters)
    legs = np.array([entry.leg for entry in parameters.entries])
    labels, units = np.array(parameters.labels), parameters.units
    reported = at.by_values / sigma[..., None] * units
    return [
        observe(reported[:, leg, legs == leg], (scale / units)[legs == leg], labels[legs == leg].tolist())
        for leg in range(machine.legs.count)
    ]


def _scales(tolerance: Mapping[str, float], parameters: ParameterSet) -> NDArray:
    """Return plausible errors (P,) of the parameters: their tolerances; for the reference reading that of
    the joints."""
    heads = [kind(entry) for entry in parameters.entries]
    known = {"rho0": tolerance.get("a", 0.0), "kappa": _PLAUSIBLE_KAPPA, **tolerance}
    declared = np.array([known.get(head, 0.0) for head in heads])
    return np.where(declared > 0, declared, widest(parameters))


def _absorption(dataset: CalibrationData, fitted: MeasuredPlatform, calibration: MachineCalibration) -> Absorption:
    """Return the absorption of each entry of K by the calibration's parameters, predicted before any fit. The
    maximum-likelihood fit weights measurements by their noise and has tolerances as prior; the implicit one does
    neither."""
    if calibration.estimator != MAXIMUM_LIKELIHOOD:
        problem = problem_of(calibration.case, calibration.parameters, fitted)
        bent = replace(problem, parameters=deformation_set(problem.nominal, "matrix"))
        still = np.zeros((len(fitted.rho), problem.deviations))
        both = [one.constrain(one.start, still).by_values for one in (problem, bent)]
        rows = [by_values.reshape(-1, by_values.shape[-1]) for by_values in both]
        return absorb(rows[0], -rows[1], calibration.parameters.labels)
    estimation = _full_problem(dataset, fitted, calibration.case)
    scales = np.where(np.isfinite(estimation.tolerance), estimation.tolerance, widest(calibration.parameters))
    prior_sigma = np.diag(estimation.prior.information)[estimation.count :] ** -0.5
    seen = linear(dataset, estimation, estimation.problem.start, fitted)
    labels = [entry.label for entry in estimation.problem.entries]
    return absorb(seen.jacobian, -seen.by_K, labels, np.concatenate([scales, prior_sigma]))


def _knowledge_difference(calibration: MachineCalibration, complete: MachineCalibration) -> NDArray:
    """Return the variance (P,) of the difference between two fits of the parameters that is due to their different
    data."""
    declared = dict(zip(complete.parameters.labels, np.diag(complete.declared), strict=True))
    knowledge = np.diag(calibration.declared)
    more = [
        declared.get(label, variance) for label, variance in zip(calibration.parameters.labels, knowledge, strict=True)
    ]
    return np.abs(knowledge - more) if calibration.estimator == MAXIMUM_LIKELIHOOD else np.zeros(len(knowledge))


def _counterparts(calibration: MachineCalibration, complete: MachineCalibration) -> NDArray:
    """Return the values (P,) of the calibration's parameters in the one with the whole deformation. kappa has its
    nominal value, relative to which the omitted effect is given too."""
    parameters, nominal = calibration.parameters, calibration.nominal
    value = dict(zip(complete.parameters.labels, complete.values, strict=True))
    return np.array(
        [
            nominal[i] if entry.name == "kappa" else value.get(entry.label, nominal[i])
            for i, entry in enumerate(parameters.entries)
        ]
    )


@dataclass(frozen=True)
class Absorbed:
    """Absorption of an omitted effect by the parameters (P,) of a calibration, SI.

    ``predicted`` before any fit, ``observed`` as difference to the fit with the whole effect, ``sigma`` of their
    difference.
    """

    predicted: NDArray
    observed: NDArray
    sigma: NDArray


def absorbed(
    dataset: CalibrationData, fitted: MeasuredPlatform, calibration: MachineCalibration, complete: MachineCalibration
) -> Absorbed:
    """Return the absorption of K by a calibration with less deformation; ``complete`` has all of K."""
    known, count = dataset.deformations["matrix"], len(calibration.parameters.entries)
    absorption = _absorption(dataset, fitted, calibration)
    size = (known.K - calibration.case.nominal.deformation).ravel()
    spread = np.diag(absorption.comparison_covariance(np.diag(known.sigma.ravel() ** 2), "fit"))[:count]
    return Absorbed(
        (absorption.shift @ size)[:count],
        calibration.values - _counterparts(calibration, complete),
        np.sqrt(np.maximum(spread, 0.0) + _knowledge_difference(calibration, complete)),
    )


@dataclass(frozen=True)
class RefittedCalibration:
    """The chosen calibration, refitted from its result."""

    data: CalibrationData
    estimation: EstimationProblem
    fit: ErrorsInVariablesFit


def refitted_calibration(
    dataset: CalibrationData, key: tuple[str, str], start_values: Mapping[tuple[str, int | None], float]
) -> RefittedCalibration | None:
    """Return the maximum-likelihood calibration of a model (structure, deformation), refitted from its result.

    start_values: values by parameter and leg, in the units of the tables. None where there is no such model, or no
    minimum.
    """
    every = list(cases(dataset, structures(dataset.machine)))
    case = next((case for case in every if case.key == key), None)
    if case is None:
        return None
    clean = screened_poses(dataset, dataset.measured.roles != "verification", every)
    estimation = _full_problem(dataset, clean.measured.subset(clean.kept), case)
    parameters = estimation.problem.parameters
    start = (
        np.array([start_values[entry.name, entry.leg_number] for entry in parameters.entries], float) * parameters.units
    )
    fit = fit_problem(estimation, start, robust=False)
    return RefittedCalibration(dataset, estimation, fit) if fit.ok else None


def parameter_budget(refitted: RefittedCalibration) -> dict[Source, Array]:
    """Return the covariance (P, P), SI, of all fitted values by source.

    If more noise was found than declared, the noise of poses, readings and survey is enlarged accordingly.
    """
    estimation, fit = refitted.estimation, refitted.fit
    at = estimation.problem.constrain(fit.values, fit.deviations)
    ratio = max(fit.noise_ratio, 1.0) if np.isfinite(fit.noise_ratio) else 1.0
    legs = slice(6, 6 + estimation.problem.rho.shape[-1])
    readings = np.zeros_like(estimation.noise)
    readings[:, legs, legs] = estimation.noise[:, legs, legs]
    noise = {TARGETS: (estimation.noise - readings) * ratio**2, READINGS: readings * ratio**2}
    prior, surveyed = _prior(refitted, ratio)
    parts = linear_estimate(at.by_values, noise, prior, at.by_deviation)
    if ratio == 1.0:
        return parts
    beyond = Source("scatter of the closing beyond the declared noise", "A", float(fit.leave_one_out.freedom))
    total = np.zeros_like(parts[TARGETS])
    for source in (TARGETS, READINGS, *surveyed):
        split = beyond_declared({source: parts[source]}, source, ratio, beyond)
        parts[source], total = split[source], total + split[beyond]
    return parts | {beyond: total}


def _prior(refitted: RefittedCalibration, ratio: float) -> tuple[dict[Source, Array], tuple[Source, ...]]:
    """Return the prior information (P, P) by source, and those of the sources that are measurements."""
    dataset, estimation = refitted.data, refitted.estimation
    left, by_source = estimation.prior.information.copy(), {}
    if dataset.surveyed is not None:
        rows = survey_rows(dataset.surveyed, estimation.problem.parameters)
        information = np.zeros_like(left)
        information[: estimation.count, : estimation.count] = rows.T @ np.linalg.solve(
            dataset.surveyed.covariance, rows
        )
        left, by_source[SURVEYED] = left - information, information / ratio**2
    for source, indices in _kinds(estimation).items():
        by_source[source] = np.diag(np.where(np.isin(np.arange(len(left)), indices), np.diag(left), 0.0))
    return by_source, tuple(source for source in by_source if source is SURVEYED)


def _kinds(estimation: EstimationProblem) -> dict[Source, list[int]]:
    """Return the indices of the values by kind of prior: tolerances by kind, deformation as measured, wide priors."""
    indices: dict[Source, list[int]] = {}
    for i in range(len(estimation.problem.start)):
        source = WIDE if i < len(estimation.problem.start) - estimation.common else COMMON
        if i < estimation.count and np.isfinite(estimation.tolerance[i]):
            entry = estimation.problem.parameters.entries[i]
            source = _tolerance(entry)
        indices.setdefault(source, []).append(i)
    return indices


def _tolerance(entry: LegParameter) -> Source:
    if is_deformation(entry):
        return Source("deformation, as the targets on the attachments showed it", "B")
    return Source(f"tolerance of the {_TOLERANCES.get(kind(entry), entry.name)}", "B")
