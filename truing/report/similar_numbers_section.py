"""Section on similar numbers of a page with different meanings: errors of different quantities, and K by stage."""

from __future__ import annotations

from collections.abc import Iterator

import pandas as pd

from truing.report.calibration.calibrations import (
    calibration_name,
    figures_by_calibration,
    main_calibration,
    rows_of,
)
from truing.report.chain_corrections import nominal_errors
from truing.report.column_heads import Head
from truing.report.diagnosis.assessed_causes import accepted_of, assessed_causes, modelled_of
from truing.report.diagnosis.gain import compared_calibrations
from truing.report.diagnosis.prediction_errors import POINTS, errors_of_models, part_names, root_mean_square
from truing.report.numbers import plain, quantity, sign, with_uncertainty
from truing.report.page import Listing, ReportSection
from truing.report.tables import Tables, is_bench, table_or_none

_HEADS = (
    Head("section", "Section of this page that gives the number."),
    Head("quantity", "Exact definition of the number."),
    Head("over", "Data over which it is taken."),
    Head("value", "Number with its unit, and its uncertainty where it has one."),
)
_Row = tuple[str, str, str, str]
_ERRORS = "Errors: each row is a different quantity, so the values need not agree"
_SHAPES = "K by three estimates of one quantity: from different data, or with different free parameters"
_DEFORMATION = {"none": "without a model", "linear": "after the linear model", "matrix": "after the matrix model"}
_OF_BODY = {"none": "without a model", "linear": "after a model linear in the drives"}
_OF_BENCH = {"none": "without a model", "linear": "after a diagonal compliance", "matrix": "after a full compliance"}
_ESTIMATES = (
    Head("entry", "Entry of K: attachment that shifts, then actuator that moves it."),
    Head("diagnosis, with all causes", "Estimate from measured values, together with all causes found."),
    Head("deformation, of shifts alone", "Estimate from the measured shifts of the attachments alone."),
    Head(
        "calibration, with the geometry", "Estimate from measured poses, together with the parameters of the geometry."
    ),
)
_SHOWN = 3  # entries of K


def alike(tables: Tables) -> ReportSection | None:
    """Return the section; None where the page has at most one such number."""
    rows = (*_nominal(tables), *_predictions(tables), *_positions(tables), *_deformation(tables), *_calibrated(tables))
    errors = Listing(_HEADS, rows, caption=_ERRORS)
    entries = tuple(_entries(tables))
    listings = [errors] if len(rows) > 1 else []
    if entries:
        listings.append(Listing(_ESTIMATES, entries, caption=_SHAPES))
    if not listings:
        return None
    lead = "Numbers in the same unit are not always the same quantity. This section says what each of them is."
    return ReportSection("alike", "Similar quantities", lead, listings=tuple(listings))


def _predictions(tables: Tables) -> Iterator[_Row]:
    """Yield the errors of the predictions without and with the causes that were found."""
    rows, parts = assessed_causes(tables), part_names(tables)
    modelled = modelled_of(rows)
    for errors in errors_of_models(rows, modelled, tables) if rows else ():
        quantity = "measured minus predicted, rms"
        has_targets = not is_bench(tables) and "axis_errors" not in tables
        quantity = f"coordinates of targets, {quantity}" if has_targets else quantity
        over = parts.held_out if errors.held_out else parts.fitted
        for words, size in (("without causes", errors.before), ("with causes", errors.after))[0 if modelled else 1 :]:
            yield ("Before and after", f"{quantity}, {words}", over, f"{plain(size)} {sign(errors.unit)}")


def _nominal(tables: Tables) -> Iterator[_Row]:
    """Yield the error of a chain as its description has it, which the first screen gives next to that without
    causes."""
    errors = nominal_errors(tables)
    if errors is not None:
        compared_quantity = "coordinates of targets, measured minus predicted, rms, by the nominal geometry"
        yield ("Verdict", compared_quantity, errors.poses, quantity(errors.nominal, errors.unit))


def _positions(tables: Tables) -> Iterator[_Row]:
    """Yield the rms errors of the platform's position by the extended model and by plain calibrations."""
    errors = compared_calibrations(tables)
    if errors is None:
        return
    is_held_out = errors["role"].eq("verification")
    over = POINTS.held_out if is_held_out.any() else POINTS.fitted
    shown = errors[is_held_out] if is_held_out.any() else errors
    for name, rows in shown.groupby("called", sort=False):
        compared_quantity = f"position of the platform, rms distance of measured and predicted, {name}"
        yield ("Before and after", compared_quantity, over, quantity(root_mean_square(rows["position_error_um"]), "um"))


def _deformation(tables: Tables) -> Iterator[_Row]:
    """Yield the rms residuals of the models of the deformation."""
    errors = table_or_none(tables, "deformation_errors")
    if errors is None:
        return
    subject = errors["subject"] if "subject" in errors else errors["leg"]
    bench = is_bench(tables)
    is_whole = errors["figure"].eq("rms_error") & errors["leg"].isna()
    for row in errors.assign(body=subject)[is_whole & subject.notna() & (not bench)].itertuples():
        words = _OF_BODY.get(str(row.model), f"after model {row.model}")
        compared_quantity = f"residuals of rigid fits of {row.body}, rms, {words}"
        yield ("Deformation", compared_quantity, "all poses", quantity(float(str(row.value)), str(row.unit)))
    rows = errors[is_whole & subject.isna()]
    compared_quantity = "motion of the platform under load, rms" if bench else "shift of the attachments along z, rms"
    for row in rows.itertuples():
        words = (_OF_BENCH if bench else _DEFORMATION).get(str(row.model), f"after model {row.model}")
        over = "all load steps" if bench else "all poses"
        yield ("Deformation", f"{compared_quantity}, {words}", over, quantity(float(str(row.value)), str(row.unit)))


def _calibrated(tables: Tables) -> Iterator[_Row]:
    """Yield the mean errors of the platform's pose by the main calibration."""
    figures, key = figures_by_calibration(tables), main_calibration(tables)
    if figures is None or key is None or key not in figures.index:
        return
    facts = figures.loc[key]
    for name, unit in (("position", "um"), ("orientation", "arcsec")):
        size = facts.get(f"{name}_mean_verification")
        if size is not None and pd.notna(size):
            compared_quantity = f"{name} of the platform, mean size of the error vector, {calibration_name(key)}"
            yield ("Calibration", compared_quantity, "held-out poses", quantity(float(size), unit))


def _entries(tables: Tables) -> Iterator[tuple[str, ...]]:
    """Yield the largest entries of K by diagnosis, deformation and calibration, µm per mm."""
    named = [size for row in accepted_of(assessed_causes(tables)) for size in row.sizes_of("K")]
    shifts, fitted = table_or_none(tables, "deformation_models"), table_or_none(tables, "calibration")
    key = main_calibration(tables)
    if shifts is None or fitted is None or key is None:
        return
    names = shifts["leg"].astype(int).map("K{}".format) + shifts["column"].astype(int).astype(str)
    shifts, fitted = shifts[(shifts["model"] == "matrix")].assign(entry=names), rows_of(fitted, key)
    for size in sorted(named, key=lambda parameter_size: -abs(parameter_size.number or 0.0))[:_SHOWN]:
        similar = (
            _first(shifts[shifts["entry"] == size.name], "coefficient"),
            _first(fitted[fitted["parameter"] == size.name], "identified"),
        )
        if any(similar):
            yield (size.name, _entry(size.number, size.sigma), *similar)


def _first(rows: pd.DataFrame, column: str) -> str:
    return "" if rows.empty else _entry(float(rows[column].iloc[0]), float(rows["sigma"].iloc[0]))


def _entry(value: float | None, sigma: float | None) -> str:
    """Return an entry of K (mm per mm) with its standard deviation, in µm per mm."""
    return "" if value is None else with_uncertainty(1e3 * value, None if sigma is None else 1e3 * sigma, "µm/mm")
