"""Section of an open chain: the arm in its first pose, its identified numbers, and errors over the workspace."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import pandas as pd
import plotly.graph_objects as go
from numpy.typing import NDArray
from plotly.subplots import make_subplots

from truing.report.figure_style import BLUE, GREEN, GREY, ORANGE, RED, label, style
from truing.report.numbers import count, listed, plain, rough, sign, with_uncertainty
from truing.report.page import Listing, ReportSection
from truing.report.scene.view import scene_axes
from truing.report.tables import XYZ, Tables, filled
from truing.simulation.mechanisms.chains.joint_table import joint_column, tree_from_rows
from truing.simulation.mechanisms.chains.tree import JointKind, Tree, TreeFrames

FAR = 3.0  # pull from which a number is farther from nominal than its tolerance explains
_MM = 1e3
_UNITS = {"rad": (180.0 / math.pi, "deg")}  # as tolerances in campaign.toml
_ARM = (
    "The nominal chain in the frame of its base; a line along each joint is its axis. Targets of unknown place are "
    "not drawn. Errors of the geometry are too small to be seen here."
)
_NUMBERS = (
    "offset: zero of the joint. dx, dy, dz, turn_x, turn_y, turn_z: shift and rotation of the joint's frame in the "
    "link below. A number that the data do not determine stands near its nominal value, and is no physical property."
)
_MAP = (
    "Each point is the tip in one pose, by the nominal chain. Large errors in one region show an effect that the "
    "model lacks there."
)


def chain(tables: Tables) -> ReportSection | None:
    """Return the section of a chain: the arm, its numbers, errors over the workspace and by series; None without
    a chain."""
    joints = filled(tables, "joints")
    if joints is None:
        return None
    tree = tree_from_rows(joints.to_dict("records"))
    readings = _readings(tree, tables)
    numbers, prediction = filled(tables, "chain_parameters"), filled(tables, "prediction")
    tip = _tip(tree, tables)
    figures: list[tuple[go.Figure, str]] = []
    if len(readings):
        figures.append((_arm(tree, readings.iloc[:1], tip, filled(tables, "survey")), _ARM))
    if prediction is not None and len(readings):
        places = tree.frames(readings.to_numpy(float)).t[:, tip] * _MM
        shown = pd.DataFrame(places, index=readings.index, columns=XYZ).join(prediction.set_index("pose"), how="inner")
        figures += [(_map(shown, tree.nodes[tip].link), _MAP)] if len(shown) else []
    listings = [_listing(numbers)] if numbers is not None else []
    series = filled(tables, "series_errors")
    listings += [_by_series(series)] if series is not None else []
    see = (("gain", "Errors of each pose, before and after"),) if prediction is not None else ()
    return ReportSection("chain", "Chain", _lead(tree, tip, numbers), tuple(figures), tuple(listings), see=see)


def _lead(tree: Tree, tip: int, numbers: pd.DataFrame | None) -> str:
    links = f"from {tree.nodes[0].link} to {tree.nodes[tip].link}"
    what = f"An open chain of {count(len(tree.readings), 'joint')} {links}."
    if numbers is None:
        return f"{what} Its geometry was not identified."
    known = numbers[numbers["identifiable"]]
    left, far = numbers[~numbers["identifiable"]], known[known["pull"].abs() > FAR]
    words = [what, f"The data determine {len(known)} of {count(len(numbers), 'number')} of its geometry."]
    if len(left):
        words.append(f"Not determined: {_named(left)}.")
    if len(far):
        words.append(f"Farther from nominal than {FAR:g} standard deviations of the tolerance: {_named(far)}.")
    elif known["pull"].notna().any():
        words.append(f"None is farther from nominal than {FAR:g} standard deviations of its tolerance.")
    return " ".join(words)


def _named(numbers: pd.DataFrame) -> str:
    return listed([f"{row.parameter} of {row.joint}" for row in numbers.itertuples()])


def _readings(tree: Tree, tables: Tables) -> pd.DataFrame:
    """Return the readings (B, n), rad or m, of the poses that have them all, indexed by pose."""
    table = filled(tables, "configurations")
    if table is None:
        return pd.DataFrame()
    found = {}
    for joint in tree.readings:
        column = joint_column(tree, joint, map(str, table.columns))
        if column is None:
            return pd.DataFrame()
        found[joint] = table[column.name].astype(float) * column.si
    return pd.DataFrame(found).set_index(table["pose"]).dropna()


def _tip(tree: Tree, tables: Tables) -> int:
    """Return the node of the last link that was measured, or of the last link."""
    seen = [filled(tables, name) for name in ("observations", "measured_poses")]
    nodes = [tree.links[body] for table in seen if table is not None for body in set(table["body"]) & set(tree.links)]
    return max(nodes, default=tree.size - 1)


def _listing(numbers: pd.DataFrame) -> Listing:
    """Return the identified numbers, the most significant first, then those that the data do not determine."""
    size = (numbers["identified"] / numbers["sigma"]).abs()
    ordered = numbers.assign(size=size).sort_values(["identifiable", "size"], ascending=False, kind="stable")
    rows, marks = [], []
    for row in ordered.itertuples():
        factor, unit = _UNITS.get(row.unit, (1.0, row.unit))
        bound = f"{plain(factor * row.tolerance)} {unit}" if row.tolerance == row.tolerance else "free"
        rows.append(
            (
                row.joint,
                row.parameter,
                with_uncertainty(factor * row.identified, factor * row.sigma, unit),
                bound,
                f"{row.pull:.1f}" if row.pull == row.pull else "–",
                "yes" if row.identifiable else "no",
            )
        )
        marks.append("warn" if row.identifiable and abs(row.pull) > FAR else "none")
    heads = ("joint", "number", "identified − nominal", "tolerance", "pull", "determined by the data")
    return Listing(
        heads, tuple(rows), tuple(marks), f"Identified numbers. {_NUMBERS}", held_by="chain_parameters.parquet"
    )


def _by_series(series: pd.DataFrame) -> Listing:
    unit = sign(str(series["unit"].iloc[0]))
    heads = ("series", "use", "poses", f"rms before, {unit}", f"rms after, {unit}")
    words = {"calibration": "fitted", "verification": "held out"}
    rows = tuple(
        (r.series, words.get(r.role, r.role), str(r.poses), rough(r.rms_before), rough(r.rms_after))
        for r in series.itertuples()
    )
    caption = "Measured minus predicted, by series, without and with the causes"
    return Listing(heads, rows, caption=caption, held_by="series_errors.parquet")


def _map(shown: pd.DataFrame, tip: str) -> go.Figure:
    """Return the errors that remain over the tip's position, from above and from the side."""
    views = (("x_mm", "y_mm", "from above"), ("x_mm", "z_mm", "from the side"))
    figure = make_subplots(rows=1, cols=2, subplot_titles=[words for *_, words in views], horizontal_spacing=0.12)
    held = (shown["role"] == "verification").to_numpy()
    words = [
        f"pose {label(pose)}: {rough(before)} → {rough(after)} µm"
        for pose, before, after in zip(shown.index, shown["rms_before"], shown["rms_after"], strict=True)
    ]
    for k, (across, up, _) in enumerate(views, 1):
        marker = {
            "color": shown["rms_after"].to_numpy(),
            "coloraxis": "coloraxis",
            "size": 9,
            "symbol": np.where(held, "diamond", "circle"),
            "line": {"width": 0.5, "color": GREY},
        }
        points = go.Scatter(
            x=shown[across].to_numpy(),
            y=shown[up].to_numpy(),
            mode="markers",
            marker=marker,
            text=words,
            hoverinfo="text",
            showlegend=False,
        )
        figure.add_trace(points, row=1, col=k)
        figure.update_xaxes(title_text=f"{across[0]} (mm)", row=1, col=k)
        figure.update_yaxes(title_text=f"{up[0]} (mm)", row=1, col=k)
    style(figure, f"Errors that remain, over the position of {label(tip)}", "Diamonds: held-out poses", 440)
    scale = {"title": {"text": "rms (µm)"}, "thickness": 12}
    figure.update_layout(coloraxis={"colorscale": "Cividis", "cmin": 0.0, "colorbar": scale})
    return figure


def _arm(tree: Tree, first: pd.DataFrame, tip: int, survey: pd.DataFrame | None) -> go.Figure:
    """Return the nominal chain at one pose with joint axes, frames of base and tip, and surveyed targets; mm."""
    frames = tree.frames(first.to_numpy(float))
    places, origins = frames.t[0] * _MM, frames.origin[0] * _MM
    shown = np.concatenate([places, origins])
    size = 0.12 * max(float(np.ptp(shown, axis=0).max()), 1.0)
    low, high = shown.min(0) - size, shown.max(0) + size
    middle, half = (low + high) / 2.0, (high - low) / 2.0
    half = np.maximum(half, 0.4 * half.max())  # a flat view would distort the arm
    parts = [_links(tree, places, origins), *_joints(tree, frames, size), *_triads(tree, frames, tip, size)]
    figure = go.Figure([*parts, *_targets(tree, frames, survey)])
    style(figure, f"The chain at pose {label(first.index[0])}", "Nominal geometry, frame of the base", 620)
    figure.update_layout(
        scene=scene_axes(middle - half, middle + half),
        legend={"orientation": "h", "y": 1.0, "yanchor": "top", "itemsizing": "constant"},
        margin={"l": 0, "r": 0, "t": 110, "b": 20},
    )
    return figure


def _links(tree: Tree, places: NDArray, origins: NDArray) -> go.Scatter3d:
    """Return a line along each link, and along the travel of each joint that slides."""
    gap = np.full(3, np.nan)
    points = [
        row
        for k, node in enumerate(tree.nodes)
        if node.parent >= 0
        for row in (places[node.parent], origins[k], places[k], gap)
    ]
    return _line(np.array(points).reshape(-1, 3), "links", GREY, 8.0)


def _joints(tree: Tree, frames: TreeFrames, size: float) -> Iterator[go.Scatter3d]:
    looks = (
        (JointKind.REVOLUTE, BLUE, "circle", "joints that turn"),
        (JointKind.PRISMATIC, GREEN, "square", "joints that slide"),
    )
    for kind, colour, symbol, words in looks:
        own = [k for k, node in enumerate(tree.nodes) if node.kind is kind]
        if not own:
            continue
        middle = frames.origin[0, own] * _MM
        along = np.stack([frames.R[0, k] @ tree.nodes[k].axis for k in own]) * size / 2.0
        yield go.Scatter3d(
            **dict(zip("xyz", middle.T, strict=True)),
            mode="markers+text",
            name=words,
            legendgroup=words,
            marker={"size": 5, "color": colour, "symbol": symbol},
            text=[label(tree.nodes[k].joint) for k in own],
            textposition="middle right",
            hoverinfo="text",
        )
        ends = np.stack([middle - along, middle + along, np.full_like(middle, np.nan)], 1).reshape(-1, 3)
        yield _line(ends, f"axes of {words}", colour, 3.0, legendgroup=words, showlegend=False)


def _triads(tree: Tree, frames: TreeFrames, tip: int, size: float) -> Iterator[go.Scatter3d]:
    """Return the axes x, y, z of base and tip."""
    for k, words in ((0, "base"), (tip, "tip")):
        name = f"{words}: {label(tree.nodes[k].link)}"
        for axis, colour in enumerate((RED, GREEN, BLUE)):
            start = frames.t[0, k] * _MM
            ends = np.stack([start, start + size * frames.R[0, k, :, axis]])
            yield go.Scatter3d(
                **dict(zip("xyz", ends.T, strict=True)),
                mode="lines+text",
                name=name,
                legendgroup=name,
                showlegend=axis == 0,
                line={"color": colour, "width": 6},
                text=["", "xyz"[axis]],
                hoverinfo="name",
            )


def _targets(tree: Tree, frames: TreeFrames, survey: pd.DataFrame | None) -> Iterator[go.Scatter3d]:
    """Return the targets whose places in their links are known."""
    own = pd.DataFrame() if survey is None else survey[survey["body"].isin(list(tree.links))].dropna(subset=XYZ)
    if not len(own):
        return
    nodes = [tree.links[body] for body in own["body"]]
    placed = np.einsum("kij,kj->ki", frames.R[0, nodes], own[XYZ].to_numpy(float)) + frames.t[0, nodes] * _MM
    yield go.Scatter3d(
        **dict(zip("xyz", placed.T, strict=True)),
        mode="markers",
        name="targets",
        marker={"size": 4, "color": ORANGE},
        text=[label(name) for name in own["target"]],
        hoverinfo="text",
    )


def _line(points: NDArray, name: str, colour: str, width: float, **more: object) -> go.Scatter3d:
    return go.Scatter3d(
        **dict(zip("xyz", points.T, strict=True)),
        mode="lines",
        name=name,
        line={"color": colour, "width": width},
        hoverinfo="skip",
        connectgaps=False,
        **more,
    )
