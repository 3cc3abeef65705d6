"""Page of the power of a planned campaign: detectable size of each effect, and rate of detection."""

from __future__ import annotations

import math
from collections.abc import Sequence

import pandas as pd
import plotly.graph_objects as go

from truing.report.column_heads import CAUSE, Head
from truing.report.diagnosis.effect_units import handy_unit, plain_size
from truing.report.figure_style import BLUE, GREY, ORANGE, figure_template, label, style
from truing.report.numbers import count_text, printed, rough
from truing.report.page import Listing, PageHead, ReportSection
from truing.report.wordings.catalogue import cause_words

CONCERNS = Head("concerns", "Part that the effect concerns: the whole, or one leg, target or other part.")
SIZE_HEADS = (
    CAUSE,
    CONCERNS,
    Head("theory", "Size from which theory expects the effect to be found with a probability of 80 %."),
    Head(
        "detectable from",
        "Size from which drawn campaigns show the effect with a probability of 80 %; brackets hold its 95 % interval.",
    ),
    Head(
        "19 of 20 times from",
        "Size from which drawn campaigns show the effect with a probability of 95 %; brackets hold its 95 % interval.",
    ),
    Head(
        "also named as",
        "Most frequent other causes found in drawn campaigns that did not name this effect; brackets hold counts.",
    ),
)
PHOTOGRAPH_HEADS = (
    Head("cause that photographs show", "Effect on the cameras or on the rays that photographs would show."),
    CONCERNS,
    Head("theory, in the run", "Size that the run would have found with a probability of 80 %, by theory."),
)
_NEVER = "not at any plausible size"
_NOT_DRAWN = "–"


def power_head(campaign: str, sizes: pd.DataFrame, rates: pd.DataFrame) -> PageHead:
    """Return the head of the page with the main results."""
    alarms = rates[rates["cause"] == "nothing"]
    text = [("none", text) for text in (alarm_words(rates),) if text]
    blind = list(dict.fromkeys(cause_words(c) for c in sizes[sizes["expected_80"].isna()]["cause"]))
    if blind:
        text.append(("warn", f"This campaign would not show {', '.join(blind)} at any plausible size."))
    drawn = int(rates["campaigns"].sum())
    if not drawn:
        text.append(("none", "By theory only: no campaign was simulated."))
    tiles = [("campaigns simulated and diagnosed", f"{drawn:,}"), ("kinds of effect", str(len(sizes)))]
    if len(alarms):
        tiles.append(("false alarms", f"{100 * alarms['found'].iloc[0]:.1f} %"))
    return PageHead(f"{campaign}: what it would show", tuple(text), tuple(tiles))


def alarm_words(rates: pd.DataFrame) -> str:
    """Return the rate of false alarms in words; empty where it was not tested."""
    alarms = rates[rates["cause"] == "nothing"]
    if not len(alarms):
        return ""
    row = alarms.iloc[0]
    watched, tried = round(row["found"] * row["campaigns"]), int(row["campaigns"])
    bounds = f"{100 * row['found_lower']:.1f} to {100 * row['found_upper']:.1f} %"
    return f"False alarms: an effect was found in {watched} of {tried} campaigns without any effect ({bounds})."


@figure_template()
def power_sections(sizes: pd.DataFrame, rates: pd.DataFrame) -> list[ReportSection]:
    """Return the sizes of all causes, then a section for each with its rates of detection and naming."""
    lead = (
        "The diagnosis of a campaign laid out like this one finds an effect of the stated size with a probability of "
        "80 % (95 % in the next column). Sizes are root mean squares of the parameter; brackets hold 95 % intervals "
        "by the drawn campaigns."
    )
    listing = Listing(SIZE_HEADS, tuple(map(tuple, size_rows(sizes))), caption="Smallest sizes that are detected")
    sections = [ReportSection("sizes", "Detectable sizes", lead, listings=(listing,))]
    drawn = rates[rates["cause"] != "nothing"]
    for cause, group in drawn.groupby("cause", sort=False):
        sections.append(_of_cause(str(cause), group))
    return sections


def section_of_photographs(text: str, rows: Sequence[Sequence[str]]) -> ReportSection:
    """Return the section on detectable effects in photographs, for which no campaign is simulated."""
    listing = Listing(PHOTOGRAPH_HEADS, tuple(map(tuple, rows)), caption="What the run would have shown, by theory")
    return ReportSection("photographs", "What photographs show", text, listings=(listing,) if rows else ())


def size_rows(sizes: pd.DataFrame) -> list[list[str]]:
    """Return the rows of the listing, as text."""
    return [
        [
            cause_words(row["cause"]),
            row["concerns"],
            _size(row, "expected_80", _NEVER),
            _with_bounds(row, "80"),
            _with_bounds(row, "95"),
            row["instead"] or "",
        ]
        for row in sizes.to_dict("records")
    ]


def _size(row: dict[str, object], name: str, otherwise: str) -> str:
    value = row[name]
    if not isinstance(value, float) or math.isnan(value):
        return otherwise
    beside = f" (with {row['beside']})" if row["beside"] else ""
    return f"{row['parameter']} {printed(plain_size(str(row['parameter']), value, str(row['unit'])))}{beside}"


def _with_bounds(row: dict[str, object], level: str) -> str:
    values = [row[f"{name}_{level}"] for name in ("found", "lower", "upper")]
    numbers = [value for value in values if isinstance(value, float) and not math.isnan(value)]
    if len(numbers) < 3:
        return _NOT_DRAWN
    factor, unit = handy_unit(str(row["parameter"]), str(row["unit"]), numbers[0])
    estimate, low, high = (rough(factor * number) for number in numbers)
    return f"{estimate} ({low} to {high}) {printed(unit)}".strip()


def _of_cause(cause: str, rates: pd.DataFrame) -> ReportSection:
    lead = f"{count_text(int(rates['campaigns'].sum()), 'campaign')} drawn with this effect hidden at several sizes."
    sorts = rates.groupby(["concerns", "parameter", "unit", "beside"], sort=False)
    figures = tuple((_curve(of_sort, str(key[0])), _caption(of_sort)) for key, of_sort in sorts)
    return ReportSection(f"cause-{cause}", cause_words(cause), lead, figures=figures)


def _caption(rates: pd.DataFrame) -> str:
    tried = int(rates["campaigns"].min())
    return f"{count_text(tried, 'campaign')} per size; bars: 95 % interval of the rate."


def _curve(rates: pd.DataFrame, concerns: str) -> go.Figure:
    """Return the rates of detection and naming of an effect against its size, with the theoretical power."""
    first = rates.iloc[0]
    factor, unit = handy_unit(first["parameter"], first["unit"], float(rates["size"].median()))
    sizes = factor * rates["size"]
    figure = go.Figure()
    figure.add_trace(go.Scatter(x=sizes, y=100 * rates["expected"], name="theory", line={"color": GREY, "dash": "dot"}))
    for outcome, colour, shift in (("found", BLUE, 0.99), ("named", ORANGE, 1.01)):  # one would hide the other
        figure.add_trace(_rates(sizes * shift, rates, outcome, colour))
    beside = f" with {first['beside']}" if first["beside"] else ""
    style(figure, label(f"{first['parameter']}{beside}, {concerns}"), "Rate of detection, and of the correct name", 340)
    axis = f"{first['parameter']}, root mean square, {printed(unit)}".rstrip(", ")
    figure.update_xaxes(type="log", title={"text": axis})
    figure.update_yaxes(range=[-3, 103], title={"text": "% of campaigns"})
    return figure


def _rates(sizes: pd.Series, rates: pd.DataFrame, outcome: str, colour: str) -> go.Scatter:
    value, lower, upper = (100 * rates[f"{outcome}{bound}"] for bound in ("", "_lower", "_upper"))
    return go.Scatter(
        x=sizes,
        y=value,
        name=outcome,
        mode="markers",
        marker={"color": colour, "size": 8},
        error_y={"type": "data", "symmetric": False, "array": upper - value, "arrayminus": value - lower},
    )
