"""The calibrations of a run side by side: their figures, which of them is chosen, and how they are called."""

from __future__ import annotations

import pandas as pd

from truing.report.tables import Tables, filled

Key = tuple[str, str]  # model, deformation
ERRORS_IN_VARIABLES, IMPLICIT, NOMINAL = "errors-in-variables", "implicit", "nominal"
TO_POINTS = "points"  # the extended model's estimator
DEFORMATIONS = ("none", "linear", "matrix")
EXTENDED = "extended"  # the model of the diagnosis, among those of the structure
_KEY = ["model", "deformation"]
_DEFORMATION_WORDS = {"none": "the deformation ignored", "linear": "linear deformation", "matrix": "matrix deformation"}


def figures_by_calibration(tables: Tables, estimator: str = ERRORS_IN_VARIABLES) -> pd.DataFrame | None:
    """A row per (model, deformation), a column per figure of ``model_choice``, in the order in which they come."""
    choice = filled(tables, "model_choice")
    if choice is None or not (choice["estimator"] == estimator).any():
        return None
    own = choice[choice["estimator"] == estimator]
    order = list(dict.fromkeys(zip(own["model"], own["deformation"], strict=True)))
    return own.pivot(index=_KEY, columns="figure", values="value").loc[order]


def chosen_calibration(tables: Tables) -> Key | None:
    """The model and deformation that the run recommends for this campaign; None where it could not choose."""
    figures = figures_by_calibration(tables)
    if figures is None or "chosen" not in figures or not (figures["chosen"] == 1.0).any():
        return None
    model, deformation = figures.index[figures["chosen"] == 1.0][0]
    return str(model), str(deformation)


def main_calibration(tables: Tables) -> Key | None:
    """The calibration whose results are quoted: the extended model where campaign.toml applies findings, else the
    chosen one."""
    extended = figures_by_calibration(tables, TO_POINTS)
    if extended is not None and "main" in extended and (extended["main"] == 1.0).any():
        model, deformation = extended.index[extended["main"] == 1.0][0]
        return str(model), str(deformation)
    return chosen_calibration(tables)


def shown_calibration(tables: Tables, table: pd.DataFrame) -> Key:
    """The calibration that is shown in full: the chosen one where the table has it, else the table's first."""
    keys = keys_of(table)
    chosen = chosen_calibration(tables)
    return chosen if chosen in keys else keys[0]


def keys_of(table: pd.DataFrame) -> list[Key]:
    """The calibrations that a table speaks of, in the order in which they come."""
    return list(dict.fromkeys(zip(table["model"].astype(str), table["deformation"].astype(str), strict=True)))


def rows_of(table: pd.DataFrame, key: Key) -> pd.DataFrame:
    """The rows of one calibration."""
    return table[(table["model"] == key[0]) & (table["deformation"] == key[1])]


def called(key: Key) -> str:
    """``the 6-pus model with matrix deformation``."""
    if key[0] == EXTENDED:
        return "the extended model of the diagnosis"
    model = "Jacobian" if key[0] == "jacobian" else key[0]
    return f"the {model} model with {deformation_words(key[1])}"


def deformation_words(deformation: str) -> str:
    """How a deformation model is called."""
    return _DEFORMATION_WORDS.get(deformation, deformation)


def in_order(deformations: pd.Series) -> list[str]:
    """Deformation models from the simplest on, then those that nobody expected."""
    found = list(dict.fromkeys(deformations.astype(str)))
    return [*(d for d in DEFORMATIONS if d in found), *(d for d in found if d not in DEFORMATIONS)]
