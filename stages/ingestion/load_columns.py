"""The loads of a table: along one axis or six at once, made six columns, and held against what may be."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from truing.formats.faultlog import FaultLog
from truing.formats.gather import Gathered
from truing.formats.shapes import WRENCH
from truing.schemas.faults import Fault
from truing.stages.ingestion.gathered_columns import declared_missing, numbers, texts, unit_factors, without

Array = NDArray[np.float64]

AXES = tuple(name[:2] for name in WRENCH)
_KINDS = {axis: "N" if axis.startswith("f") else "N m" for axis in AXES}
_FURTHEST_TEST = 2.5  # of a range; beyond it, a wrong unit is likelier than an overload test
_ROUNDED = 1e-9  # a load at its range is in it
EMPTY_LOAD = "a load in every row; an empty cell has to be declared by missing"
_ONE_LOAD = 1e-3  # of the largest of its component: as alike as two tables write the same load


def with_known_loads(found: Gathered) -> Gathered:
    """The rows whose loads were all written down, of files whose mapping says which values mean missing."""
    names = [name for name in (*WRENCH, "load") if name in found.table.column_names]
    unknown = np.any([np.isnan(numbers(found, name)) for name in names], axis=0) if names else np.zeros(1, bool)
    return without(found, unknown & declared_missing(found), "a load that was not written down") if names else found


def six_loads(found: Gathered, loading: Any, log: FaultLog) -> Array:
    """The loads (N, 6) in N and N m; a component without a value beside others is 0. Notes what cannot be."""
    names = found.table.column_names
    six, one = [name for name in WRENCH if name in names], [name for name in ("load_axis", "load") if name in names]
    if bool(six) == bool(one) or len(one) == 1:
        expected = f"either columns {', '.join(WRENCH)}, or load_axis and load"
        if not six and not one:
            expected += '; where nothing acted, constants = { load_axis = "fz", load = 0 }'
        log.add(Fault(found.first_file, expected, value=", ".join([*six, *one]) or None))
        return np.full((len(found.table), 6), np.nan)
    if one:
        axis, load = (
            texts(found, "load_axis"),
            numbers(found, "load") * unit_factors(found, "load", "load_axis", _KINDS, log),
        )
        found.fault(log, np.isnan(load), "load", EMPTY_LOAD)
        loads = np.where(axis[:, None] == np.array(AXES, object), load[:, None], 0.0)
    else:
        loads = np.column_stack([numbers(found, name) if name in six else _unloaded(found) for name in WRENCH])
        written = np.any([~np.isnan(numbers(found, name)) for name in six], axis=0)
        found.fault(log, ~written, six[0], EMPTY_LOAD)
        loads = np.nan_to_num(loads)
    _check_range(found, loads, "load" if one else None, loading, log)
    return loads


def _unloaded(found: Gathered) -> Array:
    return np.zeros(len(found.table))


def _check_range(found: Gathered, loads: Array, column: str | None, loading: Any, log: FaultLog) -> None:
    for k, name in enumerate(WRENCH):
        limit = loading.allowed(name)
        if limit is not None:
            beyond = np.abs(loads[:, k]) > limit * (1.0 + _ROUNDED)
            expected = f"at most {limit:g} {_KINDS[AXES[k]]} of {AXES[k]} either way, by [loading]"
            cure = _cure(np.abs(loads[beyond, k]).max(initial=0.0) / getattr(loading, name))
            found.fault(log, beyond, column or name, expected + cure)


def _cure(share: float) -> str:
    """What to do of loads that go to this share of their range."""
    if share > _FURTHEST_TEST:
        return "; is its unit right?"
    return f"; of an overload test, [loading] overload = {math.ceil(share * 100.0 - _ROUNDED) / 100.0:g} allows it"


def check_one_load(found: Gathered, step: NDArray[np.int64], loads: Array, log: FaultLog) -> None:
    """A fault at every row whose load is not that of the first row of its step; step (N,) numbers the steps."""
    rows = np.flatnonzero(found.sound("run", "step", "load_axis", "load", *WRENCH))
    _, first, at = np.unique(step[rows], return_index=True, return_inverse=True)
    known, apart = loads[rows], np.zeros(len(loads), dtype=bool)
    with np.errstate(invalid="ignore"):
        apart[rows] = np.any(np.abs(known - known[first[at]]) > _allowed(known), axis=1)
    found.fault(log, apart, _load_column(found), "one load per step, on the same axis in all of its rows")


def check_same_loads(found: Gathered, loads: Array, other: Array, log: FaultLog) -> None:
    """A fault at every row whose loads (N, 6) are not those (N, 6) that the readings have for this step; NaN: none."""
    with np.errstate(invalid="ignore"):
        apart = np.any(np.abs(loads - other) > _allowed(np.concatenate([loads, other])), axis=1)
    apart &= found.sound("run", "step", "load_axis", "load", *WRENCH)
    found.fault(log, apart, _load_column(found), "the load that the readings of this run and step have")


def _allowed(loads: Array) -> Array:
    """(6,) how far two notes of the same load may be apart."""
    return _ONE_LOAD * np.nan_to_num(np.abs(loads)).max(axis=0, initial=0.0)


def _load_column(found: Gathered) -> str:
    """The column to name where loads do not agree."""
    return next((name for name in ("load", *WRENCH) if name in found.table.column_names), "load")
