"""Exchanged loads in a calibration table: pairs of rows that fit once their loads are swapped back.

One calibration predicts the loads of all rows from their signals, with squares, products and cubes if a linear one is
clearly insufficient. If two rows were exchanged, in all or some components of the load, each misses by exactly the
difference of the two; a gross error or a bad channel does not cause that.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from truing.estimation.sensor.load_table import LoadTable
from truing.estimation.sensor.nonlinear_terms import detected_form, nonlinear_terms, residual_sum_of

if TYPE_CHECKING:
    from scipy.sparse import csr_array


_NORMAL_MEDIAN = 0.6745
_L1_ROUNDS, _CLOSE = 30, 0.1  # sigmas; smaller residuals gain no more weight
_SELECTIONS, _GROSS = 3, 5.0
_OPEN = 1e-12  # share of the largest eigenvalue below which one is zero
_ROUNDS = 50  # most exchanges that are searched, one after the other
_SUSPECT = 2.5  # row residual in sigmas; smaller ones cannot be part of a significant exchange
_TELLS = 4.0  # gain in chi-square from which a component counts as exchanged
_MOST_PAIRS = 300_000  # most pairs of rows that are tested: bounds the memory for tables full of gross errors
_FALSE_ALARM = 1e-3  # probability of naming any exchange in a table without one
_LARGE = 5000  # rows; in larger tables two rows hardly affect the fit, which is repeated only at the end
_ALIKE = 2.0  # ratio of sizes up to which rows count as equally far off
_BY_CHANCE = 0.05  # expected accidental exchanges among rows that are far off for other reasons
# A load is stray from this many sigmas and such a share of the range on; the share of rows that may be.
_STRAY, _STRAY_SHARE, _FEW_STRAY = 20.0, 0.05, 0.02
# For a zero per run: rows per column, and share of the loads' variance within runs.
_ROWS_PER_COLUMN, _WITHIN_SHARE = 4.0, 0.2


@dataclass(frozen=True)
class RowExchange:
    """Two rows (from 0) with exchanged loads in some components (of W).

    before, after: rms misfit in sigmas over these components; p_value: corrected for all pairs and all sets of
    components. Components in which the two loads differ by less than noise are left out.
    """

    first: int
    second: int
    components: tuple[int, ...]
    before: float
    after: float
    p_value: float


def exchanged_loads(table: LoadTable, false_alarm: float = _FALSE_ALARM) -> list[RowExchange]:
    """Return the exchanged rows of a table as in `search_exchanges`."""
    return search_exchanges(table, false_alarm)[0]


def search_exchanges(table: LoadTable, false_alarm: float = _FALSE_ALARM) -> tuple[list[RowExchange], int]:
    """Return the exchanged rows of a table, the most significant first, and the number of suspected pairs not tested.

    Equal loads in both rows are no exchange. If too many rows are far off, only the pairs of the worst ones are tested.
    The noise comes from the table's own residuals, in a robust fit of loads to signals and a zero. The zero is per run
    if loads change within sufficiently long runs, since bridges drift between them. Exchanged rows of signals look the
    same as exchanged rows of loads.
    """
    applied = np.flatnonzero(np.ptp(table.loads, axis=0) > 0)
    loads, exchanged, unseen = table.loads[:, applied], list[RowExchange](), 0
    zeros = _zeros(table, loads)
    columns, cubes, residuals, sigma = _calibrated(table.signals, loads, zeros)
    written, is_fitted = loads / sigma, True
    for _ in range(_ROUNDS):
        exchange, left_out = _best(loads, residuals / sigma, sigma, false_alarm, table.case)
        unseen = max(unseen, left_out)
        if exchange is None and is_fitted:
            break
        if exchange is not None:
            before = loads[[exchange.first, exchange.second]]
            _exchange(loads, exchange)
            residuals[[exchange.first, exchange.second]] += loads[[exchange.first, exchange.second]] - before
            exchanged.append(replace(exchange, components=tuple(applied[list(exchange.components)].tolist())))
        is_fitted = exchange is None or len(loads) <= _LARGE
        if is_fitted:
            residuals, sigma = _robust_residuals(columns, loads, zeros)
    if exchanged and _is_smooth((columns, cubes), (written, loads / sigma), zeros):
        return [], unseen
    return exchanged, unseen


def _calibrated(signals: NDArray, loads: NDArray, zeros: _Zeros) -> tuple[NDArray, NDArray, NDArray, NDArray]:
    """Return the columns (N, Q) that predict loads (N, W): signals, with nonlinear terms if significant; all nonlinear
    terms; and residuals and scatter (W,) of a robust fit. Terms are in the signals, or in the loads of a linear
    calibration if these are fewer. Outlying rows do not influence which terms are significant."""
    residuals, sigma = _robust_residuals(signals, loads, zeros)
    near = np.all(np.abs(residuals) < _GROSS * sigma, axis=1)
    zeros_near = _Zeros.of(np.unique(zeros.of_row[near], return_inverse=True)[1])
    inputs = signals if signals.shape[1] <= loads.shape[1] else loads - residuals
    forms = list(nonlinear_terms(inputs))
    clear = detected_form(signals[near], inputs[near], loads[near] / sigma, zeros_near.without_mean, zeros_near.count)
    if clear is None:
        return signals, forms[-1], residuals, sigma
    columns = np.hstack([signals, forms[clear]])
    return columns, forms[-1], *_robust_residuals(columns, loads, zeros)


def _is_smooth(columns: tuple[NDArray, NDArray], loads: tuple[NDArray, NDArray], zeros: _Zeros) -> bool:
    """True if further terms explain the recorded loads (N, W), in sigmas, better than exchanging rows does. The
    expected gain of random terms is subtracted; with too few rows the answer is False."""
    fitted, more = columns
    written, exchanged = loads
    smooth = residual_sum_of([fitted, more], written, zeros.without_mean, zeros.count)
    put_right = residual_sum_of([fitted], exchanged, zeros.without_mean, zeros.count)
    return smooth.spare > len(written) // 2 and smooth.mean_square < put_right.mean_square


def least_difference(table: LoadTable, false_alarm: float = _FALSE_ALARM) -> NDArray:
    """Return the smallest differences (W,) of two loads, in units of loads, for which an exchange is found.

    For exchanges in one component; from the scatter of the residuals and the number of equally outlying rows; 0 if
    never applied. Noise shifts the limit by about one sigma.
    """
    from scipy.special import chdtri

    applied = np.flatnonzero(np.ptp(table.loads, axis=0) > 0)
    loads = table.loads[:, applied]
    zeros = _zeros(table, loads)
    *_, residuals, sigma = _calibrated(table.signals, loads, zeros)
    trials = len(loads) * (len(loads) - 1) // 2 * (2 ** len(applied) - 1)
    least = np.sqrt(float(chdtri(1, false_alarm / max(trials, 1))))
    sizes = np.sort(np.max(np.abs(residuals / sigma), axis=1))
    tried = np.maximum(least, 1.0) * 1.05 ** np.arange(300)
    rows = np.searchsorted(sizes, tried * _ALIKE, "right") - np.searchsorted(sizes, tried / _ALIKE, "left") + 2
    # as `_chance_probability` counts for two rows that are one sigma off after the exchange
    chance = np.sqrt(2.0 * np.pi * np.e) / (2.0 * (_ALIKE - 1.0 / _ALIKE) * tried)
    refused = np.flatnonzero(0.5 * (rows * chance) ** 2 > _BY_CHANCE)
    if len(refused):
        least = float(tried[min(refused[-1] + 1, len(tried) - 1)])
    result = np.zeros(table.loads.shape[1])
    result[applied] = least * np.where(np.isfinite(sigma), sigma, 0.0)
    return result


@dataclass(frozen=True)
class StrayLoad:
    """A row (from 0) whose signals ask for another load: the component with the largest difference over its range, its
    load as recorded and as indicated by the signals, and the difference in sigmas."""

    row: int
    component: int
    written: float
    asked: float
    sigmas: float


def stray_loads(table: LoadTable, exchanged: Collection[int] = ()) -> list[StrayLoad] | None:
    """Return the rows whose load differs from that indicated by the signals, far beyond noise and by a clear share of
    its range. Rows ``exchanged`` are skipped; None where these are so many that they are no single mistakes.

    By the fit of `search_exchanges`, without any exchange. One disturbed signal looks like a wrong load. Where signals
    are nearly dependent, their noise alone indicates other loads; then the recorded load explains them.
    """
    applied = np.flatnonzero(np.ptp(table.loads, axis=0) > 0)
    loads, zeros = table.loads[:, applied], _zeros(table, table.loads[:, applied])
    *_, residuals, sigma = _calibrated(table.signals, loads, zeros)
    span = np.quantile(loads, 1.0 - _FEW_STRAY, axis=0) - np.quantile(loads, _FEW_STRAY, axis=0)
    share = np.abs(residuals) / np.where(span > 0.0, span, np.inf)
    worst = np.argmax(share, axis=1)
    every = np.arange(len(loads))
    size = np.abs(residuals / sigma)[every, worst]
    single = ~np.isin(every, list(exchanged))
    rows = np.flatnonzero((share[every, worst] > _STRAY_SHARE) & (size > _STRAY) & single)
    rows = rows[_is_unexplained(table.signals, loads, zeros, rows)]
    if len(rows) > max(1.0, _FEW_STRAY * len(loads)):
        return None
    return [
        StrayLoad(
            int(row),
            int(applied[at]),
            float(loads[row, at]),
            float(loads[row, at] - residuals[row, at]),
            float(size_of_row),
        )
        for row, at, size_of_row in zip(rows, worst[rows], size[rows], strict=True)
    ]


def _is_unexplained(signals: NDArray, loads: NDArray, zeros: _Zeros, rows: NDArray) -> NDArray:
    """Return True for rows (N,) whose signals their loads do not explain, by a fit to all other rows."""
    weights = np.ones(signals.shape)
    weights[rows] = 0.0
    residuals = _weighted_residuals(loads, signals, weights, zeros)
    noise = _scatter(np.delete(residuals, rows, axis=0), loads.shape[1] + zeros.count)
    return np.asarray((np.abs(residuals[rows]) > _GROSS * noise).any(axis=1))


def _exchange(loads: NDArray, row_exchange: RowExchange) -> None:
    components = list(row_exchange.components)
    loads[np.ix_([row_exchange.first, row_exchange.second], components)] = loads[
        np.ix_([row_exchange.second, row_exchange.first], components)
    ]


def _zeros(table: LoadTable, loads: NDArray) -> _Zeros:
    """Return the zero of each row: one per run, or one for all."""
    runs = _Zeros.of(np.unique(table.case, return_inverse=True)[1].ravel())
    rows = len(loads) / (table.signals.shape[1] + runs.count)
    within = runs.without(loads, np.ones(len(loads)))
    tell = np.sum(within**2, 0) >= _WITHIN_SHARE * np.sum((loads - loads.mean(0)) ** 2, 0)
    return runs if rows >= _ROWS_PER_COLUMN and tell.all() else _Zeros.of(np.zeros(len(loads), int))


@dataclass(frozen=True)
class _Zeros:
    """Index (N,) of the zero of each row among Z, and the matrix (Z, N) that sums rows by zero."""

    of_row: NDArray
    sums: csr_array

    @classmethod
    def of(cls, number: NDArray) -> _Zeros:
        from scipy.sparse import csr_array

        size = len(number)
        return cls(
            number, csr_array((np.ones(size), (number, np.arange(size))), (int(number.max(initial=0)) + 1, size))
        )

    @property
    def count(self) -> int:
        return int(self.sums.shape[0])

    def without_mean(self, values: NDArray) -> NDArray:
        """Return values (N, K) minus their mean per zero."""
        return self.without(values, np.ones(len(values)))

    def without(self, values: NDArray, weight: NDArray) -> NDArray:
        """Return values (N, K) minus their weighted mean per zero, weight (N,); unchanged without any weight."""
        mass = self.sums @ weight
        mean = (self.sums @ (weight[:, None] * values)) / np.where(mass > 0.0, mass, 1.0)[:, None]
        return np.asarray(values - mean[self.of_row])


def _robust_residuals(signals: NDArray, loads: NDArray, zeros: _Zeros) -> tuple[NDArray, NDArray]:
    """Return loads minus predictions (N, W) by a robust fit, and their scatter (W,). Least absolute deviations by
    reweighting, then least squares of inliers; each component separately."""
    size = np.sqrt(np.mean(zeros.without_mean(signals) ** 2, 0))
    columns = signals / np.where(size > 0.0, size, 1.0)
    parameters = columns.shape[1] + zeros.count
    residuals = _weighted_residuals(columns, loads, np.ones_like(loads), zeros)
    for _ in range(_L1_ROUNDS):
        far = np.abs(residuals) / _scatter(residuals, parameters)
        residuals = _weighted_residuals(columns, loads, 1.0 / np.maximum(far, _CLOSE), zeros)
    for _ in range(_SELECTIONS):
        near = np.abs(residuals) < _GROSS * _scatter(residuals, parameters)
        residuals = _weighted_residuals(columns, loads, near.astype(float), zeros)
    return residuals, _scatter(residuals, parameters)


def _weighted_residuals(columns: NDArray, loads: NDArray, weight: NDArray, zeros: _Zeros) -> NDArray:
    """Return residuals (N, W) of a fit to columns (N, Q) and zeros, with weights (N, W)."""
    residuals = np.empty_like(loads)
    for k, weights in enumerate(weight.T):
        within = zeros.without(np.column_stack([columns, loads[:, k]]), weights)
        weighed = weights[:, None] * within[:, :-1]
        # channels may be dependent
        inverse = np.linalg.pinv(weighed.T @ within[:, :-1], rcond=_OPEN, hermitian=True)
        residuals[:, k] = within[:, -1] - within[:, :-1] @ (inverse @ (weighed.T @ within[:, -1]))
    return residuals


def _scatter(residuals: NDArray, parameters: int) -> NDArray:
    """Return the robust standard deviation (W,) of residuals (N, W)."""
    freedom = np.sqrt(len(residuals) / max(len(residuals) - parameters, 1))
    spread = np.median(np.abs(residuals), 0) / _NORMAL_MEDIAN * freedom
    return np.where(spread > 0, spread, np.inf)


def _suspected(whitened: NDArray, needed: float) -> tuple[NDArray, NDArray, int]:
    """Return the pairs (first, second) of rows with residuals (N, W) in sigmas large enough for the needed gain in
    chi-square; and the number of such pairs not returned. An exchange gains at most the chi-square of its rows."""
    size = np.sum(whitened**2, axis=1)
    rows = np.flatnonzero(np.any(np.abs(whitened) > _SUSPECT, axis=1))
    rows = rows[np.argsort(-size[rows], kind="stable")]
    index = np.arange(len(rows))
    partners = np.maximum(np.searchsorted(-size[rows], size[rows] - needed, side="right") - index - 1, 0)
    is_taken = np.cumsum(partners) <= _MOST_PAIRS
    unseen, partners = int(partners[~is_taken].sum()), np.where(is_taken, partners, 0)
    first = np.repeat(index, partners)
    second = first + 1 + np.arange(len(first)) - np.repeat(np.cumsum(partners) - partners, partners)
    pairs = np.sort(np.stack([rows[first], rows[second]]), axis=0)
    pairs = pairs[:, np.lexsort(pairs[::-1])]
    return pairs[0], pairs[1], unseen


def _best(
    loads: NDArray, whitened: NDArray, sigma: NDArray, false_alarm: float, case: NDArray
) -> tuple[RowExchange | None, int]:
    """Return the exchange with the largest gain, if it is significant and leaves both rows within the noise; and the
    number of suspected pairs not tested. If one of its rows fits as well after an exchange within its own run (N,),
    that one is returned: adjacent rows are confused more easily than rows of different days."""
    from scipy.special import chdtri

    pairs = len(loads) * (len(loads) - 1) // 2
    trials = pairs * (2 ** loads.shape[1] - 1)
    needed = 2.0 * float(chdtri(1, false_alarm / max(trials, 1)))
    first, second, unseen = _suspected(whitened, needed)
    if not len(first):
        return None, unseen
    direction = (loads[first] - loads[second]) / sigma
    one_way, other_way = (_compare(whitened, (first, second), sign * direction) for sign in (1.0, -1.0))
    valid, p_value = one_way.valid(pairs, trials, false_alarm)
    before, used, count, total, left = one_way.before, one_way.taken, one_way.count, one_way.total, one_way.left
    # by chance as many pairs have the opposite difference; without any, other pairs are not gross errors
    is_chance = unseen or other_way.valid(pairs, trials, false_alarm)[0].any()
    explained = np.array([], int) if is_chance else np.unique(np.concatenate([first[valid], second[valid]]))
    near = np.flatnonzero(valid)
    expected = _chance_probability(whitened, (first[near], second[near]), direction[near], used[near], explained)
    valid[near] = expected <= _BY_CHANCE
    if not valid.any():
        return None, unseen
    best = int(np.argmax(np.where(valid, total, -np.inf)))
    rows = (first[best], second[best])
    nearer = valid & (case[first] == case[second]) & (np.isin(first, rows) | np.isin(second, rows))
    if nearer.any():
        best = int(np.argmax(np.where(nearer, total, -np.inf)))
    row_exchange = RowExchange(
        int(first[best]),
        int(second[best]),
        tuple(np.flatnonzero(used[best]).tolist()),
        float(np.sqrt(np.sum(before[best, used[best]]) / (2 * count[best]))),
        float(np.sqrt(left[best] / (2 * count[best]))),
        float(p_value[best]),
    )
    return row_exchange, unseen


@dataclass(frozen=True)
class _ExchangedPairs:
    """Squared residuals of P pairs before and after an exchange (P, W), and the components that improve."""

    before: NDArray
    after: NDArray
    taken: NDArray

    @property
    def count(self) -> NDArray:
        return np.asarray(self.taken.sum(1))

    @property
    def left(self) -> NDArray:
        return np.asarray(np.sum(np.where(self.taken, self.after, 0.0), 1))

    @property
    def total(self) -> NDArray:
        return np.asarray(np.sum(np.where(self.taken, self.before - self.after, 0.0), 1))

    def valid(self, pairs: int, trials: int, false_alarm: float) -> tuple[NDArray, NDArray]:
        """Return the mask of exchanges beyond chance that leave both rows within noise, and their p-values (P,)."""
        from scipy.special import chdtrc, chdtri

        some = np.maximum(self.count, 1)
        p_value = np.where(self.count > 0, np.minimum(1.0, trials * chdtrc(some, self.total / 2)), 1.0)
        return (p_value <= false_alarm) & (self.left <= chdtri(2 * some, false_alarm / pairs)), p_value


def _compare(whitened: NDArray, rows: tuple[NDArray, NDArray], direction: NDArray) -> _ExchangedPairs:
    first, second = whitened[rows[0]], whitened[rows[1]]
    before, after = first**2 + second**2, (first - direction) ** 2 + (second + direction) ** 2
    gain = np.where(np.isfinite(before - after), before - after, 0.0)
    # each row has to improve, or one gross error would pair with any outlying row
    is_right = (first**2 > (first - direction) ** 2) & (second**2 > (second + direction) ** 2)
    return _ExchangedPairs(before, after, (gain > _TELLS) & is_right)


def _chance_probability(
    whitened: NDArray, rows: tuple[NDArray, NDArray], direction: NDArray, taken: NDArray, explained: NDArray
) -> NDArray:
    """Return the expected number of accidental exchanges as good as each of P pairs, among rows equally far off.
    whitened (N, W), direction and taken (P, W). A row with another cause lies anywhere within its size. The further it
    is off, the less often it reaches the place of another row by chance. Heavy tails are included. Rows ``explained``
    by other exchanges are not counted.
    """
    sizes = np.sort(np.delete(np.max(np.abs(whitened), axis=1), explained))
    expected = np.full(len(direction), 0.5)
    for row, sign in zip(rows, (-1.0, 1.0), strict=True):
        before = np.abs(whitened[row])
        size = np.max(np.where(taken, before, 0.0), axis=1, initial=0.0)
        alike = np.searchsorted(sizes, size * _ALIKE, "right") - np.searchsorted(sizes, size / _ALIKE, "left")
        after = whitened[row] + sign * direction
        wide = 2.0 * (_ALIKE - 1.0 / _ALIKE) * np.maximum(before, 1.0)
        density = np.exp(0.5 * np.minimum(after**2, 1e3)) * np.sqrt(2.0 * np.pi) / wide
        expected *= np.maximum(alike, 1) * np.prod(np.where(taken, density, 1.0), axis=1)
    return expected
