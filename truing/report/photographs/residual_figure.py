"""What the adjustment leaves of each ray, as vectors over the format: image by image, and what they have in common."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from truing.report.figure_style import BLUE, GREY, ORANGE, RED, label, style
from truing.report.numbers import count as counted
from truing.report.scene.view import round_gain

if TYPE_CHECKING:
    import pandas as pd
    import plotly.graph_objects as go


MOST_IMAGES = 40
_CELLS = 12  # of the longer side of the format, whose mean residuals are drawn
_FEWEST = 3  # rays that make a mean
_LENGTH = 0.03  # of the format's width, of the residual in the middle


def residual_picture(residuals: pd.DataFrame, cameras: pd.DataFrame) -> go.Figure:
    """Residual vectors: first of each camera's format what its images have in common, then image by image.

    ``residuals``: the table image_residuals; ``cameras``: of the formats.
    """
    import plotly.graph_objects as go

    formats = cameras.groupby("camera", sort=False)[["width_px", "height_px"]].first()
    told = residuals[residuals["vx_px"].notna()]
    kept = told[~told["rejected"]]
    width = float(formats["width_px"].max())
    usual = float(np.median(np.hypot(kept["vx_px"], kept["vy_px"]))) if len(kept) else 1.0
    gain = round_gain(_LENGTH * width / max(usual, 1e-9))
    images = _shown(told)
    figure, steps = go.Figure(), []
    for camera in [name for name in formats.index if (kept["camera"] == name).any()]:
        steps.append((f"{camera}, all images: means of cells", _means(kept[kept["camera"] == camera], formats, gain)))
    for pose, image in images:
        own = told[(told["pose"] == pose) & (told["image"] == image)]
        steps.append((f"{image}, pose {pose}" if str(pose) not in str(image) else str(image), _of_image(own, gain)))
    owner = [number for number, (_, traces) in enumerate(steps) for _ in traces]
    for number, (_, traces) in enumerate(steps):
        for trace in traces:
            trace.visible = number == 0
            figure.add_trace(trace)
    by = round_gain(width / 10.0)
    total = told.groupby(["pose", "image"]).ngroups
    more = f" The {len(images)} of {total} images with the largest residuals." if len(images) < total else ""
    style(
        figure,
        "What the adjustment leaves of each ray",
        f"Measured minus adjusted: {by:g} px along the axes are {by / gain:.2g} px of residual.{more}",
        620,
    )
    height = float(formats["height_px"].max())
    edge = 0.02 * width
    figure.update_xaxes(title_text="x (px)", range=[-edge, width + edge], constrain="domain", zeroline=False)
    figure.update_yaxes(
        title_text="y (px)", range=[height + edge, -edge], scaleanchor="x", constrain="domain", zeroline=False
    )
    figure.update_layout(
        sliders=[_slider([name for name, _ in steps], owner)],
        shapes=[{"type": "rect", "x0": 0, "y0": 0, "x1": width, "y1": height, "line": {"color": GREY, "width": 1}}],
        legend={"orientation": "h", "y": -0.1, "yanchor": "top", "x": 0.0},
    )
    return figure


def _shown(residuals: pd.DataFrame) -> list[tuple[Any, Any]]:
    """The images to choose from, in their order: all, or those with the largest residuals."""
    size = np.hypot(residuals["vx_px"], residuals["vy_px"]).where(~residuals["rejected"])
    rms = (size**2).groupby([residuals["pose"], residuals["image"]], sort=False).mean()
    chosen = set(rms.sort_values(ascending=False).index[:MOST_IMAGES])
    return [key for key in rms.index if key in chosen]


def _means(own: pd.DataFrame, formats: pd.DataFrame, gain: float) -> list[Any]:
    """Mean residuals of the cells of one camera's format, of all its images together."""
    cell = float(formats.loc[own["camera"].iloc[0]].max()) / _CELLS
    column, row = (np.floor(own[f"{a}_px"] / cell).astype(int) for a in "xy")
    means = own.groupby([row, column])[["x_px", "y_px", "vx_px", "vy_px"]].mean()
    counts = own.groupby([row, column]).size()
    means, counts = means[counts >= _FEWEST], counts[counts >= _FEWEST]
    words = [
        f"{counted(n, 'ray')}, mean ({r.vx_px:+.3f}, {r.vy_px:+.3f}) px"
        for r, n in zip(means.itertuples(), counts, strict=True)
    ]
    return [*_vectors(means, gain, BLUE, "mean of a cell"), _ends(means, words, BLUE, "middle of its rays")]


def _of_image(own: pd.DataFrame, gain: float) -> list[Any]:
    good, wrong = own[~own["rejected"]], own[own["rejected"]]
    drawn = [*_vectors(good, gain, BLUE, "residual"), _ends(good, _words(good), BLUE, "ray")]
    if len(wrong):
        drawn.append(
            _ends(wrong, [f"{w}; {r}" for w, r in zip(_words(wrong), wrong["reason"], strict=True)], RED, "rejected")
        )
    return drawn


def _words(rays: pd.DataFrame) -> list[str]:
    return [f"{label(r.point)}: ({r.vx_px:+.3f}, {r.vy_px:+.3f}) px" for r in rays.itertuples()]


def _vectors(rays: pd.DataFrame, gain: float, colour: str, name: str) -> list[Any]:
    import plotly.graph_objects as go

    start = rays[["x_px", "y_px"]].to_numpy()
    end = start + gain * rays[["vx_px", "vy_px"]].to_numpy()
    lines = np.stack([start, end, np.full_like(start, np.nan)], axis=1).reshape(-1, 2)
    x, y = np.round(lines, 1).T
    look = {"color": colour if name == "residual" else ORANGE, "width": 1.5}
    return [go.Scatter(x=x, y=y, mode="lines", name=name, line=look, hoverinfo="skip", connectgaps=False)]


def _ends(rays: pd.DataFrame, words: list[str], colour: str, name: str) -> Any:
    import plotly.graph_objects as go

    return go.Scatter(
        x=rays["x_px"].round(1),
        y=rays["y_px"].round(1),
        mode="markers",
        name=name,
        text=words,
        hoverinfo="text",
        marker={
            "color": colour,
            "size": 7 if name == "rejected" else 4,
            "symbol": "x" if name == "rejected" else "circle",
        },
    )


def _slider(names: list[str], owner: list[int]) -> dict[str, Any]:
    steps = [
        {"label": label(name), "method": "restyle", "args": [{"visible": [number == k for number in owner]}]}
        for k, name in enumerate(names)
    ]
    return {"steps": steps, "currentvalue": {"prefix": "image "}, "pad": {"t": 10, "b": 20, "l": 60, "r": 60}}
