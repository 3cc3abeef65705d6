"""Section of the measured data: bodies, targets, poses, time and temperature; or runs, loads, channels,
surroundings."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from truing.belonging.counted_times import merely_counts
from truing.report import poses_section as pose_figures
from truing.report.figure_style import BLUE, GREEN, GREY, ORANGE, label, style
from truing.report.heads import BODY, CHANNEL, LOAD, ROLE, RUN, TARGET, Head
from truing.report.numbers import count, duration, in_one_unit, plain, quantity
from truing.report.page import Listing, ReportSection
from truing.report.tables import (
    LOAD_UNITS,
    LOADS,
    SIGMA,
    STEP,
    XYZ,
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
_NO_SURROUNDINGS = {*STEP, "time_s", *LOADS.values(), "reading", "sigma", *_RAW}
_COLOURS = {"x": BLUE, "y": ORANGE, "z": GREEN}

_WHAT = {"air": "refractive index of the air", "material": "temperature of the material"}


def measured(tables: Tables) -> ReportSection | None:
    """Return the section on bodies and targets with their visibility, or on the loads of a bench; None for an axis."""
    if table_or_none(tables, "axis_errors") is not None:
        return None
    points = table_or_none(tables, "observations")
    if points is None and table_or_none(tables, "scans") is not None:
        return _measured_scans(tables)
    if points is None:
        poses = table_or_none(tables, "poses")
        given = None if poses is None else poses[poses["default"] & (poses["method"] == "measured")]
        return measured_loads(tables) if given is None or given.empty else _measured_poses(tables, given)
    survey, known = table_or_none(tables, "survey"), _known_targets(tables, points)
    listings = [_bodies(points, survey, known)]
    if table_or_none(tables, "configurations") is not None:
        listings.append(_ranges(tables["configurations"]))
    listings.append(_targets(points, survey, table_or_none(tables, "residuals")))
    picture = (pose_figures.visible_share(points, known), "A dark column is a pose in which few targets were measured.")
    if table_or_none(tables, "scans") is not None:
        listings.append(_scans(tables["scans"]))
    shown = tuple(listing for listing in listings if listing.rows)
    return ReportSection("measured", "Measured", _campaign_sentence(tables), (picture,), shown)


def _known_targets(tables: Tables, points: pd.DataFrame) -> pd.Series:
    """Return the number of targets by body, in the order of the points: all that were surveyed or ever seen."""
    names = points[["body", "target"]].drop_duplicates()
    survey = table_or_none(tables, "survey")
    if survey is not None:
        names = names.merge(survey[["body", "target"]], how="outer").drop_duplicates()
    return names.groupby("body")["target"].nunique().reindex(_in_order(points, names))


def _in_order(points: pd.DataFrame, names: pd.DataFrame) -> list[str]:
    return list(dict.fromkeys([*points["body"].drop_duplicates(), *names["body"]]))


def _bodies(points: pd.DataFrame, survey: pd.DataFrame | None, known: pd.Series) -> Listing:
    rows = []
    for body, number in known.items():
        part = points[points["body"] == body]
        survey_of_body = survey[survey["body"] == body] if survey is not None else None
        rows.append(
            (
                str(body),
                str(number),
                "–" if survey_of_body is None else str(len(survey_of_body)),
                "–" if survey_of_body is None else str(int(survey_of_body["leg"].notna().sum())),
                f"{part['pose'].nunique():,}",
                f"{len(part):,}",
                ", ".join(quantity(s, "mm") for s in part[SIGMA].median()),
            )
        )
    heads = (
        BODY,
        Head("targets", "Number of targets of the body, surveyed or seen."),
        Head("surveyed", "Number of targets with coordinates in the frame of the body."),
        Head("at attachments", "Number of targets at attachments of legs, which move if the platform deforms."),
        Head("poses", "Number of poses in which the body was measured."),
        Head("points", "Number of measured points of the body."),
        Head("median sigma x, y, z", "Median standard deviation of a coordinate, by axis."),
    )
    return Listing(heads, tuple(rows), caption="Bodies and their targets")


_FROM, _TO = Head("from", "Smallest value."), Head("to", "Largest value.")


def _ranges(configurations: pd.DataFrame) -> Listing:
    """Return the ranges of readings and covariates."""
    numeric = configurations.select_dtypes("number").columns
    columns = [c for c in numeric if c not in ("pose", "time_s")]
    rows = tuple(
        (
            c,
            f"{configurations[c].min():.6g}",
            f"{configurations[c].max():.6g}",
            str(int(configurations[c].notna().sum())),
        )
        for c in columns
    )
    heads = (
        Head("column", "Column of the table of configurations."),
        _FROM,
        _TO,
        Head("poses", "Number of poses with a value."),
    )
    return Listing(heads, rows, caption="Readings and surroundings", folded=len(rows) > 12)


def _targets(points: pd.DataFrame, survey: pd.DataFrame | None, residuals: pd.DataFrame | None) -> Listing:
    """Return every target: its place in the survey, number of observations, and number of exclusions."""
    keys = ["body", "target"]
    table = points.groupby(keys, sort=False).size().rename("seen").reset_index()
    if survey is not None:
        table = survey[[*keys, *XYZ, "leg"]].merge(table, on=keys, how="outer", sort=False)
    if residuals is not None:
        table = table.merge(residuals.groupby(keys)["rejected"].sum().reset_index(), on=keys, how="left")
    rows = tuple(_target_row(r) for r in table.itertuples())
    heads = (
        BODY,
        TARGET,
        Head("x, y, z in the survey (mm)", "Coordinates of the target in the frame of its body."),
        Head("attachment", "Leg at whose attachment the target sits; a dash for the others."),
        Head("seen in poses", "Number of poses in which the target was measured."),
        Head("left out in", "Number of poses in which its point was left out as a gross error."),
    )
    return Listing(heads, rows, caption=f"All {count(len(rows), 'target')}", folded=True, held_by="survey.parquet")


def _target_row(r: Any) -> tuple[str, ...]:
    position = [getattr(r, c, None) for c in XYZ]
    known = all(p is not None and p == p for p in position)
    leg = getattr(r, "leg", None)
    left_out = getattr(r, "rejected", None)
    return (
        r.body,
        r.target,
        ", ".join(f"{p:.3f}" for p in position) if known else "not surveyed",
        f"leg {int(leg)}" if leg is not None and leg == leg else "",
        "0" if cell(r.seen) == "" else str(int(r.seen)),
        str(int(left_out)) if left_out is not None and left_out == left_out and left_out else "",
    )


def _measured_scans(tables: Tables) -> ReportSection:
    sentence = _campaign_sentence(tables)
    return ReportSection("measured", "Measured", sentence, listings=(_scans(tables["scans"]),))


def _measured_poses(tables: Tables, given: pd.DataFrame) -> ReportSection:
    """Return poses that an instrument measured directly, with the columns recorded with them."""
    rows = tuple((str(body), f"{len(part):,}") for body, part in given.groupby("body", sort=False))
    listings = [Listing((BODY, _MEASURED_POSES), rows, caption="Bodies whose poses were measured")]
    if (conf := table_or_none(tables, "configurations")) is not None and _ranges(conf).rows:
        listings.append(_ranges(conf))
    text = f"{_campaign_sentence(tables)} Poses were measured as such, without targets: {len(given):,} of them."
    return ReportSection("measured", "Measured", text, listings=tuple(listings))


_MEASURED_POSES = Head("poses", "Number of poses that the instrument reported.")


def _scans(scans: pd.DataFrame) -> Listing:
    """Return the results of the registration of dense scans, body by body."""
    rows = tuple(
        (
            str(body),
            f"{int((part['status'] == 'ok').sum()):,} of {len(part):,}",
            f"{part['n_used'].median():,.0f}",
            f"{plain(100.0 * part['overlap'].median())} %",
            quantity(part["rms_mm"].median(), "mm"),
            plain(part["noise_ratio"].median()),
        )
        for body, part in scans.groupby("body", sort=False)
    )
    heads = (
        BODY,
        Head("scans registered", "Number of scans that gave a pose."),
        Head("points used, median", "Median number of points of a scan in the fit."),
        Head("overlap", "Share of a scan's points on the reference surface."),
        Head("rms", "Root mean square distance of the points from the reference surface."),
        Head("scatter over declared noise", "Rms distance from the reference surface divided by the declared noise."),
    )
    return Listing(heads, rows, caption="Dense scans")


def _campaign_sentence(tables: Tables) -> str:
    conf = table_or_none(tables, "configurations")
    if conf is None:
        return "No table of configurations: poses are in the order of the files."
    roles = ", ".join(f"{n:,} {role}" for role, n in conf["role"].value_counts().items())
    sentence = f"{count(len(conf), 'pose')} ({roles}){_time_words(conf['time_s'].to_numpy(dtype=float))}"
    if "temperature_c" in conf and conf["temperature_c"].notna().any():
        low, high = conf["temperature_c"].min(), conf["temperature_c"].max()
        sentence += f", at {low:.2f} to {high:.2f} °C"
    return sentence + "."


def campaign_span(tables: Tables) -> str:
    """Return the duration of the poses or load steps, such as ``over 3.4 h``; empty if unknown."""
    conf, steps = table_or_none(tables, "configurations"), load_steps(tables)
    words = _time_words_of_loads(steps) if conf is None else _time_words(conf["time_s"].to_numpy(dtype=float))
    return words.strip(" ,")


def _time_words(times: Any) -> str:
    """Return the duration in words; empty where times merely number the poses."""
    if len(times) < 2:
        return ""
    if np.all(np.diff(np.sort(times)) == 1.0):
        return ", without times other than their order"
    if len(np.unique(times)) < len(times) and np.any(np.diff(times) < 0.0):  # of several clocks, or from zero again
        return ""
    return f" over {duration(float(np.ptp(times)))}"


def measured_loads(tables: Tables) -> ReportSection:
    """Return the section on runs, steps, loads, channels and surroundings of a bench."""
    steps = load_steps(tables)
    if not len(steps):
        if (approaches := table_or_none(tables, "positions")) is not None:
            runs = count(approaches["run"].nunique(), "run")
            targets = count(approaches["target_mm"].nunique(), "target")
            text = f"{count(len(approaches), 'approach')} of an axis to {targets}, in {runs}: see Positioning."
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
    text = f"{count(len(steps), 'load step')} in {count(runs, 'run')}{_time_words_of_loads(steps)}, {_at_once(steps)}. "
    signals = signal_names(tables)
    beside = f"{count(len(signals), 'signal')} ({signals[0]} to {signals[-1]})" if signals else ""
    if not len(read):
        return f"{text}Recorded: {beside or 'no channels'}; the motion of the platform was not measured."
    per_run = read.groupby("run")["channel"].nunique()
    channels = in_channel_order(read["channel"].unique())
    how = "one in each run" if (per_run == 1).all() else "all in every run" if (per_run == len(channels)).all() else ""
    text += f"Recorded: {', '.join(channels)}{f' ({how})' if how else ''}{f' and {beside}' if beside else ''}."
    roles = steps.groupby("run")["role"].first().value_counts()
    return text + (f" Held out: {count(int(roles['verification']), 'run')}." if "verification" in roles else "")


def _time_words_of_loads(steps: pd.DataFrame) -> str:
    if len(steps) and _is_counted(steps):
        return ", without times other than their order"
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
        _FROM,
        _TO,
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
            own = readings[readings["channel"] == channel]
            unit = str(own["unit"].iloc[0])
            span = (quantity(own["reading"].min(), unit), quantity(own["reading"].max(), unit))
            noise = _noise(own["sigma"], unit, estimated=channel in estimated)
            rows.append((channel, str(own["run"].nunique()), f"{len(own):,}", *span, noise))
    signals = table_or_none(tables, "signals")
    for name in signal_names(tables):
        own = signals[["run", f"{name}_mv"]].dropna() if signals is not None else None
        if own is not None and len(own):
            low, high = (plain(value) for value in (own[f"{name}_mv"].min(), own[f"{name}_mv"].max()))
            rows.append((name, str(own["run"].nunique()), f"{len(own):,}", f"{low} mV", f"{high} mV", signal_noise))
    heads = (
        CHANNEL,
        Head("runs", "Number of runs in which the channel was read."),
        Head("readings", "Number of readings of the channel."),
        _FROM,
        _TO,
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
    heads = (Head("surroundings", "Recorded quantity that is no load and no reading."), _FROM, _TO, _NUMBER)
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
    return Listing(heads, rows, caption=f"All {count(len(rows), 'run')}", folded=len(rows) > _OPEN, held_by=held_by)


def _run_row(run: object, table: pd.DataFrame, channels: Any) -> tuple[str, ...]:
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
