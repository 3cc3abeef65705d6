"""Choice of targets of an axis: those that determine its scale, lost motion and periodic errors of any period best.

Periods are not known before, so the criterion is a sum of log det over models that differ in the period alone; a set of
targets that does not show one of them has minus infinity. Every target is approached from both sides. One lies in each
of equal parts of the travel, so that no error of another form stays between them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from truing.arrays import Array, Index
from truing.estimation.design.pose_selection import bound_design, efficiency, information_of, sum_log_det
from truing.simulation.axis.causes import AxisCause
from truing.simulation.axis.model import AxisModel
from truing.simulation.axis.periodic import AxisPeriodicError
from truing.simulation.axis.rows import AxisRows

# Part of the travel at either end that is left for turning round, and number of candidates per target.
TURNING, CANDIDATES = 0.02, 8
_STARTS, _SWEEPS = 6, 50  # random starts, and most sweeps over the targets from each
# Fewest periods over the travel, most models, and the shortest period, as a share of the mean step.
_FEWEST_PERIODS, _MOST_MODELS, _OF_STEP = 2.0, 60, 0.5
# Targets on a lattice have a spectral window above this; frequencies are searched in these steps per period.
_ON_LATTICE, _FINE, _SHORTEST_STEP, _MOST_TARGETS = 0.999, 64.0, 4.0, 100


@dataclass(frozen=True)
class ChosenTargets:
    """Chosen candidates (P,) as rising indices, with their D-efficiency and that of as many targets in equal steps.

    Both are relative to the best of any candidates, also of several in one part; each of ``models`` has ``unknowns``.
    """

    chosen: Index
    efficiency: float
    even: float
    unknowns: int
    models: int


def candidate_targets(low: float, high: float, count: int, rng: np.random.Generator) -> Array:
    """Return candidates (C,) for ``count`` targets, one at random in each of equal cells: a lattice of them could not
    show some periods."""
    margin, cells = TURNING * (high - low), CANDIDATES * count
    places = (np.arange(cells) + rng.uniform(0.0, 1.0, cells)) / cells
    step = 10.0 ** np.floor(np.log10((high - low) / cells / 10.0))
    return np.asarray(np.round((low + margin + places * (high - low - 2.0 * margin)) / step) * step)


def with_periods(causes: Sequence[AxisCause], travel: float, count: int) -> list[tuple[AxisCause, ...]]:
    """Return the models whose effects ``count`` targets shall show: all causes, with a periodic error of every period.

    Known periods stay; searched ones run from half the travel to half the mean step.
    """
    fixed = [cause for cause in causes if not isinstance(cause, AxisPeriodicError)]
    waves = [cause for cause in causes if isinstance(cause, AxisPeriodicError)]
    searched = [wave for wave in waves if not wave.has_set_shape]
    every = [wave for wave in waves if wave.has_set_shape]
    if searched:
        highest = max(count / _OF_STEP, 2.0 * _FEWEST_PERIODS)
        models = min(_MOST_MODELS, int(2.0 * (highest - _FEWEST_PERIODS)))
        frequencies = np.linspace(_FEWEST_PERIODS, highest, models) / travel
        every += [replace(searched[0], period=1.0 / f, frequency_sigma=0.0, aliased=False) for f in frequencies]
    return [(*fixed, wave) for wave in every] or [tuple(fixed)]


def target_rows(model: AxisModel, sigma: NDArray, positions: Array, effects: Sequence[Sequence[AxisCause]]) -> NDArray:
    """Return whitened derivatives (C, L, 2 K, q) of readings at positions (C,), rad or m, from both sides.

    ``sigma`` (K,) is the noise of the encoders; ``effects`` are the L models, each with q unknowns.
    """
    up, down = (_rows_at(model, sigma, _approached(positions, side), effects) for side in (1.0, -1.0))
    return np.concatenate([up, down], axis=2)


def row_information(
    model: AxisModel, sigma: NDArray, rows: AxisRows, effects: Sequence[Sequence[AxisCause]]
) -> NDArray:
    """Return the information (L, q, q) of given rows, with their directions of approach."""
    return information_of(_rows_at(model, sigma, rows, effects))


def choose_targets(
    rows: NDArray, even_rows: NDArray, kept: NDArray | None, rng: np.random.Generator, is_random: bool = False
) -> ChosenTargets:
    """Choose a target in each part of the travel, in addition to the information ``kept`` (L, q, q).

    ``rows`` (C, L, M, q): candidates; ``even_rows`` (P, L, M, q): as many targets in equal steps. No other candidate of
    its part is better for any target; if random, they are the first ones drawn. Raises ValueError if the candidates do
    not determine every model.
    """
    count, size = len(even_rows), rows.shape[1] * rows.shape[3]
    bound = bound_design(rows, count, kept, gap=1e-3)
    parts = np.arange(len(rows)).reshape(count, -1)
    starts = [rng.permuted(parts, axis=1)[:, 0] for _ in range(1 if is_random else _STARTS)]
    found = starts if is_random else [_exchanged(rows, parts, start, kept) for start in starts]
    values = [sum_log_det(information_of(rows[chosen], kept)) for chosen in found]
    even = efficiency(sum_log_det(information_of(even_rows, kept)), bound.upper, size)
    best = int(np.argmax(values))
    return ChosenTargets(found[best], efficiency(values[best], bound.upper, size), even, rows.shape[3], rows.shape[1])


def lattice_step(positions: Array) -> float | None:
    """Return the largest step of which all distances between positions (N,) are multiples; None without one.

    A periodic error of this period, or of a whole fraction of it, is the same at all of them. The spectral window
    |mean exp(2 pi i f x)| is then near one at the frequency f.
    """
    distinct = np.unique(positions)
    travel = float(np.ptp(distinct)) if len(distinct) else 0.0
    if not 3 <= len(distinct) <= _MOST_TARGETS or not travel > 0.0:
        return None
    frequencies = np.arange(1.5 * _FINE, _SHORTEST_STEP * len(distinct) * _FINE) / (_FINE * travel)
    window = np.abs(np.exp(2j * np.pi * frequencies[:, None] * distinct).mean(1))
    near = np.flatnonzero(window > _ON_LATTICE)
    if not len(near):
        return None
    beyond = np.flatnonzero(np.diff(near) > 1)
    peak = near[: beyond[0] + 1] if len(beyond) else near
    return 1.0 / float(frequencies[peak[np.argmax(window[peak])]])


def visited(targets: Array, cycles: int, low: float, high: float) -> Array:
    """Return the commands of cycles up and down through targets (P,), with turns at ``low`` and ``high``.

    The first row is at ``low``, so that every target is approached from a known side.
    """
    return np.tile(np.concatenate([[low], targets, [high], targets[::-1]]), cycles)


def targets_within(readings: int, cycles: int) -> int:
    """Return the number of targets that ``readings`` allow in cycles up and down, turns included; inverse of the length
    of `visited`."""
    return (readings // cycles - 2) // 2


def _approached(positions: Array, side: float) -> AxisRows:
    """Rows at positions (C,), each approached from one side."""
    none = np.zeros(len(positions))
    order = np.arange(float(len(positions)))
    poses = tuple(range(len(positions)))
    return AxisRows(poses, order, positions, none + side, none, none, order, np.zeros((len(none), 3)), none)


def _rows_at(model: AxisModel, sigma: NDArray, rows: AxisRows, effects: Sequence[Sequence[AxisCause]]) -> NDArray:
    whitened_rows = []
    for causes in effects:
        model_at_rows = model.with_causes(causes).at(rows)
        prediction = model_at_rows.predict(
            np.zeros(model_at_rows.shared_size), np.zeros((len(rows.command), model_at_rows.local_size))
        )
        stops = np.asarray(prediction.by_local)[:, :, 0]
        covariance = np.diag(sigma**2) + stops @ np.swapaxes(stops, 1, 2)
        whitened_rows.append(np.linalg.solve(np.linalg.cholesky(covariance), np.asarray(prediction.by_shared)[:, :, 0]))
    return np.stack(whitened_rows, 1)


def _exchanged(rows: NDArray, parts: Index, start: Index, kept: NDArray | None) -> Index:
    """Return candidates (P,), one of each part (P, c), that no exchange within a part improves."""
    chosen = start.copy()
    each = np.einsum("clmq,clmr->clqr", rows, rows)
    before = 0.0 if kept is None else kept
    for _ in range(_SWEEPS):
        earlier = chosen.copy()
        for k, part in enumerate(parts):
            sum_of_others = before + each[np.delete(chosen, k)].sum(0)
            sign, value = np.linalg.slogdet(sum_of_others + each[part])
            chosen[k] = part[np.argmax(np.where(sign > 0, value, -np.inf).sum(1))]
        if (chosen == earlier).all():
            break
    return chosen
