"""Effects of no catalogued form: shapes of unit root mean square."""

from __future__ import annotations

import numpy as np

from tests.blind.generator.arms.arm import Arm
from tests.blind.generator.arms.effects import Effect
from tests.blind.generator.arms.instrument import Instrument
from tests.blind.generator.arms.schedule import Schedule
from tests.blind.generator.arms.transforms import Array

KINDS = ("two-joints", "remanence", "slow-base", "heavy-tails")
FOREIGN = tuple(f"foreign {kind}" for kind in KINDS)


def draw_foreign(
    kind: str, arm: Arm, schedule: Schedule, instrument: Instrument, rng: np.random.Generator
) -> list[Effect]:
    """Foreign effects of one kind at every joint that can carry it, in random order."""
    names, count = arm.names(), len(schedule.time)
    if kind == "slow-base":
        if instrument.frame == "pose":
            return []
        course = np.stack([_slow(schedule.time, rng) for _ in range(6)], axis=1) * np.array([1.0] * 3 + [1.5] * 3)
        return [Effect("foreign", "", 0, course, fixed={"kind": kind})]
    found = []
    for column in rng.permutation(len(names)):
        others = [k for k in range(len(names)) if k != column]
        two = rng.choice(others, 2, replace=False) if len(others) > 1 else np.array([column, others[0]])
        if kind == "two-joints":
            shape = _field(_scaled(schedule.readings[:, two]), rng)
        elif kind == "remanence":
            course = _scaled(schedule.readings[:, [column]])[:, 0]
            # Most of what remains is a gain and a backlash of the joint, which have names.
            shape = _beside(_play(course), np.stack([course, schedule.approach[:, column]], axis=1))
        elif kind == "heavy-tails":
            shape = rng.standard_t(1.5, size=count)
        else:
            raise ValueError(f"foreign effect {kind!r}: expected one of {', '.join(KINDS)}")
        fixed: dict[str, float | str] = {"kind": kind}
        if kind == "two-joints":
            fixed["inputs"] = " ".join(names[k] for k in two)
        found.append(Effect("foreign", f"joint {names[column]}", int(column), _unit(shape), fixed=fixed))
    return found


def _scaled(readings: Array) -> Array:
    low, high = readings.min(axis=0), readings.max(axis=0)
    return 2.0 * (readings - low) / (high - low) - 1.0


def _unit(shape: Array) -> Array:
    return shape / np.sqrt(np.mean(shape**2))


def _beside(shape: Array, columns: Array) -> Array:
    """Part of a shape (N,) that neither a constant nor the columns (N, C) explain."""
    known = np.column_stack([np.ones(len(shape)), columns])
    return np.asarray(shape - known @ np.linalg.lstsq(known, shape, rcond=None)[0])


def _field(inputs: Array, rng: np.random.Generator) -> Array:
    """Random smooth function (N,) of two inputs (N, 2) in -1..1: bumps of half the range wide."""
    centres, heights = rng.uniform(-1.2, 1.2, (25, 2)), rng.normal(size=25)
    away = np.sum((inputs[:, None] - centres) ** 2, axis=2)
    bumps = np.exp(-away / (2.0 * 0.45**2)) @ heights
    return bumps - bumps.mean()


def _play(course: Array) -> Array:
    """Hysteresis of a course in -1..1, by elements with play: it depends on the direction from which a place was
    reached."""
    remains = np.zeros(len(course))
    for width in (0.1, 0.3, 0.6, 0.9):
        place = 0.0
        for n, value in enumerate(course):
            place = min(max(place, value - width), value + width)
            remains[n] += place - value
    return remains - remains.mean()


def _slow(time: Array, rng: np.random.Generator) -> Array:
    """Smooth course (N,) over time without its line: three half waves and more."""
    share = (time - time[0]) / (time[-1] - time[0])
    course = sum(rng.normal() / k * np.cos(np.pi * k * share + rng.uniform(-1.0, 1.0)) for k in range(2, 7))
    line = np.polynomial.Polynomial.fit(share, np.asarray(course), 1)
    return _unit(np.asarray(course) - line(share))
