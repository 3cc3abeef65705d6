"""Repeated runs of a bench: scatter of readings and signals, and lack of fit of the models."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa

from truing.estimation.interferometry.recorded_steps import (
    CHANNELS,
    READING_SI,
    READING_UNITS,
    RecordedSteps,
    repeated_runs,
)
from truing.estimation.repeatability import (
    Squares,
    known_mean,
    lack_of_fit,
    residuals_from_lines,
    within_groups,
    within_runs,
)
from truing.stages.common.manual_decisions import without_excluded
from truing.stages.common.point_arrays import number_column
from truing.stages.common.reading_arrays import load_steps
from truing.stages.common.repeats import SAME_LOADS
from truing.stages.common.rows import Rows
from truing.stages.repeats.tables import Repeated, Repeats

if TYPE_CHECKING:
    from truing.schemas.campaign import Campaign


def repeats_of_loads(tables: Mapping[str, pa.Table], settings: Campaign) -> tuple[Rows, ...]:
    """Return rows of ``repeats`` and ``lack_of_fit``; none if no run was repeated."""
    try:
        steps, _ = without_excluded(load_steps(tables), settings)
    except ValueError:
        return Rows("repeats"), Rows("lack_of_fit")
    groups = repeated_runs(steps)
    if not groups:
        return Rows("repeats"), Rows("lack_of_fit")
    repeats, names = Repeats(groups, SAME_LOADS, within_runs), steps.signals
    readings = Repeated("reading", CHANNELS, READING_UNITS)
    repeats.add(readings, steps.reading / READING_SI, np.sqrt(known_mean(steps.sigma**2)) / READING_SI)
    if names:
        signals, noise = Repeated("signal", names, ("mV",) * len(names)), settings.noise.signal_mv
        repeats.add(signals, 1e3 * steps.signal, np.full(len(names), np.nan if noise is None else noise))
        left, squares = residuals_from_lines(1e3 * steps.signal, steps.load, steps.run, ~steps.held_out)
        repeats.add_fit(signals, "linear in the loads", lack_of_fit(squares, within_runs(left, groups)))
    _add_diagnosis(repeats, tables, steps, readings)
    return repeats.repeats, repeats.fits


def _add_diagnosis(repeats: Repeats, tables: Mapping[str, pa.Table], steps: RecordedSteps, readings: Repeated) -> None:
    """Add the residuals of the readings from simulation and extended model, each run relative to its own zero."""
    errors = tables.get("reading_errors")
    if errors is None or not errors.num_rows:
        return
    index_of = {
        key: row for row, key in enumerate(zip([steps.runs[r] for r in steps.run], steps.step.tolist(), strict=True))
    }
    keys = zip(errors.column("run").to_pylist(), errors.column("step").to_pylist(), strict=True)
    row = np.array([index_of.get(key, -1) for key in keys])
    place_of = {name: n for n, name in enumerate(CHANNELS)}  # the linear model above has the signals
    channel = np.array([place_of.get(name, -1) for name in errors.column("channel").to_pylist()])
    is_repeat = (row >= 0) & (channel >= 0) & (np.asarray(errors.column("role").to_pylist(), object) != "verification")
    for model, column, spent in (
        ("simulation", "missed_before", 0.0),
        ("extended model", "missed_after", _numbers_found(tables.get("diagnosis"))),
    ):
        left = np.full_like(steps.reading, np.nan)
        left[row[is_repeat], channel[is_repeat]] = number_column(errors, column)[is_repeat]
        squares = within_groups(left, [np.flatnonzero(steps.run == number) for number in range(len(steps.runs))])
        freedom = squares.freedom - spent / max(len(set(errors.column("channel").to_pylist())), 1)
        repeated = within_runs(left, repeats.groups)
        repeats.add_fit(readings, model, lack_of_fit(Squares(squares.square, freedom), repeated))


def _numbers_found(diagnosis: pa.Table | None) -> float:
    """Return the number of estimated parameters of all found causes."""
    if diagnosis is None:
        return 0.0
    found_rows = [row for row in diagnosis.to_pylist() if row["verdict"] == "found"]
    return float(
        sum(value.get("sigma") is not None for row in found_rows for value in json.loads(row["parameters"]).values())
    )
