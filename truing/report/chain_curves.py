"""Figures of errors along a joint: error curves, and errors of guideways."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pandas as pd
import plotly.graph_objects as go
from numpy.typing import NDArray
from plotly.subplots import make_subplots

from truing.report.figure_style import BLUE, GREY, ORANGE, label, style

CURVES = (
    "Motion of the joint minus its reading, as the extended model holds it, with two standard deviations. The curve is "
    "drawn where the data determine it. Elsewhere predictions rest on the assumption that it is small."
)
GUIDEWAYS = (
    "Error of the carriage along its slide, as the extended model holds it, with its 95 % band. A shift is "
    "drawn from the straight line through both ends of the travel (end-point reference of ISO 230-1), a turn from the "
    "direction at the start. Dashed lines mark the first and last measured position."
)
_ARCSEC = 180.0 * 3600.0 / math.pi
_MM = 1e3
_MOTIONS = {"shift": ("straightness along", "µm", 1e6), "turn": ("turn about", "arcsec", _ARCSEC)}


def error_curves(curves: pd.DataFrame, joints: pd.DataFrame) -> go.Figure:
    """Return the error curves of the joints along their readings; angles in deg and mdeg, lengths in mm and um."""
    known = curves[curves["is_determined"]]
    names = list(dict.fromkeys(known["joint"]))
    slides = set(joints.loc[joints["joint_kind"] == "prismatic", "joint"])
    rows = -(-len(names) // 2)
    titles = [label(name) for name in names]
    figure = make_subplots(rows=rows, cols=2, subplot_titles=titles, vertical_spacing=0.35 / rows)
    for index, name in enumerate(names):
        panel = {"row": index // 2 + 1, "col": index % 2 + 1}
        along, size = (1e3, 1e6) if name in slides else (180.0 / math.pi, 180e3 / math.pi)
        units = ("mm", "µm") if name in slides else ("deg", "mdeg")
        of_joint = curves[curves["joint"] == name]
        readings, shown = of_joint["joint_reading_si"].to_numpy() * along, of_joint["is_determined"].to_numpy()
        middle, sigma = (of_joint[column].to_numpy() * size for column in ("deviation_si", "deviation_sigma_si"))
        figure.add_traces(_with_band(readings, np.where(shown, middle, np.nan), sigma), *_places(panel))
        figure.update_xaxes(title={"text": f"reading ({units[0]})", "standoff": 2}, **panel)
        figure.update_yaxes(title_text=units[1], **panel)
    return style(figure, "Error curves of the joints", "Motion minus reading", 120 + 240 * rows)


def guideway_errors(errors: pd.DataFrame) -> go.Figure:
    """Return the errors of the guideways over the positions of their slides: shifts in um, turns in arcsec."""
    groups = list(errors.groupby(["joint", "guideway_motion", "guideway_axis"], sort=False))
    rows = -(-len(groups) // 2)
    titles = [f"{label(joint)}: {_MOTIONS[motion][0]} {axis}" for (joint, motion, axis), _ in groups]
    figure = make_subplots(rows=rows, cols=min(2, len(groups)), subplot_titles=titles, vertical_spacing=0.35 / rows)
    for index, ((_, motion, _), curve) in enumerate(groups):
        panel = {"row": index // 2 + 1, "col": index % 2 + 1}
        _, unit, size = _MOTIONS[motion]
        deviation, sigma = (curve[column].to_numpy() * size for column in ("guideway_error_si", "guideway_sigma_si"))
        figure.add_traces(_with_band(curve["joint_reading_si"].to_numpy() * _MM, deviation, sigma), *_places(panel))
        for column in ("measured_from_si", "measured_to_si"):
            end = float(curve[column].iloc[0]) * _MM
            figure.add_vline(x=end, line={"width": 1, "dash": "dash", "color": ORANGE}, **panel)
        figure.update_xaxes(title={"text": "position of the slide (mm)", "standoff": 2}, **panel)
        figure.update_yaxes(title_text=unit, **panel)
    return style(figure, "Errors of the guideways", "Motion of the carriage next to its travel", 120 + 240 * rows)


def _with_band(readings: NDArray, middle: NDArray, sigma: NDArray) -> list[go.Scatter]:
    """Return lines of a curve and of two standard deviations about it."""
    lines = ((middle + 2 * sigma, 0.5, GREY), (middle - 2 * sigma, 0.5, GREY), (middle, 1.5, BLUE))
    return [
        go.Scatter(x=readings, y=values, mode="lines", line={"width": width, "color": colour}, showlegend=False)
        for values, width, colour in lines
    ]


def _places(panel: dict[str, int]) -> tuple[Sequence[int], Sequence[int]]:
    """Return rows and columns of the lines of one panel."""
    return [panel["row"]] * 3, [panel["col"]] * 3
