"""What has changed since the campaign that this one starts from."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from truing.report.diagnosis.pull_figure import pull_figure
from truing.report.numbers import count, with_uncertainty
from truing.report.page import Listing, Section
from truing.report.parameter_names import name_of, shown_in
from truing.report.tables import Tables, cell, filled

if TYPE_CHECKING:
    import pandas as pd

_TITLE = "What has changed since the earlier model"
_NAMED = 3
_SERIES = {"z": "each by itself", "jump": "the fewest changes that explain all of them"}


def changes(tables: Tables) -> Section | None:
    """Numbers then and now, those that changed first; None where no earlier model is named."""
    if "changes" not in tables:
        return None
    table = filled(tables, "changes")
    said = change_words(tables)
    if table is None or not said:
        why = "The earlier model and this campaign have no number in common that both determine."
        return Section("changes", _TITLE, why, state="not evaluated")
    state = "changed" if has_changed(tables) else "pass"
    return Section("changes", _TITLE, said, tuple(_figures(table)), (_listing(table),), state)


def change_words(tables: Tables) -> str:
    """Which numbers changed beyond chance, and by how much; empty where there is no earlier model to compare with."""
    table = filled(tables, "changes")
    if table is None or not (table["z"].notna().any() or table["changed"].any()):
        return ""
    if _is_another(table):
        return (
            "The earlier model is of another machine, or this one was rebuilt: nothing of what it knew was used, "
            "and this campaign stands by itself."
        )
    judged = count(int((table["z"].notna() | table["changed"]).sum()), "number")
    changed = _largest_first(table[table["changed"]])
    if not len(changed):
        return f"Since the earlier model none of {judged} changed beyond chance."
    most = "; ".join(_change(r) for r in changed.head(_NAMED).itertuples())
    more = f"; and {len(changed) - _NAMED} more" if len(changed) > _NAMED else ""
    return f"Since the earlier model {len(changed)} of {judged} changed: {most}{more}."


def has_changed(tables: Tables) -> bool:
    """Whether anything changed since the earlier model."""
    table = filled(tables, "changes")
    return table is not None and bool(table["changed"].any())


def _is_another(table: pd.DataFrame) -> bool:
    return bool(table["changed"].all() and table["change"].isna().all())


def _largest_first(changed: pd.DataFrame) -> pd.DataFrame:
    jump = (changed["change"] / changed["sigma_change"]).abs()
    return changed.assign(jump=jump).sort_values("jump", ascending=False, kind="stable", na_position="last")


def _change(r: Any) -> str:
    """``l of leg 5 by 150 ± 2 µm (or a_z5, which this campaign cannot tell from it)``."""
    factor, unit = shown_in(r.parameter, r.unit)
    if r.change != r.change:
        return _name(r)
    if unit == "mm" and abs(r.change) < 1.0:
        factor, unit = 1e3 * factor, "µm"
    instead = f" (or {cell(r.instead)}, which this campaign cannot tell from it)" if cell(r.instead) else ""
    return f"{_name(r)} by {with_uncertainty(factor * r.change, factor * r.sigma_change, unit)}{instead}"


def _name(r: Any) -> str:
    """The number, with the effect that it belongs to where it is not the machine's own."""
    effect = cell(r.effect_of)
    return f"{name_of(r.parameter, r.leg)} of {effect}" if effect else name_of(r.parameter, r.leg)


def _figures(table: pd.DataFrame) -> list[tuple[object, str]]:
    known = table[table["z"].notna() | table["change"].notna()]
    if not len(known):
        return []
    jumps = known.assign(jump=known["change"] / known["sigma_change"])
    title = "Changes since the earlier model, in standard deviations"
    figure = pull_figure(jumps, _SERIES, title, "change / its standard deviation")
    return [(figure, "Numbers that are told only together may change without leaving the band each by itself.")]


def _listing(table: pd.DataFrame) -> Listing:
    ordered = _largest_first(table).assign(size=table["z"].abs())
    ordered = ordered.sort_values(["changed", "jump", "size"], ascending=False, kind="stable", na_position="last")
    rows = tuple(_cells(r) for r in ordered.itertuples())
    marks = tuple("fail" if changed else "none" for changed in ordered["changed"])
    heads = ("number", "before", "now", "difference", "in sigma", "changed by", "or instead", "unit")
    caption = "Every number, then and as this campaign alone has it"
    return Listing(heads, rows, marks, caption, len(rows) > 12, "changes.parquet")


def _cells(r: Any) -> tuple[str, ...]:
    factor, unit = shown_in(r.parameter, r.unit)
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
