"""Data of the diagnosis of an axis (readings minus commands), and its artifacts."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, cast

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from truing.arrays import TableRow
from truing.inference.blocks import group_numbers
from truing.inference.observations import Epochs, Frames, Observations
from truing.report.diagnosis.findings import IN_TURN, SCATTER_OF_REPEATS
from truing.report.numbers import count_text
from truing.schemas.verdict import Relation
from truing.simulation.axis.extended_model import extended_axis, write_axis
from truing.simulation.axis.model import AxisModel
from truing.simulation.axis.rows import ENCODERS, MEASURED
from truing.stages.common.approaches import gross_approaches
from truing.stages.common.axis_columns import (
    REPORTED_UNITS,
    SI,
    AxisColumns,
    columns_of,
    command_sigma,
    encoder_sigma,
    excluded_rows,
)
from truing.stages.common.blocks import groupings_of, labels_of, selected_groupings
from truing.stages.common.evaluable_axis_stages import is_held_out, why_no_diagnosis
from truing.stages.diagnosis.diagnosis_data import Channels, DiagnosisData, InstrumentResults
from truing.stages.diagnosis.residual_tables import errors_by_role, identified_table

if TYPE_CHECKING:
    from truing.inference.fitted_model import FittedModel
    from truing.inference.selection import CauseDiagnosis
    from truing.schemas.campaign import Campaign
    from truing.schemas.mechanism import AxisMechanism
    from truing.simulation.effects_model import EffectsModel

Mask = NDArray[np.bool_]

# Rows of a recording that are compared, evenly spread over it: more rows take long and add little information.
_MOST_ROWS = 1500
# Prior of an encoder's zero, as a multiple of the distance of its readings from the commands.
_WIDE = 1e3
# Prior of the load's stop behind the motor, as a share of the encoders' noise: hardly any, but it may prove larger.
_HARDLY = 0.2
_SCATTER_AT_TARGET = "Approach one target ten times from the same side: the scatter is the true noise."
_SCATTER = "Send the axis to one command ten times from the same side: the scatter is the true noise."


def assemble(tables: Mapping[str, pa.Table], settings: Campaign) -> DiagnosisData[AxisModel]:
    """Data of the diagnosis; raises ValueError with the reason if the campaign lacks them."""
    if why := why_no_diagnosis(tables, settings):
        raise ValueError(why)
    table = tables["configurations"]
    columns = columns_of(settings, table)
    off = command_sigma(settings)
    rows, deviations = columns.rows(table, off), columns.deviations(table)
    out, declared_correct = (excluded_rows(rules, rows) for rules in (settings.exclude, settings.keep))
    is_observed = np.isfinite(deviations) & ~out[:, None]
    held_out = is_held_out(table)
    available = is_observed.any(1) & ~held_out
    fitted, held_out = _spread(available), _spread(is_observed.any(1) & held_out)
    largest = float(np.abs(np.where(is_observed, deviations, 0.0)).max())
    sigma = np.array([encoder_sigma(settings, name) for name in columns.encoders], float)
    middle = np.nanmedian(np.where(is_observed, deviations, np.nan), axis=0)
    spread = float(np.abs(np.where(is_observed, deviations - middle, 0.0)).max())
    axis = replace(columns.axis(off), spread=spread, noise=float(np.hypot(off, np.median(sigma))))
    zero, stop = _WIDE * max(largest, float(sigma.max())), _HARDLY * float(np.median(sigma))
    model = AxisModel(axis, rows.subset(fitted), zero, off, stop)

    def poses(rows_of_role: Mask) -> Epochs:
        covariance = np.broadcast_to(sigma**2, is_observed[rows_of_role].shape)[..., None, None]
        measured = Observations(
            np.where(is_observed, deviations, 0.0)[rows_of_role][..., None], covariance, is_observed[rows_of_role]
        )
        keep = np.broadcast_to(declared_correct[rows_of_role][:, None], is_observed[rows_of_role].shape)
        return Epochs(measured, rows.subset(rows_of_role), Frames.of_numbers(int(rows_of_role.sum())), keep)

    shown = _encoder_channels(columns, "held-out rows" if held_out.any() else IN_TURN)
    subset, known = rows.subset(fitted), selected_groupings(labels_of(table, rows.poses), fitted)
    groupings = groupings_of(subset.readings, subset.time_s, subset.direction[:, None], known)
    return DiagnosisData(
        model,
        replace(poses(fitted), repeats=group_numbers(np.round(subset.readings, 12)), groupings=groupings),
        poses(held_out) if held_out.any() else None,
        _left_out(tables, int(out.sum()), int(available.sum()), int(fitted.sum())),
        _results,
        model_text=_model_text,
        shown=_of_approaches(shown) if "positions" in tables else shown,
        relation=Relation.TARGETS_POSITIONS if "positions" in tables else Relation.COMMANDS_ENCODERS,
    )


def _spread(rows: Mask) -> Mask:
    """Return the mask of at most `_MOST_ROWS` of the rows of a mask, evenly spread over them."""
    chosen = np.flatnonzero(rows)
    if len(chosen) > _MOST_ROWS:  # a step that is no whole number meets every sample of a standstill
        chosen = chosen[np.linspace(0, len(chosen) - 1, _MOST_ROWS).round().astype(int)]
    spread = np.zeros_like(rows)
    spread[chosen] = True
    return spread


def _left_out(tables: Mapping[str, pa.Table], excluded: int, available: int, fitted: int) -> str:
    """Rows and approaches that are not compared, in words; empty without any."""
    gross = int(gross_approaches(tables["positions"]).sum()) if "positions" in tables else 0
    words = [f"{count_text(excluded, 'row')} excluded by a person"] if excluded else []
    if fitted < available:
        words.append(
            f"{count_text(available - fitted, 'row')} of {available:,}, so that {fitted:,} evenly spread remain"
        )
    return "; ".join(
        [*words, *([f"{count_text(gross, 'approach')} that check position-errors names"] if gross else [])]
    )


def _of_approaches(shown: Channels) -> Channels:
    """Words of the page for approaches, whose noise is their own scatter."""
    return replace(shown, epoch="approach", scatter=_SCATTER_AT_TARGET, noise=SCATTER_OF_REPEATS)


def _encoder_channels(columns: AxisColumns, held_out: str) -> Channels:
    unit, si = columns.reported_unit
    count = len(columns.encoders)
    return Channels(
        (unit,) * count,
        np.full(count, si),
        np.zeros(count, bool),
        epoch="row",
        fitted="the rows fitted",
        held_out=held_out,
        drive="the command",
        scatter=_SCATTER,
    )


def _model_text(fitted: FittedModel, settings: Campaign) -> str:
    """The extended model of a fit, as model.toml has it."""
    assert isinstance(fitted.model, AxisModel)
    context = {"campaign": settings.campaign.name}
    return write_axis(extended_axis(fitted.model, fitted.fit.shared, fitted.covariance(), context))


def _results(diagnosis: CauseDiagnosis, data: DiagnosisData[EffectsModel], settings: Campaign) -> InstrumentResults:
    """Errors of each reading, and the extended model."""
    section = cast("AxisMechanism", settings.mechanism)
    assert isinstance(data.shown, Channels)
    errors = _errors(diagnosis, data.shown, section.unit)
    required = _required(errors, section, settings)
    text = _model_text(diagnosis.final, settings)
    return InstrumentResults({"axis_errors": errors, "component_errors": required, "model": text})


def _required(errors: pa.Table, section: AxisMechanism, settings: Campaign) -> pa.Table | None:
    """Rows of component_errors.parquet: the outside instrument, else the encoder outside the loop; None without one."""
    names = set(errors.column("encoder").to_pylist()) - {section.loop}
    encoder = next((name for name in (MEASURED, *ENCODERS) if name in names), None)
    sigma = None if encoder is None else encoder_sigma(settings, encoder)
    if encoder is None or sigma is None:
        return None
    unit, sigma = section.unit, sigma / SI[section.unit]
    rows = [row for row in errors.to_pylist() if row["encoder"] == encoder]
    error_rows = [
        {
            "pose": row["pose"],
            "role": row["role"],
            "component": "axis",
            "missed": row["missed_after"] * REPORTED_UNITS[unit][1] / SI[unit],
            "missed_before": row["missed_before"] * REPORTED_UNITS[unit][1] / SI[unit],
            "sigma": sigma,
            "unit": unit,
        }
        for row in rows
    ]
    return identified_table("component_errors", error_rows, "pose", ("missed_before",))


def _errors(diagnosis: CauseDiagnosis, channels: Channels, unit: str) -> pa.Table:
    """Rows of axis_errors.parquet: every reading without and with the findings."""
    floor = np.sqrt(diagnosis.final.floor.square) / channels.si
    rows: list[TableRow] = []
    for role, before, after in errors_by_role(diagnosis):
        assert isinstance(before.model, AxisModel)
        names, axis_rows = before.model.channel_names, before.model.rows
        rows += [
            {
                "pose": axis_rows.poses[b],
                "role": role,
                "encoder": names[k],
                "command": float(axis_rows.command[b] / SI[unit]),
                "command_unit": unit,
                "approach": int(axis_rows.direction[b]),
                "missed_before": float(before.gap[b, k, 0] / channels.si[k]),
                "missed_after": float(after.gap[b, k, 0] / channels.si[k]),
                "unit": channels.units[k],
                "noise_floor": float(floor[k]),
            }
            for b, k in np.argwhere(before.is_observed & after.is_observed)
        ]
    return identified_table("axis_errors", rows, "pose")
