"""Detectable size of an effect: the size that a search finds with given power, by linear theory from its signature.

An effect of a given size shifts unit normals, along the directions in which the campaign sees the candidate, by the
size times the strengths. The search's F test then has a noncentral distribution, which gives its power. A found effect
is also clearly more probable than none. This needs more than the F test where few causes are searched.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Generic

import numpy as np

from truing.inference.arrays import Array, Integers
from truing.inference.evidence import SIZES, log_evidence, sizes_of
from truing.inference.model import CauseT
from truing.inference.names_next_to_others import LEAST_PROBABILITY
from truing.inference.search import CauseCandidate, ChannelFamily, Search, f_test
from truing.inference.verdicts import NOT_TESTABLE, REJECTED, Reason, Verdict

POWER = 0.8
# Number of random patterns of an effect's parameters over which its power is averaged.
_PATTERNS = 64
_HALVINGS = 28  # of the logarithm of the size, to seven digits
# A candidate that is found only at more than this many times its plausible scale is not testable.
_IMPLAUSIBLE = 10.0
_TINY = 1e-300
_SMALLEST, _LARGEST = 1e-6, 1e4  # in plausible scales; an effect that needs more counts as never found
# Signal-to-noise ratios at which power is tabulated; above the last one the power is 1.
_ROOTS = np.linspace(0.0, 40.0, 401)
# Log odds over no effect that a found effect has at least.
_LEAST_LOG_ODDS = float(np.log(LEAST_PROBABILITY / (1.0 - LEAST_PROBABILITY)))


@dataclass(frozen=True)
class AcceptanceRule:
    """Rule by which a search accepts a candidate: the uncorrected p of its F test with ``rank`` directions is below a
    threshold.

    ``freedom`` are the degrees of freedom of the noise, including those of the candidate.
    """

    rank: int
    freedom: float
    threshold: float

    @cached_property
    def _table(self) -> Array:
        """Power at the tabulated signal-to-noise ratios."""
        from scipy.special import fdtri, ncfdtr

        residual_freedom = max(self.freedom - self.rank, 1.0)
        critical = fdtri(self.rank, residual_freedom, 1.0 - min(self.threshold, 1.0 - 1e-12))
        return np.asarray(np.nan_to_num(1.0 - ncfdtr(self.rank, residual_freedom, _ROOTS**2, critical), nan=1.0))

    def power(self, signal_to_noise: Array) -> Array:
        """Return the probability (...) of acceptance at signal-to-noise ratios (...), the roots of the
        non-centrality."""
        return np.interp(signal_to_noise, _ROOTS, self._table, right=1.0)


@dataclass(frozen=True)
class EffectSensitivity(Generic[CauseT]):
    """Sensitivity of a campaign to one sort of effect.

    ``per_scale`` (D,) are signal-to-noise ratios of random patterns of the parameters, with a root mean square of one
    plausible scale. ``of_shapes`` (S D,) are those of all effects of the sort, which differ in shape (onset, pitch,
    time constant), zero where unseen; None if there is one.
    """

    cause: CauseT  # a typical one of its sort
    kind: str
    rule: AcceptanceRule
    per_scale: Array
    of_shapes: Array | None = None

    def power(self, size: float) -> float:
        """Return the probability of finding the effect at a size in plausible scales; zero if it is invisible."""
        return self._mean_power(size, self._distinct)

    def rate(self, size: float) -> float:
        """Return the probability of finding an effect at a size in plausible scales whose shape is drawn at random."""
        return self._mean_power(size, self._distinct_of_shapes)

    def _mean_power(self, size: float, ratios: tuple[Array, Integers]) -> float:
        if self.rule.rank == 0:
            return 0.0
        values, counts = ratios
        return float(self.rule.power(size * values) @ counts / counts.sum())

    @cached_property
    def _distinct(self) -> tuple[Array, Integers]:
        """Distinct ratios and how often each occurs: a single parameter has one."""
        return np.unique(self.per_scale, return_counts=True)

    @cached_property
    def _distinct_of_shapes(self) -> tuple[Array, Integers]:
        return self._distinct if self.of_shapes is None else np.unique(self.of_shapes, return_counts=True)

    def smallest(self, power: float = POWER) -> float | None:
        """Return the size, in plausible scales, that is found with the given power; None where no size is."""
        low, high = np.log(_SMALLEST), np.log(_LARGEST)
        if self.power(_LARGEST) < power:
            return None
        for _ in range(_HALVINGS):
            middle = (low + high) / 2
            low, high = (low, middle) if self.power(float(np.exp(middle))) >= power else (middle, high)
        return float(np.exp(high))

    @property
    def is_plausible(self) -> bool:
        """True if an effect of at most ten plausible scales would be found."""
        return self.power(_IMPLAUSIBLE) >= POWER

    def signal_to_noise(self, size: float) -> float:
        """Return the root of the mean non-centrality at a size in plausible scales."""
        return size * float(np.sqrt(np.mean(self.per_scale**2)))


def per_scale(strengths: Array, loadings: Array) -> Array:
    """Return the signal-to-noise ratios (D,) of random patterns, from the strengths (r,) and loadings (P, r) of a
    signature."""
    return np.asarray(np.linalg.norm(_patterns(len(loadings)) @ loadings * strengths, axis=1))


@lru_cache(maxsize=256)
def _patterns(parameters: int) -> Array:
    """Return random patterns (D, P) whose root mean square is one."""
    pattern = np.random.default_rng(0).standard_normal((_PATTERNS if parameters > 1 else 1, parameters))
    return np.asarray(pattern * np.sqrt(parameters) / np.linalg.norm(pattern, axis=1, keepdims=True))


@dataclass(frozen=True)
class _Seen(Generic[CauseT]):
    """A candidate as a search sees it, by its F test alone: ``strengths`` (r,) along orthonormal ``loadings`` (P, r) of
    its parameters, and its ``prior`` probability within its kind."""

    sensitivity: EffectSensitivity[CauseT]
    strengths: Array
    loadings: Array
    prior: float

    def sensitivity_of_found(self, of_shapes: Array | None = None) -> EffectSensitivity[CauseT]:
        """Return the sensitivity by the whole rule: significant, and clearly more probable than no effect."""
        own, rule = self.sensitivity, self.sensitivity.rule
        if rule.rank:
            sizes = sizes_of(SIZES, 1.0, is_known=own.cause.has_known_scale)
            least = _least_squares(self.strengths, self.loadings, rule.freedom, self.prior, sizes)
            p_value = float(f_test(least, rule.rank, 1.0, rule.freedom))
            rule = replace(rule, threshold=min(rule.threshold, p_value))
        return replace(own, rule=rule, of_shapes=of_shapes)


def effect_sensitivities(search: Search[CauseT], level: float) -> list[EffectSensitivity[CauseT]]:
    """Return the sensitivity of a search to every sort of effect, by kind, subject (the whole or a single thing) and
    parameters.

    Of candidates of one sort that differ in shape (onset, pitch, time constant), the one of median sensitivity.
    """
    sorts: dict[tuple[object, ...], list[_Seen[CauseT]]] = {}
    for seen in (*_of_candidates(search, level, search.candidates), *_of_families(search, level)):
        own = seen.sensitivity
        sorts.setdefault((own.kind, *_effect_kind(own.cause, search.part_count)), []).append(seen)
    return [_median_sensitivity(sort) for sort in sorts.values()]


def sensitivity_to(search: Search[CauseT], cause: CauseT, level: float) -> EffectSensitivity[CauseT] | None:
    """Return the sensitivity of a search to one of its candidates; None where it has no such candidate."""
    key = cause.key
    matching = (candidate for candidate in search.candidates if candidate.key == key)
    seen = next(_of_candidates(search, level, matching), None)
    return None if seen is None else seen.sensitivity_of_found()


def assessed(verdicts: Iterable[Verdict[CauseT]], search: Search[CauseT], level: float) -> tuple[Verdict[CauseT], ...]:
    """Return the verdicts sorted; a rejected kind is not testable if no sort of it would be found at a
    plausible size."""
    plausible: dict[str, bool] = {}
    for effect_sensitivity in effect_sensitivities(search, level):
        plausible[effect_sensitivity.kind] = (
            plausible.get(effect_sensitivity.kind, False) or effect_sensitivity.is_plausible
        )
    updated = (
        replace(verdict, verdict=NOT_TESTABLE) if _is_hidden(verdict, plausible) else verdict for verdict in verdicts
    )
    return tuple(sorted(updated, key=lambda verdict: verdict.rank))


def _is_hidden(verdict: Verdict[CauseT], plausible: Mapping[str, bool]) -> bool:
    if verdict.verdict != REJECTED or verdict.reason not in (Reason.CHANCE, Reason.UNSEEN):
        return False
    return not plausible.get(verdict.cause.id, verdict.reason == Reason.CHANCE)  # not every kind has a computed size


def _of_candidates(
    search: Search[CauseT], level: float, candidates: Iterable[CauseCandidate[CauseT]]
) -> Iterator[_Seen[CauseT]]:
    rules: dict[tuple[str, int], AcceptanceRule] = {}
    for candidate in candidates:
        signature, sort = candidate.signature, (candidate.kind, candidate.signature.rank)
        if not candidate.cause.catalogued or candidate.cause.concerns_several:
            continue
        if sort not in rules:
            rules[sort] = _rule(search, *sort, level)
        own = per_scale(signature.strengths, signature.loadings)
        sensitivity = EffectSensitivity(candidate.cause, candidate.kind, rules[sort], own)
        yield _Seen(sensitivity, signature.strengths, signature.loadings, candidate.prior)


def _of_families(search: Search[CauseT], level: float) -> Iterator[_Seen[CauseT]]:
    """Yield the sensitivity to single channels, at each shape."""
    for family in search.families:
        signatures = family.signatures
        if signatures.is_observed.any():
            rule = _rule(search, family.kind, signatures.parameters, level)
            for channel in range(len(signatures.rotated.channels)):
                yield from _of_channel(family, channel, rule)


def _of_channel(family: ChannelFamily[CauseT], channel: int, rule: AcceptanceRule) -> Iterator[_Seen[CauseT]]:
    signatures = family.signatures
    for shape in np.flatnonzero(signatures.is_observed[:, channel]).tolist():
        values, vectors = np.linalg.eigh(signatures.gram[shape, channel])
        strengths, cause = np.sqrt(np.maximum(values, 0.0)), family.cause.member(channel, shape)
        if cause.catalogued:
            sensitivity = EffectSensitivity(cause, family.kind, rule, per_scale(strengths, vectors))
            yield _Seen(sensitivity, strengths, vectors, family.prior)


def _least_squares(strengths: Array, loadings: Array, freedom: float, prior: float, sizes: Sequence[float]) -> float:
    """Return the reduction of the sum of squares, in units of the noise, that gives the least log odds of a found
    effect: the median over random patterns of its parameters."""
    signal = _patterns(len(loadings)) @ loadings * strengths
    direction = signal / np.maximum(np.linalg.norm(signal, axis=1, keepdims=True), _TINY)
    needed = _LEAST_LOG_ODDS - float(np.log(max(prior, _TINY)))
    low, high = np.zeros(len(direction)), np.full(len(direction), _ROOTS[-1] ** 2)
    for _ in range(_HALVINGS):
        middle = (low + high) / 2.0
        along = direction * np.sqrt(middle)[:, None]
        # The noise level is estimated from all that is left, and the effect adds its squares to the total.
        is_enough = log_evidence(along, strengths, freedom + middle, freedom, sizes) >= needed
        low, high = np.where(is_enough, low, middle), np.where(is_enough, middle, high)
    return float(np.median(high))


def _rule(search: Search[CauseT], kind: str, rank: int, level: float) -> AcceptanceRule:
    if rank == 0:
        return AcceptanceRule(0, 1.0, level)
    group = search.null.group_of(kind, rank)
    return AcceptanceRule(rank, search.noise.freedom(group.input_share), search.null.threshold(group, level))


def _effect_kind(cause: CauseT, parts: int) -> tuple[object, ...]:
    """Return the subject and the names and units of parameters, which effects of one sort share."""
    return (cause.subject, *dict.fromkeys((p.name.rstrip("0123456789_"), p.unit) for p in cause.parameters(parts)))


def _median_sensitivity(sort: Sequence[_Seen[CauseT]]) -> EffectSensitivity[CauseT]:
    sensitivities = [seen.sensitivity for seen in sort]
    squares = [float(np.mean(own.per_scale**2)) if own.rule.rank else 0.0 for own in sensitivities]
    median = sort[int(np.argsort(squares, kind="stable")[len(sort) // 2])]
    if len(sort) == 1:
        return median.sensitivity_of_found()
    of_shapes = [own.per_scale if own.rule.rank else np.zeros_like(own.per_scale) for own in sensitivities]
    return median.sensitivity_of_found(np.concatenate(of_shapes))
