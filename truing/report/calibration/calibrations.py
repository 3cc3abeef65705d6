"""Access to the calibrations of a run: figures by model, the chosen one, and names."""

from __future__ import annotations

import pandas as pd

from truing.report.tables import Tables, table_or_none

Key = tuple[str, str]  # model, deformation
ERRORS_IN_VARIABLES, IMPLICIT, NOMINAL = "errors-in-variables", "implicit", "nominal"
TO_POINTS = "points"  # the extended model's estimator
DEFORMATIONS = ("none", "linear", "matrix", "in-plane")
EXTENDED = "extended"  # the model of the diagnosis, among those of the structure
_KEY = ["model", "deformation"]
_DEFORMATION_WORDS = {
    "none": "the deformation ignored",
    "linear": "linear deformation",
    "matrix": "matrix deformation",
    "in-plane": "matrix deformation along z, x and y",
}


def figures_by_calibration(tables: Tables, estimator: str = ERRORS_IN_VARIABLES) -> pd.DataFrame | None:
    """Return a row per (model, deformation) and a column per figure of ``model_choice``, in the order of the table."""
    choice = table_or_none(tables, "model_choice")
    if choice is None:
        return None
    of_estimator = choice[choice["estimator"] == estimator]
    rows: dict[Key, dict[str, float]] = {}
    for model, deformation, figure, value in zip(
        *(of_estimator[name] for name in (*_KEY, "figure", "value")), strict=True
    ):
        rows.setdefault((model, deformation), {})[figure] = value
    if not rows:
        return None
    names = sorted({name for row in rows.values() for name in row})
    return pd.DataFrame(list(rows.values()), pd.MultiIndex.from_tuples(rows, names=_KEY), names)


def chosen_calibration(tables: Tables) -> Key | None:
    """Return the recommended model and deformation; None where the run could not choose."""
    figures = figures_by_calibration(tables)
    if figures is None or "chosen" not in figures or not (figures["chosen"] == 1.0).any():
        return None
    model, deformation = figures.index[figures["chosen"] == 1.0][0]
    return str(model), str(deformation)


def main_calibration(tables: Tables) -> Key | None:
    """Return the calibration whose results are quoted: the extended model if campaign.toml applies findings, else the
    chosen one."""
    extended = figures_by_calibration(tables, TO_POINTS)
    if extended is not None and "main" in extended and (extended["main"] == 1.0).any():
        model, deformation = extended.index[extended["main"] == 1.0][0]
        return str(model), str(deformation)
    return chosen_calibration(tables)


def displayed_calibration(tables: Tables, table: pd.DataFrame) -> Key:
    """Return the calibration shown in full: the chosen one if the table has it, else the table's first."""
    keys = keys_of(table)
    chosen = chosen_calibration(tables)
    return chosen if chosen in keys else keys[0]


def keys_of(table: pd.DataFrame) -> list[Key]:
    """Return the calibrations in a table, in its order."""
    return list(dict.fromkeys(zip(table["model"].astype(str), table["deformation"].astype(str), strict=True)))


def rows_of(table: pd.DataFrame, key: Key) -> pd.DataFrame:
    """Return the rows of one calibration."""
    return table[(table["model"] == key[0]) & (table["deformation"] == key[1])]


def calibration_name(key: Key) -> str:
    """Return the name of a calibration: ``the 6-pus model with matrix deformation``."""
    if key[0] == EXTENDED:
        return "the extended model of the diagnosis"
    model = "Jacobian" if key[0] == "jacobian" else key[0]
    return f"the {model} model with {deformation_words(key[1])}"


def deformation_words(deformation: str) -> str:
    """Return the name of a deformation model in words."""
    return _DEFORMATION_WORDS.get(deformation, deformation)


def in_order(deformations: pd.Series) -> list[str]:
    """Return deformation models from the simplest on, then unknown ones."""
    present = list(dict.fromkeys(deformations.astype(str)))
    return [*(d for d in DEFORMATIONS if d in present), *(d for d in present if d not in DEFORMATIONS)]
