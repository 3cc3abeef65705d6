"""The compliance matrix, each measured entry beside the simulated one."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from truing.report.figure_style import style
from truing.report.numbers import plain, with_uncertainty
from truing.report.sensor.axes import CHANNELS, LOADS, per_kilo

if TYPE_CHECKING:
    import pandas as pd
    import plotly.graph_objects as go

_CLIPPED = 6.0


def comparison_map(compliance: pd.DataFrame) -> go.Figure:
    """Measured over simulated in every cell; colour says by how many sigmas they differ."""
    import plotly.graph_objects as go

    measured = {(r.response, r.load): r for r in compliance[compliance["model"] == "matrix"].itertuples()}
    drawing = {(r.response, r.load): r for r in compliance[compliance["model"] == "simulated"].itertuples()}
    pull, text, said = np.full((6, 6), np.nan), np.full((6, 6), "", object), np.full((6, 6), "", object)
    for i, response in enumerate(CHANNELS):
        for j, load in enumerate(LOADS):
            one, two = measured.get((response, load)), drawing[response, load]
            factor, unit = per_kilo(response, load)
            if one is None:
                text[i, j] = f"not<br>measured<br>{_short(factor * two.coefficient)}"
                continue
            pull[i, j] = one.pull
            text[i, j] = f"{_short(factor * one.coefficient)}<br>{_short(factor * two.coefficient)}"
            said[i, j] = (
                f"measured {with_uncertainty(factor * one.coefficient, factor * one.sigma, unit)}<br>"
                f"simulated {with_uncertainty(factor * two.coefficient, factor * two.sigma, unit)}<br>"
                f"{one.pull:+.1f} sigma: {one.verdict}"
            )
    figure = go.Figure()
    figure.add_trace(
        go.Heatmap(
            z=np.clip(pull, -_CLIPPED, _CLIPPED),
            x=list(LOADS),
            y=[f"{channel} " for channel in CHANNELS],
            text=text,
            texttemplate="%{text}",
            textfont={"size": 12},
            customdata=said,
            hovertemplate="%{y}under %{x}<br>%{customdata}<extra></extra>",
            colorscale="RdBu_r",
            zmin=-_CLIPPED,
            zmax=_CLIPPED,
            xgap=1,
            ygap=1,
            colorbar={"title": {"text": "sigmas apart"}, "thickness": 16},
        )
    )
    subtitle = "µm (dx dy dz) or arcsec (rx ry rz) per kN or kN·m. White: agrees; the darker, the further apart"
    style(figure, "Compliance, measured (above) and simulated (below)", subtitle, 560)
    figure.update_yaxes(autorange="reversed", automargin=True, type="category", showgrid=False)
    figure.update_xaxes(side="top", type="category", showgrid=False)
    figure.update_layout(margin={"t": 110, "b": 20})
    return figure


def _short(value: float) -> str:
    """Three digits, and nothing for what is nothing beside the rest."""
    return "0" if abs(value) < 5e-4 else plain(value)
