"""Design parameters of flexures and legs: effect of a tolerance next to the noise, identifiable or not."""

from __future__ import annotations

import pandas as pd
import plotly.graph_objects as go

from truing.report.column_heads import MODEL_OF_LEGS, PARAMETER, Head
from truing.report.figure_style import BLUE, GREY, style
from truing.report.numbers import count_text, plain, quantity, sign
from truing.report.page import Drawn, Listing
from truing.report.tables import Row, Tables, table_or_none

_OF_LEGS = {"beta": "β", "flexure_length": "l_b"}
_BODIES = {"flexure": "flexures", "tube": "legs"}
_ROW, _AROUND = 18, 190


def sensitivities(tables: Tables) -> Drawn:
    """Return the figure of the effect of each tolerance, next to the noise of the closure."""
    table = table_or_none(tables, "flexure_parameters")
    if table is None:
        return []
    names = [f"{r.model}: {_named(r.parameter, r.leg)}" for r in table.itertuples()]
    figure = go.Figure()
    for column, words, colour, symbol in (
        ("sensitivity_um", "effect of one tolerance", BLUE, "circle"),
        ("closure_noise_um", "noise of the closure", GREY, "line-ns-open"),
    ):
        marker = {"color": colour, "size": 9, "symbol": symbol}
        figure.add_trace(go.Scatter(x=table[column], y=names, mode="markers", name=words, marker=marker))
    title, subtitle = "Effect of the design parameters of flexures", "Rms change of the closure by one tolerance"
    style(figure, title, subtitle, _AROUND + _ROW * len(table))
    figure.update_xaxes(type="log", title_text="µm")
    figure.update_yaxes(autorange="reversed", automargin=True, type="category")
    words = (
        "A pose adds little where the effect is far below the noise, or where other parameters have the same effect."
    )
    return [(figure, f"{_words(table)}. {words}")]


def design_parameters(tables: Tables) -> tuple[Listing, ...]:
    """Return the listing of the design parameters, where a model uses flexures."""
    table = table_or_none(tables, "flexure_parameters")
    if table is None:
        return ()
    rows = tuple(_row(r) for r in table.itertuples())
    marks = tuple("pass" if known else "none" for known in table["identifiable"])
    heads = (
        MODEL_OF_LEGS,
        PARAMETER,
        Head("nominal", "Value of the parameter in campaign.toml."),
        Head("tolerance", "Standard deviation of the parameter by manufacture: as declared, else its nominal value."),
        Head("effect", "Rms change of the leg's closure over the poses if the parameter changes by one tolerance."),
        Head("noise", "Rms noise of the leg's closure by poses and readings."),
        Head("sigma / tolerance", "Standard deviation from the data alone divided by the tolerance."),
        Head("identifiable", "Whether the data determine the parameter better than its tolerance."),
    )
    caption = f"{_words(table)}. Tolerance: as declared, else 100 % of the nominal value"
    return (Listing(heads, rows, marks, caption, True, "flexure_parameters.parquet"),)


def _words(table: pd.DataFrame) -> str:
    known = int(table["identifiable"].sum())
    return f"{known or 'None'} of {count_text(len(table), 'design parameter')} of flexures and legs can be identified"


def _row(r: Row) -> tuple[str, ...]:
    unit = sign(r.unit) if r.unit != "1" else ""
    return (
        r.model,
        _named(r.parameter, r.leg),
        f"{plain(r.nominal)} {unit}".strip(),
        f"{plain(r.tolerance)} {unit}".strip(),
        quantity(r.sensitivity_um, "um"),
        quantity(r.closure_noise_um, "um"),
        plain(r.sigma_over_tolerance),
        "yes" if r.identifiable else "no",
    )


def _named(parameter: str, leg: float) -> str:
    """Return ``β of leg 1``, or ``bending stiffness of the flexures`` where legs share the parameter."""
    if leg == leg:
        return f"{_OF_LEGS.get(parameter, parameter)} of leg {int(leg)}"
    body, _, kind = parameter.partition("_")
    return f"{kind} stiffness of the {_BODIES.get(body, body)}"
