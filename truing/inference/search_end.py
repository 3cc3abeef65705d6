"""Reasons why a search stops: nothing real is left, or it reached a limit because the machine fits no known cause."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Generic

from truing.inference.arrays import Mask
from truing.inference.fitted_model import FittedModel
from truing.inference.model import CauseT
from truing.inference.prediction import predicts_worse
from truing.inference.rounds import Round

# A machine that needs more causes hardly fits the catalogue. From this number on, a cause must also predict held-out
# epochs significantly better, and the names of all are doubted.
MANY_CAUSES = 8
# Most nonparametric effects. More would only describe residuals piece by piece.
MOST_UNNAMED = 3
# Most events of one kind and subject: causes with an onset, such as jumps of a tool. More would only describe residuals
# period by period.
MOST_EVENTS = 2
# Most operations of the fits of further causes, in rows times squared unknowns: a few minutes for the largest
# campaigns. A limit on the clock would give different results on different computers.
MOST_OPERATIONS = 3e10


class SearchEnd(StrEnum):
    """Reason why a search stopped."""

    COMPLETE = "complete"  # no remaining candidate is significant
    MOST_CAUSES = "most-causes"  # MANY_CAUSES or more were accepted, and no other one is known to predict better
    UNNAMED_EFFECTS = "unnamed-effects"  # MOST_UNNAMED were accepted, and another candidate is significant
    EVENTS = "events"  # MOST_EVENTS of a part were accepted, and the next candidate is one more
    REFUSED = "refused"  # the remaining significant candidates predict held-out epochs worse
    TIME = "time"  # further causes would take too long, and another candidate is significant


@dataclass(frozen=True)
class EndOfSearch(Generic[CauseT]):
    """The reason why a search stopped, the number of accepted causes, the next candidate, and the least p-value left.

    ``left`` is None where no remaining candidate is significant. Candidates that have no plausible size do not count.
    """

    end: SearchEnd
    accepted: int
    left: CauseT | None
    p_value: float

    @property
    def is_complete(self) -> bool:
        """True if no significant candidate is left."""
        return self.end is SearchEnd.COMPLETE


@dataclass
class FurtherCauses(Generic[CauseT]):
    """Causes beyond the usual number: kinds that do not pay, and the operations that all their fits took."""

    unpaid: set[str] = field(default_factory=set)
    operations: float = 0.0

    def pays(self, before: FittedModel[CauseT], after: FittedModel[CauseT], covered: Mask) -> bool:
        """Return True if a further cause predicts held-out epochs significantly better; count its fit."""
        self.operations += len(after.fit.whitened.residual) * len(after.fit.shared) ** 2
        return predicts_worse(after.held_out, before.held_out, covered)

    def limit(
        self, accepted: Sequence[CauseT], current: FittedModel[CauseT], chosen: CauseT | None
    ) -> SearchEnd | None:
        """Return the limit that the accepted causes have reached, None where the chosen one may be accepted."""
        if sum(not cause.catalogued for cause in accepted) >= MOST_UNNAMED:
            return SearchEnd.UNNAMED_EFFECTS
        if chosen is not None and not chosen.recurs and _is_event(chosen, current):
            same = [cause for cause in accepted if (cause.id, cause.subject) == (chosen.id, chosen.subject)]
            if sum(_is_event(cause, current) for cause in same) >= MOST_EVENTS:
                return SearchEnd.EVENTS
        if len(accepted) < MANY_CAUSES:
            return None
        if current.held_out is None:
            return SearchEnd.MOST_CAUSES
        return SearchEnd.TIME if self.operations >= MOST_OPERATIONS else None

    def end(
        self, limit: SearchEnd | None, accepted: int, closing: Round[CauseT], left: CauseT | None
    ) -> EndOfSearch[CauseT]:
        """Return the end of a search in its closing round.

        ``left`` is the candidate that it would have accepted next, or one that is significant but does not pay.
        """
        plausible = (
            best_candidate
            for best_candidate in closing.best.values()
            if closing.scores[best_candidate.key].log_evidence > 0.0
        )
        least = min(map(closing.p_value, plausible), default=1.0)
        if left is None:
            limit = SearchEnd.MOST_CAUSES if accepted > MANY_CAUSES else SearchEnd.COMPLETE
        return EndOfSearch(limit or SearchEnd.MOST_CAUSES, accepted, left, least)


def _is_event(cause: CauseT, current: FittedModel[CauseT]) -> bool:
    """Return True if a cause begins at an onset that the search chooses, as jumps do and waves do not."""
    return current.scene.onsets(cause) is not None
