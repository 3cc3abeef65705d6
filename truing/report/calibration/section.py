"""The section of the calibrations: which model is chosen and why, how far each misses, what parameters it found."""

from __future__ import annotations

from typing import TYPE_CHECKING

from truing.report.calibration import figures as calibration_figures
from truing.report.calibration.calibrations import (
    ERRORS_IN_VARIABLES,
    IMPLICIT,
    TO_POINTS,
    chosen_calibration,
    figures_by_calibration,
    rows_of,
    shown_calibration,
)
from truing.report.calibration.geometry_figure import geometry_picture, has_geometry
from truing.report.calibration.listing import all_calibrations, strong_correlations
from truing.report.calibration.parameter_listings import all_deviations, deviations
from truing.report.calibration.words import cost_of_models, lead, method_words, tests_of_chosen
from truing.report.model_tests import listing_of, state_of
from truing.report.numbers import plain
from truing.report.page import Listing, Section
from truing.report.reasons import why_no_calibration
from truing.report.tables import Tables, filled

if TYPE_CHECKING:
    import pandas as pd

Drawn = list[tuple[object, str]]
_BY_DEFAULT, _AS_REPORTED = "by maximum likelihood", "by the implicit objectives"


def calibration(tables: Tables) -> Section | None:
    """The choice of the model, the errors of all calibrations, and their parameters."""
    if "calibration" not in tables:
        return None
    fitted = filled(tables, "calibration")
    if fitted is None:
        return Section("calibration", "Calibration", why_no_calibration(tables), state="not evaluated")
    shown = [*_errors(tables), *_geometry(tables, fitted), *_correlations(tables, fitted)]
    tests = tests_of_chosen(tables)
    listings = [listing_of(tests, "Tests of the chosen calibration"), *_listings(tables, fitted)]
    return Section("calibration", "Calibration", lead(tables, fitted), tuple(shown), tuple(listings), state_of(tests))


def _errors(tables: Tables) -> Drawn:
    accuracy = filled(tables, "accuracy")
    if accuracy is None:
        return []
    return [(calibration_figures.errors(accuracy, chosen_calibration(tables)), cost_of_models(tables))]


def _geometry(tables: Tables, fitted: pd.DataFrame) -> Drawn:
    """The picture of the chosen model of the structure: as the telescope report fits, and by maximum likelihood."""
    model = shown_calibration(tables, fitted)[0]
    fits = {_AS_REPORTED: filled(tables, "implicit_calibration"), _BY_DEFAULT: fitted}
    own = {name: table[table["model"] == model] for name, table in fits.items() if table is not None}
    own = {name: table for name, table in own.items() if has_geometry(table)}
    return [(geometry_picture(own), _pull_words(tables, model))] if own else []


def _pull_words(tables: Tables, model: str) -> str:
    said = "What a model leaves out, its geometry has to swallow, as far as tolerances and surveyed joints let it."
    for words, estimator in ((_AS_REPORTED, IMPLICIT), (_BY_DEFAULT, ERRORS_IN_VARIABLES)):
        figures = figures_by_calibration(tables, estimator)
        if figures is None or "rms_pull" not in figures or model not in figures.index.get_level_values("model"):
            continue
        pulls = figures.loc[model, "rms_pull"].dropna()
        if not len(pulls):
            continue
        said += f" Rms pull {words}: {', '.join(f'{d} {plain(pull)}' for d, pull in pulls.items())}."
    return said


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
    extended = figures_by_calibration(tables, TO_POINTS)
    if extended is not None:
        caption = "The extended model of the diagnosis, fitted to every point and all that was found"
        listings.append(all_calibrations(extended, fitted, caption))
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
