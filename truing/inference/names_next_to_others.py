"""Doubtful names compared again next to all other accepted causes: their probabilities, and rivals in their place.

At its acceptance, a cause is compared with its rivals in a model that lacks the causes accepted later.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Generic

import numpy as np

from truing.inference.accepted_cause import Accepted
from truing.inference.choice import CandidateChoice, choose, chosen_again
from truing.inference.forward_search import ForwardSearch
from truing.inference.model import CauseT
from truing.inference.prediction import predicts_worse
from truing.inference.rounds import RIVAL_FACTOR, Round, explains_the_same
from truing.inference.search_result import Searched

# Probability from which on a name is found, among all that explain the same.
LEAST_PROBABILITY = 0.9
# Whitened residuals up to which a doubtful name is compared again: beyond, two rounds would take too much memory.
_MOST_COMPARED = 20_000


@dataclass(frozen=True)
class NamesNextToOthers(Generic[CauseT]):
    """Comparison of doubtful names of a search, by its fits of candidates of these ``kinds`` of cause."""

    search: ForwardSearch[CauseT]
    kinds: Sequence[CauseT]
    exchanged: set[str] = field(default_factory=set)  # keys of names that gave their place to a rival

    def compared(self, searched: Searched[CauseT]) -> Searched[CauseT]:
        """Return the search with doubtful names, and those with rivals, compared next to all other accepted causes.

        A name that a rival clearly beats there gives its place to that rival, and the search goes on.
        """
        kept = list(searched.kept)
        for at, step in enumerate(kept):
            is_last = at == len(kept) - 1 and not self.exchanged  # it was compared next to all others
            if is_last or not step.cause.catalogued or not _has_rivals(step):
                continue
            round_without = self._round_without(step, searched)
            if round_without is None:
                continue
            if exchanged := self._exchanged(step, round_without, searched):
                return self.compared(exchanged)
            kept[at] = self._compared_again(step, round_without, searched)
        is_same = all(new is old for new, old in zip(kept, searched.kept, strict=True))
        return searched if is_same else replace(searched, kept=kept)

    def _round_without(self, step: Accepted[CauseT], searched: Searched[CauseT]) -> Round[CauseT] | None:
        """Return the round of candidates next to all other causes, None where it would take too much memory."""
        without = self.search.without_cause(searched, step.cause.key)
        if len(without.fit.whitened.residual) > _MOST_COMPARED:
            return None
        return self.search.scored(without, self.kinds, len(searched.rounds))

    def _exchanged(
        self, step: Accepted[CauseT], compared: Round[CauseT], searched: Searched[CauseT]
    ) -> Searched[CauseT] | None:
        """Return the search with a rival in the place of a name; None where none is clearly more probable."""
        chosen = self._clear_rival(step, compared, searched)
        if chosen is None:
            return None
        chosen, cause, after = self.search.fitted_form(chosen, compared)
        if predicts_worse(searched.final.held_out, after.held_out, self.search.covered(cause, after)):
            return None
        self.exchanged.add(step.candidate.key)
        accepted = self.search.accepted(chosen, cause, compared, after).light(compared.closed())
        steps = [accepted if other is step else other for other in searched.kept]
        return self.search.continued(searched, self.kinds, steps)

    def _clear_rival(
        self, step: Accepted[CauseT], compared: Round[CauseT], searched: Searched[CauseT]
    ) -> CandidateChoice[CauseT] | None:
        """Return the choice of another name that is clearly more probable than a name and explains the same."""
        chosen = choose(compared, self._refused(searched), self.search.settings.level, pairs=False)
        if chosen is None or not chosen.candidate.cause.catalogued or chosen.candidate.key in self.exchanged:
            return None
        name = next((c for c in compared.candidates if c.key == step.candidate.key), None)
        own = 0.0 if name is None else compared.posterior(name)
        is_clear = compared.posterior(chosen.candidate) > own + float(np.log(RIVAL_FACTOR))
        last = searched.rounds[-1]
        same = explains_the_same(compared.scores[chosen.candidate.key], last.scores.get(chosen.candidate.key))
        return chosen if is_clear and same else None

    def _compared_again(
        self, step: Accepted[CauseT], compared: Round[CauseT], searched: Searched[CauseT]
    ) -> Accepted[CauseT]:
        """Return an accepted cause with its probability and its rivals in the round next to all other causes."""
        name = next((c for c in compared.candidates if c.key == step.candidate.key), None)
        if name is None:
            return step
        refused = self._refused(searched)
        chosen = chosen_again(compared, name, refused, self.search.settings.level)
        again = self.search.accepted(chosen, step.cause, compared, searched.final, refused).light(compared.closed())
        probability = again.round.probability_of_name(name, searched.rounds[-1])
        return replace(again, before=step.before, after=step.after, probability=probability)

    @staticmethod
    def _refused(searched: Searched[CauseT]) -> set[str]:
        return {verdict.cause.id for verdict in searched.refused}


def _has_rivals(step: Accepted[CauseT]) -> bool:
    """Return True if a name is doubtful, or a cause of another kind explains the data nearly as well."""
    rivals = (rival for rival, _ in step.chosen.rivals if rival.cause.catalogued)
    return step.probability < LEAST_PROBABILITY or any(rival.kind != step.candidate.kind for rival in rivals)
