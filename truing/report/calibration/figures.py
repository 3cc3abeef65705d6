"""Figures of the calibrations: errors of all of them, and correlations between the parameters of one."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from truing.report.calibration.calibrations import Key, called, in_order
from truing.report.figure_style import BLUE, GREY, ORANGE, label, sequence_title, style
from truing.report.numbers import plain
from truing.report.parameter_names import name_of

if TYPE_CHECKING:
    import pandas as pd
    import plotly.graph_objects as go

_ROLES = {"calibration": ("calibration poses", BLUE), "verification": ("held-out poses", ORANGE)}
_ERRORS = (
    ("position_error_um", "position_noise_um", "position error (µm)", "µm"),
    ("orientation_error_arcsec", "orientation_noise_arcsec", "orientation error (arcsec)", "arcsec"),
)
_PALE = 0.4
# Heights in pixels: of a calibration, of all that stands around and between the panels, outside and between them.
_ROW, _AROUND, _OUTSIDE, _BETWEEN = 52, 240, 158, 78
# Of errors that differ by more than this, the smaller cannot be seen beside the larger.
_FAR = 30.0
# More parameters than this are not told apart in a picture of a page's width.
_PARAMETERS_SHOWN = 130


def errors(accuracy: pd.DataFrame, chosen: Key | None) -> go.Figure:
    """Mean and maximum error of each calibration, position above and orientation below (report, figures 15 to 17)."""
    from plotly.subplots import make_subplots

    accuracy = accuracy.assign(role=accuracy["role"].replace("reference", "calibration"))
    sizes = _mean_and_largest(accuracy)
    height = _AROUND + _ROW * sizes.groupby(level=["model", "deformation"]).ngroups
    grid = make_subplots(rows=2, cols=1, vertical_spacing=_BETWEEN / (height - _OUTSIDE))
    floors = []
    for row, (error, noise, words, unit) in enumerate(_ERRORS, 1):
        for role in [role for role in _ROLES if role in set(accuracy["role"])]:
            for trace in _bars(sizes.xs(role, level="role"), error, role, unit, row == 1):
                grid.add_trace(trace, row=row, col=1)
        floor = _floor(accuracy, noise, chosen)
        if floor is not None:
            grid.add_vline(x=floor, line={"color": GREY, "dash": "dot", "width": 2}, row=row, col=1)
            floors.append(f"{plain(floor)} {unit}")
        axis = _axis(sizes[error])
        grid.update_xaxes(title_text=sequence_title(words, "type" in axis), **axis, row=row, col=1)
    subtitle = "Full colour: mean; pale: maximum"
    subtitle += f". Dotted: rms that noise alone leaves, {' and '.join(floors)}" if floors else " over the poses"
    style(grid, "How far the calibrated models miss", subtitle, height)
    grid.update_yaxes(autorange="reversed", automargin=True)
    grid.update_layout(barmode="group", bargap=0.25, legend=_legend(), margin={"t": 108})
    return grid


def _axis(sizes: pd.DataFrame) -> dict[str, Any]:
    """An axis from zero; logarithmic where the worst calibration would leave nothing to be seen of the best."""
    mean, largest = (sizes[part][sizes[part] > 0.0] for part in ("mean", "max"))
    if not len(mean) or largest.max() < _FAR * largest.min():
        return {"rangemode": "tozero"}
    ends = np.log10([0.5 * mean.min(), 1.2 * largest.max()])
    return {"type": "log", "range": [float(end) for end in ends], "dtick": 1}


def _legend() -> dict[str, Any]:
    return {"orientation": "h", "y": 1.0, "yanchor": "bottom", "x": 0.0, "itemclick": False, "itemdoubleclick": False}


def _mean_and_largest(accuracy: pd.DataFrame) -> pd.DataFrame:
    columns = [error for error, *_ in _ERRORS]
    by = accuracy.groupby(["deformation", "model", "role"], sort=False)[columns].agg(["mean", "max"])
    order = in_order(accuracy["deformation"])
    return by.loc[order]


def _bars(sizes: pd.DataFrame, error: str, role: str, unit: str, named: bool) -> list[go.Bar]:
    """The maximum, pale, with the mean before it."""
    import plotly.graph_objects as go

    name, colour = _ROLES[role]
    places = [[label(d) for d, _ in sizes.index], [label(m) for _, m in sizes.index]]
    common: dict[str, Any] = {"y": places, "orientation": "h", "offsetgroup": role, "legendgroup": role}
    template = "%{y}<br>" + name + ", {}: %{{x:.2f}} " + unit + "<extra></extra>"
    return [
        go.Bar(
            x=sizes[(error, part)].to_numpy(),
            name=name,
            marker={"color": colour, "opacity": opacity, "line": {"width": 0}},
            hovertemplate=template.replace("{}", words).replace("{{", "{").replace("}}", "}"),
            showlegend=named and part == "mean",
            **common,
        )
        for part, words, opacity in (("max", "maximum", _PALE), ("mean", "mean", 1.0))
    ]


def _floor(accuracy: pd.DataFrame, column: str, chosen: Key | None) -> float | None:
    """Rms that noise leaves in the held-out poses of the chosen calibration, else in all poses."""
    if column not in accuracy:
        return None
    own = accuracy
    if chosen is not None:
        own = own[(own["model"] == chosen[0]) & (own["deformation"] == chosen[1])]
    own = own[own["role"] == "verification"] if (own["role"] == "verification").any() else own
    floor = float(np.sqrt(np.mean(own[column].dropna().to_numpy(dtype=float) ** 2))) if own[column].notna().any() else 0
    return floor or None


def correlation_map(own: pd.DataFrame, key: Key) -> go.Figure:
    """Correlations between the parameters of one calibration as a heat map, leg by leg, in per cent."""
    import plotly.graph_objects as go

    names, legs, values = _symmetric(own)
    ticks = _middles(legs)
    figure = go.Figure()
    figure.add_trace(
        go.Heatmap(
            z=values,
            x=names,
            y=names,
            zmin=-100,
            zmax=100,
            colorscale="RdBu_r",
            colorbar={"title": {"text": "%"}, "thickness": 16, "tickvals": [-100, 0, 100]},
            hovertemplate="%{y} and %{x}: %{z} %<extra></extra>",
        )
    )
    subtitle = f"Of {label(called(key))}. White: independent. Dark: only a combination of the two is known well"
    style(figure, "Correlations between the identified parameters", subtitle, 620)
    axis = {"type": "category", "tickvals": list(ticks), "ticktext": list(ticks.values()), "showgrid": False}
    figure.update_xaxes(**axis)
    figure.update_yaxes(**axis, autorange="reversed", automargin=True)
    return figure


def _symmetric(own: pd.DataFrame) -> tuple[list[str], list[float], np.ndarray]:
    """Names of the parameters leg by leg, their legs, and the correlations (N, N) in whole per cent."""
    ends = [("leg", "parameter"), ("other_leg", "other_parameter")]
    pairs = [list(zip(own[leg].astype(float).fillna(np.inf), own[name], strict=True)) for leg, name in ends]
    strength: dict[tuple[float, str], float] = {}
    for end, r in [(end, abs(r)) for side in pairs for end, r in zip(side, own["correlation"], strict=True)]:
        strength[end] = max(strength.get(end, 0.0), r)
    kept = sorted(strength, key=lambda end: -strength[end])[:_PARAMETERS_SHOWN]
    order = [end for end in strength if end in set(kept)]
    order.sort(key=lambda end: end[0])
    place = {end: k for k, end in enumerate(order)}
    values = 100 * np.eye(len(order), dtype=np.int8)
    for a, b, r in zip(*pairs, own["correlation"], strict=True):
        if a in place and b in place:
            values[place[a], place[b]] = values[place[b], place[a]] = round(100 * r)
    names = [label(name_of(name, leg if np.isfinite(leg) else np.nan)) for leg, name in order]
    return names, [leg for leg, _ in order], values


def _middles(legs: list[float]) -> dict[int, str]:
    """Where along the axis each leg's parameters have their middle, and its name."""
    return {
        int(np.median(np.flatnonzero(np.array(legs) == leg))): f"leg {int(leg)}" if np.isfinite(leg) else "shared"
        for leg in dict.fromkeys(legs)
    }
