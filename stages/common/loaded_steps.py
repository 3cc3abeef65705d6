"""Accepted readings by load step, with the effect of the declared beam geometry."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa

from truing.arrays import Array
from truing.estimation.interferometry.compliance import AcceptedReadings, Loaded, fitted_compliance, geometry_spread
from truing.estimation.interferometry.recorded_steps import CHANNELS, READING_SI, RecordedSteps
from truing.estimation.response import (
    FALSE_ALARM,
    holm_significant,
)
from truing.simulation.bench.six_upur.nominal_sensor import SimulatedCompliance
from truing.stages.common.point_arrays import number_column
from truing.stages.common.reading_arrays import load_steps

if TYPE_CHECKING:
    from truing.schemas.sections import Noise


def accepted_readings(residuals: pa.Table, steps: RecordedSteps) -> AcceptedReadings:
    """Content of reading_residuals for the readings of load steps; readings without known geometry are excluded."""
    index_of = {key: row for row, key in enumerate(zip((steps.runs[r] for r in steps.run), steps.step, strict=True))}
    keys = zip(residuals.column("run").to_pylist(), residuals.column("step").to_pylist(), strict=True)
    row = np.array([index_of[key] for key in keys], dtype=np.int64)
    k = np.array([CHANNELS.index(name) for name in residuals.column("channel").to_pylist()], dtype=np.int64)
    values = np.zeros((3, *steps.reading.shape))
    values[0] = 1.0
    for n, name in enumerate(("sigma", "geometry", "geometry_sigma")):
        if name in residuals.column_names:
            values[n, row, k] = number_column(residuals, name) * READING_SI[k]
    is_known = np.isfinite(steps.reading) & np.isfinite(values[1])
    is_known[row, k] &= ~np.asarray(residuals.column("rejected").to_pylist(), dtype=bool)
    return AcceptedReadings(is_known, values[0], values[1], np.nan_to_num(values[2]))


def loaded_steps(tables: Mapping[str, pa.Table], noise: Noise, simulated: SimulatedCompliance | None) -> Loaded:
    """Readings without gross errors and without significant drifts of runs."""
    steps = load_steps({"readings": tables["readings"]})
    readings = accepted_readings(tables["reading_residuals"], steps)
    drift = _drifts(tables["run_terms"], steps)
    begin = np.array([steps.time_s[steps.run == r].min(initial=np.inf) for r in range(len(steps.runs))])
    moved = drift[steps.run] * (steps.time_s - begin[steps.run])[:, None]
    reading = np.where(readings.kept, steps.reading - moved - readings.added, np.nan)
    spread = geometry_spread(steps.load, readings.added_sigma)
    loaded = Loaded(steps, reading, readings.sigma**2, int(np.count_nonzero(drift)), spread)
    load_sigma = np.repeat([noise.load_n, noise.load_nm], 3)
    if not load_sigma.any():
        return loaded
    # an error of the load also moves the platform
    entries = fitted_compliance(loaded, "matrix").entries if simulated is None else simulated.entries
    by_loads = (np.nan_to_num(entries) ** 2) @ load_sigma**2
    return replace(loaded, variance=readings.sigma**2 + by_loads, by_loads=by_loads)


def _drifts(terms: pa.Table, steps: RecordedSteps) -> Array:
    """Significant drift (R, 6) of each run, per s; zero for the others."""
    drifts = np.zeros((len(steps.runs), 6))
    rows = [row for row in terms.to_pylist() if row["term"] == "drift"]
    real = holm_significant(np.array([row["p_value"] for row in rows]), FALSE_ALARM)
    for row, significant in zip(rows, real, strict=True):
        k = CHANNELS.index(row["channel"])
        drifts[steps.runs.index(row["run"]), k] = row["value"] * READING_SI[k] / 3600.0 if significant else 0.0
    return drifts
