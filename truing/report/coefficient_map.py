"""Map of the coefficients of a deformation model."""

from __future__ import annotations

import numpy as np
import pandas as pd
import plotly.graph_objects as go
from numpy.typing import NDArray

from truing.report.figure_style import style
from truing.report.numbers import with_uncertainty

# The cells of wider matrices are too small for numbers.
NUMBERED = 15


def coefficient_map(matrix: pd.DataFrame, along: str = "z") -> go.Figure:
    """Return a matrix of coefficients as a heat map; entries that chance could explain are in brackets."""
    wide = {c: matrix.pivot(index="leg", columns="column", values=c) for c in ("coefficient", "sigma")}
    values, sigma = 1e3 * wide["coefficient"], 1e3 * wide["sigma"]
    real = significant(matrix, "leg", "column").to_numpy()
    bound = float(np.nanmax(np.abs(values.to_numpy())))
    figure = go.Figure()
    figure.add_trace(
        go.Heatmap(
            z=values,
            x=[f"actuator {c}" for c in values.columns],
            y=[f"attachment {r} " for r in values.index],
            text=cells_of(values.to_numpy(), real, "{:.1f}"),
            texttemplate="%{text}" if len(values.columns) <= NUMBERED else None,
            textfont={"size": 14},
            customdata=_entry_listing(values.to_numpy(), sigma.to_numpy()),
            colorscale="RdBu_r",
            zmin=-bound,
            zmax=bound,
            xgap=1,
            ygap=1,
            colorbar={"title": {"text": "µm per mm"}, "thickness": 16},
            hovertemplate="%{y}with %{x}: %{customdata}<extra></extra>",
        )
    )
    typical = float(np.nanmedian(sigma.to_numpy()))
    subtitle = f"One sigma of an entry: {typical:.2g} µm per mm. In brackets: not distinguishable from zero"
    style(figure, f"K: shift of each attachment along {along}, in µm per mm of each actuator", subtitle, 520)
    matrix_axes(figure)
    return figure


def significant(matrix: pd.DataFrame, index: str, columns: str) -> pd.DataFrame:
    """Return a table of which coefficients chance does not explain."""
    known = matrix if "significant" in matrix else matrix.assign(significant=True)
    return known.pivot(index=index, columns=columns, values="significant")


def cells_of(values: NDArray, real: NDArray, form: str) -> list[list[str]]:
    """Return the text of every cell, in brackets where chance explains the value."""
    return [
        [form.format(v) if mark else f"({form.format(v)})" for v, mark in zip(row, marks, strict=True)]
        for row, marks in zip(values, real, strict=True)
    ]


def _entry_listing(values: NDArray, sigma: NDArray) -> list[list[str]]:
    """Return every entry with its uncertainty."""
    return [
        [with_uncertainty(v, s, "µm/mm") for v, s in zip(*pair, strict=True)]
        for pair in zip(values, sigma, strict=True)
    ]


def matrix_axes(figure: go.Figure) -> None:
    """Set the axes of a map: rows from the top, names of columns above."""
    figure.update_yaxes(autorange="reversed", automargin=True, type="category", showgrid=False)
    figure.update_xaxes(side="top", type="category", showgrid=False)
    figure.update_layout(margin={"t": 110, "b": 20})
