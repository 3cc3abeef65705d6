"""Uncertainty of the causes that were found, by source, and its part in other results."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa

from truing.arrays import TableRow
from truing.estimation.uncertainty_budget import Budget, Source
from truing.simulation.catalogue import catalogue, catalogue_of_photographed_points, catalogue_of_rays
from truing.simulation.cause import Step
from truing.stages.uncertainty_statement.statement import Statement

if TYPE_CHECKING:
    from truing.schemas.campaign import Campaign

Parts = dict[tuple[str, str, str], dict[Source, float]]  # by cause, subject and parameter
_BEYOND = Source("shape of the likelihood, and what else may be concerned", "A")
_WHOLE = Source("fit of the diagnosis as a whole", "A")
_SMALL = 1e-3  # of an uncertainty: no part of its own
DEFORMATION = "platform-deformation"


def state_causes(statement: Statement, tables: Mapping[str, pa.Table], settings: Campaign) -> None:
    """State each parameter of each found cause."""
    table = tables.get("diagnosis")
    if table is None or not table.num_rows:
        statement.not_evaluated("cause", "all", "the diagnosis was not evaluated")
        return
    rows = table.to_pylist()
    found_rows = [row for row in rows if row["verdict"] == "found" and row["cause"] != "unexplained"]
    open_ = [row for row in rows if row["cause"] == "unexplained" and row["verdict"] not in (None, "rejected")]
    if not found_rows:
        none = "no cause of the catalogue was found, and so none has a size"
        unnamed = "; effects without a name have theirs in the section Diagnosis" if open_ else ""
        statement.not_evaluated("cause", "all", f"{none}{unnamed}")
    parts = _parts(tables.get("cause_uncertainty"))
    for row in found_rows:
        _state_cause(statement, row, parts)
    for row in open_:
        statement.omitted("cause", f"unexplained, {row['subject'] or 'everywhere'}", str(row["explanation"]))
    if found_rows:
        statement.omitted("cause", "which cause it is", "each budget holds if the cause is the one that was named")


def _parts(table: pa.Table | None) -> Parts:
    parts: Parts = {}
    for row in [] if table is None else table.to_pylist():
        dof = row["degrees_of_freedom"]
        source = Source(row["input_source"], row["evaluation"], np.inf if dof is None else dof)
        key = row["cause"], row["subject"] or "", row["parameter"]
        parts.setdefault(key, {})[source] = row["contribution"]
    return parts


def _state_cause(statement: Statement, row: TableRow, parts: Parts) -> None:
    cause, concerned = row["cause"], row["subject"] or ""
    subject = f"{cause} {concerned}".strip()
    parameters = json.loads(row["parameters"] or "{}")
    reported = {
        name: parameter
        for name, parameter in parameters.items()
        if isinstance(parameter, dict) and parameter.get("sigma") is not None
    }
    for name in parameters.keys() - reported.keys():
        statement.not_evaluated("cause", name, "it is no measured number, or nothing bounds it", subject)
    for name, one in reported.items():
        budget = _budget_of_cause(parts.get((cause, concerned, name), {}), float(one["sigma"]))
        statement.state("cause", subject, [name], np.array([float(one["value"])]), [one["unit"]], budget)


def _budget_of_cause(parts: Mapping[Source, float], total_variance: float) -> Budget:
    """Return the budget of one parameter; variance beyond the named sources is a source of its own."""
    total = float(np.linalg.norm(list(parts.values()))) if parts else 0.0
    if not total > 0.0:
        return Budget((_WHOLE,), np.array([[total_variance]]))
    parts_within = {source: part * min(1.0, total_variance / total) for source, part in parts.items()}
    if total_variance > total * (1.0 + _SMALL):
        parts_within[_BEYOND] = float(np.sqrt(total_variance**2 - total**2))
    return Budget(tuple(parts_within), np.array(list(parts_within.values()))[:, None])


def found_causes(tables: Mapping[str, pa.Table]) -> dict[str, str]:
    """Return the found causes in words, by id."""
    table = tables.get("diagnosis")
    rows = [row for row in table.to_pylist() if row["verdict"] == "found"] if table is not None else []
    return {f"{row['cause']} {row['subject'] or ''}".strip(): row["cause"] for row in rows}


def of_instrument(cause: str) -> bool:
    """Return True if a cause, by id, changes the recorded points and so all poses."""
    known = (catalogue() | catalogue_of_photographed_points() | catalogue_of_rays()).get(cause)
    return known is not None and known.step is Step.INSTRUMENT
