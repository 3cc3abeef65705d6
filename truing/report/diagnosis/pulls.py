"""Whether a machine returns to what it was built to be: pulls before and after, against what tolerances allow."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from truing.report.diagnosis.compared import Compared, compared
from truing.report.diagnosis.pull_figure import pull_figure
from truing.report.numbers import count, p_value, plain, rough
from truing.report.page import Listing, Section
from truing.report.parameter_names import name_of
from truing.report.tables import Tables, filled

if TYPE_CHECKING:
    import pandas as pd

_BEFORE, _AFTER = "plain", "extended"
_COLUMNS = {"pull_before": "the causes left out", "pull_after": "the causes modelled"}


def pulls(tables: Tables) -> Section | None:
    """Pulls of the identifiable parameters, with the band of their sum; None where the run left none at all."""
    if "pulls" not in tables:
        return None
    table, of = filled(tables, "pulls"), compared(tables)
    title = f"Pulls: {of.built_question}"
    own = table[table["identifiable"].astype(bool)] if table is not None else None
    if table is None or own is None or not len(own):
        why = f"Nothing of the {of.built} is known better from the data than from its tolerance."
        return Section("pulls", title, why, state="not evaluated")
    sums = _sums(tables)
    axis = "shift / √(tolerance² − sigma²)"
    figure = pull_figure(own, _COLUMNS, f"Pulls of the identified {of.built}, before and after", axis)
    words = "What a model leaves out, other numbers have to swallow: a right cause brings the pulls back."
    left = len(table) - len(own)
    words += f" {count(left, 'parameter')} that the data do not determine left out." if left else ""
    return Section("pulls", title, _lead(sums, of), ((figure, words),), (_together(sums), _all(own)), _state(sums))


def _sums(tables: Tables) -> dict[str, Any]:
    """The row of each model whose pulls could be held against their band."""
    table = filled(tables, "pull_sums")
    rows = {str(row.model): row for row in table.itertuples()} if table is not None else {}
    return {model: row for model, row in rows.items() if _known(row)}


def _rms(chi_square: float, freedom: float) -> float:
    return math.sqrt(chi_square / freedom) if freedom > 0 and chi_square >= 0.0 else math.nan


def _known(row: Any) -> bool:
    return row.freedom > 0 and math.isfinite(row.chi_square) and math.isfinite(row.upper)


def _state(sums: dict[str, Any]) -> str:
    """Whether the pulls of the extended model are as small as honest tolerances let them be."""
    if not sums:
        return "not evaluated"
    last = _last(sums)
    return "pass" if last.chi_square <= last.upper else "fail"


def _last(sums: dict[str, Any]) -> Any:
    return sums[_AFTER] if _AFTER in sums else next(iter(sums.values()))


def _lead(sums: dict[str, Any], of: Compared) -> str:
    if not sums:
        return "All pulls together could not be held against their band: see each of them."
    last = _last(sums)
    low, high = _rms(last.lower, last.freedom), _rms(last.upper, last.freedom)
    band = f"with honest tolerances 95 % of campaigns lie between {rough(low)} and {rough(high)}"
    size = _rms(last.chi_square, last.freedom)
    if _BEFORE in sums and _AFTER in sums:
        was = rough(_rms(sums[_BEFORE].chi_square, sums[_BEFORE].freedom))
        return (
            f"Rms pull {was} with the causes left out, {rough(size)} with them modelled; {band}. {_verdict(last, of)}"
        )
    return f"Rms pull {rough(size)}; {band}. {_verdict(last, of)}"


def _verdict(row: Any, of: Compared) -> str:
    if row.chi_square > row.upper:
        return "Parts are farther from nominal than their tolerances allow: these are too small, or more is wrong."
    if row.chi_square < row.lower:
        return "Parts are closer to nominal than their tolerances ask: these are generous."
    return of.as_built


def _together(sums: dict[str, Any]) -> Listing:
    words = {_BEFORE: _COLUMNS["pull_before"], _AFTER: _COLUMNS["pull_after"]}
    rows = tuple(
        (
            words.get(model, model),
            plain(_rms(row.chi_square, row.freedom)),
            plain(row.chi_square),
            f"{plain(row.lower)} to {plain(row.upper)}",
            str(int(row.freedom)),
            p_value(row.p_value),
        )
        for model, row in sums.items()
    )
    heads = ("model", "rms pull", "chi-square", "95 % band", "degrees of freedom", "p")
    return Listing(heads, rows, caption="All pulls together, their correlations taken into account")


def _all(own: pd.DataFrame) -> Listing:
    order = own.assign(size=own["pull_before"].abs()).sort_values("size", ascending=False, kind="stable")
    rows = tuple((name_of(r.parameter, r.leg), plain(r.pull_before), plain(r.pull_after)) for r in order.itertuples())
    return Listing(("parameter", "pull before", "after"), rows, (), "Every pull", True, "pulls.parquet")
