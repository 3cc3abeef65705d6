"""Subsection on effects that the simulation neglects: plates and own weight, against the compliance's uncertainty."""

from __future__ import annotations

import pandas as pd

from truing.report.column_heads import UNIT, Head
from truing.report.numbers import count_text, plain, quantity
from truing.report.page import Listing, ReportSection
from truing.report.tables import Tables, cell, per_kilo, table_or_none

_MARKS = {"negligible": "pass", "not negligible": "warn"}


def neglected(tables: Tables) -> ReportSection | None:
    """Return the section on neglected effects; None where no plate or mass is declared."""
    effects = table_or_none(tables, "neglected")
    if effects is None:
        return None
    sentences = [_sentence(str(name), group) for name, group in effects.groupby("effect", sort=False)]
    if effects["effect"].str.startswith("elastic").any():
        sentences.append(
            "A plate is estimated as separate sectors, one per joint, clamped at its rigid middle; a whole plate "
            "with evenly spaced joints is stiffer. [mechanism.platform] or [mechanism.base] elastic = true adds it to "
            "the simulation."
        )
    weight = table_or_none(tables, "own_weight")
    if weight is not None:
        sentences.append(
            "Readings are counted from the state under own weight, which changes them only through the compliance."
        )
    listings = [_worst(effects), *([] if weight is None else [_weight(weight)]), _every(effects)]
    state = (
        "warn" if (effects["verdict"] == "not negligible").any() else "pass" if effects["verdict"].notna().any() else ""
    )
    return ReportSection(
        "neglected", "Effects that the simulation neglects", " ".join(sentences), (), tuple(listings), state
    )


def _sentence(name: str, table: pd.DataFrame) -> str:
    """Return a sentence on whether neglect of an effect matters, with the entry that it changes most."""
    known = table[table["effect_over_sigma"].notna()]
    if not len(known):
        return f"{name.capitalize()}: not assessed, because the compliance has no uncertainty."
    worst = known.loc[known["effect_over_sigma"].idxmax()]
    entry = f"{worst.response} under {worst.load}"
    share = f"{plain(float(worst.effect_over_sigma))} standard deviations ({entry})"
    many = int((known["verdict"] == "not negligible").sum())
    if not many:
        return f"{name.capitalize()}: negligible; it changes no entry of the compliance by more than {share}."
    return (
        f"{name.capitalize()}: not negligible; it changes {count_text(many, 'entry')} of {len(known)} by more than a "
        f"third of a standard deviation, at most by {share}."
    )


def _row(row: object) -> tuple[str, ...]:
    factor, unit = per_kilo(row.response, row.load)  # type: ignore[attr-defined]
    ratio = row.effect_over_sigma  # type: ignore[attr-defined]
    return (
        str(row.effect),  # type: ignore[attr-defined]
        f"{row.response} under {row.load}",  # type: ignore[attr-defined]
        plain(factor * row.coefficient),  # type: ignore[attr-defined]
        f"{factor * row.effect_change:+.3g}",  # type: ignore[attr-defined]
        plain(factor * row.sigma),  # type: ignore[attr-defined]
        unit,
        plain(ratio) if ratio == ratio else "–",
        cell(row.verdict) or "not assessed",  # type: ignore[attr-defined]
    )


_HEADS = (
    Head("effect", "Physical effect that the simulation leaves out."),
    Head("entry", "Entry of the compliance: component of the motion under one load component."),
    Head("simulated", "Entry as simulated without the effect."),
    Head("change", "Change of the simulated entry by the effect."),
    Head("sigma", "Standard deviation of measured minus simulated entry."),
    UNIT,
    Head("change over sigma", "Size of the change divided by the standard deviation of measured minus simulated."),
    Head("verdict", "Whether the effect is negligible for this entry."),
)


def _worst(effects: pd.DataFrame) -> Listing:
    """Return for each effect the entries on the diagonal, and the one that changes most."""
    unit_of_response = effects["response"].map(
        dict(zip(("dx", "dy", "dz", "rx", "ry", "rz"), ("fx", "fy", "fz", "mx", "my", "mz"), strict=True))
    )
    worst = effects.groupby("effect", sort=False)["effect_over_sigma"].idxmax().dropna()
    shown = effects[(unit_of_response == effects["load"]) | effects.index.isin(worst)]
    rows, marks = _listed(shown)
    caption = "Change of the compliance by each neglected effect: the loads' own axes, and the entry that changes most"
    return Listing(_HEADS, rows, marks, caption)


def _every(effects: pd.DataFrame) -> Listing:
    rows, marks = _listed(effects)
    return Listing(_HEADS, rows, marks, "Every entry", True, "neglected.parquet")


def _listed(effects: pd.DataFrame) -> tuple[tuple[tuple[str, ...], ...], tuple[str, ...]]:
    rows = tuple(_row(row) for row in effects.itertuples())
    return rows, tuple(_MARKS.get(row[-1], "none") for row in rows)


_WEIGHT_HEADS = (
    Head("quantity", "Quantity that the row gives."),
    Head("of", "Part of the sensor that it concerns."),
    Head("value", "Computed value with its unit."),
)


def _weight(weight: pd.DataFrame) -> Listing:
    rows = tuple((str(r.figure), str(r.subject), quantity(float(r.value), str(r.unit))) for r in weight.itertuples())
    return Listing(_WEIGHT_HEADS, rows, (), "Own weight, and its effect on the sensor")
