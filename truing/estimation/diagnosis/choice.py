"""Which candidate of a round to accept, and which others the data cannot tell from it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from truing.estimation.diagnosis.candidate_round import NAMED, RIVAL_FACTOR, Round
from truing.estimation.diagnosis.candidate_search import Candidate


@dataclass(frozen=True)
class Choice:
    """The candidate to accept, and which ones the data cannot tell from it, with their log odds over it."""

    candidate: Candidate
    rivals: tuple[tuple[Candidate, float], ...]

    def light(self) -> Choice:
        """Return it without designs, which only a search needs."""
        return Choice(self.candidate.light(), tuple((rival.light(), lead) for rival, lead in self.rivals))


def choose(current: Round, refused: set[str], level: float) -> Choice | None:
    """Return the candidate to accept: of the kinds that explain the data equally well the one with the fewest
    parameters, a named one unless no name is more probable; where two together explain what one would swallow, the
    stronger of them, whose rivals are those that do as well beside the other.

    None where nothing is real, at the p-value ``level``, that is not of a kind among ``refused``.
    """
    equals = _equals(current, level)
    rivals = [c for c in equals if c.kind not in refused]
    if not rivals:
        return None
    pair = current.best_pair
    if pair is not None and is_real(current, pair.first, level) and pair.first.kind not in refused:
        return Choice(pair.first, tuple(own for own in pair.rivals if is_real(current, own[0], level)))
    unnamed = max((current.posterior(c) for c in rivals if not c.cause.catalogued), default=-np.inf)
    named = [c for c in rivals if c.cause.catalogued and current.posterior(c) >= unnamed - NAMED]
    chosen = min(named or rivals, key=lambda c: (*_complexity(c), -current.posterior(c)))
    return Choice(chosen, tuple((c, current.posterior(c) - current.posterior(chosen)) for c in equals))


def is_real(current: Round, candidate: Candidate, level: float) -> bool:
    """Return whether chance is ruled out, and the data speak for the cause rather than for none.

    The second is no matter of course: many parameters may be far from zero together, and of no plausible size in any
    direction.
    """
    speaks = current.scores[candidate.key].log_evidence > 0.0
    return speaks and current.p_value(candidate) <= level


def _equals(current: Round, level: float) -> list[Candidate]:
    """Return the best candidates of those kinds that are real and within a factor 20 of the best in evidence."""
    real = [c for c in current.best.values() if is_real(current, c, level)]
    best = max((current.posterior(c) for c in real), default=0.0)
    return [c for c in real if current.posterior(c) >= best - np.log(RIVAL_FACTOR)]


def _complexity(candidate: Candidate) -> tuple[bool, int]:
    """Return whether a candidate has no name, and its number of parameters."""
    return not candidate.cause.catalogued, candidate.signature.parameters
