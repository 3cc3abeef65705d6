"""Other shapes of an accepted cause, alone or next to a further cause: they may explain far more than it does.

At few positions of an axis, a wave of a wrong period passes for a scale error and a wave of the right one. Before the
other causes are found, the right one is no better than hundreds of others; next to them, a fit tells.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Generic

import numpy as np

from truing.inference.fitted_model import FittedModel
from truing.inference.fitter import Fitter
from truing.inference.model import CauseT
from truing.inference.rounds import RIVAL_FACTOR, Round
from truing.inference.search import CauseCandidate

# Shapes that are fitted, alone and next to each further cause: the linear evidence is that of a grid of shapes.
_FITTED = 12
_LEAST = 1e-300


@dataclass(frozen=True)
class OtherShape(Generic[CauseT]):
    """A cause in another shape, and a further cause next to it if there is one, as candidates of a round without
    both."""

    shape: CauseCandidate[CauseT]
    partner: CauseCandidate[CauseT] | None = None

    @property
    def candidates(self) -> tuple[CauseCandidate[CauseT], ...]:
        """Both candidates, the further cause first."""
        return (self.shape,) if self.partner is None else (self.partner, self.shape)


def other_shape(
    fitter: Fitter[CauseT],
    current: FittedModel[CauseT],
    without: Round[CauseT],
    cause: CauseT,
    others: Sequence[CauseT],
) -> OtherShape[CauseT] | None:
    """Return the shape of a cause that explains clearly more than the ``current`` model, alone or next to a further
    cause; None if none does.

    ``without``: round after the ``others`` alone, without the ``cause`` whose shape is asked.
    """
    best: tuple[float, OtherShape[CauseT] | None] = (0.0, None)
    for tried in _tried(without, cause):
        causes = (*others, *(candidate.cause.refined() for candidate in tried.candidates))
        lead = _log_odds(fitter.comparable(causes, current), current)
        best = max(best, (lead, tried), key=lambda one: one[0])
    return best[1]


def _tried(without: Round[CauseT], cause: CauseT) -> Iterator[OtherShape[CauseT]]:
    """Yield the shapes that are fitted, the most probable ones alone and next to each further cause."""
    assert without.search is not None
    pathways, like = without.search.pathways, (cause.id, cause.subject)
    shapes = [c for c in without.candidates if (c.cause.id, c.cause.subject) == like and c.signature.rank]
    yield from (OtherShape(shapes[k]) for k in _best([without.posterior(shape) for shape in shapes]))
    for partner in without.best.values():
        if partner.cause.id != cause.id and partner.cause.catalogued and without.posterior(partner) > 0.0:
            evidence = [without.pair_evidence(pathways, partner, shape) for shape in shapes]
            yield from (OtherShape(shapes[k], partner) for k in _best(evidence))


def _best(evidence: Sequence[float]) -> list[int]:
    return [int(k) for k in np.argsort(evidence)[: -_FITTED - 1 : -1]]


def _log_odds(other: FittedModel[CauseT], current: FittedModel[CauseT]) -> float:
    """Return the log likelihood ratio of another model at a free noise level, less the limit of a clear lead.

    Further parameters have the penalty of Schwarz (Ann. Statist. 6 (1978) 461). Both models have the same observations.
    """
    count = float(np.sum(current.measured.is_observed))
    squares = [max(float(np.sum(one.fit.whitened.rest**2)), _LEAST) for one in (current, other)]
    further = len(other.fit.shared) - len(current.fit.shared)
    gained = 0.5 * count * float(np.log(squares[0] / squares[1]))
    return gained - 0.5 * further * float(np.log(count)) - float(np.log(RIVAL_FACTOR))
