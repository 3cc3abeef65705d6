"""Choice of the next candidate to accept, and of the rivals that the data cannot distinguish from it."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Generic, TypeVar

import numpy as np

from truing.inference.evidence import probabilities
from truing.inference.model import CauseT
from truing.inference.rounds import NAME_LOG_ODDS, RIVAL_FACTOR, Round, is_nonparametric_of_subject
from truing.inference.search import CauseCandidate

_MOST_SUBJECTS = 3  # other subjects, or inputs, that are listed for a cause

Named = TypeVar("Named", str, tuple[str, ...])


@dataclass(frozen=True)
class CandidateChoice(Generic[CauseT]):
    """The candidate to accept, and indistinguishable rivals with their log odds over it.

    ``probability``: of its kind, among all kinds and none. ``of_two``: it is accepted as one of two that together
    explain what a single one would absorb; its probability holds next to the other one. ``subjects``: its other
    possible subjects, with the odds against each; ``inputs``: the same, of a nonparametric effect; ``quantities``:
    those of its subject that it may change instead.
    """

    candidate: CauseCandidate[CauseT]
    rivals: tuple[tuple[CauseCandidate[CauseT], float], ...]
    probability: float
    of_two: bool = False
    subjects: tuple[tuple[str, float], ...] = ()
    inputs: tuple[tuple[tuple[str, ...], float], ...] = ()
    quantities: tuple[str, ...] = ()

    def light(self) -> CandidateChoice[CauseT]:
        """Return the choice without designs, which only a search needs."""
        rivals = tuple((rival.light(), lead) for rival, lead in self.rivals)
        return replace(self, candidate=self.candidate.light(), rivals=rivals)


def choose(
    current: Round[CauseT], refused: set[str], level: float, *, pairs: bool = True
) -> CandidateChoice[CauseT] | None:
    """Return the candidate to accept, at the p-value ``level``; None where no candidate is real.

    This is the kind with the fewest parameters among those that explain the data equally well: none is three times more
    probable. A catalogued cause is preferred to a nonparametric effect unless the effect is clearly more
    probable. Where a pair explains what a single candidate would absorb, it is the first of the pair. Its rivals are
    then those that explain the data equally well in its place. Kinds in ``refused`` are ignored, also as a standard for
    the others.
    """
    rivals = _equivalent_candidates(current, level, refused)
    if not rivals:
        return None
    pair = current.best_pair if pairs else None
    if pair is not None and pair.first.kind not in refused and _is_acceptable_first(current, pair.first, level):
        also = tuple(rival for rival in pair.rivals if is_real(current, rival[0], level))
        first = pair.first
        others = _other_subjects(current, first), _other_inputs(current, first), _other_quantities(current, first)
        return CandidateChoice(first, also, pair.probability, True, *others)
    unnamed = [c for c in rivals if not c.cause.catalogued]
    least = max((current.posterior(c) for c in unnamed), default=-np.inf) - NAME_LOG_ODDS
    named = [c for c in rivals if c.cause.catalogued and current.posterior(c) >= least]
    left = probabilities({kind: current.posterior(c) for kind, c in current.best.items() if kind not in refused})
    equal = named or unnamed
    best = max(map(current.posterior, equal))
    chosen = min(
        (c for c in equal if current.posterior(c) >= best - NAME_LOG_ODDS),
        key=lambda c: (c.signature.parameters, -current.posterior(c)),
    )
    return _choice(current, chosen, rivals, left[chosen.kind])


def chosen_again(
    current: Round[CauseT], name: CauseCandidate[CauseT], refused: set[str], level: float
) -> CandidateChoice[CauseT]:
    """Return the choice of a given candidate with its rivals of this round, as where it is chosen there."""
    rivals = _equivalent_candidates(current, level, refused)
    return _choice(current, name, [c for c in rivals if c.kind != name.kind], current.probabilities[name.kind])


def _choice(
    current: Round[CauseT],
    chosen: CauseCandidate[CauseT],
    rivals: Sequence[CauseCandidate[CauseT]],
    probability: float,
) -> CandidateChoice[CauseT]:
    also = tuple((c, current.posterior(c) - current.posterior(chosen)) for c in rivals)
    others = _other_subjects(current, chosen), _other_inputs(current, chosen), _other_quantities(current, chosen)
    return CandidateChoice(chosen, also, probability, False, *others)


def confirmed(
    current: Round[CauseT], choice: CandidateChoice[CauseT], next_round: Round[CauseT], level: float, refused: set[str]
) -> bool:
    """Return True if a candidate chosen from a pair, with the best candidate after its refit, still beats every single
    one.

    Before the refit, the evidence of the pair is only an estimate. So is that of a single candidate, which is linear in
    the effect; a candidate that leaves nothing real needs no partner.
    """
    remaining = next_round.best.values()
    if not any(is_real(next_round, c, level) for c in remaining):
        return True
    alone = max(current.posterior(c) for kind, c in current.best.items() if kind not in refused)
    next_posterior = max((next_round.posterior(c) for c in remaining), default=0.0)
    return bool(current.posterior(choice.candidate) + next_posterior >= alone + np.log(RIVAL_FACTOR))


def is_real(current: Round[CauseT], candidate: CauseCandidate[CauseT], level: float) -> bool:
    """Return True if a candidate is significant and the evidence favours it over no effect.

    Evidence is needed too: many parameters together may differ from zero significantly without a plausible size in any
    direction.
    """
    speaks = current.scores[candidate.key].log_evidence > 0.0
    return speaks and current.p_value(candidate) <= level


def is_outdone(current: Round[CauseT], chosen: CauseCandidate[CauseT], refused: set[str]) -> bool:
    """Return True if a refused nonparametric effect is clearly more probable than a chosen catalogued cause."""
    unnamed = (c for c in current.candidates if not c.cause.catalogued and c.kind in refused)
    least = current.posterior(chosen) + NAME_LOG_ODDS
    return chosen.cause.catalogued and any(current.posterior(candidate) > least for candidate in unnamed)


def is_worth_reporting(rival: CauseCandidate[CauseT], lead: float) -> bool:
    """Return True for rivals to report: catalogued causes, and nonparametric effects that are at least as probable."""
    return rival.cause.catalogued or lead >= 0.0


def _equivalent_candidates(current: Round[CauseT], level: float, refused: set[str]) -> list[CauseCandidate[CauseT]]:
    """Return the best candidates of the kinds that hold up and are within a factor 20 of the best in evidence."""
    real = [c for c in current.best.values() if c.kind not in refused and _is_acceptable(current, c, level)]
    best = max((current.posterior(c) for c in real), default=0.0)
    return [c for c in real if current.posterior(c) >= best - np.log(RIVAL_FACTOR)]


def _is_acceptable(current: Round[CauseT], candidate: CauseCandidate[CauseT], level: float) -> bool:
    """Return True if a candidate is real and, if catalogued, is not just a remainder of a nonparametric effect in the
    model.

    Nonparametric effects are rough and leave a remainder. A catalogued cause must therefore clearly beat their
    higher-order terms, real or not, other effects of the same subject, and chance; and it must not be small compared
    with one that acts on the same.
    """
    if not is_real(current, candidate, level):
        return False
    forms = [cause for cause in current.fitted.causes if not cause.catalogued]
    if not candidate.cause.catalogued or not forms:
        return True
    reported = {cause.subject for cause in forms if cause.subject}  # effects of the whole have no subject
    unnamed = [c for c in current.candidates if not c.cause.catalogued]
    rests = (current.posterior(c) for c in unnamed if c.cause.is_higher_order or c.cause.subject in reported)
    least = max(max(rests, default=0.0), 0.0) + float(np.log(RIVAL_FACTOR))
    return current.posterior(candidate) >= least and not current.is_remainder(candidate)


def _is_acceptable_first(current: Round[CauseT], first: CauseCandidate[CauseT], level: float) -> bool:
    """Return True if the first of a pair may be accepted; if the model holds nonparametric effects, as if it came
    alone."""
    if any(is_nonparametric_of_subject(cause) for cause in current.fitted.causes):
        return _is_acceptable(current, first, level)
    return is_real(current, first, level)


def _other_subjects(current: Round[CauseT], chosen: CauseCandidate[CauseT]) -> tuple[tuple[str, float], ...]:
    """Return the other possible subjects of a catalogued cause, the most probable first, with the odds against each."""
    if not chosen.cause.catalogued:
        return ()
    alike = (c for c in current.candidates if c.kind == chosen.kind)
    return _near(chosen.cause.subject, ((c.cause.subject, current.posterior(c)) for c in alike))


def _other_inputs(current: Round[CauseT], chosen: CauseCandidate[CauseT]) -> tuple[tuple[tuple[str, ...], float], ...]:
    """Return the inputs on which the subject of a nonparametric effect may depend instead, the most probable first,
    with the odds against each."""
    if chosen.cause.catalogued:
        return ()
    parts, subject = current.fitted.model.part_count, chosen.cause.subject
    chosen_inputs = chosen.cause.inputs(parts)
    alike = [(c.cause.inputs(parts), c) for c in current.candidates if c.kind == chosen.kind]
    return _near(
        chosen_inputs,
        (
            (inputs, current.posterior(c))
            for inputs, c in alike
            if c.cause.subject == subject and (inputs == chosen_inputs or not set(chosen_inputs) <= set(inputs))
        ),
    )


def _other_quantities(current: Round[CauseT], chosen: CauseCandidate[CauseT]) -> tuple[str, ...]:
    """Return the quantities of the subject that a nonparametric effect of the same inputs may change instead, the most
    probable first."""
    if chosen.cause.catalogued:
        return ()
    parts, subject = current.fitted.model.part_count, chosen.cause.subject
    alike = (
        (c.cause.moved_quantity, current.posterior(c))
        for c in current.candidates
        if c.kind == chosen.kind and c.cause.subject == subject
        if c.cause.inputs(parts) == chosen.cause.inputs(parts)
    )
    return tuple(quantity for quantity, _ in _near(chosen.cause.moved_quantity, alike))


def _near(chosen_name: Named, candidates: Iterable[tuple[Named, float]]) -> tuple[tuple[Named, float], ...]:
    """Return the subjects besides ``chosen_name`` of candidates with log odds, where these are small, with the odds."""
    logs: dict[Named, float] = {}
    for named, log in candidates:
        logs[named] = float(np.logaddexp(logs.get(named, -np.inf), log))
    best = logs.pop(chosen_name)
    near = sorted((best - log, named) for named, log in logs.items() if best - log < np.log(RIVAL_FACTOR))
    return tuple((named, float(np.exp(against))) for against, named in near[:_MOST_SUBJECTS])
