"""Held-out accuracy: the root mean square error in poses that nothing was fitted to, and how far so few tell it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from stages.uncertainty_statement.statement import Statement
from truing.estimation.uncertainty_budget import Budget, Source

if TYPE_CHECKING:
    import pyarrow as pa

    from schemas.campaign import Campaign

Array = NDArray[np.float64]

LEAST_POSES = 2
_ERRORS = {"position_error_um": ("position, rms", "um"), "orientation_error_arcsec": ("orientation, rms", "arcsec")}


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


def root_mean_square(errors: Array) -> tuple[float, Budget]:
    """The root mean square of N errors and its budget: the scatter of their squares, of N - 1 degrees of freedom."""
    squares = errors**2
    value = float(np.sqrt(np.mean(squares)))
    spread = float(np.std(squares, ddof=1) / np.sqrt(len(squares)))
    own = spread / (2.0 * value) if value > 0.0 else 0.0
    source = Source("scatter from pose to pose, noise of the measurement included", "A", float(len(errors) - 1))
    return value, Budget((source,), np.array([[own]]))


def _quoted(tables: Mapping[str, pa.Table]) -> list[tuple[str, str]]:
    chosen = [
        (row["model"], row["deformation"])
        for row in tables["model_choice"].to_pylist()
        if (row["estimator"], row["figure"], row["value"]) == ("errors-in-variables", "chosen", 1.0)
    ]
    models, deformations = (tables["accuracy"].column(name).to_pylist() for name in ("model", "deformation"))
    keys = dict.fromkeys(zip(models, deformations, strict=True))
    return [*chosen, *(key for key in keys if key[0] == "extended")]
