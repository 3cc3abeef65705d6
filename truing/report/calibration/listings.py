"""Listings of calibrations: comparison of all, parameters leg by leg, and strong correlations."""

from __future__ import annotations

from typing import Any

import pandas as pd

from truing.report.calibration.calibrations import Key, calibration_name, deformation_words, in_order, keys_of, rows_of
from truing.report.column_heads import DEFORMATION, MODEL_OF_LEGS, PARAMETER, Head, leg_head
from truing.report.numbers import p_value, plain, with_uncertainty
from truing.report.page import Listing
from truing.report.parameter_names import MEANING, UNBROKEN, kind_of, name_of, print_unit
from truing.report.tables import Row, cell

GOOD = ("ok", "converged")
_HEADS = (
    Head("choice", "Marks the calibration that is chosen, those that are as good, and fits that failed."),
    MODEL_OF_LEGS,
    DEFORMATION,
    Head("fitted (µm)", "Mean / maximum distance between measured and predicted position, at the fitted poses."),
    Head(
        "(arcsec)",
        "Mean / maximum angle between measured and predicted orientation, at the fitted poses.",
    ),
    Head("held out (µm)", "Mean / maximum distance between measured and predicted position, at the held-out poses."),
    Head(
        "(arcsec)",
        "Mean / maximum angle between measured and predicted orientation, at the held-out poses.",
    ),
    Head("held out / noise", "Error at the held-out poses over that of noise alone; 1: noise alone."),
    Head("p", "Probability that noise alone gives held-out errors at least this large."),
    Head("rms pull", "Root mean square of the pulls of all parameters; 1 if they agree with their tolerances."),
    Head("χ² / freedom", "Sum of the squared weighted residuals / degrees of freedom of the fit."),
)
_ERRORS = "Errors: mean / maximum. p: probability of the held-out errors by chance. Equal: as good as the chosen one"
_SAID = {"chosen": "chosen", "indistinguishable": "equal"}
_MARKS = {"": "", "chosen": "pass", "equal": "none"}
_STRONG = 0.9
_ALL_LEGS = Head("all legs", "Value of a parameter that belongs to no single leg.")
_OPEN = 12

_CELL = "Identified − nominal ± one standard deviation; in brackets the pull: that shift over its expected size."
_BENT = ("K", "kappa")
_STAR = "*: the data determine it no better than its tolerance."
_MEASURED = "κ and K: as identified."


def all_calibrations(figures: pd.DataFrame, fitted: pd.DataFrame | None, caption: str, folded: bool = False) -> Listing:
    """Return a row per model and deformation: errors (mean / maximum) at fitted and held-out poses, and goodness of
    fit."""
    ended = _status(fitted)
    rows = tuple(_row(key, dict(row), ended.get(key, "")) for key, row in figures.iterrows())
    marks = tuple(_MARKS.get(row[0], "warn") for row in rows)
    return Listing(_HEADS, rows, marks, f"{caption}. {_ERRORS}", folded, "model_choice.parquet")


def _status(fitted: pd.DataFrame | None) -> dict[object, str]:
    if fitted is None or "status" not in fitted:
        return {}
    return {key: str(status) for key, status in fitted.groupby(["model", "deformation"])["status"].first().items()}


def _row(key: Any, figures: dict[str, float], status: str) -> tuple[str, ...]:
    chosen = next((word for name, word in _SAID.items() if figures.get(name) == 1.0), "")
    ended = status if status and status not in GOOD else ""
    pairs = [
        f"{plain(figures.get(f'{kind}_mean_{role}'))} / {plain(figures.get(f'{kind}_max_{role}'))}".replace(
            " ", UNBROKEN
        )
        for role in ("calibration", "verification")
        for kind in ("position", "orientation")
    ]
    return (
        ended or chosen,
        *key,
        *pairs,
        plain(figures.get("heldout_ratio")),
        p_value(figures.get("p_value")).replace(" ", UNBROKEN),
        plain(figures.get("rms_pull")),
        f"{plain(figures.get('chi_square'))} / {plain(figures.get('freedom'))}",
    )


def strong_correlations(correlations: pd.DataFrame) -> Listing:
    """Return pairs of correlated parameters, the strongest first."""
    strong = correlations[correlations["correlation"].abs() >= _STRONG]
    strong = strong.sort_values("correlation", key=lambda r: -r.abs(), kind="stable")
    rows = tuple(
        (name_of(r.parameter, r.leg), name_of(r.other_parameter, r.other_leg), f"{r.correlation:+.3f}")
        for r in strong.itertuples()
    )
    caption = f"Correlations of {_STRONG:g} and more: only the sum or the difference of the two is well known"
    heads = (
        PARAMETER,
        Head("with", "Other parameter of the pair."),
        Head("correlation", "Correlation of the errors of both parameters, from −1 to 1."),
    )
    return Listing(heads, rows, caption=caption, folded=len(rows) > _OPEN, held_by="correlations.parquet")


def deviations(fitted: pd.DataFrame, key: Key) -> Listing:
    """Return the parameters of one calibration, rows by kind and columns by leg."""
    fitted_rows = rows_of(fitted, key)
    star = f" {_STAR}" if not _identifiable(fitted_rows).all() else ""
    measured = f" {_MEASURED}" if fitted_rows["parameter"].str.startswith(_BENT).any() else ""
    caption = f"Parameters of {calibration_name(key)}. {_CELL}{star} {MEANING}{measured}"
    heads, rows = _by_leg(fitted_rows)
    return Listing((PARAMETER, *heads), rows, caption=caption, held_by="calibration.parquet")


def all_deviations(fitted: pd.DataFrame, method: str, held_by: str) -> list[Listing]:
    """Return a folded listing per deformation model with all models of the structure."""
    return [_of_deformation(fitted, d, method, held_by) for d in in_order(fitted["deformation"])]


def _of_deformation(fitted: pd.DataFrame, deformation: str, method: str, held_by: str) -> Listing:
    of_deformation = fitted[fitted["deformation"] == deformation]
    heads, _ = _by_leg(of_deformation)
    rows = [
        (model, *row)
        for model, deformation in keys_of(of_deformation)
        for row in _by_leg(rows_of(of_deformation, (model, deformation)), heads)[1]
    ]
    caption = f"All parameters with {deformation_words(deformation)}, {method}"
    return Listing((MODEL_OF_LEGS, PARAMETER, *heads), tuple(rows), caption=caption, folded=True, held_by=held_by)


def _by_leg(
    parameters: pd.DataFrame, heads: tuple[str, ...] = ()
) -> tuple[tuple[str, ...], tuple[tuple[str, ...], ...]]:
    """Return heads of the columns (legs, and parameters of none), and a row of cells per kind of parameter."""
    legs = sorted(parameters["leg"].dropna().unique())
    heads = heads or (
        *(leg_head(int(leg)) for leg in legs),
        *([_ALL_LEGS] if parameters["leg"].isna().any() else []),
    )
    cells: dict[str, dict[str, str]] = {}
    for r in parameters.assign(known=_identifiable(parameters)).itertuples():
        kind, unit = _kind(r), print_unit(r.parameter, r.unit)[1]
        column = f"leg {int(r.leg)}" if r.leg == r.leg else "all legs"
        cells.setdefault(f"{kind} ({unit})".replace(" ", UNBROKEN) if unit else kind, {})[column] = _cell(r)
    return heads, tuple((kind, *(row.get(head, "") for head in heads)) for kind, row in cells.items())


def _kind(r: Row) -> str:
    """Return the kind of a parameter, equal in every leg; with the name of its effect, as effects may share names."""
    kind, effect = kind_of(r.parameter, r.leg), cell(getattr(r, "effect_of", None))
    return kind if not effect or r.parameter.startswith(_BENT) else f"{kind} of {effect}"


def _cell(r: Row) -> str:
    factor, _ = print_unit(r.parameter, r.unit)
    if r.parameter.startswith(_BENT) or r.nominal != r.nominal:  # an effect has no nominal value
        return with_uncertainty(factor * r.identified, factor * r.sigma).replace(" ", UNBROKEN)
    text = with_uncertainty(factor * (r.identified - r.nominal), factor * r.sigma)
    pull = getattr(r, "pull", float("nan"))
    text += f" ({round(pull, 1) + 0.0:.1f})" if pull == pull else ""
    return (text if r.known else f"{text} *").replace(" ", UNBROKEN)


def _identifiable(parameters: pd.DataFrame) -> pd.Series:
    """Return True for parameters that the data determine, also if the table does not state it."""
    if "identifiable" in parameters:
        return parameters["identifiable"].astype(bool)
    return parameters["parameter"].notna()
