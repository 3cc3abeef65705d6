"""Inputs that predict the residuals of a machine which no model of causes explains as a whole.

The residuals of each channel, and courses of the groups in space, are asked in turn on which set of inputs they
depend. What a model with causes explains no longer hides the rest, so the residuals of several models are asked.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from truing.inference.arrays import Array, Mask
from truing.inference.campaign_inputs import column_of, columns_of, in_time_of, time_columns
from truing.inference.fitted_model import FittedModel
from truing.inference.input_sets import p_value_of_sets, sets_of_inputs
from truing.inference.input_spectra import Spectra
from truing.inference.model import CauseT
from truing.inference.part_dependences import Part, depends, part_dependences
from truing.inference.part_errors import part_problem
from truing.inference.residual_courses import FEWEST_EPOCHS, residuals_of
from truing.inference.search import LEAST_P

_FEWEST_OF_PLACE = 12
_LEAST_SHARE = 1e-6  # of the squares; an input with a smaller share is not named
_LEAST_SQUARES = 1e-300


@dataclass(frozen=True)
class Attributed:
    """Inputs that predict residuals of some channels, or of all channels where ``channels`` is empty.

    ``share`` is the share of the residuals' squares that they predict beyond chance; ``p_value`` is corrected for all
    tests. ``remains``: False if accepted causes explain it, so that only a model without them shows it.
    ``subject``: the part whose error it is, empty where residuals as such depend on them. ``is_partial``: True if the
    accepted causes may explain a part of the share, of which the rest remains.
    """

    channels: tuple[int, ...]
    inputs: tuple[str, ...]
    share: float
    p_value: float
    remains: bool = True
    subject: str = ""
    is_partial: bool = False


@dataclass(frozen=True)
class Attributions:
    """Inputs that predict residuals; ``ended_early``: whether errors of single parts were too large a problem to search
    to the end."""

    found: tuple[Attributed, ...] = ()
    ended_early: bool = False


def attributed(
    plain: FittedModel[CauseT],
    models: Sequence[FittedModel[CauseT]],
    level: float,
    level_of_course: float,
    doubted_noise: Array | None = None,
) -> Attributions:
    """Return the inputs that predict the residuals of models of one campaign, at a familywise p-value of ``level``.

    What the last of several models does not show does not remain with its causes.
    What a course follows is a question of its own, decided at ``level_of_course`` for each. Shares are of the squares
    of the plain model's residuals. ``doubted_noise`` (B, K): factors on the noise of the fits that may be an effect.
    """
    columns = columns_of(plain, plain.model.error_groups)
    residuals = (
        (model, group_residuals) for model in models for group_residuals in residuals_of(model, plain, doubted_noise)
    )
    tried = [
        (model, group_residuals)
        for model, group_residuals in residuals
        if group_residuals.epochs.sum() >= FEWEST_EPOCHS
    ]
    known: dict[bytes, Spectra] = {}  # of the last epochs alone: all spectra of a long campaign take much memory
    attributions: list[Attributed] = []
    for model, group_residuals in sorted(tried, key=lambda pair: pair[1].group):
        at = group_residuals.epochs
        if (key := at.tobytes()) not in known:
            varied = {name: values[at] for name, values in columns.items() if np.ptp(values[at]) > 0.0}
            known.clear()
            known[key] = Spectra(varied, in_time_of(plain, at))
        tests, least = (1, level_of_course) if group_residuals.is_course else (len(tried), level / len(tried))
        for inputs, share, p_value in sets_of_inputs(group_residuals.rows, known[key], least):
            if group_residuals.share * share < _LEAST_SHARE:
                continue
            p_value, remains = min(1.0, max(p_value * tests, LEAST_P)), model is models[-1]
            attributions.append(
                Attributed(group_residuals.channels, inputs, group_residuals.share * share, p_value, remains)
            )
    ended_early = False
    if level_of_course > level:  # the model is known not to hold
        every = np.ones(len(plain.measured.values), bool)
        spectra = known.get(every.tobytes()) or Spectra(columns, in_time_of(plain, every))
        of_parts = _of_parts(plain, models[-1], spectra, level_of_course)
        attributions, ended_early = [*attributions, *of_parts.found], of_parts.ended_early
    return Attributions(tuple(_merged(attributions)), ended_early)


def _of_parts(plain: FittedModel[CauseT], final: FittedModel[CauseT], spectra: Spectra, level: float) -> Attributions:
    """Return the readings on which the errors of single parts depend in the plain model, and time for the base.

    Other columns compete and are not named: a slow motion of anything else also moves the parts. During one campaign it
    may resemble a function of any slow column.
    """
    readings = {name: column_of(values, spectra.columns) for name, values in plain.scene.inputs.items()}
    problem = part_problem(plain)
    if problem is None or len(problem.moved) < FEWEST_EPOCHS:
        return Attributions()
    if problem.is_too_large:
        return Attributions(ended_early=True)
    left = None if final is plain else part_problem(final)
    left = None if left is None or left.is_too_large else left
    squares = max(float(np.sum(plain.fit.whitened.rest**2)), _LEAST_SQUARES)
    subjects, parts = _parts(plain, readings)
    timed = time_columns(spectra.columns, spectra.in_time)
    found, ended_early = list[Attributed](), False
    for dependence in part_dependences(problem, parts, spectra, level):
        ended_early = dependence.ends_early
        named = {*readings.values(), *(() if subjects[dependence.index] else timed)}
        inputs = tuple(name for name in dependence.inputs if name in named)
        share = _share_saved(plain, dependence.predicted) / squares
        if inputs and share >= _LEAST_SHARE:
            is_left = left is not None and depends(left, parts[dependence.index], dependence.inputs, spectra, level)
            remains = final is plain or is_left
            subject = subjects[dependence.index] if dependence.is_sure else ""
            is_partial = is_left and final is not plain
            p_value = max(dependence.p_value, LEAST_P)
            found.append(Attributed((), inputs, min(share, 1.0), p_value, remains, subject, is_partial))
    return Attributions(tuple(found), ended_early)


def _parts(fitted: FittedModel[CauseT], readings: Mapping[str, str | None]) -> tuple[list[str], list[Part]]:
    """Return the subjects of a model's parts and their directions, numbered as the pathways of its errors."""
    pathways = fitted.model.error_pathways
    subjects = list(dict.fromkeys(pathway.subject for pathway in pathways))
    parts = []
    for subject in subjects:
        pathways_of_part = [
            (place, pathway.input) for place, pathway in enumerate(pathways) if pathway.subject == subject
        ]
        parts.append(Part(tuple(place for place, _ in pathways_of_part), readings.get(pathways_of_part[0][1])))
    return subjects, parts


def _share_saved(fitted: FittedModel[CauseT], predicted: Array) -> float:
    """Return the squares of the residuals that a prediction (B, M) of whitened rows saves."""
    whitened = fitted.fit.whitened
    rows = np.zeros(len(whitened.rest))
    rows[: predicted.size] = predicted.ravel()
    left = whitened.rest - whitened.without_shared(rows)
    return float(np.sum(whitened.rest**2) - np.sum(left**2))


def p_value_of_dependence(residuals: Array, observed: Mask, fitted: FittedModel[CauseT]) -> float:
    """Return the p-value of a dependence of ``residuals`` (B, K, d) on inputs, at the ``observed`` (B, K) ones."""
    at, channels = np.asarray(observed.any(1)), observed.any(0)
    if at.sum() < _FEWEST_OF_PLACE:
        return 1.0
    rows = np.nan_to_num(np.where(observed[..., None], residuals, 0.0)[at][:, channels].reshape(int(at.sum()), -1))
    groups = fitted.model.error_groups
    columns = {name: values[at] for name, values in columns_of(fitted, groups).items() if np.ptp(values[at]) > 0.0}
    if not columns or not rows.any():
        return 1.0
    return p_value_of_sets(rows, Spectra(columns, in_time_of(fitted, at)))


def _merged(attributions: Iterable[Attributed]) -> Iterator[Attributed]:
    """Yield one entry for all entries whose inputs are contained in it, of the same channels and subject or of none:
    what a channel or a part follows, the residuals follow."""
    left = sorted(
        attributions, key=lambda dependence: (-len(dependence.inputs), not dependence.channels, not dependence.subject)
    )
    while left:
        first = left[0]
        same = (first.channels, first.subject), ((), "")
        alike = [
            dependence
            for dependence in left
            if (dependence.channels, dependence.subject) in same and set(dependence.inputs) <= set(first.inputs)
        ]
        share, p_value = max(dependence.share for dependence in alike), min(dependence.p_value for dependence in alike)
        remaining = [dependence for dependence in alike if dependence.remains]
        is_partial = bool(remaining) and (
            len(remaining) < len(alike) or any(dependence.is_partial for dependence in remaining)
        )
        left = [dependence for dependence in left if all(dependence is not other for other in alike)]
        yield Attributed(
            first.channels, first.inputs, share, p_value, bool(remaining), first.subject, is_partial=is_partial
        )
