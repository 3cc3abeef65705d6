"""The figure of how well each parameter is known: its sigma in parts of its tolerance, kind by leg."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from truing.report.calibration.calibrations import Key, called
from truing.report.figure_style import label, style
from truing.report.parameter_names import kind_of

if TYPE_CHECKING:
    import pandas as pd
    import plotly.graph_objects as go

_ROW = 28


def knowledge_map(own: pd.DataFrame, key: Key) -> go.Figure:
    """Heat map of sigma over tolerance of one calibration's parameters; those not identifiable in brackets."""
    import plotly.graph_objects as go

    told = own.assign(
        kind=[kind_of(name, leg) for name, leg in zip(own["parameter"], own["leg"], strict=True)],
        place=[f"leg {int(leg)}" if leg == leg else "all legs" for leg in own["leg"]],
        ratio=own["sigma"] / own["tolerance"],
        known=own["identifiable"].astype(bool) if "identifiable" in own else True,
    )
    kinds, places = list(dict.fromkeys(told["kind"])), list(dict.fromkeys(told.sort_values("leg")["place"]))
    wide = {
        c: told.pivot(index="kind", columns="place", values=c).reindex(index=kinds, columns=places)
        for c in ("ratio", "known")
    }
    figure = go.Figure()
    figure.add_trace(
        go.Heatmap(
            z=np.round(wide["ratio"].to_numpy(dtype=float), 4),
            x=places,
            y=[f"{label(kind)} " for kind in kinds],
            text=_cells(wide["ratio"].to_numpy(dtype=float), wide["known"].to_numpy()),
            texttemplate="%{text}",
            zmin=0,
            zmax=1,
            xgap=1,
            ygap=1,
            colorscale="Blues",
            colorbar={"title": {"text": "sigma / tolerance"}, "thickness": 16},
            hovertemplate="%{y} of %{x}: %{z:.3f} tolerances<extra></extra>",
        )
    )
    subtitle = f"Sigma after the calibration over the tolerance before it, {label(called(key))}"
    style(figure, "How well each parameter is known", subtitle, 170 + _ROW * len(kinds))
    figure.update_xaxes(type="category", side="top", showgrid=False)
    figure.update_yaxes(type="category", autorange="reversed", automargin=True, showgrid=False)
    figure.update_layout(margin={"t": 110, "b": 20})
    return figure


def _cells(ratios: np.ndarray, known: np.ndarray) -> list[list[str]]:
    return [[_cell(r, k) for r, k in zip(*pair, strict=True)] for pair in zip(ratios, known, strict=True)]


def _cell(ratio: float, known: bool) -> str:
    if ratio != ratio:
        return ""
    return f"{ratio:.2f}" if known else f"({ratio:.2f})"
