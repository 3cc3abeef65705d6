"""Figures of a sensor's calibration: how far models miss what was held out, its errors by class, its merit."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from truing.report.figure_style import BLUE, GREEN, GREY, ORANGE, RED, style
from truing.report.numbers import plain
from truing.report.sensor.axes import LOADS

if TYPE_CHECKING:
    import pandas as pd
    import plotly.graph_objects as go

_COLOURS = dict(zip(LOADS, (BLUE, ORANGE, GREEN, RED, "#CC79A7", "#56B4E9"), strict=True))
_BAR = 1.96
_WIDE = 30.0
# By matrix and model: how it is named, and drawn.
_SHOWN = {
    ("G", ""): ("G", GREY, "line-ew-open"),
    ("G", "elastic joints"): ("G, joints that resist", GREEN, "square-open"),
    ("G'", ""): ("G'", ORANGE, "diamond-open"),
    ("G_B'", ""): ("G_B'", BLUE, "circle"),
}


def held_out_errors(choice: pd.DataFrame, largest: dict[str, float]) -> go.Figure:
    """Rms error of every component in loads that a model has not seen, by model, in per cent of the largest load."""
    import plotly.graph_objects as go

    held = choice[choice["figure"] == "heldout_rms"]
    chosen = set(choice.loc[(choice["figure"] == "chosen") & (choice["value"] == 1.0), "model"])
    models = list(dict.fromkeys(held["model"]))
    names = {model: f"{_name(model)}{'  ◀ chosen' if model in chosen else ''}" for model in models}
    figure, every = go.Figure(), []
    for load in [load for load in LOADS if load in largest]:
        own = held[held["subject"] == load]
        share = 100.0 * own["value"].to_numpy() / largest[load]
        every += share.tolist()
        figure.add_trace(
            go.Scatter(
                x=share,
                y=[names[model] for model in own["model"]],
                mode="markers",
                name=load,
                marker={"color": _COLOURS[load], "size": 9},
                hovertemplate="%{y}: " + load + " %{x:.3g} %<extra></extra>",
            )
        )
    wide = max(every) > _WIDE * min(every) if every else False
    style(figure, "Errors of held-out loads", "Rms, in per cent of each axis's largest load", 170 + 34 * len(models))
    figure.update_xaxes(title_text="% of the largest load", type="log" if wide else "linear", dtick=1 if wide else None)
    if not wide:
        figure.update_xaxes(rangemode="tozero")
    figure.update_yaxes(autorange="reversed", automargin=True, type="category")
    figure.update_layout(legend={"orientation": "h", "y": 1.0, "yanchor": "bottom", "x": 0.0}, margin={"t": 110})
    return figure


def _name(model: str) -> str:
    return model.replace(", linear", "").replace("zero none", "no zero").replace("zero common", "one zero")


def error_classes(classes: pd.DataFrame) -> go.Figure:
    """The largest error of every class and axis, with what noise alone would exceed once in twenty times."""
    import plotly.graph_objects as go

    told = classes.dropna(subset=["value"])
    worst = told.assign(size=told["value"].abs()).sort_values("size").groupby(["error_class", "load"]).tail(1)
    order = list(dict.fromkeys(classes["error_class"]))
    names = [name for name in order if (worst["error_class"] == name).any()]
    loads = [load for load in LOADS if (worst["load"] == load).any()]
    figure = go.Figure()
    for load in loads:
        own = worst[worst["load"] == load].set_index("error_class").reindex(names)
        figure.add_trace(
            go.Bar(
                x=names,
                y=own["size"],
                name=load,
                marker={"color": _COLOURS[load]},
                offsetgroup=load,
                error_y=_above_zero(own["size"], _BAR * own["sigma"]),
                hovertemplate=load + ", %{x}: %{y:.3g} %<extra></extra>",
            )
        )
    figure.update_layout(barmode="group", bargap=0.25)
    _limits(figure, worst, names, loads)
    subtitle = "Black line: what noise alone would exceed once in twenty times; a bar below it was not seen. Bars: 95 %"
    style(figure, "Errors by class, in per cent of the range (interpolation: of the load)", subtitle, 420)
    figure.update_yaxes(title_text="%", rangemode="tozero")
    figure.update_layout(legend={"orientation": "h", "y": 1.0, "yanchor": "bottom", "x": 0.0}, margin={"t": 110})
    return figure


def _above_zero(size: pd.Series, reach: pd.Series) -> dict[str, object]:
    """Bars that end at zero, below which no size is."""
    down = np.minimum(reach, size)
    return {"type": "data", "array": reach, "arrayminus": down, "symmetric": False, "thickness": 1, "width": 2}


def _limits(figure: go.Figure, worst: pd.DataFrame, names: list[str], loads: list[str]) -> None:
    """A line across every bar at its limit."""
    table = worst.set_index(["error_class", "load"])["limit"]
    width = 0.75 / len(loads)
    for i, name in enumerate(names):
        for j, load in enumerate(loads):
            if (name, load) in table.index:
                middle = i + (j - 0.5 * (len(loads) - 1)) * width
                limit = float(table[name, load])
                figure.add_shape(
                    type="line",
                    x0=middle - 0.5 * width,
                    x1=middle + 0.5 * width,
                    y0=limit,
                    y1=limit,
                    line={"color": "black", "width": 2},
                )


def merit_figure(merit: pd.DataFrame, length_m: float) -> go.Figure:
    """Sensitivities and condition of G, G' and, where leg forces are known, G_B', moments over a length."""
    import plotly.graph_objects as go

    at = merit[np.isclose(merit["length_m"].to_numpy(dtype=float), length_m)]
    figure = go.Figure()
    for (matrix, model), own in at[at["matrix"] != "G_B"].groupby(["matrix", "model"], sort=False):
        name, colour, symbol = _SHOWN.get((matrix, model), _SHOWN[matrix, ""])
        each = own[own["figure"] == "sensitivity"].set_index("subject").reindex(LOADS)
        condition = own[own["figure"] == "condition"].iloc[0]
        sigmas = np.array([*each["sigma"], condition["sigma"]], dtype=float)
        figure.add_trace(
            go.Scatter(
                x=[*(f"S {load}" for load in LOADS), "condition"],
                y=[*each["value"], condition["value"]],
                mode="markers",
                name=name,
                marker={"color": colour, "size": 10, "symbol": symbol},
                error_y={"type": "data", "array": _BAR * np.nan_to_num(sigmas), "width": 3},
                hovertemplate="%{x}: %{y:.4g}<extra>" + name + "</extra>",
            )
        )
    subtitle = f"Moments over {plain(length_m)} m, at which they weigh as much as forces. Bars: 95 %"
    style(figure, "Sensitivities and condition number", subtitle, 380)
    figure.update_yaxes(rangemode="tozero")
    figure.update_layout(legend={"orientation": "h", "y": 1.0, "yanchor": "bottom", "x": 0.0}, margin={"t": 110})
    return figure
