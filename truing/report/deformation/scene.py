"""The deformation picture: targets of one body and their amplified displacement in 3-D, pose by pose."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from truing.report.figure_style import BLUE, GREY, ORANGE, RED, label, style
from truing.report.numbers import quantity

if TYPE_CHECKING:
    import pandas as pd
    import plotly.graph_objects as go

_XYZ = ["x_mm", "y_mm", "z_mm"]
_SHIFT = ["dx_mm", "dy_mm", "dz_mm"]
_POSES_SHOWN = 12
_TRACES_OF_A_POSE = 5


def deformation_picture(shape: pd.DataFrame, residuals: pd.DataFrame, body: str) -> go.Figure:
    """Targets at their places in the body and their amplified displacement; a slider holds the poses that deform most.

    ``shape``: body, target, x_mm, y_mm, z_mm, leg; ``residuals`` of one body (telescope report, figure 6).
    """
    import plotly.graph_objects as go

    placed = residuals[~residuals["rejected"]].merge(shape, on=["body", "target"]).dropna(subset=_SHIFT)
    placed = placed.assign(size=np.linalg.norm(placed[_SHIFT].to_numpy(), axis=1))
    poses = _most_deformed(placed)
    shown = placed[placed["pose"].isin(poses)]
    extent = float(np.ptp(shown[_XYZ].to_numpy(), axis=0).max())
    gain = round_gain(0.16 * extent / max(float(shown["size"].quantile(0.99)), 1e-9))
    figure = go.Figure()
    for k, pose in enumerate(poses):
        for trace in _displaced(shown[shown["pose"] == pose], gain):
            figure.add_trace(trace.update(visible=k == 0))
    step = round_gain(extent / 10.0)
    subtitle = f"Each line runs from a target's place to where it is measured; {quantity(step, 'mm')} on the axes = "
    subtitle += f"{quantity(step / gain, 'mm')} of displacement"
    style(figure, f"Displacement of the targets of {label(body)}, amplified {gain:g} times", subtitle, 640)
    start = shown[_XYZ].to_numpy()
    figure.update_layout(
        sliders=[_slider(poses)],
        scene=_scene(np.concatenate([start, start + gain * shown[_SHIFT].to_numpy()])),
        legend={"orientation": "h", "y": 1.0, "yanchor": "top", "itemsizing": "constant"},
        margin={"l": 0, "r": 0, "t": 90, "b": 40},
    )
    return figure


def _most_deformed(placed: pd.DataFrame) -> list[Any]:
    square = (placed["size"] ** 2).groupby(placed["pose"], sort=False).mean()
    return list(square.sort_values(ascending=False, kind="stable").index[:_POSES_SHOWN])


def _slider(poses: Sequence[Any]) -> dict[str, Any]:
    steps = [
        {
            "label": label(pose),
            "method": "update",
            "args": [{"visible": [i // _TRACES_OF_A_POSE == k for i in range(_TRACES_OF_A_POSE * len(poses))]}],
        }
        for k, pose in enumerate(poses)
    ]
    return {"steps": steps, "currentvalue": {"prefix": "pose "}, "pad": {"t": 10, "b": 20, "l": 60, "r": 60}}


def _scene(points: NDArray[np.float64]) -> dict[str, Any]:
    """Axes that hold body and amplified displacement; a flat body gets a third of its width as height, to be seen."""
    low, high = points.min(axis=0), points.max(axis=0)
    margin = 0.02 * float((high - low).max()) + 1e-6
    low, high = low - margin, high + margin
    ratio = np.maximum((high - low) / (high - low).max(), 0.35)
    ratio *= 1.75 / np.linalg.norm(ratio)
    away = 0.98 + 0.25 * float(ratio[2])
    axes = {
        f"{a}axis": {"title": {"text": f"{a} (mm)"}, "range": [float(low[k]), float(high[k])], "nticks": 6}
        for k, a in enumerate("xyz")
    }
    return {
        **axes,
        "aspectmode": "manual",
        "aspectratio": {a: float(ratio[k]) for k, a in enumerate("xyz")},
        "camera": {
            "eye": {"x": 0.8 * away, "y": -1.15 * away, "z": 0.75 * away},
            "center": {"x": 0, "y": 0, "z": -0.12},
        },
    }


def round_gain(gain: float) -> float:
    """The largest of 1, 2, 5, 10, 20... that is not above ``gain``."""
    power = 10.0 ** np.floor(np.log10(max(gain, 1.0)))
    return float(power * max(d for d in (1, 2, 5) if d * power <= max(gain, 1.0)))


def _displaced(rows: pd.DataFrame, gain: float) -> list[go.Scatter3d]:
    start, shift = rows[_XYZ].to_numpy(), rows[_SHIFT].to_numpy()
    end = start + gain * shift
    names = [
        f"{label(t)}: {quantity(float(np.linalg.norm(d)), 'mm')}" for t, d in zip(rows["target"], shift, strict=True)
    ]
    attached = rows["leg"].notna().to_numpy()
    arrows = np.stack([start, end, np.full_like(start, np.nan)], axis=1).reshape(-1, 3)
    around = _ring(start[attached])
    return [
        _dots(start, names, ~attached, "target", BLUE),
        _dots(start, names, attached, "target at an attachment", ORANGE),
        _line(arrows, "displacement", {"color": RED, "width": 6}),
        _line(start[attached][around], "ring of attachments", {"color": GREY, "width": 2}),
        _line(end[attached][around], "the ring, displaced", {"color": ORANGE, "width": 5}),
    ]


def _dots(
    points: NDArray[np.float64], names: Sequence[str], chosen: NDArray[np.bool_], name: str, colour: str
) -> go.Scatter3d:
    import plotly.graph_objects as go

    x, y, z = points[chosen].T
    text = [n for n, c in zip(names, chosen, strict=True) if c]
    dots = {"size": 4, "color": colour}
    return go.Scatter3d(
        x=x, y=y, z=z, mode="markers", name=name, marker=dots, text=text, hoverinfo="text", showlegend=bool(len(x))
    )


def _line(points: NDArray[np.float64], name: str, line: dict[str, Any]) -> go.Scatter3d:
    import plotly.graph_objects as go

    x, y, z = points.T
    return go.Scatter3d(
        x=x, y=y, z=z, mode="lines", name=name, line=line, hoverinfo="skip", connectgaps=False, showlegend=bool(len(x))
    )


def _ring(attachments: NDArray[np.float64]) -> NDArray[np.intp]:
    """The order in which the attachments lie round their middle, closed: displaced, the buckled wheel."""
    if not len(attachments):
        return np.zeros(0, dtype=np.intp)
    x, y, _ = (attachments - attachments.mean(axis=0)).T
    order = np.argsort(np.arctan2(y, x), kind="stable")
    return np.append(order, order[0])
