"""Map of a measured matrix against a simulated one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import plotly.graph_objects as go
from numpy.typing import ArrayLike

from truing.report.figure_style import style

_CLIPPED = 6.0


@dataclass(frozen=True)
class ComparedEntries:
    """Entries of two matrices: difference in sigmas, text of the cell, and words at the pointer, each (R, C)."""

    pull: ArrayLike
    cells: ArrayLike
    hover: ArrayLike


def comparison_map(
    entries: ComparedEntries, rows: Sequence[str], columns: Sequence[str], title: str, subtitle: str
) -> go.Figure:
    """Return a map of the entries, whose colour is their difference in sigmas."""
    figure = go.Figure()
    figure.add_trace(
        go.Heatmap(
            z=np.clip(entries.pull, -_CLIPPED, _CLIPPED),
            x=list(columns),
            y=[f"{row} " for row in rows],
            text=entries.cells,
            texttemplate="%{text}",
            textfont={"size": 12},
            customdata=entries.hover,
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
