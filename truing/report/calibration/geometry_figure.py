"""The geometry seen from above, with amplified deviations of the identified joints (telescope report, figure 18)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from truing.report.calibration.calibrations import deformation_words, in_order
from truing.report.figure_style import BLUE, GREEN, GREY, ORANGE, RED, label, style
from truing.report.numbers import quantity
from truing.report.scene.view import round_gain

if TYPE_CHECKING:
    import pandas as pd
    import plotly.graph_objects as go

_JOINTS = {"a": ("lower joint a", "square-open"), "b": ("upper joint b", "circle-open")}
# Open symbols of different kinds, so that those at the same place can all be seen.
_DRAWN_AS = {
    "none": (ORANGE, "circle-open", 14),
    "linear": (BLUE, "x-thin", 9),
    "matrix": (GREEN, "triangle-up-open", 12),
}
_OTHER = (RED, "diamond-open", 12)
# The largest deviation is drawn so long, in parts of the mechanism's width.
_LARGEST = 0.25
_CIRCLE = np.linspace(0.0, 2.0 * np.pi, 33)


def has_geometry(fitted: pd.DataFrame) -> bool:
    """Whether the places of a joint seen from above can be told from a table of parameters in mm."""
    return any(len(_places(fitted, joint)) for joint in _JOINTS)


def geometry_picture(fits: Mapping[str, pd.DataFrame]) -> go.Figure:
    """Nominal joints from above, and where each deformation model puts them, of one model of the structure.

    ``fits``: parameters by what the estimator is called, a panel each.
    """
    from plotly.subplots import make_subplots

    panels = [{joint: found for joint in _JOINTS if len(found := _places(own, joint))} for own in fits.values()]
    every = [found for places in panels for found in places.values()]
    gain, extent = _gain(every), _extent(every)
    figure = make_subplots(rows=1, cols=len(panels), subplot_titles=[label(name) for name in fits])
    for column, (places, own) in enumerate(zip(panels, fits.values(), strict=True), 1):
        for trace in _traces(places, in_order(own["deformation"]), gain):
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


def _traces(places: dict[str, pd.DataFrame], deformations: list[str], gain: float) -> list[go.Scatter]:
    """Everything of one panel: legs, nominal joints with their tolerances, and the joints as identified."""
    drawn = _legs(places)
    for joint, found in places.items():
        circles = _tolerances(found, gain)
        drawn += [_nominal(found, joint), *(c.update(showlegend=joint == next(iter(places))) for c in circles)]
    return drawn + [trace for d in deformations for trace in _moved(list(places.values()), d, gain)]


def _places(fitted: pd.DataFrame, joint: str) -> pd.DataFrame:
    """Per leg and deformation: nominal place x, y and deviation dx, dy in mm, tolerance; a fixed coordinate stays."""
    own = fitted[fitted["parameter"].isin([f"{joint}_x", f"{joint}_y"]) & (fitted["unit"] == "mm")]
    own = own.assign(deviation=own["identified"] - own["nominal"], axis=own["parameter"].str[-1])
    columns = [c for c in ("nominal", "deviation", "tolerance") if c in own]
    wide = own.pivot(index=["deformation", "leg"], columns="axis", values=columns)
    if not len(wide) or not {("nominal", "x"), ("nominal", "y")} <= set(wide.columns):
        return own.iloc[:0]
    found = wide["nominal"].rename_axis(columns=None)
    found = found.assign(dx=wide[("deviation", "x")], dy=wide[("deviation", "y")])
    found["tolerance"] = wide["tolerance"].mean(axis=1) if "tolerance" in columns else np.nan
    return found.dropna(subset=["x", "y"]).fillna({"dx": 0.0, "dy": 0.0}).reset_index()


def _extent(places: list[pd.DataFrame]) -> float:
    points = np.concatenate([found[["x", "y"]].to_numpy() for found in places])
    return float(np.ptp(points, axis=0).max()) or 1.0


def _gain(places: list[pd.DataFrame]) -> float:
    largest = max(float(np.hypot(found["dx"], found["dy"]).max()) for found in places)
    return round_gain(_LARGEST * _extent(places) / max(largest, 1e-9))


def _legs(places: dict[str, pd.DataFrame]) -> list[go.Scatter]:
    """A thin line from the lower to the upper joint of each leg."""
    import plotly.graph_objects as go

    if len(places) < 2:
        return []
    lower, upper = (found.drop_duplicates("leg")[["leg", "x", "y"]] for found in places.values())
    both = lower.merge(upper, on="leg", suffixes=("", "_upper"))
    gap = np.full(len(both), np.nan)
    x = np.stack([both["x"], both["x_upper"], gap], 1).ravel()
    y = np.stack([both["y"], both["y_upper"], gap], 1).ravel()
    line = {"color": GREY, "width": 1, "dash": "dot"}
    return [go.Scatter(x=x, y=y, mode="lines", line=line, name="leg", hoverinfo="skip")]


def _nominal(found: pd.DataFrame, joint: str) -> go.Scatter:
    import plotly.graph_objects as go

    own, (name, symbol) = found.drop_duplicates("leg"), _JOINTS[joint]
    return go.Scatter(
        x=own["x"],
        y=own["y"],
        mode="markers+text",
        marker={"color": GREY, "size": 6, "symbol": symbol},
        text=[f"{joint}{int(leg)}" for leg in own["leg"]],
        textposition="bottom center",
        textfont={"color": GREY, "size": 11},
        name=f"{name}, nominal",
        hoverinfo="skip",
    )


def _tolerances(found: pd.DataFrame, gain: float) -> list[go.Scatter]:
    """One tolerance around each nominal place, amplified like the deviations."""
    import plotly.graph_objects as go

    own = found.drop_duplicates("leg")
    own = own[np.isfinite(own["tolerance"])]
    if not len(own):
        return []
    radius = gain * own["tolerance"].to_numpy()[:, None]
    x, y = (
        np.pad(own[a].to_numpy()[:, None] + radius * turn(_CIRCLE), ((0, 0), (0, 1)), constant_values=np.nan).ravel()
        for a, turn in (("x", np.cos), ("y", np.sin))
    )
    line = {"color": GREY, "width": 1}
    return [go.Scatter(x=np.round(x, 3), y=np.round(y, 3), mode="lines", line=line, name="tolerance", hoverinfo="skip")]


def _moved(places: list[pd.DataFrame], deformation: str, gain: float) -> list[go.Scatter]:
    """Where one deformation model puts the joints, with a line from their nominal places."""
    import pandas as pd
    import plotly.graph_objects as go

    own = pd.concat([found[found["deformation"] == deformation] for found in places], ignore_index=True)
    colour, symbol, size = _DRAWN_AS.get(deformation, _OTHER)
    end_x, end_y, gap = own["x"] + gain * own["dx"], own["y"] + gain * own["dy"], np.full(len(own), np.nan)
    x, y = (np.stack([own[a], end, gap], 1).ravel() for a, end in (("x", end_x), ("y", end_y)))
    words = label(deformation_words(deformation))
    common: dict[str, Any] = {"legendgroup": words, "name": words}
    text = [
        f"leg {int(leg)}: {quantity(dx, 'mm')}, {quantity(dy, 'mm')}"
        for leg, dx, dy in zip(own["leg"], own["dx"], own["dy"], strict=True)
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
