"""Which candidate of a round to accept, and which others the data cannot tell from it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from truing.estimation.diagnosis.candidate_round import NAMED, RIVAL_FACTOR, Round, is_form_of_a_subject
from truing.estimation.diagnosis.candidate_search import Candidate

_MOST_SUBJECTS = 3


@dataclass(frozen=True)
class Choice:
    """The candidate to accept, and which ones the data cannot tell from it, with their log odds over it.

    ``of_two``: it is accepted as one of two that together explain what one would swallow; ``subjects``: what else it
    may concern, with the odds against each.
    """

    candidate: Candidate
    rivals: tuple[tuple[Candidate, float], ...]
    of_two: bool = False
    subjects: tuple[tuple[str, float], ...] = ()

    def light(self) -> Choice:
        """Return it without designs, which only a search needs."""
        rivals = tuple((rival.light(), lead) for rival, lead in self.rivals)
        return replace(self, candidate=self.candidate.light(), rivals=rivals)


def choose(current: Round, refused: set[str], level: float, *, pairs: bool = True) -> Choice | None:
    """Return the candidate to accept: of the kinds that explain the data equally well the one with the fewest
    parameters, a named one unless no name is more probable; where two together explain what one would swallow, the
    stronger of them, whose rivals are those that do as well beside the other.

    None where nothing is real, at the p-value ``level``, that is not of a kind among ``refused``: what is out for
    another reason sets no standard that the others would have to meet.
    """
    rivals = _equals(current, level, refused)
    if not rivals:
        return None
    pair = current.best_pair if pairs else None
    if pair is not None and pair.first.kind not in refused and _leads(current, pair.first, level):
        also = tuple(own for own in pair.rivals if is_real(current, own[0], level))
        return Choice(pair.first, also, True, _other_subjects(current, pair.first))
    unnamed = [c for c in rivals if not c.cause.catalogued]
    least = max((current.posterior(c) for c in unnamed), default=-np.inf) - NAMED
    named = [c for c in rivals if c.cause.catalogued and current.posterior(c) >= least]
    chosen = min(named or unnamed, key=lambda c: (c.signature.parameters, -current.posterior(c)), default=None)
    if chosen is None:
        return None
    also = tuple((c, current.posterior(c) - current.posterior(chosen)) for c in rivals)
    return Choice(chosen, also, False, _other_subjects(current, chosen))


def confirmed(current: Round, choice: Choice, following: Round, level: float, refused: set[str]) -> bool:
    """Return whether what was chosen as one of two, and the best beside it once everything was fitted anew, are still
    more probable than any single one that was not refused: before, the evidence of two is an estimate.

    So is that of a single one, which is linear in the effect; what leaves nothing real beside it needs no other.
    """
    left = following.best.values()
    if not any(is_real(following, c, level) for c in left):
        return True
    alone = max(current.posterior(c) for kind, c in current.best.items() if kind not in refused)
    beside = max((following.posterior(c) for c in left), default=0.0)
    return bool(current.posterior(choice.candidate) + beside >= alone + np.log(RIVAL_FACTOR))


def is_real(current: Round, candidate: Candidate, level: float) -> bool:
    """Return whether chance is ruled out, and the data speak for the cause rather than for none.

    The second is no matter of course: many parameters may be far from zero together, and of no plausible size in any
    direction.
    """
    speaks = current.scores[candidate.key].log_evidence > 0.0
    return speaks and current.p_value(candidate) <= level


def _equals(current: Round, level: float, refused: set[str]) -> list[Candidate]:
    """Return the best candidates of those kinds that stand and are within a factor 20 of the best in evidence."""
    real = [c for c in current.best.values() if c.kind not in refused and _stands(current, c, level)]
    best = max((current.posterior(c) for c in real), default=0.0)
    return [c for c in real if current.posterior(c) >= best - np.log(RIVAL_FACTOR)]


def _stands(current: Round, candidate: Candidate, level: float) -> bool:
    """Return whether a candidate is real, and a name no remainder of a form that nobody declared.

    Such forms are rough, so that something is left of them: beside one, a name has to be told from its further terms,
    real or not, from other forms of its subject, and from chance, and must not be small beside it where it acts on the
    same.
    """
    if not is_real(current, candidate, level):
        return False
    forms = [cause for cause in current.stand.causes if not cause.catalogued]
    if not candidate.cause.catalogued or not forms:
        return True
    told = {cause.subject for cause in forms if cause.subject}  # what concerns all is about nothing in particular
    unnamed = [c for c in current.candidates if not c.cause.catalogued]
    rests = (current.posterior(c) for c in unnamed if c.cause.goes_on or c.cause.subject in told)
    least = max(max(rests, default=0.0), 0.0) + float(np.log(RIVAL_FACTOR))
    return current.posterior(candidate) >= least and not current.is_remainder(candidate)


def _leads(current: Round, first: Candidate, level: float) -> bool:
    """Return whether the first of a pair is accepted: beside forms of a subject as if it came alone."""
    if any(is_form_of_a_subject(cause) for cause in current.stand.causes):
        return _stands(current, first, level)
    return is_real(current, first, level)


def _other_subjects(current: Round, chosen: Candidate) -> tuple[tuple[str, float], ...]:
    """Return what else a named cause may concern, the most probable first, with the odds against each."""
    if not chosen.cause.catalogued:
        return ()
    logs: dict[str, float] = {}
    for candidate in current.candidates:
        if candidate.kind == chosen.kind:
            own = candidate.cause.subject
            logs[own] = float(np.logaddexp(logs.get(own, -np.inf), current.posterior(candidate)))
    best = logs.pop(chosen.cause.subject)
    near = sorted((best - log, subject) for subject, log in logs.items() if best - log < np.log(RIVAL_FACTOR))
    return tuple((subject, float(np.exp(against))) for against, subject in near[:_MOST_SUBJECTS])
