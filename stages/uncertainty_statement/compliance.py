"""Entries of the compliance: readings, loads, the geometry of the beams, and what corrections leave open."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from truing.estimation.interferometry.compliance_budget import budget_of_entries, compliance_budgets
from truing.estimation.interferometry.recorded_steps import CHANNELS, LOADS
from truing.estimation.uncertainty_budget import NOT_HELD, Budget, Source
from truing.stages.common.loaded_steps import loaded_steps
from truing.stages.common.nominal_sensor import simulated_compliance
from truing.stages.uncertainty_statement.found_causes import found_causes
from truing.stages.uncertainty_statement.statement import Statement

if TYPE_CHECKING:
    import pyarrow as pa

    from truing.schemas.campaign import Campaign

Array = NDArray[np.float64]

CORRECTED = Source("correction for air and material", "B")
_MODEL = "matrix"
_CLOSES = 1e-6


def state_compliance(statement: Statement, tables: Mapping[str, pa.Table], settings: Campaign) -> None:
    """State every entry that the readings tell, by the model in which every load may act on every component."""
    table = tables.get("compliance")
    if table is None or not table.num_rows:
        if settings.campaign.kind == "interferometer" and "positions" not in tables:
            statement.not_evaluated("compliance", "all", "no readings of displacement under load")
        return
    rows = [row for row in table.to_pylist() if row["model"] == _MODEL and row["sigma"]]
    if not rows:
        statement.not_evaluated("compliance", "all", "the loads do not tell it")
        return
    loaded = loaded_steps(tables, settings.noise, simulated_compliance(settings, tables.get("given_compliance")))
    declared = settings.noise.linear_um is not None and settings.noise.angular_arcsec is not None
    try:
        found = compliance_budgets(loaded, declared)
    except np.linalg.LinAlgError:  # one of the components is not determined by its own readings
        found = None
    places = [(CHANNELS.index(row["response"]), LOADS.index(row["load"])) for row in rows]
    whole = np.array([row["sigma"] for row in rows], float)
    told = None if found is None else budget_of_entries(found, loaded, places)
    if told is None or not np.allclose(told.standard, whole, rtol=_CLOSES):
        told = Budget((Source("fit as a whole: readings, loads and geometry", "A"),), whole[None])
    estimate = np.array([row["coefficient"] for row in rows], float)
    told = told.beside(CORRECTED, np.abs(estimate) * _corrected(tables)[[i for i, _ in places]])
    names, units = [f"{row['response']} per {row['load']}" for row in rows], [row["unit"] for row in rows]
    statement.state("compliance", "loads as written down", names, estimate, units, told.filled())
    _omit(statement, tables, settings)


def _corrected(tables: Mapping[str, pa.Table]) -> Array:
    """What corrections leave uncertain of each component (6,), as a share of its largest reading."""
    share = np.zeros(len(CHANNELS))
    if "reading_corrections" not in tables:
        return share
    readings = tables["readings"]
    channel = np.array(readings.column("channel").to_pylist(), object)
    value = np.abs(np.asarray(readings.column("reading").to_pylist(), float))
    for row in tables["reading_corrections"].to_pylist():
        if row["subject"] in CHANNELS and row["sigma"] is not None and (channel == row["subject"]).any():
            k = CHANNELS.index(row["subject"])
            share[k] = np.hypot(share[k], row["sigma"] / max(value[channel == row["subject"]].max(), 1e-30))
    return share


def _omit(statement: Statement, tables: Mapping[str, pa.Table], settings: Campaign) -> None:
    noise = settings.noise
    if not noise.load_n and not noise.load_nm:
        statement.omitted("compliance", "applied loads", "[noise] declares neither load_n nor load_nm")
    if "reading_corrections" not in tables or not tables["reading_corrections"].num_rows:
        why = "readings came corrected, and [interferometer] declares nothing of what that leaves open"
        statement.omitted("compliance", "wavelength, air and material", why)
    for name in found_causes(tables):
        statement.omitted("compliance", name, NOT_HELD)
