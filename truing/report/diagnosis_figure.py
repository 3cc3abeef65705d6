"""The figure of the diagnosis: how far predictions miss, cause by cause."""

from __future__ import annotations

from typing import TYPE_CHECKING

from truing.report.figure_style import BLUE, GREY, ORANGE, label, style
from truing.report.numbers import plain, sign

if TYPE_CHECKING:
    import pandas as pd
    import plotly.graph_objects as go


def misses(found: pd.DataFrame) -> go.Figure:
    """Measured minus predicted, rms, before and after each accepted cause of one unit, against what noise leaves."""
    import plotly.graph_objects as go

    causes = [f"{r.cause} {r.subject}" if isinstance(r.subject, str) else r.cause for r in found.itertuples()]
    stages = ["simulation as it is", *(f"+ {label(cause.strip())}" for cause in causes)]
    figure = go.Figure()
    for name, column, colour in (("calibration poses", "rms", BLUE), ("held-out poses", "heldout_rms", ORANGE)):
        heights = [found[f"{column}_before"].iloc[0], *found[f"{column}_after"]]
        if not found[f"{column}_after"].notna().any():
            continue
        figure.add_trace(
            go.Bar(
                y=stages,
                x=heights,
                name=name,
                orientation="h",
                text=[plain(h) for h in heights],
                marker={"color": colour},
            )
        )
    floor = float(found["noise_floor"].iloc[-1])
    unit = sign(str(found["unit"].iloc[0]))
    figure.add_vline(x=floor, line={"color": GREY, "dash": "dot", "width": 2})
    subtitle = f"Dotted: what the declared noise alone leaves, {plain(floor)} {unit}"
    style(figure, "How far predictions miss the measurement, cause by cause", subtitle, 190 + 55 * len(stages))
    figure.update_yaxes(autorange="reversed", automargin=True, type="category")
    figure.update_xaxes(title_text=f"rms of measured − predicted ({unit})", rangemode="tozero")
    figure.update_layout(legend={"orientation": "h", "y": 1.0, "yanchor": "bottom", "x": 1.0, "xanchor": "right"})
    return figure
