"""Search for slips that explain unexpected responses, in competition with all physical causes.

Responses are compared on a scale that is logarithmic for main ones and linear for those near zero. A factor between
units, a sign and an exchange are large on it; a stiffness that differs by a third is not.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from truing.arrays import Array, Index, Mask
from truing.belonging.evidence import log_evidence, physics
from truing.belonging.relation import RecordSlip, RelationState, RelationTest, SlipKind, named_shortly
from truing.belonging.responses import Responses

_UNEXPLAINED = 0.5  # share of the expected responses that slips may leave as misfit
_SHARED = 0.1  # prior width, relative, of what all responses have in common; and those of an axis, of a column
_BESIDE = 0.7  # share of a response's prior width that remains when common widths are separate
_TELLING = 0.3  # share of the possible response, expected or recorded, above which one separates hypotheses
_FLOOR, _CEILING = 0.01, 0.5  # relative scatter of responses from run to run, at least and at most
CLEARLY, _RIGHT = 2.0, 1.2  # least deviation of affected responses as recorded, and largest after correction, in widths
_MUCH = 12.0  # log evidence that a slip must gain beyond the chance gain by its number of rivals
_AS_LIKELY = 3.0  # log evidence within which another slip is as likely
_COMPARED = 12  # number of the nearest candidates whose evidence is computed
_ROUNDS = 6
_MOST_SLIPS = 2
_CLEAR = 0.1  # largest sigma of a usable response over the typical size of its column


@dataclass(frozen=True)
class ExpectedResponse:
    """Expected response of columns (K) to loads: matrix (K, 6), in the unit of the columns per N and N m.

    The product of ``of_column`` (K,) and ``of_load`` (6,) is the largest possible response. ``gain`` is the relative
    prior width of a column's own gain; ``cross`` and ``main`` those of one response, as shares of the largest possible
    and of its own. Below the share ``linear``, responses are compared by differences, not by ratios.
    """

    matrix: Array
    of_column: Array
    of_load: Array
    gain: float = _SHARED
    cross: float = 0.1
    main: float = 0.15
    linear: float = 0.1

    def expected(self, column: Index, direction: Array) -> Array:
        """Return the expected response (C,) of columns (C,) to loads (C, 6)."""
        return np.asarray(np.sum(self.matrix[column] * direction, axis=1))

    def possible(self, column: Index, direction: Array) -> Array:
        """Return the largest possible response (C,) of columns (C,) to loads (C, 6)."""
        return np.asarray(self.of_column[column] * np.linalg.norm(direction * self.of_load, axis=1))


@dataclass(frozen=True)
class ColumnReading:
    """An interpretation of the records: loads (C, 6), true column (C,) of each response, and correction factor (C,)."""

    direction: Array
    column: Index
    factor: Array


@dataclass(frozen=True)
class SlipCandidate:
    """A slip, the responses (C,) that it may concern, their interpretation, and the log number of similar slips."""

    slip: RecordSlip
    concerns: Mask
    undo: Callable[[ColumnReading], ColumnReading]
    penalty: float = 0.0


@dataclass(frozen=True)
class Explained:
    """Slips that apply together, equally likely ones, relative misfit before and after, number of tests, and
    deviations.

    ``misses`` (C,) are the deviations of all responses, in widths, with the slips undone.
    """

    slips: tuple[RecordSlip, ...]
    rivals: tuple[RecordSlip, ...]
    before: float
    after: float
    tried: int
    misses: Array

    def tested(self, relation: str, state: RelationState, reason: str, hidden: Sequence[RecordSlip]) -> RelationTest:
        """Return the result for a relation: a failure if there are slips, otherwise the given state."""
        before, after = 100.0 * self.before, 100.0 * self.after
        if not self.slips:
            return RelationTest(relation, state, reason, "", before, unit="%", tried=self.tried, hidden=tuple(hidden))
        subject = named_shortly(list(dict.fromkeys(name for slip in self.slips for name in slip.subjects)))
        if self.after > _UNEXPLAINED:
            return RelationTest(relation, RelationState.FAILS, "no-slip", subject, before, unit="%", tried=self.tried)
        sizes = (before, after, None, "%")
        return RelationTest(relation, RelationState.FAILS, "slip", subject, *sizes, self.slips, self.rivals, self.tried)


@dataclass(frozen=True)
class _ScaledResponses:
    """Responses and expectations as shares of the possible ones, on the scale (C,) of comparison."""

    share: Array
    expected: Array
    possible: Array
    by: ExpectedResponse

    @property
    def misfit(self) -> Array:
        return np.arcsinh(self.share / self.by.linear) - np.arcsinh(self.expected / self.by.linear)

    @property
    def slope(self) -> Array:
        """Slope of the scale at the expectation."""
        return 1.0 / np.hypot(self.expected, self.by.linear)

    @property
    def width(self) -> Array:
        """Prior width on that scale."""
        return np.asarray((self.by.cross + self.by.main * np.abs(self.expected)) * self.slope)

    @property
    def deviations(self) -> Array:
        """Deviation in prior widths."""
        return np.asarray(self.misfit / self.width)

    @property
    def is_large(self) -> Mask:
        """True for responses that are, or should be, large enough to separate hypotheses."""
        return np.maximum(np.abs(self.share), np.abs(self.expected)) > _TELLING

    def subset(self, rows: Mask) -> _ScaledResponses:
        return _ScaledResponses(self.share[rows], self.expected[rows], self.possible[rows], self.by)


def clear_responses(responses: Responses, count: int) -> Responses:
    """Return the responses of columns (count) that are clear of their scatter."""
    typical = np.array(
        [
            np.quantile(np.abs(responses.size[mine]), 0.75) if (mine := responses.column == k).any() else 0.0
            for k in range(count)
        ]
    )
    return responses.subset(responses.sigma <= _CLEAR * np.maximum(typical[responses.column], np.abs(responses.size)))


def as_recorded(responses: Responses) -> ColumnReading:
    """Return the interpretation of responses as recorded."""
    return ColumnReading(responses.direction, responses.column, np.ones(len(responses)))


def misses_read(responses: Responses, expected: ExpectedResponse, read: ColumnReading) -> Array:
    """Return the deviation (C,) of responses under an interpretation, in prior widths."""
    return _compare(responses, expected, read).deviations


def explain(
    responses: Responses,
    expected: ExpectedResponse,
    candidates: Sequence[SlipCandidate],
    broad: Sequence[SlipCandidate] = (),
) -> Explained:
    """Return the slips that explain responses clearly better than the record, and than any physical cause could.

    broad: candidates that are also tried in pairs if no single one explains everything.
    """
    read = as_recorded(responses)
    first = _compare(responses, expected, read)
    chosen, rivals, now = _add_one_by_one(responses, expected, [*broad, *candidates])
    tried = len(broad) + len(candidates)
    if _root(_compare(responses, expected, now).deviations) > _RIGHT or _penalty(chosen) > _MUCH:
        tried += len(broad) * (len(broad) - 1) // 2
        two = _best_of_two(responses, expected, broad)
        if two is not None and two[1] > _gain(responses, expected, (read, first), now) - _penalty(chosen):
            chosen, now = two[0], two[2]
            rivals = ()
    slips = merged([candidate.slip for candidate in chosen])
    where = _readings_differ(read, now) if slips else np.ones(len(responses), bool)
    last = _compare(responses, expected, now)
    return Explained(slips, rivals, _relative(first, where), _relative(last, where), tried, last.deviations)


def _add_one_by_one(
    responses: Responses, expected: ExpectedResponse, candidates: Sequence[SlipCandidate]
) -> tuple[list[SlipCandidate], tuple[RecordSlip, ...], ColumnReading]:
    """Return the clearest slips in turn, the rivals of the first, and the interpretation with them."""
    read, chosen, rivals = as_recorded(responses), list[SlipCandidate](), tuple[RecordSlip, ...]()
    for _ in range(_ROUNDS):
        best = _best(responses, expected, read, candidates)
        if best is None or len(merged([*(candidate.slip for candidate in chosen), best[0].slip])) > _MOST_SLIPS:
            break
        rivals = rivals if chosen else best[2]
        chosen.append(best[0])
        read = best[1]
    return chosen, rivals, read


def _best_of_two(
    responses: Responses, expected: ExpectedResponse, broad: Sequence[SlipCandidate]
) -> tuple[list[SlipCandidate], float, ColumnReading] | None:
    """Return the pair of slips with the smallest deviation and its log evidence; None if no pair explains
    everything."""
    read = as_recorded(responses)
    first = _compare(responses, expected, read)
    best: tuple[float, list[SlipCandidate], ColumnReading] | None = None
    for at, trial in enumerate(broad):
        half = trial.undo(read)
        for other in broad[at + 1 :]:
            if _are_one(trial.slip, other.slip):
                continue
            now = other.undo(half)
            left = _root(_compare(responses, expected, now).deviations)
            if best is None or left < best[0]:
                best = left, [trial, other], now
    if best is None or best[0] > min(_RIGHT, 0.5 * _root(first.deviations)):
        return None
    gain = _gain(responses, expected, (read, first), best[2]) - _penalty(best[1])
    return (best[1], gain, best[2]) if gain > _MUCH else None


def _are_one(slip: RecordSlip, other: RecordSlip) -> bool:
    """Return True for two units of the same numbers: their product is no unit."""
    general = (replace(one, factor=1.0, dimension="") for one in (slip, other))
    return slip.kind is SlipKind.UNIT and len(set(general)) == 1


def _penalty(chosen: Sequence[SlipCandidate]) -> float:
    return sum(candidate.penalty for candidate in chosen) + np.log(2.0 * max(len(chosen), 1))


def merged(slips: Sequence[RecordSlip]) -> tuple[RecordSlip, ...]:
    """Return slips of one kind, quantity and size as one of all their subjects."""
    names_by_slip: dict[RecordSlip, tuple[str, ...]] = {}
    for slip in slips:
        general = replace(slip, subjects=())
        names_by_slip[general] = tuple(dict.fromkeys((*names_by_slip.get(general, ()), *slip.subjects)))
    return tuple(replace(first, subjects=subjects) for first, subjects in names_by_slip.items())


def hidden(
    responses: Responses, expected: ExpectedResponse, candidates: Sequence[SlipCandidate]
) -> tuple[RecordSlip, ...]:
    """Return the slips that would not show: with the slip undone, expected responses hardly deviate."""
    read = as_recorded(responses)
    here = _compare(responses, expected, read)
    ideal = replace(responses, size=here.expected * here.possible)
    perfect = _compare(ideal, expected, read)
    out = []
    for candidate in candidates:
        now = candidate.undo(read)
        there = _compare(ideal, expected, now)
        changed = _informative(perfect, there, _readings_differ(read, now))
        if not changed.any() or _root(there.deviations[changed]) < CLEARLY:
            out.append(candidate.slip)
    broad = {slip for slip in out if not slip.subjects}
    return tuple(slip for slip in out if not slip.subjects or replace(slip, subjects=()) not in broad)


def _compare(responses: Responses, expected: ExpectedResponse, read: ColumnReading) -> _ScaledResponses:
    possible = np.maximum(expected.possible(read.column, read.direction), 1e-300)
    wanted = expected.expected(read.column, read.direction)
    return _ScaledResponses(responses.size * read.factor / possible, wanted / possible, possible, expected)


def _readings_differ(first: ColumnReading, other: ColumnReading) -> Mask:
    return np.asarray(
        (first.factor != other.factor)
        | (first.column != other.column)
        | np.any(first.direction != other.direction, axis=1)
    )


def _best(
    responses: Responses, expected: ExpectedResponse, read: ColumnReading, candidates: Sequence[SlipCandidate]
) -> tuple[SlipCandidate, ColumnReading, tuple[RecordSlip, ...]] | None:
    """Return the best candidate, the interpretation with it, and equally likely ones; None if none is clear."""
    here = _compare(responses, expected, read)
    near = sorted(_halving(responses, expected, read, here, candidates), key=lambda trial: trial[0])[:_COMPARED]
    if not near:
        return None
    gains = [_gain(responses, expected, (read, here), now) - candidate.penalty for _, candidate, now in near]
    top = int(np.argmax(gains))
    if gains[top] < _MUCH:
        return None
    _, chosen, now = near[top]
    others = tuple(
        candidate.slip
        for gain, (_, candidate, _) in zip(gains, near, strict=True)
        if candidate is not chosen and gain > gains[top] - _AS_LIKELY and not _is_part(candidate.slip, chosen.slip)
    )
    return chosen, now, others


def _is_part(slip: RecordSlip, containing: RecordSlip) -> bool:
    """Return True if a slip is another one restricted to some places."""
    return replace(slip, subjects=()) == replace(containing, subjects=()) and (
        not containing.subjects or set(containing.subjects) <= set(slip.subjects)
    )


def _halving(
    responses: Responses,
    expected: ExpectedResponse,
    read: ColumnReading,
    here: _ScaledResponses,
    candidates: Sequence[SlipCandidate],
) -> Iterator[tuple[float, SlipCandidate, ColumnReading]]:
    """Yield candidates that at least halve the misfit of what they concern, down to the size of physical effects. Each
    with the deviation of all responses and the interpretation with it."""
    before = np.abs(here.deviations)
    for candidate in candidates:
        if np.max(before[candidate.concerns], initial=0.0) < CLEARLY:
            continue
        now = candidate.undo(read)
        there = _compare(responses, expected, now)
        changed = _informative(here, there, _readings_differ(read, now))
        if not changed.any() or _root(before[changed]) < CLEARLY:
            continue
        after = there.deviations
        if _root(after[changed]) <= min(_RIGHT, 0.5 * _root(before[changed])):
            yield _root(after), candidate, now


def _informative(here: _ScaledResponses, there: _ScaledResponses, changed: Mask) -> Mask:
    """Return the responses changed by a slip that are, or should be, large either way; all where there is none."""
    large = changed & (here.is_large | there.is_large)
    return large if large.any() else changed


def _root(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _gain(
    responses: Responses, expected: ExpectedResponse, pair: tuple[ColumnReading, _ScaledResponses], other: ColumnReading
) -> float:
    """Return the gain in log evidence by another interpretation, from responses that are informative under
    either one."""
    here, there = pair[1], _compare(responses, expected, other)
    informative = here.is_large | there.is_large
    if not informative.any():
        return -np.inf
    return _evidence(other, there, expected, informative) - _evidence(pair[0], here, expected, informative)


def _evidence(read: ColumnReading, compared: _ScaledResponses, expected: ExpectedResponse, rows: Mask) -> float:
    """Return the log evidence of the recorded sizes of some responses, with physical causes of plausible size free."""
    read = ColumnReading(read.direction[rows], read.column[rows], read.factor[rows])
    compared = compared.subset(rows)
    slope = compared.slope
    axis = np.argmax(np.abs(read.direction * expected.of_load), axis=1)
    bound = _BESIDE * compared.width * np.where(compared.expected < 0.0, -1.0, 1.0)
    along = _SHARED * compared.expected * slope
    column = read.column
    known = [
        along[:, None],
        np.where(axis[:, None] == np.arange(6), along[:, None], 0.0),
        np.where(column[:, None] == np.unique(column), along[:, None] * expected.gain / _SHARED, 0.0),
        np.where((6 * column + axis)[:, None] == np.unique(6 * column + axis), bound[:, None], 0.0),
    ]
    scale = np.log(np.abs(read.factor) / (compared.possible * np.hypot(compared.share, expected.linear)))
    return float(log_evidence(compared.misfit, physics(np.column_stack(known)), _FLOOR, _CEILING)) + float(scale.sum())


def _relative(compared: _ScaledResponses, where: Mask) -> float:
    """Return the rms misfit over the rms expectation of some responses."""
    if not where.any():
        return 0.0
    wanted = max(_root(compared.expected[where]), 0.1 * _root(compared.share[where]), 1e-300)
    return _root(compared.share[where] - compared.expected[where]) / wanted
