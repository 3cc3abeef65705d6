"""Accuracy: the root mean square error in held-out poses, and of positioning along an axis; how far so few tell it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from truing.estimation.interferometry.iso230 import positioning_uncertainty
from truing.estimation.uncertainty_budget import Budget, Source, root_mean_square
from truing.stages.common.positioning import SEED, deviations, instrument
from truing.stages.uncertainty_statement.statement import Statement

if TYPE_CHECKING:
    import pyarrow as pa

    from truing.schemas.campaign import Campaign


LEAST_POSES = 2
_ERRORS = {"position_error_um": ("position, rms", "um"), "orientation_error_arcsec": ("orientation, rms", "arcsec")}
REPEATS = Source("repeated approaches", "A", distribution="drawn")
LENGTH = Source("expansion and temperature of the axis", "B", distribution="drawn")


def state_accuracy(statement: Statement, tables: Mapping[str, pa.Table], settings: Campaign) -> None:
    """State the rms error of every calibration that is quoted: the chosen one, and the extended model."""
    table = tables.get("accuracy")
    if table is None or not table.num_rows:
        if settings.mechanism.is_legged:
            statement.not_evaluated("accuracy", "all", "no model predicts where the platform is")
        return
    rows = [row for row in table.to_pylist() if row["role"] == "verification"]
    for key in _quoted(tables):
        own = [row for row in rows if (row["model"], row["deformation"]) == key]
        subject = f"{key[0]}, {key[1]} deformation, held-out poses"
        for column, (quantity, unit) in _ERRORS.items():
            errors = np.array([row[column] for row in own if row[column] is not None], float)
            if len(errors) < LEAST_POSES:
                why = f"needs {LEAST_POSES} poses that nothing was fitted to, found {len(errors)}"
                statement.not_evaluated("accuracy", quantity, why, subject)
                continue
            value, told = root_mean_square(errors)
            statement.state("accuracy", subject, [quantity], np.array([value]), unit, told)
    statement.omitted("accuracy", "places and conditions that were not measured", "it holds for poses like those taken")


def _quoted(tables: Mapping[str, pa.Table]) -> list[tuple[str, str]]:
    chosen = [
        (row["model"], row["deformation"])
        for row in tables["model_choice"].to_pylist()
        if (row["estimator"], row["figure"], row["value"]) == ("errors-in-variables", "chosen", 1.0)
    ]
    models, deformations = (tables["accuracy"].column(name).to_pylist() for name in ("model", "deformation"))
    keys = dict.fromkeys(zip(models, deformations, strict=True))
    return [*chosen, *(key for key in keys if key[0] == "extended")]


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
