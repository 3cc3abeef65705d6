"""Small drawing of the machine for the first screen: legs, links, targets and frames, as inline SVG.

What a failed check names is ringed. Bodies without poses stand as designed, or side by side as surveyed.
"""

from __future__ import annotations

import html
import itertools
import json
import re
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from truing.report.quality_section import accepted_verdicts
from truing.report.scene.frames import leg_joints
from truing.report.tables import XYZ, Tables, cell, table_or_none

_Points = NDArray[np.float64]
_PLACE, _ENTRIES = ["px_mm", "py_mm", "pz_mm"], [f"r{i}{j}" for i in range(3) for j in range(3)]
_ORIGIN, _AXIS = ["ox_mm", "oy_mm", "oz_mm"], ["ax", "ay", "az"]
# View from the front right and above: right, up.
_VIEW = np.array([[0.866, 0.5, 0.0], [-0.171, 0.296, 0.940]])
_WIDTH, _HEIGHT, _EDGE = 300.0, 240.0, 18.0  # px
_MOST_TARGETS = 400
_AXIS_LENGTH = 0.2  # of the machine's size
_LEG = r"\b(?:rho|leg )(\d+)(?:_mm)?\b"  # leg in the subject of a check

_LETTER, _TEXT = 5.2, 10.0  # width of a letter and height of a text, px
_LABEL_DISTANCES = (7.0, 12.0, 18.0, 25.0, 33.0)  # distances of a text from what it names, px
_LABEL_ANGLES = np.radians(
    [0.0, 40.0, -40.0, 80.0, -80.0, 130.0, -130.0]
)  # and angles, rad, from the direction away from the machine
_KEY = "ringed or dashed: named by a failed check"
_FAILING = " failing"  # further class of what a failed check names


@dataclass
class _Shape:
    """Parts in one frame, mm: lines and dots with their class, frames by name, and labels at points.

    A label is written on the side away from its last point.
    """

    lines: list[tuple[str, _Points]] = field(default_factory=list)
    dots: list[tuple[str, _Points]] = field(default_factory=list)
    frames: list[tuple[str, _Points, _Points]] = field(default_factory=list)  # name, origin, axes in columns
    labels: list[tuple[str, _Points, _Points]] = field(default_factory=list)

    @property
    def points(self) -> _Points:
        """All points (N, 3) that the view has to hold."""
        parts = [points for _, points in (*self.lines, *self.dots)] + [origin[None] for _, origin, _ in self.frames]
        return np.concatenate(parts) if parts else np.empty((0, 3))


def machine_drawing(tables: Tables) -> str:
    """Return the drawing as SVG; empty where the tables hold no geometry."""
    named = failing_names(tables)
    for build in (_chain, _machine, _axis):
        shape = build(tables, named)
        if shape is not None and len(points := shape.points[np.isfinite(shape.points).all(axis=1)]):
            return _svg(shape, points)
    return ""


@dataclass(frozen=True)
class FailingNames:
    """Parts that failed checks name: legs by number, and words in which names of bodies, targets and joints stand."""

    legs: frozenset[int] = frozenset()
    words: str = ""

    def __contains__(self, name: object) -> bool:
        """True if the name stands in the words, between blanks."""
        return f" {_spaced(str(name))} " in self.words


def failing_names(tables: Tables) -> FailingNames:
    """Return the things named by failed checks that were not accepted, and the slips that explain them."""
    checks, relations = table_or_none(tables, "qa"), table_or_none(tables, "belonging")
    if checks is None:
        return FailingNames()
    failed = checks[checks["verdict"].eq("fail") & ~accepted_verdicts(checks)]
    words = [cell(subject) for subject in failed["subject"]]
    if relations is not None:
        rows = relations[relations["state"].eq("fails") & relations["relation"].isin(failed["check"])]
        slips = [slip for text in rows["slips"] for slip in json.loads(cell(text) or "[]")]
        words += [subject for slip in slips for subject in slip["subjects"]]
    text = " ".join(words)
    legs = frozenset(int(number) for number in re.findall(_LEG, text))
    return FailingNames(legs, f" {_spaced(re.sub(_LEG, ' ', text))} ")


def _spaced(words: str) -> str:
    return " ".join(words.replace(",", " ").split())


def _machine(tables: Tables, named: FailingNames) -> _Shape | None:
    """Return legs between their joints, both rings and the frames, as designed; targets of all bodies in one pose."""
    table, shape = table_or_none(tables, "frames"), _Shape()
    _add_bodies(shape, tables, named, with_frames=table is None)
    if table is None:
        return shape
    _add_legs(shape, *leg_joints(table), named)
    for name, group in table[table["frame"].isin(["base", "platform"])].groupby("frame", sort=False):
        shape.frames.append((str(name), *_frame(group)))
    return shape


def _frame(table: pd.DataFrame) -> tuple[_Points, _Points]:
    """Return origin (3,) and axes in columns (3, 3) of a frame's rows."""
    return table[XYZ].to_numpy(float)[0], table[["along_x", "along_y", "along_z"]].to_numpy(float).T


def _add_legs(shape: _Shape, lower: _Points, upper: _Points, named: FailingNames) -> None:
    for k, ends in enumerate(zip(lower, upper, strict=True), 1):
        shape.lines.append((f"leg{_FAILING * (k in named.legs)}", np.stack(ends)))
    for name, ring in (("base", lower), ("platform", upper)):
        middle = ring - ring.mean(axis=0)
        order = np.argsort(np.arctan2(middle[:, 1], middle[:, 0]))
        shape.lines.append((name, ring[np.append(order, order[0])]))
    shape.labels += [(str(k), a, lower.mean(axis=0)) for k, a in enumerate(lower, 1)]


def _chain(tables: Tables, named: FailingNames) -> _Shape | None:
    """Return the links of an open chain, its joints, and the frames of base and tip."""
    nodes = table_or_none(tables, "chain_nodes")
    if nodes is None:
        return None
    shape = _Shape()
    positions, origins = nodes[XYZ].to_numpy(float), nodes[_ORIGIN].to_numpy(float)
    links = [np.stack([positions[b], origins[k], positions[k]]) for k, b in enumerate(nodes["below"]) if b >= 0]
    shape.lines += [("leg", points) for points in links]
    moves = (nodes["joint_kind"] != "fixed").to_numpy()
    size = 0.05 * max(float(np.ptp(positions, axis=0).max()), 1.0)
    axes = nodes[_AXIS].to_numpy(float)
    for joint_node in np.flatnonzero(moves):
        joint = cell(nodes["joint"].iloc[joint_node])
        is_failing = bool(joint) and joint in named
        shape.lines.append(
            (f"base{_FAILING * is_failing}", origins[joint_node] + size * np.outer([-1.0, 1.0], axes[joint_node]))
        )
        if is_failing:
            shape.labels.append((joint, origins[joint_node], positions.mean(axis=0)))
    ends = [(0, str(nodes["link"].iloc[0])), *((int(k), str(nodes["link"].iloc[k])) for k in _tips(nodes))]
    for k, name in ends:
        shape.frames.append((name, positions[k], nodes.loc[k, _ENTRIES].to_numpy(float).reshape(3, 3)))
    survey = table_or_none(tables, "survey")
    for k, node in enumerate(nodes["link"]):
        if survey is None:
            break
        turn = nodes.loc[k, _ENTRIES].to_numpy(float).reshape(3, 3)
        _add_targets(shape, survey, str(node), (positions[k], turn), named)
    return shape


def _tips(nodes: pd.DataFrame) -> NDArray[np.intp]:
    return np.flatnonzero(nodes["is_tip"])


def _add_targets(
    shape: _Shape, targets: pd.DataFrame, body: str, at: tuple[_Points, _Points], named: FailingNames
) -> None:
    """Add the targets of a body that stands at a place (3,) with a rotation (3, 3); those that are named apart, or all
    of a named body of which none is."""
    rows = targets[targets["body"] == body].dropna(subset=XYZ)[:_MOST_TARGETS]
    origin, turn = at
    points = rows[XYZ].to_numpy(float) @ turn.T + origin
    failing = np.array([name in named for name in rows["target"]], dtype=bool)
    if body in named and not failing.any():
        failing = np.ones(len(rows), dtype=bool)
    elif failing.any():
        middle = points.mean(axis=0)
        names = zip(rows["target"][failing], points[failing], strict=True)
        shape.labels += [(str(name), point, middle) for name, point in names]
    kind = "fixed" if body == "base" else "target"
    for chosen, more in ((~failing, ""), (failing, _FAILING)):
        if chosen.any():
            shape.dots.append((f"{kind}{more}", points[chosen]))


def _add_bodies(shape: _Shape, tables: Tables, named: FailingNames, *, with_frames: bool) -> None:
    """Add the targets of all bodies, and their frames: in the first pose that has most of them; without poses where
    the machine is designed to hold them, or else side by side."""
    targets, motions, designed = (table_or_none(tables, name) for name in ("shape", "motions", "frames"))
    if targets is None:
        return
    if motions is not None:
        number = motions.groupby("pose", sort=False)["body"].nunique()
        placed_bodies = list(_placed(motions[motions["pose"] == number.idxmax()]))
    elif designed is not None:
        names = {name.replace(" ", ""): _frame(group) for name, group in designed.groupby("frame", sort=False)}
        placed_bodies = [(str(body), names[body]) for body in targets["body"].unique() if body in names]
    else:
        placed_bodies = list(_side_by_side(targets))
    for body, (origin, turn) in placed_bodies:
        _add_targets(shape, targets, body, (origin, turn), named)
        if with_frames and not body.startswith("leg"):
            shape.frames.append((body, origin, turn))


def _side_by_side(targets: pd.DataFrame) -> Iterator[tuple[str, tuple[_Points, _Points]]]:
    """Yield each body with a place (3,) next to the one before, unturned."""
    right = 0.0
    for body, group in targets.dropna(subset=XYZ).groupby("body", sort=False):
        points = group[XYZ].to_numpy(float)
        wide = max(float(np.ptp(points[:, 0])), 1.0)
        yield str(body), (np.array([right - points[:, 0].min(), 0.0, 0.0]), np.eye(3))
        right += 1.3 * wide


def _placed(motions: pd.DataFrame) -> Iterator[tuple[str, tuple[_Points, _Points]]]:
    """Yield each body with its place (3,) and rotation (3, 3) in the frame that most bodies share, its parent's."""
    parent = motions["parent"].mode().iloc[0]
    if (motions["body"] == parent).any():
        yield str(parent), (np.zeros(3), np.eye(3))
    for _, row in motions[motions["parent"] == parent].iterrows():
        yield str(row["body"]), (row[_PLACE].to_numpy(float), row[_ENTRIES].to_numpy(float).reshape(3, 3))


def _axis(tables: Tables, _: FailingNames) -> _Shape | None:
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

    def at(xyz: _Points) -> _Points:
        shown = (np.atleast_2d(xyz) @ _VIEW.T - (low + high) / 2.0) * scale * np.array([1.0, -1.0])
        return np.asarray(shown + np.array([_WIDTH, _HEIGHT]) / 2.0)

    parts = [f'<polyline class="{name}" points="{_listed(at(line))}"/>' for name, line in shape.lines]
    for name, line in shape.dots:
        radius = 4.5 if name.endswith(_FAILING) else 2
        parts += [f'<circle class="{name}" cx="{x:.1f}" cy="{y:.1f}" r="{radius}"/>' for x, y in at(line)]
    texts: list[tuple[str, _Points, _Points]] = []
    for (name, origin, _), ends in zip(shape.frames, tips, strict=True):
        (x, y), *arrows = at(np.vstack([origin, ends]))
        for axis, (u, v) in zip("xyz", arrows, strict=True):
            parts.append(f'<line class="axis" x1="{x:.1f}" y1="{y:.1f}" x2="{u:.1f}" y2="{v:.1f}"/>')
            words = f"{axis} {name}".strip() if axis == "z" else axis
            texts.append((words, np.array([u, v]), np.array([x, y])))
    texts += [(words, *at(np.stack([start, middle]))) for words, start, middle in shape.labels]
    drawn = [_along(at(line)) for _, line in shape.lines] + [at(line) for _, line in shape.dots]
    drawn += [
        _along(at(np.stack([origin, end])))
        for (_, origin, _), tip in zip(shape.frames, tips, strict=True)
        for end in tip
    ]
    parts += [
        f'<text x="{x:.1f}" y="{y:.1f}">{html.escape(words)}</text>'
        for words, x, y in _placed_labels(texts, np.concatenate([np.empty((0, 2)), *drawn]))
    ]
    if any(name.endswith(_FAILING) for name, _ in (*shape.lines, *shape.dots)):
        parts.append(f'<text class="key" x="4" y="{_HEIGHT - 4:.0f}">{_KEY}</text>')
    size = f"{_WIDTH:.0f} {_HEIGHT:.0f}"
    return f'<svg class="machine" viewBox="0 0 {size}" role="img" aria-label="{_words(shape)}">{"".join(parts)}</svg>'


def _along(line: _Points) -> _Points:
    """Return points (N, 2) along a line, at most a pixel and a half apart."""
    steps = [np.linspace(a, b, 2 + int(np.linalg.norm(b - a) / 1.5)) for a, b in itertools.pairwise(line)]
    return np.concatenate(steps) if steps else line


def _placed_labels(texts: list[tuple[str, _Points, _Points]], drawn: _Points) -> Iterator[tuple[str, float, float]]:
    """Yield each text with the middle of its base line, px, next to its point on the side away from another point.

    drawn: points (N, 2) of lines and dots. Of the places that cover no text before, the nearest that covers the fewest
    of these is taken.
    """
    taken: list[_Points] = []
    for words, point, middle in texts:
        half = np.array([0.5 * _LETTER * len(words), 0.5 * _TEXT])
        away = point - middle
        angle = np.arctan2(away[1], away[0])
        boxes = []
        for distance in _LABEL_DISTANCES:
            for turn in angle + _LABEL_ANGLES:
                direction = np.array([np.cos(turn), np.sin(turn)])
                centre = point + distance * direction + np.abs(direction) * np.sign(direction) * half * [1.0, 0.0]
                boxes.append(np.stack([centre - half, centre + half]))
        inside = [box for box in boxes if (box[0] > 0.0).all() and (box[1] < [_WIDTH, _HEIGHT]).all()]
        free = [box for box in inside if not any(_overlap(box, other) for other in taken)]
        box = min(free or inside or boxes, key=lambda box: _covered(box, drawn))
        taken.append(box)
        x, y = box.mean(axis=0)
        yield words, float(x), float(y + 0.33 * _TEXT)


def _overlap(first: _Points, second: _Points) -> bool:
    return bool((first[0] < second[1]).all() and (second[0] < first[1]).all())


def _covered(box: _Points, drawn: _Points) -> int:
    return int(((drawn > box[0]) & (drawn < box[1])).all(axis=1).sum())


def _listed(points: _Points) -> str:
    return " ".join(f"{x:.1f},{y:.1f}" for x, y in points)


def _words(shape: _Shape) -> str:
    """Return the content of the drawing in words, for readers who cannot see it."""
    targets = sum(len(points) for _, points in shape.dots)
    names = ", ".join(html.escape(name) for name, _, _ in shape.frames if name)
    legs = sum(name.startswith("leg") for name, _ in shape.lines)
    failing = sum(name.endswith(_FAILING) for name, _ in shape.lines)
    failing += sum(len(points) for name, points in shape.dots if name.endswith(_FAILING))
    numbers = ((legs, "lines for legs or links"), (targets, "targets"), (failing, "of them named by a failed check"))
    parts = [f"frames of {names}"] * bool(names) + [f"{number} {noun}" for number, noun in numbers if number]
    return f"Drawing of the machine: {'; '.join(parts)}"
