"""Class `Accepted`: a cause that a search accepted, with the choice and the models around it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Generic

from truing.inference.choice import CandidateChoice
from truing.inference.fitted_model import FittedModel
from truing.inference.model import CauseT
from truing.inference.rounds import Round
from truing.inference.search import CauseCandidate


@dataclass(frozen=True)
class Accepted(Generic[CauseT]):
    """An accepted cause: the choice, its round, and the models without it and with it."""

    chosen: CandidateChoice[CauseT]
    round: Round[CauseT]
    cause: CauseT  # in the form that was fitted
    before: FittedModel[CauseT]  # the model without it
    after: FittedModel[CauseT]
    is_outdone: bool  # a nonparametric effect was more probable, but was refused
    choice: float  # evidence averaged over its shapes on its subject, relative to its own
    probability: float  # of its kind among all that explain the same
    rivals: frozenset[str]  # keys of nonparametric effects that explain much of what it explains
    onsets: tuple[CauseT, CauseT] | None = None  # the cause at its earliest and latest possible onset
    is_contested: bool = False  # another form of it fits better, though not clearly

    @property
    def candidate(self) -> CauseCandidate[CauseT]:
        """Candidate that was accepted."""
        return self.chosen.candidate

    def light(self, closed: Round[CauseT]) -> Accepted[CauseT]:
        """Return the accepted cause with its round ``closed`` and without designs, which only a search needs."""
        return replace(self, chosen=self.chosen.light(), round=closed)
