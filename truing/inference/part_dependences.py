"""Columns on which the errors of single parts depend, such as one part's error on the inputs of two others.

All parts and all sets of columns compete, each as a Gaussian process. The process acts in the direction in which an
error of the part moves the observations. A dependence that is found becomes an unknown, and the search repeats.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np

from truing.inference.arrays import Array
from truing.inference.evidence import log_evidence_of_products
from truing.inference.input_sets import INCLUDED, Inputs, odds_of_sets, probability_of
from truing.inference.input_spectra import EFFECT_SIZES, Spectra
from truing.inference.part_errors import PartErrors, PartProblem
from truing.threads import in_order

_MOST_FOUND = 6  # dependences that are found in turn
_MOST_INPUTS = 2  # of a set: three hardly have two neighbouring epochs
_OWN = 0.5  # prior probability that an error depends on its own input and its history alone
_LEAST_POWER = 0.01  # variance of a parameter by the prior over that by noise; smaller ones are not held
_LOST = 0.5  # a part explains the same as the one held if it loses this share of its log odds


@dataclass(frozen=True)
class Part:
    """A part whose errors are tested: the directions in which it moves, and the column that moves it, if any."""

    directions: tuple[int, ...]
    column: str | None = None


@dataclass(frozen=True)
class PartDependence:
    """Columns on which the error of a part depends; ``index`` of that part, ``is_sure`` if no other explains the same.

    ``predicted`` (B, M): the change of the whitened rows by it. ``ends_early``: True if no other part was compared with
    it and no further dependence was searched, because the problem is too large.
    """

    index: int
    is_sure: bool
    inputs: Inputs
    p_value: float
    predicted: Array
    ends_early: bool = False


@dataclass(frozen=True)
class _OddsOfSets:
    """Log odds of every set of columns: that one direction of a part depends on it, and that any of them do."""

    of_one: Mapping[Inputs, float]
    of_any: Mapping[Inputs, float]

    @property
    def best(self) -> Inputs:
        """Most probable set."""
        return max(self.of_any, key=lambda inputs: self.of_any[inputs])


@dataclass(frozen=True)
class _Turn:
    """Errors of the parts next to earlier findings, and the log odds part by part."""

    problem: PartProblem
    errors: PartErrors
    odds: Sequence[_OddsOfSets]

    @cached_property
    def of_parts(self) -> Array:
        """Log odds (n,) that the error of each part depends on anything."""
        return np.array([np.logaddexp.reduce(list(odds_of_part.of_one.values())) for odds_of_part in self.odds])

    @property
    def p_value(self) -> float:
        """P-value of the mean likelihood ratio of all parts (Markov's inequality)."""
        return float(min(1.0, len(self.odds) * np.exp(-np.logaddexp.reduce(self.of_parts))))

    def likeliest(self, part: Part, inputs: Inputs, spectra: Spectra) -> Iterator[tuple[int, Array, Array]]:
        """Yield each direction of a part, its functions (B, r) of parameters N(0, 1), and the predicted error (B,)."""
        for direction in part.directions:
            several = spectra.functions_of(inputs)
            best = max(several, key=lambda functions: _evidence(self.errors, direction, functions))
            yield direction, *_predicted(self.errors, direction, best)


def part_dependences(
    problem: PartProblem, parts: Sequence[Part], spectra: Spectra, level: float
) -> Iterator[PartDependence]:
    """Yield the columns on which the errors of the parts depend, one dependence after another.

    Each adds unknowns. The search ends where they become too many: then no other part is compared with the last one.
    """
    for turn, after in _turns(problem, parts, spectra, level):
        index = int(np.argmax(turn.of_parts))
        odds_of_part = turn.odds[index]
        inputs = tuple(name for name in spectra.columns if probability_of(name, odds_of_part.of_any) >= INCLUDED)
        if inputs:
            moved = turn.problem.moved
            errors = turn.likeliest(parts[index], odds_of_part.best, spectra)
            predicted = np.sum([moved[:, :, place] * error[:, None] for place, _, error in errors], axis=0)
            is_sure = after is not None and not _explain_the_same(turn, after, index)
            yield PartDependence(index, is_sure, inputs, turn.p_value, predicted, ends_early=after is None)


def depends(problem: PartProblem, part: Part, inputs: Inputs, spectra: Spectra, level: float) -> bool:
    """Return True if the error of a part depends on a set of columns, which was found in another model."""
    errors, several = problem.estimated(), spectra.functions_of(inputs)
    log_evidences = [_evidence(errors, place, functions) for place in part.directions for functions in several]
    return bool(np.logaddexp.reduce(log_evidences) - np.log(len(log_evidences)) >= -np.log(level))


def _turns(
    problem: PartProblem, parts: Sequence[Part], spectra: Spectra, level: float
) -> Iterator[tuple[_Turn, _Turn | None]]:
    """Yield each turn that has a dependence, and the turn next to that; None if its problem is too large."""
    turn = _turn(problem, parts, spectra)
    for _ in range(_MOST_FOUND):
        if turn.p_value > level:
            return
        index, beyond = int(np.argmax(turn.of_parts)), turn.problem
        for direction, functions, _ in turn.likeliest(parts[index], turn.odds[index].best, spectra):
            beyond = beyond.beyond(direction, functions)
        after = None if beyond.is_too_large else _turn(beyond, parts, spectra)
        yield turn, after
        if after is None:
            return
        turn = after


def _turn(problem: PartProblem, parts: Sequence[Part], spectra: Spectra) -> _Turn:
    errors = problem.estimated()
    # Parts are independent, and most of the time is spent in products of matrices, outside Python.
    return _Turn(problem, errors, list(in_order(partial(_odds, errors, spectra), parts)))


def _explain_the_same(turn: _Turn, after: _Turn, index: int) -> bool:
    """Return True if another part was about as probable, and is no longer once the part is held."""
    before, later = turn.of_parts, after.of_parts
    rivals = (before > before[index] + np.log(1.0 / INCLUDED - 1.0)) & (later < _LOST * before)
    return bool(np.any(np.delete(rivals, index)))


def _odds(errors: PartErrors, spectra: Spectra, part: Part) -> _OddsOfSets:
    """Return the log odds of every set of columns over scatter, for the error of one part."""
    known: dict[Inputs, Array] = {}

    def of_directions(inputs: Inputs) -> Array:
        if inputs not in known:
            several = spectra.functions_of(inputs)
            log_evidences = [
                [_evidence(errors, place, functions) for functions in several] for place in part.directions
            ]
            known[inputs] = np.logaddexp.reduce(log_evidences, axis=1) - np.log(len(several))
        return known[inputs]

    def of_one(inputs: Inputs) -> float:
        return float(np.logaddexp.reduce(of_directions(inputs)) - np.log(len(part.directions)))

    def of_any(inputs: Inputs) -> float:
        return float(np.sum(np.logaddexp(0.0, of_directions(inputs)) - np.log(2.0)))

    names = tuple(spectra.columns)
    if len(part.directions) > 1:
        return _OddsOfSets(odds_of_sets(of_one, names, _MOST_INPUTS), odds_of_sets(of_any, names, _MOST_INPUTS))
    odds = odds_of_sets(of_one, names, _MOST_INPUTS)
    if part.column is not None:
        odds = {inputs: value + np.log1p(-_OWN) for inputs, value in odds.items()}
        own_reading = (part.column,)
        odds[own_reading] = float(np.logaddexp(of_one(own_reading) + np.log(_OWN), odds[own_reading]))
    return _OddsOfSets(odds, odds)


def _evidence(errors: PartErrors, index: int, functions: Array) -> float:
    """Return the log evidence of a random function over an error of the same part without any order, of any size."""
    squares, freedom = (of_parts[index] for of_parts in errors.squares)
    if not squares > 0.0:
        return 0.0
    gram, scores, size = errors.products(index, functions)
    return log_evidence_of_products(gram / size, scores / np.sqrt(size), squares, freedom, EFFECT_SIZES)


def _predicted(errors: PartErrors, index: int, functions: Array) -> tuple[Array, Array]:
    """Return functions (B, r) of a part's error whose parameters are N(0, 1), of the most probable size, and the error
    (B,) that they predict."""
    squares, freedom = (of_parts[index] for of_parts in errors.squares)
    if not squares > 0.0:  # a part that never errs along this direction, as one that was not measured along it
        return np.zeros((len(functions), 0)), np.zeros(len(functions))
    along, strengths, directions = errors.along(index, functions)
    powers = [(size * strengths) ** 2 for size in EFFECT_SIZES]
    noise = squares / freedom
    fits = [
        np.sum(along**2 * power_ratio / (1.0 + power_ratio)) / noise - np.sum(np.log1p(power_ratio))
        for power_ratio in powers
    ]
    power = powers[int(np.argmax(fits))]
    unit = functions @ directions
    is_large = power > _LEAST_POWER
    error = unit @ (along / strengths * power / (1.0 + power))
    return (unit * np.sqrt(power) / strengths)[:, is_large], error - error.mean()  # a constant is the part's zero
