"""The figure of the requirements: errors with their intervals against the limits."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from truing.report.calibration.calibrations import Key, called
from truing.report.figure_style import GREEN, GREY, ORANGE, RED, label, sequence_title, size_axis, style
from truing.report.numbers import quantity

if TYPE_CHECKING:
    import pandas as pd
    import plotly.graph_objects as go

_DRAWN_AS = {"meets": (GREEN, "circle"), "undecided": (ORANGE, "diamond"), "fails": (RED, "x")}


def requirement_bars(own: pd.DataFrame, key: Key) -> go.Figure:
    """Each component's error in units of its limit, with its interval; right of the line is too much."""
    import plotly.graph_objects as go

    shown = own[own["error"].notna() & (own["requirement"] > 0.0)]
    ratio = {c: (shown[c] / shown["requirement"]).to_numpy(dtype=float) for c in ("error", "lower", "upper")}
    figure = go.Figure()
    for verdict, (colour, symbol) in _DRAWN_AS.items():
        mine = (shown["verdict"] == verdict).to_numpy()
        if not mine.any():
            continue
        rows, error = shown[mine], ratio["error"][mine]
        bars = {"type": "data", "symmetric": False, "thickness": 3, "width": 6}
        bars |= {"array": ratio["upper"][mine] - error, "arrayminus": error - ratio["lower"][mine]}
        figure.add_trace(
            go.Scatter(
                x=error,
                y=[label(name) for name in rows["component"]],
                mode="markers",
                name=verdict,
                marker={"color": colour, "size": 11, "symbol": symbol},
                error_x=bars,
                text=[f"{quantity(e, u)} of {quantity(r, u)}" for e, r, u in _sizes(rows)],
                hovertemplate="%{y}: %{text}<extra>" + verdict + "</extra>",
            )
        )
    kind = size_axis(np.append(np.concatenate(list(ratio.values())), 1.0))
    figure.add_vline(x=1.0, line={"color": GREY, "width": 2, "dash": "dot"})
    subtitle = f"Of {label(called(key))}. Bars: 95 % interval. Right of the dotted line: more than required"
    style(figure, "Errors against what is required", subtitle, 170 + 42 * len(shown))
    title = sequence_title("error / requirement", kind.get("type") == "log")
    figure.update_xaxes(title_text=title, **{k: v for k, v in kind.items() if k != "dtick"})
    names = [label(name) for name in shown["component"]]
    figure.update_yaxes(type="category", categoryorder="array", categoryarray=names[::-1], automargin=True)
    figure.update_layout(legend={"orientation": "h", "y": 1.0, "yanchor": "bottom", "x": 0.0}, showlegend=True)
    figure.update_layout(margin={"t": 100})
    return figure


def _sizes(rows: pd.DataFrame) -> list[tuple[float, float, str]]:
    return list(zip(rows["error"], rows["requirement"], rows["unit"], strict=True))
