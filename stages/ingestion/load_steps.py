"""Load steps in files: loads on one axis or all six, their order, and averages of several samples."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa

from truing.arrays import Array, Index, Mask
from truing.formats.faultlog import FaultLog
from truing.formats.raw_tables import TRANSIT, WRENCH
from truing.formats.row_collection import CollectedRows
from truing.schemas.faults import Fault
from truing.stages.common.table_arrays import (
    check_unique_keys,
    declared_missing,
    numbered,
    numbers,
    texts,
    unit_factors,
    without_rows,
)

if TYPE_CHECKING:
    from truing.schemas.sections import Loading

AXES = tuple(name[:2] for name in WRENCH)
UNITS_BY_AXIS = {axis: "N" if axis.startswith("f") else "N m" for axis in AXES}
_FURTHEST_TEST = 2.5  # of a range; above this, a wrong unit is more likely than an overload test
_ROUNDED = 1e-9  # a load at its range is in it
EMPTY_LOAD = "a load in every row; an empty cell has to be declared by missing"
_ONE_LOAD = 1e-3  # of the largest of its component: rounding of the same load in two tables
_OF_A_STEP = ("run", "step", "channel")
_EMPTY_SAMPLE = "a number in every sample; an empty cell has to be declared by missing"


def with_known_loads(collected: CollectedRows) -> CollectedRows:
    """Return the rows with all loads recorded, if the mapping declares missing values."""
    names = [name for name in (*WRENCH, "load") if name in collected.table.column_names]
    unknown = np.any([np.isnan(numbers(collected, name)) for name in names], axis=0) if names else np.zeros(1, bool)
    return (
        without_rows(collected, unknown & declared_missing(collected), "a load that was not written down")
        if names
        else collected
    )


def six_loads(collected: CollectedRows, loading: Loading, log: FaultLog) -> Array:
    """Return the loads (N, 6) in N and N m; an empty component next to others is 0. Reports impossible loads."""
    names = collected.table.column_names
    six, one = [name for name in WRENCH if name in names], [name for name in ("load_axis", "load") if name in names]
    if bool(six) == bool(one) or len(one) == 1:
        expected = f"either columns {', '.join(WRENCH)}, or load_axis and load"
        if not six and not one:
            expected += '; where nothing acted, constants = { load_axis = "fz", load = 0 }'
        log.add(Fault(collected.first_file, expected, value=", ".join([*six, *one]) or None))
        return np.full((len(collected.table), 6), np.nan)
    if one:
        axis, load = (
            texts(collected, "load_axis"),
            numbers(collected, "load") * unit_factors(collected, "load", "load_axis", UNITS_BY_AXIS, log),
        )
        collected.fault(log, np.isnan(load), "load", EMPTY_LOAD)
        loads = np.where(axis[:, None] == np.array(AXES, object), load[:, None], 0.0)
    else:
        unloaded = np.zeros(len(collected.table))
        loads = np.column_stack([numbers(collected, name) if name in six else unloaded for name in WRENCH])
        written = np.any([~np.isnan(numbers(collected, name)) for name in six], axis=0)
        collected.fault(log, ~written, six[0], EMPTY_LOAD)
        loads = np.nan_to_num(loads)
    _check_range(collected, loads, "load" if one else None, loading, log)
    return loads


def _check_range(collected: CollectedRows, loads: Array, column: str | None, loading: Loading, log: FaultLog) -> None:
    for k, name in enumerate(WRENCH):
        limit = loading.allowed(name)
        if limit is not None:
            beyond = np.abs(loads[:, k]) > limit * (1.0 + _ROUNDED)
            expected = f"at most {limit:g} {UNITS_BY_AXIS[AXES[k]]} of {AXES[k]} either way, by [loading]"
            cure = _cure(np.abs(loads[beyond, k]).max(initial=0.0) / getattr(loading, name))
            collected.fault(log, beyond, column or name, expected + cure)


def _cure(share: float) -> str:
    """Return the remedy for loads of this share of their range."""
    if share > _FURTHEST_TEST:
        return "; is its unit right?"
    return f"; of an overload test, [loading] overload = {math.ceil(share * 100.0 - _ROUNDED) / 100.0:g} allows it"


def check_one_load(collected: CollectedRows, step: Index, loads: Array, log: FaultLog) -> None:
    """Report rows whose load differs from the first row of their step; ``step`` (N,): step numbers."""
    rows = np.flatnonzero(collected.without_faults("run", "step", "load_axis", "load", *WRENCH))
    _, first, at = np.unique(step[rows], return_index=True, return_inverse=True)
    known, is_different = loads[rows], np.zeros(len(loads), dtype=bool)
    with np.errstate(invalid="ignore"):
        is_different[rows] = np.any(np.abs(known - known[first[at]]) > _allowed(known), axis=1)
    collected.fault(
        log, is_different, _load_column(collected), "one load per step, on the same axis in all of its rows"
    )


def check_same_loads(collected: CollectedRows, loads: Array, other: Array, log: FaultLog) -> None:
    """Report rows whose loads (N, 6) differ from those (N, 6) of the readings in the same step; NaN: unknown."""
    with np.errstate(invalid="ignore"):
        is_different = np.any(np.abs(loads - other) > _allowed(np.concatenate([loads, other])), axis=1)
    is_different &= collected.without_faults("run", "step", "load_axis", "load", *WRENCH)
    collected.fault(log, is_different, _load_column(collected), "the load that the readings of this run and step have")


def _allowed(loads: Array) -> Array:
    """Return the allowed difference (6,) between two records of the same load."""
    return _ONE_LOAD * np.nan_to_num(np.abs(loads)).max(axis=0, initial=0.0)


def _load_column(collected: CollectedRows) -> str:
    """Return the column to name if loads disagree."""
    return next((name for name in ("load", *WRENCH) if name in collected.table.column_names), "load")


def check_times(collected: CollectedRows, log: FaultLog) -> None:
    """Report rows that are not later than the previous step of their run."""
    if "time_s" not in collected.table.column_names:
        return
    run, step, time = numbered(collected, "run"), numbers(collected, "step"), numbers(collected, "time_s")
    wrong = np.zeros(len(run), dtype=bool)
    order = np.lexsort((time, step, run))
    order = order[collected.without_faults("run", "step", "time_s")[order]]
    for rows in np.split(order, np.flatnonzero(np.diff(run[order])) + 1):
        known = rows[np.isfinite(time[rows])]
        before = np.searchsorted(step[known], step[known])  # the first row of the same step: before it, the latest
        wrong[known] = (before > 0) & (time[known] <= time[known[before - 1]])
    collected.fault(log, wrong, "time_s", "a time after that of the step before: steps are in the order taken")


def check_roles(collected: CollectedRows, log: FaultLog) -> None:
    """Report rows whose role differs from the first row of their run."""
    if "role" not in collected.table.column_names:
        return
    rows = np.flatnonzero(collected.without_faults("run", "role"))
    role = numbered(collected, "role")[rows]
    _, first, at = np.unique(numbered(collected, "run")[rows], return_index=True, return_inverse=True)
    is_unknown = np.zeros(len(collected.table), dtype=bool)
    is_unknown[rows] = role != role[first[at]]
    collected.fault(log, is_unknown, "role", "one role for a whole run")


def without_transit(collected: CollectedRows) -> CollectedRows:
    """Return the table without samples recorded during a change of load, which are counted as left out."""
    if TRANSIT not in collected.table.column_names:
        return collected
    kept_rows = without_rows(collected, numbers(collected, TRANSIT) == 1.0, "samples in transit between loads")
    return replace(kept_rows, table=kept_rows.table.drop_columns([TRANSIT]))


def averaged(collected: CollectedRows, log: FaultLog) -> CollectedRows:
    """Return one row per run, step and channel: mean of each real column over the samples with a reading.

    Loads, times and temperatures are averaged with the readings; those of a single sample would bias the response on a
    ramp. Reports samples without a load, and texts that differ within a step. A covariate is averaged over the samples
    that have it.
    """
    collected = with_known_loads(without_transit(collected))
    _check_samples(collected, log)
    _, first, at = np.unique(numbered(collected, *_OF_A_STEP), return_index=True, return_inverse=True)
    _check_constant(collected, first[at], log)
    return _means(collected, first, at, _with_reading(collected, at))


def averaged_signals(collected: CollectedRows, loading: Loading, log: FaultLog) -> CollectedRows:
    """Return one row per load step of a recording: mean of each real column over the samples of the step.

    Samples are rows of a run in succession with equal loads. Where rows share the number of a step, another number
    begins another step. Steps are numbered anew where several have the same number, as in files that each begin
    with 1.
    """
    collected = with_known_loads(without_transit(collected))
    loads = six_loads(collected, loading, log)
    run, step = numbered(collected, "run"), numbers(collected, "step")
    in_files = np.argsort(run, kind="stable")
    of_run, of_step = np.diff(run[in_files]) != 0, np.diff(step[in_files]) != 0
    changes = np.any(np.diff(loads[in_files], axis=0) != 0.0, axis=1) | of_run
    if not of_step.all():  # else every row has a number of its own
        changes |= of_step
    block = np.empty(len(run), dtype=np.int64)
    block[in_files] = np.concatenate([[0], np.cumsum(changes)])[: len(run)]
    _, first, at = np.unique(block, return_index=True, return_inverse=True)
    _check_constant(collected, first[at], log)
    made = _means(collected, first, at, np.ones(len(at), dtype=bool))
    if len(np.unique(numbered(made, "run", "step"))) == len(made.table):
        return made
    anew = pa.array(np.arange(len(made.table)), type=made.table.schema.field("step").type)
    return replace(made, table=made.table.set_column(made.table.column_names.index("step"), "step", anew))


def _means(collected: CollectedRows, first: Index, at: Index, counts: Mask) -> CollectedRows:
    """Return the first rows (S,) of the steps, with means over the counted samples (N,) of each step ``at`` (N,)."""
    further = np.ones(len(at), dtype=bool)
    further[first] = False
    rows = without_rows(collected, further, "")
    table = rows.table
    for index, name in enumerate(table.column_names):
        if _is_averaged(collected.table, name):
            means = _sample_means(_sampled(collected, name), counts, at)
            table = table.set_column(index, name, pa.array(means[at[~further]], from_pandas=True))
    return replace(rows, table=table, left_out=collected.left_out)


def _is_averaged(table: pa.Table, name: str) -> bool:
    return name not in _OF_A_STEP and bool(pa.types.is_floating(table.schema.field(name).type))


def _with_reading(collected: CollectedRows, at: Index) -> Mask:
    """Return the mask (N,) of samples with a reading; all samples of a step without any, to keep its row."""
    is_finite = np.isfinite(numbers(collected, "reading"))
    return np.asarray(is_finite | (np.bincount(at, is_finite)[at] == 0.0), dtype=bool)


def _sampled(collected: CollectedRows, name: str) -> Array:
    """Return a column (N,) of numbers; an empty wrench component next to others is 0."""
    values = numbers(collected, name)
    return np.nan_to_num(values) if name in WRENCH else values


def _sample_means(values: Array, counts: Mask, at: Index) -> Array:
    """Return the means (S,) of known values (N,) over the counted samples; NaN where none is known."""
    known = np.isfinite(values) & counts
    count, total = np.bincount(at, known), np.bincount(at, np.where(known, values, 0.0))
    return np.divide(total, count, out=np.full(len(count), np.nan), where=count > 0)


def _check_samples(collected: CollectedRows, log: FaultLog) -> None:
    """Report samples without a load, or with an empty reading that is not declared missing."""
    names = collected.table.column_names
    six = [name for name in WRENCH if name in names]
    columns_given = [numbers(collected, name) for name in (six or ["load"] if "load" in names else six)]
    if columns_given:
        collected.fault(log, np.all(np.isnan(columns_given), axis=0), (six or ["load"])[0], EMPTY_LOAD)
    empty = np.asarray(collected.table.column("reading").is_null())
    collected.fault(log, empty & ~declared_missing(collected), "reading", _EMPTY_SAMPLE)


def _check_constant(collected: CollectedRows, first: Index, log: FaultLog) -> None:
    """Report samples whose text or whole number differs from the first sample of their step."""
    for name in collected.table.column_names:
        if name not in _OF_A_STEP and not _is_averaged(collected.table, name):
            reported = texts(collected, name)
            collected.fault(
                log, np.asarray(reported != reported[first], dtype=bool), name, f"one {name} for all samples of a step"
            )


def checked_steps(
    collected: CollectedRows, key: Sequence[str], loading: Loading, log: FaultLog, cure: str = ""
) -> tuple[CollectedRows, Array]:
    """Return the counted rows of load steps and their loads (N, 6); reports faulty keys, times, roles and loads."""
    collected = with_known_loads(without_transit(collected))
    check_unique_keys(collected, log, *key, cure=cure)
    check_times(collected, log)
    check_roles(collected, log)
    return collected, six_loads(collected, loading, log)
