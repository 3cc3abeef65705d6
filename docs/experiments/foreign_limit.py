"""``python -m docs.experiments.foreign_limit``: largest share of inputs of unmodelled effects that any method can name.

Pattern, size and noise of each effect are known, without the part that the fit's unknowns absorb. Inputs are named by
Bayes' rule with the generator's own prior. Once each effect acts alone; once next to all other effects of its campaign,
of which also the inputs, and the errors of an instrument by place, are known. No method can name more inputs with the
same certainty.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from benchmarks.blind import FOREIGN, INSTRUMENTS, drawn
from tests.blind.generator.case import Case, Measure
from tests.blind.generator.draw import Plan
from tests.blind.generator.effects import Setting
from tests.blind.generator.foreign import (
    Foreign,
    ForeignDrives,
    ForeignField,
    LandsElsewhere,
    NobodyRecorded,
    Remembers,
    WanderingBase,
    _input,
)
from tests.blind.generator.machine import Machine
from tests.blind.generator.quaternions import Array
from tests.blind.generator.smooth import LENGTH_SCALES, random_walk, remanence, standardised
from tests.blind.generator.strength import change

SEED, CAMPAIGNS, DRAWS, DRAWS_OF_COURSES = 331177, 40, 6, 200
FOLLOWS_NOTHING, NAMED = 0.4, 0.9  # prior of an effect without a column; probability from which an input is named
STEP = 1e-4  # mm: every pathway is in proportion
LEAST = 1e-4  # of a covariance's largest eigenvalue; smaller ones are left out
TAIL = 2.0  # degrees of freedom of an approach's scatter
Inputs = tuple[str, ...]


@dataclass(frozen=True)
class Moves(Foreign):
    """Unit motion of one pathway of an effect, the same in every pose: a leg's drive, a joint of the base, a field, or
    lengths in a known ratio."""

    of: Foreign
    place: int

    @property
    def drivers(self) -> Inputs:
        return ()

    def drive(self, drho: Array, setting: Setting) -> Array:
        return drho + STEP * (np.arange(drho.shape[1]) == self.place) if isinstance(self.of, DRIVES) else drho

    def structure(self, machine: Machine, setting: Setting) -> None:
        if isinstance(self.of, ForeignField):
            _Whole(STEP, self.of.seed, self.of.inputs, body=self.of.body).structure(machine, setting)
        elif isinstance(self.of, WanderingBase):
            machine.a[:, self.place // 3, self.place % 3] += STEP
        elif isinstance(self.of, NobodyRecorded):
            legs = machine.length.shape[1]
            machine.length += STEP * np.random.default_rng(self.of.seed + 1).uniform(-1, 1, legs)


class _Whole(ForeignField):
    """A field at full size in every pose."""

    def course(self, drho: Array, setting: Setting, seed: int) -> Array:
        return np.ones(len(drho))


DRIVES = ForeignDrives, LandsElsewhere, Remembers
ASKED = ForeignDrives, ForeignField, Remembers  # a base that wanders takes minutes
MOVING = *DRIVES, ForeignField, WanderingBase, NobodyRecorded  # the others are errors by place


@dataclass(frozen=True)
class Pathways:
    """Pathways of an effect: what moves each by one, and its courses in all poses (N, I), mm."""

    effect: Foreign
    places: tuple[int, ...]
    courses: Array


@dataclass(frozen=True)
class World:
    """The fitted poses of a campaign: columns (N,) by name, and the courses (N, I) of all effects.

    information (N I, N I): on the courses, in order of poses; factors: of the courses' covariances. drho and in_time:
    displacements in all poses, and the poses' order in time.
    """

    columns: Mapping[str, Array]
    drho: Array
    in_time: NDArray[np.intp]
    fitted: NDArray[np.bool_]
    pathways: tuple[Pathways, ...]
    information: Array
    factors: list[Array]
    friction: dict[int, Array]

    @cached_property
    def owners(self) -> NDArray[np.intp]:
        """The effect of each course (I,)."""
        return np.repeat(np.arange(len(self.pathways)), [len(pathway.places) for pathway in self.pathways])

    @cached_property
    def courses(self) -> Array:
        """Courses (N, I) less their means, mm."""
        every = np.concatenate([pathway.courses[self.fitted] for pathway in self.pathways], 1)
        return np.asarray(every - every.mean(0))

    @cached_property
    def powers(self) -> Array:
        """Mean squares (I,) of the courses."""
        return np.asarray(np.mean(self.courses**2, axis=0))


def smooth(inputs: Array, rng: np.random.Generator) -> list[Array]:
    """Covariances (N, N), of unit mean variance, of the generator's functions of inputs (N, D), by drawn length
    scales."""
    scaled = standardised(inputs)
    plane = np.column_stack([np.ones(len(scaled)), scaled])
    rest = np.eye(len(scaled)) - plane @ np.linalg.pinv(plane)
    found = []
    for _ in range(DRAWS):
        apart = scaled / rng.uniform(*LENGTH_SCALES, scaled.shape[1])
        kernel = rest @ np.exp(-0.5 * np.sum((apart[:, None] - apart) ** 2, -1)) @ rest
        if np.trace(kernel) > 1e-6 * len(kernel):
            found.append(kernel * len(kernel) / np.trace(kernel))
    return found


def of_courses(courses: Array) -> Array:
    """Covariance (N, N), of unit mean variance, of courses (D, N) that were drawn."""
    centred = courses - courses.mean(1, keepdims=True)
    kernel = centred.T @ centred
    return np.asarray(kernel * len(kernel) / np.trace(kernel))


def friction(world: World, leg: int) -> Array:
    """Covariance (N, N) of the generator's friction in an actuator."""
    if leg not in world.friction:
        courses = np.empty((DRAWS_OF_COURSES, len(world.drho)))
        for seed, own in enumerate(courses):
            own[world.in_time] = remanence(world.drho[world.in_time, leg], seed)
        world.friction[leg] = of_courses(courses[:, world.fitted])
    return world.friction[leg]


def prior(columns: Sequence[str]) -> dict[Inputs, float]:
    """Probability of every set of inputs, as the generator draws it."""
    readings = [name for name in columns if name.startswith("rho")]
    others = [name for name in columns if not name.startswith("rho")]
    pairs = list(combinations(readings, 2))
    drives: dict[Inputs, float] = {(name,): 0.5 / len(readings) for name in readings}
    drives |= dict.fromkeys(pairs, 0.5 / len(pairs))
    found: dict[Inputs, float] = {(other,): 0.25 / len(others) for other in others}
    for own, share in drives.items():
        found[own] = 0.5 * share
        found |= {(*own, other): 0.25 * share / len(others) for other in others}
    return found


def factor(covariance: Array) -> Array:
    """Return F (N, r) with F F^T = covariance, but for its smallest eigenvalues."""
    values, vectors = np.linalg.eigh(covariance)
    kept = values > LEAST * values[-1]
    return np.asarray(vectors[:, kept] * np.sqrt(values[kept]))


def world_of(case: Case, rng: np.random.Generator) -> World:
    """Return the fitted poses of a case, and the information of its fit on all courses."""
    assert isinstance(case.plan, Plan)
    campaign, measure = case.plan.campaign(), Measure(case.plan)
    schedule, drho = campaign.schedule, campaign.truth.drho
    fitted = np.array(schedule.role) != "verification"
    names = [f"rho{k + 1}_mm" for k in range(drho.shape[1])]
    names += ["time_s", "temperature_c", *schedule.further]
    columns = {name: _input(name, drho, measure._setting)[fitted] for name in names}
    moving = [effect for effect in case.effects if isinstance(effect, MOVING)]
    pathways = tuple(_pathways(effect, measure, drho) for effect in moving)
    plain, fit = case.plan.campaign(exact=True), measure._fit
    each = []
    for own in pathways:
        for place in own.places:
            moved = case.plan.campaign([Moves(1.0, 0, own.effect, place)], exact=True)
            each.append(change(plain, moved) / STEP * fit.weight)
    seen = np.stack(each, -1)[fitted]
    basis = fit.own[fitted]
    seen = seen - basis @ (np.swapaxes(basis, 1, 2) @ seen)
    shared = fit.shared.reshape(*fit.weight.shape, -1)[fitted]
    taken = (np.swapaxes(seen, 1, 2) @ shared).reshape(-1, shared.shape[-1])
    information = -taken @ fit.inverse @ taken.T
    count = seen.shape[-1]
    for pose, own in enumerate(seen):
        at = slice(pose * count, (pose + 1) * count)
        information[at, at] += own.T @ own
    world = World(columns, drho, np.argsort(schedule.time_s), fitted, pathways, information, [], {})
    for own in pathways:
        world.factors.extend(factor(covariance_of(world, own, column, rng)) for column in range(len(own.places)))
    return world


def _pathways(effect: Foreign, measure: Measure, drho: Array) -> Pathways:
    """Return the pathways of an effect with their courses; the effect itself computes the errors of the drives."""
    setting, size = measure._setting, effect.size
    if isinstance(effect, DRIVES):
        moved = effect.drive(drho, setting) - drho
        places = tuple(np.flatnonzero(np.ptp(moved, axis=0) > 0.0).tolist())
        return Pathways(effect, places, moved[:, places])
    if isinstance(effect, ForeignField):
        return Pathways(effect, (0,), size * effect.course(drho, setting, effect.seed)[:, None])
    if isinstance(effect, WanderingBase):
        joints = _joints(effect, measure)
        return Pathways(effect, tuple(range(joints.shape[1])), joints)
    in_time, walk = np.argsort(setting.schedule.time_s), np.empty(len(drho))
    walk[in_time] = random_walk(len(walk), effect.seed)
    return Pathways(effect, (0,), size * walk[:, None])


def _joints(effect: WanderingBase, measure: Measure) -> Array:
    """Return the displacements (N, 3 L), mm, of the base's joints."""
    count = len(measure.plain.schedule.pose)
    joints, nothing = np.zeros((count, measure.plain.readings.shape[1], 3)), np.zeros(0)
    machine = Machine(joints, nothing, nothing, nothing, nothing, nothing, nothing, nothing, 0.0)
    effect.structure(machine, measure._setting)
    return machine.a.reshape(count, -1)


def covariance_of(world: World, own: Pathways, column: int, rng: np.random.Generator) -> Array:
    """Return the covariance (N, N) of a course whose inputs are known."""
    effect, course = own.effect, own.courses[world.fitted, column]
    power = float(np.mean((course - course.mean()) ** 2))
    if isinstance(effect, LandsElsewhere):  # how far a single approach scatters is known, too
        core = effect.size / 10.0
        return np.diag((TAIL * core**2 + course**2) / (TAIL + 1.0))
    if isinstance(effect, Remembers):
        return power * friction(world, own.places[column])
    if isinstance(effect, NobodyRecorded):
        walks = np.empty((DRAWS_OF_COURSES, len(world.drho)))
        for seed, walk in enumerate(walks):
            walk[world.in_time] = random_walk(len(walk), seed)
        return power * of_courses(walks[:, world.fitted])
    inputs = np.column_stack([world.columns[name] for name in effect.drivers])
    return power * np.mean(smooth(inputs, rng), axis=0)


def hypotheses(world: World, own: Pathways, rng: np.random.Generator) -> list[tuple[Inputs, float, Array]]:
    """Return hypotheses on the courses of an effect: inputs, log prior, and covariance (N, N) of unit mean variance."""
    count = int(world.fitted.sum())
    names, found = list(world.columns), []
    legs = own.places if isinstance(own.effect, (ForeignDrives, Remembers)) else ()
    nothing = 1.0 / 3.0 if legs else FOLLOWS_NOTHING
    functions = 1.0 / 3.0 if legs else 1.0 - FOLLOWS_NOTHING
    for inputs, share in prior(names).items():
        each = smooth(np.column_stack([world.columns[name] for name in inputs]), rng)
        found += [(inputs, float(np.log(functions * share / len(each))), kernel) for kernel in each]
    found += [((f"rho{leg + 1}_mm",), float(np.log(1.0 / 3.0 / len(legs))), friction(world, leg)) for leg in legs]
    return [*found, ((), float(np.log(nothing)), np.eye(count) - 1.0 / count)]


def courses_together(own: Pathways) -> list[list[int]]:
    """Return the courses of an effect that follow the same inputs: friction of each actuator is its own."""
    each = range(len(own.places))
    return [[column] for column in each] if isinstance(own.effect, Remembers) else [list(each)]


def named(world: World, number: int, noise: Array, rng: np.random.Generator, *, alone: bool) -> set[str]:
    """Return the inputs that the courses of an effect follow with a probability of at least 0.9.

    ``noise`` (N I,): noise of the scores of all courses, with the information as covariance.
    """
    own, reported = world.pathways[number], set[str]()
    acting = np.flatnonzero((world.owners == number) | (not alone))
    first, possible = int(np.flatnonzero(world.owners == number)[0]), hypotheses(world, own, rng)
    for together in courses_together(own):
        asked = [first + column for column in together]
        odds = _odds(possible, *_beside(world, asked, acting, noise), world.powers[asked])
        every = np.logaddexp.reduce(list(odds.values()))
        for name in world.columns:
            with_it = [value for inputs, value in odds.items() if name in inputs]
            if with_it and np.exp(np.logaddexp.reduce(with_it) - every) >= NAMED:
                reported.add(name)
    return reported


def _beside(world: World, asked: Sequence[int], acting: NDArray[np.intp], noise: Array) -> tuple[Array, Array]:
    """Return the information on some courses, one after the other, and their scores, next to all that act."""
    poses, count = world.courses.shape
    place = np.arange(poses * count).reshape(poses, count)
    score = world.information @ (world.courses * np.isin(np.arange(count), acting)).ravel() + noise
    at = place[:, asked].T.ravel()
    others = [k for k in acting if k not in asked]
    if not others:
        return world.information[np.ix_(at, at)], score[at]
    ends = np.cumsum([0, *(world.factors[k].shape[1] for k in others)])
    wide = np.zeros((place.size, ends[-1]))
    for k, start, end in zip(others, ends[:-1], ends[1:], strict=True):
        wide[place[:, k], start:end] = world.factors[k]
    moved = world.information @ wide
    inner = np.eye(ends[-1]) + wide.T @ moved
    taken = np.linalg.solve(inner, np.column_stack([moved[at].T, wide.T @ score]))
    left = np.column_stack([world.information[np.ix_(at, at)], score[at]]) - moved[at] @ taken
    return left[:, :-1], left[:, -1]


def _odds(
    possible: Sequence[tuple[Inputs, float, Array]], information: Array, score: Array, powers: Array
) -> dict[Inputs, float]:
    """Return the log odds of each set of inputs, for courses of mean squares ``powers`` next to each other."""
    found = dict[Inputs, float]()
    for inputs, log_prior, kernel in possible:
        wide = np.kron(np.diag(np.sqrt(powers)), factor(kernel))
        root = np.linalg.cholesky(np.eye(wide.shape[1]) + wide.T @ information @ wide)
        along = np.linalg.solve(root, wide.T @ score)
        value = 0.5 * along @ along - np.sum(np.log(np.diag(root)))
        found[inputs] = float(np.logaddexp(found.get(inputs, -np.inf), log_prior + value))
    return found


def main() -> None:
    """Print the table of docs/foreign-worlds.md."""
    found = list[tuple[bool, int, bool, bool]]()
    for number in range(CAMPAIGNS):
        one, rng = drawn(number, SEED, group=FOREIGN), np.random.default_rng(number)
        try:
            case = INSTRUMENTS[one.instrument].hide(one.names, one.layout, one.strength, one.seed)
        except ValueError:  # what a layout does not show cannot be hidden in it
            continue
        assert isinstance(case, Case)
        world = world_of(case, rng)
        values, vectors = np.linalg.eigh(world.information)
        noise = vectors @ (np.sqrt(np.maximum(values, 0.0)) * rng.normal(size=len(values)))
        for place, own in enumerate(world.pathways):
            if isinstance(own.effect, ASKED):
                inputs = set(own.effect.drivers)
                reported = [inputs <= named(world, place, noise, rng, alone=alone) for alone in (True, False)]
                found.append((isinstance(own.effect, Remembers), len(inputs), reported[0], reported[1]))
    for label, rows in _rows(np.array(found, int)):
        shares = " | ".join(f"{100.0 * share:.0f} %" for share in rows[:, 2:].mean(0))
        sys.stdout.write(f"| {label} | {len(rows)} | {shares} |\n")


def _rows(found: Array) -> list[tuple[str, Array]]:
    """Return the labels of the table with their effects."""
    functions = found[found[:, 0] == 0]
    rows = [(f"function of {size}", functions[functions[:, 1] == size]) for size in (1, 2, 3)]
    return [*rows, ("friction with memory", found[found[:, 0] == 1]), ("all", found)]


if __name__ == "__main__":
    main()
