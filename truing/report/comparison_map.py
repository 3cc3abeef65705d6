"""Map of a measured matrix against a simulated one."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import plotly.graph_objects as go
from numpy.typing import ArrayLike

from truing.report.figure_style import style

_CLIPPED = 6.0


def comparison_map(
    pull: ArrayLike,
    cells: ArrayLike,
    hover: ArrayLike,
    rows: Sequence[str],
    columns: Sequence[str],
    title: str,
    subtitle: str,
) -> go.Figure:
    """Return a map whose colour is the difference in sigmas; ``cells``: text of an entry, ``hover``: words of the
    pointer."""
    figure = go.Figure()
    figure.add_trace(
        go.Heatmap(
            z=np.clip(pull, -_CLIPPED, _CLIPPED),
            x=list(columns),
            y=[f"{row} " for row in rows],
            text=cells,
            texttemplate="%{text}",
            textfont={"size": 12},
            customdata=hover,
            hovertemplate="%{y}under %{x}<br>%{customdata}<extra></extra>",
            colorscale="RdBu_r",
            zmin=-_CLIPPED,
            zmax=_CLIPPED,
            xgap=1,
            ygap=1,
            colorbar={"title": {"text": "sigmas apart"}, "thickness": 16},
        )
    )
    style(figure, title, f"{subtitle}. White: agrees; the darker, the further apart", 560)
    figure.update_yaxes(autorange="reversed", automargin=True, type="category", showgrid=False)
    figure.update_xaxes(side="top", type="category", showgrid=False)
    figure.update_layout(margin={"t": 110, "b": 20})
    return figure
