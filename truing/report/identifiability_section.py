"""Section of identifiability: determined and inseparable parameters, and the bias by an omission."""

from __future__ import annotations

import numpy as np
import pandas as pd
import plotly.graph_objects as go

from truing.report import absorption
from truing.report.absorption import absorbed_by, agreement, most_shifted_words
from truing.report.calibration.calibrations import Key, calibration_name, displayed_calibration, rows_of
from truing.report.column_heads import DEFORMATION, PARAMETER, UNIT, Head, leg_head
from truing.report.figure_style import label, style
from truing.report.numbers import plain, with_uncertainty
from truing.report.page import Drawn, Listing, ReportSection
from truing.report.parameter_names import kind_of, name_of, print_unit, symbols
from truing.report.reasons import why_not_known
from truing.report.tables import Row, Tables, table_or_none

_TITLE = "Identifiability"
_INDICES = {
    "condition": "Largest over smallest singular value of the scaled Jacobian; near 1 is good.",
    "O1": "Geometric mean of the singular values over the root of the number of poses (Borm and Menq).",
    "O2": "Smallest over largest singular value (Driels and Pathre).",
    "O3": "Smallest singular value (Nahvi, Hollerbach and Hayward).",
    "O4": "Square of the smallest singular value over the largest one (Nahvi and Hollerbach).",
    "O5": "Inverse of the sum of the inverse singular values (Sun and Hollerbach).",
}
# Identifiable sets with more names than this are counted instead.
_NAMED = 12
_OPEN = 20

_ROW = 28


def knowledge(tables: Tables) -> ReportSection | None:
    """Return the section with rank, unidentifiable combinations, uncertainty of each parameter, and absorption map."""
    if "observability" not in tables:
        return None
    observed = table_or_none(tables, "observability")
    if observed is None:
        return ReportSection("knowledge", _TITLE, why_not_known(tables), state="not evaluated")
    fitted = table_or_none(tables, "calibration")
    key = displayed_calibration(tables, fitted if fitted is not None else observed)
    absorbed = absorbed_by(tables, key)
    text = " ".join(words for words in (_rank(observed, key), most_shifted_words(absorbed)) if words)
    listings = [*_observability(observed, key), *([_absorbed(absorbed)] if absorbed is not None else [])]
    shown = tuple(listing for listing in listings if listing.rows)
    return ReportSection("knowledge", _TITLE, text, (*_known_parameters(tables, key), *_absorption(absorbed)), shown)


def _observability(observed: pd.DataFrame, key: Key) -> list[Listing]:
    legs, whole_machine = _by_leg(observed), _without_leg(observed, key)
    return [
        _indices(legs, whole_machine, key),
        _combinations(legs, "Parameters that poses and readings cannot distinguish, leg by leg"),
        _combinations(
            whole_machine,
            f"Parameters that all measurements cannot distinguish in {calibration_name(key)}",
            folded=True,
        ),
        _sigmas(legs),
    ]


def _by_leg(observed: pd.DataFrame) -> pd.DataFrame:
    return observed[observed["leg"].notna()] if "leg" in observed else observed.iloc[:0]


def _without_leg(observed: pd.DataFrame, key: Key) -> pd.DataFrame:
    rows = rows_of(observed, key)
    return rows[rows["leg"].isna()] if "leg" in rows else rows


def _facts(table: pd.DataFrame) -> dict[str, float]:
    return dict(zip(table["figure"], table["value"], strict=True))


def _rank(observed: pd.DataFrame, key: Key) -> str:
    """Return in words the rank of each leg from poses and readings alone, and of the chosen model from all
    measurements."""
    legs, whole_machine, texts = _by_leg(observed), _without_leg(observed, key), []
    if len(legs):
        asked, rank = (int(legs.loc[legs["figure"] == name, "value"].max()) for name in ("parameters", "rank"))
        texts.append(
            f"Poses and readings alone determine at most {rank} of the {asked} parameters of a leg."
            f"{_largest_set_text(legs)}"
        )
    facts = _facts(whole_machine)
    if "rank" in facts and "parameters" in facts:
        asked, rank = int(facts["parameters"]), int(facts["rank"])
        part = f"all {asked}" if rank == asked else f"{rank} of the {asked}"
        by_tolerances = "" if rank == asked else "; only tolerances limit the others"
        texts.append(
            f"All measurements, targets included, determine {part} parameters of {calibration_name(key)}"
            f"{by_tolerances}."
        )
    return " ".join(texts) or f"Observability of {calibration_name(key)}."


def _largest_set_text(legs: pd.DataFrame) -> str:
    """Return in words a largest identifiable set in most legs, and the parameters that do not fit into it."""
    if "combination" not in legs:
        return ""
    numbers = legs.assign(names=_of_any_leg(legs)).dropna(subset="names")
    sets = numbers.loc[numbers["figure"] == "identifiable_set", "names"].value_counts()
    if not len(sets):
        return ""
    chosen = str(sets.index[0]).split()
    every = dict.fromkeys(numbers.loc[numbers["figure"] == "sigma", "names"])
    left = [symbols(name) for name in every if name not in chosen]
    named = ", ".join(symbols(name) for name in chosen)
    return f" If {named} are identified, {', '.join(left)} remain unidentifiable." if left else ""


def _of_any_leg(legs: pd.DataFrame) -> list[str | None]:
    """Return the names of each row without the number of the leg."""
    return [
        " ".join(name.removesuffix(str(int(leg))) for name in words.split()) if isinstance(words, str) else None
        for words, leg in zip(legs["combination"], legs["leg"], strict=True)
    ]


def _unknown(table: pd.DataFrame) -> pd.DataFrame:
    if "combination" not in table:
        return table.iloc[:0]
    return table[(table["figure"] == "unidentifiable") & table["combination"].notna()]


def _combinations(table: pd.DataFrame, caption: str, folded: bool = False) -> Listing:
    """Return a row per unobservable direction, so that a group of many stays readable."""
    rows = tuple(
        (symbols(words.strip()), plain(r.value) if k == 0 else "")
        for r in _unknown(table).itertuples()
        for k, words in enumerate(r.combination.split(";"))
    )
    heads = (
        Head(
            "combination (m, rad)",
            "Combination of parameters that the data cannot distinguish; lengths in m, angles in rad.",
        ),
        Head(
            "standard deviation of the unobservable direction, in tolerances",
            "Uncertainty that the data alone leave in this direction; 1 or more: no better than the tolerance.",
        ),
    )
    folded = folded or len(rows) > _OPEN
    return Listing(heads, rows, caption=caption, folded=folded, held_by="observability.parquet")


def _indices(legs: pd.DataFrame, table: pd.DataFrame, key: Key) -> Listing:
    """Return rank, condition and the indices O1 to O5 of each leg and of the chosen model."""
    parts = [(f"leg {int(leg)}", group) for leg, group in legs.groupby("leg", sort=True)] if len(legs) else []
    if len(table):
        parts.append((calibration_name(key), table))
    rows = tuple(_index_row(name, rows_of_part) for name, rows_of_part in parts)
    caption = "Observability of each leg by poses and readings alone, and of the chosen model by all measurements"
    heads = (
        Head("of", "Leg by itself, or the whole model."),
        Head("numbers", "Number of parameters."),
        Head("rank", "Number of independent combinations of parameters that the data determine."),
        Head(
            "a largest identifiable set",
            "One choice of as many parameters as possible that the data determine together.",
        ),
        *(Head(name, words) for name, words in _INDICES.items()),
    )
    return Listing(heads, rows, caption=caption, held_by="observability.parquet")


def _index_row(name: str, table: pd.DataFrame) -> tuple[str, ...]:
    facts = _facts(table)
    sets = table.loc[table["figure"] == "identifiable_set", "combination"] if "combination" in table else table.iloc[:0]
    names = str(sets.iloc[0]).split() if len(sets) else []
    chosen = " ".join(map(symbols, names)) if len(names) <= _NAMED else f"{len(names)} parameters"
    return (
        name,
        plain(facts.get("parameters")),
        plain(facts.get("rank")),
        chosen,
        *(plain(facts.get(i)) for i in _INDICES),
    )


def _sigmas(legs: pd.DataFrame) -> Listing:
    """Return the uncertainty of each leg's parameters from data alone, in tolerances, with all others free."""
    named = "combination" in legs and "leg" in legs
    reported = legs[legs["figure"] == "sigma"] if named else legs.iloc[:0]
    numbers = sorted(reported["leg"].unique()) if named else []
    cells: dict[str, dict[float, str]] = {}
    for r in reported.itertuples():
        cells.setdefault(str(r.combination).removesuffix(str(int(r.leg))), {})[r.leg] = plain(r.value)
    rows = tuple((symbols(name), *(cell.get(leg, "") for leg in numbers)) for name, cell in cells.items())
    caption = "Standard deviation of each parameter from the data alone, in tolerances (a dash: not determined)"
    return Listing((PARAMETER, *(leg_head(int(leg)) for leg in numbers)), rows, caption=caption, folded=True)


def _known_parameters(tables: Tables, key: Key) -> Drawn:
    fitted = table_or_none(tables, "calibration")
    if fitted is None or "tolerance" not in fitted:
        return []
    rows = rows_of(fitted, key)
    rows = rows[(rows["tolerance"] > 0.0) & rows["sigma"].notna()]
    if not len(rows):
        return []
    words = "Near 0: known from the data. Near 1: known only from its tolerance. In brackets: not identifiable."
    return [(_knowledge_map(rows, key), words)]


def _absorption(absorbed: pd.DataFrame | None) -> Drawn:
    if absorbed is None:
        return []
    drawn: Drawn = []
    if (absorbed["tolerance"] > 0.0).any():
        words = "Predicted by linear algebra before any fit. Surveyed joints and tolerances reduce the bias."
        drawn.append((absorption.absorption_map(absorbed), words))
    if absorbed["observed"].notna().any():
        drawn.append((absorption.predicted_against_observed(absorbed), agreement(absorbed)))
    return drawn


def _absorbed(absorbed: pd.DataFrame) -> Listing:
    rows = tuple(_absorbed_row(r) for r in absorbed.itertuples())
    heads = (
        Head("effect left out", "Effect that the fit ignores."),
        DEFORMATION,
        Head("estimator", "Method of the fit: maximum likelihood or implicit objectives."),
        PARAMETER,
        Head("predicted", "Shift of the parameter that linear algebra predicts before the fit."),
        Head("observed", "Shift of the parameter between both fits, with one standard deviation."),
        UNIT,
    )
    caption = "Bias of every parameter if an effect is left out"
    return Listing(heads, rows, caption=caption, folded=True, held_by="absorption.parquet")


def _absorbed_row(r: Row) -> tuple[str, ...]:
    factor, unit = print_unit(r.parameter, r.unit)
    observed = with_uncertainty(factor * r.observed, factor * r.sigma)
    name = name_of(r.parameter, r.leg)
    return r.effect, r.deformation, r.estimator, name, plain(factor * r.predicted), observed, unit


def _knowledge_map(table: pd.DataFrame, key: Key) -> go.Figure:
    """Return a heat map of sigma over tolerance of one calibration's parameters; unidentifiable ones in brackets."""
    reported = table.assign(
        kind=[kind_of(name, leg) for name, leg in zip(table["parameter"], table["leg"], strict=True)],
        place=[f"leg {int(leg)}" if leg == leg else "all legs" for leg in table["leg"]],
        ratio=table["sigma"] / table["tolerance"],
        known=table["identifiable"].astype(bool) if "identifiable" in table else True,
    )
    kinds, columns = list(dict.fromkeys(reported["kind"])), list(dict.fromkeys(reported.sort_values("leg")["place"]))
    wide = {
        c: reported.pivot(index="kind", columns="place", values=c).reindex(index=kinds, columns=columns)
        for c in ("ratio", "known")
    }
    figure = go.Figure()
    figure.add_trace(
        go.Heatmap(
            z=np.round(wide["ratio"].to_numpy(dtype=float), 4),
            x=columns,
            y=[f"{label(kind)} " for kind in kinds],
            text=_cells(wide["ratio"].to_numpy(dtype=float), wide["known"].to_numpy()),
            texttemplate="%{text}",
            zmin=0,
            zmax=1,
            xgap=1,
            ygap=1,
            colorscale="Blues",
            colorbar={"title": {"text": "sigma / tolerance"}, "thickness": 16},
            hovertemplate="%{y} of %{x}: %{z:.3f} tolerances<extra></extra>",
        )
    )
    subtitle = f"Standard deviation after the calibration over the tolerance before it, {label(calibration_name(key))}"
    style(figure, "How well each parameter is known", subtitle, 170 + _ROW * len(kinds))
    figure.update_xaxes(type="category", side="top", showgrid=False)
    figure.update_yaxes(type="category", autorange="reversed", automargin=True, showgrid=False)
    figure.update_layout(margin={"t": 110, "b": 20})
    return figure


def _cells(ratios: np.ndarray, known: np.ndarray) -> list[list[str]]:
    return [[_cell(r, k) for r, k in zip(*pair, strict=True)] for pair in zip(ratios, known, strict=True)]


def _cell(ratio: float, known: bool) -> str:
    if ratio != ratio:
        return ""
    return f"{ratio:.2f}" if known else f"({ratio:.2f})"
