"""Requirements of machines that the diagnosis alone identifies: an open chain, a single axis."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa

from truing.calibration.accuracy import MODEL, UNCORRECTED
from truing.report.numbers import count_text
from truing.stages.calibration.model_rows import COMPONENTS, SI, requirement_rows
from truing.stages.common.missing_data import HELD_OUT
from truing.stages.common.point_arrays import number_column, positions
from truing.stages.declaration import Outcome

if TYPE_CHECKING:
    from truing.schemas.campaign import Campaign

_AXIS = "axis"


def with_component_requirements(
    outcome: Outcome, tables: Mapping[str, pa.Table], settings: Campaign, incomplete: str
) -> Outcome:
    """Return the outcome with requirements.parquet by the errors of the extended model, of a chain or an axis.

    The errors of an axis count also without correction.
    ``incomplete``: misfit of that model, so that it meets no requirement; else empty.
    """
    if settings.mechanism.type not in ("chain", _AXIS) or "diagnosis" not in tables:
        return outcome
    errors_table = tables.get("component_errors")
    rows = requirement_rows(settings.requirement, (MODEL, "none"), *_errors(errors_table), incomplete)
    if not rows.count:
        return outcome
    met = rows.columns["verdict"].count("meets")
    words = f"{outcome.figure}; {met} of {count_text(rows.count, 'requirement')} met after correction"
    made = [rows.table()]
    if errors_table is not None and "missed_before" in errors_table.column_names:
        uncorrected = _errors(errors_table, "missed_before")
        made.append(requirement_rows(settings.requirement, (UNCORRECTED, "none"), *uncorrected).table())
    return replace(outcome, artifacts={**outcome.artifacts, "requirements": pa.concat_tables(made)}, figure=words)


def _errors(table: pa.Table | None, column: str = "missed") -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Errors and variances (B, 6) by component, SI, NaN if not measured, and which poses were held out (B,).

    The error of an axis counts for every component: [requirement] states one.
    """
    if table is None or not table.num_rows:
        return np.full((1, 6), np.nan), np.zeros((1, 6)), np.zeros(1, bool)
    poses = tuple(dict.fromkeys(table.column("pose").to_pylist()))
    row, component = positions(table.column("pose"), poses), np.array(table.column("component").to_pylist())
    si = np.array([SI[unit] for unit in table.column("unit").to_pylist()])
    values = np.stack([number_column(table, column) * si, (number_column(table, "sigma") * si) ** 2])
    errors, held_out = np.full((2, len(poses), 6), np.nan), np.zeros(len(poses), bool)
    held_out[row[np.array(table.column("role").to_pylist()) == HELD_OUT]] = True
    for k, name in enumerate(COMPONENTS):
        concerned = (component == name) | (component == _AXIS)
        errors[:, row[concerned], k] = values[:, concerned]
    return errors[0], errors[1], held_out
