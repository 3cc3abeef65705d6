"""Figures of readings: what is left of them beside their runs' curves."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from truing.report.figure_style import BLUE, MANY_POINTS, ORANGE, RED, label, style
from truing.report.sensor.axes import CHANNELS, moved_unit

if TYPE_CHECKING:
    import pandas as pd
    import plotly.graph_objects as go

_BAR = 1.96
_REACH = 6.0  # sigmas beyond which a residual stands at the edge


def reading_residuals(residuals: pd.DataFrame) -> go.Figure:
    """Residuals of every channel in the order of the readings, with the band of the noise."""
    from plotly.subplots import make_subplots

    channels = [channel for channel in CHANNELS if (residuals["channel"] == channel).any()]
    columns = min(3, len(channels))
    rows = -(-len(channels) // columns)
    grid = make_subplots(
        rows=rows,
        cols=columns,
        subplot_titles=[f"{channel} ({moved_unit(channel)})" for channel in channels],
        horizontal_spacing=0.05,
        vertical_spacing=0.16 if rows > 1 else 0.0,
    )
    grid.update_annotations(font={"size": 13})
    for k, channel in enumerate(channels):
        place = {"row": k // columns + 1, "col": k % columns + 1}
        part = residuals[residuals["channel"] == channel].reset_index(drop=True)
        sigma = float(part["sigma"].median())
        for trace in _points(part, sigma, len(residuals) > MANY_POINTS):
            grid.add_trace(trace, **place)
        for side in (-1.0, 1.0):
            grid.add_hline(y=side * _BAR * sigma, line={"color": ORANGE, "width": 1, "dash": "dot"}, **place)
        edge = 1.1 * max(min(_REACH * sigma, float(part["residual"].abs().max())), 2.5 * sigma)
        grid.update_yaxes(range=[-edge, edge], **place)
    style(grid, "Readings less their runs' curves", "Dotted: 95 % of the noise. In the order taken", 150 + 200 * rows)
    grid.update_traces(showlegend=False)
    grid.update_xaxes(title_text="reading", row=rows)
    grid.update_layout(margin={"t": 110})
    return grid


def _points(part: pd.DataFrame, sigma: float, many: bool) -> list[go.Scatter]:
    import plotly.graph_objects as go

    kind = go.Scattergl if many else go.Scatter
    out = part["rejected"].to_numpy()
    text = np.array([f"run {label(r)} step {s}" for r, s in zip(part["run"], part["step"], strict=True)], object)
    value = part["residual"].to_numpy(dtype=float)
    kept = kind(
        x=part.index[~out],
        y=value[~out],
        mode="markers",
        marker={"color": BLUE, "size": 3 if many else 4},
        text=text[~out],
        hovertemplate="%{text}: %{y:.3g}<extra></extra>",
    )
    if not out.any():
        return [kept]
    gross = kind(
        x=part.index[out],
        y=np.clip(value[out], -_REACH * sigma, _REACH * sigma),
        mode="markers",
        marker={"color": RED, "size": 10, "symbol": "x-thin", "line": {"color": RED, "width": 2}},
        text=[f"{one}: {size:.4g}" for one, size in zip(text[out], value[out], strict=True)],
        hovertemplate="left out, %{text}<extra></extra>",
    )
    return [kept, gross]
