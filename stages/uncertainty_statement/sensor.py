"""The matrix of a force sensor, loads told by it, and its held-out accuracy."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from truing.estimation.sensor.budget import Calibrated, coefficient_parts, matrix_parts
from truing.estimation.sensor.calibrate import fit_calibration
from truing.estimation.sensor.calibration_matrix import calibration_matrix, wrenches
from truing.estimation.sensor.contenders import by_cases, contenders
from truing.estimation.sensor.held_out_loads import covariance_by_case, hold_out
from truing.estimation.uncertainty_budget import NOT_HELD, Budget, Source, budget
from truing.stages.common.recorded_signals import ranges_of, recorded
from truing.stages.uncertainty_statement.found_causes import found_causes
from truing.stages.uncertainty_statement.statement import Statement

if TYPE_CHECKING:
    import pyarrow as pa

    from truing.schemas.campaign import Campaign

Array = NDArray[np.float64]

_UNITS = ("N", "N", "N", "N m", "N m", "N m")


def state_sensor(statement: Statement, tables: Mapping[str, pa.Table], settings: Campaign) -> None:
    """State the entries of G_B, the loads that one reading at full range tells, and errors of held-out loads."""
    name = _chosen(tables)
    if name is None:
        if settings.campaign.kind == "interferometer" and "positions" not in tables:
            statement.not_evaluated("G_B", "all", "no signals were calibrated")
        return
    try:
        made = _calibrated(tables, settings, name)
    except (ValueError, np.linalg.LinAlgError) as why:
        statement.not_evaluated("G_B", "all", f"the calibration cannot be made once more: {why}")
        return
    _matrix(statement, made)
    _loads(statement, made, ranges_of(settings, made.found))
    _held_out(statement, made)
    if not made.found.load_sigma.any():
        for result in ("G_B", "load"):
            statement.omitted(result, "applied loads", "[noise] declares neither load_n nor load_nm")
    if made.found.covariate_names == ():
        statement.omitted("G_B", "temperature of the sensor", "it was not recorded, or did not change")
    for name in found_causes(tables):
        if " signal " in f"{name} ":
            for result in ("G_B", "load"):
                statement.omitted(result, name, NOT_HELD)
    for cause in made.found.causes:
        statement.omitted("G_B", f"size of {cause}", "loads are taken as the diagnosis has them, its size as exact")


def _chosen(tables: Mapping[str, pa.Table]) -> str | None:
    table = tables.get("sensor_matrix")
    rows = [] if table is None else table.to_pylist()
    return next((row["model"] for row in rows if row["chosen"] and row["matrix"] == "G_B"), None)


def _calibrated(tables: Mapping[str, pa.Table], settings: Campaign, name: str) -> Calibrated:
    found = recorded(tables, settings)
    model = next(model for model in contenders(found) if model.name == name)
    table, _ = by_cases(found, ~found.steps.held_out)
    fit = fit_calibration(table, model)
    spare = float(max(len(table.signals) - fit.matrix.shape[1], 1))
    declared = settings.noise.signal_mv is not None
    signals = Source("noise of the signals", "B") if declared else Source("noise of the signals", "A", spare)
    parts = coefficient_parts(fit, table, signals)
    return Calibrated(found, table, fit, parts, covariance_by_case(table, model), signals)


def _matrix(statement: Statement, made: Calibrated) -> None:
    matrix = calibration_matrix(made.fit, made.table.signal_cov)
    told = budget(matrix_parts(made))
    more = made.beyond_chance(np.diag(made.by_case.covariance), told.standard**2)
    rows, columns = (index.ravel() for index in np.indices(matrix.value.shape))
    names = [f"{made.table.load_names[i]} per {made.table.signal_names[j]}" for i, j in zip(rows, columns, strict=True)]
    units = [f"{_UNITS[i]}/mV" for i in rows]
    told = told.beside(made.cases, more).filled()
    statement.state("G_B", made.fit.model.name, names, matrix.value.ravel(), units, told)


def _loads(statement: Statement, made: Calibrated, ranges: Array) -> None:
    """State each load at its full range, as one reading of the signals tells it."""
    fit, table = made.fit, made.table
    axes = np.flatnonzero(np.isfinite(ranges))
    loads = np.diag(ranges)[axes]
    none = np.zeros((len(axes), table.covariates.shape[1]))
    if fit.model.direction == "forward":
        signals = fit.predict(loads, none)
    else:
        signals = loads @ np.linalg.pinv(fit.matrix[:, : len(fit.terms.inputs)]).T
    noise = np.zeros((signals.shape[1],) * 2) if table.signal_cov is None else table.signal_cov
    found = wrenches(fit, signals, none, noise)
    own = np.arange(len(axes)), axes, axes
    reading = Source("noise of the signals, in the one reading", made.signals.evaluation, made.signals.dof)
    parts = {reading: found.own[own]}
    for source, part in made.parts.items():
        by_part = replace(found, own=np.zeros_like(found.own), coefficients=part).covariance
        parts[Source(f"calibration: {source.name}", source.evaluation, source.dof)] = by_part[own]
    told = Budget(tuple(parts), np.sqrt(np.maximum(np.array(list(parts.values())), 0.0)))
    width = made.by_case.value.shape[1]
    blocks = made.by_case.covariance.reshape(-1, width, len(table.load_names), width)
    by_case = np.einsum("nc,ncd,nd->n", signals, blocks[axes, :, axes], signals)
    calibration = told.standard**2 - parts[reading]
    told = told.beside(made.cases, made.beyond_chance(by_case, calibration)).filled()
    names = [table.load_names[k] for k in axes]
    subject = [f"one reading at {ranges[k]:g} {_UNITS[k]} of {table.load_names[k]}" for k in axes]
    statement.state("load", subject, names, found.value[np.arange(len(axes)), axes], [_UNITS[k] for k in axes], told)


def _held_out(statement: Statement, made: Calibrated) -> None:
    """State the rms error of loads whose case the calibration has not seen."""
    errors, cases = hold_out(made.table, made.fit.model).errors, made.table.cases
    if len(cases) < 2:
        statement.not_evaluated("accuracy", "all", "there is one load case alone, and none to hold out")
        return
    share = np.stack([np.sum(errors[made.table.case == case] ** 2, 0) for case in cases]) * len(cases) / len(errors)
    value = np.sqrt(share.mean(0))
    own = np.std(share, axis=0, ddof=1) / np.sqrt(len(cases)) / (2.0 * np.where(value > 0.0, value, 1.0))
    source = Source("scatter from load case to load case", "A", float(len(cases) - 1))
    names = [f"{name}, rms" for name in made.table.load_names]
    statement.state("accuracy", "held-out load cases", names, value, list(_UNITS), Budget((source,), own[None]))
