"""Onsets between those that a search tries: the best candidate of every kind begins where it explains most.

A long campaign has too many onsets to try all of them with every cause. A cause tried at a wrong onset explains its
effect only in part. Another kind of cause with the right onset would then be preferred.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from truing.inference.fitted_model import FittedModel
from truing.inference.model import CauseT, Onsets
from truing.inference.scores import Score, parts_of
from truing.inference.search import CauseCandidate, Search, total_of
from truing.inference.search_candidates import admissible
from truing.inference.signatures import signatures_of

# Number of steps from one onset to the next; each step is divided anew.
_STEPS = 4
# Reduction of the sum of squares, in units of the noise, that 95 % of true onsets lose at most to the best one: the
# quantile of (1 - exp(-x / 2))^2, the distribution for a jump in white noise. Source: Yao, Annals of Statistics 15
# (1987) 1321. This many onsets in a row that lose more end the interval.
_LOSS, _IN_A_ROW = -2.0 * float(np.log(1.0 - np.sqrt(0.95))), 4
_MOST_IN_INTERVAL = 300  # onsets that are compared at most, of all possible ones


def at_best_onsets(
    search: Search[CauseT], scores: Sequence[Score], fitted: FittedModel[CauseT]
) -> list[CauseCandidate[CauseT]]:
    """Return the best candidate of every kind at its best onset, where the search tries only some onsets.

    Only candidates more probable than no effect are considered.
    """
    best: dict[str, tuple[float, CauseCandidate[CauseT]]] = {}
    for candidate, score in zip(search.candidates, scores, strict=True):
        if score.log_posterior > best.get(candidate.kind, (0.0, candidate))[0]:
            best[candidate.kind] = score.log_posterior, candidate
    known = {candidate.key for candidate in search.candidates}
    finer = [_at_best_onset(candidate, fitted, search) for _, candidate in best.values()]
    return [candidate for candidate in finer if candidate.key not in known]


def _at_best_onset(
    candidate: CauseCandidate[CauseT], fitted: FittedModel[CauseT], search: Search[CauseT]
) -> CauseCandidate[CauseT]:
    """Return a candidate at the onset, among those between the onsets tried, from which it explains most.

    Of the onsets up to the next one that was tried, a few are compared, then those near the best of them, and so on.
    """
    onsets = fitted.scene.onsets(candidate.cause)
    spacing, most = (1 if onsets is None else onsets.spacing), _squares(candidate, search)
    while onsets is not None and spacing > 1:
        step = max(1, spacing // _STEPS)
        moved = [onsets.moved(by) for by in range(step * ((1 - spacing) // step), spacing, step) if by]
        causes = admissible(fitted, [cause for cause in moved if cause is not None])
        effects = signatures_of(search.pathways, (fitted.partial_designs(cause) for cause in causes))
        for cause, effect in zip(causes, effects, strict=True):
            finer = replace(candidate, cause=cause, signature=effect)
            if (squares := _squares(finer, search)) > most:
                candidate, most = finer, squares
        onsets, spacing = fitted.scene.onsets(candidate.cause), step
    return candidate


def _squares(candidate: CauseCandidate[CauseT], search: Search[CauseT]) -> float:
    """Return the reduction of the sum of squares by a candidate."""
    return float(np.sum(parts_of(candidate.signature, search.pathways.residual) ** 2))


def onset_interval(
    candidate: CauseCandidate[CauseT], fitted: FittedModel[CauseT], search: Search[CauseT]
) -> tuple[CauseT, CauseT] | None:
    """Return a candidate's cause at its earliest and at its latest onset that the data do not exclude (95 %).

    None for causes without a free onset, and where only its own onset is left.
    """
    onsets = fitted.scene.onsets(candidate.cause)
    if onsets is None:
        return None
    total, freedom = total_of(fitted)
    least = _squares(candidate, search) - _LOSS * total / freedom
    step = 1 + len(onsets.epochs) // _MOST_IN_INTERVAL
    ends = [_last_possible(candidate, onsets, by, least, fitted, search) for by in (-step, step)]
    return None if ends[0].key == ends[1].key else (ends[0], ends[1])


def _last_possible(
    candidate: CauseCandidate[CauseT],
    onsets: Onsets[CauseT],
    step: int,
    least: float,
    fitted: FittedModel[CauseT],
    search: Search[CauseT],
) -> CauseT:
    """Return the cause at the last onset in the direction ``step`` of time that explains at least this many squares.

    If onsets between are skipped, the first one that explains less is its limit.
    """
    last, lost, by = 0, 0, step
    while lost < _IN_A_ROW and (cause := onsets.moved(by)) is not None:
        (effect,) = signatures_of(search.pathways, [fitted.partial_designs(cause)])
        is_possible = _squares(replace(candidate, cause=cause, signature=effect), search) >= least
        last, lost, by = (by, 0, by + step) if is_possible else (last, lost + 1, by + step)
    beyond = onsets.moved(last + step) if abs(step) > 1 else None
    return beyond or onsets.moved(last) or candidate.cause
