"""Figures of the calibrations: errors of all, correlations of one, and the geometry from above."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from truing.report.calibration.calibrations import Key, calibration_name, deformation_words, in_order
from truing.report.figure_style import BLUE, GREEN, GREY, ORANGE, RED, label, sequence_title, style
from truing.report.numbers import plain, quantity
from truing.report.parameter_names import name_of
from truing.report.scene.view import round_gain

_ROLES = {"calibration": ("calibration poses", BLUE), "verification": ("held-out poses", ORANGE)}
_ERRORS = (
    ("position_error_um", "position_noise_um", "position error (µm)", "µm"),
    ("orientation_error_arcsec", "orientation_noise_arcsec", "orientation error (arcsec)", "arcsec"),
)
_PALE = 0.4
# Heights in pixels: of a row, and of the space around and between the panels.
_ROW, _AROUND, _OUTSIDE, _BETWEEN = 52, 240, 158, 78
# Ratio of errors above which the smaller one would be invisible on a linear axis.
_FAR = 30.0
# Largest number of parameters that are distinguishable in a figure of a page's width.
_PARAMETERS_SHOWN = 130
_LABEL_PX = 10  # height of a parameter with its name in the map of correlations

_JOINTS = {"a": ("lower joint a", "square-open"), "b": ("upper joint b", "circle-open")}
# Open symbols of different kinds, so that those at the same place can all be seen.
_DRAWN_AS = {
    "none": (ORANGE, "circle-open", 14),
    "linear": (BLUE, "x-thin", 9),
    "matrix": (GREEN, "triangle-up-open", 12),
}
_OTHER = (RED, "diamond-open", 12)
# Length of the largest deviation in the figure, as a share of the mechanism's width.
_LARGEST = 0.25
_CIRCLE = np.linspace(0.0, 2.0 * np.pi, 33)


def errors(accuracy: pd.DataFrame, chosen: Key | None) -> go.Figure:
    """Return mean and maximum error of each calibration, position above and orientation below (report, figures 15 to
    17)."""
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
    subtitle += f". Dotted: rms by noise alone, {' and '.join(floors)}" if floors else " over the poses"
    style(grid, "Errors of the calibrated models", subtitle, height)
    grid.update_yaxes(autorange="reversed", automargin=True)
    grid.update_layout(barmode="group", bargap=0.25, legend=_legend(), margin={"t": 108})
    return grid


def _axis(sizes: pd.DataFrame) -> dict[str, object]:
    """Return an axis from zero, or logarithmic if the worst calibration would make the best invisible."""
    mean, largest = (sizes[part][sizes[part] > 0.0] for part in ("mean", "max"))
    if not len(mean) or largest.max() < _FAR * largest.min():
        return {"rangemode": "tozero"}
    ends = np.log10([0.5 * mean.min(), 1.2 * largest.max()])
    return {"type": "log", "range": [float(end) for end in ends], "dtick": 1}


def _legend() -> dict[str, object]:
    return {"orientation": "h", "y": 1.0, "yanchor": "bottom", "x": 0.0, "itemclick": False, "itemdoubleclick": False}


def _mean_and_largest(accuracy: pd.DataFrame) -> pd.DataFrame:
    columns = [error for error, *_ in _ERRORS]
    statistics = accuracy.groupby(["deformation", "model", "role"], sort=False)[columns].agg(["mean", "max"])
    order = in_order(accuracy["deformation"])
    return statistics.loc[order]


def _bars(sizes: pd.DataFrame, error: str, role: str, unit: str, named: bool) -> list[go.Bar]:
    """Return pale bars of the maximum with bars of the mean in front."""
    name, colour = _ROLES[role]
    labels = [[label(d) for d, _ in sizes.index], [label(m) for _, m in sizes.index]]
    common: dict[str, object] = {"y": labels, "orientation": "h", "offsetgroup": role, "legendgroup": role}
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
    """Return the rms by noise alone at held-out poses of the chosen calibration, otherwise at all poses."""
    if column not in accuracy:
        return None
    errors = accuracy
    if chosen is not None:
        errors = errors[(errors["model"] == chosen[0]) & (errors["deformation"] == chosen[1])]
    errors = errors[errors["role"] == "verification"] if (errors["role"] == "verification").any() else errors
    floor = (
        float(np.sqrt(np.mean(errors[column].dropna().to_numpy(dtype=float) ** 2)))
        if errors[column].notna().any()
        else 0
    )
    return floor or None


def correlation_map(correlations: pd.DataFrame, key: Key) -> go.Figure:
    """Return the correlations of one calibration's parameters as a heat map, leg by leg, in per cent."""
    names, values = _symmetric(correlations)
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
    subtitle = (
        f"Of {label(calibration_name(key))}. White: independent. Dark: only a combination of the two is well known"
    )
    style(figure, "Correlations between the identified parameters", subtitle, max(620, 160 + _LABEL_PX * len(names)))
    indices = list(range(len(names)))
    axis = {"type": "category", "tickvals": indices, "ticktext": names, "showgrid": False, "tickfont": {"size": 8}}
    figure.update_xaxes(**axis, tickangle=-90, automargin=True)
    figure.update_yaxes(**axis, autorange="reversed", automargin=True)
    return figure


def _symmetric(correlations: pd.DataFrame) -> tuple[list[str], np.ndarray]:
    """Return names of the parameters leg by leg, and the correlations (N, N) in whole per cent."""
    ends = [("leg", "parameter"), ("other_leg", "other_parameter")]
    pairs = [
        list(zip(correlations[leg].astype(float).fillna(np.inf), correlations[name], strict=True)) for leg, name in ends
    ]
    strength: dict[tuple[float, str], float] = {}
    for end, r in [(end, abs(r)) for side in pairs for end, r in zip(side, correlations["correlation"], strict=True)]:
        strength[end] = max(strength.get(end, 0.0), r)
    strongest = sorted(strength, key=lambda end: -strength[end])[:_PARAMETERS_SHOWN]
    order = [end for end in strength if end in set(strongest)]
    order.sort(key=lambda end: end[0])
    index_of = {end: k for k, end in enumerate(order)}
    values = 100 * np.eye(len(order), dtype=np.int8)
    for a, b, r in zip(*pairs, correlations["correlation"], strict=True):
        if a in index_of and b in index_of:
            values[index_of[a], index_of[b]] = values[index_of[b], index_of[a]] = round(100 * r)
    names = [label(name_of(name, leg if np.isfinite(leg) else np.nan)) for leg, name in order]
    return names, values


def has_geometry(fitted: pd.DataFrame) -> bool:
    """Return True if a table of parameters in mm determines the places of a joint from above."""
    return any(len(_joint_positions(fitted, joint)) for joint in _JOINTS)


def geometry_picture(fits: Mapping[str, pd.DataFrame]) -> go.Figure:
    """Return nominal joints from above and their identified places, for all deformation models of one structure.

    ``fits``: parameters by name of the estimator, a panel each.
    """
    panels = [
        {joint: positions for joint in _JOINTS if len(positions := _joint_positions(fit, joint))}
        for fit in fits.values()
    ]
    every = [rows for joints in panels for rows in joints.values()]
    gain, extent = _gain(every), _extent(every)
    figure = make_subplots(rows=1, cols=len(panels), subplot_titles=[label(name) for name in fits])
    for column, (joints, fitted) in enumerate(zip(panels, fits.values(), strict=True), 1):
        for trace in _traces(joints, in_order(fitted["deformation"]), gain):
            trace.showlegend = trace.showlegend is not False and column == 1
            figure.add_trace(trace, row=1, col=column)
        figure.update_yaxes(scaleanchor=f"x{column}" if column > 1 else "x", row=1, col=column)
    step = round_gain(extent / 10.0)
    subtitle = f"{quantity(step, 'mm')} on the axes = {quantity(step / gain, 'mm')} of deviation"
    title = f"Identified joints seen from above, deviations amplified {gain:g} times"
    style(figure, title, subtitle, 620)
    figure.update_xaxes(title_text="x (mm)", constrain="domain", zeroline=False)
    figure.update_yaxes(constrain="domain", zeroline=False)
    figure.update_yaxes(title_text="y (mm)", col=1)
    figure.update_annotations(font={"size": 13})
    figure.update_layout(legend={"orientation": "h", "y": -0.1, "yanchor": "top", "x": 0.0}, margin={"t": 100})
    return figure


def _traces(joints: dict[str, pd.DataFrame], deformations: list[str], gain: float) -> list[go.Scatter]:
    """Return all traces of one panel: legs, nominal joints with tolerances, and identified joints."""
    drawn = _legs(joints)
    for joint, rows in joints.items():
        circles = _tolerances(rows, gain)
        drawn += [_nominal(rows, joint), *(c.update(showlegend=joint == next(iter(joints))) for c in circles)]
    return drawn + [trace for d in deformations for trace in _joint_lines(list(joints.values()), d, gain)]


def _joint_positions(fitted: pd.DataFrame, joint: str) -> pd.DataFrame:
    """Return per leg and deformation the nominal place x, y, deviation dx, dy in mm, and tolerance; zero deviation if
    fixed."""
    rows = fitted[fitted["parameter"].isin([f"{joint}_x", f"{joint}_y"]) & (fitted["unit"] == "mm")]
    rows = rows.assign(deviation=rows["identified"] - rows["nominal"], axis=rows["parameter"].str[-1])
    columns = [c for c in ("nominal", "deviation", "tolerance") if c in rows]
    wide = rows.pivot(index=["deformation", "leg"], columns="axis", values=columns)
    if not len(wide) or not {("nominal", "x"), ("nominal", "y")} <= set(wide.columns):
        return rows.iloc[:0]
    joints = wide["nominal"].rename_axis(columns=None)
    joints = joints.assign(dx=wide[("deviation", "x")], dy=wide[("deviation", "y")])
    joints["tolerance"] = wide["tolerance"].mean(axis=1) if "tolerance" in columns else np.nan
    return joints.dropna(subset=["x", "y"]).fillna({"dx": 0.0, "dy": 0.0}).reset_index()


def _extent(joints: list[pd.DataFrame]) -> float:
    points = np.concatenate([joint[["x", "y"]].to_numpy() for joint in joints])
    return float(np.ptp(points, axis=0).max()) or 1.0


def _gain(joints: list[pd.DataFrame]) -> float:
    largest = max(float(np.hypot(joint["dx"], joint["dy"]).max()) for joint in joints)
    return round_gain(_LARGEST * _extent(joints) / max(largest, 1e-9))


def _legs(joints: dict[str, pd.DataFrame]) -> list[go.Scatter]:
    """Return a thin line from the lower to the upper joint of each leg."""
    if len(joints) < 2:
        return []
    lower, upper = (rows.drop_duplicates("leg")[["leg", "x", "y"]] for rows in joints.values())
    both = lower.merge(upper, on="leg", suffixes=("", "_upper"))
    gap = np.full(len(both), np.nan)
    x = np.stack([both["x"], both["x_upper"], gap], 1).ravel()
    y = np.stack([both["y"], both["y_upper"], gap], 1).ravel()
    line = {"color": GREY, "width": 1, "dash": "dot"}
    return [go.Scatter(x=x, y=y, mode="lines", line=line, name="leg", hoverinfo="skip")]


def _nominal(rows: pd.DataFrame, joint: str) -> go.Scatter:
    joints, (name, symbol) = rows.drop_duplicates("leg"), _JOINTS[joint]
    return go.Scatter(
        x=joints["x"],
        y=joints["y"],
        mode="markers+text",
        marker={"color": GREY, "size": 6, "symbol": symbol},
        text=[f"{joint}{int(leg)}" for leg in joints["leg"]],
        textposition="bottom center",
        textfont={"color": GREY, "size": 11},
        name=f"{name}, nominal",
        hoverinfo="skip",
    )


def _tolerances(rows: pd.DataFrame, gain: float) -> list[go.Scatter]:
    """Return a circle of one tolerance around each nominal place, amplified like the deviations."""
    joints = rows.drop_duplicates("leg")
    joints = joints[np.isfinite(joints["tolerance"])]
    if not len(joints):
        return []
    radius = gain * joints["tolerance"].to_numpy()[:, None]
    x, y = (
        np.pad(joints[a].to_numpy()[:, None] + radius * turn(_CIRCLE), ((0, 0), (0, 1)), constant_values=np.nan).ravel()
        for a, turn in (("x", np.cos), ("y", np.sin))
    )
    line = {"color": GREY, "width": 1}
    return [go.Scatter(x=np.round(x, 3), y=np.round(y, 3), mode="lines", line=line, name="tolerance", hoverinfo="skip")]


def _joint_lines(joints: list[pd.DataFrame], deformation: str, gain: float) -> list[go.Scatter]:
    """Return the joints of one deformation model, with a line from their nominal places."""
    rows = pd.concat([joint[joint["deformation"] == deformation] for joint in joints], ignore_index=True)
    colour, symbol, size = _DRAWN_AS.get(deformation, _OTHER)
    end_x, end_y, gap = (rows["x"] + gain * rows["dx"], rows["y"] + gain * rows["dy"], np.full(len(rows), np.nan))
    x, y = (np.stack([rows[a], end, gap], 1).ravel() for a, end in (("x", end_x), ("y", end_y)))
    words = label(deformation_words(deformation))
    common: dict[str, object] = {"legendgroup": words, "name": words}
    text = [
        f"leg {int(leg)}: {quantity(dx, 'mm')}, {quantity(dy, 'mm')}"
        for leg, dx, dy in zip(rows["leg"], rows["dx"], rows["dy"], strict=True)
    ]
    return [
        go.Scatter(
            x=x, y=y, mode="lines", line={"color": colour, "width": 1}, hoverinfo="skip", showlegend=False, **common
        ),
        go.Scatter(
            x=end_x,
            y=end_y,
            mode="markers",
            marker={"color": colour, "symbol": symbol, "size": size, "line": {"width": 2, "color": colour}},
            text=text,
            hovertemplate="%{text}<extra>" + words + "</extra>",
            **common,
        ),
    ]
