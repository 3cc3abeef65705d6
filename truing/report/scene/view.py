"""3-D view of one body: places, amplified displacements, and the legs chosen by the reader."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import plotly.graph_objects as go
from numpy.typing import NDArray

from truing.report.figure_style import BLUE, GREEN, GREY, ORANGE, RED, label, style

# Most points times steps on a page; of more steps, those with the largest displacements are kept.
MOST_DRAWN = 6000
# Decades of selectable gains above and below the suitable one.
_BEYOND = 10.0
_TALLEST = 0.95  # largest height of a scene relative to the view, so that its top is not cut


@dataclass(frozen=True)
class DrawnScene:
    """Scene of S steps (poses, or loads), N points and L legs, all in the body's frame, mm.

    ``place`` (S, N, 3) and ``shift`` (S, N, 3), NaN where a point was not measured; ``leg`` (N,) from 1, 0 for none;
    ``attached`` (N,): drawn in the ring; ``own`` (N,): shown only with its leg; ``words`` (S, N) for each displacement;
    ``lower`` and ``upper`` (S, L, 3): joints of ``legs`` (L,); ``arrow`` (S, 2, 3): the load; ``said``: measured values
    per step and leg, in words.
    """

    step: str
    labels: tuple[str, ...]
    names: tuple[str, ...]
    place: NDArray[np.float64]
    shift: NDArray[np.float64]
    leg: NDArray[np.intp]
    attached: NDArray[np.bool_]
    own: NDArray[np.bool_]
    words: tuple[tuple[str, ...], ...]
    legs: tuple[int, ...] = ()
    lower: NDArray[np.float64] | None = None
    upper: NDArray[np.float64] | None = None
    arrow: NDArray[np.float64] | None = None
    captions: tuple[tuple[str, ...], ...] = ()
    all_legs: bool = False  # legs are drawn also where none is chosen
    ringed: str = "target at an attachment"  # words for the points in the ring

    @property
    def gain(self) -> float:
        """Suitable amplification: the largest displacement of the first step covers a sixth of the view."""
        size = np.linalg.norm(self.shift[0, ~self.own], axis=-1)
        large = float(np.nanmax(size, initial=0.0))
        return round_gain(0.16 * self.extent / max(large, 1e-9))

    @property
    def extent(self) -> float:
        """Largest side of the body, mm."""
        return float(np.nanmax(np.nanmax(self.place[:, ~self.own], axis=(0, 1)) - self.low))

    @property
    def low(self) -> NDArray[np.float64]:
        """Corner (3,) of the body with the smallest coordinates, mm."""
        return np.asarray(np.nanmin(self.place[:, ~self.own], axis=(0, 1)))

    @property
    def ring(self) -> NDArray[np.intp]:
        """Points at attachments in their order round the centre, closed: their ring shows a buckled platform."""
        attached = np.flatnonzero(self.attached)
        if not len(attached):
            return attached
        points = np.nanmean(self.place[:, attached], axis=0)
        x, y, _ = (points - points.mean(axis=0)).T
        order = attached[np.argsort(np.arctan2(y, x), kind="stable")]
        return np.append(order, order[0])


def round_gain(gain: float) -> float:
    """Return the largest of 1, 2, 5, 10, 20... that is not above ``gain``."""
    power = 10.0 ** np.floor(np.log10(max(gain, 1.0)))
    return float(power * max(d for d in (1, 2, 5) if d * power <= max(gain, 1.0)))


def gains(chosen: float) -> list[float]:
    """Return the selectable amplifications around the suitable one: 1, 2, 5, 10, ..."""
    steps = np.arange(np.floor(np.log10(_BEYOND * chosen)) + 1.0)
    every = np.multiply.outer(10.0**steps, (1.0, 2.0, 5.0)).ravel()
    return [float(gain) for gain in every if gain <= _BEYOND * chosen]


def picture(scene: DrawnScene, title: str, subtitle: str) -> go.Figure:
    """Return the scene as a figure with a slider for the step; the page adds controls for amplification and legs."""
    figure = go.Figure(_traces(scene))
    for trace, changes in zip(figure.data, drawn(scene, 0, scene.gain), strict=True):
        trace.update(changes)
    style(figure, title, subtitle, 640)
    low, high = _box(scene)
    figure.update_layout(
        meta={"scene": scene_data(scene)},
        sliders=[_slider(scene)],
        scene=scene_axes(low, high),
        legend={"orientation": "h", "y": 1.0, "yanchor": "top", "itemsizing": "constant"},
        margin={"l": 0, "r": 0, "t": 90, "b": 40},
    )
    return figure


def drawn(scene: DrawnScene, step: int, gain: float, chosen: tuple[int, ...] = ()) -> list[dict[str, object]]:
    """Return coordinates and texts of all traces with the chosen legs, as the script of the page computes them too."""
    start, end = scene.place[step], scene.place[step] + gain * scene.shift[step]
    is_finite = np.isfinite(start).all(-1) & np.isfinite(end).all(-1)
    is_finite &= ~scene.own | np.isin(scene.leg, chosen)
    lit = is_finite & (np.isin(scene.leg, chosen) if chosen else True)
    ring = scene.ring[is_finite[scene.ring]]
    legs = [k for k, leg in enumerate(scene.legs) if leg in chosen or (scene.all_legs and not chosen)]
    legs = legs if scene.lower is not None else []
    gap = np.full((1, 3), np.nan)
    lines = np.stack([start, end, np.broadcast_to(gap, start.shape)], axis=1)[lit].reshape(-1, 3)
    joints = _joints(scene, step)[legs]
    rods = np.concatenate([joints, np.broadcast_to(gap, (len(legs), 1, 3))], axis=1).reshape(-1, 3)
    arrow = scene.arrow[step] if scene.arrow is not None else np.zeros((0, 3))
    words = np.array([label(word) for word in scene.words[step]], dtype=object)
    plain, attached = is_finite & ~scene.attached, is_finite & scene.attached
    shown = [
        (start[plain], words[plain]),
        (start[attached], words[attached]),
        (lines, None),
        (start[ring], None),
        (end[ring], None),
        (rods, None),
        (joints.reshape(-1, 3), [f"leg {scene.legs[k]}, {end} joint" for k in legs for end in ("lower", "upper")]),
        (arrow, None),
    ]
    return [
        {**dict(zip("xyz", np.round(points, 4).T, strict=True)), **({} if text is None else {"text": list(text)})}
        for points, text in shown
    ]


def _joints(scene: DrawnScene, step: int) -> NDArray[np.float64]:
    """Return lower and upper joints (L, 2, 3) of a step."""
    if scene.lower is None or scene.upper is None:
        return np.zeros((0, 2, 3))
    return np.stack([scene.lower[step], scene.upper[step]], axis=1)


def scene_data(scene: DrawnScene) -> dict[str, object]:
    """Return the scene for the page's script: numbers in mm, points by step."""
    return {
        "gain": scene.gain,
        "gains": gains(scene.gain),
        "names": [label(name) for name in scene.names],
        "place": _listed(scene.place),
        "shift": _listed(scene.shift, 6),
        "leg": scene.leg.tolist(),
        "attached": scene.attached.tolist(),
        "own": scene.own.tolist(),
        "words": [[label(word) for word in words] for words in scene.words],
        "ring": scene.ring.tolist(),
        "legs": list(scene.legs),
        "joints": [_listed(_joints(scene, step)) for step in range(len(scene.labels))],
        "arrow": [] if scene.arrow is None else _listed(scene.arrow),
        "said": [list(statements) for statements in scene.captions],
        "allLegs": scene.all_legs,
        "scale": round_gain(scene.extent / 10.0),
        "colours": {"chosen": RED, "other": "rgba(122,122,122,0.5)"},
    }


def _listed(values: NDArray[np.float64], digits: int = 4) -> object:
    """Return nested lists with null for unknown values."""
    rounded = np.round(values, digits)
    return np.where(np.isfinite(rounded), rounded.astype(object), np.array(None)).tolist()


def _traces(scene: DrawnScene) -> list[go.Scatter3d]:
    """Return the traces without coordinates, in the order of ``drawn``."""

    def dots(name: str, colour: str, size: float = 4.0, **more: Any) -> go.Scatter3d:
        marker = {"size": size, "color": colour}
        return go.Scatter3d(mode="markers", name=name, marker=marker, hoverinfo="text", **more)

    def line(name: str, colour: str, width: float, **more: Any) -> go.Scatter3d:
        look = {"color": colour, "width": width}
        return go.Scatter3d(mode="lines", name=name, line=look, hoverinfo="skip", connectgaps=False, **more)

    ringed, legged = bool(scene.attached.any()), bool(scene.legs)
    return [
        dots("target", BLUE, showlegend=bool((~scene.attached).any())),
        dots(scene.ringed, ORANGE, showlegend=ringed),
        line("displacement", RED, 6.0),
        line("ring of attachments", GREY, 2.0, showlegend=ringed),
        line("the ring, displaced", ORANGE, 5.0, showlegend=ringed),
        line("leg", GREEN, 7.0, showlegend=legged and scene.all_legs),
        dots("joint", GREEN, 5.0, showlegend=False),
        line("load", BLUE, 8.0, showlegend=scene.arrow is not None),
    ]


def _slider(scene: DrawnScene) -> dict[str, object]:
    steps = []
    for step, name in enumerate(scene.labels):
        changes = drawn(scene, step, scene.gain)
        args = {axis: [trace[axis] for trace in changes] for axis in "xyz"}
        args["text"] = [trace.get("text") for trace in changes]
        steps.append({"label": label(name), "method": "restyle", "args": [args]})
    return {"steps": steps, "currentvalue": {"prefix": f"{scene.step} "}, "pad": {"t": 10, "b": 20, "l": 60, "r": 60}}


def _box(scene: DrawnScene) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the corners (3,) of everything that can be shown, over all steps and legs."""
    parts = [scene.place.reshape(-1, 3), (scene.place + scene.gain * scene.shift).reshape(-1, 3)]
    if scene.lower is not None and scene.upper is not None:
        parts += [scene.lower.reshape(-1, 3), scene.upper.reshape(-1, 3)]
    if scene.arrow is not None:
        parts.append(scene.arrow.reshape(-1, 3))
    points = np.concatenate(parts)
    return np.nanmin(points, axis=0), np.nanmax(points, axis=0)


def scene_axes(low: NDArray[np.float64], high: NDArray[np.float64]) -> dict[str, Any]:
    """Return axes that hold body and amplified displacement; a flat body gets a visible height of a third
    of its width."""
    margin = 0.02 * float((high - low).max()) + 1e-6
    low, high = low - margin, high + margin
    ratio = np.maximum((high - low) / (high - low).max(), 0.35)
    ratio *= min(1.75 / np.linalg.norm(ratio), _TALLEST / ratio[2])
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
