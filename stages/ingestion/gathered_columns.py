"""Columns of a gathered table as arrays, and units that hang on what another column says."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from truing.formats.faultlog import FaultLog
from truing.formats.gather import Gathered
from truing.formats.units import UnknownUnit, conversion
from truing.schemas.faults import Fault

Array = NDArray[np.float64]


def numbers(found: Gathered, name: str) -> Array:
    """A column (N,) of numbers, NaN where it has none."""
    return np.asarray(found.table.column(name).to_numpy(zero_copy_only=False), dtype=float)


def texts(found: Gathered, name: str) -> NDArray[np.object_]:
    """A column (N,) as it stands."""
    return np.asarray(found.table.column(name).to_pylist(), dtype=object)


def numbered(found: Gathered, *names: str) -> NDArray[np.int64]:
    """(N,) a number for every combination of values in these columns, in order of appearance."""
    rows = list(zip(*(found.table.column(name).to_pylist() for name in names), strict=True))
    place = {key: number for number, key in enumerate(dict.fromkeys(rows))}
    return np.array([place[key] for key in rows], dtype=np.int64)


def unit_factors(found: Gathered, name: str, kind: str, wanted: Mapping[str, str], log: FaultLog) -> Array:
    """(N,) what brings a column into the unit that the value of ``kind`` in each row wants.

    A unit of another dimension concerns other rows: kN says nothing of torques, nm nothing of angles. One that no row
    could want is a fault.
    """
    values = texts(found, kind)
    factors = np.ones(len(values))
    start = 0
    for file, records in found.parts:
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
    """What brings a unit into those that values want, where it is of their dimension."""
    found = {}
    for value, target in wanted.items():
        try:
            found[value] = conversion(unit, target)[0]
        except UnknownUnit:
            continue
    return found


def declared_missing(found: Gathered) -> NDArray[np.bool_]:
    """(N,) rows of files whose mapping says which values mean missing."""
    return np.concatenate([np.full(len(records), bool(file.entry.missing)) for file, records in found.parts])


def without(found: Gathered, rows: NDArray[np.bool_], reason: str) -> Gathered:
    """The table without some rows (N,), which are counted as left out."""
    import pyarrow as pa

    if not rows.any():
        return found
    parts, left_out, start = [], found.left_out.copy(), 0
    for file, records in found.parts:
        out = rows[start : start + len(records)]
        start += len(records)
        parts.append((file, records[~out]))
        left_out[(file.raw.name, reason)] += int(out.sum())
    faulty = {name: told[~rows] for name, told in found.faulty.items()}
    return replace(found, table=found.table.filter(pa.array(~rows)), parts=parts, left_out=+left_out, faulty=faulty)
