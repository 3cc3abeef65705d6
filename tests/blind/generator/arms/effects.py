"""Hidden effects: each has a shape over the poses and one size, in SI."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from tests.blind.generator.arms.arm import Arm
from tests.blind.generator.arms.instrument import Instrument
from tests.blind.generator.arms.motion import State, at_rest, base_moment, places
from tests.blind.generator.arms.schedule import Schedule
from tests.blind.generator.arms.transforms import Array

JOINT_CAUSES = (
    "joint-offset",
    "joint-gain",
    "joint-backlash",
    "joint-eccentricity",
    "joint-harmonic",
    "joint-settling",
    "joint-compliance",
    "joint-sag",
    "approach-scatter",
)
LINK_CAUSES = ("link-bending", "link-growth")
BASE_CAUSES = ("base-drift", "base-jump", "column-tilt")
# Needs several hundred poses.
OF_MANY_POSES = ("joint-error-curve",)
CAUSES = (*JOINT_CAUSES, *LINK_CAUSES, *BASE_CAUSES, "target-moved", "joints-exchanged")
OF_GRAVITY = ("joint-compliance", "joint-sag", "link-bending", "column-tilt")
# Revolute joints alone.
OF_ANGLE = ("joint-eccentricity", "joint-harmonic", "joint-compliance", "joint-sag", "joint-error-curve")
# Of slides alone.
OF_SLIDES = ("joint-pitch-error", "guideway-error")
ADDED = (*OF_MANY_POSES, *OF_SLIDES)  # hidden only on request
# Of screws and racks, m.
PITCHES = (0.005, 0.01, 0.016, 0.02, 0.04, 0.0785)
MOST_TURNS = 120  # over the travel
SIX = ("dx", "dy", "dz", "rx", "ry", "rz")


@dataclass(frozen=True)
class Effect:
    """One hidden effect. ``shape`` is what one unit of ``size`` adds: to a joint (N,), a link's growth (N,), the base's
    motion (N, 6) or a target's place (N, 3); of compliance and flexibility it is empty. ``joint-sag`` is the compliance
    of a joint in an arm whose file holds no masses.
    """

    cause: str
    subject: str
    where: int
    shape: Array
    size: float = 1.0
    fixed: dict[str, float | str] = field(default_factory=dict)
    strength: float = 0.0


def hide(effects: Sequence[Effect], arm: Arm, schedule: Schedule, targets: int) -> State:
    """The state of an arm with effects in it."""
    state = at_rest(arm, schedule.readings, targets)
    for effect in effects:
        state = _added(state, effect)
    return state


def _added(state: State, effect: Effect) -> State:
    change, where = effect.size * effect.shape, effect.where
    if effect.cause in ("joint-compliance", "joint-sag"):
        return replace(state, compliance=_at(state.compliance, where, effect.size))
    if effect.cause == "link-bending":
        return replace(state, flexibility=_at(state.flexibility, where, effect.size))
    if effect.cause == "guideway-error":
        return replace(state, carriage=_at(state.carriage, (slice(None), where), change))
    if effect.cause == "link-growth":
        return replace(state, growth=_at(state.growth, (slice(None), where), change))
    if effect.cause == "joints-exchanged":
        return replace(state, angles=state.angles + change)
    if effect.cause == "target-moved":
        return replace(state, shift=_at(state.shift, (slice(None), where), change))
    if change.ndim == 2:
        return replace(state, twist=state.twist + change)
    return replace(state, angles=_at(state.angles, (slice(None), where), change))


def _at(values: Array, where: int | tuple[slice, int], change: Array | float) -> Array:
    changed = values.copy()
    changed[where] += change
    return changed


def draw_effect(
    cause: str, arm: Arm, schedule: Schedule, instrument: Instrument, rng: np.random.Generator
) -> list[Effect]:
    """Effects of one cause at every subject that can carry it, in random order; sizes are one unit."""
    if cause in (*JOINT_CAUSES, *ADDED):
        found = [_of_joint(cause, k, arm, schedule, rng) for k in range(len(arm.actuated)) if _fits(cause, arm, k)]
    elif cause in LINK_CAUSES:
        shape = schedule.warmth if cause == "link-growth" else np.zeros(0)
        found = [Effect(cause, f"link {arm.links[n].name}", n, shape) for n in _beams(cause, arm)]
    elif cause in BASE_CAUSES:
        found = [] if instrument.frame == "pose" else [_of_base(cause, arm, schedule, rng)]
    elif cause == "target-moved":
        found = [_of_target(n, instrument, schedule, rng) for n in range(len(instrument.targets))]
    elif cause == "joints-exchanged":
        found = _exchanges(arm, schedule)
    else:
        raise ValueError(f"cause {cause!r}: expected one of {', '.join((*CAUSES, *ADDED))}")
    return [found[n] for n in rng.permutation(len(found))]


def _fits(cause: str, arm: Arm, column: int) -> bool:
    own = arm.actuated[column]
    if cause == "joint-sag" and arm.loops is not None:  # what a joint carries in loops is no link above it
        return False
    if cause == "joint-sag" and any(j.kind == "prismatic" for j in arm.joints if j.child in arm.outboard(own)):
        return False
    slides = arm.joints[own].kind == "prismatic"
    return slides if cause in OF_SLIDES else not (slides and cause in OF_ANGLE)


def _of_joint(cause: str, column: int, arm: Arm, schedule: Schedule, rng: np.random.Generator) -> Effect:
    angle, fixed = schedule.readings[:, column], dict[str, float | str]()
    shape, phase = np.zeros(0), float(rng.uniform(-np.pi, np.pi))
    if cause == "joint-offset":
        shape = np.ones_like(angle)
    elif cause == "joint-gain":
        shape = angle
    elif cause == "joint-backlash":
        shape = -schedule.approach[:, column]
    elif cause == "joint-settling":
        tau = float(rng.uniform(0.2, 0.6) * np.median(schedule.waits))
        form = str(rng.choice(["share", "lag"]))
        moved = schedule.steps[:, column]
        left = np.exp(-schedule.waits / tau)
        shape, fixed = -(moved if form == "share" else np.sign(moved)) * left, {"tau": tau, "form": form}
    elif cause == "approach-scatter":
        shape = rng.normal(size=len(angle))
    elif cause in ("joint-eccentricity", "joint-harmonic"):
        order = 1.0 if cause == "joint-eccentricity" else float(rng.integers(2, 7))
        if cause == "joint-harmonic" and rng.random() < 0.5:
            order = round(float(rng.uniform(20.0, 180.0)), 1)
        shape, fixed = np.sin(order * angle + phase), {"order": order, "phase": phase}
    elif cause == "joint-pitch-error":
        travel = float(np.ptp(angle))
        pitch = float(rng.choice([own for own in PITCHES if 3.0 * own < travel < MOST_TURNS * own]))
        shape, fixed = np.sin(2.0 * np.pi * angle / pitch + phase), {"period": pitch, "phase": phase}
    elif cause == "joint-error-curve":
        shape = _teeth(angle, rng)
    elif cause == "guideway-error":
        shape, fixed = _rail(angle, arm.joints[arm.actuated[column]].axis, rng)
    return Effect(cause, f"joint {arm.names()[column]}", column, shape, fixed=fixed)


def _rail(travel: Array, axis: Array, rng: np.random.Generator) -> tuple[Array, dict[str, float | str]]:
    """Motion (N, 6) of a carriage: a bow with a wave in it, to one side of the rail or about one axis (1 rad per m)."""
    share = (travel - travel.min()) / np.ptp(travel)
    bow = np.sin(np.pi * share) + float(rng.uniform(-0.6, 0.6)) * np.sin(2.0 * np.pi * share)
    motions = [n for n in range(6) if n > 2 or abs(axis[n]) < 0.5]
    number = int(rng.choice(motions))
    return np.outer(bow, np.eye(6)[number]), {"motion": SIX[number]}


def _teeth(angle: Array, rng: np.random.Generator) -> Array:
    """An uneven saw over the turn: from tooth to tooth of 15 to 25 degrees a slow rise, a fast fall, another height."""
    ends = np.cumsum(rng.uniform(np.radians(15.0), np.radians(25.0), 30))
    ends = ends[: np.searchsorted(ends, 2.0 * np.pi)] * (2.0 * np.pi / ends[np.searchsorted(ends, 2.0 * np.pi) - 1])
    heights, place = rng.uniform(0.4, 1.0, len(ends)), np.mod(angle, 2.0 * np.pi)
    tooth = np.minimum(np.searchsorted(ends, place), len(ends) - 1)
    starts = np.concatenate([[0.0], ends[:-1]])
    share = (place - starts[tooth]) / (ends - starts)[tooth]
    return heights[tooth] * np.where(share < 0.7, share / 0.7, (1.0 - share) / 0.3)


def _beams(cause: str, arm: Arm) -> list[int]:
    """Links with one joint at their end, far enough away; a bent one may not carry a slide."""
    found = []
    for number in range(1, len(arm.links)):
        ends = arm.children(number)
        long = len(ends) == 1 and np.linalg.norm(arm.joints[ends[0]].origin[:3, 3]) > 0.05
        if long and (cause == "link-growth" or arm.joints[ends[0]].kind != "prismatic"):
            found.append(number)
    return found


def _of_base(cause: str, arm: Arm, schedule: Schedule, rng: np.random.Generator) -> Effect:
    if cause == "column-tilt":
        height = float(rng.uniform(0.0, 1.0))
        moment = base_moment(arm, places(arm, at_rest(arm, schedule.readings, 0)))
        way = np.concatenate([np.cross(moment, -height * arm.gravity), moment], axis=1)
        return Effect(cause, f"link {arm.links[0].name}", 0, way, fixed={"height": height})
    way = rng.normal(size=6) * np.array([1.0, 1.0, 1.0, 1.5, 1.5, 1.5])  # turns per metre of motion: a base of 0.7 m
    way, count = way / np.linalg.norm(way[:3]), len(schedule.time)
    fixed = {f"way_{name}": float(part) for name, part in zip(SIX, way, strict=True)}
    if cause == "base-drift":
        course = (schedule.time - schedule.time[0]) / (schedule.time[-1] - schedule.time[0])
        return Effect(cause, "", 0, np.outer(course, way), fixed={**fixed})
    start = int(rng.integers(count // 4, 3 * count // 4))
    after = (np.arange(count) >= start).astype(float)
    return Effect(cause, "", 0, np.outer(after, way), fixed={**fixed, "from_pose": float(start + 1)})


def _of_target(number: int, instrument: Instrument, schedule: Schedule, rng: np.random.Generator) -> Effect:
    way, count = rng.normal(size=3), len(schedule.time)
    way, start = way / np.linalg.norm(way), int(rng.integers(count // 4, 3 * count // 4))
    shape = np.outer((np.arange(count) >= start).astype(float), way)
    fixed: dict[str, float | str] = {f"way_{name}": float(part) for name, part in zip(SIX[:3], way, strict=True)}
    fixed["from_pose"] = float(start + 1)
    return Effect("target-moved", f"target {instrument.targets[number].name}", number, shape, fixed=fixed)


def _exchanges(arm: Arm, schedule: Schedule) -> list[Effect]:
    found, names = [], arm.names()
    kinds = [arm.joints[n].kind for n in arm.actuated]
    for one in range(len(names)):
        for other in range(one + 1, len(names)):
            if kinds[one] == kinds[other]:
                order = np.arange(len(names))
                order[[one, other]] = other, one
                shape = schedule.readings[:, order] - schedule.readings
                found.append(Effect("joints-exchanged", f"joint {names[one]} joint {names[other]}", one, shape))
    return found


def parameters(effect: Effect, arm: Arm) -> dict[str, dict[str, float | str]]:
    """Parameters of an effect by the names of the campaign format, in SI."""
    size, fixed = effect.size, effect.fixed
    slide = effect.cause in JOINT_CAUSES and arm.joints[arm.actuated[effect.where]].kind == "prismatic"
    unit = "m" if slide else "rad"
    named: dict[str, tuple[float, str]] = {}
    if effect.cause in ("joint-offset", "joint-backlash"):
        named = {effect.cause.removeprefix("joint-"): (size, unit)}
    elif effect.cause == "joint-gain":
        named = {"gain": (size, "1")}
    elif effect.cause == "approach-scatter":
        named = {"scatter": (size, unit)}
    elif effect.cause in ("joint-eccentricity", "joint-harmonic"):
        phase = float(fixed["phase"])
        named = {"sine": (size * np.cos(phase), "rad"), "cosine": (size * np.sin(phase), "rad")}
        if effect.cause == "joint-harmonic":
            named = {"order": (float(fixed["order"]), "1"), "amplitude": (abs(size), "rad"), **named}
    elif effect.cause == "joint-pitch-error":
        phase = float(fixed["phase"])
        named = {"period": (float(fixed["period"]), "m")}
        named |= {"sine": (size * np.cos(phase), "m"), "cosine": (size * np.sin(phase), "m")}
    elif effect.cause == "joint-error-curve":
        named = {"largest": (abs(size) * float(np.ptp(effect.shape)), "rad")}
    elif effect.cause == "joint-settling":
        form = str(fixed["form"])
        named = {form: (size, "1" if form == "share" else unit), "tau": (float(fixed["tau"]), "s")}
    elif effect.cause == "column-tilt":
        named = {"tilt": (size, "rad/(N m)"), "shift": (size * float(fixed["height"]), "m/(N m)")}
    elif effect.cause in ("joint-compliance", "joint-sag"):
        named = {"compliance": (size, "rad/(N m)")}
    elif effect.cause == "link-bending":
        named = {"flexibility": (size, "1/(N m^2)")}
    elif effect.cause == "link-growth":
        named = {"growth": (size, "1/K")}
    elif effect.cause.startswith("base-") or effect.cause == "target-moved":
        ways = {name: float(fixed[f"way_{name}"]) for name in SIX if f"way_{name}" in fixed}
        named = {name: (size * way, "rad" if name.startswith("r") else "m") for name, way in ways.items()}
        if "from_pose" in fixed:
            named["from_pose"] = (float(fixed["from_pose"]), "1")
    elif effect.cause == "foreign":
        named = {"size": (size, "")}
    return {name: {"value": float(value), "unit": of} for name, (value, of) in named.items()}
