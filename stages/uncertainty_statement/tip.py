"""Uncertainty of the predicted poses of a chain's tip."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa

from truing.estimation.uncertainty_budget import Budget, Source
from truing.stages.uncertainty_statement.causes import found_causes
from truing.stages.uncertainty_statement.statement import Statement

if TYPE_CHECKING:
    from truing.schemas.campaign import Campaign

_ENDS = {
    "approach-scatter": "the scatter of joints in the predicted pose itself",
    "base-drift": "it ends with the campaign, and the tip is relative to the base",
    "base-jump": "it ends with the campaign, and the tip is relative to the base",
}


def state_tip(statement: Statement, tables: Mapping[str, pa.Table], settings: Campaign) -> None:
    """State every component of the tip's predicted pose in the base, at poses of the campaign."""
    table = tables.get("tip_uncertainty")
    if table is None or not table.num_rows:
        return
    parts: dict[Source, dict[tuple[str, str], float]] = {}
    results: dict[tuple[str, str], dict[str, Any]] = {}
    for row in table.to_pylist():
        dof = row["degrees_of_freedom"]
        source = Source(row["input_source"], row["evaluation"], np.inf if dof is None else dof)
        key = row["pose"], row["quantity"]
        parts.setdefault(source, {})[key] = row["contribution"]
        results.setdefault(key, row)
    contributions = np.array([[part.get(key, 0.0) for key in results] for part in parts.values()])
    statement.state(
        "tip",
        [f"{row['body']} in {row['parent']}, pose {row['pose']}" for row in results.values()],
        [row["quantity"] for row in results.values()],
        np.array([row["estimate"] for row in results.values()], float),
        [row["unit"] for row in results.values()],
        Budget(tuple(parts), contributions),
    )
    statement.omitted("tip", "causes that were not found", "each budget holds for the model of the diagnosis")
    statement.omitted("tip", "temperature", "its readings count as exact")
    for name, cause in found_causes(tables).items():
        if cause in _ENDS:
            statement.omitted("tip", name, _ENDS[cause])
