"""The section of what can be known: what the data determine, what they cannot tell apart, and who swallows what."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from truing.report import absorption_figures
from truing.report.absorption_words import agreement, swallowed
from truing.report.calibrations import Key, called, rows_of, shown_calibration
from truing.report.knowledge_figure import knowledge_map
from truing.report.numbers import count, plain, with_uncertainty
from truing.report.page import Listing, Section
from truing.report.parameter_names import name_of, shown_in
from truing.report.reasons import why_not_known
from truing.report.tables import Tables, cell, filled

if TYPE_CHECKING:
    import pandas as pd

Drawn = list[tuple[object, str]]
_TITLE = "What can be known"
_INDICES = ("rank", "parameters", "condition", "O1", "O2", "O3", "O4", "O5")
_OPEN = 12


def knowledge(tables: Tables) -> Section | None:
    """Rank and unidentifiable combinations, how well each parameter is known, and the absorption map."""
    if "observability" not in tables:
        return None
    observed = filled(tables, "observability")
    if observed is None:
        return Section("knowledge", _TITLE, why_not_known(tables), state="not evaluated")
    key = shown_calibration(tables, observed)
    absorbed = _of_model(tables, key)
    said = " ".join(words for words in (_rank(observed, key), swallowed(absorbed)) if words)
    listings = [_combinations(observed, key), _indices(observed, key), _singular_values(observed, key)]
    if absorbed is not None:
        listings.append(_absorbed(absorbed))
    shown = tuple(listing for listing in listings if listing.rows)
    return Section("knowledge", _TITLE, said, (*_known(tables, key), *_absorption(absorbed)), shown)


def _of_model(tables: Tables, key: Key) -> pd.DataFrame | None:
    """The absorption by the chosen model of the structure, with the tolerance of each parameter where it has one."""
    table = filled(tables, "absorption")
    if table is None:
        return None
    own = table[table["model"] == key[0]] if (table["model"] == key[0]).any() else table
    fitted = filled(tables, "calibration")
    if fitted is None or "tolerance" not in fitted:
        return own.assign(tolerance=float("nan"))
    names = ["model", "deformation", "leg", "parameter"]
    return own.merge(fitted[[*names, "tolerance"]].drop_duplicates(names), on=names, how="left")


def _rank(observed: pd.DataFrame, key: Key) -> str:
    facts = _whole(rows_of(observed, key)).set_index("figure")["value"]
    if "rank" not in facts or "parameters" not in facts:
        return f"Observability of {called(key)}."
    rank, asked = int(facts["rank"]), int(facts["parameters"])
    said = f"Of the {asked} parameters of {called(key)}, these poses determine {'all' if rank == asked else rank}"
    if rank == asked:
        return f"{said}."
    unknown = _unknown(rows_of(observed, key))
    example = f", such as {unknown['combination'].iloc[0]}," if len(unknown) else ""
    return f"{said}; {count(asked - rank, 'combination')}{example} cannot be seen at all."


def _whole(own: pd.DataFrame) -> pd.DataFrame:
    """One row per figure of all legs together; of the single legs where nothing is said of the whole."""
    named = own[~own["figure"].isin(["singular_value", "unidentifiable"])]
    whole = named[named["leg"].isna()] if "leg" in named else named
    return (whole if len(whole) else named).drop_duplicates("figure")


def _unknown(own: pd.DataFrame) -> pd.DataFrame:
    if "combination" not in own:
        return own.iloc[:0]
    return own[(own["figure"] == "unidentifiable") & own["combination"].notna()]


def _combinations(observed: pd.DataFrame, key: Key) -> Listing:
    own = _unknown(rows_of(observed, key))
    rows = tuple((cell(r.combination), plain(r.value)) for r in own.itertuples())
    caption = f"What the data of {called(key)} cannot tell apart (each parameter in its tolerance)"
    heads = ("combination", "known to, in tolerances")
    return Listing(heads, rows, caption=caption, folded=len(rows) > _OPEN, held_by="observability.parquet")


def _indices(observed: pd.DataFrame, key: Key) -> Listing:
    """Rank, condition and the indices O1 to O5 of every calibration."""
    keys = list(dict.fromkeys(zip(observed["model"], observed["deformation"], strict=True)))
    rows = tuple(_index_row(rows_of(observed, other), other) for other in keys)
    marks = tuple("pass" if other == key else "" for other in keys)
    caption = "Observability of every calibration, from its Jacobian in units of noise and tolerances"
    heads = ("model", "deformation", *_INDICES)
    return Listing(heads, rows, marks, caption, held_by="observability.parquet")


def _index_row(own: pd.DataFrame, key: Key) -> tuple[str, ...]:
    facts = _whole(own).set_index("figure")["value"]
    return (*key, *(plain(facts.get(name)) for name in _INDICES))


def _singular_values(observed: pd.DataFrame, key: Key) -> Listing:
    own = rows_of(observed, key)
    values = own[own["figure"] == "singular_value"]
    rows = tuple((str(k), plain(value)) for k, value in enumerate(values["value"], 1))
    return Listing(("number", "singular value"), rows, caption=f"Singular values of {called(key)}", folded=True)


def _known(tables: Tables, key: Key) -> Drawn:
    fitted = filled(tables, "calibration")
    if fitted is None or "tolerance" not in fitted:
        return []
    own = rows_of(fitted, key)
    own = own[(own["tolerance"] > 0.0) & own["sigma"].notna()]
    if not len(own):
        return []
    words = "Near 0 the data say it; near 1 it is known no better than from the drawing. In brackets: not identifiable."
    return [(knowledge_map(own, key), words)]


def _absorption(absorbed: pd.DataFrame | None) -> Drawn:
    if absorbed is None:
        return []
    drawn: Drawn = []
    if (absorbed["tolerance"] > 0.0).any():
        words = "Predicted by linear algebra before any fit, from the poses and the noise alone."
        drawn.append((absorption_figures.absorption_map(absorbed), words))
    if absorbed["observed"].notna().any():
        drawn.append((absorption_figures.predicted_against_observed(absorbed), agreement(absorbed)))
    return drawn


def _absorbed(absorbed: pd.DataFrame) -> Listing:
    rows = tuple(_absorbed_row(r) for r in absorbed.itertuples())
    heads = ("effect left out", "deformation", "parameter", "predicted", "observed", "unit")
    caption = "What every parameter takes of an effect that is left out"
    return Listing(heads, rows, caption=caption, folded=True, held_by="absorption.parquet")


def _absorbed_row(r: Any) -> tuple[str, ...]:
    factor, unit = shown_in(r.parameter, r.unit)
    observed = with_uncertainty(factor * r.observed, factor * r.sigma)
    name = name_of(r.parameter, r.leg)
    return r.effect, r.deformation, name, plain(factor * r.predicted), observed, unit
