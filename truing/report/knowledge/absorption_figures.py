"""Figures of the absorption map: what each parameter is predicted to swallow, and what it did swallow."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from truing.report.figure_style import BLUE, GREEN, GREY, ORANGE, RED, label, style
from truing.report.knowledge.absorption_words import Group, correlation, group_words, groups, leading_groups
from truing.report.numbers import plain
from truing.report.parameter_names import kind_of, name_of, shown_in

if TYPE_CHECKING:
    import pandas as pd
    import plotly.graph_objects as go

_BAR = 1.96
# One parameter may go a hundred tolerances; the others are to be seen beside it.
_CLIPPED = 10.0
_COLOURS = (BLUE, ORANGE, GREEN, RED)
_SYMBOLS = ("circle", "x", "triangle-up", "diamond")


def absorption_map(absorbed: pd.DataFrame) -> go.Figure:
    """Predicted change of every parameter per effect left out: number in its unit, colour in its tolerances."""
    from plotly.subplots import make_subplots

    parts = leading_groups(absorbed.assign(kind=_kinds(absorbed)))
    titles = [f"If {group_words(key)}" for key, _ in parts]
    heights = [rows["kind"].nunique() for _, rows in parts]
    room = 70.0 / (30.0 * sum(heights) + 70.0 * len(parts))
    grid = make_subplots(
        rows=len(parts), cols=1, subplot_titles=[label(t) for t in titles], row_heights=heights, vertical_spacing=room
    )
    for row, (_, rows) in enumerate(parts, 1):
        grid.add_trace(_panel(rows), row=row, col=1)
    subtitle = f"Number: in the parameter's unit. Colour: in tolerances of the parameter, clipped at {_CLIPPED:g}"
    height = 140 + 30 * sum(heights) + 70 * len(parts)
    style(grid, "Absorption: what parameters take of an effect that is left out", subtitle, height)
    bar = {"title": {"text": "tolerances"}, "thickness": 16}
    grid.update_layout(coloraxis={"colorscale": "RdBu_r", "cmin": -_CLIPPED, "cmax": _CLIPPED, "colorbar": bar})
    grid.update_layout(margin={"t": 110})
    grid.update_xaxes(type="category", showgrid=False)
    grid.update_yaxes(type="category", autorange="reversed", automargin=True, showgrid=False)
    grid.update_annotations(font={"size": 13})
    return grid


def _kinds(rows: pd.DataFrame) -> list[str]:
    """Kind and unit of every row's parameter: ``a_x (mm)``."""
    kinds = [
        (kind_of(name, leg), shown_in(name, unit)[1])
        for name, leg, unit in zip(rows["parameter"], rows["leg"], rows["unit"], strict=True)
    ]
    return [f"{kind} ({unit})" if unit else kind for kind, unit in kinds]


def _columns(rows: pd.DataFrame) -> list[str]:
    return [f"leg {int(leg)}" if leg == leg else "all legs" for leg in rows["leg"]]


def _printed(rows: pd.DataFrame, column: str) -> Any:
    factors = [shown_in(name, unit)[0] for name, unit in zip(rows["parameter"], rows["unit"], strict=True)]
    return rows[column].to_numpy(dtype=float) * factors


def _panel(rows: pd.DataFrame) -> go.Heatmap:
    import plotly.graph_objects as go

    told = rows.assign(place=_columns(rows), told=_printed(rows, "predicted"))
    told["size"] = told["predicted"] / told["tolerance"]
    order = list(dict.fromkeys(told["kind"])), list(dict.fromkeys(told.sort_values("leg", kind="stable")["place"]))
    wide = {
        c: told.pivot(index="kind", columns="place", values=c).reindex(index=order[0], columns=order[1])
        for c in ("size", "told")
    }
    return go.Heatmap(
        z=np.round(wide["size"].to_numpy(), 3),
        x=order[1],
        y=[f"{label(kind)} " for kind in order[0]],
        text=[[plain(v) if v == v else "" for v in row] for row in wide["told"].to_numpy()],
        texttemplate="%{text}",
        coloraxis="coloraxis",
        xgap=1,
        ygap=1,
        hovertemplate="%{y} of %{x}: %{text}, %{z:.1f} tolerances<extra></extra>",
    )


def predicted_against_observed(absorbed: pd.DataFrame) -> go.Figure:
    """What the fit did against what was predicted, a panel per kind of parameter, with the line of equality."""
    from plotly.subplots import make_subplots

    told = absorbed.assign(kind=_kinds(absorbed))
    told = told.assign(x=_printed(told, "predicted"), y=_printed(told, "observed"), bar=_BAR * _printed(told, "sigma"))
    kinds = list(dict.fromkeys(told["kind"]))
    columns = min(3, len(kinds))
    rows = -(-len(kinds) // columns)
    titles = [_panel_title(kind, told[told["kind"] == kind]) for kind in kinds]
    gap = 0.3 / rows
    grid = make_subplots(rows=rows, cols=columns, subplot_titles=titles, vertical_spacing=gap, horizontal_spacing=0.09)
    named: set[Any] = set()
    for k, kind in enumerate(kinds):
        place = {"row": k // columns + 1, "col": k % columns + 1}
        own = told[told["kind"] == kind]
        grid.add_trace(_equality(own), **place)
        for number, (key, part) in enumerate(groups(absorbed)):
            points = own.loc[own.index.isin(part.index)]
            if len(points):
                grid.add_trace(_points(points, key, number, key not in named), **place)
                named.add(key)
    subtitle = "Bars: 95 %; line: the fit did what was predicted"
    style(grid, "What the fit did against what linear algebra predicted", subtitle, 170 + 230 * rows)
    grid.update_xaxes(title={"text": "predicted", "standoff": 4}, row=rows)
    grid.update_yaxes(title={"text": "observed"}, col=1)
    grid.update_annotations(font={"size": 13})
    grid.update_layout(
        legend={"orientation": "h", "y": -0.16 / rows - 0.02, "yanchor": "top", "x": 0.0}, margin={"t": 100}
    )
    return grid


def _panel_title(kind: str, rows: pd.DataFrame) -> str:
    r = correlation(rows["x"], rows["y"])
    return label(kind) if r is None else f"{label(kind)}, r = {r:.3f}"


def _equality(rows: pd.DataFrame) -> go.Scatter:
    import plotly.graph_objects as go

    values = np.concatenate([rows["x"], rows["y"]]).astype(float)
    reach = [float(np.nanmin(values)), float(np.nanmax(values))]
    return go.Scatter(x=reach, y=reach, mode="lines", line={"color": GREY}, hoverinfo="skip", showlegend=False)


def _points(rows: pd.DataFrame, key: Group, number: int, named: bool) -> go.Scatter:
    import plotly.graph_objects as go

    colour, symbol = _COLOURS[number % len(_COLOURS)], _SYMBOLS[number % len(_SYMBOLS)]
    return go.Scatter(
        x=rows["x"],
        y=rows["y"],
        mode="markers",
        marker={"color": colour, "size": 7, "symbol": symbol},
        error_y={"type": "data", "array": rows["bar"], "thickness": 1, "width": 0},
        text=[label(name_of(name, leg)) for name, leg in zip(rows["parameter"], rows["leg"], strict=True)],
        hovertemplate="%{text}: predicted %{x:.3g}, observed %{y:.3g}<extra></extra>",
        name=label(group_words(key)),
        legendgroup=str(number),
        showlegend=named,
    )
