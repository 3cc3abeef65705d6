"""Page of proofs on a machine over its workspace: one pose, no singular pose, one reading; and its flexures."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd
import plotly.graph_objects as go

from truing.report.column_heads import Head
from truing.report.figure_style import BLUE, GREY, ORANGE, figure_template, style
from truing.report.numbers import count_text, plain, sign
from truing.report.page import Listing, PageHead, ReportSection

_MARKS = {"proven": "pass", "not decided": "warn", "refuted": "fail"}
_ORDER = ("proven", "not decided", "refuted")
_MEANINGS = {
    "one pose": "two different poses never have the same readings",
    "no singular pose": "no pose is singular",
    "one reading": "at most one reading closes each leg in each pose",
}
_MODELS = {"beam": "flexures by beam theory"}
_MODEL = Head("model", "Model of the legs: rigid legs with ideal joints, or flexures by beam theory.")
_HEADS = (
    Head("statement", "Property of the machine over the whole range."),
    _MODEL,
    Head("state", "Whether the statement is proven, refuted or not decided."),
    Head("parts examined", "Number of parts of the range that the proof examined."),
    Head("parts not decided", "Number of parts of the range that remain without proof."),
    Head(
        "slope of the closure by the reading",
        "Bounds of the derivative of the leg's closure by its reading; a lower bound above zero proves one reading.",
    ),
)


def uniqueness_words(frames: Mapping[str, pd.DataFrame]) -> list[str]:
    """Return the results in sentences. frames: statements, range, undecided, and flexures if any."""
    lines = [f"Range: {_range(frames['range'])}, about the reference pose."]
    for (statement, model), group in frames["statements"].groupby(["statement", "model"], sort=False):
        lines.append(f"{_state(group).capitalize()}, {_model(str(model))}: {_MEANINGS[str(statement)]}{_where(group)}.")
    if (frames["statements"]["state"] != "proven").any():
        lines.append("Not decided is no fault of the machine: smaller limits in [workspace] are easier to prove.")
    return lines


def _state(table: pd.DataFrame) -> str:
    return max(table["state"], key=_ORDER.index)


def _model(name: str) -> str:
    return _MODELS.get(name, f"rigid legs ({name})")


def _where(table: pd.DataFrame) -> str:
    """Return the extent of the undecided part, or the legs."""
    open_ = table[table["state"] != "proven"]
    if not len(open_):
        return ""
    if open_["leg"].notna().any():
        return f" (not shown for leg {', '.join(str(int(leg)) for leg in open_['leg'])})"
    left, examined = open_["undecided_parts"].iloc[0], open_["parts"].iloc[0]
    if left != left:
        return ""
    return f" ({count_text(int(left), 'part')} of the range left after {count_text(int(examined), 'part')})"


def _range(table: pd.DataFrame) -> str:
    units = {"mm": "mm", "deg": "°"}
    ranges = []
    for row in table[~table["coordinate"].str.startswith("rho")].itertuples():
        name, _, unit = str(row.coordinate).partition("_")
        source = "" if row.given_by == "workspace" else " (as far as the other limits let it)"
        ranges.append(f"{name} ±{plain(row.half_range)} {units[unit]}{source}")
    readings = table[table["coordinate"].str.startswith("rho")]["half_range"]
    return f"{', '.join(ranges)}, readings ±{plain(readings.max())} mm"


def uniqueness_head(campaign: str, frames: Mapping[str, pd.DataFrame]) -> PageHead:
    """Return the head of the page with the main results."""
    words, statements = uniqueness_words(frames), frames["statements"]
    states = [_state(group) for _, group in statements.groupby(["statement", "model"], sort=False)]
    marks = ["", *(_MARKS[state] for state in states)]
    marks += [""] * (len(words) - len(marks))
    tiles = tuple((name, str(states.count(name))) for name in _ORDER if name in states)
    return PageHead(f"{campaign}: one pose for its readings", tuple(zip(marks, words, strict=True)), tiles)


@figure_template()
def uniqueness_sections(frames: Mapping[str, pd.DataFrame]) -> list[ReportSection]:
    """Return the sections on statements, undecided parts, and flexures."""
    sections = [
        ReportSection(
            "statements",
            "What is proven",
            "Every bound is rounded outwards (interval arithmetic). A proven statement holds for every pose of the "
            "range, with the nominal geometry and a rigid platform.",
            listings=(_statements(frames["statements"]),),
        )
    ]
    undecided = frames["undecided"]
    if len(undecided):
        sections.append(_parts(undecided))
    if (path := frames.get("flexures")) is not None:
        most, length = (float(path[name].iloc[0]) for name in ("largest_bend_deg", "flexure_length_mm"))
        text = f"Flexures of {plain(length)} mm bend by up to {plain(most)}° at the corners of the workspace."
        caption = "Displacement of a flexure's end from its straight place (telescope report, figure 9)."
        drawn = (
            "Beam: constant curvature (figure 8). Joint in its place: the end stays on a sphere about a point at β of "
        )
        drawn += "the length from the root, and the leg turns as about a pivot in the middle (figure 10)."
        figures = ((flexure_figure(path), caption), (flexure_drawing(path), drawn))
        sections.append(ReportSection("flexures", "Flexures and ideal pivots", text, figures))
    return sections


def _statements(table: pd.DataFrame) -> Listing:
    rows, marks = [], []
    for row in table.itertuples():
        of_leg = "" if row.leg != row.leg else f", leg {int(row.leg)}"
        slope = "–" if row.slope_low != row.slope_low else f"{row.slope_low:.4f} to {row.slope_high:.4f}"
        open_ = "–" if row.undecided_parts != row.undecided_parts else str(int(row.undecided_parts))
        text = f"{_MEANINGS[str(row.statement)]}{of_leg}"
        rows.append((text, _model(str(row.model)), str(row.state), str(row.parts), open_, slope))
        marks.append(_MARKS[str(row.state)])
    return Listing(_HEADS, tuple(rows), tuple(marks), "Statements over the range")


def _parts(undecided: pd.DataFrame) -> ReportSection:
    names = [str(name) for name in undecided.columns if name != "model"]
    rows = tuple((str(row["model"]), *(f"{row[name]:.4g}" for name in names)) for _, row in undecided.iterrows())
    listing = Listing(
        (_MODEL, *map(_end_head, names)),
        rows,
        caption="Parts of the range",
        folded=True,
        held_by="the -undecided table",
    )
    lead = "Parts of the range in which interval arithmetic could not decide, as displacement from the reference pose."
    return ReportSection("undecided", "What is not decided", lead, listings=(listing,))


def _end_head(name: str) -> Head:
    """Return the head of an end of a part: ``x min, mm``."""
    coordinate, side, unit = name.split("_")
    end = {"min": "Lower", "max": "Upper"}[side]
    return Head(
        f"{coordinate} {side}, {sign(unit)}", f"{end} end of the part, as displacement from the reference pose."
    )


def flexure_figure(path: pd.DataFrame) -> go.Figure:
    """Return the path of a flexure's end: ideal pivot, beam theory, and the circle that replaces it."""
    figure = go.Figure()
    for name, (title, line) in _PATHS.items():
        x, y = path[f"{name}_across_um"], path[f"{name}_along_um"]
        figure.add_trace(go.Scatter(x=x, y=y, mode="lines", line=line, name=title))
    style(figure, "Displacement of a flexure's end", f"bent from 0 to {plain(float(path['bend_deg'].max()))}°", 400)
    figure.update_xaxes(title={"text": "across, µm"})
    figure.update_yaxes(title={"text": "towards the root, µm"})
    figure.update_layout(legend={"orientation": "h", "y": -0.18})
    return figure


def flexure_drawing(path: pd.DataFrame) -> go.Figure:
    """Return a flexure bent clearly more than in operation: beam, sphere of the joint in its place, and pivot."""
    length, beta = (float(path[name].iloc[0]) for name in ("flexure_length_mm", "flexure_beta"))
    bend, steps = np.radians(_DRAWN_BEND), np.linspace(0.0, 1.0, _DRAWN_POINTS)
    # root at the origin, straight flexure along x
    beam = length / bend * np.stack([np.sin(bend * steps), 1.0 - np.cos(bend * steps)])
    end, direction = beam[:, -1], np.array([np.cos(bend), np.sin(bend)])
    pivot, radius = np.array([0.5 * length, 0.0]), (1.0 - beta) * length
    about = np.linspace(-0.5, 1.6, _DRAWN_POINTS) * bend
    sphere = np.array([[beta * length], [0.0]]) + radius * np.stack([np.cos(about), np.sin(about)])
    leg = np.stack([end, end + 0.4 * length * direction], -1)
    lever = np.stack([pivot, pivot + 0.5 * length * direction], -1)
    figure = go.Figure()
    for (across, along), line, name in (
        (np.array([[0.0, length], [0.0, 0.0]])[::-1], {"color": GREY, "width": 6}, "straight flexure"),
        (beam[::-1], {"color": BLUE, "width": 6}, "bent flexure"),
        (leg[::-1], {"color": BLUE, "width": 2}, "direction of the leg"),
        (sphere[::-1], {"color": ORANGE, "dash": "dot", "width": 2}, "sphere of its end"),
        (lever[::-1], {"color": GREY, "dash": "dash", "width": 2}, "ideal pivot"),
    ):
        figure.add_trace(go.Scatter(x=across, y=along, mode="lines", line=line, name=name))
    centres = {"x": [0.0, 0.0], "y": [beta * length, 0.5 * length], "text": ["centre of the sphere", "pivot"]}
    figure.add_trace(
        go.Scatter(
            **centres, mode="markers+text", textposition="middle left", marker={"color": "black"}, showlegend=False
        )
    )
    style(figure, "A bent flexure and the joint in its place", f"drawn with {_DRAWN_BEND}°, β = {plain(beta)}", 480)
    figure.update_xaxes(title={"text": "across, mm"}, range=[-0.6 * length, 0.7 * length])
    figure.update_yaxes(title={"text": "along, from the root, mm"}, scaleanchor="x")
    figure.update_layout(legend={"orientation": "h", "y": -0.18})
    return figure


_DRAWN_BEND, _DRAWN_POINTS = 25, 61  # degrees: visible, and far beyond any flexure's bend
_PATHS = {
    "pivot": ("ideal pivot in the middle", {"color": GREY, "dash": "dash"}),
    "beam": ("beam theory (eq. 12)", {"color": BLUE, "width": 4}),
    "circle": ("circle of the beam model (eq. 13)", {"color": ORANGE, "dash": "dot", "width": 3}),
}
