"""Section of frames: base, platform, legs with their joint axes, and measured directions, in one 3-D view."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pandas as pd
import plotly.graph_objects as go
from numpy.typing import NDArray

from truing.report.column_heads import Head
from truing.report.figure_style import BLUE, GREEN, GREY, ORANGE, RED, label, style
from truing.report.page import Listing, ReportSection
from truing.report.tables import XYZ, Tables, table_or_none
from truing.schemas.calibration_columns import LEG_JOINTS

_ALONG = ["along_x", "along_y", "along_z"]
_COLOURS = {"base": BLUE, "platform": ORANGE, "measurement": RED}
_LENGTHS = {"base": 0.35, "platform": 0.35, "measurement": 0.25}  # of an axis, as a share of the largest radius
_OF_LEGS = 0.18
_OUTWARD = 0.15  # of a leg's number from its joint, as a share of the radius there
_HEAD = 0.2  # of an axis: length of its arrow head


def frames(tables: Tables) -> ReportSection | None:
    """Return the section of the sensor's frames; None without their table."""
    table = table_or_none(tables, "frames")
    if table is None:
        return None
    lead, words = _OF_SENSOR if (table["frame"] == "measurement").any() else _OF_LEGS_ALONE
    figures = ((frames_figure(table), f"{_LEGEND} {words}"),)
    return ReportSection("frames", "Frames", lead, figures, (_listing(table),))


_LEGEND = "Click an entry of the legend to show or hide it; a double click shows it alone."
_OF_SENSOR = (
    "Every load, displacement and compliance is in the axes of the base, at the platform's origin. An element of a leg "
    "is in the axes of its leg: z from the lower to the upper joint, x horizontal (S1), S2 opposite to y.",
    "S1, S2: lower universal joint; S3: force cell; S4, S5: upper universal joint; S6: revolute joint. Radii: "
    "directions in which errors of the two radii move the joints. dx .. rz: directions in which the channels count, "
    "with [interferometer.beams].",
)
_OF_LEGS_ALONE = (
    "Poses are those of the platform in the axes of the base. z of a leg leads from its lower to its upper joint (b), "
    "x is in the plane of z and of the base's z. Drawn as designed, at the reference readings.",
    "u: direction of the actuator at the lower joint. a' to c' and d' to b': flexures with their axes along the leg; "
    "c' to d': the tube between them.",
)


def frames_figure(table: pd.DataFrame) -> go.Figure:
    """Return all frames with named axes, and the legs with the outlines of their joints; fixed frame, mm."""
    lower, upper = leg_joints(table)
    size = float(np.linalg.norm(np.concatenate([lower, upper])[:, :2], axis=1).max())
    tall = float(np.ptp(np.concatenate([lower, upper])[:, 2])) / (2.0 * size)
    away = max(1.0, 1.1 * tall)  # of the camera: a machine taller than wide would leave the view
    figure = go.Figure([*_legs(lower, upper), *_axes(table, size)])
    style(
        figure,
        "Frames",
        "As designed, in the frame of the base. Legs are numbered at their lower joints",
        680,
    )
    figure.update_layout(
        scene={
            "aspectmode": "data",
            "camera": {"eye": {"x": away, "y": -1.25 * away, "z": 0.8 * away}},
            **{f"{c}axis": {"title": {"text": f"{c} (mm)"}, "nticks": 6} for c in "xyz"},
        },
        legend={"orientation": "h", "y": 1.0, "yanchor": "top", "itemsizing": "constant"},
        margin={"l": 0, "r": 0, "t": 110, "b": 20},
    )
    return figure


def leg_joints(table: pd.DataFrame) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the lower and the upper joints (L, 3) of all legs: the first and the last of their joint axes."""
    joints = table[table["frame"].str.startswith(LEG_JOINTS)].groupby("frame", sort=False)[XYZ]
    return joints.first().to_numpy(dtype=float), joints.last().to_numpy(dtype=float)


def _legs(lower: NDArray[np.float64], upper: NDArray[np.float64]) -> Iterator[go.Scatter3d]:
    gap = np.full((len(lower), 1, 3), np.nan)
    rods = np.concatenate([lower[:, None], upper[:, None], gap], axis=1).reshape(-1, 3)
    yield _line(rods, "legs", GREY, 5.0)
    for name, points in (("base joints", lower), ("platform joints", upper)):
        order = np.argsort(np.arctan2(points[:, 1], points[:, 0]))
        ring = points[np.append(order, order[0])]
        colour = _COLOURS[name.split()[0]]
        yield _line(ring, name, colour, 2.0)
    numbers = [str(k) for k in range(1, len(lower) + 1)]
    # Outside the ring, so that numbers of two neighbours do not cover each other on a small screen.
    outside = lower + _OUTWARD * (lower - lower.mean(axis=0))
    yield go.Scatter3d(
        **dict(zip("xyz", outside.T, strict=True)), mode="text", text=numbers, showlegend=False, hoverinfo="skip"
    )


def _axes(table: pd.DataFrame, size: float) -> Iterator[go.Scatter3d]:
    """Yield the axes of each frame as arrows with names at the tips; of the legs, only the first is shown at first."""
    for name, group in table.groupby("frame", sort=False):
        frame = str(name)
        of_leg = frame not in _COLOURS
        hidden = (of_leg and not frame.endswith(" 1")) or frame == "measurement"
        length = size * _LENGTHS.get(frame, _OF_LEGS)
        colour = _COLOURS.get(frame, GREEN if frame.startswith("leg") else "#7b3294")
        start, direction = group[XYZ].to_numpy(dtype=float), group[_ALONG].to_numpy(dtype=float)
        arrows = np.concatenate([_arrow(a, length * w) for a, w in zip(start, direction, strict=True)])
        visible = "legendonly" if hidden else True
        yield _line(arrows, frame, colour, 5.0, visible=visible, legendgroup=frame)
        yield go.Scatter3d(
            **dict(zip("xyz", (start + 1.12 * length * direction).T, strict=True)),
            mode="text",
            text=[_tip(frame, str(axis)) for axis in group["axis_name"]],
            textfont={"color": colour, "size": 13},
            name=frame,
            legendgroup=frame,
            showlegend=False,
            visible=visible,
            hoverinfo="skip",
        )


def _tip(frame: str, axis: str) -> str:
    """Return the name of an axis with its frame: ``x base``, ``y 1``, ``S2``."""
    if frame in ("base", "platform"):
        return f"{axis} {frame}"
    return f"{axis} {frame.split()[-1]}" if frame.startswith("leg") else label(axis)


def _arrow(start: NDArray[np.float64], direction: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the points (7, 3) of an arrow: shaft and head, each ended by a gap."""
    side = np.cross(
        direction, [0.0, 0.0, 1.0] if abs(direction[2]) < 0.9 * np.linalg.norm(direction) else [1.0, 0.0, 0.0]
    )
    side *= 0.4 * _HEAD * np.linalg.norm(direction) / np.linalg.norm(side)
    end, gap = start + direction, np.full(3, np.nan)
    return np.stack([start, end, gap, end - _HEAD * direction + side, end, end - _HEAD * direction - side, gap])


def _line(points: NDArray[np.float64], name: str, colour: str, width: float, **more: object) -> go.Scatter3d:
    return go.Scatter3d(
        **dict(zip("xyz", np.round(points, 3).T, strict=True)),
        mode="lines",
        name=name,
        line={"color": colour, "width": width},
        hoverinfo="name",
        connectgaps=False,
        **more,
    )


def _listing(table: pd.DataFrame) -> Listing:
    rows = tuple(
        (
            str(r.frame),
            str(r.axis_name),
            ", ".join(f"{value:.3f}" for value in (r.x_mm, r.y_mm, r.z_mm)),
            ", ".join(f"{value + 0.0:.6f}" for value in (r.along_x, r.along_y, r.along_z)),
        )
        for r in table.itertuples()
    )
    heads = (
        Head("frame", "Frame of the base, the platform or a leg; the joints of a leg; or the measured directions."),
        Head("axis", "Axis of the frame, end of a flexure, joint axis S1 to S6, or channel."),
        Head("origin, mm", "Coordinates x, y, z of the point in the frame of the base."),
        Head("direction", "Components of the unit vector along the axis, in the frame of the base."),
    )
    return Listing(heads, rows, (), "Origins and axes in the frame of the base", True, "frames.parquet")
