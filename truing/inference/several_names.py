"""Several accepted names for what may be a single effect without a name."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import combinations
from typing import TypeAlias

import numpy as np

from truing.inference.arrays import Array
from truing.inference.model import CauseT
from truing.inference.rounds import RIVAL_FACTOR, Round
from truing.inference.search import CauseCandidate

# p-value above which two steps cancel, and least signal-to-noise of each.
_CANCEL, _CLEAR_STEP = 0.01, 8.0
# An accepted cause, its candidate, and the round that accepted it.
AcceptedCause: TypeAlias = tuple[CauseT, CauseCandidate[CauseT], Round[CauseT]]


def several_for_one(
    accepted: Sequence[AcceptedCause[CauseT]],
    last: Round[CauseT],
    move_alike: Callable[[CauseT, CauseT], bool],
) -> set[str]:
    """Return the keys of accepted causes of one part that may be a single effect without a name.

    Together they are not clearly more probable than one nonparametric effect of the part, among the candidates of the
    ``last`` round. Or they are of one kind and subject and ``move_alike``: a course has several steps. Not so where the
    machine sets their shapes, such as the periods of a turn.
    """
    named = [entry for entry in accepted if entry[0].catalogued]
    result: set[str] = set()
    for first, second in combinations([cause for cause, _, _ in named], 2):
        is_one_kind = (first.subject, first.id) == (second.subject, second.id)
        if is_one_kind and not (first.has_set_shape and second.has_set_shape) and move_alike(first, second):
            result |= {first.key, second.key}
    for part in {cause.affected_part for cause, _, _ in named}:
        of_part = [entry for entry in named if entry[0].affected_part == part]
        if len(of_part) > 1 and _odds_of_one(of_part, last) > -np.log(RIVAL_FACTOR):
            result |= {cause.key for cause, _, _ in of_part}
    return result


def cancel(first: tuple[Array, Array], second: tuple[Array, Array]) -> bool:
    """Return True if two clear effects, each with values (P,) and covariance (P, P), cancel where both act: something
    was displaced and put back. The steps of a course do not return to its start in every component."""
    from scipy.special import chdtrc

    if len(first[0]) != len(second[0]) or min(_squares(*first), _squares(*second)) < _CLEAR_STEP**2:
        return False
    return bool(chdtrc(len(first[0]), _squares(first[0] + second[0], first[1] + second[1])) > _CANCEL)


def _squares(values: Array, covariance: Array) -> float:
    return float(values @ np.linalg.solve(covariance, values))


def _odds_of_one(accepted: Sequence[AcceptedCause[CauseT]], last: Round[CauseT]) -> float:
    """Return the log odds of the best nonparametric effect of a part against its accepted causes together.

    Both are against the model before the first of them; by the chain rule the odds of the causes multiply.
    """
    part, before = accepted[0][0].affected_part, accepted[0][2].scores
    unnamed = [
        candidate for candidate in last.candidates if not candidate.cause.catalogued and candidate.cause.subject == part
    ]
    best = max(
        (before[candidate.key].log_posterior for candidate in unnamed if candidate.key in before), default=-np.inf
    )
    return float(best - sum(last_scores.posterior(candidate) for _, candidate, last_scores in accepted))
