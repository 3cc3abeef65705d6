"""Artifacts of the diagnosis of a chain: errors of each pose and series, identified numbers, and model.toml."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from truing.arrays import TableRow
from truing.inference.fitter import Fitter
from truing.schemas.artifacts import ARTIFACTS
from truing.simulation.mechanisms.chains.closed_tree import ClosedTree
from truing.simulation.mechanisms.chains.extended_model import extended_chain, write_chain
from truing.simulation.mechanisms.chains.guideways import GuidewayError
from truing.simulation.mechanisms.chains.joint_curves import JointErrorCurve
from truing.simulation.mechanisms.chains.model import ChainModel
from truing.simulation.mechanisms.chains.motor_encoders import MotorTerm
from truing.stages.common.missing_data import HELD_OUT
from truing.stages.diagnosis.all_epochs import fitted_to_all
from truing.stages.diagnosis.chain_inseparable import inseparable_table
from truing.stages.diagnosis.chain_next import chain_measurements_of
from truing.stages.diagnosis.chain_parameters import parameters_table, pull_sums_table, uncertainty_table
from truing.stages.diagnosis.chain_repeats import accuracy_table
from truing.stages.diagnosis.component_errors import tip_errors
from truing.stages.diagnosis.diagnosis_data import DiagnosisData, InstrumentResults
from truing.stages.diagnosis.residual_tables import errors_by_role, left_out_table, prediction_table
from truing.stages.diagnosis.tip_uncertainty import tip_table

if TYPE_CHECKING:
    from truing.inference.fitted_model import FittedModel
    from truing.inference.prediction import PredictionError
    from truing.inference.selection import CauseDiagnosis
    from truing.schemas.campaign import Campaign
    from truing.simulation.effects_model import EffectsModel

_MM, _UM = 1e-3, 1e6


def results(
    diagnosis: CauseDiagnosis,
    data: DiagnosisData[EffectsModel],
    settings: Campaign,
    series: Mapping[int | str, str],
    motors: Sequence[MotorTerm] = (),
    tables: Mapping[str, pa.Table] = MappingProxyType({}),
) -> InstrumentResults:
    """Errors of each pose and series, identified numbers of the chain, and the extended model.

    ``series``: label of the series of each pose that has one; ``motors``: terms of the motor encoders.
    ``tables``: joints and configurations, by which next poses are chosen.
    """
    next_poses = chain_measurements_of(diagnosis, settings, tables) if tables else None
    model = diagnosis.final.model
    is_open = isinstance(model, ChainModel) and not isinstance(model.tree, ClosedTree)
    inseparable = inseparable_table(diagnosis.final, settings, tables) if tables and is_open else None
    diagnosis, data = fitted_to_all(diagnosis, data, settings.diagnosis.seed)
    final = diagnosis.final
    of_errors = {"diagnosis_left_out": left_out_table(diagnosis, data)} if diagnosis.screened else {}
    of_motors = {"motor_encoders": motors_table(motors)} if motors else {}
    repeated = accuracy_table(data, tables)
    of_repeats = {} if repeated is None else {"arm_accuracy": repeated}
    of_series = {"series_errors": series_table(diagnosis, data, series)} if series else {}
    return InstrumentResults(
        {
            "prediction": prediction_table(diagnosis, data, positions_alone, nominal_errors(diagnosis, data)),
            **of_errors,
            **of_series,
            **of_repeats,
            **of_motors,
            "chain_parameters": parameters_table(final),
            "pull_sums": pull_sums_table(diagnosis.plain, final),
            "chain_uncertainty": uncertainty_table(final),
            "chain_inseparable": inseparable,
            **curves_table(final),
            "guideway_errors": guideways_table(final),
            "model": text_of_model(final, settings),
            "component_errors": tip_errors(diagnosis, data),
            "tip_uncertainty": tip_table(final, settings),
            "next_poses": None if next_poses is None else next_poses.table,
        },
        {} if next_poses is None else next_poses.advice,
    )


def nominal_errors(diagnosis: CauseDiagnosis, data: DiagnosisData[EffectsModel]) -> dict[str, PredictionError]:
    """Errors of the chain as its description has it, by role of the poses; only base and tool are fitted.

    Gross errors that the diagnosis found are left out. Empty where the description is taken for exact.
    """
    model = data.model
    assert isinstance(model, ChainModel)
    if not model.layout["links"].stop - model.layout["links"].start and not len(model.free_offsets):
        return {}
    exact = replace(model.known, modes=model.known.modes[..., :0], offsets=np.zeros_like(model.known.offsets))
    final = diagnosis.final
    calibration, held_out = data.calibration, data.held_out
    calibration = replace(calibration, measured=replace(calibration.measured, is_observed=final.measured.is_observed))
    if held_out is not None and final.held_out is not None:
        held_out = replace(held_out, measured=replace(held_out.measured, is_observed=final.held_out.is_observed))
    fitted = Fitter(replace(model, known=exact), calibration, held_out, 0).fitted(())
    errors = {"calibration": fitted.error}
    return errors if fitted.held_out is None else errors | {HELD_OUT: fitted.held_out}


def positions_alone(error: PredictionError) -> PredictionError:
    """Error of the measured positions or distances: orientations have another unit."""
    assert isinstance(error.model, ChainModel)
    turned = error.model.is_angle
    if not turned.any():
        return error
    is_observed = error.measured.is_observed & ~turned
    gap = np.where(turned[:, None], 0.0, error.gap)
    return replace(error, gap=gap, measured=replace(error.measured, is_observed=is_observed))


def series_table(
    diagnosis: CauseDiagnosis, data: DiagnosisData[EffectsModel], series: Mapping[int | str, str]
) -> pa.Table:
    """Rows of series_errors.parquet: errors of the positions in each series, fitted and held out."""
    rows: list[TableRow] = []
    for role, before, after in errors_by_role(diagnosis):
        epochs = data.calibration if role != HELD_OUT else data.held_out
        assert epochs is not None
        labels = np.array([series.get(pose, "") for pose in epochs.conditions.poses], object)
        errors = positions_alone(before), positions_alone(after)
        for label in sorted(set(labels) - {""}):
            selected = labels == label
            sizes = [_rms(error, selected) for error in errors]
            if None not in sizes:
                numbers = dict(zip(("rms_before", "rms_after"), sizes, strict=True))
                rows.append({"series": label, "role": role, "poses": int(selected.sum()), **numbers, "unit": "um"})
    return pa.Table.from_pylist(rows, schema=ARTIFACTS["series_errors"].arrow_schema())


def motors_table(terms: Sequence[MotorTerm]) -> pa.Table:
    """Rows of motor_encoders.parquet, lengths in mm."""
    rows = []
    for term in terms:
        unit, si = {"m": ("mm", _MM), "m/N": ("mm/N", _MM)}.get(term.unit, (term.unit, 1.0))
        numbers = {"value": term.value, "sigma": term.sigma}
        scaled = {name: None if size is None else size / si for name, size in numbers.items()}
        row = {"joint": term.joint, "parameter": term.parameter, "unit": unit, **scaled}
        rows.append({**row, "identifiable": term.value is not None})
    return pa.Table.from_pylist(rows, schema=ARTIFACTS["motor_encoders"].arrow_schema())


def _rms(error: PredictionError, errors: NDArray) -> float | None:
    """Root mean square per coordinate of some poses (B,), um; None where nothing was seen."""
    count = error.measured.size * int(error.is_observed[errors].sum())
    return float(np.sqrt(np.sum(error.gap[errors] ** 2) / count)) * _UM if count else None


def text_of_model(fitted: FittedModel, settings: Campaign) -> str:
    """The extended model of a fit, as model.toml has it."""
    model = fitted.model
    assert isinstance(model, ChainModel)
    context = {"campaign": settings.campaign.name}
    tip = model.known.payload[0]
    return write_chain(extended_chain(model, fitted.fit.shared, fitted.covariance(), tip, context))


def curves_table(fitted: FittedModel) -> dict[str, pa.Table]:
    """Rows of joint_curves.parquet: error curves of joints along their readings; none without such a cause."""
    curves = [
        curve
        for cause in fitted.causes
        if isinstance(cause, JointErrorCurve)
        for curve in cause.curves(*fitted.values(cause))
    ]
    if not curves:
        return {}
    columns = {
        "joint": [curve.joint for curve in curves for _ in curve.readings],
        "joint_reading_si": np.concatenate([curve.readings for curve in curves]),
        "deviation_si": np.concatenate([curve.deviation for curve in curves]),
        "deviation_sigma_si": np.concatenate([curve.sigma for curve in curves]),
        "is_determined": np.concatenate([curve.is_determined for curve in curves]),
    }
    return {"joint_curves": pa.table(columns, schema=ARTIFACTS["joint_curves"].arrow_schema())}


def guideways_table(fitted: FittedModel) -> pa.Table | None:
    """Rows of guideway_errors.parquet: error of each guideway along its slide; None without such a cause."""
    assert isinstance(fitted.model, ChainModel)
    parts: list[pa.Table] = []
    machine = fitted.model.scene.inputs_of_machine
    for cause in fitted.causes:
        if not isinstance(cause, GuidewayError):
            continue
        curve = cause.curve(*fitted.values(cause))
        measured = machine.readings[:, machine.tree.readings.index(cause.joint)]
        count = len(curve.readings)
        columns = {
            "joint": [cause.joint] * count,
            "guideway_motion": [cause.error] * count,
            "guideway_axis": [cause.axis] * count,
            "joint_reading_si": curve.readings,
            "guideway_error_si": curve.deviation,
            "guideway_sigma_si": curve.sigma,
            "measured_from_si": np.full(count, measured.min()),
            "measured_to_si": np.full(count, measured.max()),
        }
        parts.append(pa.table(columns, schema=ARTIFACTS["guideway_errors"].arrow_schema()))
    return pa.concat_tables(parts) if parts else None
