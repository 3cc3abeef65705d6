"""Uncertainty of the mechanism's parameters, of errors in held-out poses and along an axis."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa

from truing.arrays import TableRow
from truing.calibration.parameter_information import parameter_budget, refitted_calibration
from truing.estimation.interferometry.iso230 import positioning_uncertainty
from truing.estimation.uncertainty_budget import NOT_HELD, Budget, Source, budget, root_mean_square
from truing.stages.common.calibration_data import assemble
from truing.stages.common.positioning import SEED, deviations, instrument
from truing.stages.uncertainty_statement.causes import DEFORMATION, found_causes
from truing.stages.uncertainty_statement.statement import Statement

if TYPE_CHECKING:
    from truing.schemas.campaign import Campaign

_CLOSES = 1e-3  # relative: a fit from where the first one ended ends there again, within its own tolerance
LEAST_POSES = 2
_ERRORS = {"position_error_um": ("position, rms", "um"), "orientation_error_arcsec": ("orientation, rms", "arcsec")}
REPEATS = Source("repeated approaches", "A", distribution="drawn")
LENGTH = Source("expansion and temperature of the axis", "B", distribution="drawn")


def state_calibration(statement: Statement, tables: Mapping[str, pa.Table], settings: Campaign) -> None:
    """State every identified number of the chosen calibration."""
    if not settings.mechanism.is_legged:
        return
    keys = _main(tables) if "calibration" in tables else []
    if not keys:
        statement.not_evaluated("calibration", "all", "no calibration was made, or none could be chosen")
        return
    key = keys[0]
    rows = [row for row in tables["calibration"].to_pylist() if (row["model"], row["deformation"]) == key]
    names = [_name(row["parameter"], row["leg"], row.get("effect_of")) for row in rows]
    effects = {row.get("effect_of") for row in rows}
    reported = [row["sigma"] is not None and row["identified"] is not None for row in rows]
    sigma = np.array([row["sigma"] if known else 0.0 for row, known in zip(rows, reported, strict=True)], float)
    parts = _budget(tables, settings, key, rows)
    if parts is None or not np.allclose(parts.standard, sigma, rtol=_CLOSES):
        parts = Budget((Source("fit as a whole: poses, readings and tolerances", "B"),), sigma[None])
    subject = f"{key[0]}, {key[1]} deformation"
    indices = np.flatnonzero(reported)
    statement.state(
        "calibration",
        subject,
        [names[i] for i in indices],
        np.array([rows[i]["identified"] for i in indices], float),
        [rows[i]["unit"] for i in indices],
        Budget(parts.sources, parts.contributions[:, indices]),
    )
    for i in np.flatnonzero(~np.array(reported, bool)):
        statement.not_evaluated("calibration", names[i], "the data do not determine it", subject)
    statement.omitted("calibration", "the choice of the model", "each budget holds for the model that was chosen")
    for name, cause in found_causes(tables).items():
        if name not in effects and not (cause.startswith(DEFORMATION) and key[1] != "none"):
            statement.omitted("calibration", name, NOT_HELD)


def _chosen_calibration(tables: Mapping[str, pa.Table]) -> list[tuple[str, str]]:
    """Return model and deformation of the chosen calibration."""
    rows = tables["model_choice"].to_pylist() if "model_choice" in tables else []
    wanted = ("errors-in-variables", "chosen", 1.0)
    return [(r["model"], r["deformation"]) for r in rows if (r["estimator"], r["figure"], r["value"]) == wanted]


def _main(tables: Mapping[str, pa.Table]) -> list[tuple[str, str]]:
    """Return model and deformation of the reported calibration: the extended model if findings are applied."""
    rows = tables["model_choice"].to_pylist() if "model_choice" in tables else []
    return [(r["model"], r["deformation"]) for r in rows if r["figure"] == "main"] or _chosen_calibration(tables)


def _name(parameter: str, leg: int | None, effect: str | None) -> str:
    name = parameter if leg is None else f"{parameter} of leg {leg}"
    return name if effect is None else f"{name}, {effect}"


def _budget(
    tables: Mapping[str, pa.Table], settings: Campaign, key: tuple[str, str], rows: list[TableRow]
) -> Budget | None:
    """Return the budget of the parameters in table units; None if the calibration cannot be repeated."""
    identified = {(row["parameter"], row["leg"]): row["identified"] for row in rows}
    try:
        refitted = refitted_calibration(assemble(tables, settings), key, identified)
        if refitted is None:
            return None
        found = parameter_budget(refitted)
    except (ValueError, np.linalg.LinAlgError):
        return None
    parameters = refitted.estimation.problem.parameters
    return budget(found, np.eye(len(parameters), len(refitted.fit.values))).scaled(1.0 / parameters.units)


def state_accuracy(statement: Statement, tables: Mapping[str, pa.Table], settings: Campaign) -> None:
    """State the rms error of the chosen calibration and of the extended model."""
    table = tables.get("accuracy")
    if table is None or not table.num_rows:
        if settings.mechanism.is_legged:
            statement.not_evaluated("accuracy", "all", "no model predicts where the platform is")
        return
    rows = [row for row in table.to_pylist() if row["role"] == "verification"]
    for key in _quoted(tables):
        rows_of_model = [row for row in rows if (row["model"], row["deformation"]) == key]
        subject = f"{key[0]}, {key[1]} deformation, held-out poses"
        for column, (quantity, unit) in _ERRORS.items():
            errors = np.array([row[column] for row in rows_of_model if row[column] is not None], float)
            if len(errors) < LEAST_POSES:
                why = f"needs {LEAST_POSES} held-out poses, found {len(errors)}"
                statement.not_evaluated("accuracy", quantity, why, subject)
                continue
            value, stated = root_mean_square(errors)
            statement.state("accuracy", subject, [quantity], np.array([value]), unit, stated)
    statement.omitted(
        "accuracy", "places and conditions that were not measured", "the figures hold for poses like the measured ones"
    )


def _quoted(tables: Mapping[str, pa.Table]) -> list[tuple[str, str]]:
    models, deformations = (tables["accuracy"].column(name).to_pylist() for name in ("model", "deformation"))
    keys = dict.fromkeys(zip(models, deformations, strict=True))
    return [*_chosen_calibration(tables), *(key for key in keys if key[0] == "extended")]


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
        rows_of_run = [row for row in rows if row["run"] == run and row.get("sigma") is not None]
        if not rows_of_run:
            statement.not_evaluated("positioning", "all", "too few cycles for an uncertainty", f"run {run}")
            continue
        rows_measured = measured.filter([str(name) == str(run) for name in measured.column("run").to_pylist()])
        target, deviation = deviations(rows_measured)
        # the same draws without what the instrument leaves open
        repeated = positioning_uncertainty(deviation, target * 1e3, np.random.default_rng(SEED))
        sigma = np.array([row["sigma"] for row in rows_of_run], float)
        by_repeats = np.minimum([repeated[row["figure"]].sigma for row in rows_of_run], sigma)
        reported = Budget((REPEATS,), by_repeats[None])
        if instrument(rows_measured, optics).stretch > 0.0:
            reported = reported.with_source(LENGTH, np.sqrt(sigma**2 - by_repeats**2))
        half = np.array([max(row["high"] - row["value"], row["value"] - row["low"]) for row in rows_of_run], float)
        estimate = np.array([row["value"] for row in rows_of_run], float)
        statement.state(
            "positioning", f"run {run}", [row["figure"] for row in rows_of_run], estimate, "um", reported, half
        )
    why = "nothing in campaign.toml declares it for positions of an axis"
    statement.omitted("positioning", "wavelength and device, alignment of the beam, drift in a cycle", why)
