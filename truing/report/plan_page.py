"""Page of a photograph plan: the network in space, camera stations, and expected uncertainty of each target."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd
import plotly.graph_objects as go
from numpy.typing import NDArray

from truing.report.column_heads import BODY, TARGET, Head
from truing.report.figure_style import BLUE, GREY, ORANGE, figure_template, label, style
from truing.report.numbers import count_text, rough
from truing.report.page import Listing, PageHead, ReportSection

_STATION_HEADS = (
    Head("station", "Number of the station in the order of the walk."),
    *(Head(f"{axis}, mm", "Coordinate of the camera in the frame of the targets.") for axis in "xyz"),
    Head("azimuth, °", "Direction from the centre of the targets to the station, about z from x."),
    Head("elevation, °", "Angle of the direction from the centre of the targets to the station above the x-y plane."),
    Head("distance, mm", "Distance of the camera from the centre of the targets."),
    Head("roll, °", "Rotation of the camera about its viewing direction."),
    Head("targets seen", "Number of targets that this photograph shows."),
)
_TARGET_HEADS = (
    BODY,
    TARGET,
    Head("rays", "Number of photographs that show the target."),
    Head("widest angle, °", "Largest angle between two rays to the target, counted up to a right angle."),
    *(Head(f"σ {axis}, mm", "Expected standard deviation of the target along this axis.") for axis in "xyz"),
    Head("σ, mm", "Expected standard deviation along the direction in which the target is least certain."),
    Head("limited by", "Largest contribution to the uncertainty of the target."),
)
_BODY_HEADS = (
    BODY,
    Head("targets", "Number of targets on the body."),
    Head("worst, mm", "Largest expected standard deviation of the body's targets."),
    Head("mean, mm", "Root mean square of the expected standard deviations of the body's targets."),
    Head("position, mm", "Expected standard deviation of the body's position, along the least certain axis."),
    Head("rotation, µrad", "Expected standard deviation of the body's rotation, about the least certain axis."),
)
_LIMITS = {
    "noise": "the noise of image points, which decreases with the square root of the number of photographs",
    "few rays": "fewer than four rays: a gross error in one ray could not be located",
    "narrow rays": "rays within 60°: photographs from more directions help",
    "camera": "the camera, calibrated together with the targets: rolled photographs or a calibration beforehand help",
    "scale": "the scale bars: better or more bars help, more photographs do not",
    "not seen twice": "fewer than two photographs show them",
}
_EYE = {"x": 0.95, "y": -1.1, "z": 0.7}
_SYMBOL = 0.16  # size of a camera's pyramid, relative to the object


def plan_head(campaign: str, text: Sequence[str], reaches: bool, frames: Mapping[str, pd.DataFrame]) -> PageHead:
    """Return the head of the page with the main results."""
    targets = frames["targets"]
    tiles = [
        ("photographs", str(len(frames["stations"]))),
        ("targets", str(len(targets))),
        ("worst target", f"{rough(float(targets['sigma_mm'].max()))} mm"),
        ("rays per target", f"{targets['rays'].mean():.0f}"),
    ]
    marks = ["pass" if reaches else "warn", *[""] * (len(text) - 1)]
    return PageHead(f"{campaign}: where to stand", tuple(zip(marks, text, strict=True)), tuple(tiles))


@figure_template()
def plan_sections(
    frames: Mapping[str, pd.DataFrame], R: NDArray[np.float64], half: tuple[float, float], wanted_mm: float | None
) -> list[ReportSection]:
    """Return the sections on network, stations, number of stations, and targets.

    R (K, 3, 3) from camera axes; half: the format's half width and height over the principal distance.
    """
    stations, targets = frames["stations"], frames["targets"]
    network = ReportSection(
        "network",
        "The network",
        "Camera stations with their fields of view, and targets coloured by their expected uncertainty. "
        "The plan knows no obstacles: leave out, or move a little, a station whose view is blocked.",
        figures=(
            (
                _network(stations, targets, R, half),
                "Drag to rotate. The short edge of a pyramid is the short side of the image.",
            ),
        ),
    )
    listing = Listing(
        _STATION_HEADS,
        tuple(map(tuple, _station_rows(stations))),
        caption="Stations in the order of a walk around the object",
    )
    stations_section = ReportSection(
        "stations",
        "Where to stand",
        "Positions are in the frame of the targets. Each camera points at their centre. Azimuth and elevation are the "
        "directions of the station from this centre.",
        listings=(listing,),
    )
    return [network, stations_section, _numbers(frames["curve"], len(stations), wanted_mm), _limits_section(frames)]


def _network(
    stations: pd.DataFrame, targets: pd.DataFrame, R: NDArray[np.float64], half: tuple[float, float]
) -> go.Figure:
    centre = stations[["x_mm", "y_mm", "z_mm"]].to_numpy(dtype=float)
    at = targets[["x_mm", "y_mm", "z_mm"]].to_numpy(dtype=float)
    size = _SYMBOL * float(np.ptp(np.concatenate([centre, at]), axis=0).max())
    figure = go.Figure()
    wide, high = half
    corners = np.array([[-wide, -high, 1], [wide, -high, 1], [wide, high, 1], [-wide, high, 1]])
    tips = centre[:, None] + size * np.einsum("kij,cj->kci", R, corners)
    for roll, colour in ((False, BLUE), (True, ORANGE)):
        mask = np.abs(stations["roll_deg"].to_numpy()) > 45.0
        mask = mask if roll else ~mask
        if mask.any():
            x, y, z = _pyramids(centre[mask], tips[mask]).T
            name = "rolled by 90°" if roll else "upright"
            figure.add_trace(
                go.Scatter3d(
                    x=x, y=y, z=z, mode="lines", name=name, line={"color": colour, "width": 3}, hoverinfo="skip"
                )
            )
    centres, together = np.unique(centre, axis=0, return_inverse=True)
    numbers = [", ".join(str(n) for n in stations["station"][together.ravel() == i]) for i in range(len(centres))]
    figure.add_trace(
        go.Scatter3d(
            x=centres[:, 0],
            y=centres[:, 1],
            z=centres[:, 2],
            mode="text",
            text=numbers,
            hovertext=[f"station {number}" for number in numbers],
            hoverinfo="text",
            name="number of the station",
            showlegend=False,
        )
    )
    known = targets["sigma_mm"].notna()
    figure.add_trace(_targets(targets[known], at[known]))
    if (~known).any():
        lost = at[~known]
        marker = {"color": GREY, "size": 4, "symbol": "x"}
        figure.add_trace(
            go.Scatter3d(x=lost[:, 0], y=lost[:, 1], z=lost[:, 2], mode="markers", marker=marker, name="not seen twice")
        )
    style(figure, label("Where the cameras stand"), "and the expected uncertainty of each target", 620)
    axes = {f"{axis}axis": {"title": {"text": f"{axis}, mm"}} for axis in "xyz"}
    figure.update_layout(scene={"aspectmode": "data", "camera": {"eye": _EYE}, **axes}, legend={"orientation": "h"})
    return figure


def _pyramids(centre: NDArray[np.float64], tips: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return one line (N, 3) along the edges of all pyramids, with breaks between them."""
    gap = np.full((len(centre), 3), np.nan)
    a, b, c, d = (tips[:, i] for i in range(4))
    walk = [centre, a, b, centre, c, d, centre, gap, b, c, gap, d, a, gap]
    return np.stack(walk, axis=1).reshape(-1, 3)


def _targets(targets: pd.DataFrame, at: NDArray[np.float64]) -> go.Scatter3d:
    words = [
        f"{r.body}/{r.target}: σ {rough(r.sigma_mm)} mm, {count_text(r.rays, 'ray')}" for r in targets.itertuples()
    ]
    return go.Scatter3d(
        x=at[:, 0],
        y=at[:, 1],
        z=at[:, 2],
        mode="markers",
        name="targets",
        text=words,
        hoverinfo="text",
        showlegend=False,
        marker={
            "size": 4,
            "color": 1e3 * targets["sigma_mm"],
            "colorscale": "Viridis_r",
            "colorbar": {"title": {"text": "σ, µm"}, "thickness": 12, "len": 0.6},
        },
    )


def _station_rows(stations: pd.DataFrame) -> list[list[str]]:
    return [
        [
            str(r.station),
            *(f"{v:.0f}" for v in (r.x_mm, r.y_mm, r.z_mm)),
            f"{np.degrees(np.arctan2(-r.view_y, -r.view_x)):.0f}",
            f"{np.degrees(np.arcsin(np.clip(-r.view_z, -1.0, 1.0))):.0f}",
            f"{r.distance_mm:.0f}",
            f"{r.roll_deg:.0f}",
            str(r.targets),
        ]
        for r in stations.itertuples()
    ]


def _numbers(curve: pd.DataFrame, chosen_number: int, wanted_mm: float | None) -> ReportSection:
    figure = go.Figure()
    for column, name, colour in (("worst_mm", "worst target", ORANGE), ("mean_mm", "mean of all", BLUE)):
        look = {"mode": "lines+markers", "line": {"color": colour}}
        figure.add_trace(go.Scatter(x=curve["stations"], y=1e3 * curve[column], name=name, **look))
    if wanted_mm is not None:
        ends = [int(curve["stations"].min()), int(curve["stations"].max())] if len(curve) else []
        look = {"mode": "lines", "line": {"color": GREY, "dash": "dot"}}
        figure.add_trace(go.Scatter(x=ends, y=[1e3 * wanted_mm] * len(ends), name="wanted", **look))
    style(
        figure,
        label("Uncertainty against number of photographs"),
        "stations chosen one by one, before any is exchanged",
        340,
    )
    figure.update_xaxes(title={"text": "photographs"})
    figure.update_yaxes(type="log", title={"text": "σ, µm"})
    lead = (
        f"This plan takes {chosen_number}. Fewer than four rays to a target cannot show which of them has a "
        "gross error."
    )
    return ReportSection(
        "number",
        "How many photographs",
        lead,
        figures=((figure, "One standard deviation along the direction in which a target is least certain."),),
    )


def _limits_section(frames: Mapping[str, pd.DataFrame]) -> ReportSection:
    targets, bodies = frames["targets"], frames["bodies"]
    ordered = targets.sort_values("sigma_mm", ascending=False, na_position="first")
    rows = tuple(
        (
            r.body,
            r.target,
            str(r.rays),
            f"{r.angle_deg:.0f}",
            *(_mm(v) for v in (r.sigma_x_mm, r.sigma_y_mm, r.sigma_z_mm, r.sigma_mm)),
            r.limited_by,
        )
        for r in ordered.itertuples()
    )
    marks = tuple("warn" if row[-1] in ("not seen twice", "few rays") else "" for row in rows)
    limits = targets["limited_by"].value_counts()
    statements = tuple(
        ("", f"{count} of {len(targets)} targets: {_LIMITS[str(name)]}.") for name, count in limits.items()
    )
    listings = (
        Listing(
            _BODY_HEADS,
            _body_rows(bodies),
            caption="Bodies, and the uncertainty of their poses (relative to the reference body, if any)",
        ),
        Listing(
            _TARGET_HEADS, rows, marks, "Targets, the worst first", folded=True, held_by="the table next to this page"
        ),
    )
    lead = "Standard deviations in the free datum, relative to all targets together. They are limited by:"
    return ReportSection("targets", "Uncertainty of the targets", lead, listings=listings, statements=statements)


def _body_rows(bodies: pd.DataFrame) -> tuple[tuple[str, ...], ...]:
    return tuple(
        (r.body, str(r.targets), *(_mm(v) for v in (r.worst_mm, r.mean_mm, r.position_mm, r.rotation_urad)))
        for r in bodies.itertuples()
    )


def _mm(value: float | None) -> str:
    return "–" if value is None or value != value else rough(float(value))
