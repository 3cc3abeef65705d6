"""Detectable size of an effect: the size that a search finds with given power, by linear theory from its signature.

An effect of a given size shifts unit normals, along the directions in which the campaign sees the candidate, by the
size times the strengths. The search's F test then has a noncentral distribution, which gives its power.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Generic

import numpy as np

from truing.inference.arrays import Array, Integers
from truing.inference.model import CauseT
from truing.inference.search import CauseCandidate, ChannelFamily, Search
from truing.inference.verdicts import NOT_TESTABLE, REJECTED, Reason, Verdict

POWER = 0.8
# Number of random patterns of an effect's parameters over which its power is averaged.
_PATTERNS = 64
_HALVINGS = 28  # of the logarithm of the size, to seven digits
# A candidate that is found only at more than this many times its plausible scale is not testable.
_IMPLAUSIBLE = 10.0
_SMALLEST, _LARGEST = 1e-6, 1e4  # in plausible scales; an effect that needs more counts as never found
# Signal-to-noise ratios at which power is tabulated; above the last one the power is 1.
_ROOTS = np.linspace(0.0, 40.0, 401)


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
    plausible scale.
    """

    cause: CauseT  # a typical one of its sort
    kind: str
    rule: AcceptanceRule
    per_scale: Array

    def power(self, size: float) -> float:
        """Return the probability of finding the effect at a size in plausible scales; zero if it is invisible."""
        if self.rule.rank == 0:
            return 0.0
        values, counts = self._distinct
        return float(self.rule.power(size * values) @ counts / len(self.per_scale))

    @cached_property
    def _distinct(self) -> tuple[Array, Integers]:
        """Distinct ratios and how often each occurs: a single parameter has one."""
        return np.unique(self.per_scale, return_counts=True)

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


def effect_sensitivities(search: Search[CauseT], level: float) -> list[EffectSensitivity[CauseT]]:
    """Return the sensitivity of a search to every sort of effect, by kind, subject (the whole or a single thing) and
    parameters.

    Of candidates of one sort that differ in shape (onset, pitch, time constant), the one of median sensitivity.
    """
    sorts: dict[tuple[object, ...], list[EffectSensitivity[CauseT]]] = {}
    for detectable_effect in (*_of_candidates(search, level, search.candidates), *_of_families(search, level)):
        sorts.setdefault(
            (detectable_effect.kind, *_effect_kind(detectable_effect.cause, search.part_count)), []
        ).append(detectable_effect)
    return [_median_sensitivity(sort) for sort in sorts.values()]


def sensitivity_to(search: Search[CauseT], cause: CauseT, level: float) -> EffectSensitivity[CauseT] | None:
    """Return the sensitivity of a search to one of its candidates; None where it has no such candidate."""
    key = cause.key
    matching = (candidate for candidate in search.candidates if candidate.key == key)
    return next(_of_candidates(search, level, matching), None)


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
) -> Iterator[EffectSensitivity[CauseT]]:
    rules: dict[tuple[str, int], AcceptanceRule] = {}
    for candidate in candidates:
        signature, sort = candidate.signature, (candidate.kind, candidate.signature.rank)
        if not candidate.cause.catalogued or candidate.cause.concerns_several:
            continue
        if sort not in rules:
            rules[sort] = _rule(search, *sort, level)
        yield EffectSensitivity(
            candidate.cause, candidate.kind, rules[sort], per_scale(signature.strengths, signature.loadings)
        )


def _of_families(search: Search[CauseT], level: float) -> Iterator[EffectSensitivity[CauseT]]:
    """Yield the sensitivity to single channels, each at its shape of median strength."""
    for family in search.families:
        signatures = family.signatures
        if signatures.is_observed.any():
            rule = _rule(search, family.kind, signatures.parameters, level)
            sensitivities = (_of_channel(family, channel, rule) for channel in range(len(signatures.rotated.channels)))
            yield from (
                sensitivity for sensitivity in sensitivities if sensitivity is not None and sensitivity.cause.catalogued
            )


def _of_channel(family: ChannelFamily[CauseT], channel: int, rule: AcceptanceRule) -> EffectSensitivity[CauseT] | None:
    signatures = family.signatures
    shapes = np.flatnonzero(signatures.is_observed[:, channel])
    if not len(shapes):
        return None
    strength = np.trace(signatures.gram[shapes, channel], axis1=-2, axis2=-1)
    shape = int(shapes[np.argsort(strength)[len(shapes) // 2]])
    values, vectors = np.linalg.eigh(signatures.gram[shape, channel])
    cause = family.cause.member(channel, shape)
    return EffectSensitivity(cause, family.kind, rule, per_scale(np.sqrt(np.maximum(values, 0.0)), vectors))


def _rule(search: Search[CauseT], kind: str, rank: int, level: float) -> AcceptanceRule:
    if rank == 0:
        return AcceptanceRule(0, 1.0, level)
    group = search.null.group_of(kind, rank)
    return AcceptanceRule(rank, search.noise.freedom(group.input_share), search.null.threshold(group, level))


def _effect_kind(cause: CauseT, parts: int) -> tuple[object, ...]:
    """Return the subject and the names and units of parameters, which effects of one sort share."""
    return (cause.subject, *dict.fromkeys((p.name.rstrip("0123456789_"), p.unit) for p in cause.parameters(parts)))


def _median_sensitivity(sensitivities: Sequence[EffectSensitivity[CauseT]]) -> EffectSensitivity[CauseT]:
    ranked = sorted(sensitivities, key=lambda s: float(np.mean(s.per_scale**2)) if s.rule.rank else 0.0)
    return ranked[len(ranked) // 2]
