"""What the campaign's data can know of the parameters, and what swallows an effect that a model leaves out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stages.calibration_data import Gathered, Measured
from stages.calibration_fits import MAXIMUM_LIKELIHOOD, Calibration, observation_covariance, survey_rows, widest
from stages.response_tables import Rows
from truing.estimation.absorption import absorb
from truing.estimation.combinations import inseparable
from truing.estimation.identifiable_set import choose_identifiable
from truing.estimation.observability import Observability, indices, observe
from truing.simulation.calibration_problem import CalibrationProblem
from truing.simulation.kinematic_model import KinematicModel
from truing.simulation.parameters import ParameterSet, deformation_set, full_set
from truing.simulation.structure import Machine

# A shift of the attachments per displacement that is plausible of a platform, where no target tells.
_PLAUSIBLE_KAPPA = 0.01


@dataclass(frozen=True)
class Whitened:
    """The closing's derivatives by P parameters (B, M, P), in standard deviations of the noise of each equation."""

    jacobian: NDArray
    factor: NDArray  # (B, M, M), lower, of the closing's covariance


def whiten(problem: CalibrationProblem, values: NDArray, measured: Measured, reading_sigma: float) -> Whitened:
    """Return the derivatives at some values, whitened by the noise of all that was measured."""
    at = problem.constrain(values, np.zeros((len(measured.rho), problem.deviations)))
    noise = observation_covariance(measured, problem, reading_sigma)
    factor = np.linalg.cholesky(at.by_deviation @ noise @ np.swapaxes(at.by_deviation, -1, -2))
    return Whitened(np.linalg.solve(factor, at.by_values), factor)


def observability_rows(gathered: Gathered, fitted: Measured, chosen: Calibration) -> Rows:
    """Return what the data can know: leg by leg of the rigid legs with all their numbers, and of the chosen model."""
    rows = Rows("observability")
    for leg, found in enumerate(_leg_by_leg(gathered, fitted)):
        _add(rows, gathered.machine.legs.closure.name, "linear", leg + 1, found, len(fitted.poses))
    whole = whiten(chosen.problem_at(fitted), chosen.values, fitted, gathered.reading_sigma)
    scale = np.where(np.isfinite(chosen.tolerance), chosen.tolerance, widest(chosen.parameters))
    seen = whole.jacobian.reshape(-1, len(scale))
    found = observe(seen, scale, chosen.parameters.labels)
    _add(rows, chosen.case.structure.name, chosen.case.deformation, None, found, len(fitted.poses))
    return rows


def _leg_by_leg(gathered: Gathered, fitted: Measured) -> list[Observability]:
    """Return the observability of each leg's numbers: joints, direction, length, reference reading and kappa."""
    machine = gathered.machine
    parameters = full_set(machine, "linear", rho0=True)
    problem = CalibrationProblem(
        KinematicModel(machine.legs.closure.name), machine, parameters, fitted.platform.p, fitted.platform.R, fitted.rho
    )
    found = whiten(problem, problem.start, fitted, gathered.reading_sigma)
    at = problem.constrain(problem.start, np.zeros((len(fitted.rho), problem.deviations)))
    sigma = np.sqrt(np.einsum("bij,bij->bi", found.factor, found.factor))
    scale = _scales(gathered.tolerance, parameters)
    legs = np.array([entry.leg for entry in parameters.entries])
    labels = np.array(parameters.labels)
    return [
        observe(at.by_values[:, leg, legs == leg] / sigma[:, leg, None], scale[legs == leg], labels[legs == leg])
        for leg in range(machine.legs.count)
    ]


def _scales(tolerance: Mapping[str, float], parameters: ParameterSet) -> NDArray:
    """Return what a parameter may plausibly be off (P,): its tolerance; of the reference reading that of the joints."""
    heads = [entry.name.partition("_")[0] for entry in parameters.entries]
    known = {"rho0": tolerance.get("a", 0.0), "kappa": _PLAUSIBLE_KAPPA, **tolerance}
    given = np.array([known.get(head, 0.0) for head in heads])
    return np.where(given > 0, given, widest(parameters))


def _add(rows: Rows, model: str, deformation: str, leg: int | None, found: Observability, poses: int) -> None:
    best = choose_identifiable(found.triangle / found.scales, found.scales, found.labels).observability
    figures = {
        "parameters": float(len(found.labels)),
        "rank": float(found.rank),
        "condition": best.condition,
        **{name.upper(): value for name, value in vars(indices(best.singular_values, poses)).items() if name[0] == "o"},
    }
    common = {"model": model, "deformation": deformation, "leg": leg, "unit": "1"}
    for name, value in figures.items():
        rows.add(**common, figure=name, value=value if np.isfinite(value) else None)
    rows.add(**common, figure="identifiable_set", value=float(len(best.labels)), combination=" ".join(best.labels))
    for label, sigma in zip(found.labels, found.sigma / found.scales, strict=True):
        rows.add(**common, figure="sigma", value=float(sigma) if np.isfinite(sigma) else None, combination=label)
    for value in found.singular_values:
        rows.add(**common, figure="singular_value", value=float(value))
    for group in inseparable(found):
        sigma = float(np.min(group.sigma))
        rows.add(**common, figure="unidentifiable", value=sigma if np.isfinite(sigma) else None, combination=group.text)


def absorption_rows(gathered: Gathered, fitted: Measured, calibrations: Sequence[Calibration]) -> Rows:
    """Return what the parameters of models with less deformation take over of K, predicted and as the fits did it."""
    rows = Rows("absorption")
    known = gathered.deformations.get("matrix")
    if known is None:
        return rows
    full = {(c.case.structure.name, c.estimator): c for c in calibrations if c.case.deformation == "matrix"}
    for calibration in calibrations:
        whole = full.get((calibration.case.structure.name, calibration.estimator))
        if calibration.case.deformation != "matrix" and whole is not None:
            _absorbed(rows, gathered, fitted.chosen(calibration.kept & whole.kept), calibration, whole)
    return rows


def _absorbed(rows: Rows, gathered: Gathered, fitted: Measured, calibration: Calibration, whole: Calibration) -> None:
    known = gathered.deformations["matrix"]
    size = (known.K - calibration.case.nominal.deformation).ravel()
    jacobian, signature, scales = _against(gathered, fitted, calibration, whole.case.nominal)
    found = absorb(jacobian, -signature, calibration.parameters.labels, scales)
    predicted = found.shift @ size
    spread = found.comparison_covariance(np.diag(np.nan_to_num(known.sigma).ravel() ** 2), "fit")
    observed = calibration.values - _counterparts(calibration, whole)
    units = calibration.parameters.units
    rows.add(
        effect="platform-deformation-matrix",
        model=calibration.case.structure.name,
        deformation=calibration.case.deformation,
        estimator=calibration.estimator,
        leg=[entry.leg + 1 if entry.leg >= 0 else None for entry in calibration.parameters.entries],
        parameter=[entry.name for entry in calibration.parameters.entries],
        unit=[entry.unit for entry in calibration.parameters.entries],
        predicted=predicted / units,
        observed=observed / units,
        sigma=np.sqrt(np.maximum(np.diag(spread), 0.0)) / units,
    )


def _against(
    gathered: Gathered, fitted: Measured, calibration: Calibration, deforming: Machine
) -> tuple[NDArray, NDArray, NDArray | None]:
    """Return Jacobian (N, P), signature of the entries of K (N, L L), and the prior's sigmas, before any fit.

    The maximum-likelihood fit weighs the closings by their noise and has tolerances, and the survey of the attachments
    in rows of their own; the implicit one has neither.
    """
    problem = calibration.problem_at(fitted)
    entries = deformation_set(deforming, "matrix")
    both = CalibrationProblem(
        problem.structure, calibration.case.nominal, entries, fitted.platform.p, fitted.platform.R, fitted.rho
    )
    start, shape = calibration.nominal, (-1, len(calibration.nominal))
    if calibration.estimator != MAXIMUM_LIKELIHOOD:
        still = np.zeros((len(fitted.rho), problem.deviations))
        by_K = both.constrain(both.start, still).by_values
        return problem.constrain(start, still).by_values.reshape(shape), by_K.reshape(-1, len(entries)), None
    whitened = whiten(problem, start, fitted, gathered.reading_sigma)
    by_K = whiten(both, both.start, fitted, gathered.reading_sigma).jacobian
    scales = np.where(np.isfinite(calibration.tolerance), calibration.tolerance, widest(calibration.parameters))
    jacobian, signature = whitened.jacobian.reshape(shape), by_K.reshape(-1, len(entries))
    if gathered.surveyed is not None:
        known = np.linalg.solve(
            np.linalg.cholesky(gathered.surveyed.covariance), survey_rows(gathered.surveyed, calibration.parameters)
        )
        jacobian = np.concatenate([jacobian, known])
        signature = np.concatenate([signature, np.zeros((len(known), len(entries)))])
    return jacobian, signature, scales


def _counterparts(calibration: Calibration, whole: Calibration) -> NDArray:
    """Return the values (P,) that the calibration's parameters have in one with the whole deformation.

    kappa is counted from its nominal value, of which the effect left out is counted too.
    """
    own, nominal = calibration.parameters, calibration.nominal
    place = dict(zip(whole.parameters.labels, whole.values, strict=True))
    return np.array(
        [
            nominal[i] if entry.name == "kappa" else place.get(entry.label, nominal[i])
            for i, entry in enumerate(own.entries)
        ]
    )
