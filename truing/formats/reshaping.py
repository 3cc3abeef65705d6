"""Records of another shape: several numbers in one cell, several targets in one row; numbers scaled and wrapped."""

from __future__ import annotations

import re

import numpy as np
import pyarrow as pa

from truing.formats.dictionaries import strings
from truing.formats.faultlog import CellFaults
from truing.formats.mapping import Plan
from truing.formats.raw import RawBatch
from truing.formats.shapes import COORDINATES
from truing.schemas.raw_value import RawValue

_NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?|[-+]?(?:nan|inf)", re.IGNORECASE)


def as_meant(values: pa.Array, meant: RawValue) -> pa.Array:
    """Numbers (N,) of a raw column as what they stand for, in the unit that the mapping gives; null stays null."""
    if meant.is_plain:
        return values
    plain = np.array(values.cast(pa.float64()).to_numpy(zero_copy_only=False), dtype=float)
    gone = np.asarray(values.is_null())
    with np.errstate(over="ignore", invalid="ignore"):  # what is not finite becomes a fault
        plain = plain * meant.scale + meant.offset
        if meant.modulo is not None:
            lowest = meant.lowest or 0.0
            turned = np.mod(plain - lowest, meant.modulo)
            plain = np.where(turned < meant.modulo, turned, 0.0) + lowest  # just below 0 rounds to a whole period
    return pa.array(plain / (meant.coverage or 1.0), mask=gone)


def spread_arrays(plan: Plan, batch: RawBatch) -> RawBatch:
    """A batch with a column for every number that the cells of some columns hold together."""
    if not plan.entry.arrays or not batch.rows:
        return batch
    columns, faults = dict(batch.columns), list(batch.faults)
    whole = np.ones(batch.rows, dtype=bool)
    for name, first, names in plan.arrays():
        position = plan.all_names.index(name)
        if position not in columns:
            continue
        cells = columns[position].cast("string")
        found = [_NUMBER.findall(cell or "") for cell in cells.to_pylist()]
        wrong = np.array([len(numbers) != len(names) for numbers in found], dtype=bool)
        faults.append(CellFaults.where(wrong, batch.records, cells, name, f"{len(names)} numbers in the cell"))
        whole &= ~wrong
        for offset in range(len(names)):
            columns[first + offset] = strings([numbers[offset] if len(numbers) > offset else "" for numbers in found])
    if not whole.all():
        columns = {key: values.filter(whole) for key, values in columns.items()}
    return RawBatch(columns, batch.records[whole], tuple(faults))


def widen(plan: Plan, batch: RawBatch) -> RawBatch:
    """A batch with one row per target, where its records hold several targets side by side."""
    groups = plan.wide
    if not groups:
        return batch
    count = len(groups)
    repeated = pa.array(np.repeat(np.arange(batch.rows), count))
    of_groups = {position for group in groups for position in group.positions}
    columns = {key: values.take(repeated) for key, values in batch.columns.items() if key not in of_groups}
    for axis, name in enumerate(COORDINATES):
        columns[name] = _interleaved([batch.columns[group.positions[axis]] for group in groups])
    for label in groups[0].labels:
        named = pa.array(np.tile(np.arange(count, dtype=np.int32), batch.rows))
        columns[label] = pa.DictionaryArray.from_arrays(named, strings([group.labels[label] for group in groups]))
    return RawBatch(columns, np.repeat(batch.records, count), batch.faults)


def _interleaved(columns: list[pa.Array]) -> pa.Array:
    """Row by row the values of several columns."""
    rows, count = len(columns[0]), len(columns)
    order = np.arange(rows * count).reshape(count, rows).T.ravel()
    return pa.concat_arrays(columns).take(order)
