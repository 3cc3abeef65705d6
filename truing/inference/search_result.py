"""Result of one forward search, and doubts among its accepted causes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Generic

from truing.inference.accepted_cause import Accepted
from truing.inference.fitted_model import FittedModel
from truing.inference.free_course import move_alike
from truing.inference.model import CauseT
from truing.inference.rounds import Round
from truing.inference.search import Search
from truing.inference.search_end import EndOfSearch
from truing.inference.several_names import cancel, several_for_one
from truing.inference.verdicts import Verdict


@dataclass(frozen=True)
class Searched(Generic[CauseT]):
    """Result of one search from the plain model on; ``given`` are the known causes that the final model holds."""

    given: tuple[CauseT, ...]
    plain: FittedModel[CauseT]
    kept: list[Accepted[CauseT]]
    refused: list[Verdict[CauseT]]  # they predict worse, or the others explain their effect
    rounds: list[Round[CauseT]]
    final: FittedModel[CauseT]
    end: EndOfSearch[CauseT]

    @property
    def search(self) -> Search[CauseT]:
        """Search of the last round, the only one that is not closed."""
        result = self.rounds[-1].search
        assert result is not None
        return result

    def named(self) -> list[CauseT]:
        """Return the accepted causes that the catalogue names."""
        return [step.cause for step in self.kept if step.cause.catalogued]


def names_of_one_effect(steps: Sequence[Accepted[CauseT]], last: Round[CauseT], final: FittedModel[CauseT]) -> set[str]:
    """Return the keys of accepted causes that may be a single effect without a name; ``last`` is the round after them,
    ``final`` the model with all of them."""
    sizes = {step.cause.key: step.candidate.signature.parameters for step in steps}

    def alike(first: CauseT, second: CauseT) -> bool:
        if cancel(final.values(first), final.values(second)):
            return False
        return move_alike(final, (first, sizes[first.key]), (second, sizes[second.key]))

    return several_for_one([(step.cause, step.candidate, step.round) for step in steps], last, alike)


def contested_causes(steps: Sequence[Accepted[CauseT]]) -> set[str]:
    """Return the keys of accepted causes that other forms contest, or that were accepted after one of these: they may
    be its consequences. Causes that contradict what others assume contest these, and the others."""
    first = next((at for at, step in enumerate(steps) if step.is_contested), len(steps))
    contested = {step.cause.key for step in steps[first:] if step.cause.catalogued}
    denied = {step.cause.denies for step in steps} - {""}
    if denied & {step.cause.assumes for step in steps}:
        contested |= {step.cause.key for step in steps if {step.cause.assumes, step.cause.denies} & denied}
    return contested
