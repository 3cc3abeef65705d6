"""Displacement against load, measured and simulated; and what lies between the two."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from truing.report.figure_style import BLUE, GREY, ORANGE, RED, style
from truing.report.sensor.axes import CHANNELS, LOADS, kilo, moved_unit

if TYPE_CHECKING:
    import pandas as pd
    import plotly.graph_objects as go

_BAR = 1.96
_BRANCHES = {"loading": ("triangle-up", BLUE), "unloading": ("triangle-down-open", RED), "unloaded": ("circle", GREY)}
_BAND = "rgba(230,159,0,0.25)"
_MANY = 400  # so many cases of a panel need no bars of their own


def own_axes(curves: pd.DataFrame) -> go.Figure:
    """Each load against the displacement along or about its own axis (force-sensor paper, figures 12-17)."""
    pairs = [(load, channel) for load, channel in zip(LOADS, CHANNELS, strict=True) if len(_of(curves, load, channel))]
    grid, columns = _grid([f"{channel} under {load}" for load, channel in pairs], min(3, len(pairs)))
    shown: set[str] = set()
    for k, (load, channel) in enumerate(pairs):
        place = {"row": k // columns + 1, "col": k % columns + 1}
        part = _of(curves, load, channel)
        if _simulated(part):
            for trace in _simulation(part, part["simulated"], shown):
                grid.add_trace(trace, **place)
        for trace in _measurement(part, part["measured"], shown):
            grid.add_trace(trace, **place)
        grid.update_xaxes(title_text=f"{load} ({kilo(load)})", title_standoff=4, **place)
        grid.update_yaxes(title_text=f"{channel} ({moved_unit(channel)})", title_standoff=4, **place)
    rows = -(-len(pairs) // columns)
    subtitle = "Bars: 95 % of the noise. Line and band: simulation, and 95 % of what its tolerances leave open"
    if not any(_simulated(_of(curves, *pair)) for pair in pairs):
        subtitle = "Bars: 95 % of the noise. The campaign holds no simulation"
    style(grid, "Displacement along each load's own axis", subtitle, 170 + 260 * rows)
    return _legend(grid)


def differences(curves: pd.DataFrame) -> go.Figure:
    """Measured minus simulated, all components under all loads, a panel each."""
    loads = [load for load in LOADS if (curves["load"] == load).any()]
    channels = [channel for channel in CHANNELS if (curves["channel"] == channel).any()]
    from plotly.subplots import make_subplots

    grid = make_subplots(
        rows=len(channels),
        cols=len(loads),
        shared_xaxes="columns",
        shared_yaxes="rows",
        horizontal_spacing=0.012,
        vertical_spacing=0.014,
        column_titles=[f"under {load}" for load in loads],
    )
    grid.update_annotations(font={"size": 12})
    shown: set[str] = set()
    for i, channel in enumerate(channels):
        for j, load in enumerate(loads):
            part, place = _of(curves, load, channel), {"row": i + 1, "col": j + 1}
            if not len(part):
                grid.add_annotation(text="not measured", showarrow=False, font={"color": GREY, "size": 10}, **place)
                continue
            for trace in _simulation(part, 0.0 * part["simulated"], shown):
                grid.add_trace(trace, **place)
            for trace in _measurement(part, part["measured"] - part["simulated"], shown, size=4):
                grid.add_trace(trace, **place)
        grid.update_yaxes(title_text=f"{channel} ({moved_unit(channel)})", title_font={"size": 11}, row=i + 1, col=1)
    for j, load in enumerate(loads):
        grid.update_xaxes(title_text=kilo(load), title_font={"size": 11}, row=len(channels), col=j + 1)
    grid.update_xaxes(tickfont={"size": 10}, nticks=3)
    grid.update_yaxes(tickfont={"size": 10}, nticks=5)
    subtitle = "Outside of the band: beyond what tolerances explain. A slope: a wrong compliance, or a wrong load"
    style(grid, "Measured minus simulated, every component under every load", subtitle, 150 + 130 * len(channels))
    return _legend(grid)


def _of(curves: pd.DataFrame, load: str, channel: str) -> pd.DataFrame:
    part = curves[(curves["load"] == load) & (curves["channel"] == channel)]
    return part.sort_values("applied", kind="stable")


def _simulated(part: pd.DataFrame) -> bool:
    return "simulated" in part and bool(part["simulated"].notna().any())


def _grid(titles: list[str], columns: int) -> tuple[go.Figure, int]:
    from plotly.subplots import make_subplots

    rows = -(-len(titles) // columns)
    grid = make_subplots(
        rows=rows,
        cols=columns,
        subplot_titles=titles,
        horizontal_spacing=0.09,
        vertical_spacing=min(0.2, 0.9 / rows),
    )
    grid.update_annotations(font={"size": 13})
    return grid, columns


def _measurement(part: pd.DataFrame, values: pd.Series, shown: set[str], size: int = 6) -> list[go.Scatter]:
    """The points of each branch, told apart."""
    import plotly.graph_objects as go

    traces = []
    for branch, (symbol, colour) in _BRANCHES.items():
        own = (part["branch"] == branch).to_numpy()
        if not own.any():
            continue
        bars: dict[str, Any] = {"type": "data", "array": _BAR * part["sigma"][own], "thickness": 1, "width": 0}
        traces.append(
            go.Scatter(
                x=1e-3 * part["applied"][own],
                y=values[own],
                mode="markers",
                name=f"measured, {branch}",
                legendgroup=branch,
                showlegend=branch not in shown,
                marker={"symbol": symbol, "color": colour, "size": size},
                error_y=bars if len(part) <= _MANY else None,
                text=[f"case {case}" for case in part["case"][own]],
                hovertemplate="%{text}: %{x:.4g} → %{y:.4g}<extra></extra>",
            )
        )
        shown.add(branch)
    return traces


def _simulation(part: pd.DataFrame, values: pd.Series, shown: set[str]) -> list[go.Scatter]:
    """The simulated line and the band of its tolerances."""
    import plotly.graph_objects as go

    x, reach = 1e-3 * part["applied"].to_numpy(), _BAR * part["simulated_sigma"].to_numpy()
    y = values.to_numpy()
    around = go.Scatter(
        x=np.concatenate([x, x[::-1]]),
        y=np.concatenate([y - reach, (y + reach)[::-1]]),
        fill="toself",
        fillcolor=_BAND,
        line={"width": 0},
        hoverinfo="skip",
        name="simulation",
        legendgroup="simulation",
        showlegend=False,
    )
    line = go.Scatter(
        x=x,
        y=y,
        mode="lines",
        line={"color": ORANGE, "width": 2},
        name="simulated",
        legendgroup="simulation",
        showlegend="simulation" not in shown,
        hoverinfo="skip",
    )
    shown.add("simulation")
    return [around, line]


def _legend(figure: go.Figure) -> go.Figure:
    figure.update_layout(
        legend={"orientation": "h", "y": -0.06, "yanchor": "top", "x": 0.0}, margin={"t": 110, "b": 90}
    )
    return figure
