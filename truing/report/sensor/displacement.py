"""Section of the platform's displacement: measured components, and residuals of readings."""

from __future__ import annotations

import numpy as np
import pandas as pd
import plotly.graph_objects as go

from truing.report.column_heads import CHANNEL, LOAD, RUN, UNIT, Head, P
from truing.report.figure_style import BAR, BLUE, MANY_POINTS, ORANGE, RED, label, panel_grid, style
from truing.report.numbers import count_text, p_value, with_uncertainty
from truing.report.page import Listing, ReportSection
from truing.report.tables import CHANNELS, LOADS, Tables, moved_unit, reason, table_or_none

_COMPONENTS = dict(zip(CHANNELS, ("dx_mm", "dy_mm", "dz_mm", "rx_rad", "ry_rad", "rz_rad"), strict=True))
_UNLIKELY = 1e-3

_REACH = 6.0  # sigmas beyond which a residual is drawn at the edge


def displacement(tables: Tables) -> ReportSection | None:
    """Return the section of load cases, their known components, and the residuals of readings."""
    if "displacement" not in tables:
        return None
    cases = table_or_none(tables, "displacement")
    if cases is None:
        why = reason(tables, "displacement") or "The campaign holds no readings of a platform under load."
        return ReportSection("displacement", "Displacement", why, state="not evaluated")
    residuals, terms = tables["reading_residuals"], tables["run_terms"]
    drawn: tuple[tuple[go.Figure, str], ...] = ()
    if residuals["residual"].notna().any():
        words = "Residuals from a smooth curve of load and time through each run. Crosses: left out as gross errors."
        drawn = ((reading_residuals(residuals), words),)
    listings = [listing for listing in (_complete_cases(cases), _drifts(terms)) if listing is not None]
    return ReportSection("displacement", "Displacement", _opening_sentences(cases, residuals), drawn, tuple(listings))


def _opening_sentences(cases: pd.DataFrame, residuals: pd.DataFrame) -> str:
    known = cases[list(_COMPONENTS.values())].notna().to_numpy()
    read = f"{count_text(len(residuals), 'reading')} of {count_text(residuals['run'].nunique(), 'run')}"
    complete = int(known.all(axis=1).sum())
    how_many = "all" if complete == len(cases) else f"{complete:,} of them"
    cases_text = f"{count_text(len(cases), 'load case')}, {how_many} in all six components"
    texts = [f"{read} give the displacement of the platform in {cases_text}."]
    never = [channel for channel, seen in zip(_COMPONENTS, known.any(axis=0), strict=True) if not seen]
    if never:
        texts.append(f"Never measured, and therefore unknown: {', '.join(never)}.")
    texts.append("Zeros and drifts of the runs are subtracted; their uncertainty is in the covariance.")
    return " ".join(texts)


_CASE_HEADS = (
    LOAD,
    Head("cases", "Number of load cases: equal loads, approached in the same way."),
    *(Head(channel, "Number of load cases in which this component of the motion is known.") for channel in CHANNELS),
)


def _complete_cases(cases: pd.DataFrame) -> Listing | None:
    """Return the number of load cases of every axis with all components known."""
    loads = cases[list(LOADS.values())].to_numpy()
    rows, marks = [], []
    for a, load in enumerate(LOADS):
        mask = (loads[:, a] != 0.0) & (np.delete(loads, a, axis=1) == 0.0).all(axis=1)
        if mask.any():
            seen = [int(cases.loc[mask, column].notna().sum()) for column in _COMPONENTS.values()]
            rows.append((load, f"{int(mask.sum()):,}", *(f"{n:,}" if n else "not measured" for n in seen)))
            marks.append("" if all(seen) else "none")
    several = (loads != 0.0).sum(axis=1) > 1
    if several.any():
        seen = [int(cases.loc[several, column].notna().sum()) for column in _COMPONENTS.values()]
        rows.append(("several", f"{int(several.sum()):,}", *(f"{n:,}" if n else "not measured" for n in seen)))
        marks.append("")
    if not rows:
        return None
    caption = "Load cases in which each component was measured"
    return Listing(_CASE_HEADS, tuple(rows), tuple(marks), caption, held_by="displacement.parquet")


_DRIFT_HEADS = (
    RUN,
    CHANNEL,
    Head("drift", "Change of the zero over the run, with one standard deviation."),
    UNIT,
    P,
)


def _drifts(terms: pd.DataFrame) -> Listing | None:
    """Return runs with significant drift."""
    drifts = terms[terms["term"] == "drift"]
    real = drifts[drifts["p_value"] < _UNLIKELY / max(len(drifts), 1)]
    if not len(real):
        return None
    rows = tuple(
        (str(r.run), r.channel, with_uncertainty(r.value, r.sigma), f"{moved_unit(r.channel)}/h", p_value(r.p_value))
        for r in real.itertuples()
    )
    caption = f"Runs that drift beyond chance, {len(real)} of {len(drifts)} with a determined drift"
    return Listing(_DRIFT_HEADS, rows, (), caption, len(rows) > 20, "run_terms.parquet")


def reading_residuals(residuals: pd.DataFrame) -> go.Figure:
    """Return residuals of every channel in the order of the readings, with the band of the noise."""
    channels = [channel for channel in CHANNELS if (residuals["channel"] == channel).any()]
    titles = [f"{channel} ({moved_unit(channel)})" for channel in channels]
    grid, positions, rows = panel_grid(titles, 3, (0.05, lambda rows: 0.16 if rows > 1 else 0.0))
    bounds: list[dict[str, object]] = []  # as shapes, because separate calls of plotly are slow
    for number, (channel, position) in enumerate(zip(channels, positions, strict=True), 1):
        part = residuals[residuals["channel"] == channel].reset_index(drop=True)
        sigma = float(part["sigma"].median())
        for trace in _points(part, sigma, len(residuals) > MANY_POINTS):
            grid.add_trace(trace, **position)
        bounds += [_bound(side * BAR * sigma, "" if number == 1 else str(number)) for side in (-1.0, 1.0)]
        edge = 1.1 * max(min(_REACH * sigma, float(part["residual"].abs().max())), 2.5 * sigma)
        grid.update_yaxes(range=[-edge, edge], **position)
    style(
        grid,
        "Readings minus the curve of their run",
        "Dotted: 95 % of the noise. In order of measurement",
        150 + 200 * rows,
    )
    grid.update_traces(showlegend=False)
    grid.update_xaxes(title_text="reading", row=rows)
    grid.update_layout(margin={"t": 110}, shapes=bounds)
    return grid


def _bound(value: float, panel: str) -> dict[str, object]:
    """Return a dotted line across a panel, as a shape; ``panel``: the number in the names of its axes."""
    shape = {"xref": f"x{panel} domain", "yref": f"y{panel}", "x0": 0.0, "x1": 1.0, "y0": value, "y1": value}
    return {"type": "line", **shape, "line": {"color": ORANGE, "width": 1, "dash": "dot"}}


def _points(part: pd.DataFrame, sigma: float, many: bool) -> list[go.Scatter]:
    kind = go.Scattergl if many else go.Scatter
    is_rejected = part["rejected"].to_numpy()
    text = np.array([f"run {label(r)} step {s}" for r, s in zip(part["run"], part["step"], strict=True)], object)
    value = part["residual"].to_numpy(dtype=float)
    used_points = kind(
        x=part.index[~is_rejected],
        y=value[~is_rejected],
        mode="markers",
        marker={"color": BLUE, "size": 3 if many else 4},
        text=text[~is_rejected],
        hovertemplate="%{text}: %{y:.3g}<extra></extra>",
    )
    if not is_rejected.any():
        return [used_points]
    gross = kind(
        x=part.index[is_rejected],
        y=np.clip(value[is_rejected], -_REACH * sigma, _REACH * sigma),
        mode="markers",
        marker={"color": RED, "size": 10, "symbol": "x-thin", "line": {"color": RED, "width": 2}},
        text=[f"{label}: {size:.4g}" for label, size in zip(text[is_rejected], value[is_rejected], strict=True)],
        hovertemplate="left out, %{text}<extra></extra>",
    )
    return [used_points, gross]
