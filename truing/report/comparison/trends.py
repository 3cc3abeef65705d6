"""Trends: every kind of number over the runs, each against its mean, with bars of 95 %."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from truing.report.comparison.compared_runs import Comparison, called, told_change, unit_of
from truing.report.figure_style import BLUE, GREEN, GREY, ORANGE, RED, label, style
from truing.report.parameter_names import kind_of
from truing.report.tables import cell

if TYPE_CHECKING:
    import pandas as pd
    import plotly.graph_objects as go

_BAR = 1.96
MOST = 12  # figures of a page
_LOOKS = (
    (BLUE, "circle"),
    (ORANGE, "square"),
    (GREEN, "diamond"),
    ("#CC79A7", "cross"),
    ("#56B4E9", "x"),
    (GREY, "triangle-up"),
)


def trend_figures(found: Comparison) -> tuple[tuple[tuple[go.Figure, str], ...], int]:
    """Figures with captions, kinds with a change first, then those that differ most; and how many are left out."""
    own = found.numbers[found.numbers["value"].notna()]
    own = own.assign(kind=[_kind(r) for r in own.itertuples()])
    known = own.groupby("kind", sort=False)["z"].transform(lambda z: z.notna().any())
    order = (
        own[known | own["changed"]]
        .assign(size=own["z"].abs())
        .groupby("kind", sort=False)
        .agg(changed=("changed", "any"), size=("size", "max"))
        .sort_values(["changed", "size"], ascending=False, kind="stable")
    )
    drawn = [_figure(found, own[own["kind"] == kind], str(kind)) for kind in order.index[:MOST]]
    captions = [_caption(own[(own["kind"] == kind) & own["changed"]]) for kind in order.index[:MOST]]
    return tuple(zip(drawn, captions, strict=True)), max(len(order) - MOST, 0)


def _caption(changed: pd.DataFrame) -> str:
    """What is ringed, and why that may not be seen here."""
    said = []
    for r in changed.itertuples():
        together = cell(r.instead)
        why = f": told only together with {together}, so that the change is surer than its bar" if together else ""
        said.append(f"{called(r)} changed by {told_change(r)}{why}.")
    return f"Ringed: {' '.join(said)}" if said else ""


def _kind(row: Any) -> str:
    if row.group in ("compliance", "G_B"):
        head, _, tail = row.parameter.partition(" ")
        return (
            f"compliance by {tail}, {'rotations' if head[0] == 'r' else 'displacements'}"
            if (row.group == "compliance")
            else f"G_B, row {head}"
        )
    leg = row.leg if row.leg is not None else float("nan")
    kind = kind_of(row.parameter, leg)
    return f"{kind} of {row.effect_of}" if row.group == "effect" else kind


def _figure(found: Comparison, own: pd.DataFrame, kind: str) -> go.Figure:
    import plotly.graph_objects as go

    figure = go.Figure()
    first = next(own.itertuples())
    lines = list(own.groupby(["leg", "parameter"], sort=False, dropna=False))
    shifts = [rows["value"] - _mean(rows) for _, rows in lines]
    factor, unit = unit_of(first, float(np.median(np.abs(np.concatenate([*shifts, own["sigma"]])))))
    if unit == "mm" and max(float(shift.abs().max()) for shift in shifts) * factor < 1.0:
        factor, unit = 1e3 * factor, "µm"
    aside = np.linspace(-0.18, 0.18, len(lines)) if len(lines) > 1 else np.zeros(1)
    for k, ((_, rows), shift) in enumerate(zip(lines, shifts, strict=True)):
        colour, symbol = _LOOKS[k % len(_LOOKS)]
        figure.add_trace(_line(rows, factor * shift, factor, aside[k], colour, symbol, unit))
    _ring(figure, lines, shifts, factor, aside)
    style(figure, label(kind), f"Each against its own mean over the runs, {unit or '1'}; bars: 95 %", 320)
    ticks = {"tickvals": list(range(1, len(found.runs) + 1)), "ticktext": [label(run.label) for run in found.runs]}
    figure.update_xaxes(**ticks, range=[0.6, len(found.runs) + 0.4], showgrid=False)
    figure.update_yaxes(title_text=f"shift, {unit or '1'}", zeroline=True, zerolinecolor=GREY)
    return figure


def _mean(rows: pd.DataFrame) -> float:
    """The mean of a number over the runs, each counted by how well it knows it."""
    sigma = rows["sigma"].to_numpy(float)
    usable = np.isfinite(sigma) & (sigma > 0.0)
    weight = 1.0 / sigma**2 if usable.all() else np.ones(len(rows))
    return float(np.average(rows["value"].to_numpy(float), weights=weight))


def _line(
    rows: pd.DataFrame, shift: pd.Series, factor: float, aside: float, colour: str, symbol: str, unit: str
) -> go.Scatter:
    import plotly.graph_objects as go

    first = next(rows.itertuples())
    name = called(first) if rows["leg"].isna().all() else f"leg {int(first.leg)}"
    short = first.parameter if first.group in ("compliance", "G_B") else name
    return go.Scatter(
        x=rows["place"] + aside,
        y=shift,
        mode="lines+markers",
        name=label(short),
        line={"color": colour, "width": 1},
        marker={"color": colour, "symbol": symbol, "size": 8},
        error_y={"type": "data", "array": _BAR * factor * rows["sigma"], "thickness": 1, "width": 3},
        hovertemplate=f"%{{y:.4g}} {unit}<extra>{label(name)}</extra>",
    )


def _ring(figure: go.Figure, lines: list[Any], shifts: list[Any], factor: float, aside: np.ndarray) -> None:
    """Rings around the numbers that changed."""
    import plotly.graph_objects as go

    places = [
        (place + aside[k], factor * value)
        for k, ((_, rows), shift) in enumerate(zip(lines, shifts, strict=True))
        for place, value, changed in zip(rows["place"], shift, rows["changed"], strict=True)
        if changed
    ]
    if places:
        x, y = zip(*places, strict=True)
        ring = {"symbol": "circle-open", "size": 18, "color": RED, "line": {"width": 2.5}}
        figure.add_trace(go.Scatter(x=x, y=y, mode="markers", name="changed", marker=ring, hoverinfo="skip"))
