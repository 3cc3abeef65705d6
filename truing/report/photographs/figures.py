"""Figures of the bundle adjustment: network of cameras and object points in 3-D, and residuals of the rays."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
import plotly.graph_objects as go
from numpy.typing import NDArray

from truing.report.figure_style import BLUE, GREEN, GREY, ORANGE, RED, label, style
from truing.report.numbers import count_text, quantity
from truing.report.scene.view import round_gain
from truing.report.tables import SIGMA

Array = NDArray[np.float64]

_MOST_POSES = 6
_COLOURS = (BLUE, ORANGE, GREEN, RED, "#CC79A7", "#56B4E9")
_FRUSTUM = 0.07  # length along the axis, as a share of the scene's extent
_ELLIPSOID = 0.025  # largest semi-axis of the median ellipsoid, as a share of that extent
_CIRCLE_ANGLES = np.linspace(0.0, 2.0 * np.pi, 17)
_SIDES = ((0, 1), (0, 2), (1, 2))

_MOST_POINTS = 1500  # of a pose in the picture of the network
_MOST_IMAGES = 40
_MOST_RAYS = 20_000  # of all images in the picture of residuals
_CELLS = 12  # cells for mean residuals along the longer side of the format
_FEWEST = 3  # fewest rays for a mean
_LENGTH = 0.03  # length of a median residual, as a share of the format's width


def network_picture(points: pd.DataFrame, images: pd.DataFrame, cameras: pd.DataFrame) -> go.Figure:
    """Return the network of one pose, or of several to choose from; tables object_points, image_orientations and
    cameras."""
    poses = _shown_poses(points, images)
    gain = _gain(points, images)
    bodies = {body: _COLOURS[k % len(_COLOURS)] for k, body in enumerate(points["body"].unique())}
    figure, step_of_trace = go.Figure(), []
    for number, pose in enumerate(poses):
        traces = _traces(
            _shown_points(points[points["pose"] == pose]), images[images["pose"] == pose], cameras, gain, bodies
        )
        for trace in traces:
            trace.visible = number == 0
            figure.add_trace(trace)
        step_of_trace += [number] * len(traces)
    sigma = float(np.median(points[SIGMA].max(axis=1)))
    more = "" if len(poses) == points["pose"].nunique() else f" {len(poses)} of {points['pose'].nunique()} poses."
    if (points["pose"].value_counts() > _MOST_POINTS).any():
        more += f" Of a pose {_MOST_POINTS:,} points, from the best to the worst."
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
        figure.update_layout(sliders=[_slider("pose", poses, step_of_trace)])
    return figure


def _shown_points(points: pd.DataFrame) -> pd.DataFrame:
    """Return the points of a pose to draw: all, or points of every rank of uncertainty, the worst among them."""
    if len(points) <= _MOST_POINTS:
        return points
    order = np.argsort(points[SIGMA].max(axis=1).to_numpy(), kind="stable")
    return points.iloc[np.sort(order[np.linspace(0, len(points) - 1, _MOST_POINTS).round().astype(int)])]


def _shown_poses(points: pd.DataFrame, images: pd.DataFrame) -> list[int | str]:
    """Return the poses to choose from: all, or the first and those with the largest uncertainty of points."""
    poses = [pose for pose in points["pose"].unique() if (images["pose"] == pose).any()]
    if len(poses) <= _MOST_POSES:
        return poses
    worst = points[SIGMA].max(axis=1).groupby(points["pose"], sort=False).median()
    chosen = {poses[0], *worst.sort_values(ascending=False).index[: _MOST_POSES - 1]}
    return [pose for pose in poses if pose in chosen]


def _gain(points: pd.DataFrame, images: pd.DataFrame) -> float:
    """Return the amplification that makes uncertainties visible at the scale of the cameras' distance."""
    pose = points["pose"].iloc[0]
    position = points.loc[points["pose"] == pose, ["x_mm", "y_mm", "z_mm"]].to_numpy()
    centre = images.loc[images["pose"] == pose, ["px_mm", "py_mm", "pz_mm"]].to_numpy()
    extent = float(np.ptp(np.concatenate([position, centre]), axis=0).max())
    sigma = float(np.median(points[SIGMA].max(axis=1)))
    return round_gain(_ELLIPSOID * extent / max(sigma, 1e-9))


def _traces(
    points: pd.DataFrame, images: pd.DataFrame, cameras: pd.DataFrame, gain: float, bodies: dict[str, str]
) -> list[go.Scatter3d]:
    from scipy.spatial.transform import Rotation

    position = points[["x_mm", "y_mm", "z_mm"]].to_numpy()
    centre = images[["px_mm", "py_mm", "pz_mm"]].to_numpy()
    R = Rotation.from_rotvec(np.array(images[["rx_rad", "ry_rad", "rz_rad"]])).as_matrix()
    view = _view(position, centre)
    middle = position.mean(axis=0)
    frusta = _frusta(
        R, centre, images, cameras, _FRUSTUM * float(np.ptp(np.concatenate([position, centre]), axis=0).max())
    )
    drawn = [
        _lines((frusta - middle) @ view.T, "camera", GREY, 2.0),
        _dots((centre - middle) @ view.T, _camera_words(images), "projection centre", GREY, 2.5),
    ]
    shape = _ellipsoids(points, gain)
    for body, colour in bodies.items():
        values = (points["body"] == body).to_numpy()
        if not values.any():
            continue
        name = str(body) or "without a body"
        drawn.append(_dots((position[values] - middle) @ view.T, _point_words(points[values]), name, colour, 2.0))
        outlines = (shape[values] + position[values][:, None] - middle).reshape(-1, 3) @ view.T
        drawn.append(_lines(outlines, f"{name}, uncertainty", colour, 1.5, legend=False))
    return drawn


def _view(points: Array, centre: Array) -> Array:
    """Return axes (3, 3) of the picture, with the cameras above the object."""
    up = (centre - points.mean(axis=0)).mean(axis=0)
    up = up / max(float(np.linalg.norm(up)), 1e-12)
    aside = np.cross(np.eye(3)[int(np.argmin(np.abs(up)))], up)
    aside = aside / np.linalg.norm(aside)
    return np.stack([aside, np.cross(up, aside), up])


def _frusta(R: Array, centre: Array, images: pd.DataFrame, cameras: pd.DataFrame, size: float) -> Array:
    """Return edges of each camera's field of view (M, 3), separated by NaN."""
    about = cameras.pivot(index="camera", columns="parameter", values="value")
    form = cameras.groupby("camera")[["width_px", "height_px"]].first()
    lines = []
    for k, camera in enumerate(images["camera"]):
        half = form.loc[camera].to_numpy(dtype=float) / 2.0 / about.loc[camera, "c"]
        corners = np.array([[a * half[0], b * half[1], 1.0] for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))]) * size
        tip, gap = np.zeros(3), np.full(3, np.nan)
        edges = [e for corner in corners for e in (tip, corner, gap)] + [*corners, corners[0], gap]
        lines.append(np.array(edges) @ R[k].T + centre[k])
    return np.concatenate(lines)


def _ellipsoids(points: pd.DataFrame, gain: float) -> Array:
    """Return outlines (N, M, 3) in mm about each point: three ellipses through its principal axes, amplified."""
    sigma = points[SIGMA].to_numpy()
    correlation = np.broadcast_to(np.eye(3), (len(points), 3, 3)).copy()
    for name, i, j in (("corr_xy", 0, 1), ("corr_xz", 0, 2), ("corr_yz", 1, 2)):
        correlation[:, i, j] = correlation[:, j, i] = points[name]
    values, axes = np.linalg.eigh(correlation * sigma[:, :, None] * sigma[:, None, :])
    half = gain * axes * np.sqrt(np.maximum(values, 0.0))[:, None, :]
    rings = [
        half[:, None, :, i] * np.cos(_CIRCLE_ANGLES)[:, None] + half[:, None, :, j] * np.sin(_CIRCLE_ANGLES)[:, None]
        for i, j in _SIDES
    ]
    gap = np.full((len(points), 1, 3), np.nan)
    return np.concatenate([part for ring in rings for part in (ring, gap)], axis=1)


def _camera_words(images: pd.DataFrame) -> list[str]:
    return [
        f"{label(r.image)}: {count_text(r.rays, 'ray')}, {r.rms_px:.3f} px rms"
        if np.isfinite(r.rms_px)
        else label(r.image)
        for r in images.itertuples()
    ]


def _point_words(points: pd.DataFrame) -> list[str]:
    return [
        f"{label(r.point)}: {count_text(r.rays, 'ray')}, up to {r.largest_angle_deg:.0f}°, "
        f"{1e3 * max(r.sigma_x_mm, r.sigma_y_mm, r.sigma_z_mm):.1f} µm"
        for r in points.itertuples()
    ]


def _dots(points: Array, words: list[str], name: str, colour: str, size: float) -> go.Scatter3d:
    x, y, z = np.round(points, 3).T
    marker = {"size": size, "color": colour}
    return go.Scatter3d(x=x, y=y, z=z, mode="markers", name=label(name), text=words, hoverinfo="text", marker=marker)


def _lines(points: Array, name: str, colour: str, width: float, *, legend: bool = True) -> go.Scatter3d:
    x, y, z = np.round(points, 3).T
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


def residual_picture(residuals: pd.DataFrame, cameras: pd.DataFrame) -> go.Figure:
    """Return residual vectors: first the means over each camera's images, then image by image.

    ``residuals``: the table image_residuals; ``cameras``: the formats.
    """
    formats = cameras.groupby("camera", sort=False)[["width_px", "height_px"]].first()
    reported = residuals[residuals["vx_px"].notna()]
    rows = reported[~reported["rejected"]]
    width = float(formats["width_px"].max())
    usual = float(np.median(np.hypot(rows["vx_px"], rows["vy_px"]))) if len(rows) else 1.0
    gain = round_gain(_LENGTH * width / max(usual, 1e-9))
    images = _shown_images(reported)
    figure, steps = go.Figure(), []
    for camera in [name for name in formats.index if (rows["camera"] == name).any()]:
        steps.append(
            (f"{camera}, all images: means of cells", _cell_means(rows[rows["camera"] == camera], formats, gain))
        )
    for pose, image in images:
        rays = reported[(reported["pose"] == pose) & (reported["image"] == image)]
        steps.append(
            (f"{image}, pose {pose}" if str(pose) not in str(image) else str(image), _image_residuals(rays, gain))
        )
    step_of_trace = [number for number, (_, traces) in enumerate(steps) for _ in traces]
    for number, (_, traces) in enumerate(steps):
        for trace in traces:
            trace.visible = number == 0
            figure.add_trace(trace)
    enlargement = round_gain(width / 10.0)
    total = reported.groupby(["pose", "image"]).ngroups
    more = f" The {len(images)} of {total} images with the largest residuals." if len(images) < total else ""
    style(
        figure,
        "Residuals of the rays",
        f"Measured minus adjusted: {enlargement:g} px on the axes = {enlargement / gain:.2g} px of residual.{more}",
        620,
    )
    height = float(formats["height_px"].max())
    edge = 0.02 * width
    figure.update_xaxes(title_text="x (px)", range=[-edge, width + edge], constrain="domain", zeroline=False)
    figure.update_yaxes(
        title_text="y (px)", range=[height + edge, -edge], scaleanchor="x", constrain="domain", zeroline=False
    )
    figure.update_layout(
        sliders=[_slider("image", [name for name, _ in steps], step_of_trace)],
        shapes=[{"type": "rect", "x0": 0, "y0": 0, "x1": width, "y1": height, "line": {"color": GREY, "width": 1}}],
        legend={"orientation": "h", "y": -0.1, "yanchor": "top", "x": 0.0},
    )
    return figure


def _shown_images(residuals: pd.DataFrame) -> list[tuple[int | str, str]]:
    """Return the images to choose from, in order: all, or those with the largest residuals."""
    size = np.hypot(residuals["vx_px"], residuals["vy_px"]).where(~residuals["rejected"])
    by_image = (size**2).groupby([residuals["pose"], residuals["image"]], sort=False)
    rms = by_image.mean()
    order = rms.sort_values(ascending=False).index
    few = int((by_image.size()[order].cumsum() <= _MOST_RAYS).sum())
    chosen = set(order[: min(max(few, 1), _MOST_IMAGES)])
    return [key for key in rms.index if key in chosen]


def _cell_means(table: pd.DataFrame, formats: pd.DataFrame, gain: float) -> list[go.Scatter]:
    """Return mean residuals in the cells of one camera's format, over all its images."""
    cell = float(formats.loc[table["camera"].iloc[0]].max()) / _CELLS
    column, row = (np.floor(table[f"{a}_px"] / cell).astype(int) for a in "xy")
    means = table.groupby([row, column])[["x_px", "y_px", "vx_px", "vy_px"]].mean()
    counts = table.groupby([row, column]).size()
    means, counts = means[counts >= _FEWEST], counts[counts >= _FEWEST]
    words = [
        f"{count_text(n, 'ray')}, mean ({r.vx_px:+.3f}, {r.vy_px:+.3f}) px"
        for r, n in zip(means.itertuples(), counts, strict=True)
    ]
    return [*_vectors(means, gain, BLUE, "mean of a cell"), _ray_ends(means, words, BLUE, "middle of its rays")]


def _image_residuals(table: pd.DataFrame, gain: float) -> list[go.Scatter]:
    accepted, rejected = table[~table["rejected"]], table[table["rejected"]]
    drawn = [*_vectors(accepted, gain, BLUE, "residual"), _ray_ends(accepted, _words(accepted), BLUE, "ray")]
    if len(rejected):
        drawn.append(
            _ray_ends(
                rejected,
                [f"{w}; {r}" for w, r in zip(_words(rejected), rejected["reason"], strict=True)],
                RED,
                "rejected",
            )
        )
    return drawn


def _words(rays: pd.DataFrame) -> list[str]:
    return [f"{label(r.point)}: ({r.vx_px:+.3f}, {r.vy_px:+.3f}) px" for r in rays.itertuples()]


def _vectors(rays: pd.DataFrame, gain: float, colour: str, name: str) -> list[go.Scatter]:
    start = rays[["x_px", "y_px"]].to_numpy()
    end = start + gain * rays[["vx_px", "vy_px"]].to_numpy()
    lines = np.stack([start, end, np.full_like(start, np.nan)], axis=1).reshape(-1, 2)
    x, y = np.round(lines, 1).T
    look = {"color": colour if name == "residual" else ORANGE, "width": 1.5}
    return [go.Scatter(x=x, y=y, mode="lines", name=name, line=look, hoverinfo="skip", connectgaps=False)]


def _ray_ends(rays: pd.DataFrame, words: list[str], colour: str, name: str) -> go.Scatter:
    return go.Scatter(
        x=rays["x_px"].round(1),
        y=rays["y_px"].round(1),
        mode="markers",
        name=name,
        text=words,
        hoverinfo="text",
        marker={
            "color": colour,
            "size": 7 if name == "rejected" else 4,
            "symbol": "x" if name == "rejected" else "circle",
        },
    )


def _slider(noun: str, names: Sequence[int | str], step_of_trace: list[int]) -> dict[str, object]:
    """Return a slider that shows the traces of one ``noun``; ``step_of_trace``: index of the name of each trace."""
    steps = [
        {"label": label(name), "method": "restyle", "args": [{"visible": [number == k for number in step_of_trace]}]}
        for k, name in enumerate(names)
    ]
    return {"steps": steps, "currentvalue": {"prefix": f"{noun} "}, "pad": {"t": 10, "b": 20, "l": 60, "r": 60}}
