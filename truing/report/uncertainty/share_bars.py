"""The bars of a budget: what share of each result's variance every source has."""

from __future__ import annotations

from typing import TYPE_CHECKING

from truing.report.figure_style import BLUE, GREEN, GREY, ORANGE, RED, label, style
from truing.report.uncertainty.grouped import Grouped

if TYPE_CHECKING:
    import plotly.graph_objects as go

_COLOURS = (BLUE, ORANGE, GREEN, RED, "#CC79A7", "#56B4E9", "#F0E442")
_REST = "all others"


def share_bars(groups: Grouped, title: str) -> go.Figure:
    """A bar per group of results, divided by source; more sources than there are colours for are put together."""
    import plotly.graph_objects as go

    figure = go.Figure()
    names = [label(name) for name in groups.names]
    drawn, rest = groups.sources[: len(_COLOURS)], groups.sources[len(_COLOURS) :]
    for source, colour in zip(drawn, _COLOURS, strict=False):
        shares = [100.0 * groups.share[name, source] for name in groups.names]
        figure.add_trace(_bar(shares, names, f"{label(source)} ({groups.evaluation[source]})", colour))
        if groups.evaluation[source] == "A":  # told apart without colour too
            figure.data[-1].marker.pattern = {"shape": "/", "fgcolor": "white", "size": 6, "solidity": 0.2}
    if rest:
        shares = [100.0 * sum(groups.share[name, source] for source in rest) for name in groups.names]
        figure.add_trace(_bar(shares, names, _REST, GREY))
    height = 150 + 26 * len(names) + 22 * len(figure.data)
    style(figure, f"{title}: where the uncertainty comes from", "Share of the variance by source", height)
    figure.update_layout(barmode="stack", showlegend=True)
    figure.update_layout(legend={"orientation": "v", "x": 0.0, "y": -70 / (26 * len(names) + 30), "yanchor": "top"})
    figure.update_xaxes(title_text="share of the variance, %", range=[0, 100])
    figure.update_yaxes(type="category", categoryorder="array", categoryarray=names[::-1], automargin=True)
    return figure


def _bar(shares: list[float], names: list[str], name: str, colour: str) -> go.Bar:
    import plotly.graph_objects as go

    template = "%{y}: %{x:.1f} %<extra>" + name.replace("%", "") + "</extra>"
    return go.Bar(x=shares, y=names, name=name, orientation="h", marker={"color": colour}, hovertemplate=template)
