"""Section of the measured data of a bench: runs, load steps, channels, surroundings and corrections."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from truing.belonging.counted_times import merely_counts
from truing.report.column_heads import CHANNEL, FROM, LOAD, ROLE, RUN, TO, Head
from truing.report.figure_style import BLUE, GREEN, GREY, ORANGE, label, style
from truing.report.numbers import count_text, duration, in_one_unit, plain, quantity
from truing.report.page import Listing, ReportSection
from truing.report.tables import (
    LOAD_UNITS,
    LOADS,
    STEP_KEYS,
    Tables,
    axes_of,
    cell,
    in_channel_order,
    is_unloading,
    load_steps,
    signal_names,
    table_or_none,
)

_OPEN = 12
_SURROUNDINGS = {
    "air_temperature_c": ("temperature of the air", "°C"),
    "air_pressure_hpa": ("pressure of the air", "hPa"),
    "relative_humidity_pct": ("relative humidity", "%"),
    "material_temperature_c": ("temperature of the material", "°C"),
}
_RAW = ("phase_deg", "radius", "signal_x", "signal_y")  # raw signals of an interferometer
_NO_SURROUNDINGS = {*STEP_KEYS, "time_s", *LOADS.values(), "reading", "sigma", *_RAW}
_COLOURS = {"x": BLUE, "y": ORANGE, "z": GREEN}

_WHAT = {"air": "refractive index of the air", "material": "temperature of the material"}


def measured_loads(tables: Tables) -> ReportSection:
    """Return the section on runs, steps, loads, channels and surroundings of a bench."""
    steps = load_steps(tables)
    if not len(steps):
        if (approaches := table_or_none(tables, "positions")) is not None:
            runs = count_text(approaches["run"].nunique(), "run")
            targets = count_text(approaches["target_mm"].nunique(), "target")
            text = f"{count_text(len(approaches), 'approach')} of an axis to {targets}, in {runs}: see Positioning."
            return ReportSection("measured", "Measured", text)
        why = "The campaign has neither object points nor load steps."
        return ReportSection("measured", "Measured", why, state="empty")
    read, axes = _read(tables), axes_of(steps)
    figures: list[tuple[object, str]] = []
    if axes:
        figures.append((_loads_in_time(steps), "Gaps are pauses between runs."))
    if axes and len(read):
        words = "An empty cell is an entry of the compliance that the campaign does not measure."
        figures.append((_readings_by_load(steps, read), words))
    listings = (
        _loads(steps, axes),
        _channels(tables, read),
        corrections(tables),
        _surroundings(tables),
        _runs(steps, read, tables),
    )
    shown = tuple(listing for listing in listings if listing.rows)
    return ReportSection("measured", "Measured", _opening_sentences(steps, read, tables), tuple(figures), shown)


def _read(tables: Tables) -> pd.DataFrame:
    """Return run, step and channel of every reading of the interferometer."""
    readings = table_or_none(tables, "readings")
    columns = ["run", "step", "channel"]
    return pd.DataFrame(columns=columns) if readings is None else readings[columns]


def _opening_sentences(steps: pd.DataFrame, read: pd.DataFrame, tables: Tables) -> str:
    runs = steps["run"].nunique()
    text = f"{count_text(len(steps), 'load step')} in {count_text(runs, 'run')}"
    text += f"{duration_words(steps)}, {_at_once(steps)}. "
    signals = signal_names(tables)
    recorded_signals = f"{count_text(len(signals), 'signal')} ({signals[0]} to {signals[-1]})" if signals else ""
    if not len(read):
        return f"{text}Recorded: {recorded_signals or 'no channels'}; the motion of the platform was not measured."
    per_run = read.groupby("run")["channel"].nunique()
    channels = in_channel_order(read["channel"].unique())
    how = "one in each run" if (per_run == 1).all() else "all in every run" if (per_run == len(channels)).all() else ""
    and_signals = f" and {recorded_signals}" if recorded_signals else ""
    text += f"Recorded: {', '.join(channels)}{f' ({how})' if how else ''}{and_signals}."
    roles = steps.groupby("run")["role"].first().value_counts()
    return text + (f" Held out: {count_text(int(roles['verification']), 'run')}." if "verification" in roles else "")


def duration_words(steps: pd.DataFrame) -> str:
    """Return the duration of load steps in words; empty where the clocks of runs differ."""
    if len(steps) and _is_counted(steps):
        return ", in a known order without times"
    spans = steps.dropna(subset="time_s").groupby("run")["time_s"].agg(["min", "max"]).sort_values("min")
    starts, ends = spans["min"].to_numpy(dtype=float), spans["max"].to_numpy(dtype=float)
    known = len(starts) and ends.max() > starts[0] and not np.any(starts[1:] < ends[:-1])  # each run from zero again
    return f" over {duration(float(ends.max() - starts[0]))}" if known else ""


def _is_counted(steps: pd.DataFrame) -> bool:
    """Return True if times merely count the steps of every run."""
    run = steps.groupby("run", sort=False).ngroup()
    ordered = steps.assign(of_run=run).sort_values(["of_run", "time_s"], kind="stable")
    return merely_counts(*(ordered[name].to_numpy() for name in ("time_s", "step", "of_run")))


def _at_once(steps: pd.DataFrame) -> str:
    several = int((steps[axes_of(steps)] != 0.0).sum(axis=1).max()) if axes_of(steps) else 0
    return (
        "without a load"
        if not several
        else "one load at a time"
        if several == 1
        else f"up to {several} loads at a time"
    )


def _loads_in_time(steps: pd.DataFrame) -> go.Figure:
    """Return loads over time, forces above torques, a line per run and axis."""
    kinds = [kind for kind in "fm" if any(axis[0] == kind for axis in axes_of(steps))]
    figure = make_subplots(len(kinds), 1, shared_xaxes=True, vertical_spacing=0.08)
    known = steps["time_s"].notna().all() and np.ptp(steps["time_s"]) > 0.0 and not _is_counted(steps)
    when = (steps["time_s"] - steps["time_s"].min()) / 3600.0 if known else steps.index.to_series()
    hint = steps.assign(when=when).sort_values("when", kind="stable")
    for row, kind in enumerate(kinds, 1):
        for axis in (a for a in axes_of(steps) if a[0] == kind):
            rows = hint[hint[axis].ne(0.0).groupby(hint["run"]).transform("any")]
            x, y, words = _broken_line(rows, axis)
            line = {"color": _COLOURS[axis[1]], "width": 1}
            trace = go.Scatter(
                x=x,
                y=y,
                mode="lines+markers",
                line=line,
                marker={"size": 4},
                name=axis,
                text=words,
                hovertemplate="%{text}: %{y} " + LOAD_UNITS[axis] + "<extra></extra>",
            )
            figure.add_trace(trace, row, 1)
        figure.update_yaxes(title_text=f"{'force (N)' if kind == 'f' else 'torque (N·m)'}", row=row, col=1)
    style(figure, "Applied loads", "Loads in the order of measurement, along each axis", 150 + 190 * len(kinds))
    figure.update_xaxes(title_text="time since the first step (h)" if known else "load step", row=len(kinds), col=1)
    figure.update_yaxes(zeroline=True, zerolinecolor=GREY)
    figure.update_layout(legend={"orientation": "h", "y": 1.0, "yanchor": "bottom", "x": 0.0}, margin={"t": 104})
    return figure


def _broken_line(table: pd.DataFrame, axis: str) -> tuple[list[float], list[float], list[str]]:
    """Return points of a line with a break after each run, and their words."""
    x: list[float] = []
    y: list[float] = []
    words: list[str] = []
    for run, part in table.groupby("run", sort=False):
        x += [*part["when"].astype(float), np.nan]
        y += [*part[axis].astype(float), np.nan]
        words += [*(f"run {label(run)}, step {step}" for step in part["step"]), ""]
    return x, y, words


def _readings_by_load(steps: pd.DataFrame, read: pd.DataFrame) -> go.Figure:
    """Return the number of readings of each channel under each load."""
    merged = read.merge(steps, on=["run", "step"], how="left")
    channels, axes = in_channel_order(merged["channel"].unique()), axes_of(steps)
    number = np.array([[int(merged.loc[merged["channel"] == c, a].ne(0.0).sum()) for a in axes] for c in channels])
    figure = go.Figure(
        go.Heatmap(
            z=np.where(number > 0, number, np.nan),
            x=axes,
            y=channels,
            zmin=0,
            colorscale=((0.0, "#FFFFFF"), (1.0, "#9CC4E0")),
            showscale=False,
            text=np.where(number > 0, number.astype(str), ""),
            texttemplate="%{text}",
            xgap=2,
            ygap=2,
            hovertemplate="%{y} under %{x}: %{text} readings<extra></extra>",
        )
    )
    style(figure, "Channels read under each load", "Readings of each channel under load", 150 + 30 * len(channels))
    figure.update_xaxes(title_text="load", showgrid=False)
    figure.update_yaxes(autorange="reversed", showgrid=False)
    return figure


def _loads(steps: pd.DataFrame, axes: list[str]) -> Listing:
    rows = tuple(_load_row(steps, axis) for axis in axes)
    heads = (
        LOAD,
        Head("runs", "Number of runs with this load."),
        Head("steps", "Number of load steps with this load."),
        Head("levels", "Number of different sizes of the load."),
        FROM,
        TO,
        Head("direction", "Whether the load only rises or also falls, and whether both signs were applied."),
    )
    return Listing(heads, rows, caption="Loads, axis by axis")


def _load_row(steps: pd.DataFrame, axis: str) -> tuple[str, ...]:
    rows = steps[steps[axis] != 0.0]
    unit = LOAD_UNITS[axis]
    back = int((is_unloading(steps, axis) & steps[axis].ne(0.0)).sum())
    both = rows[axis].min() < 0.0 < rows[axis].max()
    coverage = ["up and down" if back else "up only", "both signs" if both else "one sign"]
    levels = rows[axis].nunique()
    low, high = (f"{value:,.6g} {unit}" for value in (steps[axis].min(), steps[axis].max()))
    return (axis, str(rows["run"].nunique()), f"{len(rows):,}", str(levels), low, high, ", ".join(coverage))


def _channels(tables: Tables, read: pd.DataFrame) -> Listing:
    """Return range and noise of a single reading of each channel."""
    rows = []
    readings, signal_noise = table_or_none(tables, "readings"), _signal_noise(tables)
    estimated = _by_ellipse(tables)
    if readings is not None:
        for channel in in_channel_order(read["channel"].unique()):
            part = readings[readings["channel"] == channel]
            unit = str(part["unit"].iloc[0])
            span = (quantity(part["reading"].min(), unit), quantity(part["reading"].max(), unit))
            noise = _noise(part["sigma"], unit, estimated=channel in estimated)
            rows.append((channel, str(part["run"].nunique()), f"{len(part):,}", *span, noise))
    signals = table_or_none(tables, "signals")
    for name in signal_names(tables):
        part = signals[["run", f"{name}_mv"]].dropna() if signals is not None else None
        if part is not None and len(part):
            low, high = (plain(value) for value in (part[f"{name}_mv"].min(), part[f"{name}_mv"].max()))
            rows.append((name, str(part["run"].nunique()), f"{len(part):,}", f"{low} mV", f"{high} mV", signal_noise))
    heads = (
        CHANNEL,
        Head("runs", "Number of runs in which the channel was read."),
        Head("readings", "Number of readings of the channel."),
        FROM,
        TO,
        Head("noise of a reading", "Standard deviation of one reading, as declared or estimated from raw signals."),
    )
    return Listing(heads, tuple(rows), caption="Channels and signals")


def _noise(sigma: pd.Series, unit: str, *, estimated: bool) -> str:
    """Return the sigma of a channel's readings; ``estimated``: from the ellipse of the raw signals, not declared."""
    known = sigma.dropna()
    if not len(known):
        return "not declared"
    low, high = in_one_unit([float(known.min()), float(known.max())], unit)
    text = low if low == high else f"{low} to {high}"
    text += " (of a sample, by its ellipse)" if estimated else ""
    lacking = len(sigma) - len(known)
    return f"{text}; of {lacking:,} not declared" if lacking else text


def _by_ellipse(tables: Tables) -> set[str]:
    """Return the channels whose sigma comes from the residuals of raw signals about their ellipse."""
    raw = table_or_none(tables, "quadrature")
    if raw is None or "sigma_source" not in raw:
        return set()
    return set(raw.loc[raw["sigma_source"].eq("ellipse"), "channel"])


def _signal_noise(tables: Tables) -> str:
    """Return the sigma of the signals from [noise]; no table holds it, so a page made from tables alone lacks it."""
    declared = table_or_none(tables, "declared_noise")
    if declared is None:
        return "[noise] signal_mv"
    size = declared["signal_mv"].iloc[0]
    return "not declared" if size != size else f"{plain(float(size))} mV"


_NUMBER = Head("number", "Number of rows with a value.")


def _surroundings(tables: Tables) -> Listing:
    """Return the ranges of the surroundings and of further recorded columns."""
    table = table_or_none(tables, "readings")
    table = table_or_none(tables, "signals") if table is None else table
    rows = []
    columns = [] if table is None else [str(c) for c in table.columns if str(c) not in _NO_SURROUNDINGS]
    for column in columns:
        words, unit = _SURROUNDINGS.get(column, (column, ""))
        known = table[column].dropna() if table is not None and table[column].dtype.kind in "fi" else ()
        if len(known) and not column.endswith("_mv"):
            rows.append((words, f"{min(known):.6g} {unit}", f"{max(known):.6g} {unit}", f"{len(known):,}"))
    heads = (Head("surroundings", "Recorded quantity that is no load and no reading."), FROM, TO, _NUMBER)
    return Listing(heads, tuple(rows), caption="Environment and other records")


def _runs(steps: pd.DataFrame, read: pd.DataFrame, tables: Tables) -> Listing:
    """Return every run: its loads, readings and duration."""
    channels = read.groupby("run")["channel"].unique() if len(read) else {}
    timed = steps.assign(time_s=np.nan) if _is_counted(steps) else steps
    rows = tuple(_run_row(run, group, channels) for run, group in timed.groupby("run", sort=False))
    heads = (
        RUN,
        ROLE,
        Head("loads", "Load components that were applied in the run."),
        Head("channels", "Channels that were read in the run."),
        Head("steps", "Number of load steps."),
        Head("begins at", "Time of the first step, by the clock of the files."),
        Head("takes", "Time from the first to the last step."),
    )
    held_by = "observations.parquet" if "readings" in tables else "signals.parquet"
    return Listing(
        heads, rows, caption=f"All {count_text(len(rows), 'run')}", folded=len(rows) > _OPEN, held_by=held_by
    )


def _run_row(run: object, table: pd.DataFrame, channels: Mapping[object, Sequence[str]]) -> tuple[str, ...]:
    times = table["time_s"].dropna()
    begins, takes = ("–", "–") if not len(times) else (f"{times.min():,.0f} s", duration(float(np.ptp(times))))
    read = ", ".join(in_channel_order(channels[run])) if run in channels else "signals"
    return (
        str(run),
        cell(table["role"].iloc[0]),
        ", ".join(axes_of(table)) or "none",
        read,
        str(len(table)),
        begins,
        takes,
    )


def corrections(tables: Tables, *, of_axis: bool = False) -> Listing:
    """Return the size and uncertainty of each correction, by channel or for a positioned axis."""
    table = table_or_none(tables, "reading_corrections")
    reported = [] if table is None else [row for row in table.itertuples() if (row.subject == "axis") == of_axis]
    rows = tuple(
        (
            row.subject,
            _WHAT[row.correction],
            quantity(row.largest, row.unit) if cell(row.largest) else "corrected as it came",
            quantity(row.sigma, row.unit) if cell(row.sigma) else "not declared",
        )
        for row in reported
    )
    heads = (
        Head("reading", "Channel, or axis, whose readings are corrected."),
        Head("corrected for", "Effect that the correction removes: air or material."),
        Head("at most by", "Largest correction of a reading."),
        Head("known to (one sigma)", "Standard deviation of the correction."),
    )
    return Listing(heads, rows, caption="Corrections of readings", held_by="reading_corrections.parquet")
