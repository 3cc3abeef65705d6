"""Whether a search came to its end, or was ended since the machine is none that it knows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Generic

from truing.inference.model import CauseT
from truing.inference.rounds import Round

# A machine with more causes than the first, or more effects without a name than the second, is none that the catalogue
# knows: further ones would describe what is left piece by piece, and explain nothing.
MOST_CAUSES, MOST_UNNAMED = 8, 3


class SearchEnd(StrEnum):
    """Why a search stopped."""

    COMPLETE = "complete"  # nothing that is left is real
    MOST_CAUSES = "most-causes"  # so many causes were accepted, and more is real
    UNNAMED_EFFECTS = "unnamed-effects"  # so many effects without a name were accepted, and more is real


@dataclass(frozen=True)
class EndOfSearch(Generic[CauseT]):
    """Why a search stopped, after how many accepted causes; what would come next, None where nothing is real, and the
    least p-value of any candidate left."""

    end: SearchEnd
    accepted: int
    left: CauseT | None
    p_value: float

    @property
    def is_complete(self) -> bool:
        """Whether nothing real is left."""
        return self.end is SearchEnd.COMPLETE


def limit_reached(accepted: Sequence[CauseT]) -> SearchEnd | None:
    """Return the limit that accepted causes have reached, None where a further one may be accepted."""
    if sum(not cause.catalogued for cause in accepted) >= MOST_UNNAMED:
        return SearchEnd.UNNAMED_EFFECTS
    return SearchEnd.MOST_CAUSES if len(accepted) >= MOST_CAUSES else None


def end_of_search(
    limit: SearchEnd | None, accepted: Sequence[CauseT], closing: Round[CauseT], left: CauseT | None
) -> EndOfSearch[CauseT]:
    """Return how a search stopped in its last round, with a cause ``left`` that it would have accepted next."""
    least = min((closing.p_value(candidate) for candidate in closing.best.values()), default=1.0)
    return EndOfSearch(SearchEnd.COMPLETE if left is None or limit is None else limit, len(accepted), left, least)
