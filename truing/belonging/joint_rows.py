"""Slips in some poses of an open chain while the other poses are right as recorded.

The places of base, tools and targets are fitted to the largest set of poses that agree. The other poses are then
compared at these places, with each slip undone.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, permutations, product
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from truing.arrays import Array, Index, Mask
from truing.belonging.assignment import cheapest_columns
from truing.belonging.relation import LENGTH_FACTORS, RecordSlip, SlipKind, both_ways
from truing.belonging.slips_in_rows import Agreement, row_places, slipped_rows
from truing.simulation.mechanisms.chains.column_slips import UNIT_FACTORS, ColumnSlipKind, corrected_columns

_WINDOWS = 12  # stretches of poses that places are fitted to
_FEWEST_APART = 3  # fewest poses of a slip that is no exchange of rows
_LEAST_SHARE = 0.2  # least share of the poses that agree; fewer may do so by chance
_FAR = 5.0  # typical misfits of poses that agree, beyond which a pose does not
_MOST_STRAY = 0.1  # largest share of poses that single mistakes explain
_MOST_STILL = 0.1  # largest share of poses that agree in which a column may stay the same too, if it is to be frozen
_LEFT = 0.2  # share of the misfit that may remain where rows are exchanged
_MOST_NAMED = 6  # equal poses that are all named; of more, those that disagree
_MOST_EXCHANGED = 200  # most poses among which an exchange is sought
_SHIFTS = (1, -1, 2, -2, 3, -3)
_AXES = ("x", "y", "z")
_BOTH_WAYS_OF_LIGHT = (0.5, 2.0)  # a way there and back in place of a distance, a diameter in place of a radius
_MEASURED, _DISTANCES = "measured positions", "distances"


# Errors (B, K, 3) at readings (B, n) and values (B, K, 3), with the places of the chain as fitted; (B, D, 1) of
# distances.
ErrorsAt: TypeAlias = Callable[[NDArray, NDArray], Array]


@dataclass(frozen=True)
class ChainComparison:
    """A chain and its measured positions: readings (B, n), rad or m, values (B, K, 3), m; or distances (B, D, 1).

    ``errors_at`` fits the places of the chain to some poses, a mask (B,). It gives the errors (B, K, 3) at readings and
    values, NaN where not seen. ``limit``: misfit, m, above which poses do not belong to their readings.
    ``targets`` (K,): link and name of each position. ``fewest``: fewest poses that determine the places.
    """

    readings: NDArray
    values: NDArray
    is_revolute: Mask
    columns: Sequence[str]
    targets: Sequence[tuple[str, str]]
    poses: Sequence[str]
    limit: float
    errors_at: Callable[[Mask], ErrorsAt]
    fewest: int = 6

    @property
    def is_of_distances(self) -> bool:
        """True where distances are measured, and not positions."""
        return self.values.shape[-1] == 1


@dataclass(frozen=True)
class RowSlips:
    """Slips in some poses, and the misfit, m, of these poses with their correction; None where that is unknown."""

    slips: tuple[RecordSlip, ...]
    after: float | None = None

    @property
    def is_explained(self) -> bool:
        """True unless the poses are only known to disagree."""
        return all(slip.kind is not SlipKind.STRAY for slip in self.slips)


@dataclass(frozen=True)
class _JointTrial:
    slip: RecordSlip
    readings: NDArray
    values: NDArray


def slips_in_poses(compared: ChainComparison) -> RowSlips | None:
    """Return the slips that explain the poses that disagree with most; stray poses where nothing does and they are few;
    None where all agree, where too few agree with one another, or where many disagree for no known reason."""
    agreement = _agreement(compared)
    if agreement is None:
        return None
    errors_at, agreed = agreement
    labels = _exchanged_names(compared, errors_at, agreed)
    if labels is not None:
        return labels
    if not len(agreed.apart):
        return None
    return (
        _frozen(compared, agreed)
        or _repeated(compared, agreed)
        or _exchanged(compared, errors_at, agreed)
        or _changed(compared, errors_at, agreed)
        or _stray(compared, agreed)
    )


def _stray(compared: ChainComparison, agreed: Agreement) -> RowSlips | None:
    """Return the poses that disagree as single mistakes; None where so many disagree that something else is wrong."""
    if len(agreed.apart) > max(1, _MOST_STRAY * len(agreed.distance)):
        return None
    return RowSlips((RecordSlip(SlipKind.STRAY, "readings of", _names(compared, agreed.apart)),))


def _names(compared: ChainComparison, rows: Index) -> tuple[str, ...]:
    return tuple(f"pose {compared.poses[row]}" for row in rows.tolist())


def _agreement(compared: ChainComparison) -> tuple[ErrorsAt, Agreement] | None:
    """Return the errors at places fitted to the largest set of agreeing poses, and that set."""
    count = len(compared.readings)
    best: Mask = np.zeros(count, bool)
    for window in _windows(count, compared.fewest):
        near = _near(compared, window)
        best = near if near.sum() > best.sum() else best
    best = _near(compared, best) if best.any() else best
    if best.sum() < max(compared.fewest, _LEAST_SHARE * count):
        return None
    errors_at = compared.errors_at(best)
    distance = _size(errors_at(compared.readings, compared.values))
    typical = float(np.median(distance[best]))
    agreement = Agreement(np.zeros(1), distance, max(_FAR * typical, compared.limit), typical)
    return errors_at, agreement


def _windows(count: int, fewest: int) -> Iterator[Mask]:
    """Yield all poses, and stretches of them, as masks (B,)."""
    yield np.ones(count, bool)
    length = max(fewest, count // 5)
    for first in np.unique(np.linspace(0, max(count - length, 0), _WINDOWS).astype(int)).tolist():
        window = np.zeros(count, bool)
        window[first : first + length] = True
        yield window


def _near(compared: ChainComparison, fitted: Mask) -> Mask:
    """Return the poses (B,) that agree with places fitted to some of them."""
    try:
        errors = compared.errors_at(fitted)(compared.readings, compared.values)
    except ValueError:
        return np.zeros(len(fitted), bool)
    return np.asarray(_size(errors) <= compared.limit)


def _size(errors: NDArray) -> Array:
    """Return the typical error (B,) of a pose per coordinate, m: the median over its positions, so that a single
    wrong target does not count."""
    return np.asarray(np.nanmedian(np.sqrt(np.mean(errors**2, axis=-1)), axis=-1))


def _rms(values: NDArray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _exchanged_names(compared: ChainComparison, errors_at: ErrorsAt, agreed: Agreement) -> RowSlips | None:
    """Return two targets of a link, or two distances, with each other's name in some poses."""
    before = errors_at(compared.readings, compared.values)
    for i, j in combinations(range(len(compared.targets)), 2):
        if compared.targets[i][0] != compared.targets[j][0]:
            continue
        values = compared.values.copy()
        values[:, [i, j]] = compared.values[:, [j, i]]
        survey_names, other = (
            np.sqrt(np.mean(e[:, [i, j]] ** 2, axis=(1, 2))) for e in (before, errors_at(compared.readings, values))
        )
        rows = (survey_names > agreed.limit) & (other < np.minimum(_LEFT * survey_names, agreed.limit))
        if rows.sum() >= _FEWEST_APART:
            names = tuple(compared.targets[k][1] for k in (i, j))
            where = row_places(rows, ~rows, compared.poses, ())
            quantity = _DISTANCES if compared.is_of_distances else "names of targets"
            slip = RecordSlip(SlipKind.PARTS_EXCHANGED, quantity, (*names, *where))
            return RowSlips((slip,), _rms(other[rows]))
    return None


def _frozen(compared: ChainComparison, agreed: Agreement) -> RowSlips | None:
    """Return the column, or all that was measured, that stays the same, in every digit, through the poses that
    disagree."""
    recorded: list[tuple[str, tuple[str, ...], NDArray]]
    if len(agreed.apart) < _FEWEST_APART:
        return None
    agree = np.ones(len(compared.values), bool)
    agree[agreed.apart] = False
    recorded = [
        ("readings", (name,), reading) for name, reading in zip(compared.columns, compared.readings.T, strict=True)
    ]
    recorded += [(_measured(compared), (), compared.values.reshape(len(compared.values), -1))]
    for quantity, names, values in recorded:
        same = (np.diff(values, axis=0) == 0.0).reshape(len(values) - 1, -1).all(1)
        still = np.append(same, False) | np.append(False, same)
        # A joint that also stands still where all is well is not frozen: joints are moved one at a time.
        if still[agreed.apart].all() and still[agree].mean() <= _MOST_STILL:
            slip = RecordSlip(SlipKind.FROZEN, quantity, (*names, *row_places(still, ~still, compared.poses, ())))
            return RowSlips((slip,))
    return None


def _measured(compared: ChainComparison) -> str:
    return _DISTANCES if compared.is_of_distances else _MEASURED


def _repeated(compared: ChainComparison, agreed: Agreement) -> RowSlips | None:
    """Return the measurements of poses that disagree, if each equals another pose in every digit."""
    far = agreed.apart
    values = compared.values.reshape(len(compared.values), -1)
    if len(far) < (_FEWEST_APART if compared.is_of_distances else 1) or not np.isfinite(values[far]).any():
        return None
    _, raveled, count = np.unique(np.nan_to_num(values), axis=0, return_inverse=True, return_counts=True)
    raveled = np.ravel(raveled)
    if not (count[raveled][far] > 1).all():
        return None
    alike = np.flatnonzero(np.isin(raveled, raveled[far]))
    names = _names(compared, alike if len(alike) <= _MOST_NAMED else far)
    return RowSlips((RecordSlip(SlipKind.COPIED, f"{_measured(compared)} of", names),))


def _changed(compared: ChainComparison, errors_at: ErrorsAt, agreed: Agreement) -> RowSlips | None:
    """Return the change of readings or of measured positions that explains the poses that disagree best."""
    candidates = []
    for trial in _trials(compared):
        after = _size(errors_at(trial.readings, trial.values))
        rows = slipped_rows(after[:, None], np.zeros((len(after), 1)), agreed)
        if rows is not None:
            candidates.append((_rms(after[rows[0]]), trial, rows))
    if not candidates:
        return None
    left, trial, rows = min(candidates, key=lambda candidate: candidate[0])
    where = row_places(*rows, compared.poses, ())
    return RowSlips((replace(trial.slip, subjects=(*trial.slip.subjects, *where)),), left)


def _exchanged(compared: ChainComparison, errors_at: ErrorsAt, agreed: Agreement) -> RowSlips | None:
    """Return poses whose readings are in each other's rows, if that explains every pose that disagrees."""
    far = agreed.apart
    if not 1 < len(far) <= _MOST_EXCHANGED:
        return None
    rows = np.arange(len(far))
    cost = np.empty((len(far), len(far)))
    for at in rows:
        readings = compared.readings.copy()
        readings[far] = compared.readings[np.roll(far, -at)]
        cost[rows, (rows + at) % len(far)] = _size(errors_at(readings, compared.values))[far]
    columns = cheapest_columns(np.log1p((cost / agreed.limit) ** 2))
    after = cost[rows, columns]
    if _rms(after) > _LEFT * _rms(agreed.distance[far]) or after.max() > agreed.limit or _is_shift(far, columns):
        return None
    return RowSlips((RecordSlip(SlipKind.ROWS_EXCHANGED, "readings", _names(compared, far)),), _rms(after))


def _is_shift(apart: Index, columns: Index) -> bool:
    """Return True where most rows took that of a neighbour: rows that are shifted, and not exchanged."""
    moved = np.abs(apart[columns] - apart)
    return bool(len(apart) > 3 * max(_SHIFTS) and np.median(moved) <= max(_SHIFTS))


def _trials(compared: ChainComparison) -> Iterator[_JointTrial]:
    """Yield every slip with readings and values after its correction in all poses."""
    readings, values = compared.readings, compared.values
    for kind, reading, corrected in corrected_columns(readings, compared.is_revolute):
        if kind not in (ColumnSlipKind.DOWN, ColumnSlipKind.UP, ColumnSlipKind.UPSIDE_DOWN):
            yield _JointTrial(column_slip(kind, [compared.columns[k] for k in reading]), corrected, values)
    for shift in _SHIFTS:
        yield _JointTrial(
            RecordSlip(SlipKind.ROWS_SHIFTED, "readings", shift=shift), np.roll(readings, -shift, axis=0), values
        )
    for trial in _units(_DISTANCES, 1) if compared.is_of_distances else changes_of_axes():
        yield _JointTrial(trial.slip, readings, values @ trial.matrix)


def column_slip(kind: ColumnSlipKind, names: Sequence[str]) -> RecordSlip:
    """Return the record of a slip in columns of readings; a shift concerns them all."""
    if kind in (ColumnSlipKind.DOWN, ColumnSlipKind.UP):
        return RecordSlip(SlipKind.ROWS_SHIFTED, "readings", shift=1 if kind is ColumnSlipKind.DOWN else -1)
    if kind is ColumnSlipKind.UPSIDE_DOWN:
        return RecordSlip(SlipKind.REVERSED, "readings")
    if kind is ColumnSlipKind.EXCHANGED:
        return RecordSlip(SlipKind.COLUMNS, "columns of readings", tuple(names))
    if kind in (ColumnSlipKind.ADDED, ColumnSlipKind.SUBTRACTED):
        return RecordSlip(SlipKind(kind.value), "readings", tuple(names))
    if kind is ColumnSlipKind.REVERSED:
        return RecordSlip(SlipKind.SIGN, "readings", tuple(names))
    return RecordSlip(SlipKind.UNIT, "readings", tuple(names), factor=UNIT_FACTORS[kind], dimension="angle")


@dataclass(frozen=True)
class MeasuredSlip:
    """A slip of measured positions or distances: right = recorded @ matrix (3, 3) or (1, 1)."""

    slip: RecordSlip
    matrix: Array


def slips_of_all(size: int) -> Iterator[MeasuredSlip]:
    """Yield what shows in all measured positions (size 3), whose frame is unknown, or distances (size 1)."""
    yield from _units(_DISTANCES if size == 1 else _MEASURED, size)
    if size > 1:
        yield MeasuredSlip(RecordSlip(SlipKind.MIRRORED, _MEASURED), np.diag([-1.0, 1.0, 1.0]))


def slips_of_lines(ends: Sequence[tuple[str, str]], values: NDArray) -> Iterator[tuple[RecordSlip, Array]]:
    """Yield slips of single distances in all poses, given the names of their ends, with the values (B, D, 1) after its
    correction: two ends with each other's name, and one distance in another unit."""
    if len(ends) < 2:
        return
    index_of = {pair: index for index, pair in enumerate(ends)}
    for first, second in combinations(sorted({name for pair in ends for name in pair}), 2):
        other = {first: second, second: first}
        exchanged = [(other.get(a, a), other.get(b, b)) for a, b in ends]
        if set(exchanged) == set(ends):
            slip = RecordSlip(SlipKind.PARTS_EXCHANGED, f"ends of {_DISTANCES}", (first, second))
            yield slip, values[:, [index_of[pair] for pair in exchanged]]
    for k, factor in product(range(len(ends)), both_ways(LENGTH_FACTORS)):
        changed_values = values.copy()
        changed_values[:, k] *= factor
        yield RecordSlip(SlipKind.UNIT, _DISTANCES, (" to ".join(ends[k]),), factor=factor), changed_values


def _units(quantity: str, size: int) -> Iterator[MeasuredSlip]:
    for factor in (*both_ways(LENGTH_FACTORS), *(_BOTH_WAYS_OF_LIGHT if size == 1 else ())):
        yield MeasuredSlip(RecordSlip(SlipKind.UNIT, quantity, factor=factor), factor * np.eye(size))


def changes_of_axes(quantity: str = _MEASURED) -> Iterator[MeasuredSlip]:
    """Yield other units, reversed and exchanged axes of positions (right = recorded @ matrix): what shows where their
    frame is known."""
    yield from _units(quantity, 3)
    for signs in product((1.0, -1.0), repeat=3):
        changed = " and ".join(name for name, sign in zip(_AXES, signs, strict=True) if sign < 0.0)
        if changed:
            yield MeasuredSlip(RecordSlip(SlipKind.SIGN, f"{changed} of {quantity}"), np.diag(signs))
    for order in permutations(range(3)):
        moved = tuple(_AXES[axis] for axis in range(3) if order[axis] != axis)
        if moved:
            yield MeasuredSlip(RecordSlip(SlipKind.COLUMNS, f"axes of {quantity}", moved), np.eye(3)[:, list(order)])
