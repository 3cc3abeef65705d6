"""The figure of shifts in standard deviations: kinds of parameters side by side, a mark per leg, and a band."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from truing.report.figure_style import BLUE, GREY, ORANGE, label, style
from truing.report.numbers import plain
from truing.report.parameter_names import kind_of, name_of

if TYPE_CHECKING:
    import pandas as pd
    import plotly.graph_objects as go

# Larger ones are drawn at the edge, so that the others can be seen.
_CLIPPED = 25.0
_BAND = 1.96
_LOOK = ((ORANGE, "circle-open", -0.16), (BLUE, "circle", 0.16))
# A table of K has a kind per column; beyond this a kind has no room.
_KINDS = 40


def pull_figure(table: pd.DataFrame, columns: Mapping[str, str], title: str, axis: str) -> go.Figure:
    """Columns of ``table`` (leg, parameter, and those of ``columns``: column to words), a mark per row and column."""
    import plotly.graph_objects as go

    kinds = [kind_of(str(name), leg) for name, leg in zip(table["parameter"], table["leg"], strict=True)]
    order = list(dict.fromkeys(kinds))[:_KINDS]
    shown = table.assign(kind=kinds)
    shown = shown[shown["kind"].isin(order)]
    place = {kind: k for k, kind in enumerate(order)}
    figure = go.Figure()
    figure.add_hrect(y0=-_BAND, y1=_BAND, fillcolor=GREY, opacity=0.15, line={"width": 0})
    looks = _LOOK if len(columns) > 1 else _LOOK[1:]
    for (column, words), look in zip(columns.items(), looks, strict=True):
        figure.add_trace(_marks(shown, place, column, words, look))
    clipped = bool((shown[list(columns)].abs() > _CLIPPED).to_numpy().any())
    edge = f". Beyond {_CLIPPED:g}: drawn at the edge" if clipped else ""
    style(figure, title, f"A mark per leg; grey: where 95 % of them lie by chance{edge}", 420)
    ticks = {"tickvals": list(place.values()), "ticktext": [label(kind) for kind in order]}
    figure.update_xaxes(**ticks, showgrid=False, zeroline=False, range=[-0.6, len(order) - 0.4])
    figure.update_yaxes(title_text=axis, zeroline=True, zerolinecolor=GREY)
    legend = {"orientation": "h", "y": 1.0, "yanchor": "bottom", "x": 0.0}
    figure.update_layout(legend=legend, margin={"t": 104}, showlegend=len(columns) > 1)
    return figure


def _marks(
    shown: pd.DataFrame, place: Mapping[str, int], column: str, words: str, look: tuple[str, str, float]
) -> go.Scatter:
    import plotly.graph_objects as go

    colour, symbol, aside = look
    values = shown[column].to_numpy(dtype=float)
    return go.Scatter(
        x=[place[kind] + aside + spread for kind, spread in zip(shown["kind"], _spread(shown["leg"]), strict=True)],
        y=np.clip(values, -_CLIPPED, _CLIPPED),
        mode="markers",
        marker={"color": colour, "symbol": symbol, "size": 8, "line": {"width": 1.5}},
        name=words,
        text=[
            f"{label(name_of(str(name), leg))}: {plain(value)}"
            for name, leg, value in zip(shown["parameter"], shown["leg"], values, strict=True)
        ],
        hovertemplate="%{text}<extra>" + words + "</extra>",
    )


def _spread(legs: pd.Series) -> Any:
    """Places of legs beside each other within their kind."""
    numbers = legs.to_numpy(dtype=float)
    known = numbers[np.isfinite(numbers)]
    if not len(known) or np.ptp(known) == 0.0:
        return np.zeros(len(numbers))
    return np.where(np.isfinite(numbers), 0.22 * ((numbers - known.min()) / np.ptp(known) - 0.5), 0.0)
