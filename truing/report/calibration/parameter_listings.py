"""Tables of identified less nominal parameters, a column per leg (telescope report, tables 5 to 7)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from truing.report.calibration.calibrations import Key, called, deformation_words, in_order, keys_of, rows_of
from truing.report.numbers import with_uncertainty
from truing.report.page import Listing
from truing.report.parameter_names import MEANING, UNBROKEN, kind_of, shown_in
from truing.report.tables import cell

if TYPE_CHECKING:
    import pandas as pd

_CELL = "Identified − nominal ± one sigma; in brackets the pull: that shift over what tolerance and sigma let it be."
_BENT = ("K", "kappa")
_STAR = "*: the data tell it no better than its tolerance."
_MEASURED = "κ and K: as identified."


def deviations(fitted: pd.DataFrame, key: Key) -> Listing:
    """The parameters of one calibration, rows by kind and columns by leg."""
    own = rows_of(fitted, key)
    star = f" {_STAR}" if not _identifiable(own).all() else ""
    measured = f" {_MEASURED}" if own["parameter"].str.startswith(_BENT).any() else ""
    caption = f"Parameters of {called(key)}. {_CELL}{star} {MEANING}{measured}"
    heads, rows = _by_leg(own)
    return Listing(("parameter", *heads), rows, caption=caption, held_by="calibration.parquet")


def all_deviations(fitted: pd.DataFrame, method: str, held_by: str) -> list[Listing]:
    """A folded table per deformation model with all models of the structure below each other."""
    return [_of_deformation(fitted, d, method, held_by) for d in in_order(fitted["deformation"])]


def _of_deformation(fitted: pd.DataFrame, deformation: str, method: str, held_by: str) -> Listing:
    own = fitted[fitted["deformation"] == deformation]
    heads, _ = _by_leg(own)
    rows = [
        (model, *row)
        for model, deformation in keys_of(own)
        for row in _by_leg(rows_of(own, (model, deformation)), heads)[1]
    ]
    caption = f"All parameters with {deformation_words(deformation)}, {method}"
    return Listing(("model", "parameter", *heads), tuple(rows), caption=caption, folded=True, held_by=held_by)


def _by_leg(own: pd.DataFrame, heads: tuple[str, ...] = ()) -> tuple[tuple[str, ...], tuple[tuple[str, ...], ...]]:
    """Heads of the columns (legs, and what belongs to none), and a row of cells per kind of parameter."""
    legs = sorted(own["leg"].dropna().unique())
    heads = heads or (*(f"leg {int(leg)}" for leg in legs), *(["all legs"] if own["leg"].isna().any() else []))
    cells: dict[str, dict[str, str]] = {}
    for r in own.assign(known=_identifiable(own)).itertuples():
        kind, unit = _kind(r), shown_in(r.parameter, r.unit)[1]
        column = f"leg {int(r.leg)}" if r.leg == r.leg else "all legs"
        cells.setdefault(f"{kind} ({unit})".replace(" ", UNBROKEN) if unit else kind, {})[column] = _cell(r)
    return heads, tuple((kind, *(row.get(head, "") for head in heads)) for kind, row in cells.items())


def _kind(r: Any) -> str:
    """What a parameter is in every leg; of an effect with its name, as two of them may have parameters alike."""
    kind, effect = kind_of(r.parameter, r.leg), cell(getattr(r, "effect_of", None))
    return kind if not effect or r.parameter.startswith(_BENT) else f"{kind} of {effect}"


def _cell(r: Any) -> str:
    factor, _ = shown_in(r.parameter, r.unit)
    if r.parameter.startswith(_BENT) or r.nominal != r.nominal:  # an effect has no drawing that it could depart from
        return with_uncertainty(factor * r.identified, factor * r.sigma).replace(" ", UNBROKEN)
    said = with_uncertainty(factor * (r.identified - r.nominal), factor * r.sigma)
    pull = getattr(r, "pull", float("nan"))
    said += f" ({round(pull, 1) + 0.0:.1f})" if pull == pull else ""
    return (said if r.known else f"{said} *").replace(" ", UNBROKEN)


def _identifiable(own: pd.DataFrame) -> pd.Series:
    """Whether the data determine each parameter; taken so where the table does not say."""
    if "identifiable" in own:
        return own["identifiable"].astype(bool)
    return own["parameter"].notna()
