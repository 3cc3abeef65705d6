"""Figures of what modelling the causes brings: cause by cause, pose by pose, and beside the plain calibrations."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from truing.report.diagnosis.compared import POINTS, Compared
from truing.report.diagnosis.judged import Judged
from truing.report.figure_style import (
    BLUE,
    GREY,
    MANY_POINTS,
    ORANGE,
    label,
    pose_axis,
    sequence_title,
    size_axis,
    style,
)
from truing.report.numbers import plain, sign

if TYPE_CHECKING:
    import pandas as pd
    import plotly.graph_objects as go

_ROLES = {"calibration": (POINTS.fitted, BLUE), "verification": (POINTS.held_out, ORANGE)}
_SYMBOLS = {"calibration": "circle", "verification": "diamond"}
_ROW, _AROUND = 55, 200
_SERIES = (("before", "without the causes", ORANGE), ("after", "with them", BLUE))
_AS_IT_IS = (("before", "simulation as it is", BLUE),)
_LEGEND = {"orientation": "h", "y": 1.0, "yanchor": "bottom", "x": 0.0}


def misses(found: list[Judged], of: Compared = POINTS, start: str = "simulation as it is") -> go.Figure:
    """Measured minus predicted, rms, before and after each accepted cause of one unit, against what noise leaves."""
    import plotly.graph_objects as go

    stages = [f"{start} ", *(f"+ {label(row.name)} " for row in found)]
    figure = go.Figure()
    fitted, held_out = [row.rms for row in found], [row.held_out for row in found]
    for name, colour, sizes in ((of.fitted, BLUE, fitted), (of.held_out, ORANGE, held_out)):
        heights = [sizes[0][0], *(after for _, after in sizes)]
        if all(height is None for height in heights):
            continue
        marker, words = {"color": colour}, [plain(height) for height in heights]
        figure.add_trace(go.Bar(y=stages, x=heights, name=name, orientation="h", text=words, marker=marker))
    unit = sign(found[0].unit)
    subtitle = _floor_line(figure, found[-1].floor, unit, vertical=True)
    style(figure, "How far predictions miss, cause by cause", subtitle, _AROUND + _ROW * len(stages))
    figure.update_yaxes(autorange="reversed", automargin=True, type="category")
    figure.update_xaxes(title_text=f"rms of measured − predicted ({unit})", rangemode="tozero")
    figure.update_layout(legend=_LEGEND, margin={"t": 100})
    return figure


def _floor_line(figure: go.Figure, floor: float | None, unit: str, vertical: bool = False) -> str:
    """Draw what noise leaves, and return the line that says so."""
    if floor is None:
        return "What noise alone leaves is not known"
    draw = figure.add_vline if vertical else figure.add_hline
    draw(**{"x" if vertical else "y": floor}, line={"color": GREY, "dash": "dot", "width": 2})
    return f"Dotted: what noise alone leaves, {plain(floor)} {unit}"


def pose_by_pose(table: pd.DataFrame, floor: float | None, modelled: bool) -> go.Figure:
    """Rms of measured minus predicted at every pose, without and, where something was found, with it."""
    import plotly.graph_objects as go

    places, axis = pose_axis(table["pose"])
    roles = table["role"].replace("reference", "calibration").to_numpy()
    unit = sign(str(table["unit"].iloc[0]))
    figure = go.Figure()
    if modelled:
        figure.add_trace(_joins(places, table))
    shown = roles[0]  # the other role has the same colours and symbols of its own
    scatter = go.Scattergl if len(table) > MANY_POINTS else go.Scatter
    for when, words, colour in _SERIES if modelled else _AS_IT_IS:
        for role, (name, _) in _ROLES.items():
            own = roles == role
            if own.any():
                texts = [
                    f"pose {label(pose)}: rms {plain(rms)}, largest {plain(most)} {unit}"
                    for pose, rms, most in zip(
                        table["pose"][own], table[f"rms_{when}"][own], table[f"largest_{when}"][own], strict=True
                    )
                ]
                figure.add_trace(
                    scatter(
                        x=places[own],
                        y=table[f"rms_{when}"][own],
                        mode="markers",
                        marker={"color": colour, "symbol": _SYMBOLS[role], "size": 9 if role == "verification" else 6},
                        name=words if role == shown else f"{words}, {name}",
                        legendgroup=when,
                        showlegend=bool(role == shown),
                        text=texts,
                        hovertemplate="%{text}<extra></extra>",
                    )
                )
    sizes = np.concatenate([table["rms_before"], table["rms_after"]])
    scale = size_axis(sizes)
    subtitle = _floor_line(figure, floor, unit)
    style(figure, "How far predictions miss, pose by pose", subtitle, 420)
    figure.update_xaxes(zeroline=False, **axis)
    figure.update_yaxes(title_text=sequence_title(f"rms of measured − predicted ({unit})", "type" in scale), **scale)
    figure.update_layout(legend=_LEGEND, margin={"t": 110})
    return figure


def _joins(places: np.ndarray, table: pd.DataFrame) -> go.Scatter:
    """A line from before to after at every pose."""
    import plotly.graph_objects as go

    x = np.repeat(places.astype(float), 3)
    y = np.stack([table["rms_before"], table["rms_after"], np.full(len(table), np.nan)], axis=1).ravel()
    line = {"color": GREY, "width": 1}
    return go.Scatter(x=x, y=y, mode="lines", line=line, opacity=0.4, hoverinfo="skip", showlegend=False)


def beside_calibrations(errors: pd.DataFrame) -> go.Figure:
    """Rms error of position of each calibration (column ``called``), fitted and held-out poses apart."""
    import plotly.graph_objects as go

    roles = errors["role"].replace("reference", "calibration")
    squares = errors["position_error_um"].astype(float) ** 2
    sizes = np.sqrt(squares.groupby([errors["called"], roles]).mean())
    names = list(dict.fromkeys(errors["called"]))
    figure = go.Figure()
    for role, (words, colour) in _ROLES.items():
        own = [float(sizes.get((name, role), np.nan)) for name in names]
        if not np.isfinite(own).any():
            continue
        figure.add_trace(
            go.Bar(
                y=[f"{label(name)} " for name in names],
                x=own,
                name=words,
                orientation="h",
                marker={"color": colour},
                text=[plain(size) for size in own],
            )
        )
    subtitle = _floor_line(figure, _noise(errors), "µm", vertical=True)
    title = "Position: the extended model beside plain calibrations"
    style(figure, title, subtitle, _AROUND + _ROW * len(names))
    figure.update_yaxes(autorange="reversed", automargin=True, type="category")
    scale = size_axis(sizes.to_numpy())
    figure.update_xaxes(title_text=sequence_title("rms error of position (µm)", "type" in scale), **scale)
    figure.update_layout(legend=_LEGEND, margin={"t": 100})
    return figure


def _noise(errors: pd.DataFrame) -> float | None:
    """What noise leaves in the held-out poses, else in all, of the last calibration told."""
    if "position_noise_um" not in errors:
        return None
    own = errors[errors["called"] == errors["called"].iloc[-1]]
    own = own[own["role"] == "verification"] if (own["role"] == "verification").any() else own
    known = own["position_noise_um"].dropna().to_numpy(dtype=float)
    return float(np.sqrt(np.mean(known**2))) if len(known) else None
