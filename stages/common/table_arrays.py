"""Input tables of a campaign: columns as arrays, units by row, checks of standard deviations and keys."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from truing.arrays import Array, Index, Mask
from truing.formats.faultlog import FaultLog
from truing.formats.row_collection import CollectedRows
from truing.formats.units import UnknownUnit, conversion
from truing.schemas.column import SIGMA_BOUNDS
from truing.schemas.faults import Fault

# The square of a bound is rounded.
_ROUNDING = 1e-9


def numbers(collected: CollectedRows, name: str) -> Array:
    """A column (N,) of numbers, NaN if empty."""
    return np.asarray(collected.table.column(name).to_numpy(zero_copy_only=False), dtype=float)


def texts(collected: CollectedRows, name: str) -> NDArray[np.object_]:
    """A column (N,) unchanged."""
    return np.asarray(collected.table.column(name).to_pylist(), dtype=object)


def numbered(collected: CollectedRows, *names: str) -> Index:
    """(N,) number of each combination of values in these columns, in order of appearance."""
    rows = list(zip(*(collected.table.column(name).to_pylist() for name in names), strict=True))
    index_of = {key: number for number, key in enumerate(dict.fromkeys(rows))}
    return np.array([index_of[key] for key in rows], dtype=np.int64)


def unit_factors(collected: CollectedRows, name: str, kind: str, wanted: Mapping[str, str], log: FaultLog) -> Array:
    """(N,) factor from a column's unit to the unit that ``kind`` requires in each row.

    A unit of another dimension concerns other rows: kN does not concern torques, nm does not concern angles. A unit
    that fits no row is a fault.
    """
    values = texts(collected, kind)
    factors = np.ones(len(values))
    start = 0
    for file, records in collected.parts:
        rows = slice(start, start + len(records))
        start += len(records)
        unit = file.entry.units.get(name)
        if unit is not None:
            by_value = _factors(unit, wanted)
            if not by_value:
                expected = f"a unit that can become {' or '.join(dict.fromkeys(wanted.values()))}"
                log.add(Fault(file.raw.name, expected, column=name, value=unit))
            factors[rows] = [by_value.get(value, 1.0) for value in values[rows]]
    return factors


def _factors(unit: str, wanted: Mapping[str, str]) -> dict[str, float]:
    """Factors from a unit to the wanted units of its dimension."""
    factors = {}
    for value, target in wanted.items():
        try:
            factors[value] = conversion(unit, target)[0]
        except UnknownUnit:
            continue
    return factors


def declared_missing(collected: CollectedRows) -> Mask:
    """(N,) mask of rows from files whose mapping declares missing values."""
    return np.concatenate([np.full(len(records), bool(file.entry.missing)) for file, records in collected.parts])


def without_rows(collected: CollectedRows, rows: Mask, reason: str) -> CollectedRows:
    """The table without some rows (N,), which are counted as left out."""
    if not rows.any():
        return collected
    parts, left_out, start = [], collected.left_out.copy(), 0
    for file, records in collected.parts:
        out = rows[start : start + len(records)]
        start += len(records)
        parts.append((file, records[~out]))
        left_out[(file.raw.name, reason)] += int(out.sum())
    faulty = {name: determined[~rows] for name, determined in collected.faulty.items()}
    return replace(collected, table=collected.table.filter(~rows), parts=parts, left_out=+left_out, faulty=faulty)


def check_sigma(
    collected: CollectedRows,
    values: Array,
    name: str,
    unit: str,
    log: FaultLog,
    *,
    or_zero: bool = False,
    cure: str = "",
) -> None:
    """Note rows whose standard deviation (N,), in ``unit``, is 0 or outside ``SIGMA_BOUNDS``; NaN is not given.

    ``or_zero``: 0 is allowed and means exact. ``cure``: remedy if none is known.
    """
    least, most = SIGMA_BOUNDS[unit]
    too_small = (values < least) & ~((values == 0.0) & or_zero)
    expected = f"{'0, or ' if or_zero else 'a standard deviation above 0, from '}{least:g} to {most:g} {unit}{cure}"
    collected.fault(log, np.asarray(too_small | (values > most), dtype=bool), name, expected)


def check_variance(collected: CollectedRows, values: Array, name: str, unit: str, log: FaultLog) -> None:
    """Note rows whose variance (N,), in ``unit`` squared, is 0 or beyond the squares of ``SIGMA_BOUNDS``."""
    least, most = (bound**2 for bound in SIGMA_BOUNDS[unit])
    wrong = (values < least * (1.0 - _ROUNDING)) | (values > most * (1.0 + _ROUNDING))
    collected.fault(log, np.asarray(wrong, dtype=bool), name, f"a variance above 0, from {least:g} to {most:g} {unit}²")


def sigmas(
    collected: CollectedRows, columns: Sequence[str], declared: float | None, key: str, what: str, log: FaultLog
) -> Array:
    """Standard deviations (N, K) in the columns' unit, with the declared one for missing cells or columns.

    ``key``: where to declare one; ``what``: the quantity, in words.
    """
    values = np.full((len(collected.table), len(columns)), np.nan)
    for number, name in enumerate(columns):
        if name in collected.table.column_names:
            values[:, number] = numbers(collected, name)
            check_sigma(collected, values[:, number], name, name.rpartition("_")[2], log)
    if np.isnan(values).any() and declared is None:
        log.add_missing(key, f"a standard deviation of {what}", collected.first_file)
    return np.where(np.isnan(values), np.nan if declared is None else declared, values)


def with_filled_column(table: pa.Table, name: str, value: object, kind: pa.DataType) -> pa.Table:
    """The table with a value in the empty cells of a column (None: unchanged), or in a new column."""
    constant = pa.scalar(value, kind)
    if name not in table.column_names:
        return table.append_column(name, pa.repeat(constant, len(table)))
    column = table.column(name).cast(kind)
    return table.set_column(
        table.column_names.index(name), name, column if value is None else column.fill_null(constant)
    )


@dataclass
class SmallTable:
    """A table of the run, and the number of raw rows left out of it, by (file, reason)."""

    table: pa.Table
    left_out: dict[tuple[str, str], int] = field(default_factory=dict)
    file: str = field(default="", kw_only=True)


def check_unique_keys(collected: CollectedRows, log: FaultLog, *key: str, cure: str = "") -> None:
    """Fault at every row whose key occurred in an earlier row; cure: remedy if that is intended."""
    if any(name not in collected.table.column_names for name in key):
        return
    again = collected.without_faults(*key)
    rows = np.flatnonzero(again)
    again[rows[np.unique(numbered(collected, *key)[rows], return_index=True)[1]]] = False
    if again.any():
        every = numbered(collected, *collected.table.column_names)
        is_copied = np.ones(len(again), bool)
        is_copied[np.unique(every, return_index=True)[1]] = False
        if is_copied[again].all():
            cure = "; these rows repeat earlier ones in every value: leave the copies out"
    collected.fault(log, again, key[-1], f"every {', '.join(key)} once{cure}")
