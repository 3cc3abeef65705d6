"""The bars of a budget: what share of each result's variance every source has."""

from __future__ import annotations

from typing import TYPE_CHECKING

from truing.report.figure_style import BLUE, GREEN, GREY, ORANGE, RED, label, style
from truing.report.uncertainty.grouped import Grouped

if TYPE_CHECKING:
    import plotly.graph_objects as go

_COLOURS = (BLUE, ORANGE, GREEN, RED, "#CC79A7", "#56B4E9", "#F0E442")
_REST = "all others"
_SEEN = 5e-3  # of a bar: what is narrower cannot be seen


def visible(groups: Grouped) -> list[str]:
    """The sources that can be seen in any of the bars."""
    return [s for s in groups.sources if max(groups.share[name, s] for name in groups.names) >= _SEEN]


def share_bars(groups: Grouped, title: str) -> go.Figure:
    """A bar per group of results, divided by source; more sources than there are colours for are put together."""
    import plotly.graph_objects as go

    figure = go.Figure()
    names = [label(name) for name in groups.names]
    drawn = visible(groups)[: len(_COLOURS)]
    rest = [source for source in groups.sources if source not in drawn]
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
    legend = {"orientation": "v", "traceorder": "normal", "x": 0.0, "yanchor": "top"}
    figure.update_layout(legend={**legend, "y": -70 / (26 * len(names) + 30)})
    figure.update_xaxes(title_text="share of the variance, %", range=[0, 100])
    figure.update_yaxes(type="category", categoryorder="array", categoryarray=names[::-1], automargin=True)
    return figure


def _bar(shares: list[float], names: list[str], name: str, colour: str) -> go.Bar:
    import plotly.graph_objects as go

    template = "%{y}: %{x:.1f} %<extra>" + name.replace("%", "") + "</extra>"
    return go.Bar(x=shares, y=names, name=name, orientation="h", marker={"color": colour}, hovertemplate=template)
