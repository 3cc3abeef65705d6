"""Page of the accuracy of a pose from the accuracy of the actuators: worst poses, legs, and a map of the workspace."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import pandas as pd
import plotly.graph_objects as go

from truing.report.column_heads import LEG, Head
from truing.report.figure_style import BLUE, GREEN, ORANGE, RED, figure_template, panel_grid, style
from truing.report.numbers import count_text, percent, plain, sign
from truing.report.page import Listing, PageHead, ReportSection

_NAMES = {
    **{axis: f"along {axis}" for axis in "xyz"},
    **{f"r{axis}": f"about {axis}" for axis in "xyz"},
    "position": "position",
    "orientation": "orientation",
}
_DISPLACEMENTS = {"x_mm": "mm", "y_mm": "mm", "z_mm": "mm", "rx_deg": "°", "ry_deg": "°", "rz_deg": "°"}
_COLOURS = (BLUE, ORANGE, GREEN, RED, "#CC79A7", "#56B4E9", "#F0E442")
_SOURCES = {
    "mechanism.actuator_accuracy_mm": "mechanism.actuator_accuracy_mm",
    "noise.actuator_mm": "√3 times noise.actuator_mm, because mechanism.actuator_accuracy_mm is absent",
}
_EQUAL = 1.02  # largest share over the mean one, below which legs contribute equally
_COMPONENT = Head("component", "Component of the pose, or its whole position or orientation.")
_HEADS = (
    _COMPONENT,
    Head("largest error", "Largest error over the workspace, with the worst sign of every actuator's error."),
    Head(
        "standard deviation there",
        "Standard deviation at the worst pose, with the errors of the actuators spread evenly over their limits.",
    ),
    Head("at the reference pose", "Largest error at the reference pose."),
    Head("requirement", "Required accuracy by campaign.toml; a dash where there is none."),
    Head("used", "Largest error in per cent of the requirement."),
)
_POSE_HEADS = (
    _COMPONENT,
    *(
        Head(f"{name.partition('_')[0]}, {unit}", "Displacement of the worst pose from the reference pose.")
        for name, unit in _DISPLACEMENTS.items()
    ),
    Head("legs", "Leg with the largest share in the largest error, or that all shares are equal."),
)


def accuracy_words(frames: Mapping[str, pd.DataFrame]) -> list[str]:
    """Return the results in sentences, the main one first. frames: worst, legs and map."""
    worst, legs = frames["worst"].set_index("quantity"), frames["legs"]
    sizes = {name: worst.loc[name] for name in ("position", "orientation")}
    largest_errors = [f"the {name} by at most {_value(row, 'worst')}" for name, row in sizes.items()]
    lines = [f"Actuators within {_accuracy(legs)}: over the workspace they move {' and '.join(largest_errors)}."]
    at_reference = ", ".join(_value(row, "at_reference") for row in sizes.values())
    sigma = ", ".join(_value(row, "sigma") for row in sizes.values())
    lines.append(
        f"At the reference pose: {at_reference}. With errors spread evenly over these limits, one "
        "standard deviation at the "
        f"worst pose: {sigma}."
    )
    lines += [f"Worst {name}: {_place(row)}; {_legs_of(legs, name)}." for name, row in sizes.items()]
    return [*lines, *_required(frames["worst"]), _searched(frames["map"])]


def _accuracy(legs: pd.DataFrame) -> str:
    sizes, source = sorted(set(legs["accuracy_um"])), _SOURCES[str(legs["accuracy_from"].iloc[0])]
    size = f"±{plain(sizes[0])} µm" if len(sizes) == 1 else f"±{plain(sizes[0])} to ±{plain(sizes[-1])} µm"
    return f"{size} ({source})"


def _value(row: pd.Series, column: str) -> str:
    return f"{plain(row[column])} {sign(str(row['unit']))}"


def _place(row: pd.Series) -> str:
    """Return the displacement of a pose from the reference pose."""
    if row["part"] == "reference":
        return "at the reference pose"
    return ", ".join(f"{name.partition('_')[0]} {row[name]:+.3g} {unit}" for name, unit in _DISPLACEMENTS.items())


def _legs_of(legs: pd.DataFrame, quantity: str) -> str:
    rows = legs[legs["quantity"] == quantity]
    first = rows.nlargest(1, "share").iloc[0]
    if first["share"] * len(rows) < _EQUAL:
        return "all legs have equal shares"
    return f"leg {first['leg']} has the largest share, {percent(100.0 * first['share'])}"


def _required(worst: pd.DataFrame) -> Iterator[str]:
    given = worst[worst["requirement"].notna()]
    if not len(given):
        return
    used = given["worst"] / given["requirement"]
    row, share = given.loc[used.idxmax()], percent(100.0 * float(used.max()))
    yield f"Requirement {_NAMES[row['quantity']]}: the actuators alone use {share} of it, of no other component more."


def _searched(poses: pd.DataFrame) -> str:
    number = poses["part"].value_counts()
    parts = f"{count_text(int(number.get('corner', 0)), 'corner')} of the workspace, "
    parts += f"{count_text(int(number['inside']), 'point')} in it, and climbs from the worst of them"
    return f"To first order in the actuators' errors, at {parts}; a narrow maximum between them is not excluded."


def accuracy_head(campaign: str, frames: Mapping[str, pd.DataFrame]) -> PageHead:
    """Return the head of the page with the main results."""
    worst = frames["worst"].set_index("quantity")
    fails = bool((worst["worst"] > worst["requirement"]).any())
    words = accuracy_words(frames)
    marks = ["fail" if fails else "pass" if worst["requirement"].notna().any() else "", *[""] * (len(words) - 1)]
    tiles = tuple(
        (f"largest error of the {name}", _value(worst.loc[name], "worst")) for name in ("position", "orientation")
    )
    return PageHead(f"{campaign}: accuracy from the actuators", tuple(zip(marks, words, strict=True)), tiles)


@figure_template()
def accuracy_sections(frames: Mapping[str, pd.DataFrame]) -> list[ReportSection]:
    """Return the sections on components, legs, and the map."""
    worst, legs, maps_frame = frames["worst"], frames["legs"], frames["map"]
    lead = "The largest error takes the worst sign of every actuator's error. It is exact for the linearised machine."
    listings = (_components(worst), _poses(worst, legs))
    shares = ((_shares(legs), "Each bar is the largest error of one component, at its own worst pose."),)
    maps = tuple((_sections(maps_frame, name), text) for name, text in _MAPS.items())
    return [
        ReportSection("components", "Largest errors", lead, listings=listings),
        ReportSection(
            "legs",
            "Share of each leg",
            "Equal shares mean that no single actuator limits the accuracy.",
            shares,
            listings=(_jacobian(frames["jacobian"]),),
        ),
        ReportSection(
            "map",
            "Over the workspace",
            "Each panel varies two displacements from the reference pose; the others are zero. Blank: outside of the "
            "limits. All poses are in the table next to this page.",
            maps,
        ),
    ]


_MAPS = {
    "position": "Largest error of the position.",
    "orientation": "Largest error of the orientation.",
}


def _jacobian(table: pd.DataFrame) -> Listing:
    slope = "Change of the leg's reading per unit of this motion of the platform."
    heads = (LEG, *(Head(name.replace("_", " "), slope) for name in table.columns[1:]))
    rows = tuple((str(int(row[0])), *(f"{value:.5f}" for value in row[1:])) for row in table.itertuples(index=False))
    return Listing(heads, rows, (), "Change of each reading by a motion of the platform at the reference pose")


def _components(worst: pd.DataFrame) -> Listing:
    rows, marks = [], []
    for _, row in worst.iterrows():
        known = bool(row["requirement"] == row["requirement"])
        used = row["worst"] / row["requirement"] if known else float("nan")
        required = (_value(row, "requirement"), percent(100.0 * used)) if known else ("–", "–")
        rows.append(
            (_NAMES[row["quantity"]], *(_value(row, name) for name in ("worst", "sigma", "at_reference")), *required)
        )
        marks.append("" if not known else "fail" if used > 1.0 else "pass")
    return Listing(_HEADS, tuple(rows), tuple(marks), "Errors of the pose by the actuators alone")


def _poses(worst: pd.DataFrame, legs: pd.DataFrame) -> Listing:
    rows = tuple(
        (
            _NAMES[row["quantity"]],
            *(f"{row[name]:.3f}" for name in _DISPLACEMENTS),
            _legs_of(legs, row["quantity"]),
        )
        for _, row in worst.iterrows()
    )
    return Listing(_POSE_HEADS, rows, caption="Worst poses, as displacement from the reference pose")


def _shares(legs: pd.DataFrame) -> go.Figure:
    figure = go.Figure()
    for leg, group in legs.groupby("leg"):
        figure.add_trace(
            go.Bar(
                y=[_NAMES[name] for name in group["quantity"]],
                x=100.0 * group["share"],
                name=f"leg {leg}",
                orientation="h",
                marker={"color": _COLOURS[(int(str(leg)) - 1) % len(_COLOURS)]},
            )
        )
    style(figure, "Share of each leg in the largest error", "per cent, at the worst pose of each component", 380)
    figure.update_layout(barmode="stack", legend={"traceorder": "normal"})
    figure.update_yaxes(autorange="reversed", automargin=True)
    return figure


def _sections(poses: pd.DataFrame, quantity: str) -> go.Figure:
    column = next(name for name in poses if str(name).startswith(f"{quantity}_error_"))
    parts = [part for part in dict.fromkeys(poses["part"]) if " " in part]
    units = {name.partition("_")[0]: (name, unit) for name, unit in _DISPLACEMENTS.items()}
    grid, panels, rows = panel_grid([part.replace(" ", ", ") for part in parts], 3, (0.08, lambda rows: 0.6 / rows / 2))
    for part, panel in zip(parts, panels, strict=True):
        of_part = poses[poses["part"] == part]
        first, second = (units[name] for name in part.split())
        table = of_part.pivot_table(index=second[0], columns=first[0], values=column, dropna=False)
        grid.add_trace(
            go.Heatmap(x=table.columns, y=table.index, z=table.to_numpy(), coloraxis="coloraxis", hoverongaps=False),
            **panel,
        )
        grid.update_xaxes(title_text=f"{first[0].partition('_')[0]}, {first[1]}", title_standoff=2, **panel)
        grid.update_yaxes(title_text=f"{second[0].partition('_')[0]}, {second[1]}", title_standoff=2, **panel)
    unit = sign(str(column).rpartition("_")[2])
    style(
        grid,
        f"Largest error of the {quantity} over the workspace",
        "sections through the reference pose",
        130 + 270 * rows,
    )
    grid.update_layout(coloraxis={"colorscale": "Viridis", "colorbar": {"title": {"text": unit}, "thickness": 12}})
    return grid
