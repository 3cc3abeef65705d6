"""Search over all candidates of all kinds of cause on one residual, and its null distribution.

Each kind is assessed by its best candidate. The statistic is the smallest p-value over kinds. Each is multiplied by
the cost of the choice among its candidates and divided by its share of the false-alarm budget. The null distribution
comes from the same search on simulated residuals and on sign-flipped ones.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Generic

import numpy as np

from truing.inference.arrays import Array, Integers, grouped, index_or_slice
from truing.inference.channel_signatures import (
    ChannelSignatures,
)
from truing.inference.fitted_model import FittedModel
from truing.inference.model import OBSERVED, CauseT, ChannelCandidates
from truing.inference.noise import NoiseComponents
from truing.inference.signatures import (
    Pathways,
    Signature,
)

# Random numbers drawn at a time.
_BLOCK = 2_500_000
# Values of residuals that are searched at a time.
_AT_ONCE = 2**20
# Limit of the standardised residuals that are sign-flipped; larger ones are effects, not noise.
_LARGEST = 5.0
# Quantile of the null distribution that gives the cost of choosing among candidates.
_QUANTILE = 0.02
# Below this share of the draws, p-values are extrapolated.
_TAIL = 0.01
# Smallest p-value reported: no noise is normal so far out.
LEAST_P = 1e-9
# Values that are always zero are left out of products if fewer than this share is left.
_MOSTLY_LIVE = 0.9
# Columns that candidates share are multiplied once if fewer than this share of all is distinct.
_MOSTLY_DISTINCT = 0.5


@dataclass(frozen=True)
class CauseCandidate(Generic[CauseT]):
    """One candidate: its cause, kind, signature, and prior probability within its kind.

    ``chosen_from``: number of candidates of single channels of which it is one with the most evidence; 1 for others.
    """

    cause: CauseT
    kind: str
    signature: Signature
    prior: float
    chosen_from: int = 1

    @cached_property
    def key(self) -> str:
        """Name that identifies it among all candidates."""
        return self.cause.key

    def light(self) -> CauseCandidate[CauseT]:
        """Return the candidate without its design, which only a search needs."""
        return replace(self, signature=replace(self.signature, design=np.zeros((0, self.signature.parameters))))


@dataclass(frozen=True)
class ChannelFamily(Generic[CauseT]):
    """Candidates over single channels: their kind and their signatures."""

    cause: ChannelCandidates[CauseT]  # makes the candidate of a channel and a shape
    kind: str
    signatures: ChannelSignatures

    @property
    def prior(self) -> float:
        """Prior probability of each candidate in its kind."""
        return 1.0 / max(int(self.signatures.is_observed.sum()), 1)


@dataclass(frozen=True)
class _Bank:
    """Unit designs of candidates on the same pathways, as rows in single precision.

    ``place``: the pathways, or the numbers (n,) of those values of (B C,) that are not always zero; ``parts``: designs
    (r * k, n) of k candidates of rank r each, sorted by direction first, and the candidates' numbers (k,). Where many
    share their columns, ``columns`` (u, n) are the distinct ones, and designs (r * k, u) combine these.
    """

    place: Integers | slice
    is_flat: bool
    columns: Array | None
    parts: list[tuple[Array, list[int]]]

    def scores(self, along: Array) -> Iterator[tuple[Array, list[int]]]:
        """Yield scores (D, r, k) of candidates from parts (D, B, C) along the pathways, and the candidates' numbers."""
        flat = along.reshape(len(along), -1)[:, self.place] if self.is_flat else along[:, :, self.place]
        rows = flat.reshape(len(along), -1)
        if self.columns is not None:
            rows = rows @ self.columns.T
        for designs, numbers in self.parts:
            yield (rows @ designs.T).reshape(len(along), -1, len(numbers)), numbers


def _bank_of(pathways: Pathways, alike: Sequence[Signature], numbers: Sequence[int]) -> _Bank:
    """Return the bank of candidates on the same pathways, with their numbers."""
    index = alike[0].index
    live = np.diagonal(pathways.gram, axis1=1, axis2=2)[:, index] > 0.0  # a channel that was not read moves nothing
    rows = np.flatnonzero(live) if live.mean() < _MOSTLY_LIVE else slice(None)
    place = index_or_slice(index)
    is_flat = isinstance(rows, np.ndarray) or isinstance(place, np.ndarray)  # which are picked faster one by one
    if is_flat:
        place = np.asarray(np.arange(len(live))[:, None] * pathways.columns.shape[2] + index).ravel()[rows]
    designs = [effect.design[rows] for effect in alike]
    loadings = [effect.loadings / effect.strengths for effect in alike]
    distinct = _distinct_columns(designs)
    columns = None
    if distinct is not None:
        columns, designs = distinct
    parts = []
    for members in grouped(effect.rank for effect in alike).values():
        wide = np.stack([(designs[m] @ loadings[m]).T.astype(np.float32) for m in members], 1)
        parts.append((wide.reshape(-1, wide.shape[-1]), [numbers[m] for m in members]))
    return _Bank(place, is_flat, columns, parts)


def _distinct_columns(designs: Sequence[Array]) -> tuple[Array, list[Array]] | None:
    """Return the distinct columns (u, n) of designs (n, P_i), in single precision, and the designs (u, P_i) that make
    them of these; None where most columns are distinct."""
    weights = np.cos(np.arange(len(designs[0])))  # equal columns have equal sums
    sums = [(weights @ design).astype(np.float32).tolist() for design in designs]
    if len({value for keys in sums for value in keys}) > _MOSTLY_DISTINCT * sum(map(len, sums)):
        return None
    distinct: list[Array] = []
    places: dict[float, list[int]] = {}
    members: list[list[int]] = []
    for design, keys in zip(designs, sums, strict=True):
        members.append([])
        for column, key in zip(design.T, keys, strict=True):
            alike = places.setdefault(key, [])
            place = next((n for n in alike if np.array_equal(distinct[n], column)), len(distinct))
            if place == len(distinct):
                alike.append(place)
                distinct.append(column)
            members[-1].append(place)
    return np.stack(distinct).astype(np.float32), [np.eye(len(distinct))[:, member] for member in members]


@dataclass(frozen=True)
class Search(Generic[CauseT]):
    """All candidates on one fit; ``shares`` are the shares of the false-alarm budget by kind."""

    pathways: Pathways
    noise: NoiseComponents
    candidates: Sequence[CauseCandidate[CauseT]]
    families: Sequence[ChannelFamily[CauseT]]
    shares: dict[str, float]
    draws: int
    rng: np.random.Generator
    part_count: int = 0  # number of like parts of the model, which have parameters of their own in some causes

    @cached_property
    def groups(self) -> tuple[CandidateGroup, ...]:
        """Groups of comparable candidates, then one group for every family of channels."""
        input_shares: dict[tuple[str, int], list[float]] = {}
        for candidate in self._visible_candidates:
            effect = candidate.signature
            input_shares.setdefault((candidate.kind, effect.rank), []).append(effect.input_share)
        listed = [CandidateGroup(kind, rank, float(np.mean(shares))) for (kind, rank), shares in input_shares.items()]
        listed += [CandidateGroup(p.kind, p.signatures.parameters, 0.0) for p in self.families]
        return tuple(listed)

    @cached_property
    def _visible_candidates(self) -> list[CauseCandidate[CauseT]]:
        return [candidate for candidate in self.candidates if candidate.signature.rank]

    @cached_property
    def _banks(self) -> list[_Bank]:
        """Candidates that can be seen, those on the same pathways together."""
        signatures = [candidate.signature for candidate in self._visible_candidates]
        alike = grouped(effect.index.tobytes() for effect in signatures)
        return [_bank_of(self.pathways, [signatures[n] for n in numbers], numbers) for numbers in alike.values()]

    def squares(self, along: Array) -> Array:
        """Return the reduction of the sum of squares by each candidate that can be seen, (D, candidates)."""
        result = np.empty((len(along), len(self._visible_candidates)))
        for bank in self._banks:
            for scores, numbers in bank.scores(along):
                result[:, numbers] = np.einsum("drk,drk->dk", scores, scores)
        return result

    def maxima(self, along: Array) -> Array:
        """Return the largest reduction in every group, (D, groups)."""
        of_families = self._of_families(along[:, :, self.pathways.places[OBSERVED]])
        return np.column_stack([self._of_candidates(along), *of_families])

    def _of_candidates(self, along: Array) -> Array:
        """Return the largest reduction (D, groups) among the candidates of every group."""
        largest = np.zeros((len(along), len(self._members)))
        for bank in self._banks:
            for scores, numbers in bank.scores(along):
                groups = self._group_numbers[numbers]
                first = np.flatnonzero(np.diff(groups, prepend=-1))
                squares = np.maximum.reduceat(np.einsum("drk,drk->dk", scores, scores), first, axis=1)
                for group, column in zip(groups[first], squares.T, strict=True):
                    np.maximum(largest[:, group], column, out=largest[:, group])
        return largest

    def _of_families(self, parts: Array) -> list[Array]:
        """Return the largest reduction (D,) in every family of channels, from parts (D, B, C) along the
        observations."""
        largest: dict[int, Array] = {}
        signatures = [family.signatures for family in self.families]
        for rotated in {
            id(family_signatures.rotated): family_signatures.rotated for family_signatures in signatures
        }.values():
            along = rotated.along(parts)
            for index, family_signatures in enumerate(signatures):
                if family_signatures.rotated is rotated:
                    largest[index] = family_signatures.squares(along).reshape(len(parts), -1).max(1)
        return [largest[index] for index in range(len(signatures))]

    @cached_property
    def _members(self) -> list[list[int]]:
        return list(grouped((c.kind, c.signature.rank) for c in self._visible_candidates).values())

    @cached_property
    def _group_numbers(self) -> Integers:
        """Number of the group of every candidate that can be seen."""
        result = np.empty(len(self._visible_candidates), int)
        for number, members in enumerate(self._members):
            result[members] = number
        return result

    def by_kind(self, maxima: Array, noise: tuple[Array | float, Array | float]) -> Array:
        """Return the smallest uncorrected p of every kind, (D, kinds), at noise levels (D,), or one, of observations
        and inputs."""
        kinds = kinds_of(self.groups)
        smallest = np.ones((len(maxima), len(kinds)))
        for number, group in enumerate(self.groups):
            level = (1.0 - group.input_share) * noise[0] + group.input_share * noise[1]
            column = kinds.index(group.kind)
            p_values = f_test(maxima[:, number], group.rank, level, self.noise.freedom(group.input_share))
            smallest[:, column] = np.minimum(smallest[:, column], p_values)
        return smallest

    @cached_property
    def null(self) -> NullDistribution:
        """Null distribution: the same search on simulated and on sign-flipped residuals."""
        drawn, flipped = [], []
        height = len(self.pathways.whitened.rest)
        block = max(_BLOCK // height, 1)
        self._prepare()
        level = self._flipped_level
        # Products of large matrices leave the interpreter free, so both searches run at once; numbers are drawn here.
        with ThreadPoolExecutor(1) as beside:
            for first in range(0, self.draws, block):
                count = min(block, self.draws - first)
                rows, levels = self._drawn(count, height), self._drawn_levels(count)
                later = beside.submit(self._smallest, self._flipped(count), (level, level))
                drawn.append(self._smallest(rows, levels))
                flipped.append(later.result())
        for needed_no_more in ("_banks", "_standard", "_best_rows", "_flipped_level"):
            self.__dict__.pop(needed_no_more, None)
        self.pathways.without_draws()
        return NullDistribution(self.groups, self.noise, self.shares, np.concatenate(drawn), np.concatenate(flipped))

    def _prepare(self) -> None:
        """Form the arrays that both searches share, before they run at once."""
        _ = self._standard, self._flipped_level, self._group_numbers, self._banks
        self.pathways.prepare_draws()
        for family in self.families:
            _ = family.signatures.inverse

    def _smallest(self, rows: Array, noise: tuple[Array | float, Array | float]) -> Array:
        """Return the smallest uncorrected p of every kind (D, kinds) on residuals (D, N), at noise levels."""
        count = max(_AT_ONCE // rows.shape[1], 1)
        parts = [rows[first : first + count] for first in range(0, len(rows), count)]
        maxima = [self.maxima(self.pathways.along(part)) for part in parts]  # the arrays between are large
        return self.by_kind(np.concatenate(maxima), noise)

    def _drawn(self, count: int, height: int) -> Array:
        """Return simulated residuals (D, N)."""
        rows = self.rng.standard_normal((count, height), np.float32)
        rows *= self.pathways.whitened.present
        return rows

    def _drawn_levels(self, count: int) -> tuple[Array, Array]:
        """Return noise levels (D,) of observations and inputs as estimates of them scatter."""
        observed, inputs = (self.rng.chisquare(nu, count) / nu for nu in (self.noise.observed, self.noise.inputs))
        return observed, inputs

    def _flipped(self, count: int) -> Array:
        """Return sign-flipped residuals (D, N)."""
        return _signs(self.rng, count, len(self._standard)) * self._standard.astype(np.float32)

    @cached_property
    def _standard(self) -> Array:
        """Standardised residuals without the part that the best candidate explains, so that an effect does not widen
        the null distribution.
        """
        whitened, rows = self.pathways.whitened, self._best_rows
        residuals = whitened.rest - rows @ (rows.T @ whitened.rest)
        leverage = whitened.leverage + np.sum(rows**2, 1)
        standard = np.where(leverage < 0.999, residuals / np.sqrt(np.maximum(1.0 - leverage, 1e-3)), 0.0)
        return np.asarray(np.clip(standard * whitened.present, -_LARGEST, _LARGEST))

    @cached_property
    def _best_rows(self) -> Array:
        """Directions (N, r) of the single candidate with the smallest p."""
        if not self._visible_candidates:
            return np.zeros((len(self.pathways.whitened.rest), 0))
        squares, p_values = self.squares(self.pathways.residual[None])[0], np.ones(len(self._visible_candidates))
        shares = np.array([candidate.signature.input_share for candidate in self._visible_candidates])
        ranks = np.array([candidate.signature.rank for candidate in self._visible_candidates])
        for rank in np.unique(ranks):
            alike = ranks == rank
            noise = self.noise.without(squares[alike], int(rank), shares[alike])
            p_values[alike] = f_test(squares[alike], int(rank), noise, self.noise.freedom(shares[alike]))
        best = int(np.lexsort((-squares, p_values))[0])
        return self._visible_candidates[best].signature.rows(self.pathways)

    @cached_property
    def _flipped_level(self) -> float:
        tested = self.pathways.whitened.present & (self.pathways.whitened.leverage < 0.999)
        return float(np.mean(self._standard[tested] ** 2))


def _signs(rng: np.random.Generator, count: int, size: int) -> Array:
    bits = np.unpackbits(rng.integers(0, 256, (count, (size + 7) // 8), np.uint8), axis=1, count=size)
    return bits.astype(np.float32) * 2.0 - 1.0


@dataclass(frozen=True)
class CandidateGroup:
    """Candidates of one kind and rank, whose squares are directly comparable."""

    kind: str
    rank: int
    input_share: float


@dataclass(frozen=True)
class NullDistribution:
    """Null distribution of a search.

    ``drawn`` and ``flipped`` (draws, kinds) are the smallest p of every kind on simulated and on sign-flipped
    residuals; ``shares`` are the shares of the false-alarm budget by kind.
    """

    groups: tuple[CandidateGroup, ...]
    noise: NoiseComponents
    shares: dict[str, float]
    drawn: Array
    flipped: Array

    @cached_property
    def kinds(self) -> tuple[str, ...]:
        """Kinds of cause with a candidate that the campaign can see."""
        return kinds_of(self.groups)

    def raw(self, squares: Array | float, group: CandidateGroup, noise: Array | float) -> Array:
        """Return the p of the F test of squares (...) of a group, at a noise level estimated without them."""
        return f_test(squares, group.rank, noise, self.noise.freedom(group.input_share))

    @cached_property
    def cost(self) -> Array:
        """Factor (kinds,) on the p of each kind: the cost of the choice among its candidates over its share of the
        budget."""
        quantile = (
            np.quantile(self.drawn, _QUANTILE, axis=0) if len(self.drawn) else np.full(len(self.kinds), _QUANTILE)
        )
        whole = sum(self.shares[kind] for kind in self.kinds)
        return np.array([_QUANTILE / q for q in quantile]) * [whole / self.shares[kind] for kind in self.kinds]

    @cached_property
    def _minima(self) -> tuple[Array, Array]:
        return np.min(self.drawn * self.cost, 1), np.min(self.flipped * self.cost, 1)

    def corrected(self, squares: float, group: CandidateGroup) -> float:
        """Return the corrected p-value of a candidate's squares: the share of null searches that find at
        least as much."""
        noise = self.noise.without(squares, group.rank, group.input_share)
        statistic = float(self.raw(squares, group, noise) * self.cost[self.kinds.index(group.kind)])
        return min(1.0, max(_share(minima, statistic) for minima in self._minima))

    def group_of(self, kind: str, rank: int) -> CandidateGroup:
        """Return the group of a kind and rank."""
        return next(group for group in self.groups if group.kind == kind and group.rank == rank)

    def threshold(self, group: CandidateGroup, level: float) -> float:
        """Return the uncorrected p at which a candidate of a group has the corrected p-value ``level``."""
        limits = [float(np.quantile(minima, level)) for minima in self._minima]
        return min(limits) / float(self.cost[self.kinds.index(group.kind)])


def kinds_of(groups: Sequence[CandidateGroup]) -> tuple[str, ...]:
    """Return the kinds of some groups, each once."""
    return tuple(dict.fromkeys(group.kind for group in groups))


def f_test(squares: Array | float, rank: int, noise: Array | float, freedom: Array | float) -> Array:
    """Return the p of the F test of squares (...) of candidates of a rank; freedom: that of the noise level."""
    from scipy.special import fdtrc

    return np.asarray(fdtrc(rank, np.maximum(freedom - rank, 1.0), np.asarray(squares) / rank / noise))


def _share(minima: Array, statistic: float) -> float:
    """Return the share of null searches with at least this statistic; below the smallest shares, in proportion to it.
    The statistic is itself a p-value except for correlations between candidates and tails of the noise; the lowest
    drawn quantile corrects for these."""
    drawn = float((1 + np.sum(minima <= statistic)) / (1 + len(minima)))
    if drawn > _TAIL:
        return drawn
    extrapolated = statistic * max(_TAIL / float(np.quantile(minima, _TAIL)), 1.0)
    return max(min(drawn, extrapolated), LEAST_P)


def total_of(fitted: FittedModel[CauseT]) -> tuple[float, float]:
    noise = fitted.noise
    return noise.observed_total + noise.inputs_total, noise.observed + noise.inputs
