"""The section of the calibrations: which model is chosen and why, how far each misses, what parameters it found."""

from __future__ import annotations

from typing import TYPE_CHECKING

from truing.report import calibration_figures
from truing.report.calibration_listing import all_calibrations, strong_correlations
from truing.report.calibration_words import cost_of_models, lead, method_words
from truing.report.calibrations import IMPLICIT, chosen_calibration, figures_by_calibration, rows_of, shown_calibration
from truing.report.geometry_figure import geometry_picture, has_geometry
from truing.report.numbers import plain
from truing.report.page import Listing, Section
from truing.report.parameter_listings import all_deviations, deviations
from truing.report.reasons import why_no_calibration
from truing.report.tables import Tables, filled

if TYPE_CHECKING:
    import pandas as pd

Drawn = list[tuple[object, str]]
_BY_DEFAULT, _AS_REPORTED = "by maximum likelihood", "by the implicit objectives of the telescope report"


def calibration(tables: Tables) -> Section | None:
    """The choice of the model, the errors of all calibrations, and their parameters."""
    if "calibration" not in tables:
        return None
    fitted = filled(tables, "calibration")
    if fitted is None:
        return Section("calibration", "Calibration", why_no_calibration(tables), state="not evaluated")
    shown = [*_errors(tables), *_geometry(tables, fitted), *_correlations(tables, fitted)]
    return Section("calibration", "Calibration", lead(tables, fitted), tuple(shown), tuple(_listings(tables, fitted)))


def _errors(tables: Tables) -> Drawn:
    accuracy = filled(tables, "accuracy")
    if accuracy is None:
        return []
    return [(calibration_figures.errors(accuracy, chosen_calibration(tables)), cost_of_models(tables))]


def _geometry(tables: Tables, fitted: pd.DataFrame) -> Drawn:
    own = fitted[fitted["model"] == shown_calibration(tables, fitted)[0]]
    if not has_geometry(own):
        return []
    return [(geometry_picture(own), _pull_words(own))]


def _pull_words(own: pd.DataFrame) -> str:
    if "pull" not in own or own["pull"].isna().all():
        return "The nearer to its nominal place, the less a joint had to bend to what is not modelled."
    rms = own["pull"].pow(2).groupby(own["deformation"], sort=False).mean() ** 0.5
    said = ", ".join(f"{name} {plain(value)}" for name, value in rms.items())
    return f"What a model leaves out, its geometry has to swallow. Rms pull of all parameters, in tolerances: {said}."


def _correlations(tables: Tables, fitted: pd.DataFrame) -> Drawn:
    table = filled(tables, "correlations")
    if table is None:
        return []
    key = shown_calibration(tables, fitted)
    own = rows_of(table, key)
    if not len(own):
        return []
    words = "Blocks along the diagonal: parameters of one leg, which the same readings have to tell apart."
    return [(calibration_figures.correlation_map(own, key), words)]


def _listings(tables: Tables, fitted: pd.DataFrame) -> list[Listing]:
    key = shown_calibration(tables, fitted)
    by_default, as_reported = figures_by_calibration(tables), figures_by_calibration(tables, IMPLICIT)
    listings = []
    if by_default is not None:
        listings.append(all_calibrations(by_default, fitted, f"All calibrations, {_BY_DEFAULT}"))
    if as_reported is not None:
        caption = f"The same {_AS_REPORTED}. {method_words(tables)}".strip()
        listings.append(all_calibrations(as_reported, filled(tables, "implicit_calibration"), caption, folded=True))
    listings += [deviations(fitted, key), *all_deviations(fitted, _BY_DEFAULT, "calibration.parquet")]
    reported = filled(tables, "implicit_calibration")
    if reported is not None:
        listings += all_deviations(reported, _AS_REPORTED, "implicit_calibration.parquet")
    table = filled(tables, "correlations")
    if table is not None:
        listings.append(strong_correlations(rows_of(table, key)))
    return [listing for listing in listings if listing.rows]
