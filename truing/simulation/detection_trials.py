"""Detection trials: hide effects of several sizes in drawn campaigns, and estimate the rate at which the diagnosis
finds them.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
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
# Subjects of the form word and name: ``target P07``, ``joint elbow``, ``run 4 channel dz``, ``camera left``.
_NAMED = ("target", "load", "channel", "signal", "run", "camera", "bar", "window", "joint", "link")
# Number of random directions over which a reported size is averaged.
_PATTERNS = 32
# Least growth of a parameter, at twice the size, that counts as growth.
_LEAST_GROWTH = 1.2


@dataclass(frozen=True)
class EffectSize:
    """Size of an effect in the unit of the tables: root mean square of its parameters of one sort.

    ``beside`` names parameters of other units that grow with it.
    """

    parameter: str
    value: float
    unit: str
    beside: str = ""


@dataclass(frozen=True)
class EffectKind:
    """Effects of one kind of cause on one kind of subject (the whole, one leg, one target), with the same parameters.

    ``causes`` are all members that could show in the campaign; ``weights`` are their prior probabilities.
    """

    kind: str
    concerns: str  # the whole, one leg, one target
    causes: tuple[Cause, ...]
    weights: NDArray

    def draw(self, size: float, legs: int, rng: np.random.Generator) -> Effect:
        """Draw a member at a size: the root mean square of its parameters, in plausible scales."""
        cause = self.causes[int(rng.choice(len(self.causes), p=self.weights))]
        return Effect(cause, _values(cause, size, legs, rng))


def _values(cause: Cause, size: float, legs: int, rng: np.random.Generator) -> NDArray:
    """Draw parameters (P,), SI, in a random direction, whose root mean square is ``size`` plausible scales."""
    scale = np.array([parameter.scale for parameter in cause.parameters(legs)])
    return size * scale * _normed(rng.standard_normal(len(scale)))


def _normed(patterns: NDArray) -> NDArray:
    """Scale patterns (..., P) to a root mean square of one."""
    return np.asarray(patterns * np.sqrt(patterns.shape[-1]) / np.linalg.norm(patterns, axis=-1, keepdims=True))


@lru_cache(maxsize=256)
def _patterns(parameters: int) -> tuple[NDArray, NDArray]:
    """Draw random directions (N, P) and count equal ones; with one parameter these are its two signs."""
    drawn = _normed(np.random.default_rng(0).standard_normal((_PATTERNS, parameters)))
    return np.unique(drawn, axis=0, return_counts=True)


def reported_size(cause: Cause, size: float, legs: int) -> EffectSize:
    """Convert a size in plausible scales to the unit of the tables.

    Only parameters that grow with the size count: a phase does not, and the angle of a lost cosine grows with the
    square root. The size is that of the last such parameter and of all others with its unit.
    """
    once, twice = (_root_mean_squares(cause, factor * size, legs) for factor in (1.0, 2.0))
    growing = [key for key in once if np.isclose(twice[key], 2.0 * once[key], rtol=0.05)]
    growing = growing or [key for key in once if twice[key] > _LEAST_GROWTH * once[key]]
    if not growing:  # a count is reported as a whole number
        first = cause.parameters(legs)[0]
        return EffectSize(first.name, size * first.scale / first.si, first.unit)
    unit = growing[-1][1]
    alike = [key for key in growing if key[1] == unit]
    value = float(np.sqrt(np.mean([once[key] ** 2 for key in alike])))
    return EffectSize(
        " ".join(name for name, _ in alike), value, unit, " ".join(n for n, other in growing if other != unit)
    )


def _root_mean_squares(cause: Cause, size: float, legs: int) -> dict[tuple[str, str], float]:
    """Return the root mean square of each reported parameter of an effect, by name and unit.

    Parameters of several legs share one entry, named without the leg.
    """
    squares: dict[tuple[str, str], list[float]] = defaultdict(list)
    names: dict[tuple[str, str], set[str]] = defaultdict(set)
    for name, unit, values in _reported_values(cause, size, legs):
        key = (name.rstrip("0123456789_"), unit)
        squares[key] += values
        names[key].add(name)
    alone = {key: name.pop() if len(name) == 1 else key[0] for key, name in names.items()}
    return {(alone[key], key[1]): float(np.sqrt(np.mean(np.square(errors)))) for key, errors in squares.items()}


def _reported_values(cause: Cause, size: float, legs: int) -> Iterator[tuple[str, str, list[float]]]:
    """Yield names, units and values of the reported parameters of an effect, over all patterns."""
    parameters = cause.parameters(legs)
    scale = np.array([parameter.scale for parameter in parameters])
    patterns, counts = _patterns(len(scale))
    if type(cause).reported is Cause.reported:  # which only changes the unit
        values = np.repeat(size * scale * patterns, counts, 0) / [parameter.si for parameter in parameters]
        for parameter, of_parameter in zip(parameters, values.T.tolist(), strict=True):
            yield parameter.name, parameter.unit, of_parameter
        return
    for pattern, count in zip(patterns, counts, strict=True):
        for reported in cause.reported(size * scale * pattern, np.zeros((len(scale), len(scale))), legs):
            if isinstance(reported.value, (int, float)) and reported.sigma is not None:
                yield reported.name, reported.unit, [reported.value] * count


def effect_kinds(kinds: Iterable[CauseT], scene: Scene[CauseT], parts: int) -> list[EffectKind]:
    """Return the kinds of effect that causes could bring into a campaign; those on the whole machine first."""
    causes_of_kind: dict[tuple[str, ...], list[CauseT]] = {}
    for kind in kinds:
        for cause in (*scene.candidates(kind), *_members(kind, scene)):
            concerns = subject_class(cause.subject)
            if concerns is not None and cause.parameters(parts):
                causes_of_kind.setdefault((kind.id, concerns, *_kind_of_parameters(cause, parts)), []).append(cause)
    ordered = sorted(causes_of_kind.items(), key=lambda item: item[0][1] != _WHOLE)
    return [EffectKind(key[0], key[1], tuple(causes), _weights(causes, scene)) for key, causes in ordered]


def _members(kind: CauseT, scene: Scene[CauseT]) -> Iterable[CauseT]:
    for profiles in scene.channel_candidates(kind):
        for shape, target in np.argwhere(profiles.usable):
            yield profiles.member(int(target), int(shape))


def subject_class(subject: str) -> str | None:
    """Classify a subject: ``the whole``, ``one leg``, ``one target``, ``one load``, ...; None for several subjects."""
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


# Sizes of the trials, relative to the one that theory expects to be found with 80 % probability.
FACTORS = (0.5, 0.7, 1.0, 1.4, 2.0)
_OPEN = "alternative"  # reason code of a name that others may replace
_NOTHING = -1


class RepeatableCampaign(Protocol):
    """A campaign plan from which campaigns can be drawn repeatedly."""

    @property
    def scene(self) -> Scene:
        """Scene from which causes propose candidates."""

    @property
    def part_count(self) -> int:
        """Number of legs, or channels, by which parameters are numbered."""


@dataclass(frozen=True)
class DetectionQuestion:
    """Kind of effect whose detectable size is searched; ``sensitivities`` holds the theoretical sensitivity to its
    members."""

    kind: EffectKind
    sensitivities: tuple[EffectSensitivity, ...]
    unit: EffectSize  # one plausible scale of the effect, in the unit of the tables

    def rate(self, size: float) -> float:
        """Return the probability of detection that theory expects at a size of an effect that is drawn at random."""
        return float(np.mean([question.rate(size) for question in self.sensitivities])) if self.sensitivities else 0.0

    def signal_to_noise(self, size: float) -> float:
        """Return the mean signal-to-noise ratio at a size."""
        return (
            float(np.mean([question.signal_to_noise(size) for question in self.sensitivities]))
            if self.sensitivities
            else 0.0
        )

    def size_of(self, power: float) -> float | None:
        """Return the size, in plausible scales, at which theory expects this power; None if no size reaches it.

        Where too many shapes stay unseen at any size, such as late onsets, it is that of the shape of median
        sensitivity.
        """
        sizes = np.geomspace(1e-4, 1e3, 281)
        rates = np.array([self.rate(float(size)) for size in sizes])
        if rates[-1] < power and self.sensitivities:
            rates = np.mean([[question.power(float(size)) for size in sizes] for question in self.sensitivities], 0)
        return float(np.interp(power, rates, sizes)) if rates[-1] >= power else None

    @cached_property
    def expected(self) -> float | None:
        """Size that theory expects to be found with 80 % probability; None if the campaign cannot show the effect."""
        return self.size_of(POWER)


@dataclass(frozen=True)
class Trial:
    """One campaign to draw and diagnose: its question (-1: nothing hidden), the size, and the hidden effects."""

    question: int
    factor: float
    effects: tuple[Effect, ...]
    seed: tuple[int, ...]


@dataclass(frozen=True)
class Answer:
    """Result of the diagnosis of one drawn campaign."""

    question: int
    factor: float
    found: bool
    named: bool
    subject_right: bool
    others_found: tuple[str, ...]


@dataclass(frozen=True)
class Rate:
    """Number of successes and of trials."""

    count: int
    of: int

    @property
    def value(self) -> float | None:
        """Relative frequency; None without trials."""
        return self.count / self.of if self.of else None

    @property
    def bounds(self) -> tuple[float, float]:
        """Interval of the rate with 95 % confidence."""
        return rate_bounds(self.count, self.of)


def questions(
    plan: RepeatableCampaign, sensitivities: Sequence[EffectSensitivity], wanted: Sequence[str], known: Iterable[Cause]
) -> list[DetectionQuestion]:
    """Return one question for each kind of effect of the wanted causes (all causes if none is named), in catalogue
    order."""
    kinds: list[Cause] = [kind for kind in known if kind.catalogued]
    kinds = [kind for kind in kinds if not wanted or kind.id in wanted]
    legs = plan.part_count
    asked = [_question(sort, sensitivities, legs) for sort in effect_kinds(kinds, plan.scene, legs)]
    return sorted(asked, key=lambda question: [kind.id for kind in kinds].index(question.kind.kind))


def _question(sort: EffectKind, sensitivities: Sequence[EffectSensitivity], legs: int) -> DetectionQuestion:
    parameters = _names(sort.causes[0], legs)
    fixed = tuple(
        sight
        for sight in sensitivities
        if sight.kind == sort.kind
        and subject_class(sight.cause.subject) == sort.concerns
        and _names(sight.cause, legs) == parameters
    )
    size = reported_size(sort.causes[0], 1.0, legs)
    parameter, beside = (re.sub(r"_\d+\b", "", names) for names in (size.parameter, size.beside))
    return DetectionQuestion(sort, fixed, replace(size, parameter=parameter, beside=beside))


def _names(cause: Any, legs: int) -> list[tuple[str, str]]:
    return list(dict.fromkeys((p.name.rstrip("0123456789_"), p.unit) for p in cause.parameters(legs)))


def trials(
    asked: Sequence[DetectionQuestion], plan: RepeatableCampaign, draws: int, nothing: int, seed: int
) -> list[Trial]:
    """Return the campaigns to draw: ``draws`` for each size of every question, and ``nothing`` without an effect.

    Trials are interleaved, so that an interrupted call covers every question.
    """
    legs = plan.part_count
    listed = [Trial(_NOTHING, 0.0, (), (seed, 0, 0, number)) for number in range(nothing)]
    for index, question in enumerate(asked):
        if question.expected is None:
            continue
        for step, factor in enumerate(FACTORS):
            for number in range(draws):
                stream = (seed, index + 1, step, number)
                effect = question.kind.draw(factor * question.expected, legs, np.random.default_rng(stream))
                listed.append(Trial(index, factor, (effect,), (*stream, 1)))
    per_round = {_NOTHING: max(nothing // max(draws, 1), 1)}
    return sorted(listed, key=lambda trial: trial.seed[3] // per_round.get(trial.question, 1))


def trial_answer(trial: Trial, rows: Iterable[Mapping[str, object]]) -> Answer:
    """Compare rows of diagnosis.parquet with the hidden effect; indistinguishable candidates count as named too.

    An effect of which only the name is open, among alternatives, is found.
    """
    listed = list(rows)
    found_rows = [row for row in listed if row["verdict"] == "found" or row.get("reason_code") == _OPEN]
    hidden = trial.effects[0].cause if trial.effects else None
    alike = [*found_rows, *(row for row in listed if row["verdict"] == "indistinguishable")] if found_rows else []
    rows_of_cause = [row for row in alike if hidden is not None and row["cause"] == hidden.id]
    return Answer(
        trial.question,
        trial.factor,
        bool(found_rows),
        bool(rows_of_cause),
        any(hidden is not None and (row["subject"] or "") == hidden.subject for row in rows_of_cause),
        tuple(f"{row['cause']} {row['subject'] or ''}".strip() for row in found_rows),
    )


def false_alarms(answers: Iterable[Answer]) -> Rate:
    """Return the rate of findings in campaigns without a hidden effect."""
    answers_of_nothing = [answer for answer in answers if answer.question == _NOTHING]
    return Rate(sum(answer.found for answer in answers_of_nothing), len(answers_of_nothing))


@dataclass(frozen=True)
class Curve:
    """A question with its answers: detection rates by size, and causes found instead."""

    question: DetectionQuestion
    factors: tuple[float, ...]
    found: tuple[Rate, ...]
    named: tuple[Rate, ...]
    subject_right: tuple[Rate, ...]
    others_found: tuple[tuple[str, int], ...]  # other findings, with their counts

    def size(self, power: float) -> Interval | None:
        """Return the size, in plausible scales, that is found with this power; None if nothing was drawn."""
        expected = self.question.size_of(0.5)
        if not self.factors or self.question.expected is None or expected is None:
            return None
        counts = np.array([rate.of for rate in self.found])
        sizes = np.array(self.factors) * self.question.expected
        return size_found(sizes, np.array([rate.count for rate in self.found]), counts, expected, power)


def curve(question: DetectionQuestion, index: int, answers: Iterable[Answer]) -> Curve:
    """Collect the answers to one question by size."""
    answers_of_place = [answer for answer in answers if answer.question == index]
    factors = tuple(sorted({answer.factor for answer in answers_of_place}))
    by_factor = [[answer for answer in answers_of_place if answer.factor == factor] for factor in factors]
    named_instead: dict[str, int] = {}
    for text in (text for answer in answers_of_place if not answer.named for text in answer.others_found):
        named_instead[text] = named_instead.get(text, 0) + 1

    def rates(what: str) -> tuple[Rate, ...]:
        return tuple(Rate(sum(getattr(member, what) for member in group), len(group)) for group in by_factor)

    listed = tuple(sorted(named_instead.items(), key=lambda item: -item[1]))
    return Curve(question, factors, rates("found"), rates("named"), rates("subject_right"), listed)
