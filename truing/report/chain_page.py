"""Section of an open chain: the arm in its first pose, its identified numbers, and errors over the workspace."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np
import pandas as pd
import plotly.graph_objects as go
from numpy.typing import NDArray
from plotly.subplots import make_subplots

from truing.report.chain_curves import CURVES, GUIDEWAYS, error_curves, guideway_errors
from truing.report.chain_inseparable import inseparable_listing, inseparable_words
from truing.report.column_heads import POSE, Head
from truing.report.figure_style import BLUE, GREEN, GREY, ORANGE, RED, label, style
from truing.report.numbers import count_text, listed, plain, quantity, rough, sign, with_uncertainty
from truing.report.page import Listing, ReportSection
from truing.report.scene.view import scene_axes
from truing.report.tables import XYZ, Row, Tables, table_or_none

FAR = 3.0  # pull from which a number is farther from nominal than its tolerance explains
_ORIGIN, _AXIS = ["ox_mm", "oy_mm", "oz_mm"], ["ax", "ay", "az"]
_ENTRIES = [f"r{i}{j}" for i in range(3) for j in range(3)]
_KINDS = (
    ("revolute", BLUE, "circle", "joints that turn"),
    ("prismatic", GREEN, "square", "joints that slide"),
)
_FARTHER = 1.15  # so that names at the edge are not cut
_UNITS = {"rad": (180.0 / math.pi, "deg")}  # as tolerances in campaign.toml
_ARM = (
    "The nominal chain in the frame of its base; a line along each joint is its axis. Targets of unknown place are "
    "not drawn. Errors of the geometry are too small to be seen here."
)
_NUMBERS = (
    "offset: zero of the joint. dx, dy, dz, turn_x, turn_y, turn_z: shift and rotation of the joint's frame in the "
    "link below. Determined: the measurements reduce the standard deviation below 70 % of that known before. All "
    "other numbers rest on their tolerances: do not use them as measured dimensions."
)
_SURE = 3.5  # standard deviations of a term beyond chance
_MOTORS = (
    "Least squares of each motor encoder on its joint reading, over the fitted poses. Sizes are those at the joint. "
    "This compares the two readings alone: errors that both share do not show, and the links are predicted from the "
    "joint readings."
)
_MOTOR_WORDS = {
    "ratio": "ratio of motor to joint",
    "lost_motion": "lost motion, to either side",
    "wind_up": "wind-up per torque of weight",
    "difference": "rms after ratio and zero",
    "remainder": "rms that remains",
}
_OF_POSE, _OF_DISTANCE = ("AP", "RP", "vAP", "dAP", "dRP"), ("AD", "RD")


def _iso_words(name: str) -> str:
    """Return the meaning of a figure of ISO 9283: ``RP_a``."""
    figure, _, turn = name.partition("_")
    quantity = f"rotation about {'xyz'['abc'.index(turn)]}" if turn else "position"
    return f"{_ISO_WORDS[figure]} of the {quantity} by ISO 9283."


_ISO_WORDS = {
    "AP": "Accuracy",
    "RP": "Repeatability",
    "vAP": "Multi-directional variation of the accuracy",
    "dAP": "Drift of the accuracy",
    "dRP": "Drift of the repeatability",
    "AD": "Accuracy of the distance between two poses: mean minus commanded,",
    "RD": "Repeatability of the distance between two poses",
}
_ISO_CAPTION = (
    "Pose accuracy AP, repeatability RP (from five repeats on), multi-directional variation vAP, and drift dAP and dRP "
    "(from twenty repeats on) by ISO 9283; a, b, c: small rotations about x, y, z. A command is the nominal chain at "
    "the readings, with places of base and tool fitted to all poses: AP contains no error of these places"
)
_ISO_DISTANCES = (
    "Distance accuracy AD and repeatability RD by ISO 9283, from five repeats on: each pose and the one whose "
    "commanded position is farthest. Places of base and tool cancel, except for errors of the tool's place in its link"
)
_REPEATS, _OPEN = 30, 12  # repeats of the standard; rows that are not folded
_REPEAT = (
    "Send the arm to five poses of its workspace, 30 times each, and from three directions if vAP is needed. Name the "
    "repeated poses in repeat_of."
)
_MAP = (
    "Each point is the tip in one pose, by the nominal chain. Large errors in one region show an effect that the "
    "model lacks there."
)


def chain(tables: Tables) -> ReportSection | None:
    """Return the section of a chain: the arm, its numbers, errors over the workspace and by series; None without
    a chain."""
    joints = table_or_none(tables, "joints")
    if joints is None:
        return None
    nodes, tips = table_or_none(tables, "chain_nodes"), table_or_none(tables, "chain_tip")
    curves = table_or_none(tables, "joint_curves")
    numbers, prediction = table_or_none(tables, "chain_parameters"), table_or_none(tables, "prediction")
    figures: list[tuple[go.Figure, str]] = []
    if nodes is not None:
        figures.append((_arm(nodes, table_or_none(tables, "survey")), _ARM))
    if nodes is not None and tips is not None and prediction is not None:
        shown = tips.merge(prediction, on="pose")
        figures.append((_map(shown, str(nodes.loc[nodes["is_tip"], "link"].iloc[0])), _MAP))
    if curves is not None and curves["is_determined"].any():
        figures.append((error_curves(curves, joints), CURVES))
    if (guideways := table_or_none(tables, "guideway_errors")) is not None:
        figures.append((guideway_errors(guideways), GUIDEWAYS))
    listings = [_listing(numbers)] if numbers is not None else []
    hidden = table_or_none(tables, "chain_inseparable")
    opening = _opening_sentences(joints, numbers)
    if hidden is not None and numbers is not None:
        opening = f"{opening} {inseparable_words(hidden, numbers)}".strip()
        listings += [found] if (found := inseparable_listing(hidden, numbers)) is not None else []
    series = table_or_none(tables, "series_errors")
    listings += [_by_series(series)] if series is not None else []
    motors = table_or_none(tables, "motor_encoders")
    listings += [_of_motors(motors)] if motors is not None else []
    repeated = table_or_none(tables, "arm_accuracy")
    listings += _of_repeats(repeated) if repeated is not None else []
    statements = () if numbers is None else _on_repeats(repeated)
    see = (("gain", "Errors of each pose, before and after"),) if prediction is not None else ()
    return ReportSection(
        "chain",
        "Chain",
        opening,
        tuple(figures),
        tuple(listings),
        statements=statements,
        see=see,
    )


def _opening_sentences(joints: pd.DataFrame, numbers: pd.DataFrame | None) -> str:
    read = joints[joints["input"] >= 0]
    chain_text = f"An open chain of {count_text(len(read), 'joint')} on {joints['link'].iloc[0]}."
    if numbers is None:
        return f"{chain_text} Its geometry was not identified."
    known = numbers[numbers["identifiable"]]
    left, far = numbers[~numbers["identifiable"]], known[known["pull"].abs() > FAR]
    words = [chain_text, f"The data determine {len(known)} of {count_text(len(numbers), 'number')} of its geometry."]
    if len(left):
        words.append(f"Not determined: {_named(left)}.")
    if len(far):
        words.append(f"Farther from nominal than {FAR:g} standard deviations of the tolerance: {_named(far)}.")
    elif known["pull"].notna().any():
        words.append(f"No determined number is farther from nominal than {FAR:g} standard deviations of its tolerance.")
    return " ".join(words)


def _named(numbers: pd.DataFrame) -> str:
    return listed([f"{row.parameter} of {row.joint}" for row in numbers.itertuples()])


def _listing(numbers: pd.DataFrame) -> Listing:
    """Return the identified numbers, the most significant first, then those that the data do not determine."""
    size = (numbers["identified"] / numbers["sigma"]).abs()
    ordered = numbers.assign(size=size).sort_values(["identifiable", "size"], ascending=False, kind="stable")
    rows, marks = [], []
    for row in ordered.itertuples():
        factor, unit = _UNITS.get(row.unit, (1.0, row.unit))
        bound = f"{plain(factor * row.tolerance)} {unit}" if row.tolerance == row.tolerance else "free"
        rows.append(
            (
                row.joint,
                row.parameter,
                with_uncertainty(factor * row.identified, factor * row.sigma, unit),
                bound,
                f"{row.pull:.1f}" if row.pull == row.pull else "–",
                "yes" if row.identifiable else "no",
            )
        )
        marks.append("warn" if row.identifiable and abs(row.pull) > FAR else "none")
    heads = (
        _JOINT,
        Head("number", "Parameter of the joint: zero, or shift or rotation of its frame in the link below."),
        Head("identified − nominal", "Identified minus nominal value, with one standard deviation."),
        Head("tolerance", "Standard deviation of the nominal value as declared; free: none is declared."),
        Head("pull", "Identified minus nominal value, divided by the standard deviation expected for this difference."),
        Head(
            "determined by the data",
            "Whether the measurements reduce the standard deviation below 70 % of that known before.",
        ),
    )
    return Listing(
        heads, tuple(rows), tuple(marks), f"Identified numbers. {_NUMBERS}", held_by="chain_parameters.parquet"
    )


_JOINT = Head("joint", "Joint of the chain that the row concerns.")


def _on_repeats(repeated: pd.DataFrame | None) -> tuple[tuple[str, str], ...]:
    """Return the reasons why figures by ISO 9283 are missing."""
    if repeated is None:
        why = "Pose accuracy and repeatability by ISO 9283 are not tested: no measured pose was repeated."
        return (("none", f"{why} {_REPEAT}"),)
    fewest = int(repeated["attained"].min())
    sentences = []
    if fewest < _REPEATS:
        sentences.append(
            ("warn", f"The fewest repeats of a pose are {fewest}; ISO 9283 asks for {_REPEATS}. {_REPEAT}")
        )
    untested = (
        (
            "vAP",
            "Multi-directional variation vAP is not tested: no pose was repeated twice from each of two directions.",
        ),
        ("AD", "Distance accuracy AD and repeatability RD are not tested: no two poses were repeated five times."),
        ("dAP", "Drift of accuracy and repeatability is not tested: no pose was repeated twenty times."),
    )
    figures = repeated["figure"].str
    sentences += [("none", why) for name, why in untested if not figures.startswith(name).any()]
    return tuple(sentences)


_REPEATED = Head("subject", "Body or point that was measured repeatedly.")


def _of_repeats(repeated: pd.DataFrame) -> list[Listing]:
    """Return the figures of ISO 9283 of each subject and pose, and of distances, with 95 % intervals of
    repeatability."""
    other_pose = repeated["other_pose"] if "other_pose" in repeated else pd.Series(None, repeated.index, dtype=object)
    parts = (
        (repeated[other_pose.isna()], ["subject", "pose"], _OF_POSE, (POSE,), _ISO_CAPTION),
        (
            repeated[other_pose.notna()],
            ["subject", "pose", "other_pose"],
            _OF_DISTANCE,
            (POSE, Head("other pose", "Other commanded pose of the distance.")),
            _ISO_DISTANCES,
        ),
    )
    return [_iso_listing(*part) for part in parts if len(part[0])]


def _iso_listing(
    repeated: pd.DataFrame, keys: list[str], figures: Sequence[str], poses: tuple[Head, ...], caption: str
) -> Listing:
    """Return a row per value of the keys, and a column per figure that a row has."""
    wanted = [f"{name}{turn}" for turn in ("", "_a", "_b", "_c") for name in figures]
    known = set(repeated["figure"])
    names = [name for name in wanted if name in known]
    rows = []
    for key, group in repeated.groupby(keys, sort=False):
        cells = {r.figure: _figure_cell(r) for r in group.itertuples()}
        rows.append((*map(str, key), str(group["attained"].max()), *(cells.get(name, "–") for name in names)))
    repeats = Head("repeats", "Number of measurements of the pose.")
    heads = (_REPEATED, *poses, repeats, *(Head(name, _iso_words(name)) for name in names))
    return Listing(heads, tuple(rows), caption=caption, folded=len(rows) > _OPEN, held_by="arm_accuracy.parquet")


def _figure_cell(row: Row) -> str:
    text, low = quantity(row.value, row.unit), getattr(row, "low", math.nan)
    return text if low is None or low != low else f"{text} ({quantity(low, row.unit)} … {quantity(row.high, row.unit)})"


def _by_series(series: pd.DataFrame) -> Listing:
    unit = sign(str(series["unit"].iloc[0]))
    heads = (
        Head("series", "Part of the campaign, where several were measured."),
        Head("use", "Whether the poses were fitted or held out."),
        Head("poses", "Number of poses."),
        Head(f"rms before, {unit}", "Root mean square of measured minus predicted without the causes found."),
        Head(f"rms after, {unit}", "Root mean square of measured minus predicted with the causes found."),
    )
    words = {"calibration": "fitted", "verification": "held out"}
    rows = tuple(
        (r.series, words.get(r.role, r.role), str(r.poses), rough(r.rms_before), rough(r.rms_after))
        for r in series.itertuples()
    )
    caption = "Measured minus predicted, by series, without and with the causes"
    return Listing(heads, rows, caption=caption, held_by="series_errors.parquet")


def _of_motors(motors: pd.DataFrame) -> Listing:
    """Return the components of the difference between motor encoders and joint readings."""
    rows, marks = [], []
    for row in motors.itertuples():
        factor, unit = _UNITS.get(row.unit, (1.0, "" if row.unit == "1" else row.unit))
        known = row.sigma == row.sigma
        size = with_uncertainty(factor * row.value, factor * row.sigma if known else None, unit)
        beyond = known and row.parameter != "ratio" and abs(row.value) > _SURE * row.sigma
        verdict_text = "–" if not known or row.parameter == "ratio" else "yes" if beyond else "no"
        name = _MOTOR_WORDS.get(row.parameter, row.parameter)
        rows.append((row.joint, name, size if row.identifiable else "not determined", verdict_text))
        marks.append("warn" if beyond else "none")
    heads = (
        _JOINT,
        Head("motor / ratio − joint", "Term of the motor reading over the ratio minus the joint reading."),
        Head("size", "Estimate of the term at the joint, with one standard deviation."),
        Head("beyond chance", "Whether the term is larger than chance explains."),
    )
    return Listing(heads, tuple(rows), tuple(marks), f"Motor encoders. {_MOTORS}", held_by="motor_encoders.parquet")


def _map(shown: pd.DataFrame, tip: str) -> go.Figure:
    """Return the errors that remain over the tip's position, from above and from the side."""
    views = (("x_mm", "y_mm", "from above"), ("x_mm", "z_mm", "from the side"))
    figure = make_subplots(rows=1, cols=2, subplot_titles=[words for *_, words in views], horizontal_spacing=0.12)
    values = (shown["role"] == "verification").to_numpy()
    words = [
        f"pose {label(pose)}: {rough(before)} → {rough(after)} µm"
        for pose, before, after in zip(shown["pose"], shown["rms_before"], shown["rms_after"], strict=True)
    ]
    for k, (across, up, _) in enumerate(views, 1):
        marker = {
            "color": shown["rms_after"].to_numpy(),
            "coloraxis": "coloraxis",
            "size": 9,
            "symbol": np.where(values, "diamond", "circle"),
            "line": {"width": 0.5, "color": GREY},
        }
        points = go.Scatter(
            x=shown[across].to_numpy(),
            y=shown[up].to_numpy(),
            mode="markers",
            marker=marker,
            text=words,
            hoverinfo="text",
            showlegend=False,
        )
        figure.add_trace(points, row=1, col=k)
        figure.update_xaxes(title_text=f"{across[0]} (mm)", row=1, col=k)
        figure.update_yaxes(title_text=f"{up[0]} (mm)", row=1, col=k)
    diamonds = "Diamonds: held-out poses" if shown["role"].eq("verification").any() else ""
    style(figure, f"Errors that remain, over the position of {label(tip)}", diamonds, 440)
    scale = {"title": {"text": "rms (µm)"}, "thickness": 12}
    ends = {"cmin": 0.0, "cmax": max(float(shown["rms_after"].max()), 1e-6)}  # from zero, so that noise looks even
    figure.update_layout(coloraxis={"colorscale": "Cividis", **ends, "colorbar": scale})
    return figure


def _arm(nodes: pd.DataFrame, survey: pd.DataFrame | None) -> go.Figure:
    """Return the nominal chain at one pose with joint axes, frames of base and tip, and surveyed targets; mm."""
    shown = np.concatenate([nodes[XYZ].to_numpy(float), nodes[_ORIGIN].to_numpy(float)])
    size = 0.12 * max(float(np.ptp(shown, axis=0).max()), 1.0)
    low, high = shown.min(0) - size, shown.max(0) + size
    middle, half = (low + high) / 2.0, (high - low) / 2.0
    half = np.maximum(half, 0.4 * half.max())  # a flat view would distort the arm
    scene = scene_axes(middle - half, middle + half)
    scene["camera"]["eye"] = {axis: _FARTHER * value for axis, value in scene["camera"]["eye"].items()}
    figure = go.Figure([_links(nodes), *_joints(nodes, size), *_triads(nodes, size), *_targets(nodes, survey)])
    style(figure, f"The chain at pose {label(nodes['pose'].iloc[0])}", "Nominal geometry, frame of the base", 620)
    figure.update_layout(
        scene=scene,
        legend={"orientation": "h", "y": 1.0, "yanchor": "top", "itemsizing": "constant"},
        margin={"l": 0, "r": 0, "t": 110, "b": 20},
    )
    return figure


def _links(nodes: pd.DataFrame) -> go.Scatter3d:
    """Return a line along each link, and along the travel of each joint that slides."""
    positions, origins = nodes[XYZ].to_numpy(float), nodes[_ORIGIN].to_numpy(float)
    gap = np.full(3, np.nan)
    parts = [(positions[b], origins[k], positions[k], gap) for k, b in enumerate(nodes["below"]) if b >= 0]
    return _line(np.array(parts).reshape(-1, 3), "links", GREY, 8.0)


def _joints(nodes: pd.DataFrame, size: float) -> Iterator[go.Scatter3d]:
    for kind, colour, symbol, words in _KINDS:
        rows = nodes[nodes["joint_kind"] == kind]
        if not len(rows):
            continue
        middle, along = rows[_ORIGIN].to_numpy(float), rows[_AXIS].to_numpy(float) * size / 2.0
        yield go.Scatter3d(
            **dict(zip("xyz", middle.T, strict=True)),
            mode="markers+text",
            name=words,
            legendgroup=words,
            marker={"size": 5, "color": colour, "symbol": symbol},
            text=[label(name) for name in rows["joint"]],
            textposition="middle right",
            hoverinfo="text",
        )
        ends = np.stack([middle - along, middle + along, np.full_like(middle, np.nan)], 1).reshape(-1, 3)
        yield _line(ends, f"axes of {words}", colour, 3.0, legendgroup=words, showlegend=False)


def _triads(nodes: pd.DataFrame, size: float) -> Iterator[go.Scatter3d]:
    """Return the axes x, y, z of base and tip."""
    for words, row in (("base", nodes.iloc[0]), ("tip", nodes[nodes["is_tip"]].iloc[0])):
        name, start = f"{words}: {label(row['link'])}", row[XYZ].to_numpy(float)
        for axis, colour in enumerate((RED, GREEN, BLUE)):
            along = row[[f"r{i}{axis}" for i in range(3)]].to_numpy(float)
            yield go.Scatter3d(
                **dict(zip("xyz", np.stack([start, start + size * along]).T, strict=True)),
                mode="lines+text",
                name=name,
                legendgroup=name,
                showlegend=axis == 0,
                line={"color": colour, "width": 6},
                text=["", "xyz"[axis]],
                hoverinfo="name",
            )


def _targets(nodes: pd.DataFrame, survey: pd.DataFrame | None) -> Iterator[go.Scatter3d]:
    """Return the targets whose places in their links are known."""
    by_link = nodes.set_index("link")
    table = pd.DataFrame() if survey is None else survey[survey["body"].isin(by_link.index)].dropna(subset=XYZ)
    if not len(table):
        return
    of = by_link.loc[table["body"]]
    R = of[_ENTRIES].to_numpy(float).reshape(-1, 3, 3)
    placed = np.einsum("kij,kj->ki", R, table[XYZ].to_numpy(float)) + of[XYZ].to_numpy(float)
    yield go.Scatter3d(
        **dict(zip("xyz", placed.T, strict=True)),
        mode="markers",
        name="targets",
        marker={"size": 4, "color": ORANGE},
        text=[label(name) for name in table["target"]],
        hoverinfo="text",
    )


def _line(points: NDArray, name: str, colour: str, width: float, **more: object) -> go.Scatter3d:
    return go.Scatter3d(
        **dict(zip("xyz", points.T, strict=True)),
        mode="lines",
        name=name,
        line={"color": colour, "width": width},
        hoverinfo="skip",
        connectgaps=False,
        **more,
    )
