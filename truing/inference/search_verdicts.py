"""Verdicts on the causes of a search: accepted, refuted by predictions, indistinguishable, and rejected ones."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Generic

import numpy as np

from truing.inference.accepted_cause import Accepted
from truing.inference.block_gain import gain_in_blocks
from truing.inference.choice import is_real, is_worth_reporting
from truing.inference.forward_search import ForwardSearch
from truing.inference.model import CauseT
from truing.inference.names_next_to_others import LEAST_PROBABILITY, NamesNextToOthers
from truing.inference.rounds import RIVAL_FACTOR, Round
from truing.inference.search_end import EndOfSearch
from truing.inference.search_result import Searched
from truing.inference.shape_uncertainty import shape_covariance_factors
from truing.inference.verdicts import (
    INDISTINGUISHABLE,
    REJECTED,
    SUSPECTED,
    Reason,
    Verdict,
    accepted,
    first_order,
    verdict_on_known_cause,
)

# Largest growth of the rms error with a finding, on fitted and on held-out epochs. It may grow slightly on fitted ones,
# since without the cause other parameters take improbable values.
_NO_MORE, _NO_WORSE = 1.002, 1.02
# Log odds over no effect below which an effect is not found.
LEAST_LOG_ODDS = float(np.log(LEAST_PROBABILITY / (1.0 - LEAST_PROBABILITY)))


@dataclass(frozen=True)
class SearchVerdicts(Generic[CauseT]):
    """Verdicts on the causes of a search, from its fits."""

    search: ForwardSearch[CauseT]

    def paying(
        self, searched: Searched[CauseT], kinds: Sequence[CauseT]
    ) -> tuple[Searched[CauseT], list[Verdict[CauseT]]]:
        """Return the search without the accepted causes that do not pay, and all verdicts. Those causes are suspected,
        and the final model does not hold them.

        At its acceptance a cause is compared without those that were accepted later. A cause that fails there is
        compared again, next to all others.
        """
        refuted: list[Verdict[CauseT]] = []
        compared = NamesNextToOthers(self.search, kinds)
        while True:
            searched = compared.compared(searched)
            accepted_keys = {step.cause.key for step in searched.kept}
            verdicts = [
                self._next_to_others(verdict, searched)
                if verdict.cause.key in accepted_keys and contradiction(verdict)
                else verdict
                for verdict in self.verdicts(searched, refuted)
            ]
            unpaid = [
                replace(verdict, verdict=SUSPECTED, reason=reason)
                for verdict in verdicts
                if verdict.cause.key in accepted_keys and (reason := _unpaid(verdict) or _weakness(verdict)) is not None
            ]
            if not unpaid:
                return searched, verdicts
            refuted.append(unpaid[-1])
            searched = self.search.without(searched, unpaid[-1].cause.key)

    def _next_to_others(self, verdict: Verdict[CauseT], searched: Searched[CauseT]) -> Verdict[CauseT]:
        """Return a verdict with the errors of the final model, and of the final model without the cause."""
        final = searched.final
        without = self.search.fitter.predicted(self.search.without_cause(searched, verdict.cause.key))
        held_out = (without.held_out, final.held_out)
        return replace(verdict, before=without.error, after=final.error, floor=final.floor, held_out=held_out)

    def verdicts(self, searched: Searched[CauseT], refuted: Sequence[Verdict[CauseT]] = ()) -> list[Verdict[CauseT]]:
        """Return one verdict per kind of cause, and one per further subject that was found. ``refuted``: verdicts on
        accepted causes that the final model no longer holds."""
        final, held_out = searched.final, self.search.fitter.held_out
        verdicts = [verdict_on_known_cause(cause, searched.plain, final, held_out) for cause in searched.given]
        for step in searched.kept:
            fits = step.before, step.after
            reported = accepted(step.round, step.candidate, step.cause, fits, final)
            size = step.candidate.signature.parameters
            spread = shape_covariance_factors(self.search.fitter, final, step.cause, size)
            blocks = self.search.fitter.blocks
            gain = gain_in_blocks(final, step.cause, size, blocks or ())
            covariance, probability = reported.covariance * spread, step.probability
            chosen = step.chosen
            reported = replace(reported, covariance=covariance, probability=probability, subjects=chosen.subjects)
            reported = replace(reported, inputs=chosen.inputs, quantities=chosen.quantities, onsets=step.onsets)
            verdicts.append(replace(reported, blocks_asked=blocks is not None, block_gain=gain))
        verdicts += refuted
        others = [*self._rivals(searched.kept), *searched.refused, *self._rejected(searched.rounds, searched.end)]
        for verdict in others:  # one row per kind of cause: its first verdict
            if verdict.cause.id not in {reported.cause.id for reported in verdicts}:
                verdicts.append(verdict)
        return verdicts

    def _rivals(self, accepted: Sequence[Accepted[CauseT]]) -> list[Verdict[CauseT]]:
        """Return verdicts on other kinds that explain a finding as well, so that the campaign cannot
        distinguish them."""
        result, held_out = [], self.search.fitter.held_out
        for step in accepted:
            for rival, lead in step.chosen.rivals:
                worth = is_worth_reporting(rival, lead) or step.probability < LEAST_PROBABILITY
                if rival.kind != step.candidate.kind and worth:
                    refitted = self.search.fitter.fitted(
                        (*step.round.fitted.causes, rival.cause.refined()), step.round.fitted
                    )
                    plain = first_order(step.round, rival, INDISTINGUISHABLE, held_out, Reason.RIVAL)
                    odds = step.round.posterior(step.candidate) + lead
                    result.append(replace(plain, with_it=refitted, log_odds=odds, rival=step.cause))
        return result

    def _rejected(self, rounds: Sequence[Round[CauseT]], end: EndOfSearch[CauseT]) -> list[Verdict[CauseT]]:
        """Return the verdicts on the best candidate of every kind that the final model does not hold. Their log odds
        are those of the first round, where they competed with the causes found."""
        closing, first, result = rounds[-1], rounds[0], []
        for kind, candidate in closing.best.items():
            before = first.best.get(kind)
            if candidate.signature.rank or before is None or not before.signature.rank:
                reason = Reason.CHANCE if candidate.signature.rank else Reason.UNSEEN
                if not end.is_complete and is_real(closing, candidate, self.search.settings.level):
                    reason = Reason.ENDED
                verdict = first_order(closing, candidate, REJECTED, self.search.fitter.held_out, reason)
            else:
                verdict = first_order(first, before, REJECTED, self.search.fitter.held_out, Reason.CONTAINED)
            result.append(verdict if before is None else replace(verdict, log_odds=first.posterior(before)))
        return result


def contradiction(verdict: Verdict[CauseT]) -> Reason | None:
    """Return the reason why predictions contradict a found cause, None where they do not: it does not pay, or blocks
    left out are less probable with the cause (``ELSEWHERE``)."""
    is_elsewhere_worse = verdict.block_gain is not None and verdict.block_gain.log_gain < -np.log(RIVAL_FACTOR)
    return _unpaid(verdict) or (Reason.ELSEWHERE if is_elsewhere_worse else None)


def is_unconfirmed(verdict: Verdict[CauseT]) -> bool:
    """Return True if blocks left out gain next to nothing from a cause, though an effect of its size would show."""
    gain = verdict.block_gain
    return gain is not None and gain.log_gain < float(np.log(RIVAL_FACTOR)) and gain.is_far_below


def _unpaid(verdict: Verdict[CauseT]) -> Reason | None:
    """Return the reason why a found cause does not pay, None where it does: predictions do not improve (``UNPAID``), or
    held-out epochs are predicted worse (``HELD_OUT``), and not by chance."""
    before, after = verdict.held_out
    held_out, is_chance = 1.0, True
    if before is not None and after is not None:
        held_out = after.growth_over(before)
        is_chance = after.log_odds_over(before) > -np.log(RIVAL_FACTOR)
    pays = verdict.signal_to_noise > 0.0 and verdict.after.growth_over(verdict.before) <= _NO_MORE
    if not pays and held_out > 1.0 / _NO_WORSE:  # an effect in held-out epochs alone lowers only their errors
        return Reason.UNPAID
    return Reason.HELD_OUT if held_out > _NO_WORSE and not is_chance else None


def _weakness(verdict: Verdict[CauseT]) -> Reason | None:
    """Return ``WEAK`` for an effect without a name that is hardly more probable than no effect; None for others. Chance
    offers so many of these that the final model does without."""
    is_weak = not verdict.cause.catalogued and verdict.log_odds < LEAST_LOG_ODDS
    return Reason.WEAK if is_weak else None
