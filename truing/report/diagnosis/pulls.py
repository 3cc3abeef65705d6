"""Shifts of parameters in standard deviations: from nominal values, and from the earlier campaign."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd
import plotly.graph_objects as go
from numpy.typing import NDArray

from truing.belonging.relation import RelationState
from truing.report.column_heads import FREEDOM, PARAMETER, UNIT, Head, P
from truing.report.diagnosis.prediction_errors import PartNames, part_names
from truing.report.far_numbers import UNLIKELY, FarNumber, far_number
from truing.report.figure_style import BLUE, GREY, ORANGE, label, style
from truing.report.numbers import count_text, p_equals, p_value, plain, rough, with_uncertainty
from truing.report.page import Listing, ReportSection
from truing.report.parameter_names import kind_of, name_of, print_unit
from truing.report.section_verdict import SectionVerdict
from truing.report.tables import Row, Tables, cell, table_or_none
from truing.schemas.verdict import ReasonCode

_BEFORE, _AFTER = "plain", "extended"
_COLUMNS = {"pull_before": "without the causes", "pull_after": "with the causes"}

# Larger pulls are drawn at the edge, so that the others stay visible.
_CLIPPED = 25.0
_BAND = 1.96
_NEARLY_ALL = 0.8  # share of the squares of all pulls
_LOOK = ((ORANGE, "circle-open", -0.16), (BLUE, "circle", 0.16))
# Most kinds of parameter on the axis; K has a kind per column.
_KINDS = 40

_TITLE = "What has changed since the earlier model"
_NAMED = 3
_SERIES = {"z": "each by itself", "jump": "the fewest changes that explain all of them"}


def pulls(tables: Tables) -> ReportSection | None:
    """Return the section of the identifiable parameters' pulls, with the band of their sum; None where
    there are none."""
    if "pulls" not in tables:
        return None
    table, parts = table_or_none(tables, "pulls"), part_names(tables)
    title = f"Pulls: {parts.built_question}"
    rows = table[table["identifiable"].astype(bool)] if table is not None else None
    if table is None or rows is None or not len(rows):
        return ReportSection("pulls", title, _unknown(parts))
    sums = _sums(tables)
    axis = "shift / √(tolerance² − sigma²)"
    figure = pull_figure(rows, _COLUMNS, f"Pulls of the identified {parts.built}, before and after", axis)
    words = "An effect that the model leaves out biases other parameters: their pulls are then large."
    left = len(table) - len(rows)
    words += f" Not shown: {count_text(left, 'parameter')} that the data do not determine." if left else ""
    return ReportSection(
        "pulls",
        title,
        _opening_sentences(sums, parts, table),
        ((figure, words),),
        (_summary_listing(sums), _pull_listing(rows)),
    )


def _unknown(parts: PartNames) -> str:
    return f"The data determine no parameter of the {parts.built} better than its tolerance."


def pulls_verdict(tables: Tables, _: Mapping[str, SectionVerdict]) -> SectionVerdict | None:
    """Return the verdict on all pulls together against realistic tolerances; None where there are none."""
    if "pulls" not in tables:
        return None
    table, parts = table_or_none(tables, "pulls"), part_names(tables)
    known = table is not None and bool(table["identifiable"].any())
    sums = _sums(tables) if known else {}
    if not sums:
        why = _opening_sentences(sums, parts, table) if known else _unknown(parts)
        return SectionVerdict("pulls", RelationState.NOT_TESTED, ReasonCode.NOT_EVALUATED, f"Pulls not tested: {why}")
    last = _final_sums(sums)
    size, limit = (_rms(chi_square, last.freedom) for chi_square in (last.chi_square, last.upper))
    text = f"Pulls of the {parts.built}: rms {rough(size)}; upper limit (95 %) if tolerances are realistic: "
    text += f"{rough(limit)} (p {p_equals(last.p_value)}). {_one_number(table, last) or _verdict(last, parts, table)}"
    if last.chi_square <= last.upper:
        if (far := _far_number(table)) is not None:
            state = RelationState.FAILS if far.p_value < UNLIKELY else RelationState.ATTENTION
            return SectionVerdict("pulls", state, ReasonCode.BEYOND_TOLERANCE, text, far.pull, "1", far.limit)
        return SectionVerdict("pulls", RelationState.OK, ReasonCode.WITHIN_TOLERANCE, text, size, "1", limit)
    state = RelationState.FAILS if last.p_value < UNLIKELY else RelationState.ATTENTION
    return SectionVerdict("pulls", state, ReasonCode.BEYOND_TOLERANCE, text, size, "1", limit)


def _far_number(table: pd.DataFrame | None) -> FarNumber | None:
    """Return the number that is off by more than its tolerance allows; None where none is."""
    if table is None or "offset_after" not in table:
        return None
    return far_number(table[table["offset_after"].notna()], "explained_after")


def _one_number(table: pd.DataFrame | None, last: Row) -> str:
    """Return the sentence on the one number that explains all pulls, or else on the leg that holds most of them.

    The number must be too far off by itself. Empty where there is neither.
    """
    if table is None or last.chi_square <= last.upper or "offset_after" not in table:
        return ""
    known = table[table["identifiable"].astype(bool)]
    # Two numbers may share one that the data determine, such as a length and a height: neither is identifiable.
    informed = table[table["offset_after"].notna()]
    if not len(informed):
        return _one_leg(known) if len(known) else ""
    left = last.chi_square - float(informed["explained_after"].max())
    far = far_number(informed, "explained_after")  # just beyond the band, any of many good numbers would explain it
    if known["offset_after"].isna().any() or far is None or not 0.0 <= left <= last.upper:
        return _one_leg(known)
    return f"The description does not fit the machine: one wrong number explains it. {_meant(far.rows)}"


def _meant(rows: Sequence[Row]) -> str:
    """Return the question whether the first number has another value, with those that are as likely."""
    meant, *also = map(_other_by, rows)
    text = f"Did you mean {meant}?"
    return f"{text} Equally likely: {'; or '.join(also)}." if also else text


def _one_leg(known: pd.DataFrame) -> str:
    """Return the sentence on the leg that holds nearly all squares of the pulls; empty where none does."""
    by_leg = (known["pull_after"] ** 2).groupby(known["leg"]).sum()
    if len(by_leg) < 2 or by_leg.max() < _NEARLY_ALL * by_leg.sum():
        return ""
    leg = int(by_leg.idxmax())
    return f"The description does not fit the machine: nearly all pulls are of leg {leg}. Are its numbers right?"


def _other_by(row: Row) -> str:
    """Return a parameter with its correction: ``l of leg 3 larger by 20.00 ± 0.12 mm``.

    Next to it all other numbers keep their tolerances, so the squares that it explains are those of its offset over its
    standard deviation.
    """
    factor, unit = print_unit(row.parameter, row.unit)
    direction, offset = "larger" if row.offset_after > 0.0 else "smaller", abs(factor * row.offset_after)
    sigma = offset / math.sqrt(row.explained_after) if row.explained_after > 0.0 else None
    return f"{name_of(row.parameter, row.leg)} {direction} by {with_uncertainty(offset, sigma, unit)}"


def _sums(tables: Tables) -> dict[str, Row]:
    """Return the row of each model whose pulls could be compared with their band."""
    table = table_or_none(tables, "pull_sums")
    rows = {str(row.model): row for row in table.itertuples()} if table is not None else {}
    return {model: row for model, row in rows.items() if _is_testable(row)}


def _rms(chi_square: float, freedom: float) -> float:
    return math.sqrt(chi_square / freedom) if freedom > 0 and chi_square >= 0.0 else math.nan


def _is_testable(row: Row) -> bool:
    return row.freedom > 0 and math.isfinite(row.chi_square) and math.isfinite(row.upper)


def _final_sums(sums: Mapping[str, Row]) -> Row:
    return sums[_AFTER] if _AFTER in sums else next(iter(sums.values()))


def _opening_sentences(sums: Mapping[str, Row], parts: PartNames, table: pd.DataFrame | None) -> str:
    if not sums:
        return "The sum of all pulls could not be tested: see each of them."
    last = _final_sums(sums)
    low, high = _rms(last.lower, last.freedom), _rms(last.upper, last.freedom)
    band = f"Expected range (95 %) if tolerances are realistic: {rough(low)} to {rough(high)}"
    size = _rms(last.chi_square, last.freedom)
    if _BEFORE in sums and _AFTER in sums:
        was = rough(_rms(sums[_BEFORE].chi_square, sums[_BEFORE].freedom))
        return f"Rms pull: {was} without the causes, {rough(size)} with them. {band}. {_verdict(last, parts, table)}"
    return f"Rms pull: {rough(size)}. {band}. {_verdict(last, parts, table)}"


def _verdict(row: Row, parts: PartNames, table: pd.DataFrame | None) -> str:
    if row.chi_square > row.upper:
        return "Parts are farther from nominal than tolerances allow: tolerances are too small, or a cause is missing."
    if (far := _far_number(table)) is not None:
        text = "The description does not fit the machine: one number is farther from nominal than its tolerance allows "
        return text + f"(p {p_equals(far.p_value)}, corrected for {far.tried} numbers). {_meant(far.rows)}"
    if row.chi_square < row.lower:
        return "Parts are closer to nominal than tolerances suggest: tolerances may be too large."
    return parts.as_built


def _summary_listing(sums: Mapping[str, Row]) -> Listing:
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
    heads = (
        Head("model", "Model with which the geometry was identified: without or with the causes found."),
        Head("rms pull", "Root mean square of the pulls; 1 if the geometry agrees with its tolerances."),
        Head("chi-square", "Sum of the squared pulls, with their correlations taken into account."),
        Head("95 % band", "Range in which chi-square lies with 95 % probability if tolerances are realistic."),
        FREEDOM,
        P,
    )
    return Listing(heads, rows, caption="All pulls together, their correlations taken into account")


_PULL_HEADS = (
    PARAMETER,
    Head("pull before", "Pull of the parameter without the causes found."),
    Head("after", "Pull of the parameter with the causes found."),
)


def _pull_listing(table: pd.DataFrame) -> Listing:
    order = table.assign(size=table["pull_before"].abs()).sort_values("size", ascending=False, kind="stable")
    rows = tuple((name_of(r.parameter, r.leg), plain(r.pull_before), plain(r.pull_after)) for r in order.itertuples())
    return Listing(_PULL_HEADS, rows, (), "Every pull", True, "pulls.parquet")


def pull_figure(table: pd.DataFrame, columns: Mapping[str, str], title: str, axis: str) -> go.Figure:
    """Return a figure of ``table`` (leg, parameter, and ``columns``: column to words), with a mark per row
    and column."""
    kinds = [kind_of(str(name), leg) for name, leg in zip(table["parameter"], table["leg"], strict=True)]
    order = list(dict.fromkeys(kinds))[:_KINDS]
    shown = table.assign(kind=kinds)
    shown = shown[shown["kind"].isin(order)]
    index_of = {kind: k for k, kind in enumerate(order)}
    figure = go.Figure()
    figure.add_hrect(y0=-_BAND, y1=_BAND, fillcolor=GREY, opacity=0.15, line={"width": 0})
    looks = _LOOK if len(columns) > 1 else _LOOK[1:]
    for (column, words), look in zip(columns.items(), looks, strict=True):
        figure.add_trace(_marks(shown, index_of, column, words, look))
    clipped = bool((shown[list(columns)].abs() > _CLIPPED).to_numpy().any())
    edge = f". Beyond {_CLIPPED:g}: drawn at the edge" if clipped else ""
    of_legs = "One mark per leg; grey" if table["leg"].notna().any() else "Grey"
    style(figure, title, f"{of_legs}: 95 % range by chance{edge}", 420)
    ticks = {"tickvals": list(index_of.values()), "ticktext": [label(kind) for kind in order]}
    figure.update_xaxes(**ticks, showgrid=False, zeroline=False, range=[-0.6, len(order) - 0.4])
    figure.update_yaxes(title_text=axis, zeroline=True, zerolinecolor=GREY)
    legend = {"orientation": "h", "y": 1.0, "yanchor": "bottom", "x": 0.0}
    figure.update_layout(legend=legend, margin={"t": 104}, showlegend=len(columns) > 1)
    return figure


def _marks(
    shown: pd.DataFrame, rank: Mapping[str, int], column: str, words: str, look: tuple[str, str, float]
) -> go.Scatter:
    colour, symbol, aside = look
    values = shown[column].to_numpy(dtype=float)
    return go.Scatter(
        x=[rank[kind] + aside + spread for kind, spread in zip(shown["kind"], _spread(shown["leg"]), strict=True)],
        y=np.clip(values, -_CLIPPED, _CLIPPED),
        mode="markers",
        marker={"color": colour, "symbol": symbol, "size": 8, "line": {"width": 1.5}},
        name=words,
        text=[
            f"{label(name_of(str(name), leg))}: {plain(value)}"
            for name, leg, value in zip(shown["parameter"], shown["leg"], values, strict=True)
        ],
        hovertemplate="%{text}<extra>" + words + "</extra>",
    )


def _spread(legs: pd.Series) -> NDArray:
    """Return places of legs next to each other within their kind."""
    numbers = legs.to_numpy(dtype=float)
    known = numbers[np.isfinite(numbers)]
    if not len(known) or np.ptp(known) == 0.0:
        return np.zeros(len(numbers))
    return np.where(np.isfinite(numbers), 0.22 * ((numbers - known.min()) / np.ptp(known) - 0.5), 0.0)


def changes(tables: Tables) -> ReportSection | None:
    """Return the section of numbers then and now, changed ones first; None where no earlier model is named."""
    if "changes" not in tables:
        return None
    table = table_or_none(tables, "changes")
    text = change_words(tables)
    if table is None or not text:
        why = "The earlier model and this campaign determine no common parameter."
        return ReportSection("changes", _TITLE, why, state="not evaluated")
    return ReportSection("changes", _TITLE, text, tuple(_figures(table)), (_listing(table),))


def changes_verdict(tables: Tables, _: Mapping[str, SectionVerdict]) -> SectionVerdict | None:
    """Return the verdict on changes since the earlier model; None where there is none."""
    table, text = table_or_none(tables, "changes"), change_words(tables)
    if table is None or not text:
        return None
    changed = float(table["changed"].sum())
    if changed:
        return SectionVerdict("changes", RelationState.ATTENTION, ReasonCode.CHANGED, text, changed, "1")
    return SectionVerdict("changes", RelationState.OK, ReasonCode.UNCHANGED, text, changed, "1")


def change_words(tables: Tables) -> str:
    """Return the significant changes in words; empty where there is no earlier model."""
    table = table_or_none(tables, "changes")
    if table is None or not (table["z"].notna().any() or table["changed"].any()):
        return ""
    if _is_another(table):
        return (
            "The earlier model is of another machine, or this machine was rebuilt. Nothing of the earlier model was "
            "used: all results rest on this campaign alone."
        )
    assessed = count_text(int((table["z"].notna() | table["changed"]).sum()), "number")
    changed = _largest_first(table[table["changed"]])
    if not len(changed):
        return f"Since the earlier model, none of {assessed} changed beyond chance."
    most = "; ".join(_change(r) for r in changed.head(_NAMED).itertuples())
    more = f"; and {len(changed) - _NAMED} more" if len(changed) > _NAMED else ""
    return f"Since the earlier model, {len(changed)} of {assessed} changed: {most}{more}."


def _is_another(table: pd.DataFrame) -> bool:
    return bool(table["changed"].all() and table["change"].isna().all())


def _largest_first(changed: pd.DataFrame) -> pd.DataFrame:
    jump = (changed["change"] / changed["sigma_change"]).abs()
    return changed.assign(jump=jump).sort_values("jump", ascending=False, kind="stable", na_position="last")


def _change(r: Row) -> str:
    """Return a change in words: ``l of leg 5 by 150 ± 2 µm (or a_z5, which this campaign cannot distinguish)``."""
    factor, unit = print_unit(r.parameter, r.unit)
    if r.change != r.change:
        return _name(r)
    if unit == "mm" and abs(r.change) < 1.0:
        factor, unit = 1e3 * factor, "µm"
    instead = f" (or {cell(r.instead)}, which this campaign cannot distinguish)" if cell(r.instead) else ""
    return f"{_name(r)} by {with_uncertainty(factor * r.change, factor * r.sigma_change, unit)}{instead}"


def _name(r: Row) -> str:
    """Return the name of a number, with its effect if it belongs to one."""
    effect = cell(r.effect_of)
    return f"{name_of(r.parameter, r.leg)} of {effect}" if effect else name_of(r.parameter, r.leg)


def _figures(table: pd.DataFrame) -> list[tuple[object, str]]:
    known = table[table["z"].notna() | table["change"].notna()]
    if not len(known):
        return []
    jumps = known.assign(jump=known["change"] / known["sigma_change"])
    title = "Changes since the earlier model, in standard deviations"
    figure = pull_figure(jumps, _SERIES, title, "change / its standard deviation")
    return [(figure, "Correlated parameters may change together while each stays inside its own band.")]


def _listing(table: pd.DataFrame) -> Listing:
    ordered = _largest_first(table).assign(size=table["z"].abs())
    ordered = ordered.sort_values(["changed", "jump", "size"], ascending=False, kind="stable", na_position="last")
    rows = tuple(_cells(r) for r in ordered.itertuples())
    marks = tuple("changed" if changed else "none" for changed in ordered["changed"])
    heads = (
        Head("number", "Parameter of the machine that both campaigns determine."),
        Head("before", "Value from the earlier campaign, with one standard deviation."),
        Head("now", "Value from this campaign alone, with one standard deviation."),
        Head("difference", "Value now minus value before, with one standard deviation."),
        Head("in sigma", "Difference divided by its standard deviation."),
        Head("changed by", "Estimated change, if only the parameters marked as changed have changed."),
        Head("or instead", "Parameters whose change would explain the data equally well."),
        UNIT,
    )
    caption = "Every parameter: earlier value, and value from this campaign alone"
    return Listing(heads, rows, marks, caption, len(rows) > 12, "changes.parquet")


def _cells(r: Row) -> tuple[str, ...]:
    factor, unit = print_unit(r.parameter, r.unit)
    return (
        _name(r),
        with_uncertainty(factor * r.before, factor * r.sigma_before),
        with_uncertainty(factor * r.now, factor * r.sigma_now),
        with_uncertainty(factor * (r.now - r.before), factor * r.sigma_difference),
        f"{r.z:.1f}" if r.z == r.z else "–",
        with_uncertainty(factor * r.change, factor * r.sigma_change) if r.changed and r.change == r.change else "",
        cell(r.instead),
        unit,
    )
