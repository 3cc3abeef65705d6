"""Single large errors of one input, which depend on nothing that was recorded: its errors have heavy tails.

Such errors have no mean effect and no common size, so no cause with a name explains them. The
likelihood of Student's t attributes them to one input: it must be clearly larger than that of heavy tails of any other
input, of any channel, and of all observations of an epoch together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Generic

import numpy as np

from truing.inference.adequacy import p_value_of_order
from truing.inference.arrays import Array
from truing.inference.attribution import p_value_of_dependence
from truing.inference.fitted_model import FittedModel
from truing.inference.heavy_tails import HEAVY, log_odds_of_large, log_odds_of_tails
from truing.inference.model import CauseT, ScatterCandidate
from truing.inference.rounds import RIVAL_FACTOR

_LARGE = 4.0  # an error is large beyond this many times the typical one
_TYPICAL = 0.6745  # median of absolute normal deviates
_RANDOM = 0.01  # p-value of order and of a dependence above which errors are random


@dataclass(frozen=True)
class SingleErrors(Generic[CauseT]):
    """Large errors of one input: the candidate, their number, the largest over the typical one, and the p-value of
    normal errors, corrected for the inputs tried."""

    candidate: ScatterCandidate[CauseT]
    count: int
    ratio: float
    p_value: float


def single_errors(
    final: FittedModel[CauseT], candidates: Sequence[ScatterCandidate[CauseT]], factor: Array
) -> SingleErrors[CauseT] | None:
    """Return the single errors of one of the candidates' inputs; None where none has heavy tails of its own.

    Each candidate marks one input at all epochs. ``factor`` (B, H) or (1, 1): factors by which a scatter that was found
    widened the prior sigmas of inputs, which their errors are measured by.
    """
    tried = [(candidate, _errors(final, candidate, factor)) for candidate in candidates]
    seen = [(candidate, residuals) for candidate, residuals in tried if np.isfinite(residuals).any()]
    if not seen:
        return None
    candidates, errors = zip(*seen, strict=True)
    gains = np.array([log_odds_of_large(residuals**2, 1) for residuals in errors])
    best = int(np.argmax(gains))
    odds = log_odds_of_tails(errors[best] ** 2, 1)
    rivals = [*np.delete(gains, best), *_gains_of_observations(final)]
    if odds < HEAVY + np.log(len(candidates)) or gains[best] < max(rivals, default=0.0) + np.log(RIVAL_FACTOR):
        return None
    size = np.abs(errors[best])
    ratio = size / max(float(np.nanmedian(size)) / _TYPICAL, 1e-300)
    count = int(np.sum(ratio > _LARGE))
    if not count or not _is_random(final, candidates[best]):
        return None
    p_value = min(1.0, len(candidates) * float(np.exp(-odds)))
    return SingleErrors(candidates[best], count, float(np.nanmax(ratio)), p_value)


def _errors(final: FittedModel[CauseT], candidate: ScatterCandidate[CauseT], factor: Array) -> Array:
    """Return the errors (B,) of a candidate's input, standardised by its own noise."""
    place = int(np.argmax(candidate.own.any(0)))
    return np.asarray((final.input_residuals.standardised(candidate.own)[..., 0] * factor)[:, place])


def _gains_of_observations(final: FittedModel[CauseT]) -> list[float]:
    """Return the log odds of large errors of each channel's observations, and of all of an epoch together."""
    squares = np.sum(final.standardised**2, -1)
    size = final.measured.size
    known = np.isfinite(squares)
    count = known.sum(1)
    whole = np.where(known, squares, 0.0).sum(1) / np.maximum(count, 1) * max(int(np.median(count)), 1)
    together = log_odds_of_large(np.where(count > 0, whole, np.nan), size * max(int(np.median(count)), 1))
    return [*(log_odds_of_large(column, size) for column in squares.T), together]


def _is_random(final: FittedModel[CauseT], candidate: ScatterCandidate[CauseT]) -> bool:
    """Return True if the errors have no order in time or along an input, and depend on none."""
    residuals, inputs = final.input_residuals.standardised(candidate.own), candidate.own
    of_order = p_value_of_order(residuals, inputs, final)
    is_ordered = of_order is not None and of_order <= _RANDOM
    return not is_ordered and p_value_of_dependence(residuals, inputs, final) > _RANDOM
