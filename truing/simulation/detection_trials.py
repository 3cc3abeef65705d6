"""Effects of every sort and of several sizes to hide in drawn campaigns, what was found of them, and rates."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from truing.estimation.dose_response import rate_bounds, size_found
from truing.estimation.interval import Interval
from truing.inference.detectable import POWER, EffectSensitivity
from truing.simulation.cause import Cause, CauseT, Effect, Scene

_WHOLE = "the whole"
# What is named by a word and its own name: ``target P07``, ``load fz``, ``run 4 channel dz``, ``camera left``.
_NAMED = ("target", "load", "channel", "signal", "run", "camera", "bar", "window")
# Patterns of an effect's parameters, over which its size is told.
_PATTERNS = 32
# What grows by less than this with twice the size does not grow.
_GROWN = 1.2


@dataclass(frozen=True)
class EffectSize:
    """How large an effect is, as the tables tell it: the root mean square of one sort of its parameters.

    ``beside`` names parameters of other units that grow with it.
    """

    parameter: str
    value: float
    unit: str
    beside: str = ""


@dataclass(frozen=True)
class EffectKind:
    """Effects of one sort: a kind of cause on the whole, on one leg or on one target, with the same parameters.

    ``causes`` are all of them that the campaign could show, ``weights`` how probable each is beforehand.
    """

    kind: str
    concerns: str  # the whole, one leg, one target
    causes: tuple[Cause, ...]
    weights: NDArray

    def draw(self, size: float, legs: int, rng: np.random.Generator) -> Effect:
        """Return one of them at a size: the root mean square of its parameters, in plausible scales."""
        cause = self.causes[int(rng.choice(len(self.causes), p=self.weights))]
        return Effect(cause, _values(cause, size, legs, rng))


def _values(cause: Cause, size: float, legs: int, rng: np.random.Generator) -> NDArray:
    """Return parameters (P,), SI, in no particular direction, whose root mean square is a size in plausible scales."""
    scale = np.array([parameter.scale for parameter in cause.parameters(legs)])
    return size * scale * _normed(rng.standard_normal(len(scale)))


def _normed(patterns: NDArray) -> NDArray:
    """Return patterns (..., P) whose root mean square is one."""
    return np.asarray(patterns * np.sqrt(patterns.shape[-1]) / np.linalg.norm(patterns, axis=-1, keepdims=True))


@lru_cache(maxsize=256)
def _patterns(parameters: int) -> tuple[NDArray, NDArray]:
    """Return patterns (N, P) in no particular direction, and how often each was drawn: of one parameter, its signs."""
    drawn = _normed(np.random.default_rng(0).standard_normal((_PATTERNS, parameters)))
    return np.unique(drawn, axis=0, return_counts=True)


def reported_size(cause: Cause, size: float, legs: int) -> EffectSize:
    """Return a size in plausible scales as the tables tell it.

    Of the parameters that grow with it (a phase does not; the angle of a lost cosine grows with its root) it is told by
    the last, and others of its unit.
    """
    once, twice = (_root_mean_squares(cause, factor * size, legs) for factor in (1.0, 2.0))
    growing = [key for key in once if np.isclose(twice[key], 2.0 * once[key], rtol=0.05)]
    growing = growing or [key for key in once if twice[key] > _GROWN * once[key]]
    if not growing:  # a count is told as a whole number
        first = cause.parameters(legs)[0]
        return EffectSize(first.name, size * first.scale / first.si, first.unit)
    unit = growing[-1][1]
    alike = [key for key in growing if key[1] == unit]
    value = float(np.sqrt(np.mean([once[key] ** 2 for key in alike])))
    return EffectSize(
        " ".join(name for name, _ in alike), value, unit, " ".join(n for n, other in growing if other != unit)
    )


def _root_mean_squares(cause: Cause, size: float, legs: int) -> dict[tuple[str, str], float]:
    """Return, by name (without leg, where several have it) and unit, the size of what the tables tell of an effect."""
    found: dict[tuple[str, str], list[float]] = defaultdict(list)
    names: dict[tuple[str, str], set[str]] = defaultdict(set)
    scale = np.array([parameter.scale for parameter in cause.parameters(legs)])
    for pattern, count in zip(*_patterns(len(scale)), strict=True):
        for reported in cause.reported(size * scale * pattern, np.zeros((len(scale), len(scale))), legs):
            if isinstance(reported.value, (int, float)) and reported.sigma is not None:
                key = (reported.name.rstrip("0123456789_"), reported.unit)
                found[key] += [reported.value] * count
                names[key].add(reported.name)
    alone = {key: own.pop() if len(own) == 1 else key[0] for key, own in names.items()}
    return {(alone[key], key[1]): float(np.sqrt(np.mean(np.square(own)))) for key, own in found.items()}


def effect_kinds(kinds: Iterable[CauseT], scene: Scene[CauseT], parts: int) -> list[EffectKind]:
    """Return the sorts of effect that kinds of cause could bring into a campaign, those on the whole first."""
    found: dict[tuple[str, ...], list[CauseT]] = {}
    for kind in kinds:
        for cause in (*scene.candidates(kind), *_members(kind, scene)):
            concerns = concerned(cause.subject)
            if concerns is not None and cause.parameters(parts):
                found.setdefault((kind.id, concerns, *_kind_of_parameters(cause, parts)), []).append(cause)
    ordered = sorted(found.items(), key=lambda item: item[0][1] != _WHOLE)
    return [EffectKind(key[0], key[1], tuple(causes), _weights(causes, scene)) for key, causes in ordered]


def _members(kind: CauseT, scene: Scene[CauseT]) -> Iterable[CauseT]:
    for profiles in scene.channel_candidates(kind):
        for shape, target in np.argwhere(profiles.usable):
            yield profiles.member(int(target), int(shape))


def concerned(subject: str) -> str | None:
    """Return what a subject is: the whole, one leg, one target, one load; None for several of them."""
    if not subject:
        return _WHOLE
    words = subject.split()
    if len(words) == 1:
        return f"one {subject.rstrip('0123456789')}"
    return f"one {words[0]}" if words[0] in _NAMED else None


def _kind_of_parameters(cause: Cause, legs: int) -> tuple[str, ...]:
    names = [f"{p.name.rstrip('0123456789_')} {p.unit}" for p in cause.parameters(legs)]
    return tuple(dict.fromkeys(names))


def _weights(causes: Iterable[CauseT], scene: Scene[CauseT]) -> NDArray:
    weights = np.array([scene.prior(cause) for cause in causes])
    return weights / weights.sum()


# Sizes that are tried, in units of the one that theory expects to be found four times out of five.
FACTORS = (0.5, 0.7, 1.0, 1.4, 2.0)
_NOTHING = -1


class RepeatableCampaign(Protocol):
    """A campaign that can be drawn again."""

    @property
    def scene(self) -> Scene:
        """What causes may propose candidates from."""

    @property
    def part_count(self) -> int:
        """How many legs, or channels, parameters are numbered by."""


@dataclass(frozen=True)
class DetectionQuestion:
    """From which size on is this sort of effect found? ``seen``: how well theory expects its members to be."""

    kind: EffectKind
    seen: tuple[EffectSensitivity, ...]
    unit: EffectSize  # an effect of one plausible scale, as the tables tell it

    def rate(self, size: float) -> float:
        """The probability of being found that theory expects at a size."""
        return float(np.mean([own.power(size) for own in self.seen])) if self.seen else 0.0

    def signal_to_noise(self, size: float) -> float:
        """The signal-to-noise ratio at a size, in the mean."""
        return float(np.mean([own.signal_to_noise(size) for own in self.seen])) if self.seen else 0.0

    def size_of(self, power: float) -> float | None:
        """The size, in plausible scales, that theory expects to be found with a probability; None where none is."""
        sizes = np.geomspace(1e-4, 1e3, 281)
        rates = np.array([self.rate(float(size)) for size in sizes])
        return float(np.interp(power, rates, sizes)) if rates[-1] >= power else None

    @cached_property
    def expected(self) -> float | None:
        """The size that theory expects to be found four times out of five; None where the campaign is blind to it."""
        return self.size_of(POWER)


@dataclass(frozen=True)
class Trial:
    """One campaign to be drawn and diagnosed: the question it answers (-1: nothing hidden), the size, what to hide."""

    question: int
    factor: float
    effects: tuple[Effect, ...]
    seed: tuple[int, ...]


@dataclass(frozen=True)
class Answer:
    """What the diagnosis said of one drawn campaign."""

    question: int
    factor: float
    found: bool
    named: bool
    subject_right: bool
    others_found: tuple[str, ...]


@dataclass(frozen=True)
class Rate:
    """How often something was so, of how many."""

    count: int
    of: int

    @property
    def value(self) -> float | None:
        """The rate; None of none."""
        return self.count / self.of if self.of else None

    @property
    def bounds(self) -> tuple[float, float]:
        """Between which it lies with a probability of 95 %."""
        return rate_bounds(self.count, self.of)


def questions(
    plan: RepeatableCampaign, seen: Sequence[EffectSensitivity], wanted: Sequence[str], known: Iterable[Cause]
) -> list[DetectionQuestion]:
    """A question per sort of effect of the wanted causes (all, where none is named), in the order of those known."""
    kinds: list[Cause] = [kind for kind in known if kind.catalogued]
    kinds = [kind for kind in kinds if not wanted or kind.id in wanted]
    legs = plan.part_count
    asked = [_question(sort, seen, legs) for sort in effect_kinds(kinds, plan.scene, legs)]
    return sorted(asked, key=lambda question: [kind.id for kind in kinds].index(question.kind.kind))


def _question(sort: EffectKind, seen: Sequence[EffectSensitivity], legs: int) -> DetectionQuestion:
    parameters = _names(sort.causes[0], legs)
    own = tuple(
        sight
        for sight in seen
        if sight.kind == sort.kind
        and concerned(sight.cause.subject) == sort.concerns
        and _names(sight.cause, legs) == parameters
    )
    size = reported_size(sort.causes[0], 1.0, legs)
    parameter, beside = (re.sub(r"_\d+\b", "", names) for names in (size.parameter, size.beside))
    return DetectionQuestion(sort, own, replace(size, parameter=parameter, beside=beside))


def _names(cause: Any, legs: int) -> list[tuple[str, str]]:
    return list(dict.fromkeys((p.name.rstrip("0123456789_"), p.unit) for p in cause.parameters(legs)))


def trials(
    asked: Sequence[DetectionQuestion], plan: RepeatableCampaign, draws: int, nothing: int, seed: int
) -> list[Trial]:
    """The campaigns to draw: ``draws`` per size of every question, and ``nothing`` without an effect.

    One of each comes before the second of any, so that what is there of an interrupted call tells of all.
    """
    legs = plan.part_count
    listed = [Trial(_NOTHING, 0.0, (), (seed, 0, 0, number)) for number in range(nothing)]
    for place, question in enumerate(asked):
        if question.expected is None:
            continue
        for step, factor in enumerate(FACTORS):
            for number in range(draws):
                own = (seed, place + 1, step, number)
                effect = question.kind.draw(factor * question.expected, legs, np.random.default_rng(own))
                listed.append(Trial(place, factor, (effect,), (*own, 1)))
    per_round = {_NOTHING: max(nothing // max(draws, 1), 1)}
    return sorted(listed, key=lambda trial: trial.seed[3] // per_round.get(trial.question, 1))


def answer(trial: Trial, rows: Iterable[Mapping[str, Any]]) -> Answer:
    """What rows of diagnosis.parquet say of what was hidden. Named, too, is what cannot be told from a found one."""
    listed = list(rows)
    found = [row for row in listed if row["verdict"] == "found"]
    hidden = trial.effects[0].cause if trial.effects else None
    alike = [r for r in listed if r["verdict"] in ("found", "indistinguishable")] if found else []
    own = [row for row in alike if hidden is not None and row["cause"] == hidden.id]
    return Answer(
        trial.question,
        trial.factor,
        bool(found),
        bool(own),
        any(hidden is not None and (row["subject"] or "") == hidden.subject for row in own),
        tuple(f"{row['cause']} {row['subject'] or ''}".strip() for row in found),
    )


def false_alarms(answers: Iterable[Answer]) -> Rate:
    """How often something was found where nothing was hidden."""
    own = [given for given in answers if given.question == _NOTHING]
    return Rate(sum(given.found for given in own), len(own))


@dataclass(frozen=True)
class Curve:
    """A question with its answers: rates by size, and the sizes that are found four times and 19 times out of 20."""

    question: DetectionQuestion
    factors: tuple[float, ...]
    found: tuple[Rate, ...]
    named: tuple[Rate, ...]
    subject_right: tuple[Rate, ...]
    others_found: tuple[tuple[str, int], ...]  # what was found instead, and how often

    def size(self, power: float) -> Interval | None:
        """The size, in plausible scales, that is found with a probability; None where nothing was drawn."""
        expected = self.question.size_of(0.5)
        if not self.factors or self.question.expected is None or expected is None:
            return None
        counts = np.array([rate.of for rate in self.found])
        sizes = np.array(self.factors) * self.question.expected
        return size_found(sizes, np.array([rate.count for rate in self.found]), counts, expected, power)


def curve(question: DetectionQuestion, place: int, answers: Iterable[Answer]) -> Curve:
    """The answers to one question, by size."""
    own = [given for given in answers if given.question == place]
    factors = tuple(sorted({given.factor for given in own}))
    by_factor = [[given for given in own if given.factor == factor] for factor in factors]
    others: dict[str, int] = {}
    for text in (text for given in own if not given.named for text in given.others_found):
        others[text] = others.get(text, 0) + 1

    def rates(what: str) -> tuple[Rate, ...]:
        return tuple(Rate(sum(getattr(given, what) for given in group), len(group)) for group in by_factor)

    listed = tuple(sorted(others.items(), key=lambda item: -item[1]))
    return Curve(question, factors, rates("found"), rates("named"), rates("subject_right"), listed)
