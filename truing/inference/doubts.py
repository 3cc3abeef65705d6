"""Doubts about accepted causes: effects that may act next to them or in their place, and an inadequate model."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

from truing.inference.accepted_cause import Accepted
from truing.inference.fitted_model import FittedModel
from truing.inference.forward_search import ForwardSearch
from truing.inference.free_course import CourseRival, course_rival, lead_over_one_course
from truing.inference.model import CauseT
from truing.inference.names_next_to_others import LEAST_PROBABILITY
from truing.inference.rounds import RIVAL_FACTOR, act_on_same, share_explained
from truing.inference.search_result import Searched, names_of_one_effect
from truing.inference.search_verdicts import LEAST_LOG_ODDS, contradiction, is_unconfirmed
from truing.inference.verdicts import FOUND, SUSPECTED, Reason, Verdict

# Probability below which other inputs, or other causes, are more probable than an effect without a name.
_EVEN = 0.5
_FEWEST_OF_COURSE = 2  # causes that may be one course


@dataclass(frozen=True)
class Doubts:
    """Doubts of a search, with accepted causes by their keys.

    whole: reason to doubt the model as a whole. outdone: causes next to which, or in place of which, an effect without
    a name may act; courses: the random courses among these effects. weak: effects without a name that larger noise may
    have produced. with_rivals: causes from which another one is indistinguishable. contested: causes that other forms
    contest, and possible consequences of these.
    """

    whole: Reason | None
    outdone: Collection[str]
    courses: Mapping[str, CourseRival]
    weak: Collection[str]
    with_rivals: Collection[str]
    contested: Collection[str] = ()

    def checked(
        self, verdict: Verdict[CauseT], final: FittedModel[CauseT], given: Collection[CauseT]
    ) -> Verdict[CauseT]:
        """Return a verdict after checks on the final model: a found cause that fails one is only suspected.

        Predictions may contradict it. A nonparametric effect is doubted that larger noise than declared may have
        produced, or in place of which other causes are more probable. A catalogued cause is also doubted if it takes
        the place of a plainer one without clear need, or if the final model is inadequate. So is one that may be a part
        of a nonparametric effect of the model. So it is if a nonparametric effect was more probable but refused, or
        still explains something next to the cause; if random courses compete with it; if no effect, or other causes
        that explain the same, are too probable; or if it rests on an assumption that nobody declared.
        """
        if verdict.verdict != FOUND:
            return verdict
        if reason := contradiction(verdict):
            return replace(verdict, verdict=SUSPECTED, reason=reason)
        if verdict.cause.key in self.weak:
            return replace(verdict, verdict=SUSPECTED, reason=Reason.INADEQUATE)
        if verdict.cause in given:
            return verdict
        if not verdict.cause.catalogued:
            is_improbable = verdict.probability < _EVEN
            return replace(verdict, verdict=SUSPECTED, reason=Reason.ALTERNATIVE) if is_improbable else verdict
        verdict = replace(verdict, share_explained=share_explained(final, verdict.cause))
        if self.whole is not None or verdict.cause.key in self.outdone:
            course = self.courses.get(verdict.cause.key)
            reason = self.whole or (Reason.UNNAMED if course is None else Reason.COURSE)
            share = verdict.share_explained if course is None else course.share
            return replace(verdict, verdict=SUSPECTED, reason=reason, course=course, share_explained=share)
        is_contested = verdict.cause.key in self.contested
        if is_contested or not verdict.cause.is_distinct(verdict.values, verdict.covariance):
            return replace(verdict, verdict=SUSPECTED, reason=Reason.ALTERNATIVE)
        if verdict.cause.is_assumed:
            return replace(verdict, verdict=SUSPECTED, reason=Reason.ASSUMED)
        if verdict.probability < LEAST_PROBABILITY:
            is_weak = verdict.log_odds < LEAST_LOG_ODDS and verdict.cause.key not in self.with_rivals
            return replace(verdict, verdict=SUSPECTED, reason=Reason.WEAK if is_weak else Reason.ALTERNATIVE)
        if is_unconfirmed(verdict):
            return replace(verdict, verdict=SUSPECTED, reason=Reason.UNCONFIRMED)
        return verdict


def outdone_causes(
    search: ForwardSearch[CauseT],
    searched: Searched[CauseT],
    verdicts: Sequence[Verdict[CauseT]],
    *,
    compares_courses: bool,
) -> tuple[set[str], dict[str, CourseRival]]:
    """Return the keys of accepted causes next to which, or in place of which, an effect without a name may act. Also
    return the random courses among these effects."""
    level = search.settings.dependence_level
    outdone = {step.cause.key for step in searched.kept if step.is_outdone or _is_incomplete(step, searched, level)}
    outdone |= names_of_one_effect(searched.kept, searched.rounds[-1], searched.final)
    if compares_courses:
        outdone |= _names_of_one_course(search, searched)
    rivals = _course_rivals(search, searched, outdone) if compares_courses else {}
    outdone |= _beside_refused(searched, verdicts)
    return outdone | rivals.keys() | _smaller(searched, rivals.keys()), rivals


def _is_incomplete(step: Accepted[CauseT], searched: Searched[CauseT], level: float) -> bool:
    """Return True if nonparametric rivals of an accepted cause still explain something next to it."""
    return searched.rounds[-1].p_value_of_rivals(step.rivals) <= level


def _names_of_one_course(search: ForwardSearch[CauseT], searched: Searched[CauseT]) -> set[str]:
    """Return the keys of accepted causes of one part that are together not clearly more probable than one random course
    of it: a zero that wanders passes for drifts and slips in single runs."""
    result: set[str] = set()
    named = [step for step in searched.kept if step.cause.catalogued]
    for part in {step.cause.affected_part for step in named}:
        of_part = [step for step in named if step.cause.affected_part == part]
        if len(of_part) < _FEWEST_OF_COURSE:
            continue
        keys = {step.cause.key for step in of_part}
        without = search.without_causes(searched, keys)
        sized = [(step.cause, step.candidate.signature.parameters) for step in of_part]
        priors = [_log_prior(step) for step in of_part]
        # Beforehand, the course is as probable as the most probable one of the names.
        lead = lead_over_one_course(searched.final, without, sized) + sum(priors) - max(priors)
        if lead < math.log(RIVAL_FACTOR):
            result |= keys
    return result


def _log_prior(step: Accepted[CauseT]) -> float:
    """Return the log prior probability of an accepted cause, with its subject and shape."""
    score = step.round.scores[step.candidate.key]
    return score.log_posterior - score.log_evidence


def _course_rivals(
    search: ForwardSearch[CauseT], searched: Searched[CauseT], outdone: set[str]
) -> dict[str, CourseRival]:
    """Return the random courses that compete with accepted causes, by their keys; none for the causes that clearly
    beat them."""
    result: dict[str, CourseRival] = {}
    for step in searched.kept:
        if step.cause.catalogued and step.cause.has_law and step.cause.key not in outdone:
            search.progress(f"random courses in place of {step.cause.id}")
            without = search.without_cause(searched, step.cause.key)
            size = step.candidate.signature.parameters
            rival = course_rival(searched.final, without, step.cause, size, step.choice)
            if rival is not None and not rival.is_clear:
                result[step.cause.key] = rival
    return result


def _beside_refused(searched: Searched[CauseT], verdicts: Sequence[Verdict[CauseT]]) -> set[str]:
    """Return the keys of accepted causes that act on the same data as a refused nonparametric effect. That effect is
    significant next to them, but predicts held-out epochs worse: something is there, in another form. If it is hardly
    more probable than no effect, nothing need be there."""
    worse = [verdict for verdict in searched.refused if verdict.reason is Reason.HELD_OUT]
    worse += [verdict for verdict in verdicts if verdict.verdict == SUSPECTED and verdict.reason is not Reason.WEAK]
    refused = [verdict.cause for verdict in worse if not verdict.cause.catalogued]
    named = searched.named()
    return {cause.key for cause in named if any(act_on_same(searched.final, cause, unnamed) for unnamed in refused)}


def _smaller(searched: Searched[CauseT], doubted: Collection[str]) -> set[str]:
    """Return the keys of accepted causes that are smaller than one of those ``doubted``: what a wrong name leaves
    may pass for another."""
    squares = {step.cause.key: step.round.scores[step.candidate.key].squares for step in searched.kept}
    largest = max((squares[key] for key in doubted), default=0.0)
    return {key for key, square in squares.items() if square < largest}


def of_larger_noise(
    steps: Mapping[str, Accepted[CauseT]], verdicts: Sequence[Verdict[CauseT]], ratio: float, level: float
) -> set[str]:
    """Return the keys of effects that are not significant at ``ratio`` times the declared noise.

    ``steps``: accepted effects by key. The search rescales the noise within limits only; beyond them, scatter of whole
    epochs looks like an effect of many amplitudes.
    """
    weak = set()
    for verdict in verdicts:
        if (step := steps.get(verdict.cause.key)) is None:
            continue
        null = step.round.null
        group = null.group_of(step.candidate.kind, step.candidate.signature.rank)
        squares = (verdict.signal_to_noise / max(ratio, 1.0)) ** 2
        if null.raw(squares, group, 1.0) > null.threshold(group, level):
            weak.add(verdict.cause.key)
    return weak
