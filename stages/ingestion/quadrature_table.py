"""Raw quadrature signals of interferometers: ellipse, phase and fringes of every channel, and the lengths they tell."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from truing.estimation.interferometry.fringes import count_fringes, length_from_phase
from truing.estimation.interferometry.log_quality import saturated
from truing.estimation.interferometry.quadrature import (
    EllipseFit,
    corrected_phase,
    fit_ellipse,
    phase_sigma,
    residual_radius,
    uncorrected_error,
)
from truing.formats.faultlog import FaultLog
from truing.formats.gather import Gathered
from truing.schemas.artifacts import ARTIFACTS
from truing.schemas.column import SIGMA_BOUNDS
from truing.schemas.faults import Fault
from truing.stages.ingestion.gathered_columns import numbered, numbers, texts
from truing.stages.ingestion.load_steps import times_from_order
from truing.stages.ingestion.step_samples import averaged

if TYPE_CHECKING:
    import pyarrow as pa

Array = NDArray[np.float64]

LINEAR = ("dx", "dy", "dz")
_UM = 1e6  # per m
_TURN = np.linspace(0.0, 2.0 * np.pi, 360, endpoint=False)
_SIGNALS = (("signal_x", "signal_y"), ("phase_deg", "radius"))


@dataclass(frozen=True)
class Lengths:
    """Signals that became readings: one row per run, step and channel with a column ``reading``, and a table of what
    became of every channel's ellipse."""

    readings: Gathered
    channels: pa.Table


def lengths(found: Gathered, settings: Any, log: FaultLog) -> Lengths | None:
    """Vacuum lengths since the first step of each run, um; several samples of a step are averaged, as are
    their loads and times.

    The ellipse of a channel is that of its electronics, one for all runs, from samples that no end of the converter's
    range cuts; fringes are counted from sample to sample of a run. None where something is wrong, which is noted.
    """
    signals = _signals(found, settings.signal_step, log)
    channel = texts(found, "channel")
    found.fault(log, ~np.isin(channel, LINEAR), "channel", f"one of {', '.join(LINEAR)}: an angle takes two of them")
    if log:
        return None
    run, step = numbered(found, "run"), numbers(found, "step")
    order = np.lexsort((np.arange(len(run)), step, run))  # samples of a step are in the order of their rows
    value, sigma = np.full((2, len(run)), np.nan)
    rows = []
    source = "column" if "sigma" in found.table.column_names else "ellipse"
    for name in dict.fromkeys(channel):
        own = order[channel[order] == name]
        told = _followed(signals[own], run[own], settings)
        value[own], sigma[own] = told.length, told.sigma
        rows.append({"channel": name, **told.facts, "sigma_source": source})
        if not told.fit.ok[0]:
            expected = f"signals of {name} that go round their ellipse: {told.fit.status[0]}"
            log.add(Fault(found.first_file, expected, column="signal_x"))
    if log:
        return None
    import pyarrow as pa

    table = pa.Table.from_pylist(rows, schema=ARTIFACTS["quadrature"].arrow_schema(present=("sigma_source",)))
    readings = _by_step(found, value, sigma, log)
    return None if log else Lengths(readings, table)


def _signals(found: Gathered, step: float | None, log: FaultLog) -> Array:
    """Signals (N, 2), given as such or as phase and radius; whole steps of a converter where its step is known."""
    given = next((names for names in _SIGNALS if all(name in found.table.column_names for name in names)), None)
    if given is None:
        log.add(Fault(found.first_file, "columns signal_x and signal_y, or phase_deg and radius"))
        return np.full((len(found.table), 2), np.nan)
    first, second = (numbers(found, name) for name in given)
    if given == _SIGNALS[1]:
        p = np.radians(first)
        first, second = second * np.cos(p), second * np.sin(p)
    signals = np.stack([first, second], -1)
    return signals if step is None else np.round(signals / step) * step


@dataclass(frozen=True)
class _Followed:
    """One channel: its ellipse, lengths (N,) in um since the first sample of each run and their sigma, and facts."""

    fit: EllipseFit
    length: Array
    sigma: Array
    facts: dict[str, Any]


def _followed(signals: Array, run: NDArray[np.int64], settings: Any) -> _Followed:
    """Samples (N, 2) in the order in which they were taken, of runs (N,)."""
    cut = np.zeros(len(signals), dtype=bool)
    for side in (0, 1):
        cut[saturated(signals[:, side]).where] = True
    there = np.asarray(np.isfinite(signals).all(-1))
    kept = there & ~cut
    whole, fit = fit_ellipse(signals), fit_ellipse(signals, kept[None])
    phase = corrected_phase(signals[None], fit.values)
    sigma = phase_sigma(fit, phase)[0]
    wavelength = 1e-9 * settings.wavelength_nm
    length, risk = np.full(len(signals), np.nan), 0.0
    for one in np.unique(run):
        own = run == one
        count = count_fringes(phase[0, own], sigma[own])
        followed = length_from_phase(count.phase, wavelength, passes=settings.passes)
        length[own] = _UM * (followed - followed[0])
        risk = max(risk, float(np.nan_to_num(count.risk).max()))
    per_rad = wavelength / settings.passes / (2.0 * np.pi)
    facts = {
        "samples": len(signals),
        **dict(zip(("x0", "y0", "amplitude_x", "amplitude_y", "lag_rad"), fit.values[0].tolist(), strict=True)),
        "radius_before": float(np.nanstd(np.linalg.norm(signals, axis=-1))),
        "radius_after": float(residual_radius(signals[None], whole.values, there[None])[0]),
        "radius_uncut": float(residual_radius(signals[None], fit.values, kept[None])[0]),
        "radius_mean": float(np.nanmean(np.linalg.norm(signals, axis=-1))),
        "cut_share": float(cut.mean()),
        "periodic_error_um": _UM * per_rad * float(np.abs(uncorrected_error(fit.values, _TURN)).max()),
        "miscount_risk": risk,
        "status": str(fit.status[0]),
    }
    return _Followed(fit, length, _UM * per_rad * sigma, facts)


def _by_step(found: Gathered, value: Array, sigma: Array, log: FaultLog) -> Gathered:
    """One row per run, step and channel, with the mean of its samples as reading, and the sigma of one of them.

    Samples in transit were needed to count fringes; they enter no mean. Readings are since the first step that has one.
    """
    import pyarrow as pa

    table = found.table.append_column("reading", pa.array(value))
    if "sigma" not in table.column_names:
        table = table.append_column("sigma", pa.array(np.maximum(sigma, SIGMA_BOUNDS["um"][0])))
    made = averaged(replace(found, table=table), log)
    reading = numbers(made, "reading")
    place = made.table.column_names.index("reading")
    table = made.table.set_column(place, "reading", pa.array(reading - reading[_first_of_run(made)]))
    made = replace(made, table=table)
    if "time_s" in table.column_names:
        return made
    _, once, at = np.unique(numbered(made, "run", "step"), return_index=True, return_inverse=True)
    run, step = numbered(made, "run")[once], numbers(made, "step")[once]
    time = times_from_order(run, step, np.full(len(once), np.nan))[at]
    return replace(made, table=table.append_column("time_s", pa.array(time)))


def _first_of_run(found: Gathered) -> NDArray[np.int64]:
    """(N,) the row of the first step with a reading of each row's run and channel."""
    pair = numbered(found, "run", "channel")
    order = np.lexsort((numbers(found, "step"), ~np.isfinite(numbers(found, "reading")), pair))
    _, start = np.unique(pair[order], return_index=True)
    return np.asarray(order[start][pair])
