"""Uncertainty of the identified numbers of a chain, and of the predicted poses of its tip."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa

from truing.arrays import TableRow
from truing.estimation.uncertainty_budget import Budget, Source
from truing.stages.uncertainty_statement.causes import found_causes
from truing.stages.uncertainty_statement.statement import Statement

if TYPE_CHECKING:
    from truing.schemas.campaign import Campaign

_ONE_MODEL = "each budget holds for the model of the diagnosis"
_ENDS = {
    "approach-scatter": "the scatter of joints in the predicted pose itself",
    "base-drift": "it ends with the campaign, and the tip is relative to the base",
    "base-jump": "it ends with the campaign, and the tip is relative to the base",
}


def state_chain(statement: Statement, tables: Mapping[str, pa.Table], settings: Campaign) -> None:
    """State every identified number of the chain that the data determine."""
    numbers, parts = (tables.get(name) for name in ("chain_parameters", "chain_uncertainty"))
    if numbers is None or parts is None or not numbers.num_rows:
        return
    rows = {(row["joint"], row["parameter"]): row for row in numbers.to_pylist()}
    determined = {key: row["identified"] for key, row in rows.items() if row["identifiable"]}
    known = [row for row in parts.to_pylist() if (row["joint"], row["parameter"]) in determined]
    _state(statement, "chain", ("joint", "parameter"), known, determined)
    for joint, parameter in (key for key in rows if key not in determined):
        statement.not_evaluated("chain", parameter, "the data do not determine it beyond its tolerance", joint)
    statement.omitted("chain", "causes that were not found", _ONE_MODEL)


def state_tip(statement: Statement, tables: Mapping[str, pa.Table], settings: Campaign) -> None:
    """State every component of the tip's predicted pose in the base, at poses of the campaign."""
    table = tables.get("tip_uncertainty")
    if table is None or not table.num_rows:
        return
    rows = [row | {"subject": f"{row['body']} in {row['parent']}, pose {row['pose']}"} for row in table.to_pylist()]
    estimates = {(row["subject"], row["quantity"]): row["estimate"] for row in rows}
    _state(statement, "tip", ("subject", "quantity"), rows, estimates)
    statement.omitted("tip", "causes that were not found", _ONE_MODEL)
    statement.omitted("tip", "temperature", "its readings are taken as exact")
    for name, cause in found_causes(tables).items():
        if cause in _ENDS:
            statement.omitted("tip", name, _ENDS[cause])


def _state(
    statement: Statement,
    result: str,
    columns: tuple[str, str],
    rows: Sequence[TableRow],
    estimates: Mapping[tuple[str, str], float],
) -> None:
    """State results named by two columns, subject and quantity, from rows of one contribution each."""
    parts: dict[Source, dict[tuple[str, str], float]] = {}
    units: dict[tuple[str, str], str] = {}
    for row in rows:
        dof, key = row["degrees_of_freedom"], (row[columns[0]], row[columns[1]])
        source = Source(row["input_source"], row["evaluation"], np.inf if dof is None else dof)
        parts.setdefault(source, {})[key] = row["contribution"]
        units[key] = row["unit"]
    if not units:
        return
    statement.state(
        result,
        [subject for subject, _ in units],
        [quantity for _, quantity in units],
        np.array([estimates[key] for key in units], float),
        list(units.values()),
        Budget(tuple(parts), np.array([[part.get(key, 0.0) for key in units] for part in parts.values()])),
    )
