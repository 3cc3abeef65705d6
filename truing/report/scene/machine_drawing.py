"""Small drawing of the machine for the first screen: legs, links, targets and frames, as inline SVG."""

from __future__ import annotations

import html
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from truing.report.scene.frames import leg_joints
from truing.report.tables import XYZ, Tables, table_or_none

_Points = NDArray[np.float64]
_PLACE, _ENTRIES = ["px_mm", "py_mm", "pz_mm"], [f"r{i}{j}" for i in range(3) for j in range(3)]
_ORIGIN, _AXIS = ["ox_mm", "oy_mm", "oz_mm"], ["ax", "ay", "az"]
# View from the front right and above: right, up.
_VIEW = np.array([[0.866, 0.5, 0.0], [-0.171, 0.296, 0.940]])
_WIDTH, _HEIGHT, _EDGE = 300.0, 240.0, 18.0  # px
_MOST_TARGETS = 400
_AXIS_LENGTH = 0.2  # of the machine's size


@dataclass
class _Shape:
    """Parts in one frame, mm: lines and dots with their class, frames by name, and labels at points."""

    lines: list[tuple[str, _Points]] = field(default_factory=list)
    dots: list[tuple[str, _Points]] = field(default_factory=list)
    frames: list[tuple[str, _Points, _Points]] = field(default_factory=list)  # name, origin, axes in columns
    labels: list[tuple[str, _Points]] = field(default_factory=list)

    @property
    def points(self) -> _Points:
        """All points (N, 3) that the view has to hold."""
        parts = [points for _, points in (*self.lines, *self.dots)] + [origin[None] for _, origin, _ in self.frames]
        return np.concatenate(parts) if parts else np.empty((0, 3))


def machine_drawing(tables: Tables) -> str:
    """Return the drawing as SVG; empty where the tables hold no geometry."""
    for build in (_chain, _machine, _axis):
        shape = build(tables)
        if shape is not None and len(points := shape.points[np.isfinite(shape.points).all(axis=1)]):
            return _svg(shape, points)
    return ""


def _machine(tables: Tables) -> _Shape | None:
    """Return legs between their joints, both rings and the frames, as designed; targets of all bodies in one pose."""
    table, shape = table_or_none(tables, "frames"), _Shape()
    _add_bodies(shape, tables, with_frames=table is None)
    if table is None:
        return shape
    _add_legs(shape, *leg_joints(table))
    for name, own in table[table["frame"].isin(["base", "platform"])].groupby("frame", sort=False):
        axes = own[["along_x", "along_y", "along_z"]].to_numpy(float).T
        shape.frames.append((str(name), own[XYZ].to_numpy(float)[0], axes))
    return shape


def _add_legs(shape: _Shape, lower: _Points, upper: _Points) -> None:
    shape.lines += [("leg", np.stack([a, b])) for a, b in zip(lower, upper, strict=True)]
    for name, ring in (("base", lower), ("platform", upper)):
        middle = ring - ring.mean(axis=0)
        order = np.argsort(np.arctan2(middle[:, 1], middle[:, 0]))
        shape.lines.append((name, ring[np.append(order, order[0])]))
    shape.labels += [(str(k), a) for k, a in enumerate(lower, 1)]


def _chain(tables: Tables) -> _Shape | None:
    """Return the links of an open chain, its joints, and the frames of base and tip."""
    nodes = table_or_none(tables, "chain_nodes")
    if nodes is None:
        return None
    shape = _Shape()
    places, origins = nodes[XYZ].to_numpy(float), nodes[_ORIGIN].to_numpy(float)
    links = [np.stack([places[b], origins[k], places[k]]) for k, b in enumerate(nodes["below"]) if b >= 0]
    shape.lines += [("leg", points) for points in links]
    moves = (nodes["joint_kind"] != "fixed").to_numpy()
    size = 0.05 * max(float(np.ptp(places, axis=0).max()), 1.0)
    ways = nodes[_AXIS].to_numpy(float)
    shape.lines += [("base", np.stack([origins[k] - size * ways[k], origins[k] + size * ways[k]])) for k in
                    np.flatnonzero(moves)]  # fmt: skip
    ends = [(0, str(nodes["link"].iloc[0])), *((int(k), str(nodes["link"].iloc[k])) for k in _tips(nodes))]
    for k, name in ends:
        shape.frames.append((name, places[k], nodes.loc[k, _ENTRIES].to_numpy(float).reshape(3, 3)))
    survey = table_or_none(tables, "survey")
    for k, node in enumerate(nodes["link"]):
        if survey is None:
            break
        own = survey.loc[survey["body"] == node, XYZ].dropna().to_numpy(float)
        turn = nodes.loc[k, _ENTRIES].to_numpy(float).reshape(3, 3)
        shape.dots.append(("target", own @ turn.T + places[k]))
    return shape


def _tips(nodes: pd.DataFrame) -> NDArray[np.intp]:
    return np.flatnonzero(nodes["is_tip"])


def _add_bodies(shape: _Shape, tables: Tables, *, with_frames: bool) -> None:
    """Add the targets of all bodies in the first pose that has most of them, and their frames."""
    places, motions = table_or_none(tables, "shape"), table_or_none(tables, "motions")
    if places is None or motions is None:
        return
    number = motions.groupby("pose", sort=False)["body"].nunique()
    for body, (origin, turn) in _placed(motions[motions["pose"] == number.idxmax()]):
        targets = places.loc[places["body"] == body, XYZ].dropna().to_numpy(float)[:_MOST_TARGETS]
        shape.dots.append(("fixed" if body == "base" else "target", targets @ turn.T + origin))
        if with_frames and not body.startswith("leg"):
            shape.frames.append((body, origin, turn))


def _placed(motions: pd.DataFrame) -> Iterator[tuple[str, tuple[_Points, _Points]]]:
    """Yield each body with its place (3,) and rotation (3, 3) in the frame that most bodies share, its parent's."""
    parent = motions["parent"].mode().iloc[0]
    if (motions["body"] == parent).any():
        yield str(parent), (np.zeros(3), np.eye(3))
    for _, row in motions[motions["parent"] == parent].iterrows():
        yield str(row["body"]), (row[_PLACE].to_numpy(float), row[_ENTRIES].to_numpy(float).reshape(3, 3))


def _axis(tables: Tables) -> _Shape | None:
    """Return a circle about the axis, or a guide along it."""
    table = table_or_none(tables, "axis_errors")
    if table is None:
        return None
    shape = _Shape()
    if (table["command_unit"] == "deg").any():
        angle = np.linspace(0.0, 2.0 * np.pi, 73)
        circle = np.stack([np.cos(angle), np.sin(angle), 0.0 * angle], axis=1)
        ticks = [np.stack([0.9 * circle[k], circle[k]]) for k in range(0, 72, 6)]
        shape.lines += [("platform", circle), *(("base", tick) for tick in ticks)]
        shape.lines.append(("leg", np.array([[0.0, 0.0, -0.3], [0.0, 0.0, 0.6]])))
    else:
        shape.lines += [("base", np.array([[-1.0, y, 0.0], [1.0, y, 0.0]])) for y in (-0.15, 0.15)]
        ring = np.array([[x, y, 0.0] for x, y in ((-0.2, -0.25), (0.2, -0.25), (0.2, 0.25), (-0.2, 0.25))])
        shape.lines.append(("platform", ring[[0, 1, 2, 3, 0]]))
    shape.frames.append(("", np.zeros(3), np.eye(3)))
    return shape


def _svg(shape: _Shape, points: _Points) -> str:
    flat = points @ _VIEW.T
    length = _AXIS_LENGTH * float(np.ptp(points, axis=0).max() or 1.0)
    tips = [origin + length * turn.T for _, origin, turn in shape.frames]
    flat = np.concatenate([flat, *(tip @ _VIEW.T for tip in tips)])
    low, high = flat.min(axis=0), flat.max(axis=0)
    span = np.maximum(high - low, 1e-9)
    scale = min((_WIDTH - 2 * _EDGE) / span[0], (_HEIGHT - 2 * _EDGE) / span[1])

    def at(places: _Points) -> _Points:
        shown = (np.atleast_2d(places) @ _VIEW.T - (low + high) / 2.0) * scale * np.array([1.0, -1.0])
        return np.asarray(shown + np.array([_WIDTH, _HEIGHT]) / 2.0)

    parts = [f'<polyline class="{name}" points="{_listed(at(own))}"/>' for name, own in shape.lines]
    for name, own in shape.dots:
        parts += [f'<circle class="{name}" cx="{x:.1f}" cy="{y:.1f}" r="2"/>' for x, y in at(own)]
    for (name, origin, _), ends in zip(shape.frames, tips, strict=True):
        (x, y), *arrows = at(np.vstack([origin, ends]))
        for axis, (u, v) in zip("xyz", arrows, strict=True):
            parts.append(f'<line class="axis" x1="{x:.1f}" y1="{y:.1f}" x2="{u:.1f}" y2="{v:.1f}"/>')
            words = f"{axis} {html.escape(name)}".strip() if axis == "z" else axis
            parts.append(f'<text x="{u + 2:.1f}" y="{v - 2:.1f}">{words}</text>')
    for words, place in shape.labels:
        ((x, y),) = at(place)
        parts.append(f'<text x="{x - 3:.1f}" y="{y + 14:.1f}">{html.escape(words)}</text>')
    size = f"{_WIDTH:.0f} {_HEIGHT:.0f}"
    return f'<svg class="machine" viewBox="0 0 {size}" role="img" aria-label="{_words(shape)}">{"".join(parts)}</svg>'


def _listed(points: _Points) -> str:
    return " ".join(f"{x:.1f},{y:.1f}" for x, y in points)


def _words(shape: _Shape) -> str:
    """Return the content of the drawing in words, for readers who cannot see it."""
    targets = sum(len(own) for _, own in shape.dots)
    names = ", ".join(html.escape(name) for name, _, _ in shape.frames if name)
    legs = sum(name == "leg" for name, _ in shape.lines)
    parts = [f"frames of {names}"] * bool(names) + [f"{legs} lines for legs or links"] * bool(legs)
    return "Drawing of the machine: " + "; ".join([*parts, *([f"{targets} targets"] if targets else [])])
