"""Section of the diagnosis: errors of the simulation, their causes, certainty and size."""

from __future__ import annotations

import math
import re
from statistics import NormalDist

import pandas as pd
import plotly.graph_objects as go

from truing.report.absorption import absorbed_by, most_shifted_words
from truing.report.calibration.calibrations import displayed_calibration
from truing.report.coefficient_map import coefficient_map
from truing.report.column_heads import CAUSE, PARAMETER, UNIT, Head
from truing.report.diagnosis.adequacy import adequacy
from truing.report.diagnosis.assessed_causes import RIVAL, SUSPECTED, AssessedCause, accepted_of, assessed_causes
from truing.report.diagnosis.detectable_sizes import hidden
from truing.report.diagnosis.effect_units import handy_unit, size_text, stem
from truing.report.diagnosis.evidence import evidence
from truing.report.diagnosis.findings import doubt_text
from truing.report.diagnosis.gain import gain_section
from truing.report.diagnosis.headline import clause
from truing.report.diagnosis.load_corrections import unrecorded_loads
from truing.report.diagnosis.next_measurements import requested_measurements
from truing.report.diagnosis.pulls import changes, pulls
from truing.report.diagnosis.verdict_sentences import certainty, counted, lower
from truing.report.figure_style import BAR, BLUE, GREY, label, style
from truing.report.numbers import capitalised, count_text, printed, rough, sign, with_uncertainty
from truing.report.page import Drawn, Listing, ReportSection
from truing.report.reasons import why_no_diagnosis
from truing.report.tables import Tables, cell, table_or_none
from truing.report.wordings.claim import ParameterSize

_TITLE = "Diagnosis"

# Number of dependences stated that only a model without the findings shows; the table has all.
_CONDITIONAL = 2
# From this number of parameters of a kind on, a figure replaces the table.
_WORTH_DRAWING = 3
_TICKS = 24


def diagnosis(tables: Tables) -> ReportSection | None:
    """Return the section with findings, evidence, gain, geometry, detectable sizes, and next measurements."""
    if "diagnosis" not in tables:
        return None
    rows = assessed_causes(tables)
    if not rows:
        why = why_no_diagnosis(tables)
        return ReportSection("diagnosis", _TITLE, capitalised(why))
    accepted = accepted_of(rows)
    rivals = [row for row in rows if row.verdict == RIVAL]
    conditional = [row for row in accepted if row.is_conditional]
    folded = conditional[_CONDITIONAL:]
    reported = [_accepted(row, tables) for row in accepted if row not in folded]
    if folded:
        more = f"Without the other findings, {count_text(len(folded), 'more dependence')} of the residuals would show."
        reported.append(("none", f"{more} The table below lists all."))
    reported += [
        ("warn", f"Alternative that this campaign cannot rule out: {lower(_finding(row, tables))}") for row in rivals
    ]
    listings = tuple(listing for listing in (_words([*accepted, *rivals]),) if listing.rows)
    parts = tuple(part for part in (adequacy(tables), *_parts(rows, accepted, tables)) if part is not None)
    return ReportSection(
        "diagnosis", _TITLE, counted(rows, tables), (), listings, statements=tuple(reported), parts=parts
    )


def _parts(rows: list[AssessedCause], causes: list[AssessedCause], tables: Tables) -> list[ReportSection | None]:
    return [
        evidence(rows),
        gain_section(rows, tables),
        sizes(causes, tables) if causes else None,
        pulls(tables),
        _absorption_link(tables) if any(row.cause.startswith("platform-deformation") for row in causes) else None,
        unrecorded_loads(rows, tables),
        hidden(rows, tables),
        requested_measurements(rows, tables),
        changes(tables),
    ]


def _accepted(row: AssessedCause, tables: Tables) -> tuple[str, str]:
    """Return a finding with its mark, and the reason if it is only suspected."""
    if row.verdict == SUSPECTED:
        doubt = doubt_text(row.reason_code, row.held_out_growth)
        return "warn", f"Suspected, not confirmed: {lower(_finding(row, tables))} Reason: {doubt}."
    return "warn" if row.is_noise else "found", _finding(row, tables)


def _finding(row: AssessedCause, tables: Tables) -> str:
    """Return a finding in words: cause, subject and size, then its certainty."""
    sure = certainty(row)
    return f"{clause(row, tables)}. {sure}." if sure else f"{clause(row, tables)}."


def _words(rows: list[AssessedCause]) -> Listing:
    """Return the full explanations from the tables."""
    reported = tuple((row.name, printed(row.explanation), printed(row.then)) for row in rows)
    heads = (
        CAUSE,
        Head("what the data say", "Result of the assessment in words, with sizes, errors and probabilities."),
        Head("next measurement", "Measurement that confirms the cause, or separates it from its rivals."),
    )
    return Listing(heads, reported, (), "Full sentences, as in diagnosis.parquet", True, "diagnosis.parquet")


def _absorption_link(tables: Tables) -> ReportSection | None:
    """Return a link to the absorption map with its main sentence."""
    fitted = table_or_none(tables, "calibration")
    text = most_shifted_words(absorbed_by(tables, displayed_calibration(tables, fitted))) if fitted is not None else ""
    if not text:
        return None
    see = (("knowledge", "Absorption map of all parameters"),)
    return ReportSection("swallowed", "Bias of the parameters if the deformation is ignored", text, see=see)


def sizes(causes: list[AssessedCause], tables: Tables) -> ReportSection:
    """Return the parameters of all findings, and the combinations that are determined where no single one is."""
    drawn = [picture for row in causes for picture in _pictures(row)]
    listings = tuple(_parameters(row) for row in causes if row.sizes)
    numbers = sum(size.number is not None for row in causes for size in row.sizes)
    lead = f"{count_text(numbers, 'parameter')} of the accepted causes, ± one standard deviation."
    combined = [(row, combinations) for row in causes if len(combinations := _combinations(row, tables))]
    text = " ".join([lead, *(_combined_words(row, combinations) for row, combinations in combined)])
    tables_of_combinations = tuple(_combined(row, combinations) for row, combinations in combined)
    return ReportSection("sizes", "Sizes of the effects", text, tuple(drawn), (*tables_of_combinations, *listings))


def _combinations(row: AssessedCause, tables: Tables) -> pd.DataFrame:
    """Return the determined combinations of a cause's parameters, none where single parameters are determined."""
    table = table_or_none(tables, "determined_combinations")
    if table is None:
        return pd.DataFrame()
    return table[(table["cause"] == row.cause) & (table["subject"].fillna("") == row.subject)]


def _combined_words(row: AssessedCause, table: pd.DataFrame) -> str:
    determined = count_text(len(table), "combination")
    return (
        f"{row.name[:1].upper()}{row.name[1:]}: the data determine {determined} of the {len(row.sizes)} parameters; no "
        "single parameter differs significantly from zero."
    )


def _combined(row: AssessedCause, table: pd.DataFrame) -> Listing:
    reported = table[["determined", "combined_value", "combined_sigma", "unit"]].itertuples(index=False)
    cells = []
    for text, value, sigma, unit in reported:
        factor, handy = handy_unit(stem(row.sizes[0].name), cell(unit), abs(value))
        size = with_uncertainty(factor * value, factor * sigma, sign(handy))
        cells.append((text, printed(size), rough(abs(value) / sigma)))
    heads = (
        Head("combination, best determined first", "Combination of parameters that the data determine by itself."),
        Head("value", "Estimate of the combination, with one standard deviation."),
        Head("in standard deviations", "Estimate divided by its standard deviation."),
    )
    caption = f"Determined combinations of {row.name}"
    return Listing(heads, tuple(cells), caption=caption, held_by="determined_combinations.parquet")


def _pictures(row: AssessedCause) -> Drawn:
    matrix = _matrix(row)
    if matrix is not None:
        return [matrix]
    sizes_by_unit: dict[str, list[ParameterSize]] = {}
    for size in row.sizes:
        if size.number is not None and size.sigma is not None:
            sizes_by_unit.setdefault(stem(size.name), []).append(size)
    return [
        (
            _parameter_bars(row, kind, several),
            "A parameter whose interval contains zero is not significant.",
        )
        for kind, several in sizes_by_unit.items()
        if len(several) >= _WORTH_DRAWING
    ]


def _matrix(row: AssessedCause) -> tuple[object, str] | None:
    """Return the heat map of K; entries that chance may have caused among so many are in brackets."""
    entries = row.sizes_of("K")
    legs = math.isqrt(len(entries))
    if legs < 2 or legs**2 != len(entries):
        return None
    bound = NormalDist().inv_cdf(1.0 - 0.025 / len(entries))
    table = pd.DataFrame(
        {
            "model": "matrix",
            "leg": [k // legs + 1 for k in range(len(entries))],
            "column": [k % legs + 1 for k in range(len(entries))],
            "coefficient": [entry.number for entry in entries],
            "sigma": [math.nan if entry.sigma is None else entry.sigma for entry in entries],
        }
    )
    table = table.assign(significant=table["coefficient"].abs() > bound * table["sigma"])
    words = "Row: attachment that shifts. Column: actuator that moves it."
    return coefficient_map(table), words


def _parameter_bars(row: AssessedCause, kind: str, several: list[ParameterSize]) -> go.Figure:
    """Return parameters of a kind, such as one per leg, with intervals of 95 %."""
    largest = max(abs(size.number or 0.0) for size in several)
    factor, unit = handy_unit(kind, several[0].unit, largest)
    values = [factor * (size.number or 0.0) for size in several]
    sigma = [factor * (size.sigma or 0.0) for size in several]
    indices = list(range(len(several)))
    figure = go.Figure()
    figure.add_trace(
        go.Bar(
            x=indices,
            y=values,
            error_y={"type": "data", "array": [BAR * s for s in sigma], "thickness": 1.5, "width": 4, "color": GREY},
            marker={"color": BLUE},
            text=[label(size.name) for size in several],
            textposition="none",
            customdata=[with_uncertainty(v, s, sign(unit)) for v, s in zip(values, sigma, strict=True)],
            hovertemplate="%{text}: %{customdata}<extra></extra>",
        )
    )
    kind_words = kind.replace("_", " ")
    style(figure, f"{label(row.name)}: {label(kind_words)}", "Bars: value; whiskers: 95 % interval", 360)
    step = max(1, -(-len(several) // _TICKS))
    ticks = [_subject_of_size(size) for size in several]
    figure.update_xaxes(tickvals=indices[::step], ticktext=[label(t) for t in ticks[::step]], showgrid=False)
    unit_words = f" ({printed(sign(unit))})" if unit else ""
    figure.update_yaxes(title_text=f"{label(kind_words)}{unit_words}", zeroline=True, zerolinecolor=GREY)
    figure.update_layout(showlegend=False)
    return figure


def _subject_of_size(size: ParameterSize) -> str:
    numbered = re.search(r"_(\d+)$", size.name)
    return f"leg {numbered[1]}" if numbered else size.name


def _parameters(row: AssessedCause) -> Listing:
    cells = tuple((size.name, *_cells(size)) for size in row.sizes)
    caption = f"Parameters of {row.name}"
    heads = (
        PARAMETER,
        Head("value", "Estimate with one standard deviation, in a unit that is easy to read."),
        Head("in the units of the tables", "Estimate as the artifacts hold it, in the unit of the column unit."),
        UNIT,
    )
    return Listing(heads, cells, caption=caption, folded=len(cells) > 8, held_by="diagnosis.parquet")


def _cells(size: ParameterSize) -> tuple[str, str, str]:
    text = printed(size_text(size.name, size.value, size.sigma, size.unit))
    number = with_uncertainty(size.number, size.sigma) if size.number is not None else _text(size.value)
    return text, number, sign(size.unit)


def _text(value: object) -> str:
    return "" if value is None else str(value)
