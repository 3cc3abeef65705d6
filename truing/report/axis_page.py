"""Section of a single axis: error of each encoder against its command, before and after modelling."""

from __future__ import annotations

import numpy as np
import pandas as pd
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from truing.report.column_heads import Head
from truing.report.figure_style import BLUE, ORANGE, style
from truing.report.numbers import count_text, rough, sign
from truing.report.page import Listing, ReportSection
from truing.report.tables import Tables, table_or_none

ENCODERS = {"motor": "encoder at the motor", "load": "encoder at the load", "measured": "outside instrument"}
_DIRECTIONS = ((1, BLUE, "triangle-right", "coming up"), (-1, ORANGE, "triangle-left", "coming down"))
_CAPTION = (
    "Each point is one reading minus its prediction. Two bands by colour show lost motion, and a slope shows a scale "
    "error. A step that depends on neither command nor direction shows a zero shift."
)
_CORRECTIONS = (
    "For errors by the command and the direction of approach alone, the controller form of truing export has a table "
    "of corrections."
)


def axis(tables: Tables) -> ReportSection | None:
    """Return the section of an axis with errors by the command alone and by the extended model; None
    without an axis."""
    errors = table_or_none(tables, "axis_errors")
    if errors is None:
        return None
    encoders = list(dict.fromkeys(errors["encoder"]))
    rows = count_text(errors["pose"].nunique(), "row")
    recorded = ", ".join(ENCODERS[name] for name in encoders)
    lead = f"{rows} of one axis, recorded by {recorded}. A constant zero of each is subtracted."
    pictures = _pictures(errors)
    if len(pictures) > 1 and "measured" in encoders:
        lead += f" {_CORRECTIONS}"
    figures = tuple((_drawn(errors, column, title), _CAPTION) for column, title in pictures)
    return ReportSection("axis", "Axis", lead, figures=figures, listings=(_listing(errors, encoders),))


def _pictures(errors: pd.DataFrame) -> list[tuple[str, str]]:
    before = ("missed_before", "Readings minus the prediction by the command alone")
    after = ("missed_after", "Readings minus the prediction by the extended model")
    changed = bool(np.any(errors["missed_before"] != errors["missed_after"]))
    return [before, after] if changed else [before]


def _listing(errors: pd.DataFrame, encoders: list[str]) -> Listing:
    unit = sign(str(errors["unit"].iloc[0]))
    heads = (
        Head("recorded by", "Encoder or instrument, and whether its rows were fitted or held out."),
        Head("rows", "Number of rows."),
        Head(f"rms before, {unit}", "Root mean square of measured minus predicted without the causes found."),
        Head(f"rms after, {unit}", "Root mean square of measured minus predicted with the causes found."),
        Head(f"noise alone, {unit}", "Rms error that declared noise alone gives."),
    )
    mask = errors["role"] == "verification"
    reported = []
    for role, of_role in (("fitted", errors[~mask]), ("held out", errors[mask])):
        for name in encoders:
            part = of_role[of_role["encoder"] == name]
            if len(part):
                sizes = [rough(float(np.sqrt(np.mean(part[c] ** 2)))) for c in ("missed_before", "missed_after")]
                reported.append(
                    (f"{ENCODERS[name]}, {role}", str(len(part)), *sizes, rough(float(part["noise_floor"].max())))
                )
    return Listing(heads, tuple(reported), caption="Errors of the predictions", held_by="axis_errors.parquet")


def _drawn(errors: pd.DataFrame, column: str, title: str) -> go.Figure:
    """Return errors over commands, one row of panels per encoder, coloured by the direction of approach."""
    encoders = list(dict.fromkeys(errors["encoder"]))
    unit, command = sign(str(errors["unit"].iloc[0])), sign(str(errors["command_unit"].iloc[0]))
    figure = make_subplots(
        rows=len(encoders),
        cols=1,
        shared_xaxes=True,
        vertical_spacing=0.3 / len(encoders),
        subplot_titles=[ENCODERS[name] for name in encoders],
    )
    for index, name in enumerate(encoders, 1):
        for direction, colour, symbol, words in _DIRECTIONS:
            rows = errors[(errors["encoder"] == name) & (errors["approach"] == direction)]
            figure.add_trace(
                go.Scatter(
                    x=rows["command"].to_numpy(),
                    y=rows[column].to_numpy(),
                    mode="markers",
                    name=words,
                    legendgroup=words,
                    showlegend=index == 1,
                    marker={"color": colour, "symbol": symbol, "size": 7},
                    customdata=rows["pose"].astype(str).to_numpy(),
                    hovertemplate=f"row %{{customdata}}, %{{x:.6g}} {command}: %{{y:.3g}} {unit}<extra></extra>",
                ),
                row=index,
                col=1,
            )
        figure.update_yaxes(title_text=f"error ({unit})", row=index, col=1)
    figure.update_xaxes(title_text=f"command ({command})", row=len(encoders), col=1)
    style(figure, title, "Colour: direction of approach", 180 + 200 * len(encoders))
    # clear of the names above the panels, and of the buttons on the right
    above = {"orientation": "h", "yref": "container", "y": 0.98, "yanchor": "top", "x": 0.0}
    figure.update_layout(legend=above, margin={"t": 110})
    return figure
