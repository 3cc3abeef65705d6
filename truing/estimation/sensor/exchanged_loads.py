"""Loads written down in each other's row: two rows of a calibration table that are right once they are exchanged back.

The loads of all rows follow from their signals by one calibration. Where two rows were exchanged, wholly or in some
components of the load, each misses by just the difference of the two, which a gross error or a bad channel does not.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from truing.estimation.sensor.load_table import LoadTable

_NORMAL_MEDIAN = 0.6745
_L1_ROUNDS, _CLOSE = 30, 0.1  # residuals nearer than that, in sigmas, do not gain more weight
_SELECTIONS, _GROSS = 3, 5.0
_OPEN = 1e-12  # share of the largest eigenvalue that is no zero
_ROUNDS = 50  # exchanges looked for, one after the other
_SUSPECT = 2.5  # of a row's residuals in sigmas, below which it cannot be part of an exchange that is no chance
_TELLS = 4.0  # gain in chi-square from which a component counts as exchanged
_FALSE_ALARM = 1e-3  # of any exchange named in a table without one
_ROWS_PER_COLUMN, _WITHIN = 4.0, 0.2  # a zero of each run: rows by column, and share of the loads' variance within runs


@dataclass(frozen=True)
class RowExchange:
    """Two rows (from 0) whose loads are exchanged in some components (of W).

    before, after: their misfit in sigmas, root mean square over these components; p_value: corrected for all pairs and
    all sets of components. A component in which the two loads differ by no more than noise is not told of.
    """

    first: int
    second: int
    components: tuple[int, ...]
    before: float
    after: float
    p_value: float


def exchanged_loads(table: LoadTable, false_alarm: float = _FALSE_ALARM) -> list[RowExchange]:
    """Return the exchanged rows of a table, the surest first; loads that the table exchanges alike are no exchange.

    The noise is that of the table's own residuals, from a robust fit of loads to signals and a zero: of each run where
    loads change within runs that are long enough, for bridges drift between them. Whole rows of signals exchanged,
    loads being right, look the same as whole rows of loads.
    """
    applied = np.flatnonzero(np.ptp(table.loads, axis=0) > 0)
    loads, found = table.loads[:, applied], []
    zeros = _zeros(table, loads)
    for _ in range(_ROUNDS):
        rest, sigma = _robust_residuals(table.signals, loads, zeros)
        one = _best(loads, rest / sigma, sigma, false_alarm)
        if one is None:
            break
        _exchange(loads, one)
        one = replace(one, components=tuple(applied[list(one.components)].tolist()))
        found.append(one)
    return found


def _exchange(loads: NDArray, one: RowExchange) -> None:
    places = list(one.components)
    loads[np.ix_([one.first, one.second], places)] = loads[np.ix_([one.second, one.first], places)]


def _zeros(table: LoadTable, loads: NDArray) -> NDArray:
    """Return which rows (N, Z) share a zero: those of a run, or all of them."""
    member = (table.case[:, None] == table.cases).astype(float)
    rows = len(loads) / (table.signals.shape[1] + member.shape[1])
    within = loads - member @ (member.T @ loads / member.sum(0)[:, None])
    tell = np.sum(within**2, 0) >= _WITHIN * np.sum((loads - loads.mean(0)) ** 2, 0)
    return member if rows >= _ROWS_PER_COLUMN and tell.all() else np.ones((len(loads), 1))


def _robust_residuals(signals: NDArray, loads: NDArray, zeros: NDArray) -> tuple[NDArray, NDArray]:
    """Return loads less what signals tell (N, W) by a fit that gross errors do not bend, and its scatter (W,).

    Least absolute deviation by reweighting, then least squares of what lies near it; each component by itself. zeros:
    which rows (N, Z) share one.
    """
    columns = np.column_stack([signals, zeros])
    size = np.sqrt(np.mean(columns**2, 0))
    columns = columns / np.where(size > 0.0, size, 1.0)
    rest = _rest(columns, loads, np.ones_like(loads))
    for _ in range(_L1_ROUNDS):
        far = np.abs(rest) / _scatter(rest, columns.shape[1])
        rest = _rest(columns, loads, 1.0 / np.maximum(far, _CLOSE))
    for _ in range(_SELECTIONS):
        near = np.abs(rest) < _GROSS * _scatter(rest, columns.shape[1])
        rest = _rest(columns, loads, near.astype(float))
    return rest, _scatter(rest, columns.shape[1])


def _rest(columns: NDArray, loads: NDArray, weight: NDArray) -> NDArray:
    """Return residuals (N, W) of a fit to columns (N, Q) with weights (N, W)."""
    normal = np.einsum("np,nw,nq->wpq", columns, weight, columns, optimize=True)
    right = np.einsum("np,nw->wp", columns, weight * loads)
    inverse = np.linalg.pinv(normal, rcond=_OPEN, hermitian=True)  # channels may repeat one another
    values = (inverse @ right[..., None])[..., 0]
    return loads - columns @ values.T


def _scatter(rest: NDArray, parameters: int) -> NDArray:
    """Return the robust standard deviation (W,) of residuals (N, W)."""
    freedom = np.sqrt(len(rest) / max(len(rest) - parameters, 1))
    spread = np.median(np.abs(rest), 0) / _NORMAL_MEDIAN * freedom
    return np.where(spread > 0, spread, np.inf)


def _best(loads: NDArray, whitened: NDArray, sigma: NDArray, false_alarm: float) -> RowExchange | None:
    """Return the exchange that explains most, if it is more than chance and leaves both rows within the noise."""
    from scipy.special import chdtrc, chdtri

    pairs = len(loads) * (len(loads) - 1) // 2
    trials = pairs * (2 ** loads.shape[1] - 1)
    suspects = np.flatnonzero(np.any(np.abs(whitened) > _SUSPECT, axis=1))
    if len(suspects) < 2:
        return None
    first, second = suspects[np.array(np.triu_indices(len(suspects), 1))]
    way = (loads[first] - loads[second]) / sigma
    before = whitened[first] ** 2 + whitened[second] ** 2
    after = (whitened[first] - way) ** 2 + (whitened[second] + way) ** 2
    gain = np.where(np.isfinite(before - after), before - after, 0.0)
    # each row has to be put right by it, or one gross error would seem an exchange with whatever lies beyond
    of_first = whitened[first] ** 2 - (whitened[first] - way) ** 2
    of_second = whitened[second] ** 2 - (whitened[second] + way) ** 2
    taken = (gain > _TELLS) & (of_first > 0) & (of_second > 0)
    count = taken.sum(1)
    total, left = (np.sum(np.where(taken, one, 0.0), 1) for one in (gain, after))
    p_value = np.where(count > 0, np.minimum(1.0, trials * chdtrc(np.maximum(count, 1), total / 2)), 1.0)
    right = left <= chdtri(2 * np.maximum(count, 1), false_alarm / pairs)
    valid = (p_value <= false_alarm) & right
    if not valid.any():
        return None
    best = int(np.argmax(np.where(valid, total, -np.inf)))
    return RowExchange(
        int(first[best]),
        int(second[best]),
        tuple(np.flatnonzero(taken[best]).tolist()),
        float(np.sqrt(np.sum(before[best, taken[best]]) / (2 * count[best]))),
        float(np.sqrt(left[best] / (2 * count[best]))),
        float(p_value[best]),
    )
