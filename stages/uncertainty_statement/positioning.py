"""Positioning of an axis by ISO 230-2: what few cycles leave open, and what the axis' temperature does.

The quantities are extremes of noisy means; their distribution is drawn (JCGM 101:2008), and so is the interval.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from stages.responses.axis_positioning import SEED, deviations, instrument
from stages.uncertainty_statement.statement import Statement
from truing.estimation.interferometry.iso230 import positioning_uncertainty
from truing.estimation.uncertainty_budget import Budget, Source

if TYPE_CHECKING:
    import pyarrow as pa

    from schemas.campaign import Campaign

REPEATS = Source("repeated approaches", "A", distribution="drawn")
LENGTH = Source("expansion and temperature of the axis", "B", distribution="drawn")


def state_positioning(statement: Statement, tables: Mapping[str, pa.Table], settings: Campaign) -> None:
    """State the quantities of the axis that the table has an uncertainty of."""
    table, measured, optics = tables.get("positioning"), tables.get("positions"), settings.interferometer
    if table is None or measured is None:
        return
    stated = set(table.column("run").to_pylist())
    for run in dict.fromkeys(measured.column("run").to_pylist()):
        if run not in stated:
            statement.not_evaluated("positioning", "all", "a quality check of the run failed", f"run {run}")
    if not stated:
        return
    rows = [row for row in table.to_pylist() if row["subject"] is None]
    for run in dict.fromkeys(row["run"] for row in rows):
        own = [row for row in rows if row["run"] == run and row.get("sigma") is not None]
        if not own:
            statement.not_evaluated("positioning", "all", "too few cycles tell no uncertainty", f"run {run}")
            continue
        taken = measured.filter([str(name) == str(run) for name in measured.column("run").to_pylist()])
        target, deviation = deviations(taken)
        # the same draws without what the instrument leaves open
        repeated = positioning_uncertainty(deviation, target * 1e3, np.random.default_rng(SEED))
        whole = np.array([row["sigma"] for row in own], float)
        by_repeats = np.minimum([repeated[row["figure"]].sigma for row in own], whole)
        told = Budget((REPEATS,), by_repeats[None])
        if instrument(taken, optics).stretch > 0.0:
            told = told.beside(LENGTH, np.sqrt(whole**2 - by_repeats**2))
        half = np.array([max(row["high"] - row["value"], row["value"] - row["low"]) for row in own], float)
        estimate = np.array([row["value"] for row in own], float)
        statement.state("positioning", f"run {run}", [row["figure"] for row in own], estimate, "um", told, half)
    why = "nothing in campaign.toml declares it for positions of an axis"
    statement.omitted("positioning", "wavelength and device, alignment of the beam, drift in a cycle", why)
