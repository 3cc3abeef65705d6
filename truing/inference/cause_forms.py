"""Forms of one cause: a plainer one that may take its place, and others that contest it or take its place later."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Generic

from truing.inference.accepted_cause import Accepted
from truing.inference.fitted_model import FittedModel
from truing.inference.fitter import Fitter
from truing.inference.model import CauseT
from truing.inference.rounds import Round
from truing.inference.search import CauseCandidate

# Least decrease of the squares by a cause that takes the place of a plainer one: chi-square, one degree, p = 2e-4; and
# by one that contests a plainer one, p = 0.01.
_PLAIN_GAIN, _CONTESTED_GAIN = 13.8, 6.6


@dataclass(frozen=True)
class CauseForms(Generic[CauseT]):
    """Comparison of the forms of a cause by their fits, next to ``given`` causes that are known before any search."""

    fitter: Fitter[CauseT]
    given: tuple[CauseT, ...]

    def plainer(
        self,
        candidate: CauseCandidate[CauseT],
        current: Round[CauseT],
        after: FittedModel[CauseT],
        *,
        is_distinct: bool,
    ) -> CauseCandidate[CauseT]:
        """Return the plainer candidate whose place a candidate takes, unless the candidate is distinct and fits clearly
        better, by the likelihood ratio of both fits; else the candidate itself."""
        wanted = (candidate.cause.plain_id, candidate.cause.subject)
        plain = next((c for c in current.candidates if (c.cause.id, c.cause.subject) == wanted), None)
        if plain is None:
            return candidate
        other = self.fitter.prepared((*current.fitted.causes, plain.cause.refined()), current.fitted)
        gain = _gain(other, after)
        return candidate if is_distinct and gain > _PLAIN_GAIN else plain

    def restated(
        self, found: Sequence[Accepted[CauseT]], current: FittedModel[CauseT], further: FittedModel[CauseT] | None
    ) -> list[Accepted[CauseT]] | None:
        """Return the accepted causes with another form of one of them, fitted again; None where each keeps its form.

        A cause that was accepted next to large missing ones may later be clearly distinct from its plain form. Another
        form has to fit clearly better than the plain one. It must not fit worse than the model with a ``further``
        cause, which would be a consequence of the wrong form.
        """
        for at, step in enumerate(found):
            others = [other.cause for k, other in enumerate(found) if k != at]
            for form in other_forms(step.candidate, step.round):
                cause = form.cause.refined()
                after = self.fitter.prepared((*self.given, *others, cause), current)
                gain, is_distinct = _gain(current, after), cause.is_distinct(*after.values(cause))
                if is_distinct and gain > _PLAIN_GAIN and (further is None or _squares(after) <= _squares(further)):
                    chosen = replace(step.chosen, candidate=form)
                    changed = replace(step, chosen=chosen, cause=cause, is_contested=False)
                    return self.fitted_in_turn([*found[:at], changed, *found[at + 1 :]])
        return None

    def is_contested(
        self, candidate: CauseCandidate[CauseT], current: Round[CauseT], after: FittedModel[CauseT]
    ) -> bool:
        """Return True if other forms of an accepted cause, with distinct values, fit better than chance allows.

        Two of them are asked for: forms that start from several units may end at one factor, and fits differ by noise.
        """
        forms, better = other_forms(candidate, current), 0
        for form in forms:
            cause = form.cause.refined()
            other = self.fitter.prepared((*current.fitted.causes, cause), current.fitted)
            better += _gain(after, other) > _CONTESTED_GAIN and cause.is_distinct(*other.values(cause))
        return better >= min(2, len(forms)) > 0

    def fitted_in_turn(self, steps: Sequence[Accepted[CauseT]]) -> list[Accepted[CauseT]]:
        """Return accepted causes with the models of a search that accepts them in this order."""
        after = steps[0].before
        fitted: list[Accepted[CauseT]] = []
        for step in steps:
            causes = (*self.given, *(other.cause for other in fitted), step.cause)
            before, after = after, self.fitter.prepared(causes, after)
            fitted.append(replace(step, before=before, after=after))
        return fitted


def other_forms(candidate: CauseCandidate[CauseT], current: Round[CauseT]) -> list[CauseCandidate[CauseT]]:
    """Return the candidates that a plain cause may have to give its place to, the most probable first."""
    wanted = (candidate.cause.id, candidate.cause.subject)
    forms = [c for c in current.candidates if (c.cause.plain_id, c.cause.subject) == wanted]
    return sorted(forms, key=current.posterior, reverse=True)


def _gain(plain: FittedModel[CauseT], other: FittedModel[CauseT]) -> float:
    """Return the decrease of the squares by another model, over its noise."""
    return (_squares(plain) - _squares(other)) / other.noise_ratio**2


def _squares(fitted: FittedModel[CauseT]) -> float:
    """Return the sum of squares of a model's residuals of observations and inputs, over the noise of its fit."""
    return float(fitted.noise.observed_total + fitted.noise.inputs_total)
