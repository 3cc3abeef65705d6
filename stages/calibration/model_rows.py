"""Calibrations as table rows: parameters, errors, figures, observability and requirements."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from truing.calibration.accuracy import (
    ARCSEC,
    AssessedCalibration,
    Decision,
    Figure,
    PoseErrors,
    chance_at_limit,
    deciding_pose_count,
    error_figures,
    error_of_95_percent,
    fit_figures,
    nominal_errors,
)
from truing.calibration.calibration_input import CalibrationData, MeasuredPlatform, under_load
from truing.calibration.fits import MAXIMUM_LIKELIHOOD, MachineCalibration
from truing.calibration.flexure_observability import DesignParameter
from truing.calibration.parameter_information import absorbed, observe_legs, observe_model
from truing.estimation.design.observability import Observability, choose_identifiable, indices, inseparable
from truing.estimation.held_out import ContenderChoice
from truing.estimation.interval import Interval
from truing.simulation.mechanisms.structures.catalogue import departure, structures
from truing.simulation.mechanisms.structures.structure import Machine, Structure, poses_at
from truing.stages.common.rows import Rows

if TYPE_CHECKING:
    from truing.schemas.sections import Requirement

Key = tuple[str, str]  # model, deformation

LESS_THAN_K = ("none", "linear")
LEAST_CORRELATION = 0.05  # pairs of parameters below this correlation are not listed
COMPONENTS = {"x": "mm", "y": "mm", "z": "mm", "rx": "deg", "ry": "deg", "rz": "deg"}
SI = {"mm": 1e-3, "deg": np.pi / 180.0}


def parameter_rows(artifact: str, calibrations: Sequence[MachineCalibration]) -> Rows:
    """Every identified parameter of every calibration, in table units."""
    rows = Rows(artifact)
    for calibration in calibrations:
        units = calibration.parameters.units
        rows.add(
            **_named_parameters(calibration),
            nominal=calibration.nominal / units,
            identified=calibration.values / units,
            sigma=calibration.sigma / units,
            tolerance=calibration.tolerance / units,
            pull=calibration.pull,
            identifiable=calibration.identifiable,
            status=calibration.status,
        )
    return rows


def _named_parameters(calibration: MachineCalibration) -> dict[str, object]:
    """Return the columns that name a calibration's parameters, one element per parameter."""
    entries = calibration.parameters.entries
    return {
        "model": calibration.case.structure.name,
        "deformation": calibration.case.deformation,
        "leg": [entry.leg_number for entry in entries],
        "parameter": [entry.name for entry in entries],
        "unit": [entry.unit for entry in entries],
    }


def correlation_rows(calibrations: Sequence[MachineCalibration]) -> Rows:
    """Correlated pairs of every calibration's parameters."""
    rows = Rows("correlations")
    for calibration in calibrations:
        names = [(entry.name, entry.leg_number) for entry in calibration.parameters.entries]
        add_correlations(rows, calibration.case.key, names, calibration.covariance)
    return rows


def add_correlations(rows: Rows, key: Key, names: Sequence[tuple[str, int | None]], covariance: NDArray) -> None:
    """Add the correlated pairs of a model's parameters, by name and leg, with their covariance (P, P)."""
    sigma = np.sqrt(np.diag(covariance))
    correlation = np.clip(np.nan_to_num(covariance / np.outer(sigma, sigma)), -1.0, 1.0)
    first, second = np.argwhere(np.triu(np.abs(correlation) >= LEAST_CORRELATION, 1)).T.tolist()
    rows.add(
        model=key[0],
        deformation=key[1],
        leg=[names[i][1] for i in first],
        parameter=[names[i][0] for i in first],
        other_leg=[names[j][1] for j in second],
        other_parameter=[names[j][0] for j in second],
        correlation=correlation[first, second],
    )


def choice_rows(assessed: Sequence[AssessedCalibration], roles: NDArray, made: ContenderChoice) -> Rows:
    """Figures of every calibration; ``made``: those by maximum likelihood, which come first."""
    rows = Rows("model_choice")
    for i, row in enumerate(assessed):
        figures = [*error_figures(row.errors, roles), *fit_figures(row)]
        if row.calibration.estimator == MAXIMUM_LIKELIHOOD:
            figures.append(("chosen", float(i == made.chosen), "1"))
            figures.append(("indistinguishable", float(made.indistinguishable[i]), "1"))
        add_figures(rows, row.calibration.case.key, row.calibration.estimator, figures)
    return rows


def add_figures(rows: Rows, key: Key, estimator: str, figures: Sequence[Figure]) -> None:
    """Add figures of a model to rows of model_choice."""
    for name, value, unit in figures:
        rows.add(model=key[0], deformation=key[1], estimator=estimator, figure=name, value=value, unit=unit)


def add_uncalibrated(rows: Rows, machine: Machine, measured: MeasuredPlatform) -> None:
    """Add the figures of the nominal machine, and the departure of every other model of its structure from rigid legs
    over the campaign's readings."""
    rigid, *elastic = structures(machine)
    errors = nominal_errors(rigid, machine, measured)
    add_figures(rows, (rigid.name, "none"), "nominal", error_figures(errors, measured.roles))
    for structure in elastic:
        if structure.name == "stiffness" and measured.load is not None:
            add_figures(rows, (structure.name, "none"), "nominal", _moved_by_load(structure, machine, measured))
        departure_um = departure(structure, machine, measured.rho) * 1e6
        reported = departure_um[np.isfinite(departure_um)]
        if len(reported):
            figures = [
                ("reading_rms_from_rigid_legs", float(np.sqrt(np.mean(reported**2))), "um"),
                ("reading_max_from_rigid_legs", float(np.max(np.abs(reported))), "um"),
            ]
            add_figures(rows, (structure.name, "none"), "nominal", figures)


def _moved_by_load(structure: Structure, machine: Machine, measured: MeasuredPlatform) -> list[Figure]:
    """Rms shift of the platform by its load, and rms of its difference between poses: the load's share that a
    calibration of the geometry cannot absorb."""
    loaded = under_load(machine, measured)
    free, loaded_poses = (poses_at(structure, variant, measured.rho) for variant in (machine, loaded))
    moved = (loaded_poses.p - free.p)[free.converged & loaded_poses.converged] * 1e6
    if not len(moved):
        return []
    sizes = {"load_shift_rms": moved, "load_shift_varying": moved - moved.mean(axis=0)}
    return [(name, float(np.sqrt(np.mean(np.sum(part**2, -1)))), "um") for name, part in sizes.items()]


def accuracy_rows(artifact: str, reported: Sequence[tuple[Key, PoseErrors]], measured: MeasuredPlatform) -> Rows:
    """Errors of all models as rows of accuracy.parquet or implicit_accuracy.parquet."""
    rows = Rows(artifact)
    parts = ("dx_um", "dy_um", "dz_um", "rx_arcsec", "ry_arcsec", "rz_arcsec")
    units = np.array([1e-6] * 3 + [ARCSEC] * 3)
    for (model, deformation), map_errors in reported:
        is_finite = np.isfinite(map_errors.error).all(-1)
        rows.add(
            model=model,
            deformation=deformation,
            pose=[pose for pose, finite in zip(measured.poses, is_finite, strict=True) if finite],
            role=measured.roles[is_finite],
            position_error_um=map_errors.position[is_finite] * 1e6,
            orientation_error_arcsec=map_errors.orientation[is_finite] / ARCSEC,
            **{name: map_errors.error[is_finite, i] / units[i] for i, name in enumerate(parts)},
            position_noise_um=map_errors.expected(0)[is_finite] * 1e6,
            orientation_noise_arcsec=map_errors.expected(3)[is_finite] / ARCSEC,
        )
    return rows


def requirement_rows(
    requirement: Requirement, key: Key, errors: NDArray, variances: NDArray, held_out: NDArray, why_not: str = ""
) -> Rows:
    """One row per required component, evaluated by the errors (B, 6) of a model, m and rad; NaN if not measured.

    variances (B, 6): those of the measurement, which are subtracted; held_out (B,): poses used, all if there are none.
    ``why_not``: failed test of the model and remedy; such a model meets no requirement.
    """
    limits = [getattr(requirement, f"{component}_{unit}") for component, unit in COMPONENTS.items()]
    si = np.array([SI[unit] for unit in COMPONENTS.values()])
    why = dict.fromkeys(COMPONENTS, why_not)
    component_errors = ComponentErrors(COMPONENTS, errors / si, variances / si**2, held_out)
    return limit_rows(component_errors, limits, key, why)


@dataclass(frozen=True)
class ComponentErrors:
    """Errors (B, K) by component, in its unit (K units by name); NaN if not measured.

    variances (B, K): those of the measurement, which are subtracted; held_out (B,): rows used, all if there are none.
    ``of``: noun of the rows.
    """

    units: Mapping[str, str]
    errors: NDArray
    variances: NDArray
    held_out: NDArray
    of: str = "poses"


def limit_rows(
    measured: ComponentErrors,
    limits: Sequence[float | None],
    key: Key,
    why_not: Mapping[str, str] = MappingProxyType({}),
) -> Rows:
    """One row per component with a limit; ``why_not``: by component, why no model meets its requirement."""
    held_out, requirement = measured.held_out, measured.of
    rows, assessed = Rows("requirements"), held_out if held_out.any() else ~held_out
    by = "" if held_out.any() else f", evaluated at the fitted {requirement}"
    for i, ((component, unit), limit) in enumerate(zip(measured.units.items(), limits, strict=True)):
        if limit is None:
            continue
        errors_of_axis, noise = measured.errors[assessed, i], measured.variances[assessed, i]
        interval = error_of_95_percent(errors_of_axis, noise)
        verdict = _verdict(interval, limit)
        decision = deciding_pose_count(
            errors_of_axis, noise, limit, 0 if held_out.any() else int(np.isfinite(errors_of_axis).sum())
        )
        words = _requirement_words(interval, verdict, limit, unit, requirement) + (by if interval else "")
        if (why := why_not.get(component)) and verdict in ("meets", "undecided"):
            verdict, words = "not evaluated", f"not tested: {why}"
        rows.add(
            model=key[0],
            deformation=key[1],
            component=component,
            requirement=limit,
            error=interval and interval.value,
            lower=interval and interval.lower,
            upper=interval and interval.upper,
            unit=unit,
            verdict=verdict,
            message=f"{component}: {words}",
            poses_judged=int(np.isfinite(errors_of_axis).sum()) or None,
            p_value=chance_at_limit(errors_of_axis, noise, limit) if interval else None,
            **(_open(decision) if verdict == "undecided" else _open(None)),
        )
    return rows


def _open(decision: Decision | None) -> dict[str, float | int | None]:
    """Measurement that would decide an undecided requirement; empty for others."""
    if decision is None:
        return dict.fromkeys(("measurements", "lower_expected", "upper_expected"))
    then = (None, None) if decision.then is None else (decision.then.lower, decision.then.upper)
    return {
        "measurements": decision.more_poses,
        "lower_expected": then[0],
        "upper_expected": then[1],
    }


def _verdict(interval: Interval | None, limit: float) -> str:
    if interval is None:
        return "not evaluated"
    if interval.upper <= limit:
        return "meets"
    return "fails" if interval.lower > limit else "undecided"


def _requirement_words(interval: Interval | None, verdict: str, limit: float, unit: str, requirement: str) -> str:
    if interval is None:
        return f"not measured at any of the {requirement}"
    bounds = f"between {interval.lower:.2g} and {interval.upper:.2g}"
    text = f"95 of 100 {requirement} stay below {interval.value:.2g} {unit} ({bounds})"
    if interval.value == 0:
        text = f"no error above the measurement noise (at most {interval.upper:.2g} {unit})"
    return f"{text}, required {limit:g} {unit}: {verdict}"


def observability_rows(data: CalibrationData, fitted: MeasuredPlatform, chosen: MachineCalibration) -> Rows:
    """Observability: leg by leg of the rigid legs with all parameters, and of the chosen model."""
    rows = Rows("observability")
    for leg, leg_observability in enumerate(observe_legs(data, fitted)):
        _observed_rows(rows, data.machine.legs.closure.name, "linear", leg + 1, leg_observability, len(fitted.poses))
    observability = observe_model(data, fitted, chosen)
    _observed_rows(rows, chosen.case.structure.name, chosen.case.deformation, None, observability, len(fitted.poses))
    return rows


def _observed_rows(
    rows: Rows, model: str, deformation: str, leg: int | None, observability: Observability, poses: int
) -> None:
    best = choose_identifiable(
        observability.triangle / observability.scales, observability.scales, observability.labels
    ).observability
    figures = {
        "parameters": float(len(observability.labels)),
        "rank": float(observability.rank),
        "threshold": observability.least,
        "condition": best.condition,
        **{name.upper(): value for name, value in vars(indices(best.singular_values, poses)).items() if name[0] == "o"},
    }
    common = {"model": model, "deformation": deformation, "leg": leg, "unit": "1"}
    for name, value in figures.items():
        rows.add(**common, figure=name, value=value if np.isfinite(value) else None)
    rows.add(**common, figure="identifiable_set", value=float(len(best.labels)), combination=" ".join(best.labels))
    for label, sigma in zip(observability.labels, observability.sigma / observability.scales, strict=True):
        rows.add(**common, figure="sigma", value=float(sigma) if np.isfinite(sigma) else None, combination=label)
    for value in observability.singular_values:
        rows.add(**common, figure="singular_value", value=float(value))
    for group in inseparable(observability):
        # one sentence for the group if sufficient, else one per unobservable change
        texts = group.texts if len(group.determined) > 1 else (group.text,)
        for text, sigma in zip(texts, group.sigma, strict=False):
            value = float(sigma) if np.isfinite(sigma) else None
            rows.add(**common, figure="unidentifiable", value=value, combination=text)


def flexure_rows(parameters: Sequence[DesignParameter]) -> Rows:
    """Design parameters of flexures and legs, with their identifiability."""
    rows = Rows("flexure_parameters")
    for parameter in parameters:
        unit = parameter.entry.si
        rows.add(
            model=parameter.model,
            leg=parameter.entry.leg_number,
            parameter=parameter.entry.name,
            unit=parameter.entry.unit,
            nominal=parameter.nominal / unit,
            tolerance=parameter.tolerance / unit,
            sensitivity_um=1e6 * parameter.sensitivity,
            closure_noise_um=1e6 * parameter.noise,
            sigma_over_tolerance=parameter.sigma if np.isfinite(parameter.sigma) else None,
            identifiable=parameter.identifiable,
        )
    return rows


def absorption_rows(
    data: CalibrationData, fitted: MeasuredPlatform, calibrations: Sequence[MachineCalibration]
) -> Rows:
    """Bias of the parameters of models with less deformation by K, predicted and observed in the fits."""
    rows = Rows("absorption")
    known = data.deformations.get("matrix")
    if known is None or not np.isfinite(known.K).all():
        return rows
    full = {(c.case.structure.name, c.estimator): c for c in calibrations if c.case.deformation == "matrix"}
    for calibration in calibrations:
        complete = full.get((calibration.case.structure.name, calibration.estimator))
        if calibration.case.deformation in LESS_THAN_K and complete is not None:
            _absorbed(rows, data, fitted.subset(calibration.kept & complete.kept), calibration, complete)
    return rows


def _absorbed(
    rows: Rows,
    data: CalibrationData,
    fitted: MeasuredPlatform,
    calibration: MachineCalibration,
    complete: MachineCalibration,
) -> None:
    units = calibration.parameters.units
    absorption = absorbed(data, fitted, calibration, complete)
    rows.add(
        **_named_parameters(calibration),
        effect="platform-deformation-matrix",
        estimator=calibration.estimator,
        predicted=absorption.predicted / units,
        observed=absorption.observed / units,
        sigma=absorption.sigma / units,
    )
