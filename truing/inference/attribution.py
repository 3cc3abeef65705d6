"""Inputs that predict the residuals of a machine which no model of causes explains as a whole.

Residuals are regressed on smooth functions of each input, on its history and on pairs of inputs, block by block. A
block counts if it is significant after correction for all blocks and residuals tried, and after removal of the
correlation in time: a column that drifts along with the residuals is no evidence of dependence.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from truing.inference.arrays import Array, Integers, Mask
from truing.inference.fitted_model import FittedModel
from truing.inference.model import CauseT
from truing.inference.search import LEAST_P

_ORDER = "order"
# Most functions of one input, of one input held fixed while an interaction is tested, of time, and of a pair; and the
# fewest epochs per function. Length scales are in standard deviations of the inputs.
_OF_ONE, _BESIDE, _OF_TIME, _OF_TWO = 8, 10, 16, 24
_EPOCHS_PER_FUNCTION, _EPOCHS_PER_FUNCTION_BESIDE, _EPOCHS_PER_FUNCTION_OF_TWO = 4, 5, 3
_SCALE, _FINE_SCALE, _SCALE_OF_TWO, _SCALE_OF_FIELDS = 0.8, 0.5, 0.9, 1.0
_FIELDS = 8  # smooth patterns over the places of a group, in addition to its common shift
_THRESHOLDS = 0.08, 0.2, 0.4  # widths of play operators, relative to the range of an input
# Functions below this share of the strongest are dropped, and blocks with less new variance than this share.
_DISTINCT, _SAME, _NEW = 1e-2, 1e-3, 1e-3
_MOST_BLOCKS = 5
_DRIFT = 0.9  # a column drifts if functions of time explain this share of its variance
_MOST_HELD = 0.6  # largest number of functions held fixed, as a share of the epochs
_FEWEST_EPOCHS = 20
_LAGS = 2  # order of the autoregression in time
_MANY = 7  # fewest columns for the test of the largest root
_TRACY_WIDOM = 46.446, 0.186054, 9.84801  # as a gamma distribution: its shape, scale and offset
# Random orders of epochs are drawn where white noise is ruled out at this p-value. With more than _RESOLVED draws as
# large, their share is the p-value.
_ORDERS, _RULED_OUT, _RESOLVED, _LEAST_SKEWNESS = 150, 1e-3, 5, 0.3
# Half the level goes to single inputs, a quarter each to their histories and to pairs.
_WEIGHTS = {"input": 2.0, "history": 4.0, "pair": 4.0}


@dataclass(frozen=True)
class Attributed:
    """Inputs that predict residuals of some channels, or of all channels where ``channels`` is empty.

    ``share`` is the share of the residuals' squares that they predict beyond chance; ``p_value`` is corrected for all
    tests.
    """

    channels: tuple[int, ...]
    inputs: tuple[str, ...]
    share: float
    p_value: float


@dataclass(frozen=True)
class _Residuals:
    """Residuals (n, q) of unit noise at selected epochs (B,), of some channels, or of all where
    ``channels`` is empty."""

    channels: tuple[int, ...]
    epochs: Mask
    rows: Array


@dataclass(frozen=True)
class _FunctionBlock:
    """Functions (n, m) of some inputs, and the functions (n, k) held fixed while they are tested."""

    inputs: tuple[str, ...]
    kind: str
    functions: Array
    beside: Array
    taken: Array  # (n, l) functions removed from the residuals once the block counts
    is_time: bool = False


def attributed(fitted: FittedModel[CauseT], level: float) -> tuple[Attributed, ...]:
    """Return the inputs that predict the residuals of a model, at a familywise p-value of ``level``."""
    order = fitted.scene.covariates.get(_ORDER)
    groups = fitted.model.error_groups
    columns = _columns(fitted, groups)
    tried = [one for one in _residuals(fitted) if one.epochs.sum() >= _FEWEST_EPOCHS]
    found: list[Attributed] = []
    for one in tried:
        at = one.epochs
        own = {name: values[at] for name, values in columns.items() if np.ptp(values[at]) > 0.0}
        in_time = _InTime(_own(order, at), _own(groups, at))
        for inputs, share, p_value in _dependences(one.rows, own, in_time, level / len(tried)):
            found.append(Attributed(one.channels, inputs, share, min(1.0, max(p_value * len(tried), LEAST_P))))
    return tuple(_merged(found))


def _own(values: Array | Integers | None, at: Mask) -> Array | None:
    return None if values is None else np.asarray(values, float)[at]


def _merged(found: Iterable[Attributed]) -> Iterator[Attributed]:
    """Yield one entry for all entries of the same channels whose inputs are contained in it."""
    left = sorted(found, key=lambda one: -len(one.inputs))
    while left:
        first = left[0]
        alike = [one for one in left if one.channels == first.channels and set(one.inputs) <= set(first.inputs)]
        share, p_value = max(one.share for one in alike), min(one.p_value for one in alike)
        left = [one for one in left if all(one is not other for other in alike)]
        yield Attributed(first.channels, first.inputs, share, p_value)


def _columns(fitted: FittedModel[CauseT], groups: Integers | None) -> dict[str, Array]:
    """Return the inputs (B,) that vary, without the order of the epochs and without copies of the same clock."""
    scene = fitted.scene
    found: dict[str, Array] = {}
    for name, values in {**scene.covariates, **scene.inputs}.items():
        if np.ndim(values) == 1 and np.asarray(values).dtype.kind in "fiu" and name != _ORDER:
            own = np.asarray(values, float)
            if np.isfinite(own).all() and np.ptp(own) > 0.0 and not any(_same(own, o, groups) for o in found.values()):
                found[name] = own
    return found


def _same(first: Array, second: Array, groups: Integers | None) -> bool:
    """Return True if two columns (B,) differ only by a constant in each group."""
    apart = _centred((first - second)[:, None], groups)
    return bool(np.abs(apart).max() < 1e-9 * max(np.ptp(first), np.ptp(second)))


def _residuals(fitted: FittedModel[CauseT]) -> Iterator[_Residuals]:
    """Yield the residuals to be explained. Where observations are numbers: one set per channel. In space: each input,
    all inputs together, and for each group the projection on smooth fields over its places, along its own axes."""
    measured, whitened = fitted.measured, fitted.fit.whitened
    epochs, channels, size = measured.values.shape
    if size == 1:
        for channel in range(channels):
            seen = measured.seen[:, channel]
            if seen.any():
                rows = fitted.standardised[:, channel]
                at = seen & np.isfinite(rows).all(1)
                yield _Residuals((channel,), at, rows[at])
        return
    height, whole = channels * size, np.ones(epochs, bool)
    rest = whitened.rest[: epochs * (height + whitened.problem.local_value.shape[1])].reshape(epochs, -1)
    inputs = rest[:, height + fitted.input_rows.start : height + fitted.input_rows.stop]
    for each in inputs.T:
        yield _Residuals((), whole, each[:, None])
    if inputs.shape[1] > 1:
        yield _Residuals((), whole, inputs)
    axes = (
        measured.whitener @ fitted.fit.frames.R[:, None] @ fitted.model.rotations(fitted.fit.shared, fitted.fit.local)
    )
    along = np.einsum("bkij,bki->bkj", axes, rest[:, :height].reshape(epochs, channels, size))
    for group in np.unique(fitted.model.channel_groups):
        own = fitted.model.channel_groups == group
        fields = _fields(np.asarray(fitted.scene.shape, float)[own])
        yield _Residuals((), whole, np.einsum("bki,kp->bpi", along[:, own], fields).reshape(epochs, -1))


def _fields(places: Array) -> Array:
    """Return smooth orthonormal patterns (K, p) over places (K, 0 to 3), a common shift among them."""
    ones = np.ones((len(places), 1))
    if not places.shape[1] or len(places) < 2:
        return _orthonormal(ones)
    return _orthonormal(np.column_stack([ones, _smooth(places[:, :2], _FIELDS, _SCALE_OF_FIELDS)]))


@dataclass(frozen=True)
class _InTime:
    """Order in time (n,) of the epochs and the groups (n,) within which they follow each other; None where unknown."""

    order: Array | None
    groups: Array | None

    @property
    def _sorted(self) -> tuple[Integers, Integers]:
        """Epochs sorted by time within each group, and their groups."""
        assert self.order is not None
        groups = np.zeros(len(self.order), int) if self.groups is None else self.groups.astype(int)
        in_time = np.lexsort((self.order, groups))
        return in_time, groups[in_time]

    def history(self, values: Array) -> Array | None:
        """Return the history of an input (n,): its lead over play operators of several widths, and its previous value
        (n, 4). None where no order is known."""
        if self.order is None:
            return None
        x, (in_time, groups) = _standard(values[:, None])[:, 0], self._sorted
        found = np.zeros((len(x), len(_THRESHOLDS) + 1))
        reach = np.array(_THRESHOLDS) * max(float(np.ptp(x)), 1e-12)
        ahead = np.zeros(len(reach))
        for place, now in enumerate(in_time):
            first = place == 0 or groups[place] != groups[place - 1]
            last = now if first else in_time[place - 1]
            ahead = 0.0 * ahead if first else np.clip(ahead + x[now] - x[last], -reach, reach)
            found[now] = [*(ahead / reach), x[last]]
        return found

    def whitener(self, rows: Array) -> _Filter:
        """Return the filter that removes the serial correlation of rows (n, q), an autoregression of order 2."""
        if self.order is None:
            return _Filter(None, np.zeros(0, int), np.zeros(0))
        in_time, groups = self._sorted
        places = np.flatnonzero(groups[_LAGS:] == groups[:-_LAGS]) + _LAGS
        before = np.stack([rows[in_time[places - lag]].ravel() for lag in range(1, _LAGS + 1)], -1)
        gram = before.T @ before + 1e-9 * np.eye(_LAGS)
        return _Filter(in_time, places, np.linalg.solve(gram, before.T @ rows[in_time[places]].ravel()))


@dataclass(frozen=True)
class _Filter:
    """Epochs in time (n,), the indices of those that have predecessors, and the autoregression coefficients."""

    in_time: Integers | None
    places: Integers
    kept: Array

    def __call__(self, rows: Array) -> Array:
        """Return the innovations of rows (n, q); the rows themselves where the order is unknown."""
        if self.in_time is None:
            return rows
        past = (share * rows[self.in_time[self.places - lag]] for lag, share in enumerate(self.kept, 1))
        return _centred(rows[self.in_time[self.places]] - np.sum(list(past), axis=0))


def _dependences(
    rows: Array, columns: Mapping[str, Array], in_time: _InTime, level: float
) -> Iterator[tuple[tuple[str, ...], float, float]]:
    """Yield names, share and p-value of the inputs on which residuals (n, q) depend, block by block."""
    whole = _condensed(_centred(rows))
    total, rest = float(np.sum(whole**2)), whole
    held: Array = np.zeros((len(rows), 0))
    blocks = list(_blocks(columns, in_time))
    for _ in range(_MOST_BLOCKS):
        whitener = in_time.whitener(rest)
        tested = [(block, *found) for block in blocks if (found := _tested(block, rest, held, whitener)) is not None]
        sorts = [block.kind for block, *_ in tested]
        corrected = [(p * _WEIGHTS[b.kind] * sorts.count(b.kind), share, b) for b, p, share in tested]
        real = [one for one in corrected if one[0] <= level and one[1] > 0.0]
        if not real:
            return
        p_value, squares, block = max(real, key=lambda one: one[1])
        yield block.inputs, min(1.0, squares / total), p_value
        blocks = [other for other in blocks if other is not block]
        held = _orthonormal(np.column_stack([held, _beyond(block.taken, held)]))
        rest = whole - held @ (held.T @ whole)


def _blocks(columns: Mapping[str, Array], in_time: _InTime) -> Iterator[_FunctionBlock]:
    """Yield all blocks of functions: of each input, of its history, of every pair."""
    epochs = len(next(iter(columns.values()), np.zeros(0)))
    none, timed = np.zeros((epochs, 0)), _timed(columns, in_time)
    most = _most(_OF_ONE, epochs, _EPOCHS_PER_FUNCTION)
    mains = {name: _smooth(own[:, None], most, _SCALE) for name, own in columns.items()}
    fine = {}
    for name, own in columns.items():
        most = _most(_OF_TIME if name in timed else _BESIDE, epochs, _EPOCHS_PER_FUNCTION_BESIDE)
        fine[name] = _orthonormal(_centred(_smooth(own[:, None], most, _FINE_SCALE)))
        yield _FunctionBlock((name,), "input", mains[name], none, fine[name], name in timed)
    for name, own in columns.items():
        if name not in timed and (history := in_time.history(own)) is not None:
            yield _FunctionBlock((name,), "history", history, fine[name], np.column_stack([history, mains[name]]))
    drifts = {name for name, own in columns.items() if any(_drifts(own, fine[time]) for time in timed)}
    for pair in combinations(columns, 2):
        if drifts >= set(pair):  # two that drift are functions of time together
            continue
        both = np.column_stack([columns[name] for name in pair])
        own = _smooth(both, _most(_OF_TWO, epochs, _EPOCHS_PER_FUNCTION_OF_TWO), _SCALE_OF_TWO)
        beside = np.column_stack([fine[name] for name in pair])
        yield _FunctionBlock(pair, "pair", own, beside, np.column_stack([own, *(mains[name] for name in pair)]))


def _most(count: int, epochs: int, each: int) -> int:
    return min(count, max(epochs // each, 3))


def _timed(columns: Mapping[str, Array], in_time: _InTime) -> frozenset[str]:
    """Return the columns that never decrease in time: a dependence on these may itself be serial correlation."""
    if in_time.order is None:
        return frozenset()
    order = np.argsort(in_time.order, kind="stable")
    return frozenset(name for name, values in columns.items() if np.all(np.diff(values[order]) >= 0.0))


def _drifts(values: Array, of_time: Array) -> bool:
    """Return True if functions of time (n, m) explain nearly all of a column (n,)."""
    own = values - values.mean()
    return bool(np.sum((of_time.T @ own) ** 2) > _DRIFT * np.sum(own**2))


def _tested(block: _FunctionBlock, rest: Array, held: Array, whitener: _Filter) -> tuple[float, float] | None:
    """Return the p-value of a block on residuals (n, q) and the squares it predicts beyond chance. ``held`` (n, h) are
    functions held fixed. None where the block adds no new function, or too few epochs are left."""
    beside = _orthonormal(np.column_stack([held, block.beside]), _SAME) if block.beside.shape[1] else held
    functions = _beyond(block.functions, beside)
    if beside.shape[1] > _MOST_HELD * len(rest) or np.sum(functions**2) < _NEW * len(rest):
        return None
    own, free = rest - beside @ (beside.T @ rest), len(rest) - 1 - beside.shape[1]
    found = _chance(functions, own, free)
    if found is None or (block.is_time and not held.shape[1]):  # what other functions leave is correlated in time
        return found
    in_time = _chance(whitener(functions), whitener(own), free - _LAGS)
    return max(found[0], 1.0 if in_time is None else in_time[0]), found[1]


def _chance(functions: Array, rows: Array, free: int) -> tuple[float, float] | None:
    """Return the p-value of functions (n, m) as predictors of rows (n, q), and the squares they predict beyond chance.

    ``free``: degrees of freedom of the rows. None where the functions are too many. An F test of all columns, with an
    effective number of independent columns (Box, Ann. Math. Stat. 25 (1954) 290); for many columns also the largest
    root, which responds to one pattern common to all of them.
    """
    from scipy.special import fdtrc

    basis = _orthonormal(functions)
    count, columns = basis.shape[1], rows.shape[1]
    if not 0 < count <= free - 4:
        return None
    along = basis.T @ rows
    left = rows.T @ rows - along.T @ along
    squares, rest = float(np.sum(along**2)), float(np.trace(left))
    independent = rest**2 / max(float(np.sum(left**2)), 1e-300)
    ratio = squares / count / max(rest / (free - count), 1e-300)
    p_value = float(fdtrc(count * independent, (free - count) * independent, ratio))
    if columns >= _MANY:
        p_value = min(1.0, 2.0 * min(p_value, _of_largest_root(basis, rows, along, left, free - count)))
    return p_value, squares - count * rest / (free - count)


def _of_largest_root(basis: Array, rows: Array, along: Array, left: Array, free: int) -> float:
    """Return the p-value of the largest root of the products of rows (n, q) with a basis (n, m).

    ``left`` (q, q) are the residual products, with ``free`` degrees of freedom. First against white noise: Johnstone,
    Ann. Stat. 29 (2001) 295, by Chiani's gamma distribution, J. Multivariate Anal. 129 (2014) 69. If this rules out
    white noise, against permuted epochs too, because a few outliers would also raise the root.
    """
    from scipy.special import gammaincc

    (count, columns), level = along.shape, float(np.trace(left)) / (free * along.shape[1])
    first, second = math.sqrt(count - 0.5), math.sqrt(columns - 0.5)
    middle, spread = (first + second) ** 2, (first + second) * (1.0 / first + 1.0 / second) ** (1.0 / 3.0)
    root, (shape, scale, offset) = float(np.linalg.norm(along, 2)) ** 2, _TRACY_WIDOM
    white = float(gammaincc(shape, max((root / level - middle) / spread + offset, 0.0) / scale))
    if white > _RULED_OUT:
        return white
    rng = np.random.default_rng(len(rows))
    orders = (rng.permutation(len(rows)) for _ in range(_ORDERS))
    drawn = np.array([np.linalg.norm(basis.T @ rows[order], 2) ** 2 for order in orders])
    return max(white, _tail(drawn, root))


def _tail(drawn: Array, found: float) -> float:
    """Return the share of draws (D,) at least as large as the value found; far out, by a gamma distribution. The gamma
    distribution has the draws' mean, variance and skewness."""
    from scipy.special import gammaincc

    if (larger := int(np.sum(drawn >= found))) > _RESOLVED:
        return (larger + 1) / (len(drawn) + 1)
    spread = float(drawn.std())
    skewness = max(float(np.mean((drawn - drawn.mean()) ** 3)) / max(spread**3, 1e-300), _LEAST_SKEWNESS)
    shape = 4.0 / skewness**2
    scale = max(spread / math.sqrt(shape), 1e-300)
    return float(gammaincc(shape, max((found - drawn.mean()) / scale + shape, 0.0)))


def _smooth(columns: Array, most: int, scale: float) -> Array:
    """Return at most ``most`` functions (n, m) of inputs (n, D) that approximate a Gaussian process. The products of
    the functions are the covariance of the process, exact at its landmarks. ``scale`` is the length scale in standard
    deviations of the inputs."""
    x = _standard(columns)
    marks = _landmarks(x, most)
    values, vectors = np.linalg.eigh(_gaussian_kernel(marks, marks, scale))
    kept = values > 1e-4 * values[-1]
    return np.asarray(_gaussian_kernel(x, marks, scale) @ (vectors[:, kept] / np.sqrt(values[kept])))


def _landmarks(x: Array, most: int) -> Array:
    """Return at most ``most`` landmarks (n, D): the place nearest to the middle, then repeatedly the farthest one."""
    distinct = np.unique(np.round(x, 9), axis=0)
    if len(distinct) <= most:
        return distinct
    chosen = [int(np.argmin(np.sum(distinct**2, 1)))]
    far = np.sum((distinct - distinct[chosen[0]]) ** 2, 1)
    while len(chosen) < most:
        chosen.append(int(np.argmax(far)))
        far = np.minimum(far, np.sum((distinct - distinct[chosen[-1]]) ** 2, 1))
    return distinct[chosen]


def _gaussian_kernel(first: Array, second: Array, scale: float) -> Array:
    return np.asarray(np.exp(-0.5 * np.sum((first[:, None] - second) ** 2, -1) / scale**2))


def _standard(columns: Array) -> Array:
    spread = columns.std(0)
    return np.asarray((columns - columns.mean(0)) / np.where(spread > 0.0, spread, 1.0))


def _centred(rows: Array, groups: Integers | None = None) -> Array:
    """Return rows (n, q) less their mean, group by group."""
    if groups is None:
        return np.asarray(rows - rows.mean(0))
    number = np.unique(groups, return_inverse=True)[1]
    mean = np.stack([np.bincount(number, column) for column in rows.T], -1) / np.bincount(number)[:, None]
    return np.asarray(rows - mean[number])


def _condensed(rows: Array) -> Array:
    """Return rows (n, q) reduced to as many columns as their rank."""
    left, size, _ = np.linalg.svd(rows, full_matrices=False)
    kept = size > 1e-6 * size.max(initial=0.0)
    return np.asarray(left[:, kept] * size[kept])


def _beyond(functions: Array, held: Array) -> Array:
    """Return functions (n, m), centred, without their projection on orthonormal functions held (n, h)."""
    own = _centred(functions)
    return np.asarray(own - held @ (held.T @ own))


def _orthonormal(functions: Array, least: float = _DISTINCT) -> Array:
    """Return an orthonormal basis (n, r) of functions (n, m), without directions below a share of the largest."""
    basis, size, _ = np.linalg.svd(functions, full_matrices=False)
    return np.asarray(basis[:, size > least * size.max(initial=0.0)])
