"""How large what was found is: every parameter with its uncertainty, as bars, as a heat map, and in a table."""

from __future__ import annotations

import math
import re
from statistics import NormalDist
from typing import TYPE_CHECKING, Any

from truing.report.deformation.figures import coefficient_map
from truing.report.diagnosis.effect_units import handy_unit, stem, told_size
from truing.report.diagnosis.judged import Judged
from truing.report.figure_style import BLUE, GREY, label, style
from truing.report.numbers import count, printed, sign, with_uncertainty
from truing.report.page import Listing, Section
from truing.report.wordings.claim import Size

if TYPE_CHECKING:
    import plotly.graph_objects as go

Drawn = list[tuple[object, str]]
# Parameters of a kind from which on a picture says more than a table.
_WORTH_DRAWING = 3
_BAR = 1.96
_TICKS = 24


def sizes(found: list[Judged]) -> Section:
    """The parameters of everything that was found."""
    drawn = [picture for row in found for picture in _pictures(row)]
    listings = tuple(_parameters(row) for row in found if row.sizes)
    numbers = sum(size.number is not None for row in found for size in row.sizes)
    lead = f"{count(numbers, 'number')} of the extended model, each with one standard deviation."
    return Section("sizes", "How large", lead, tuple(drawn), listings)


def _pictures(row: Judged) -> Drawn:
    matrix = _matrix(row)
    if matrix is not None:
        return [matrix]
    own: dict[str, list[Size]] = {}
    for size in row.sizes:
        if size.number is not None and size.sigma is not None:
            own.setdefault(stem(size.name), []).append(size)
    return [
        (parameter_bars(row, kind, several), "An interval that holds the zero line is a parameter that may be nothing.")
        for kind, several in own.items()
        if len(several) >= _WORTH_DRAWING
    ]


def _matrix(row: Judged) -> tuple[object, str] | None:
    """The heat map of K; entries that chance may have made, among as many, are set in brackets."""
    entries = row.sizes_of("K")
    legs = math.isqrt(len(entries))
    if legs < 2 or legs**2 != len(entries):
        return None
    import pandas as pd

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


def parameter_bars(row: Judged, kind: str, several: list[Size]) -> go.Figure:
    """Parameters of a kind, one per leg or so, with intervals of 95 %."""
    import plotly.graph_objects as go

    largest = max(abs(size.number or 0.0) for size in several)
    factor, unit = handy_unit(kind, several[0].unit, largest)
    values = [factor * (size.number or 0.0) for size in several]
    sigma = [factor * (size.sigma or 0.0) for size in several]
    places = list(range(len(several)))
    figure = go.Figure()
    figure.add_trace(
        go.Bar(
            x=places,
            y=values,
            error_y={"type": "data", "array": [_BAR * s for s in sigma], "thickness": 1.5, "width": 4, "color": GREY},
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
    ticks = [_place(size) for size in several]
    figure.update_xaxes(tickvals=places[::step], ticktext=[label(t) for t in ticks[::step]], showgrid=False)
    unit_words = f" ({printed(sign(unit))})" if unit else ""
    figure.update_yaxes(title_text=f"{label(kind_words)}{unit_words}", zeroline=True, zerolinecolor=GREY)
    figure.update_layout(showlegend=False)
    return figure


def _place(size: Size) -> str:
    numbered = re.search(r"_(\d+)$", size.name)
    return f"leg {numbered[1]}" if numbered else size.name


def _parameters(row: Judged) -> Listing:
    cells = tuple((size.name, *_cells(size)) for size in row.sizes)
    caption = f"Parameters of {row.name}"
    heads = ("parameter", "value", "in the units of the tables", "unit")
    return Listing(heads, cells, caption=caption, folded=len(cells) > 8, held_by="diagnosis.parquet")


def _cells(size: Size) -> tuple[str, str, str]:
    told = printed(told_size(size.name, size.value, size.sigma, size.unit))
    number = with_uncertainty(size.number, size.sigma) if size.number is not None else _text(size.value)
    return told, number, sign(size.unit)


def _text(value: Any) -> str:
    return "" if value is None else str(value)
