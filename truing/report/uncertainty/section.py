"""The section that states uncertainties in the terms of the GUM, with a budget per kind of result."""

from __future__ import annotations

from typing import TYPE_CHECKING

from truing.report.numbers import count, plain, rough, sign, with_uncertainty
from truing.report.page import Listing, Section
from truing.report.reasons import why_absent
from truing.report.tables import Tables, cell, filled, reason
from truing.report.uncertainty.grouped import Grouped, grouped
from truing.report.uncertainty.share_bars import share_bars, visible

if TYPE_CHECKING:
    import pandas as pd

_TITLE = "Statement of uncertainty"
KINDS = {
    "pose": "Poses",
    "calibration": "Numbers of the mechanism",
    "cause": "Sizes of the causes that were found",
    "compliance": "Compliance",
    "G_B": "Matrix of the sensor",
    "load": "Loads told by one reading",
    "accuracy": "Held-out accuracy",
    "positioning": "Positioning by ISO 230-2",
}
_OPEN = 12  # longer listings are folded away
_DRAWN = "Of positioning, the distribution is drawn: U reaches the farther end of its 95 % interval, and k is U/u."
_MANY = 1000.0  # degrees of freedom that make no difference any more
_WHERE = "uncertainty.parquet"


def uncertainty(tables: Tables) -> Section:
    """Every kind of result with its expanded uncertainties and its budget; and what is no part of any."""
    stated = filled(tables, "uncertainty")
    if stated is None:
        why = reason(tables, "uncertainty") or why_absent("uncertainty", tables)
        return Section("uncertainty", _TITLE, why, state="not evaluated")
    budget = tables.get("uncertainty_budget")
    parts = []
    for kind, title in KINDS.items():
        own = stated[stated["result"] == kind]
        if len(own):
            parts.append(_part(kind, title, own, None if budget is None else budget[budget["result"] == kind]))
    if not stated["stated"].any():
        return Section("uncertainty", _TITLE, _none(stated), state="not evaluated", parts=tuple(parts))
    kinds = "A: evaluated from the observations of this campaign; B: declared before it (GUM 4.2, 4.3)."
    return Section("uncertainty", _TITLE, f"{statement(stated)} {kinds}", parts=tuple(parts))


def statement(stated: pd.DataFrame) -> str:
    """The sentence that the GUM asks for (7.2.3), with the coverage factor where all results have the same."""
    own = stated[stated["stated"]]
    dof = own["degrees_of_freedom"]
    factors = sorted({f"{k:.2f}" for k in own["coverage_factor"].dropna()})
    said = "The reported expanded uncertainty is stated as the standard uncertainty multiplied by the coverage factor k"
    if len(factors) == 1 and (dof.isna() | (dof > _MANY)).all():
        law = f"= {factors[0]}, which for a normal distribution"
    elif len(own) == 1:
        law = f"= {factors[0]}, which for a t-distribution with ν_eff = {plain(float(dof.iloc[0]))}"
    else:
        law = "beside it, which for a t-distribution with its effective degrees of freedom (∞: a normal distribution)"
    drawn = f" {_DRAWN}" if (own["result"] == "positioning").any() else ""
    return f"{said} {law} corresponds to a coverage probability of approximately 95 %.{drawn}"


def _none(stated: pd.DataFrame) -> str:
    reasons = dict.fromkeys(cell(why) for why in stated["reason"])
    return f"No result has an uncertainty that could be stated: {'; '.join(filter(None, reasons))}."


def _part(kind: str, title: str, own: pd.DataFrame, budget: pd.DataFrame | None) -> Section:
    told, left = own[own["stated"]], own[~own["stated"]]
    listings, figures = [], []
    if budget is not None and len(told):
        groups = grouped(told, budget[budget["evaluation"] != "not evaluated"])
        if len(visible(groups)) > 1:
            figures.append((share_bars(groups, title), _reading(groups)))
        listings.append(_budget(groups))
    if len(told):
        listings.append(_stated(told))
    if len(left):
        listings.append(_not_stated(left))
    if budget is not None and (budget["evaluation"] == "not evaluated").any():
        listings.append(_omitted(budget[budget["evaluation"] == "not evaluated"]))
    lead = f"{count(len(told), 'result')} stated" + (f", {len(left)} not evaluated." if len(left) else ".")
    state = "" if len(told) else "not evaluated"
    return Section(f"uncertainty-{kind.lower()}", title, lead, tuple(figures), tuple(listings), state)


def _reading(groups: Grouped) -> str:
    typical = " Where several results make one bar, it is their mean." if groups.several else ""
    return f"Shares of the variance; hatched: type A.{typical}"


def _stated(told: pd.DataFrame) -> Listing:
    rows = tuple(
        (
            cell(r.subject),
            cell(r.quantity),
            with_uncertainty(r.estimate, r.expanded_uncertainty, sign(cell(r.unit))),
            rough(r.standard_uncertainty),
            _factor(r.coverage_factor),
            freedom(r.degrees_of_freedom),
        )
        for r in told.itertuples()
    )
    heads = ("of", "quantity", "estimate ± expanded uncertainty U", "u", "k", "ν_eff")
    return Listing(heads, rows, caption="Results", folded=len(rows) > _OPEN, held_by=_WHERE)


def _not_stated(left: pd.DataFrame) -> Listing:
    rows = tuple(("not evaluated", cell(r.subject), cell(r.quantity), cell(r.reason)) for r in left.itertuples())
    heads, marks = ("state", "of", "quantity", "why"), ("none",) * len(rows)
    return Listing(heads, rows, marks, "Without a stated uncertainty", len(rows) > _OPEN, _WHERE)


def _budget(groups: Grouped) -> Listing:
    rows = tuple(
        (
            group,
            source,
            groups.evaluation[source],
            groups.distribution[source],
            f"{rough(groups.typical[group, source])} {sign(groups.unit[group])}".strip(),
            freedom(groups.dof[source]),
            f"{100.0 * groups.share[group, source]:.1f} %",
        )
        for group in groups.names
        for source in groups.sources
        if groups.share[group, source] >= 5e-4
    )
    what = "standard uncertainty, rms of the results" if groups.several else "standard uncertainty"
    heads = ("result", "source", "type", "distribution", what, "ν", "share of the variance")
    caption = "Budget; parts below 0.05 % are in uncertainty_budget.parquet"
    return Listing(heads, rows, caption=caption, folded=len(rows) > 2 * _OPEN, held_by="uncertainty_budget.parquet")


def _omitted(budget: pd.DataFrame) -> Listing:
    rows = tuple(("not evaluated", cell(r.input_source), cell(r.reason)) for r in budget.itertuples())
    heads, marks = ("state", "source", "why"), ("none",) * len(rows)
    return Listing(heads, rows, marks, "Not in the budget", held_by="uncertainty_budget.parquet")


def _factor(value: float) -> str:
    return f"{value:.2f}" if value == value else "–"


def freedom(dof: float) -> str:
    """Degrees of freedom in whole numbers, as tables of Student's distribution have them."""
    return "∞" if dof != dof or dof > _MANY else f"{int(dof)}"
