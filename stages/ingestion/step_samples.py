"""Several samples of a load step: one row per step and channel, every number the mean over the same samples."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from truing.formats.faultlog import FaultLog
from truing.formats.gather import Gathered
from truing.formats.shapes import TRANSIT, WRENCH
from truing.stages.ingestion.gathered_columns import declared_missing, numbered, numbers, texts, without
from truing.stages.ingestion.load_columns import EMPTY_LOAD, with_known_loads

if TYPE_CHECKING:
    import pyarrow as pa

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_OF_A_STEP = ("run", "step", "channel")
_EMPTY = "a number in every sample; an empty cell has to be declared by missing"


def without_transit(found: Gathered) -> Gathered:
    """The table without the samples that were taken on the way to the next load, which are counted as left out."""
    if TRANSIT not in found.table.column_names:
        return found
    kept = without(found, numbers(found, TRANSIT) == 1.0, "samples in transit between loads")
    return replace(kept, table=kept.table.drop_columns([TRANSIT]))


def averaged(found: Gathered, log: FaultLog) -> Gathered:
    """One row per run, step and channel: the mean of every column of real numbers over the samples with a reading.

    A mean reading at the load, time or temperature of one of its samples would tilt the response on every ramp. Notes
    samples without a load, and texts that differ between samples of a step. A covariate is the mean of those samples
    that have it.
    """
    found = with_known_loads(without_transit(found))
    _check_samples(found, log)
    _, first, at = np.unique(numbered(found, *_OF_A_STEP), return_index=True, return_inverse=True)
    _check_alike(found, first[at], log)
    counts = _with_reading(found, at)
    further = np.ones(len(at), dtype=bool)
    further[first] = False
    rows = without(found, further, "")
    table = rows.table
    for place, name in enumerate(table.column_names):
        if _is_averaged(found.table, name):
            means = _means(_sampled(found, name), counts, at)
            table = table.set_column(place, name, _numbers(means[at[~further]]))
    return replace(rows, table=table, left_out=found.left_out)


def _is_averaged(table: pa.Table, name: str) -> bool:
    import pyarrow as pa

    return name not in _OF_A_STEP and bool(pa.types.is_floating(table.schema.field(name).type))


def _numbers(values: Array) -> pa.Array:
    import pyarrow as pa

    return pa.array(values, from_pandas=True)


def _with_reading(found: Gathered, at: NDArray[np.int64]) -> Mask:
    """(N,) samples that count: those with a reading; all of a step without any, whose row tells that it was there."""
    there = np.isfinite(numbers(found, "reading"))
    return np.asarray(there | (np.bincount(at, there)[at] == 0.0), dtype=bool)


def _sampled(found: Gathered, name: str) -> Array:
    """A column (N,) of numbers; a component of the wrench without a value beside others is 0."""
    values = numbers(found, name)
    return np.nan_to_num(values) if name in WRENCH else values


def _means(values: Array, counts: Mask, at: NDArray[np.int64]) -> Array:
    """(S,) means of what is known of values (N,) in the samples that count; NaN where nothing is."""
    known = np.isfinite(values) & counts
    count, total = np.bincount(at, known), np.bincount(at, np.where(known, values, 0.0))
    return np.divide(total, count, out=np.full(len(count), np.nan), where=count > 0)


def _check_samples(found: Gathered, log: FaultLog) -> None:
    """A fault at every sample without a load, or with an empty reading that nothing declares missing."""
    names = found.table.column_names
    six = [name for name in WRENCH if name in names]
    given = [numbers(found, name) for name in (six or ["load"] if "load" in names else six)]
    if given:
        found.fault(log, np.all(np.isnan(given), axis=0), (six or ["load"])[0], EMPTY_LOAD)
    empty = np.asarray(found.table.column("reading").is_null())
    found.fault(log, empty & ~declared_missing(found), "reading", _EMPTY)


def _check_alike(found: Gathered, first: NDArray[np.int64], log: FaultLog) -> None:
    """A fault at every sample that says in words, or in whole numbers, something else than the first of its step."""
    for name in found.table.column_names:
        if name not in _OF_A_STEP and not _is_averaged(found.table, name):
            told = texts(found, name)
            found.fault(log, np.asarray(told != told[first], dtype=bool), name, f"one {name} for all samples of a step")
