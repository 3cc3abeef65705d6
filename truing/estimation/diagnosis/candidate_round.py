"""What one fitted model leaves for every candidate cause: a search, evidence one by one, and evidence in pairs."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from truing.estimation.diagnosis.alike_evidence import alike_log_evidence
from truing.estimation.diagnosis.candidate_search import Candidate, Profiles, Search
from truing.estimation.diagnosis.evidence import log_evidence, probabilities
from truing.estimation.diagnosis.fitted_model import Stand
from truing.estimation.diagnosis.judge import Judge
from truing.estimation.diagnosis.profile_signatures import TurnedPoints, profile_signatures, turned_points
from truing.estimation.diagnosis.signatures import POINTS, Channels, Signature, joint, signature

# Single targets with the most evidence that become candidates of their own.
_BEST_MEMBERS = 4
# How many of the most probable candidates are tried in pairs.
_PAIRED = 20
_OF_A_KIND = 3
# The probability that parameters of parts that were made alike are of like size, and not independent of each other.
_ALIKE = 0.7
# A cause of the catalogue is named unless a dependence in no declared form is more probable by this factor.
NAMED = float(np.log(3.0))
# Rivals within this factor of the best in evidence cannot be told from it.
RIVAL_FACTOR = 20.0
# Plausible scales are also tried this many times as large.
STRETCH = 3.0


@dataclass(frozen=True)
class Score:
    """What the data say of one candidate."""

    squares: float  # by which it lowers the sum of squares
    log_evidence: float  # marginal likelihood over that of the model without it
    log_posterior: float  # the same with what was probable beforehand
    along: NDArray  # (r,) scores along its directions

    @property
    def signal_to_noise(self) -> float:
        """Return the root of the reduction of the sum of squares."""
        return float(np.sqrt(self.squares))


@dataclass(frozen=True)
class Pair:
    """Two candidates that together explain what no single one does, the one to be accepted first before the other.

    ``rivals`` would explain it as well in place of the first, beside the second, with their log odds over the first.
    """

    first: Candidate
    second: Candidate
    rivals: tuple[tuple[Candidate, float], ...]


@dataclass(frozen=True)
class Round:
    """A fitted model, the candidates that are still open, and what the data say of each."""

    stand: Stand
    judge: Judge
    candidates: tuple[Candidate, ...]
    scores: dict[str, Score] = field(repr=False)  # by the cause's key
    tried: int  # how many candidates there were
    search: Search | None = field(repr=False)  # None once the round is over

    def p_value(self, candidate: Candidate) -> float:
        """Return a candidate's p-value, corrected for everything that was tried."""
        if not candidate.signature.rank:
            return 1.0
        group = self.judge.group_of(candidate.kind, candidate.signature.rank)
        return self.judge.corrected(self.scores[candidate.key].squares, group)

    @cached_property
    def best(self) -> dict[str, Candidate]:
        """Return the most probable candidate of every kind."""
        found: dict[str, Candidate] = {}
        for candidate in self.candidates:
            rival = found.setdefault(candidate.kind, candidate)
            if self.posterior(candidate) > self.posterior(rival):
                found[candidate.kind] = candidate
        return found

    def closed(self) -> Round:
        """Return the round as it was decided, without what is needed only to decide: large campaigns fill memory."""
        kept = tuple(candidate.light() for candidate in self.best.values())
        return replace(self, candidates=kept, search=None)

    def posterior(self, candidate: Candidate) -> float:
        """Return a candidate's log posterior odds against the model without it."""
        return self.scores[candidate.key].log_posterior

    @cached_property
    def probabilities(self) -> dict[str, float]:
        """Return the probability of every kind of cause, among them and none."""
        return probabilities({kind: self.posterior(candidate) for kind, candidate in self.best.items()})

    def scale_holds(self, candidate: Candidate, rivals: Sequence[Candidate]) -> bool:
        """Return whether a candidate stays the most probable where plausible scales are tripled."""
        own = self._stretched(candidate)
        return all(own >= self._stretched(rival) for rival in rivals)

    def _stretched(self, candidate: Candidate) -> float:
        """Return a candidate's log posterior odds with plausible scales tripled."""
        score = self.scores[candidate.key]
        if not candidate.signature.rank:
            return score.log_posterior
        beforehand = score.log_posterior - score.log_evidence
        return _log_evidence(candidate, self.stand, score.along, STRETCH) + beforehand

    @cached_property
    def best_pair(self) -> Pair | None:
        """Return the pair of candidates with the most evidence, the stronger one first, if it beats any single one."""
        if len(self.candidates) < 2 or self.search is None:
            return None
        tried = self._paired
        odds = {pair: self._pair_evidence(self.search.channels, *pair) for pair in _index_pairs(tried)}
        if not odds:
            return None
        best = max(odds, key=lambda pair: odds[pair] - NAMED * _unnamed(tried[i] for i in pair))
        if odds[best] < max(self.posterior(candidate) for candidate in tried) + np.log(RIVAL_FACTOR):
            return None
        first, second = sorted(best, key=lambda i: (_unnamed([tried[i]]), -self.posterior(tried[i])))
        behind = {sum(pair) - second: own - odds[best] for pair, own in odds.items() if second in pair}
        rivals = [(tried[i], lead) for i, lead in behind.items() if i != first and lead >= -np.log(RIVAL_FACTOR)]
        return Pair(tried[first], tried[second], tuple(rivals))

    @cached_property
    def _paired(self) -> list[Candidate]:
        """Return the most probable candidates, a few of each kind."""
        taken: list[Candidate] = []
        for candidate in sorted(self.candidates, key=self.posterior, reverse=True):
            if candidate.signature.rank and sum(c.kind == candidate.kind for c in taken) < _OF_A_KIND:
                taken.append(candidate)
        return taken[:_PAIRED]

    def _pair_evidence(self, channels: Channels, first: int, second: int) -> float:
        pair = self._paired[first], self._paired[second]
        strengths, loadings = joint(channels, pair[0].signature, pair[1].signature)
        raw = np.concatenate([_raw_scores(c.signature, self.scores[c.key]) for c in pair])
        along = (raw @ loadings) / strengths
        total, freedom = _total(self.stand)
        beforehand = sum(np.log(c.prior) + self._of_likeness(c) for c in pair)
        return float(log_evidence(along, strengths, total, freedom)) + float(beforehand)

    def _of_likeness(self, candidate: Candidate) -> float:
        """Return what a candidate's log evidence owes to parameters of like size."""
        score, (total, freedom) = self.scores[candidate.key], _total(self.stand)
        return score.log_evidence - float(log_evidence(score.along, candidate.signature.strengths, total, freedom))


def _index_pairs(tried: Sequence[Candidate]) -> list[tuple[int, int]]:
    """Return the pairs worth trying: of two kinds, or of two single targets."""
    return [
        (i, j)
        for i, j in combinations(range(len(tried)), 2)
        if tried[i].kind != tried[j].kind or _apart(tried[i], tried[j])
    ]


def _unnamed(candidates: Iterable[Candidate]) -> int:
    """Return how many candidates are dependences in a form that nobody declared."""
    return sum(not candidate.cause.catalogued for candidate in candidates)


def _apart(first: Candidate, second: Candidate) -> bool:
    """Return whether two candidates act on channels none of which they share, as two single targets do."""
    return not np.isin(first.signature.index, second.signature.index).any()


def _raw_scores(own: Signature, score: Score) -> NDArray:
    """Return the scores (P,) of a candidate's parameters, from those along its directions."""
    return np.asarray(own.loadings @ (score.along * own.strengths))


def _total(stand: Stand) -> tuple[float, float]:
    noise = stand.noise
    return noise.points_total + noise.readings_total, noise.points + noise.readings


def score_round(stand: Stand, kinds: Sequence[Any], draws: int, rng: np.random.Generator) -> Round:
    """Return what a fitted model leaves for all candidates that the kinds of cause propose."""
    return scored(stand, search_of(stand, kinds, draws, rng))


def scored(stand: Stand, search: Search) -> Round:
    """Return what a fitted model leaves for all candidates of a search."""
    along = search.channels.along(stand.fit.whitened.rest[None])[0]
    scores = {c.key: _score(c, stand, search.channels, along) for c in search.candidates}
    return Round(stand, search.judge, tuple(search.candidates), scores, len(search.candidates), search)


def search_of(stand: Stand, kinds: Sequence[Any], draws: int, rng: np.random.Generator) -> Search:
    """Return the search over all candidates that the kinds of cause propose, on what a fitted model leaves."""
    channels = stand.channels()
    candidates, profiles = _proposed(stand, channels, kinds), _profiles(stand, channels, kinds)
    along = channels.along(stand.fit.whitened.rest[None])[0]
    for own in profiles:
        candidates += _best_members(stand, channels, own, along)
    shares = {kind.id: kind.share for kind in kinds}
    return Search(channels, stand.noise, candidates, profiles, shares, draws, rng)


def _proposed(stand: Stand, channels: Channels, kinds: Sequence[Any]) -> list[Candidate]:
    found = []
    for kind in kinds:
        further = _open(stand, [c for own in stand.causes if own.id == kind.id for c in own.further(stand.scene)])
        for proposed in (_open(stand, kind.candidates(stand.scene)), further):
            weights = np.array([cause.prior(stand.scene) for cause in proposed])
            whole = max(weights.sum(), 1e-300) * (2.0 if further else 1.0)
            for cause, weight in zip(proposed, weights / whole, strict=True):
                found.append(_candidate(stand, channels, cause, kind.id, float(weight)))
    return found


def _open(stand: Stand, proposed: Sequence[Any]) -> list[Any]:
    """Return the causes that the model of a stand has a place for."""
    return [cause for cause in proposed if not any(own.excludes(cause) for own in stand.causes)]


def _candidate(stand: Stand, channels: Channels, cause: Any, kind: str, prior: float) -> Candidate:
    return Candidate(cause, kind, signature(channels, stand.designer(cause)), prior)


def _profiles(stand: Stand, channels: Channels, kinds: Sequence[Any]) -> list[Profiles]:
    found = []
    turns, scene = stand.model.turns(stand.fit.shared, stand.fit.local), stand.scene
    points: dict[bytes, TurnedPoints] = {}  # mostly the same for all
    for kind in kinds:
        for own in kind.profiles(scene):
            key = own.targets.tobytes()
            points[key] = points.get(key) or turned_points(channels, own.targets, turns)
            signatures = profile_signatures(points[key], own.values * own.scale, own.usable)
            if signatures.seen.any():
                found.append(Profiles(own, kind.id, signatures))
    return found


def _best_members(stand: Stand, channels: Channels, own: Profiles, along: NDArray) -> list[Candidate]:
    """Return the candidates over single targets with the most evidence, each target at its best shape."""
    signatures = own.signatures
    scores = signatures.scores(signatures.points.along(along[None][:, :, channels.places[POINTS]]))[..., 0]
    values, vectors = np.linalg.eigh(signatures.gram)
    strengths = np.sqrt(np.maximum(values, 1e-12))
    parts = np.einsum("stpr,stp->str", vectors, scores) / strengths
    total, freedom = _total(stand)
    odds = np.where(signatures.seen, log_evidence(parts, strengths, total, freedom), -np.inf)
    found = []
    for target in np.argsort(-odds.max(0), kind="stable")[:_BEST_MEMBERS]:
        shape = int(np.argmax(odds[:, target]))
        cause = own.cause.member(int(target), shape) if np.isfinite(odds[shape, target]) else None
        if cause is not None and cause.key not in stand.model.layout:
            found.append(_candidate(stand, channels, cause, own.kind, own.prior))
    return found


def _score(candidate: Candidate, stand: Stand, channels: Channels, along: NDArray) -> Score:
    own = candidate.signature
    if not own.rank:
        return Score(0.0, 0.0, float(np.log(candidate.prior)), np.zeros(0))
    parts = along[:, own.index].ravel() @ own.unit_design
    odds = _log_evidence(candidate, stand, parts)
    return Score(float(parts @ parts), odds, odds + float(np.log(max(candidate.prior, 1e-300))), parts)


def _log_evidence(candidate: Candidate, stand: Stand, parts: NDArray, stretch: float = 1.0) -> float:
    """Return a candidate's log evidence: of parameters of like size where there are such, or independent ones."""
    own, (total, freedom) = candidate.signature, _total(stand)
    independent = float(log_evidence(parts, own.strengths, total, freedom, stretch))
    members = candidate.cause.alike(stand.model.leg_count)
    if not members:
        return independent
    scores = own.loadings @ (parts * own.strengths)
    gram = (own.loadings * own.strengths**2) @ own.loadings.T
    alike = alike_log_evidence(scores, gram, members, total, freedom, stretch)
    return float(np.logaddexp(np.log(_ALIKE) + alike, np.log(1 - _ALIKE) + independent))
