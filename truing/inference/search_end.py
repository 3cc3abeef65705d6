"""Reasons why a search stops: nothing real is left, or it reached a limit because the machine fits no known cause."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Generic

from truing.inference.model import CauseT
from truing.inference.rounds import Round

# Most accepted causes, and most nonparametric effects among them. A machine that needs more does not fit the catalogue:
# more causes would only describe its residuals piece by piece.
MOST_CAUSES, MOST_UNNAMED = 8, 3


class SearchEnd(StrEnum):
    """Reason why a search stopped."""

    COMPLETE = "complete"  # no remaining candidate is significant
    MOST_CAUSES = "most-causes"  # MOST_CAUSES were accepted, and another candidate is significant
    UNNAMED_EFFECTS = "unnamed-effects"  # MOST_UNNAMED were accepted, and another candidate is significant


@dataclass(frozen=True)
class EndOfSearch(Generic[CauseT]):
    """The reason why a search stopped, the number of accepted causes, the next candidate, and the least p-value left.

    ``left`` is None where no remaining candidate is significant.
    """

    end: SearchEnd
    accepted: int
    left: CauseT | None
    p_value: float

    @property
    def is_complete(self) -> bool:
        """True if no significant candidate is left."""
        return self.end is SearchEnd.COMPLETE


def limit_reached(accepted: Sequence[CauseT]) -> SearchEnd | None:
    """Return the limit that the accepted causes have reached, None where another one may be accepted."""
    if sum(not cause.catalogued for cause in accepted) >= MOST_UNNAMED:
        return SearchEnd.UNNAMED_EFFECTS
    return SearchEnd.MOST_CAUSES if len(accepted) >= MOST_CAUSES else None


def end_of_search(
    limit: SearchEnd | None, accepted: Sequence[CauseT], closing: Round[CauseT], left: CauseT | None
) -> EndOfSearch[CauseT]:
    """Return the end of a search in its closing round; ``left`` is the candidate it would have accepted next."""
    least = min((closing.p_value(candidate) for candidate in closing.best.values()), default=1.0)
    return EndOfSearch(SearchEnd.COMPLETE if left is None or limit is None else limit, len(accepted), left, least)
