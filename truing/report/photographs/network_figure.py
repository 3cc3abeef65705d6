"""The network in 3-D: where cameras stood as frusta, object points with ellipsoids of their uncertainty."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from truing.report.figure_style import BLUE, GREEN, GREY, ORANGE, RED, label, style
from truing.report.numbers import count as counted
from truing.report.numbers import quantity
from truing.report.scene.view import round_gain

if TYPE_CHECKING:
    import pandas as pd
    import plotly.graph_objects as go

Array = NDArray[np.float64]

MOST_POSES = 6
_COLOURS = (BLUE, ORANGE, GREEN, RED, "#CC79A7", "#56B4E9")
_FRUSTUM = 0.07  # of the scene's extent, along the axis
_ELLIPSOID = 0.025  # of that extent, the largest semi-axis of the point in the middle
_TURN = np.linspace(0.0, 2.0 * np.pi, 17)
_SIDES = ((0, 1), (0, 2), (1, 2))


def network_picture(points: pd.DataFrame, images: pd.DataFrame, cameras: pd.DataFrame) -> go.Figure:
    """The network of one pose, or of several that a reader chooses from; tables object_points, image_orientations and
    cameras."""
    import plotly.graph_objects as go

    poses = _shown(points, images)
    gain = _gain(points, images)
    bodies = {body: _COLOURS[k % len(_COLOURS)] for k, body in enumerate(points["body"].unique())}
    figure, owner = go.Figure(), []
    for number, pose in enumerate(poses):
        own = _traces(points[points["pose"] == pose], images[images["pose"] == pose], cameras, gain, bodies)
        for trace in own:
            trace.visible = number == 0
            figure.add_trace(trace)
        owner += [number] * len(own)
    sigma = float(np.median(points[["sigma_x_mm", "sigma_y_mm", "sigma_z_mm"]].max(axis=1)))
    more = "" if len(poses) == points["pose"].nunique() else f" {len(poses)} of {points['pose'].nunique()} poses."
    style(
        figure,
        f"Cameras and object points, uncertainty amplified {gain:g} times",
        f"One standard deviation; in the middle {quantity(sigma, 'mm')} along a point's worst axis.{more}",
        640,
    )
    axis = {"title": {"text": ""}, "nticks": 5}
    figure.update_layout(
        scene={
            **{f"{a}axis": {**axis, "title": {"text": "mm"}} for a in "xyz"},
            "aspectmode": "data",
            "camera": {"eye": {"x": 0.85, "y": -1.1, "z": 0.45}, "center": {"x": 0, "y": 0, "z": -0.1}},
        },
        legend={"orientation": "h", "y": 1.0, "yanchor": "top", "itemsizing": "constant"},
        margin={"l": 0, "r": 0, "t": 90, "b": 40},
    )
    if len(poses) > 1:
        figure.update_layout(sliders=[_slider(poses, owner)])
    return figure


def _shown(points: pd.DataFrame, images: pd.DataFrame) -> list[Any]:
    """The poses to choose from: all, or the first and those whose points are known least."""
    poses = [pose for pose in points["pose"].unique() if (images["pose"] == pose).any()]
    if len(poses) <= MOST_POSES:
        return poses
    worst = points[["sigma_x_mm", "sigma_y_mm", "sigma_z_mm"]].max(axis=1).groupby(points["pose"], sort=False).median()
    chosen = {poses[0], *worst.sort_values(ascending=False).index[: MOST_POSES - 1]}
    return [pose for pose in poses if pose in chosen]


def _gain(points: pd.DataFrame, images: pd.DataFrame) -> float:
    """The amplification that lets uncertainties be seen, beside the cameras' distance."""
    pose = points["pose"].iloc[0]
    place = points.loc[points["pose"] == pose, ["x_mm", "y_mm", "z_mm"]].to_numpy()
    centre = images.loc[images["pose"] == pose, ["px_mm", "py_mm", "pz_mm"]].to_numpy()
    extent = float(np.ptp(np.concatenate([place, centre]), axis=0).max())
    sigma = float(np.median(points[["sigma_x_mm", "sigma_y_mm", "sigma_z_mm"]].max(axis=1)))
    return round_gain(_ELLIPSOID * extent / max(sigma, 1e-9))


def _traces(
    points: pd.DataFrame, images: pd.DataFrame, cameras: pd.DataFrame, gain: float, bodies: dict[Any, str]
) -> list[Any]:
    from scipy.spatial.transform import Rotation

    place = points[["x_mm", "y_mm", "z_mm"]].to_numpy()
    centre = images[["px_mm", "py_mm", "pz_mm"]].to_numpy()
    R = Rotation.from_rotvec(np.array(images[["rx_rad", "ry_rad", "rz_rad"]])).as_matrix()
    view = _view(place, centre)
    middle = place.mean(axis=0)
    frusta = _frusta(
        R, centre, images, cameras, _FRUSTUM * float(np.ptp(np.concatenate([place, centre]), axis=0).max())
    )
    drawn = [
        _lines((frusta - middle) @ view.T, "camera", GREY, 2.0),
        _dots((centre - middle) @ view.T, _camera_words(images), "projection centre", GREY, 2.5),
    ]
    shape = _ellipsoids(points, gain)
    for body, colour in bodies.items():
        own = (points["body"] == body).to_numpy()
        if not own.any():
            continue
        name = str(body) or "without a body"
        drawn.append(_dots((place[own] - middle) @ view.T, _point_words(points[own]), name, colour, 2.0))
        outlines = (shape[own] + place[own][:, None] - middle).reshape(-1, 3) @ view.T
        drawn.append(_lines(outlines, f"{name}, uncertainty", colour, 1.5, legend=False))
    return drawn


def _view(place: Array, centre: Array) -> Array:
    """Axes (3, 3) of the picture: the cameras are above the object."""
    up = (centre - place.mean(axis=0)).mean(axis=0)
    up = up / max(float(np.linalg.norm(up)), 1e-12)
    aside = np.cross(np.eye(3)[int(np.argmin(np.abs(up)))], up)
    aside = aside / np.linalg.norm(aside)
    return np.stack([aside, np.cross(up, aside), up])


def _frusta(R: Array, centre: Array, images: pd.DataFrame, cameras: pd.DataFrame, size: float) -> Array:
    """Edges of each camera's field of view (M, 3), separated by NaN."""
    about = cameras.pivot(index="camera", columns="parameter", values="value")
    form = cameras.groupby("camera")[["width_px", "height_px"]].first()
    out = []
    for k, camera in enumerate(images["camera"]):
        half = form.loc[camera].to_numpy(dtype=float) / 2.0 / about.loc[camera, "c"]
        corners = np.array([[a * half[0], b * half[1], 1.0] for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))]) * size
        tip, gap = np.zeros(3), np.full(3, np.nan)
        edges = [e for corner in corners for e in (tip, corner, gap)] + [*corners, corners[0], gap]
        out.append(np.array(edges) @ R[k].T + centre[k])
    return np.concatenate(out)


def _ellipsoids(points: pd.DataFrame, gain: float) -> Array:
    """Outlines (N, M, 3) in mm about each point: the three ellipses through its principal axes, amplified."""
    sigma = points[["sigma_x_mm", "sigma_y_mm", "sigma_z_mm"]].to_numpy()
    correlation = np.broadcast_to(np.eye(3), (len(points), 3, 3)).copy()
    for name, i, j in (("corr_xy", 0, 1), ("corr_xz", 0, 2), ("corr_yz", 1, 2)):
        correlation[:, i, j] = correlation[:, j, i] = points[name]
    values, axes = np.linalg.eigh(correlation * sigma[:, :, None] * sigma[:, None, :])
    half = gain * axes * np.sqrt(np.maximum(values, 0.0))[:, None, :]
    rings = [
        half[:, None, :, i] * np.cos(_TURN)[:, None] + half[:, None, :, j] * np.sin(_TURN)[:, None] for i, j in _SIDES
    ]
    gap = np.full((len(points), 1, 3), np.nan)
    return np.concatenate([part for ring in rings for part in (ring, gap)], axis=1)


def _camera_words(images: pd.DataFrame) -> list[str]:
    return [
        f"{label(r.image)}: {counted(r.rays, 'ray')}, {r.rms_px:.3f} px rms"
        if np.isfinite(r.rms_px)
        else label(r.image)
        for r in images.itertuples()
    ]


def _point_words(points: pd.DataFrame) -> list[str]:
    return [
        f"{label(r.point)}: {counted(r.rays, 'ray')}, up to {r.largest_angle_deg:.0f}°, "
        f"{1e3 * max(r.sigma_x_mm, r.sigma_y_mm, r.sigma_z_mm):.1f} µm"
        for r in points.itertuples()
    ]


def _dots(place: Array, words: list[str], name: str, colour: str, size: float) -> Any:
    import plotly.graph_objects as go

    x, y, z = np.round(place, 3).T
    marker = {"size": size, "color": colour}
    return go.Scatter3d(x=x, y=y, z=z, mode="markers", name=label(name), text=words, hoverinfo="text", marker=marker)


def _lines(place: Array, name: str, colour: str, width: float, *, legend: bool = True) -> Any:
    import plotly.graph_objects as go

    x, y, z = np.round(place, 3).T
    return go.Scatter3d(
        x=x,
        y=y,
        z=z,
        mode="lines",
        name=label(name),
        line={"color": colour, "width": width},
        hoverinfo="skip",
        connectgaps=False,
        showlegend=legend,
    )


def _slider(poses: list[Any], owner: list[int]) -> dict[str, Any]:
    steps = [
        {"label": label(pose), "method": "restyle", "args": [{"visible": [number == k for number in owner]}]}
        for k, pose in enumerate(poses)
    ]
    return {"steps": steps, "currentvalue": {"prefix": "pose "}, "pad": {"t": 10, "b": 20, "l": 60, "r": 60}}
