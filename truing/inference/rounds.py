"""One round of the search: evidence of every candidate, alone and in pairs, given one fitted model."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import combinations
from typing import Generic

import numpy as np

from truing.inference.arrays import Array
from truing.inference.evidence import (
    log_evidence,
    log_possible,
    probabilities,
)
from truing.inference.fitted_model import FittedModel
from truing.inference.model import CauseLike, CauseT
from truing.inference.onset_search import at_best_onsets
from truing.inference.scores import (
    Score,
    log_evidence_of,
    parts_of,
    posterior_covariance,
    raw_scores,
    scores_of,
    squares_left,
)
from truing.inference.search import CandidateGroup, CauseCandidate, NullDistribution, Search, total_of
from truing.inference.search_candidates import HIGHER_ORDER_SHARE, admissible, candidate_of, search_of
from truing.inference.signatures import Pathways, Signature, joint, signature

# Number of the most probable candidates that are tried in pairs, and of those of one kind.
_PAIRED = 20
_OF_A_KIND = 3
# If the model holds a nonparametric effect that acts on at least the share _SAME_GROUND of what a catalogued cause acts
# on, the cause must explain at least the share _OF_ITS_SIZE of that effect's squares (half its amplitude).
_OF_ITS_SIZE, _SAME_GROUND = 0.25, 0.5
_MOST_OF_IT = 0.5  # share of a candidate that varies at equal inputs of another effect
# Log odds by which a nonparametric effect must lead to be preferred to a cause of the catalogue.
NAME_LOG_ODDS = float(np.log(3.0))
# Rivals within this factor of the best in evidence are indistinguishable from it.
RIVAL_FACTOR = 20.0
# A candidate explains the same as an accepted one if at most this share of its squares is left next to it; kinds whose
# squares differ by less than this share have the same effect.
_LOST, _EQUAL = 0.5, 1e-3
# Factor on the plausible scales in the test of robustness against them.
STRETCH = 3.0


def explains_the_same(score: Score, later: Score | None) -> bool:
    """Return True if a candidate loses half of its squares next to an accepted cause, from ``score`` to ``later``."""
    return later is not None and later.squares <= _LOST * score.squares


def is_nonparametric_of_subject(cause: CauseLike) -> bool:
    """Return True for a nonparametric effect with a subject; one of the whole is no rival of a catalogued cause."""
    return not cause.catalogued and bool(cause.subject)


def share_explained(final: FittedModel[CauseT], cause: CauseT) -> float:
    """Return the share (0 to 1) of a catalogued cause in the squares that it and nonparametric effects explain
    together.

    Only nonparametric effects that act on most of what the cause acts on count, unless the cause varies where their
    inputs are equal.
    """
    unnamed = [other for other in final.causes if not other.catalogued]
    if not unnamed:
        return 1.0
    pathways = final.pathways
    acting_part, squares = _acting(final, pathways, cause)
    unnamed = [other for other in unnamed if not _varies_at_equal(final, acting_part, other)]
    others = [_acting(final, pathways, other) for other in unnamed]
    beside = sum(held for form, held in others if acting_part.share_on(pathways, form) > _SAME_GROUND)
    return squares / (squares + beside)


def _varies_at_equal(fitted: FittedModel[CauseT], effect: Signature, held: CauseT) -> bool:
    """Return True if most of an effect varies among epochs with equal inputs of another one, such as commands that
    were approached from both sides: it is no remainder of that one."""
    known, names = fitted.scene.covariates, held.inputs(fitted.model.part_count)
    columns = [known[name] for name in names if name in known and known[name].ndim == 1]
    if not columns or len(columns) < len(names):
        return False
    group = np.unique(np.column_stack(columns), axis=0, return_inverse=True)[1].ravel()
    design = effect.design.reshape(len(group), -1)
    sums = np.zeros((group.max() + 1, design.shape[1]))
    np.add.at(sums, group, design)
    within = design - (sums / np.bincount(group)[:, None])[group]
    return float(np.sum(within**2)) > _MOST_OF_IT * float(np.sum((design - design.mean(0)) ** 2))


def act_on_same(fitted: FittedModel[CauseT], cause: CauseT, unnamed: CauseT) -> bool:
    """Return True if a nonparametric effect acts on most of what a cause acts on."""
    first, second = (signature(fitted.pathways, fitted.design_matrix(effect)) for effect in (cause, unnamed))
    return first.share_on(fitted.pathways, second) > _SAME_GROUND


def _acting(fitted: FittedModel[CauseT], pathways: Pathways, cause: CauseT) -> tuple[Signature, float]:
    """Return the signature of a cause that the model holds, and its squares over its own covariance."""
    values, covariance = fitted.values(cause)
    squares = float(values @ np.linalg.solve(covariance, values))
    return signature(pathways, fitted.design_matrix(cause)), squares


@dataclass(frozen=True)
class CandidatePair(Generic[CauseT]):
    """Two candidates that together explain more than any single one; ``first`` is accepted first.

    ``rivals`` could replace the first, together with the second, with their log odds over it. ``probability``: of the
    kind of the first next to the second, among all kinds and none.
    """

    first: CauseCandidate[CauseT]
    second: CauseCandidate[CauseT]
    rivals: tuple[tuple[CauseCandidate[CauseT], float], ...]
    probability: float


@dataclass(frozen=True)
class Round(Generic[CauseT]):
    """A fitted model, the candidates that are still open, and their scores."""

    fitted: FittedModel[CauseT]
    null: NullDistribution
    candidates: tuple[CauseCandidate[CauseT], ...]
    scores: dict[str, Score] = field(repr=False)  # by the cause's key
    tried: int  # how many candidates there were
    kinds: dict[str, str] = field(repr=False)  # of all candidates, by the cause's key
    search: Search[CauseT] | None = field(repr=False)  # None once the round is over

    def p_value(self, candidate: CauseCandidate[CauseT]) -> float:
        """Return a candidate's p-value, corrected for all candidates tried."""
        if not candidate.signature.rank:
            return 1.0
        group = self.null.group_of(candidate.kind, candidate.signature.rank)
        return self.null.corrected(self.scores[candidate.key].squares, group)

    @cached_property
    def best(self) -> dict[str, CauseCandidate[CauseT]]:
        """Most probable candidate of every kind."""
        best_of_kind: dict[str, CauseCandidate[CauseT]] = {}
        for candidate in self.candidates:
            rival = best_of_kind.setdefault(candidate.kind, candidate)
            if self.posterior(candidate) > self.posterior(rival):
                best_of_kind[candidate.kind] = candidate
        return best_of_kind

    def closed(self) -> Round[CauseT]:
        """Return the round without the designs and the search, which need much memory and only serve the decision."""
        candidates = tuple(candidate.light() for candidate in self.best.values())
        return replace(self, candidates=candidates, search=None)

    def posterior(self, candidate: CauseCandidate[CauseT]) -> float:
        """Return a candidate's log posterior odds against the model without it."""
        return self.scores[candidate.key].log_posterior

    def probability_of_name(
        self, chosen: CauseCandidate[CauseT], later: Round[CauseT], ignored: Collection[str] = ()
    ) -> float:
        """Return the probability of the kind of a candidate among all that explain the same, and none.

        ``later`` is the round after its acceptance. A candidate explains the same if it loses half of its squares
        there. Each kind has the sum of its candidates, since one of them is enough. A kind with as many parameters or
        more that has the same effect is no alternative: no such campaign separates the two. Nor are ``ignored`` kinds.
        """
        squares = self.scores[chosen.key].squares
        odds: dict[str, list[float]] = {chosen.kind: [self.posterior(chosen)]}
        for key, score in self.scores.items():
            equal = (
                len(score.along) >= len(chosen.signature.strengths) and abs(score.squares - squares) < _EQUAL * squares
            )
            if (
                key != chosen.key
                and self.kinds[key] not in ignored
                and explains_the_same(score, later.scores.get(key))
                and not (equal and self.kinds[key] != chosen.kind)
            ):
                odds.setdefault(self.kinds[key], []).append(score.log_posterior)
        log_odds = {kind: float(np.logaddexp.reduce(values)) for kind, values in odds.items()}
        return probabilities(log_odds)[chosen.kind]

    @cached_property
    def probabilities(self) -> dict[str, float]:
        """Probability of every kind of cause, among all kinds and none."""
        return probabilities({kind: self.posterior(candidate) for kind, candidate in self.best.items()})

    def choice(self, candidate: CauseCandidate[CauseT]) -> float:
        """Return the evidence averaged over the candidates of a kind on the same subject, relative to that of one of
        them; at most 1."""
        alike = [c for c in self.candidates if c.kind == candidate.kind and c.cause.subject == candidate.cause.subject]
        log_sum = float(np.logaddexp.reduce([self.posterior(c) for c in alike]))
        prior = float(np.log(max(sum(c.prior for c in alike), 1e-300)))
        return float(np.exp(min(0.0, log_sum - prior - self.scores[candidate.key].log_evidence)))

    def scale_holds(self, candidate: CauseCandidate[CauseT], rivals: Sequence[CauseCandidate[CauseT]]) -> bool:
        """Return True if a candidate stays the most probable when plausible scales are tripled."""
        log_odds = self._log_odds_at_triple_scale(candidate)
        return all(log_odds >= self._log_odds_at_triple_scale(rival) for rival in rivals)

    def _log_odds_at_triple_scale(self, candidate: CauseCandidate[CauseT]) -> float:
        """Return a candidate's log posterior odds with plausible scales tripled."""
        score = self.scores[candidate.key]
        if not candidate.signature.rank:
            return score.log_posterior
        beforehand = score.log_posterior - score.log_evidence
        return log_evidence_of(candidate, self.fitted, score.along, STRETCH) + score.log_signs + beforehand

    @cached_property
    def best_pair(self) -> CandidatePair[CauseT] | None:
        """Pair of candidates with the most evidence, if it clearly beats every single one; None otherwise."""
        if len(self.candidates) < 2 or self.search is None:
            return None
        tried = self._paired
        odds = {(i, j): self.pair_evidence(self.search.pathways, tried[i], tried[j]) for i, j in _index_pairs(tried)}
        least = max((self.posterior(candidate) for candidate in tried), default=0.0) + np.log(RIVAL_FACTOR)
        for best in sorted(
            odds, key=lambda pair: odds[pair] - NAME_LOG_ODDS * _unnamed(tried[i] for i in pair), reverse=True
        ):
            if odds[best] < least:
                return None
            if odds[best] >= self._least_of_pair([tried[i] for i in best]):
                break
        else:
            return None
        first, second = sorted(best, key=lambda i: (_unnamed([tried[i]]), -self.posterior(tried[i])))
        behind = {sum(pair) - second: value - odds[best] for pair, value in odds.items() if second in pair}
        rivals = [(tried[i], lead) for i, lead in behind.items() if i != first and lead >= -np.log(RIVAL_FACTOR)]
        alone = self.posterior(tried[second]) - odds[best]
        by_kind: dict[str, float] = {}
        for i, lead in behind.items():
            by_kind[tried[i].kind] = max(lead - alone, by_kind.get(tried[i].kind, -np.inf))
        return CandidatePair(tried[first], tried[second], tuple(rivals), probabilities(by_kind)[tried[first].kind])

    def _least_of_pair(self, pair: Sequence[CauseCandidate[CauseT]]) -> float:
        """Return the least log odds of a pair of a catalogued cause and a nonparametric effect. A nonparametric effect
        is rough. The pair must clearly beat the effect with its own higher-order terms, or with another form of the
        same subject."""
        unnamed = [candidate for candidate in pair if not candidate.cause.catalogued]
        if len(unnamed) != 1 or not is_nonparametric_of_subject(unnamed[0].cause):
            return -np.inf
        return self._log_odds_with_addition(unnamed[0]) + float(np.log(RIVAL_FACTOR))

    def _log_odds_with_addition(self, form: CauseCandidate[CauseT]) -> float:
        """Return the log odds of a nonparametric effect with the best addition among nonparametric effects of its
        subject."""
        if form.key not in self._rests:
            assert self.search is not None
            pathways = self.search.pathways
            others = [c for c in self._unnamed_best if c is not form and c.cause.subject == form.cause.subject]
            beside = [self.pair_evidence(pathways, form, c) for c in (*self._higher_order_candidates(form), *others)]
            self._rests[form.key] = max([self.posterior(form), *beside])
        return self._rests[form.key]

    def rivals_of(self, name: CauseCandidate[CauseT]) -> frozenset[str]:
        """Return the keys of the nonparametric effects that explain at least a quarter of a cause's squares.

        The overlap of their directions decides, not the part of the data that they explain: of many effects, those
        would be taken that chance favours.
        """
        assert self.search is not None
        pathways, along = self.search.pathways, self.scores[name.key].along
        direction = name.signature.rows(pathways) @ (along / max(float(np.linalg.norm(along)), 1e-300))
        parts = pathways.along(direction[None])[0]
        return frozenset(
            candidate.key
            for candidate in self.candidates
            if not candidate.cause.catalogued
            and candidate.signature.rank
            and np.sum(parts_of(candidate.signature, parts) ** 2) >= _OF_ITS_SIZE
        )

    def p_value_of_rivals(self, rivals: Collection[str]) -> float:
        """Return the p-value of nonparametric rivals, given by their keys, next to an accepted cause.

        A name of the right form leaves them nothing but chance.
        """
        p_values = [
            candidate.chosen_from * self._raw_p_value(candidate)
            for candidate in self.candidates
            if candidate.key in rivals and candidate.signature.rank
        ]
        return min(1.0, len(p_values) * min(p_values)) if p_values else 1.0

    def _raw_p_value(self, candidate: CauseCandidate[CauseT]) -> float:
        squares, effect = self.scores[candidate.key].squares, candidate.signature
        noise = self.fitted.noise.without(squares, effect.rank, effect.input_share)
        return float(self.null.raw(squares, CandidateGroup(candidate.kind, effect.rank, effect.input_share), noise))

    def is_remainder(self, candidate: CauseCandidate[CauseT]) -> bool:
        """Return True if a candidate is probably a remainder of a nonparametric effect of the model.

        It is small compared with that effect, acts on the same values, and does not vary where the effect's inputs are
        equal. The remainder of an effect does not vary there either.
        """
        if self.search is None:
            return False
        pathways, squares = self.search.pathways, self.scores[candidate.key].squares
        return any(
            squares < _OF_ITS_SIZE * squares_held
            and candidate.signature.share_on(pathways, held) > _SAME_GROUND
            and not _varies_at_equal(self.fitted, candidate.signature, cause)
            for cause, held, squares_held in self._held_nonparametric
        )

    @cached_property
    def _held_nonparametric(self) -> list[tuple[CauseT, Signature, float]]:
        """Nonparametric effects with a subject that the model holds, with their signatures and squares."""
        assert self.search is not None
        return [
            (cause, *_acting(self.fitted, self.search.pathways, cause))
            for cause in self.fitted.causes
            if is_nonparametric_of_subject(cause)
        ]

    @cached_property
    def _rests(self) -> dict[str, float]:
        return {}

    @cached_property
    def _unnamed_best(self) -> list[CauseCandidate[CauseT]]:
        """Most probable nonparametric effects, and all higher-order terms of an accepted one."""
        ranked = sorted(self.candidates, key=self.posterior, reverse=True)
        unnamed = [c for c in ranked if not c.cause.catalogued and c.signature.rank]
        return [c for index, c in enumerate(unnamed) if index < _PAIRED or c.cause.is_higher_order]

    def _higher_order_candidates(self, form: CauseCandidate[CauseT]) -> list[CauseCandidate[CauseT]]:
        """Return the higher-order terms of an effect as candidates, as they would be proposed after its acceptance."""
        assert self.search is not None
        pathways, proposed = (
            self.search.pathways,
            admissible(self.fitted, self.fitted.scene.higher_order_terms(form.cause)),
        )
        prior = HIGHER_ORDER_SHARE / max(len(proposed), 1)
        candidates = [candidate_of(self.fitted, pathways, cause, form.kind, prior) for cause in proposed]
        return [candidate for candidate in candidates if candidate.signature.rank]

    def _score(self, candidate: CauseCandidate[CauseT]) -> Score:
        """Return the score of a candidate, also of one that is not yet proposed."""
        if candidate.key in self.scores or self.search is None:
            return self.scores[candidate.key]
        return scores_of([candidate], self.fitted, self.search.pathways.residual)[0]

    @cached_property
    def _paired(self) -> list[CauseCandidate[CauseT]]:
        """Most probable candidates, a few of each kind."""
        taken: list[CauseCandidate[CauseT]] = []
        of_kind: Counter[str] = Counter()
        for candidate in sorted(self.candidates, key=self.posterior, reverse=True):
            if candidate.signature.rank and of_kind[candidate.kind] < _OF_A_KIND:
                of_kind[candidate.kind] += 1
                taken.append(candidate)
        return taken[:_PAIRED]

    def pair_evidence(self, pathways: Pathways, *pair: CauseCandidate[CauseT]) -> float:
        """Return the log odds of two candidates together against the model without them."""
        strengths, loadings = joint(pathways, pair[0].signature, pair[1].signature)
        raw = np.concatenate([raw_scores(c.signature, self._score(c)) for c in pair])
        along = (raw @ loadings) / strengths
        total, freedom = total_of(self.fitted)
        beforehand = sum(np.log(c.prior) + self._log_evidence_of_sizes(c) for c in pair)
        values, covariance = loadings @ (along / strengths), posterior_covariance(loadings, strengths)
        signs = self._signs(pair, values, covariance, along)
        return float(log_evidence(along, strengths, total, freedom)) + float(beforehand) + signs

    def _signs(self, pair: Sequence[CauseCandidate[CauseT]], values: Array, covariance: Array, along: Array) -> float:
        """Return the log evidence that impossible signs cost candidates together. Given are all their parameters (P,)
        and the parts (r,) of the residual along their directions."""
        parts, first, total = self.fitted.model.part_count, 0, 0.0
        left = squares_left(self.fitted, along)
        for candidate in pair:
            place = np.s_[first : first + candidate.signature.parameters]
            total += log_possible(values[place], covariance[place, place], candidate.cause.one_sided(parts), *left)
            first = place.stop
        return total

    def _log_evidence_of_sizes(self, candidate: CauseCandidate[CauseT]) -> float:
        """Return the part of a candidate's log evidence that is due to parameters of like size or of a known range."""
        cause = candidate.cause
        if not (cause.has_known_scale or cause.like_sized(self.fitted.model.part_count)):
            return 0.0
        score, (total, freedom) = self._score(candidate), total_of(self.fitted)
        owed = score.log_evidence - score.log_signs
        return owed - float(log_evidence(score.along, candidate.signature.strengths, total, freedom))


def _index_pairs(tried: Sequence[CauseCandidate[CauseT]]) -> list[tuple[int, int]]:
    """Return the index pairs worth trying: of two kinds, or of separate pathways such as two single channels."""
    return [
        (i, j)
        for i, j in combinations(range(len(tried)), 2)
        if tried[i].kind != tried[j].kind or _share_no_pathway(tried[i], tried[j])
    ]


def _unnamed(candidates: Iterable[CauseCandidate[CauseT]]) -> int:
    """Return the number of candidates that are nonparametric effects."""
    return sum(not candidate.cause.catalogued for candidate in candidates)


def _share_no_pathway(first: CauseCandidate[CauseT], second: CauseCandidate[CauseT]) -> bool:
    """Return True if two candidates share no pathway, as two single channels do."""
    return not np.isin(first.signature.index, second.signature.index).any()


def score_round(
    fitted: FittedModel[CauseT], kinds: Sequence[CauseT], draws: int, rng: np.random.Generator
) -> Round[CauseT]:
    """Return the round of a fitted model: scores of all candidates that the kinds of cause propose.

    Where a search tries only some onsets, the best candidate of every kind is added at its best onset.
    """
    search = search_of(fitted, kinds, draws, rng)
    scores = scores_of(search.candidates, fitted, search.pathways.residual)
    added = at_best_onsets(search, scores, fitted)
    scores += scores_of(added, fitted, search.pathways.residual)
    return _round(fitted, replace(search, candidates=[*search.candidates, *added]), scores)


def _round(fitted: FittedModel[CauseT], search: Search[CauseT], scores: Sequence[Score]) -> Round[CauseT]:
    by_key = {candidate.key: score for candidate, score in zip(search.candidates, scores, strict=True)}
    kinds = {candidate.key: candidate.kind for candidate in search.candidates}
    return Round(fitted, search.null, tuple(search.candidates), by_key, len(search.candidates), kinds, search)
