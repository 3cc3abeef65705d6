"""Section on the tolerances of a force sensor: errors of its platform by each (force-sensor paper, figures 8-9).

Dots are drawn sensors; a bar is the 95 % interval of their rms; a line is the rms to first order.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd
import plotly.graph_objects as go

from truing.report.column_heads import Head
from truing.report.figure_style import BLUE, GREEN, GREY, ORANGE, RED, figure_template, style
from truing.report.numbers import percent, plain, sign
from truing.report.page import Listing, PageHead, ReportSection
from truing.report.tables import Tables, table_or_none

_TITLE = "Tolerances as designed"
_ALL = "all"
_NAMES = {
    "platform_radius": "platform radius",
    "base_radius": "base radius",
    "lower_clearance": "lower clearance",
    "middle_clearance": "middle clearance",
    "sensor_installation": "sensor installation",
    _ALL: "all together",
}
_SAMPLES = {"position": "platform_shift_um", "attitude": "platform_turn_arcsec"}
_HEADS = (
    Head("source", "Tolerance of the sensor that moves its platform; all: every tolerance at once."),
    Head("tolerance T", "Full width of the tolerance zone; the standard deviation is a sixth of it."),
    Head("rms", "Rms error of the platform to first order in the tolerances."),
    Head(
        "rms of 100 drawn sensors (95 %)", "Rms error of sensors drawn at random, with the 95 % interval of this rms."
    ),
    Head("95 % of sensors below", "Error that 95 % of all sensors do not exceed."),
    Head("share of the variance", "Part of the variance of the error by all tolerances that this one explains."),
)
_LINK_HEADS = (
    Head("link", "Number of the link from the base's axis; links 1 and 7 end at imaginary joints."),
    Head("along the normal", "Shift from the previous joint axis to this one; along the radius for links 1 and 7."),
    Head("along the axis", "Distance along the joint axis between the normals to the previous and the next axis."),
    Head("angle about the axis", "Angle about the joint axis from the normal before it to the normal behind it."),
    Head("twist to the next axis", "Angle about the next normal from this joint axis to the next one."),
    Head("axis", "Components of the unit vector along the joint axis, in the frame of the base."),
)
_SOURCE = Head("1 µm of", "Length of the leg that has an error of 1 µm.")
_COLOURS = (BLUE, ORANGE, GREEN, RED, "#CC79A7")
_SPREAD = 0.28  # half width of the cloud of dots


def tolerances(tables: Tables) -> ReportSection | None:
    """Return the section with the errors of the platform by each tolerance; None without tolerances."""
    errors, samples = table_or_none(tables, "tolerance_errors"), table_or_none(tables, "tolerance_samples")
    if errors is None or samples is None:
        return None
    words = tolerance_words(errors)
    figures = tuple(
        (_figure(errors, samples, part), text)
        for part, text in (
            ("position", "Distance of the platform's origin from its place as designed."),
            ("attitude", "Rotation of the platform from its attitude as designed."),
        )
    )
    caption = "Share of the variance of position and attitude; a tolerance with a small share may be wider."
    listings = tuple(_listing(errors, part) for part in _SAMPLES)
    return ReportSection("tolerances", _TITLE, " ".join(words), (*figures, (_shares(errors), caption)), listings)


def tolerance_words(errors: pd.DataFrame) -> list[str]:
    """Return the main results in sentences, from tolerance_errors."""
    clauses = []
    for part in _SAMPLES:
        rows = errors[errors["pose_part"] == part]
        row, single_sources = rows[rows["error_source"] == _ALL].iloc[0], rows[rows["error_source"] != _ALL]
        largest = single_sources.nlargest(1, "variance_share").iloc[0]
        unit = sign(str(row["unit"]))
        text = f"All tolerances together: rms {part} error {plain(row['first_order'])} {unit}, "
        text += f"below {plain(row['error_95'])} {unit} for 95 % of sensors."
        name, share = _NAMES[largest["error_source"]], percent(100.0 * largest["variance_share"])
        clauses += [text, f"Largest share in the {part} variance: {name}, {share}."]
    return [
        *clauses,
        "These errors follow from the design alone, without load and without measurements; the legs are closed loops.",
    ]


def _figure(errors: pd.DataFrame, samples: pd.DataFrame, part: str) -> go.Figure:
    """Return the drawn errors of each source with the band of their rms, and the rms to first order."""
    rows = errors[errors["pose_part"] == part].reset_index(drop=True)
    figure, unit = go.Figure(), sign(str(rows["unit"].iloc[0]))
    aside = np.random.default_rng(0).uniform(-_SPREAD, _SPREAD, len(samples))
    row = samples["error_source"].map({name: k for k, name in enumerate(rows["error_source"])})
    dots = {"color": BLUE, "size": 4, "opacity": 0.5}
    figure.add_trace(
        go.Scatter(x=row + aside, y=samples[_SAMPLES[part]], mode="markers", marker=dots, name="one drawn sensor")
    )
    bars = {"type": "data", "symmetric": False, "array": rows["high"] - rows["sample_rms"]}
    bars |= {"arrayminus": rows["sample_rms"] - rows["low"], "color": RED, "thickness": 3, "width": 4}
    figure.add_trace(
        go.Scatter(
            x=rows.index + _SPREAD + 0.08,
            y=rows["sample_rms"],
            mode="markers",
            marker={"color": RED, "size": 3},
            error_y=bars,
            name="rms of the drawn sensors, 95 %",
        )
    )
    ends = np.stack([rows.index - 0.42, rows.index + 0.42, np.full(len(rows), np.nan)], 1).ravel()
    heights = np.repeat(rows["first_order"].to_numpy(), 3)
    black = {"color": "black", "width": 1.5}
    figure.add_trace(
        go.Scatter(x=ends, y=heights, mode="lines", line=black, name="rms to first order", hoverinfo="skip")
    )
    style(figure, f"Error of the {part} by each tolerance", "each tolerance alone, then all together", 400)
    figure.update_xaxes(tickvals=list(rows.index), ticktext=[_NAMES[name] for name in rows["error_source"]], color=GREY)
    figure.update_yaxes(title={"text": f"{part} error, {unit}"}, rangemode="tozero")
    figure.update_layout(legend={"orientation": "h", "y": -0.14})
    return figure


def _shares(errors: pd.DataFrame) -> go.Figure:
    figure = go.Figure()
    single_sources = errors[errors["error_source"] != _ALL]
    for (source, group), colour in zip(single_sources.groupby("error_source", sort=False), _COLOURS, strict=False):
        name, shares = _NAMES[str(source)], 100.0 * group["variance_share"]
        bar = {"orientation": "h", "marker": {"color": colour}}
        figure.add_trace(go.Bar(y=group["pose_part"], x=shares, name=name, **bar))
    style(figure, "Share of each tolerance in the variance of the error", "per cent", 280)
    figure.update_layout(barmode="stack", legend={"traceorder": "normal"})
    return figure


def _listing(errors: pd.DataFrame, part: str) -> Listing:
    of_part = errors[errors["pose_part"] == part]
    unit = sign(str(of_part["unit"].iloc[0]))
    rows = tuple(
        (
            _NAMES[str(row.error_source)],
            "–" if row.error_source == _ALL else f"{plain(row.tolerance_width_um)} µm",
            f"{plain(row.first_order)} {unit}",
            f"{plain(row.sample_rms)} ({plain(row.low)} to {plain(row.high)}) {unit}",
            f"{plain(row.error_95)} {unit}",
            percent(100.0 * row.variance_share),
        )
        for row in of_part.itertuples()
    )
    return Listing(_HEADS, rows, caption=f"Errors of the {part}")


def chain_section(frames: Mapping[str, pd.DataFrame]) -> ReportSection:
    """Return the section on the legs as chains: links, and what 1 um of each source does at the end of an open leg."""
    links, influence = frames["links"], frames["influence"]
    lead = "Each leg as a chain from the base's axis to the platform's origin (force-sensor paper, eq. 5 to 13), with "
    lead += "imaginary joints along both radii (links 1 and 7). The first leg is shown; the tables hold all legs."
    first_leg = links[links["leg"] == 1]
    geometry = tuple(
        (
            str(row.link),
            f"{plain(row.length_mm)} mm",
            f"{plain(row.offset_mm)} mm",
            _degrees(row.angle_deg),
            _degrees(row.twist_to_next_deg),
            ", ".join(f"{value + 0.0:.4f}" for value in (row.axis_x, row.axis_y, row.axis_z)),
        )
        for row in first_leg.itertuples()
    )
    chain = Listing(_LINK_HEADS, geometry, (), "Links of leg 1", held_by="the -links table")
    parts = [name for name in influence.columns if name not in ("leg", "error_source")]
    first = influence[influence["leg"] == 1]
    rows = tuple(
        (_NAMES[str(row["error_source"])], *(plain(float(row[name])) for name in parts)) for _, row in first.iterrows()
    )
    named = ((name.partition("_")[0], sign(name.partition("_")[2])) for name in parts)
    heads = (
        _SOURCE,
        *(Head(f"{part}, {unit}", "Error of the platform's pose in this component.") for part, unit in named),
    )
    open_leg = Listing(heads, rows, (), "Platform on leg 1 alone, without the others", held_by="the -influence table")
    return ReportSection("chains", "Legs as chains", lead, listings=(chain, open_leg))


def _degrees(value: float) -> str:
    return "–" if value != value else f"{plain(value)}°"


def tolerance_head(campaign: str, errors: pd.DataFrame) -> PageHead:
    """Return the head of a page on the tolerances alone."""
    words = tolerance_words(errors)
    rows = errors[errors["error_source"] == _ALL]
    tiles = tuple(
        (f"rms {row.pose_part} error", f"{plain(float(row.first_order))} {sign(str(row.unit))}")
        for row in rows.itertuples()
    )
    return PageHead(f"{campaign}: errors by tolerances", tuple(("", text) for text in words), tiles)


@figure_template()
def tolerance_sections(tables: Tables) -> list[ReportSection]:
    """Return the sections of a page on the tolerances alone."""
    section = tolerances(tables)
    return [] if section is None else [section]
