"""Positioning of an axis by ISO 230-2: commands that were repeated, approached from both sides."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa

from truing.arrays import Array, Index
from truing.estimation.interferometry.iso230 import positioning, positioning_uncertainty
from truing.report.numbers import count_text
from truing.simulation.axis.rows import ENCODERS, AxisRows
from truing.stages.common.axis_columns import SI, AxisColumns, columns_of, command_sigma, excluded_rows, targets_of
from truing.stages.common.evaluable_axis_stages import FEW_TARGETS, why_no_positioning
from truing.stages.common.positioning import SEED
from truing.stages.common.rows import Rows
from truing.stages.declaration import Outcome

if TYPE_CHECKING:
    from truing.schemas.campaign import Campaign

_DIRECTIONS = {1: "forward", -1: "backward"}
_FEWEST_TARGETS = 2
_OF_AXIS = {"R": "repeatability", "E": "systematic", "A": "accuracy"}
_BOTH = {
    "B": "reversal",
    "B_mean": "mean_reversal",
    "R": "bidirectional_repeatability",
    "E": "bidirectional_systematic",
    "M": "mean_deviation",
    "A": "bidirectional_accuracy",
}


def with_axis_positioning(outcome: Outcome, tables: Mapping[str, pa.Table], settings: Campaign, why: str) -> Outcome:
    """Return the outcome with the positioning of an axis; without rows where no command was repeated from both
    sides at rest, or where ``why`` gives a reason to withhold it."""
    table = tables.get("configurations")
    rows = Rows("positioning")
    if table is not None and table.num_rows and not why:
        columns = columns_of(settings, table)
        why = why_no_positioning(columns.rows(table, command_sigma(settings)))
        rows = rows if why else positioning_rows(table, columns, settings)
    left = {**outcome.artifacts, "positioning": rows.table("string")}
    if not rows.count:
        why = why or FEW_TARGETS
        return replace(outcome, artifacts=left, figure=f"not evaluated: {why}", why_not=why)
    runs = dict.fromkeys(rows.columns["run"])
    words = f"positioning by ISO 230-2 of {count_text(len(runs), 'reading')} of the axis: {', '.join(map(str, runs))}"
    return replace(
        outcome, artifacts=left, read=count_text(table.num_rows if table else 0, "row"), figure=words, why_not=""
    )


def positioning_rows(table: pa.Table, columns: AxisColumns, settings: Campaign) -> Rows:
    """Return all quantities, um or arcsec, for the outside instrument and for each encoder outside the loop.

    The first rows, before any movement, came from an unknown side and do not count.
    """
    off = command_sigma(settings)
    rows = columns.rows(table, off)
    unit, si = columns.reported_unit
    readings = columns.deviations(table) / si
    readings[excluded_rows(settings.exclude, rows) | (rows.travelled <= columns.axis(off).least_move)] = np.nan
    result, (target, group) = Rows("positioning"), targets_of(rows.command)
    shown = target / SI[columns.unit]
    for encoder in (name for name in reversed(ENCODERS) if name in columns.encoders and name != columns.loop):
        deviation = _arranged(readings[:, list(columns.encoders).index(encoder)], group, rows, len(target))
        is_complete = np.isfinite(deviation).any(-1).all(-1)
        if is_complete.sum() >= _FEWEST_TARGETS:
            names = [f"{at:.7g} {columns.unit}" for at in shown[is_complete]]  # commands are rounded in rad or m
            _add(result, encoder, names, deviation[is_complete], unit, target[is_complete] / si)
    return result


def _arranged(readings: Array, group: Index, rows: AxisRows, targets: int) -> Array:
    """Return readings (P, 2, C) by target, direction and approach, NaN where there are fewer approaches.

    Readings that follow each other at one target are one approach, with their mean: without a movement in between they
    show no repeatability.
    """
    in_time = np.argsort(rows.order, kind="stable")
    approach = np.empty(len(group), int)
    approach[in_time] = np.cumsum(np.diff(group[in_time], prepend=-1) != 0)
    cells = {}
    for index in np.ndindex(targets, 2):
        in_cell = (group == index[0]) & (rows.direction == tuple(_DIRECTIONS)[index[1]]) & np.isfinite(readings)
        _, number, count_of = np.unique(approach[in_cell], return_inverse=True, return_counts=True)
        cells[index] = np.bincount(number, readings[in_cell]) / count_of
    result = np.full((targets, 2, max(2, *(len(means) for means in cells.values()))), np.nan)
    for index, cell in cells.items():
        result[index][: len(cell)] = cell
    return result


def _add(rows: Rows, run: str, names: list[str], deviation: Array, unit: str, target: Array) -> None:
    """Add the quantities of targets and axis that the number of repeats determines."""
    found = positioning(deviation)
    repeats = np.isfinite(deviation).sum(-1)

    def add(figure: str, subject: str | None, value: float, **more: float) -> None:
        if np.isfinite(value):
            unit_of_figure = "1" if figure.startswith("n_") else unit
            rows.add(run=run, figure=figure, subject=subject, value=float(value), unit=unit_of_figure, **more)

    for index, name in enumerate(names):
        for direction_index, words in enumerate(_DIRECTIONS.values()):
            add(f"mean_{words}", name, found.mean[index, direction_index])
            add(f"s_{words}", name, found.scatter[index, direction_index])
            add(f"R_{words}", name, found.repeatability_at[index, direction_index])
            add(f"n_{words}", name, float(repeats[index, direction_index]))
        add("B", name, found.reversal_at[index])
        add("R", name, found.bidirectional_at[index])
    for direction_index, words in enumerate(_DIRECTIONS.values()):
        for symbol, field in _OF_AXIS.items():
            add(f"{symbol}_{words}", None, getattr(found, field)[direction_index])
    known = {}
    if repeats.min() > 1:
        known = positioning_uncertainty(deviation, target, np.random.default_rng(SEED))
    for symbol, field in _BOTH.items():
        known_as = known.get(symbol)
        more = {} if known_as is None else {"sigma": known_as.sigma, "low": known_as.low, "high": known_as.high}
        add(symbol, None, float(getattr(found, field)), **more)
