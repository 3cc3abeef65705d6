"""Campaigns of free bodies without a mechanism; the hidden effect acts on one of them.

Written from the physics alone: a target's place on its body, the body's pose in the frame of the measurement, noise.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from tests.blind.generator.folder import truth_path
from tests.blind.generator.quaternions import Array, from_vector, inverse, rotate


@dataclass(frozen=True)
class Body:
    """A body with so many targets within a radius in mm; at rest but for a jitter, in mm and rad, or anywhere."""

    name: str
    targets: int
    radius: float = 200.0
    at_rest: bool = False
    jitter_mm: float = 0.01
    jitter_rad: float = 1e-5


@dataclass(frozen=True)
class Hidden:
    """An effect on one body. ``deformation``: a pattern proportional to a column (rms in mm over the column's range).
    ``hysteresis``: depends on the direction from which a drive came. ``drift``: a pattern in time; ``walk``: the whole
    body in time; both with tau relative to the campaign's length (0: linear). ``moved``: one target shifts from a pose
    on. ``swapped``: labels exchanged in a pose. ``sag``: every target shifts along gravity by its own amount; ``nest``:
    one target does. ``scatter``: the body is displaced anew in each pose of a consecutive third (one sigma per
    axis)."""

    kind: str
    body: str
    size: float
    column: str = ""
    tau: float = 0.0


@dataclass(frozen=True)
class Layout:
    """Measured bodies and poses, noise in mm, share of missing points and of gross errors."""

    bodies: tuple[Body, ...] = (Body("tool", 6), Body("base", 5, 400.0, at_rest=True))
    poses: int = 60
    noise: float = 0.005
    declared: float | None = None
    surveyed: bool = True
    configured: bool = True
    missing: float = 0.02
    gross: float = 0.005
    verification: int = 12
    drives: tuple[str, ...] = ("elevation_deg",)
    up: tuple[float, float, float] | None = None  # in the frame of the body at rest
    columns: Mapping[str, Array] = field(default_factory=dict)


@dataclass(frozen=True)
class Drawn:
    """A campaign as measured, and the truth: places (K, 3) on the bodies, recorded points (N, K, 3), mm."""

    layout: Layout
    names: list[tuple[str, str]]
    places: Array
    points: Array
    is_observed: Array
    columns: dict[str, Array]
    truth: dict[str, object]


def draw(layout: Layout, hidden: tuple[Hidden, ...], rng: np.random.Generator) -> Drawn:
    """Draws a campaign with effects; all else comes from the same stream whether they are hidden or not."""
    names = [(body.name, f"{body.name[0].upper()}{k + 1:02}") for body in layout.bodies for k in range(body.targets)]
    places = np.concatenate([_spread(body, rng) for body in layout.bodies])
    columns = _columns(layout, rng)
    poses = {body.name: _poses(body, layout.poses, rng) for body in layout.bodies}
    noise = rng.normal(size=(layout.poses, len(names), 3)) * layout.noise
    is_observed = rng.random((layout.poses, len(names))) >= layout.missing
    wrong = rng.random(is_observed.shape) < layout.gross
    noise += wrong[..., None] * rng.normal(size=noise.shape) * 200 * layout.noise
    own = np.broadcast_to(places, noise.shape).copy()
    truth: list[dict[str, object]] = []
    for effect in hidden:
        rows = np.array([body == effect.body for body, _ in names])
        if effect.kind in ("sag", "nest"):
            shift, reported = _sagging(effect, int(rows.sum()), _down(layout, poses, effect.body), rng)
        else:
            shift, reported = _shifted(effect, places[rows], columns, rng)
        own[:, rows] += shift
        truth.append({"cause": effect.kind, "subject": effect.body, "size": effect.size, **reported})
    points = np.empty_like(own)
    for body in layout.bodies:
        rows = np.array([name == body.name for name, _ in names])
        turn, at = poses[body.name]
        points[:, rows] = rotate(turn[:, None], own[:, rows]) + at[:, None]
    points = points + noise
    _swap(points, names, hidden, truth, rng)
    return Drawn(layout, names, places, points, is_observed, columns, {"effects": truth})


def write(drawn: Drawn, folder: Path, rng: np.random.Generator) -> Path:
    """Writes the campaign's folder, and the truth next to it."""
    folder.mkdir(parents=True)
    layout = drawn.layout
    rest = next((body.name for body in layout.bodies if body.at_rest), None)
    head = ["[campaign]", f'name = "{folder.name}"', 'kind = "photogrammetry"']
    turned = [] if layout.up is None else ["[measurement]", f"up = {list(layout.up)}"]
    head += [f"drives = {json.dumps(list(layout.drives))}"] if layout.configured else []
    head += ["[bodies]", f'reference = "{rest}"'] if rest else []
    declared = layout.noise if layout.declared is None else layout.declared
    _write(folder / "campaign.toml", [*head, *turned, "[noise]", f"point_mm = {declared}"])
    rows = [
        f"{n + 1},{body},{name},{_numbers(drawn.points[n, k])}"
        for n in range(layout.poses)
        for k, (body, name) in enumerate(drawn.names)
        if drawn.is_observed[n, k]
    ]
    _write(folder / "points.csv", ["pose,body,target,x_mm,y_mm,z_mm", *rows])
    if layout.surveyed:
        survey = drawn.places + rng.normal(size=drawn.places.shape) * layout.noise
        lines = [f"{b},{t},{_numbers(at)}," for (b, t), at in zip(drawn.names, survey, strict=True)]
        _write(folder / "targets.csv", ["body,target,x_mm,y_mm,z_mm,leg", *lines])
    if layout.configured:
        _write(folder / "configurations.csv", _configurations(drawn))
    truth_path(folder).write_text(json.dumps(drawn.truth, indent=1), encoding="utf-8")
    return folder


def _spread(body: Body, rng: np.random.Generator) -> Array:
    at = rng.normal(size=(body.targets, 3))
    return body.radius * at / np.sqrt(np.mean(np.sum(at**2, -1)))


def _columns(layout: Layout, rng: np.random.Generator) -> dict[str, Array]:
    """Time with pauses, a slow temperature, and every drive up and down twice."""
    n = layout.poses
    time = np.cumsum(rng.uniform(40.0, 120.0, n))
    temperature = 20.0 + 2.0 * np.sin(2 * np.pi * time / time[-1] * 1.3 + rng.uniform(0, 6)) + rng.normal(size=n) * 0.1
    columns = {"time_s": time, "temperature_c": temperature}
    for number, drive in enumerate(layout.drives):
        swing = np.abs((np.arange(n) * (4 + 3 * number) / n) % 2 - 1)  # 1 -> 0 -> 1 -> 0 -> 1
        columns[drive] = np.round(45.0 + 90.0 * swing, 1)
    return {**columns, **layout.columns}


def _poses(body: Body, count: int, rng: np.random.Generator) -> tuple[Array, Array]:
    if body.at_rest:
        turn, at = rng.normal(size=3), rng.normal(size=3) * 1000
        jitter = rng.normal(size=(count, 6))
        return from_vector(turn + body.jitter_rad * jitter[:, 3:]), at + body.jitter_mm * jitter[:, :3]
    return from_vector(rng.normal(size=(count, 3))), rng.normal(size=(count, 3)) * 1000


def _shifted(
    effect: Hidden, places: Array, columns: Mapping[str, Array], rng: np.random.Generator
) -> tuple[Array, dict[str, object]]:
    """Return the shifts of a body's targets (N, k, 3), mm, and their facts for the report."""
    time = columns["time_s"]
    if effect.kind == "moved":
        target, first = int(rng.integers(len(places))), int(rng.integers(len(time) // 4, 3 * len(time) // 4))
        shift = np.zeros((len(time), *places.shape))
        way = effect.size * _unit(rng)
        shift[first:, target] = way
        return shift, {"target": target, "from_pose": first + 1, "shift_mm": way.tolist()}
    if effect.kind == "growth":
        return effect.size * (columns["temperature_c"] - 20.0)[:, None, None] * places, {"alpha": effect.size}
    if effect.kind == "jump":
        first = int(rng.integers(len(time) // 4, 3 * len(time) // 4))
        way = _unit(rng) + np.cross(0.5 * _unit(rng), places) / np.sqrt(np.mean(np.sum(places**2, -1)))
        return (np.arange(len(time)) >= first)[:, None, None] * effect.size * way, {"from_pose": first + 1}
    if effect.kind == "scatter":
        first = int(rng.integers(len(time) // 8, len(time) // 2))
        own = (np.arange(len(time)) >= first) & (np.arange(len(time)) < first + len(time) // 3)
        shift = effect.size * rng.normal(size=(len(time), 1, 3)) * own[:, None, None]
        return np.broadcast_to(shift, (len(time), *places.shape)), {"from_pose": first + 1}
    pattern = rng.normal(size=places.shape)
    if effect.kind in ("walk", "late"):
        pattern = np.broadcast_to(_unit(rng) * np.sqrt(3.0), places.shape)
    elif effect.kind == "deformation" or effect.kind == "hysteresis" or effect.kind == "drift":
        pattern = _without_motion(places, pattern)
    pattern = pattern * effect.size / np.sqrt(np.mean(pattern**2))
    course = {"": 0.0 * time, **{name: _unit_range(values) for name, values in columns.items()}}[effect.column]
    if effect.kind in ("drift", "walk"):
        course = _unit_range(time if effect.tau == 0 else 1 - np.exp(-_unit_range(time) / effect.tau))
    if effect.kind == "hysteresis":
        course = _came_from(columns[effect.column]) / 2
    if effect.kind == "late":
        course = np.maximum(2.0 * _unit_range(time) - 1.0, 0.0)
    if effect.kind == "swapped":
        course = 0.0 * time
    return course[:, None, None] * pattern, {"pattern_mm": pattern.tolist()}


def _down(layout: Layout, poses: Mapping[str, tuple[Array, Array]], body: str) -> Array:
    """The direction of gravity (N, 3) in a body's frame."""
    rest = next(body.name for body in layout.bodies if body.at_rest)
    down = rotate(poses[rest][0], -np.array(layout.up) / np.linalg.norm(layout.up or ()))
    return rotate(inverse(poses[body][0]), down)


def _sagging(effect: Hidden, targets: int, down: Array, rng: np.random.Generator) -> tuple[Array, dict[str, object]]:
    """Return the sag of targets (N, k, 3) relative to their mean, and the amplitude of each."""
    sag = effect.size * rng.normal(size=targets)
    if effect.kind == "nest":
        sag = effect.size * (np.arange(targets) == rng.integers(targets))
    return (down - down.mean(0))[:, None] * sag[:, None], {"sag_mm": sag.tolist()}


def _without_motion(places: Array, pattern: Array) -> Array:
    """The pattern less the small motion of the body that comes nearest to it."""
    arms = places - places.mean(0)
    axes = np.eye(3)
    motions = [np.broadcast_to(axis, arms.shape).ravel() for axis in axes] + [np.cross(a, arms).ravel() for a in axes]
    basis = np.stack(motions, 1)
    return pattern - (basis @ np.linalg.lstsq(basis, pattern.ravel(), rcond=None)[0]).reshape(pattern.shape)


def _came_from(values: Array) -> Array:
    """+1 after a drive went up, -1 after it went down."""
    direction, last = np.ones(len(values)), 1.0
    for n in range(1, len(values)):
        last = np.sign(values[n] - values[n - 1]) or last
        direction[n] = last
    return direction


def _swap(
    points: Array,
    names: list[tuple[str, str]],
    hidden: tuple[Hidden, ...],
    truth: list[dict[str, object]],
    rng: np.random.Generator,
) -> None:
    for effect, reported in zip(hidden, truth, strict=True):
        if effect.kind == "swapped":
            rows = [k for k, (body, _) in enumerate(names) if body == effect.body]
            one, other = rng.choice(rows, 2, replace=False)
            pose = int(rng.integers(len(points)))
            points[pose, [one, other]] = points[pose, [other, one]]
            reported |= {"targets": sorted([names[one][1], names[other][1]]), "pose": pose + 1}


def _configurations(drawn: Drawn) -> list[str]:
    layout = drawn.layout
    roles = np.array(["calibration"] * layout.poses, object)
    roles[:: max(layout.poses // max(layout.verification, 1), 2)] = (
        "verification" if layout.verification else "calibration"
    )
    columns = list(drawn.columns)
    return [
        ",".join(["pose", "role", *columns]),
        *(
            f"{n + 1},{roles[n]}," + ",".join(f"{drawn.columns[name][n]:.3f}" for name in columns)
            for n in range(layout.poses)
        ),
    ]


def _unit(rng: np.random.Generator) -> Array:
    way = rng.normal(size=3)
    return way / np.linalg.norm(way)


def _unit_range(values: Array) -> Array:
    return (values - values.min()) / np.ptp(values)


def _numbers(values: Array) -> str:
    return ",".join(f"{value:.6f}" for value in values)


def _write(path: Path, lines: list[str]) -> None:
    path.write_text("\n".join(lines) + "\n", encoding="utf-8", newline="\n")


def without_survey(layout: Layout) -> Layout:
    """The same bodies without a survey of their targets, and without roles."""
    return replace(layout, surveyed=False, verification=0)
