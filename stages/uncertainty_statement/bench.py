"""Uncertainty of compliance, G_B, loads from one reading, and errors in held-out load cases."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa

from truing.arrays import Array
from truing.estimation.interferometry.compliance import budget_of_entries, compliance_budgets
from truing.estimation.interferometry.recorded_steps import CHANNELS, LOADS
from truing.estimation.sensor.budget import (
    Calibrated,
    budget_of_loads,
    budget_of_matrix,
    recalibrated,
    rms_of_held_out,
)
from truing.estimation.uncertainty_budget import NOT_HELD, Budget, Source
from truing.stages.common.loaded_steps import loaded_steps
from truing.stages.common.nominal_sensor import simulated_compliance
from truing.stages.common.recorded_signals import ranges_of, recorded, recorded_with_other_loads
from truing.stages.uncertainty_statement.causes import found_causes
from truing.stages.uncertainty_statement.statement import Statement

if TYPE_CHECKING:
    from truing.schemas.campaign import Campaign

CORRECTED = Source("correction for air and material", "B")
CELLS = Source("sensitivity of the single-axis cells, as declared", "B")
_MODEL = "matrix"
_CLOSES = 1e-6
_LOAD_UNITS = ("N", "N", "N", "N m", "N m", "N m")


def state_compliance(statement: Statement, tables: Mapping[str, pa.Table], settings: Campaign) -> None:
    """State each entry that the readings determine, by the matrix model."""
    table = tables.get("compliance")
    if table is None or not table.num_rows:
        if settings.campaign.kind == "interferometer" and "positions" not in tables:
            statement.not_evaluated("compliance", "all", "no readings of displacement under load")
        return
    rows = [row for row in table.to_pylist() if row["model"] == _MODEL and row["sigma"]]
    if not rows:
        statement.not_evaluated("compliance", "all", "the loads do not determine it")
        return
    loaded = loaded_steps(tables, settings.noise, simulated_compliance(settings, tables.get("given_compliance")))
    declared = settings.noise.linear_um is not None and settings.noise.angular_arcsec is not None
    try:
        budgets = compliance_budgets(loaded, declared)
    except np.linalg.LinAlgError:  # one of the components is not determined by its own readings
        budgets = None
    indices = [(CHANNELS.index(row["response"]), LOADS.index(row["load"])) for row in rows]
    sigma = np.array([row["sigma"] for row in rows], float)
    budget = None if budgets is None else budget_of_entries(budgets, loaded, indices)
    if budget is None or not np.allclose(budget.standard, sigma, rtol=_CLOSES):
        budget = Budget((Source("fit as a whole: readings, loads and geometry", "A"),), sigma[None])
    estimate = np.array([row["coefficient"] for row in rows], float)
    budget = budget.with_source(CORRECTED, np.abs(estimate) * _corrected(tables)[[i for i, _ in indices]])
    names, units = [f"{row['response']} per {row['load']}" for row in rows], [row["unit"] for row in rows]
    statement.state("compliance", "recorded loads", names, estimate, units, budget.filled())
    _omit(statement, tables, settings)


def _corrected(tables: Mapping[str, pa.Table]) -> Array:
    """Return the remaining uncertainty of corrections per component (6,), relative to its largest reading."""
    share = np.zeros(len(CHANNELS))
    if "reading_corrections" not in tables:
        return share
    readings = tables["readings"]
    channel = np.array(readings.column("channel").to_pylist(), object)
    value = np.abs(np.asarray(readings.column("reading").to_pylist(), float))
    for row in tables["reading_corrections"].to_pylist():
        if row["subject"] in CHANNELS and row["sigma"] is not None and (channel == row["subject"]).any():
            k = CHANNELS.index(row["subject"])
            share[k] = np.hypot(share[k], row["sigma"] / max(value[channel == row["subject"]].max(), 1e-30))
    return share


def _omit(statement: Statement, tables: Mapping[str, pa.Table], settings: Campaign) -> None:
    noise = settings.noise
    if not noise.load_n and not noise.load_nm:
        statement.omitted("compliance", "applied loads", "[noise] declares neither load_n nor load_nm")
    if "reading_corrections" not in tables or not tables["reading_corrections"].num_rows:
        why = "the readings are corrected already, and [interferometer] declares no uncertainty of the corrections"
        statement.omitted("compliance", "wavelength, air and material", why)
    for name in found_causes(tables):
        statement.omitted("compliance", name, NOT_HELD)


def state_sensor(statement: Statement, tables: Mapping[str, pa.Table], settings: Campaign) -> None:
    """State the entries of G_B, the loads from one reading at full range, and errors of held-out loads."""
    name = _chosen_model(tables)
    if name is None:
        if settings.campaign.kind == "interferometer" and "positions" not in tables:
            statement.not_evaluated("G_B", "all", "no signals were calibrated")
        return
    try:
        made = recalibrated(recorded(tables, settings), name, settings.noise.signal_mv is not None)
    except (ValueError, np.linalg.LinAlgError) as why:
        statement.not_evaluated("G_B", "all", f"the calibration cannot be made once more: {why}")
        return
    _state_matrix(statement, made)
    _state_leg_matrix(statement, made, settings)
    _state_loads(statement, made, ranges_of(settings, made.found))
    _state_held_out(statement, made)
    if not made.found.load_sigma.any():
        for result in ("G_B", "load"):
            statement.omitted(result, "applied loads", "[noise] declares neither load_n nor load_nm")
    if made.found.covariate_names == ():
        statement.omitted("G_B", "temperature of the sensor", "it was not recorded, or did not change")
    for name in found_causes(tables):
        if " signal " in f"{name} ":
            for result in ("G_B", "load"):
                statement.omitted(result, name, NOT_HELD)
    acting = None if made.found.causes else recorded_with_other_loads(tables, settings)
    for cause in () if acting is None else acting.causes:
        for result in ("G_B", "load", "accuracy"):
            statement.omitted(result, cause, NOT_HELD)
    for cause in made.found.causes:
        statement.omitted("G_B", f"size of {cause}", "loads are taken as the diagnosis has them, its size as exact")


def _chosen_model(tables: Mapping[str, pa.Table]) -> str | None:
    table = tables.get("sensor_matrix")
    rows = [] if table is None else table.to_pylist()
    return next((row["model"] for row in rows if row["chosen"] and row["matrix"] == "G_B"), None)


def _state_matrix(statement: Statement, made: Calibrated) -> None:
    matrix, budget = budget_of_matrix(made)
    rows, columns = (index.ravel() for index in np.indices(matrix.shape))
    names = [f"{made.table.load_names[i]} per {made.table.signal_names[j]}" for i, j in zip(rows, columns, strict=True)]
    statement.state("G_B", made.fit.model.name, names, matrix.ravel(), [f"{_LOAD_UNITS[i]}/mV" for i in rows], budget)


def _state_leg_matrix(statement: Statement, made: Calibrated, settings: Campaign) -> None:
    """State the entries of G_B', from forces of the cells to the wrench, where their sensitivity is declared."""
    sensitivity, tolerance = settings.signals.sensitivity_mv_per_n, settings.signals.sensitivity_tolerance
    if sensitivity is None:
        return
    matrix, budget = budget_of_matrix(made)
    factor = np.broadcast_to(np.asarray(sensitivity, float), matrix.shape)
    entries = (matrix * factor).ravel()
    budget = budget.scaled(factor.ravel())
    if tolerance:
        budget = budget.with_source(CELLS, tolerance * np.abs(entries))
    else:
        statement.omitted("G_B'", CELLS.name, "[signals] declares no sensitivity_tolerance")
    rows, columns = (index.ravel() for index in np.indices(matrix.shape))
    names = [f"{made.table.load_names[i]} per force of cell {j + 1}" for i, j in zip(rows, columns, strict=True)]
    units = ["1" if i < 3 else "m" for i in rows]
    statement.state("G_B'", made.fit.model.name, names, entries, units, budget)


def _state_loads(statement: Statement, made: Calibrated, ranges: Array) -> None:
    """State each load at its full range, determined from one reading of the signals."""
    axes = np.flatnonzero(np.isfinite(ranges))
    value, budget = budget_of_loads(made, np.diag(ranges)[axes], axes)
    names, units = [made.table.load_names[k] for k in axes], [_LOAD_UNITS[k] for k in axes]
    subject = [f"one reading at {ranges[k]:g} {_LOAD_UNITS[k]} of {made.table.load_names[k]}" for k in axes]
    statement.state("load", subject, names, value, units, budget)


def _state_held_out(statement: Statement, made: Calibrated) -> None:
    """State the rms error of loads whose case was not used in the calibration."""
    held_out_error = rms_of_held_out(made)
    if held_out_error is None:
        statement.not_evaluated("accuracy", "all", "there is one load case alone, and none to hold out")
        return
    names = [f"{name}, rms" for name in made.table.load_names]
    statement.state("accuracy", "held-out load cases", names, held_out_error[0], list(_LOAD_UNITS), held_out_error[1])
