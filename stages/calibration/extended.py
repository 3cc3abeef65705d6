"""The extended model in the tables of the calibrations: parameters, effects and accuracy.

The diagnosis fitted it to the points themselves.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from truing.calibration.accuracy import (
    ARCSEC,
    ESTIMATOR,
    MODEL,
    AssessedCalibration,
    Extended,
    error_figures,
    errors_at,
    identifiable,
)
from truing.calibration.calibration_input import CalibrationData, MeasuredPlatform
from truing.inference.pulls import pulls
from truing.simulation.mechanisms.extended_model import ExtendedModel, name_and_leg, read_model, some_of
from truing.stages.calibration.model_rows import accuracy_rows, add_correlations, add_figures, requirement_rows
from truing.stages.common.applied_findings import AS_RECORDED, WITH_FINDINGS
from truing.stages.common.point_arrays import pose_ids
from truing.stages.common.pose_conditions import pose_conditions
from truing.stages.common.rows import Rows

if TYPE_CHECKING:
    from truing.schemas.sections import Requirement
    from truing.simulation.mechanisms.recording import Conditions


def extended_of(
    text: str, tables: Mapping[str, pa.Table], measured: MeasuredPlatform, fitted: NDArray, *, is_main: bool = False
) -> Extended:
    """Model of a model.toml compared with measured poses; fitted (B,): poses that it was fitted to."""
    extended_model = read_model(text)
    conditions = _conditions(extended_model, tables["configurations"], measured)
    return Extended(extended_model, errors_at(extended_model, conditions, measured, fitted), is_main)


def _conditions(extended: ExtendedModel, configurations: pa.Table, measured: MeasuredPlatform) -> Conditions:
    """Conditions of the measured poses; conditions that depend on the order in time use all poses."""
    every = pose_ids(configurations)
    conditions = pose_conditions(
        configurations, every, extended.model.nominal.count, extended.model.known.reading_sigma
    )
    index_of = {pose: n for n, pose in enumerate(every)}
    return some_of(conditions, np.array([index_of[pose] for pose in measured.poses], int))


def extended_parameters(extended: Extended) -> Rows:
    """Parameters of the machine, then those of the effects, as rows of calibration.parquet."""
    rows, geometry = Rows("calibration"), extended.geometry
    si = np.array([entry.si for entry in geometry.parameters])
    reported = identifiable(geometry)
    if len(si):
        shift = geometry.values - geometry.nominal
        spread = np.where(reported, np.diag(geometry.prior) - geometry.sigma**2, np.nan)
        rows.add(
            model=MODEL,
            deformation=extended.deformation,
            leg=[entry.leg + 1 for entry in geometry.parameters],
            parameter=[entry.name for entry in geometry.parameters],
            unit=[entry.unit for entry in geometry.parameters],
            nominal=geometry.nominal / si,
            identified=geometry.values / si,
            sigma=geometry.sigma / si,
            tolerance=geometry.tolerance / si,
            pull=np.where(geometry.known, shift / np.sqrt(spread), np.nan),
            identifiable=reported,
            status="ok",
        )
    _add_effects(rows, extended)
    return rows


def _add_effects(rows: Rows, extended: Extended) -> None:
    """Add the numeric parameters of each effect; texts (first pose) are in diagnosis.parquet."""
    for effect, covariance in extended.effects:
        for reported in effect.cause.reported(effect.values, covariance, extended.found.model.nominal.count):
            if not isinstance(reported.value, str) and reported.sigma is not None:
                name, leg = name_and_leg(reported.name)
                rows.add(
                    model=MODEL,
                    deformation=extended.deformation,
                    leg=leg,
                    parameter=name,
                    effect_of=f"{effect.cause.id} {effect.cause.subject}".strip(),
                    unit=reported.unit,
                    identified=reported.value,
                    sigma=reported.sigma,
                    identifiable=True,
                    status="ok",
                )


def extended_figures(extended: Extended) -> list[tuple[str, float, str]]:
    """Figures of the model's fit: number of parameters, and shift of the geometry."""
    geometry = extended.geometry
    indices = np.flatnonzero(geometry.known)
    pull_sums = pulls(
        (geometry.values - geometry.nominal)[indices],
        geometry.prior[np.ix_(indices, indices)],
        geometry.covariance[np.ix_(indices, indices)],
    )
    reported = pull_sums.pull[pull_sums.identifiable]
    figures = [("parameters", float(len(extended.found.shared)), "1"), ("pull_freedom", float(len(reported)), "1")]
    if len(reported):
        figures += [("rms_pull", float(np.sqrt(np.mean(reported**2))), "1"), ("pull_p_value", pull_sums.p_value, "1")]
    return figures


def extended_correlations(extended: Extended) -> Rows:
    """Correlated pairs of the model's parameters, with those of effects in their fitted form."""
    model, geometry = extended.found.model, extended.geometry
    names = [(entry.name, entry.leg_number) for entry in geometry.parameters]
    by_shared = [geometry.by_shared]
    for cause in model.causes:
        parameters = cause.parameters(model.nominal.count)
        names += [name_and_leg(parameter.name) for parameter in parameters]
        by_shared.append(np.eye(model.shared_size)[model.layout[cause.key]])
    rows, derivative = Rows("correlations"), np.concatenate(by_shared)
    add_correlations(rows, (MODEL, extended.deformation), names, derivative @ extended.found.covariance @ derivative.T)
    return rows


def compared_rows(chosen: AssessedCalibration, extended: Extended, fitted: NDArray) -> Rows:
    """Errors of the chosen calibration and of the extended model at held-out poses.

    fitted (B,): the other poses; if all were fitted, the errors are at those.
    """
    rows, is_held_out = Rows("calibrations_compared"), ~fitted
    asked, tested_on = (is_held_out, "verification poses") if is_held_out.any() else (fitted, "calibration poses")
    assert chosen.errors is not None
    causes = [f"{effect.cause.id} {effect.cause.subject}".strip() for effect, _ in extended.effects]
    both = (
        (AS_RECORDED, chosen.calibration.case.key, chosen.errors, None),
        (WITH_FINDINGS, (MODEL, extended.deformation), extended.errors, " and ".join(dict.fromkeys(causes))),
    )
    for data, (model, deformation), errors, findings in both:
        for quantity, size, first, unit, si in (
            ("position", errors.position, 0, "um", 1e-6),
            ("orientation", errors.orientation, 3, "arcsec", ARCSEC),
        ):
            used = asked & np.isfinite(size)
            if not used.any():
                continue
            rms = float(np.sqrt(np.mean(size[used] ** 2))) / si
            rows.add(
                data=data,
                is_main=extended.is_main == (data == WITH_FINDINGS),
                findings=findings,
                model=model,
                deformation=deformation,
                quantity=quantity,
                tested_on=tested_on,
                rms_error=rms,
                largest_error=float(size[used].max()) / si,
                rms_unchanged=rms,
                noise_rms=float(np.sqrt(np.mean(errors.expected(first)[used] ** 2))) / si,
                count=int(used.sum()),
                unit=unit,
            )
    return rows


def add_extended(
    rows: Mapping[str, Rows],
    extended: Extended,
    requirement: Requirement,
    data: CalibrationData,
    fitted: NDArray,
    why_not: str,
) -> None:
    """Add the extended model to the tables of the calibrations; it is no candidate of the choice, because it was fitted
    to other data. ``why_not``: reason of a failed test, so that it meets no requirement; else empty."""
    key, measured = (MODEL, extended.deformation), data.measured
    rows["calibration"].extend(extended_parameters(extended))
    rows["correlations"].extend(extended_correlations(extended))
    rows["accuracy"].extend(accuracy_rows("accuracy", [(key, extended.errors)], measured))
    figures = [*error_figures(extended.errors, measured.roles), *extended_figures(extended)]
    figures += [("main", 1.0, "1")] if extended.is_main else []
    add_figures(rows["model_choice"], key, ESTIMATOR, figures)
    noise = np.diagonal(measured.platform.covariance, axis1=1, axis2=2)
    rows["requirements"].extend(requirement_rows(requirement, key, extended.errors.error, noise, ~fitted, why_not))
