"""Search for the intended readings: every description with every slip of columns and rows, scored by its evidence."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import chain

import numpy as np

from truing.arrays import Array
from truing.belonging.reading_hypotheses import (
    Description,
    MeasuredMotion,
    RecordingHypothesis,
    best_recording,
    descriptions,
    finite_required_readings,
    joint_descriptions,
)
from truing.belonging.reading_row_slips import MOVED, ReadingNames
from truing.belonging.relation import RecordSlip
from truing.belonging.slips_in_rows import RowOrder, best_order

_AS_LIKELY = 10.0  # log evidence within which two explanations are indistinguishable
APART = 0.5  # misfit over the required movement that no error of the geometry explains
CLEAR = 50.0  # log evidence by which a slip must win
_HALVES = 0.5  # largest share of the misfit that may remain after a slip is undone
_MOST_POSES = 240  # most poses for hypotheses about columns and the description; rows are tested in all poses


@dataclass(frozen=True)
class SlipSearch:
    """Readings as recorded, as most likely intended (in all poses), the order of rows, and the number of hypotheses
    tried."""

    plain: RecordingHypothesis
    intended: RecordingHypothesis
    order: RowOrder
    tried: int
    rivals: tuple[RecordingHypothesis, ...]


def search_slips(motion: MeasuredMotion, *, of_joints: bool = False) -> SlipSearch:
    """Return the result for the mechanism as described and its slips; ``of_joints``: also those of few joints."""
    step = -(-len(motion.p) // _MOST_POSES)
    thin, tried = motion.every_nth(step), 0
    scored: list[tuple[RecordingHypothesis, Description]] = []
    plain = None
    for description in chain(descriptions(motion), joint_descriptions(motion) if of_joints else ()):
        hypothesis, intended, count = best_recording(thin, description.every_nth(step), exchanged=False)
        plain = plain or hypothesis
        scored.append((intended, description))
        tried += count
    assert plain is not None  # the description as recorded is always among them
    ahead = max(scored, key=lambda scored_row: scored_row[0].evidence)
    for description in {id(description_of): description_of for description_of in (scored[0][1], ahead[1])}.values():
        _, intended, count = best_recording(thin, description.every_nth(step), exchanged=True)
        scored.append((intended, description))
        tried += count
    best, description = max(scored, key=lambda pair: pair[0].evidence)
    if not _explains_enough(plain, best, motion.noise):
        best, description = plain, scored[0][1]
    near = [_score_all_rows(motion, one, about) for one, about in scored if best.evidence - one.evidence < _AS_LIKELY]
    intended = _score_all_rows(motion, best, description)
    required = finite_required_readings(description)
    return SlipSearch(
        plain, intended, best_order(intended.misfit + required, required, motion.noise), tried, tuple(near)
    )


def likely_recordings(search: SlipSearch) -> list[RecordingHypothesis]:
    """Return possible intended readings in some rows, the most likely first. The rest of the table decides between
    them, because it determines the geometry far better than tolerances do."""
    least = search.plain.evidence + _AS_LIKELY
    likely = [one for one in (search.intended, *search.rivals) if one.evidence > least and not one.description.slips]
    return sorted(likely, key=lambda hypothesis: -hypothesis.evidence)


def _score_all_rows(
    motion: MeasuredMotion, hypothesis: RecordingHypothesis, description: Description
) -> RecordingHypothesis:
    """Return a hypothesis that was chosen on some of the poses, for all of them."""
    required = finite_required_readings(description)
    return replace(
        hypothesis, description=description, misfit=hypothesis.readings(motion.readings, required) - required
    )


def _explains_enough(plain: RecordingHypothesis, best: RecordingHypothesis, noise: float) -> bool:
    """Return True if slips explain more than all physical effects of the catalogue, and at least halve the misfit."""
    if best.evidence - plain.evidence <= CLEAR:
        return False
    before, after = misfit_before_after(plain.misfit, best.misfit, noise)
    required = finite_required_readings(best.description)
    left, moved = (rms(values - values.mean(axis=0)) for values in (best.misfit, required))
    return before > MOVED * noise and after <= _HALVES * before and left <= APART * moved


def misfit_before_after(before: Array, after: Array, noise: float) -> tuple[float, float]:
    """Return the rms misfit, m, before and after slips are undone: about the mean of each leg if it is clear and
    halved, or else in total, as where lengths are wrong."""
    pairs = [(rms(values - values.mean(axis=0)), rms(values)) for values in (before, after)]
    about, without_mean = zip(*pairs, strict=True)
    return about if about[1] <= _HALVES * about[0] and about[0] > MOVED * noise else without_mean


def rival_slips(
    search: SlipSearch, names: ReadingNames, motion: MeasuredMotion, slips: tuple[RecordSlip, ...]
) -> tuple[RecordSlip, ...]:
    """Return single slips that explain the data as well as the chosen ones."""
    if not search.intended.slips(names.columns, motion.readings):  # an order of rows alone: no description explains it
        return ()
    record_slips = [rival.slips(names.columns, motion.readings) for rival in search.rivals]
    return tuple(
        dict.fromkeys(
            slips_of_rival[0]
            for slips_of_rival in record_slips
            if len(slips_of_rival) == 1 and slips_of_rival[0] not in slips
        )
    )


def misfit_in_order(hypothesis: RecordingHypothesis, order: RowOrder) -> Array:
    """Return the misfit with columns and rows in their right places."""
    required = finite_required_readings(hypothesis.description)
    is_placed = order.rows >= 0
    return np.asarray((hypothesis.misfit + required)[order.rows[is_placed]] - required[is_placed])


def rms(values: Array) -> float:
    """Return the root mean square of values (...)."""
    return float(np.sqrt(np.mean(values**2)))
