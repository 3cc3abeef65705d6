"""Section of uncertainties in the terms of the GUM, with a budget per kind of result."""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import dataclass

import pandas as pd
import plotly.graph_objects as go

from truing.report.column_heads import Head, term_head
from truing.report.figure_style import BLUE, GREEN, GREY, ORANGE, RED, label, style
from truing.report.numbers import count_text, plain, rough, sign, with_uncertainty
from truing.report.page import MOST_ROWS, Listing, ReportSection
from truing.report.parameter_names import print_unit
from truing.report.reasons import why_absent
from truing.report.tables import Tables, cell, reason, table_or_none

_TITLE = "Statement of uncertainty"
TITLES_BY_KIND = {
    "pose": "Poses",
    "chain": "Geometry of the chain",
    "tip": "Predicted poses of the tip",
    "calibration": "Parameters of the mechanism",
    "cause": "Sizes of the causes that were found",
    "compliance": "Compliance",
    "G_B": "Calibration matrix of the sensor",
    "G_B'": "Matrix from forces of the cells to the wrench",
    "load": "Loads from one reading",
    "accuracy": "Held-out accuracy",
    "positioning": "Positioning by ISO 230-2",
}
_OPEN = 12  # longer listings are folded
_DRAWN = "For positioning, the distribution is simulated: U reaches the farther end of its 95 % interval, and k is U/u."
_MANY = 1000.0  # degrees of freedom above which the normal distribution applies
_WHERE = "uncertainty.parquet"
_SIZES = ("estimate", "standard_uncertainty", "expanded_uncertainty", "contribution")

_OF_LEG, _NUMBERED = re.compile(r" of leg \d+$"), re.compile(r"_\d+$|(?<=^K)\d+(_\d+)?$")

_COLOURS = (BLUE, ORANGE, GREEN, RED, "#CC79A7", "#56B4E9", "#F0E442")
_REST = "all others"
_SEEN = 5e-3  # least visible share of a bar


def uncertainty(tables: Tables) -> ReportSection:
    """Return the section of expanded uncertainties and budgets by kind of result, and of effects in no budget."""
    stated = table_or_none(tables, "uncertainty")
    if stated is None:
        why = reason(tables, "uncertainty") or why_absent("uncertainty", tables)
        return ReportSection("uncertainty", _TITLE, why, state="not evaluated")
    stated, budget = _as_printed(stated), tables.get("uncertainty_budget")
    budget = None if budget is None else _as_printed(budget)
    parts = []
    for kind, title in TITLES_BY_KIND.items():
        rows = stated[stated["result"] == kind]
        if len(rows):
            parts.append(_part(kind, title, rows, None if budget is None else budget[budget["result"] == kind]))
    if not stated["stated"].any():
        return ReportSection(
            "uncertainty", _TITLE, _reasons_for_none(stated), state="not evaluated", parts=tuple(parts)
        )
    kinds = "A: evaluated from the observations of this campaign; B: declared before it (GUM 4.2, 4.3)."
    return ReportSection("uncertainty", _TITLE, f"{statement(stated)} {kinds}", parts=tuple(parts))


def _as_printed(table: pd.DataFrame) -> pd.DataFrame:
    """Return the rows in the units of the other sections: directions in mrad, K in µm/mm."""
    pairs = list(zip(table["quantity"], table["unit"], strict=True))
    unit_of = {pair: print_unit(group_of("", cell(pair[0])), cell(pair[1])) for pair in set(pairs)}
    units = [unit_of[pair] for pair in pairs]
    scaled = [name for name in _SIZES if name in table]
    factors = pd.Series([factor for factor, _ in units], index=table.index)
    shown = [unit if factor == 1.0 else printed for (factor, printed), unit in zip(units, table["unit"], strict=True)]
    return table.assign(**{name: table[name] * factors for name in scaled}, unit=shown)


def statement(stated: pd.DataFrame) -> str:
    """Return the sentence required by the GUM (7.2.3), with the coverage factor where all results share it."""
    rows = stated[stated["stated"]]
    dof = rows["degrees_of_freedom"]
    factors = sorted({f"{k:.2f}" for k in rows["coverage_factor"].dropna()})
    text = "The reported expanded uncertainty is stated as the standard uncertainty multiplied by the coverage factor k"
    if len(factors) == 1 and (dof.isna() | (dof > _MANY)).all():
        law = f"= {factors[0]}, which for a normal distribution"
    elif len(rows) == 1:
        law = f"= {factors[0]}, which for a t-distribution with ν_eff = {plain(float(dof.iloc[0]))}"
    else:
        law = "next to it, which for a t-distribution with its effective degrees of freedom (∞: a normal distribution)"
    drawn = f" {_DRAWN}" if (rows["result"] == "positioning").any() else ""
    return f"{text} {law} corresponds to a coverage probability of approximately 95 %.{drawn}"


def _reasons_for_none(stated: pd.DataFrame) -> str:
    reasons = dict.fromkeys(cell(why) for why in stated["reason"])
    return f"No result has an uncertainty that could be stated: {'; '.join(filter(None, reasons))}."


def _part(kind: str, title: str, table: pd.DataFrame, budget: pd.DataFrame | None) -> ReportSection:
    reported, left = table[table["stated"]], table[~table["stated"]]
    listings, figures = [], []
    if budget is not None and len(reported):
        groups = _grouped(reported, budget[budget["evaluation"] != "not evaluated"])
        if len(_visible(groups)) > 1:
            figures.append((_share_bars(groups, title), _reading(groups)))
        listings.append(_budget(groups))
    if len(reported):
        listings.append(_stated(reported))
    if len(left):
        listings.append(_not_stated(left))
    if budget is not None and (budget["evaluation"] == "not evaluated").any():
        listings.append(_omitted(budget[budget["evaluation"] == "not evaluated"]))
    lead = f"{count_text(len(reported), 'result')} stated" + (f", {len(left)} not evaluated." if len(left) else ".")
    state = "" if len(reported) else "not evaluated"
    return ReportSection(f"uncertainty-{kind.lower()}", title, lead, tuple(figures), tuple(listings), state)


def _reading(groups: _Grouped) -> str:
    typical = " A bar for several results shows their mean." if groups.several else ""
    return f"Shares of the variance; hatched: type A.{typical}"


_OF = Head("of", "Body, leg, cause or channel that the result concerns.")
_QUANTITY = Head("quantity", "Quantity that the result gives.")
_STATE = Head("state", "State of the row: not evaluated.")
_WHY = Head("why", "Reason why it has no stated uncertainty, or is not in the budget.")


def _stated(reported: pd.DataFrame) -> Listing:
    rows = tuple(
        (
            cell(r.subject),
            cell(r.quantity),
            with_uncertainty(r.estimate, r.expanded_uncertainty, sign(cell(r.unit))),
            f"{rough(r.standard_uncertainty)} {sign(cell(r.unit))}".strip(),
            _factor(r.coverage_factor),
            freedom(r.degrees_of_freedom),
        )
        for r in reported.head(MOST_ROWS).itertuples()
    )
    heads = (
        _OF,
        _QUANTITY,
        Head("estimate ± expanded uncertainty U", "Estimate and half width of its 95 % interval: U = k u."),
        term_head("u", "standard uncertainty"),
        term_head("k", "coverage factor"),
        Head("ν_eff", "Effective degrees of freedom of u, by Welch and Satterthwaite."),
    )
    return Listing(heads, rows, caption="Results", folded=len(rows) > _OPEN, held_by=_WHERE, total=len(reported))


def _not_stated(left: pd.DataFrame) -> Listing:
    rows = tuple(("not evaluated", cell(r.subject), cell(r.quantity), cell(r.reason)) for r in left.itertuples())
    heads, marks = (_STATE, _OF, _QUANTITY, _WHY), ("none",) * len(rows)
    return Listing(heads, rows, marks, "Without a stated uncertainty", len(rows) > _OPEN, _WHERE)


def _budget(groups: _Grouped) -> Listing:
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
    rms_text = ", rms of the results" if groups.several else ""
    heads = (
        Head("result", "Result, or group of results of one kind."),
        Head("source", "Source of uncertainty."),
        Head("type", "A: from observations of this campaign; B: declared, from other knowledge."),
        Head("distribution", "Assumed distribution of the source."),
        Head(f"standard uncertainty{rms_text}", "Standard uncertainty of the result by this source alone."),
        Head("ν", "Degrees of freedom of the source's standard uncertainty; ∞ if it is taken as exactly known."),
        Head("share of the variance", "Part of the squared uncertainty of the result that this source gives."),
    )
    caption = "Budget; parts below 0.05 % are in uncertainty_budget.parquet"
    return Listing(heads, rows, caption=caption, folded=len(rows) > 2 * _OPEN, held_by="uncertainty_budget.parquet")


def _omitted(budget: pd.DataFrame) -> Listing:
    rows = tuple(("not evaluated", cell(r.input_source), cell(r.reason)) for r in budget.itertuples())
    heads, marks = (_STATE, Head("source", "Source of uncertainty."), _WHY), ("none",) * len(rows)
    return Listing(heads, rows, marks, "Not in the budget", held_by="uncertainty_budget.parquet")


def _factor(value: float) -> str:
    return f"{value:.2f}" if value == value else "–"


def freedom(dof: float) -> str:
    """Return degrees of freedom as an integer, as in tables of Student's distribution."""
    return "∞" if dof != dof or dof > _MANY else f"{int(dof)}"


@dataclass(frozen=True)
class _Grouped:
    """Groups of results by name, sources by weight; by (group, source): rms contribution and share."""

    names: tuple[str, ...]
    sources: tuple[str, ...]
    typical: dict[tuple[str, str], float]
    share: dict[tuple[str, str], float]
    unit: dict[str, str]
    evaluation: dict[str, str]
    distribution: dict[str, str]
    dof: dict[str, float]
    several: bool


def group_of(result: str, quantity: str) -> str:
    """``a_x`` for ``a_x of leg 3``, ``K`` for ``K12``, ``fx`` of a matrix for ``fx per v2``."""
    if result in ("G_B", "compliance"):
        return quantity.partition(" per ")[0] if result == "G_B" else quantity
    return _NUMBERED.sub("", _OF_LEG.sub("", quantity))


def _grouped(stated: pd.DataFrame, budget: pd.DataFrame) -> _Grouped:
    """Return the budgets of one kind of result by group; a share refers to the group's summed variance."""
    result = str(stated["result"].iloc[0])
    rows = budget.assign(
        group=[group_of(result, quantity) for quantity in budget["quantity"]], squares=budget["contribution"] ** 2
    )
    names = tuple(dict.fromkeys(rows["group"]))
    size = Counter(group_of(result, quantity) for quantity in stated["quantity"])
    squares = rows.groupby(["group", "input_source"])["squares"].sum()
    total = rows.groupby("group")["squares"].sum()
    sources = _by_weight(rows)
    keys = [(name, source) for name in names for source in sources]
    reported = {key: float(squares.get(key, 0.0)) for key in keys}
    first = rows.drop_duplicates("input_source").set_index("input_source")
    return _Grouped(
        names,
        sources,
        {key: (reported[key] / size[key[0]]) ** 0.5 for key in keys},
        {key: reported[key] / total[key[0]] if total[key[0]] > 0.0 else 0.0 for key in keys},
        {name: str(rows.loc[rows["group"] == name, "unit"].iloc[0] or "") for name in names},
        {source: str(first.loc[source, "evaluation"]) for source in sources},
        {source: str(first.loc[source, "distribution"]) for source in sources},
        {source: float(first.loc[source, "degrees_of_freedom"]) for source in sources},
        max(size[name] for name in names) > 1,
    )


def _by_weight(rows: pd.DataFrame) -> tuple[str, ...]:
    """Return sources by their mean share, the largest first."""
    shares = rows.groupby("input_source", sort=False)["share_of_variance"].sum()
    return tuple(shares.sort_values(ascending=False, kind="stable").index)


def _visible(groups: _Grouped) -> list[str]:
    """Return the sources that are visible in any of the bars."""
    return [s for s in groups.sources if max(groups.share[name, s] for name in groups.names) >= _SEEN]


def _share_bars(groups: _Grouped, title: str) -> go.Figure:
    """Return a bar per group of results, divided by source; sources without a colour of their own are combined."""
    figure = go.Figure()
    names = [label(name) for name in groups.names]
    drawn = _visible(groups)[: len(_COLOURS)]
    undrawn = [source for source in groups.sources if source not in drawn]
    for source, colour in zip(drawn, _COLOURS, strict=False):
        shares = [100.0 * groups.share[name, source] for name in groups.names]
        figure.add_trace(_bar(shares, names, f"{label(source)} ({groups.evaluation[source]})", colour))
        if groups.evaluation[source] == "A":  # distinguishable without colour too
            figure.data[-1].marker.pattern = {"shape": "/", "fgcolor": "white", "size": 6, "solidity": 0.2}
    if undrawn:
        shares = [100.0 * sum(groups.share[name, source] for source in undrawn) for name in groups.names]
        figure.add_trace(_bar(shares, names, _REST, GREY))
    height = 150 + 26 * len(names) + 22 * len(figure.data)
    style(figure, f"{title}: where the uncertainty comes from", "Share of the variance by source", height)
    figure.update_layout(barmode="stack", showlegend=True)
    legend = {"orientation": "v", "traceorder": "normal", "x": 0.0, "yanchor": "top"}
    figure.update_layout(legend={**legend, "y": -70 / (26 * len(names) + 30)})
    figure.update_xaxes(title_text="share of the variance, %", range=[0, 100])
    figure.update_yaxes(type="category", categoryorder="array", categoryarray=names[::-1], automargin=True)
    return figure


def _bar(shares: list[float], names: list[str], name: str, colour: str) -> go.Bar:
    template = "%{y}: %{x:.1f} %<extra>" + name.replace("%", "") + "</extra>"
    return go.Bar(x=shares, y=names, name=name, orientation="h", marker={"color": colour}, hovertemplate=template)
