"""Small plots with linear axes as SVG, for pages that must render without scripts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

_WIDTH, _HEIGHT = 380, 270
_LEFT, _RIGHT, _TOP, _BOTTOM = 58, 12, 30, 42
# Colours that colour-blind readers tell apart.
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#000000")


@dataclass(frozen=True)
class Trace:
    """Points x, y (N,): ``line`` joins them, ``dots`` marks them, ``bars`` stands them on zero.

    A trace without a name has the colour of the named one in its place, counted from the first without.
    """

    name: str
    x: NDArray
    y: NDArray
    style: str = "dots"


@dataclass(frozen=True)
class Plot:
    """One plot: title, axes, traces; ``names`` (N,) stand below whole numbers on x in place of them; ``square``: one
    scale on both axes."""

    title: str
    x_label: str
    y_label: str
    traces: Sequence[Trace]
    names: Sequence[str] = ()
    square: bool = False


def write_plots(path: Path, plots: Sequence[Plot]) -> None:
    """Write plots side by side, with one legend below."""
    width, height = len(plots) * _WIDTH, _HEIGHT + 26
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="{height}" viewBox="0 0 {width} {height}" '
        'font-family="sans-serif" font-size="12">',
        f'<rect width="{width}" height="{height}" fill="white"/>',
    ]
    for k, plot in enumerate(plots):
        parts += [f'<g transform="translate({k * _WIDTH},0)">', *_plot(plot), "</g>"]
    at = _LEFT
    for k, trace in enumerate(plots[0].traces):
        if not trace.name:
            continue
        parts.append(f'<rect x="{at}" y="{_HEIGHT + 6}" width="10" height="10" fill="{COLOURS[k]}"/>')
        parts.append(f'<text x="{at + 15}" y="{_HEIGHT + 15}">{escape(trace.name)}</text>')
        at += 30 + 7 * len(trace.name)
    path.write_text("\n".join([*parts, "</svg>\n"]), encoding="utf-8")


def _plot(plot: Plot) -> list[str]:
    x, y = (np.concatenate([getattr(trace, axis) for trace in plot.traces]) for axis in "xy")
    if any(trace.style == "bars" for trace in plot.traces):
        y, x = np.append(y, 0.0), np.concatenate([x, [x.min() - 0.5, x.max() + 0.5]])
    (left, right), (low, high) = _limits(x), _limits(y)
    across, down = _WIDTH - _LEFT - _RIGHT, _HEIGHT - _TOP - _BOTTOM
    if plot.square:
        middle, half = (left + right) / 2.0, (high - low) / 2.0 * across / down
        left, right = middle - half, middle + half

    def u(value: float) -> float:
        return _LEFT + across * (value - left) / (right - left)

    def v(value: float) -> float:
        return _TOP + down * (high - value) / (high - low)

    middle = _LEFT + across / 2
    out = [f'<text x="{middle}" y="18" text-anchor="middle" font-weight="bold">{escape(plot.title)}</text>']
    out.append(f'<text x="{middle}" y="{_HEIGHT - 6}" text-anchor="middle">{escape(plot.x_label)}</text>')
    turned = f'transform="translate(13,{_TOP + down / 2}) rotate(-90)"'
    out.append(f'<text {turned} text-anchor="middle">{escape(plot.y_label)}</text>')
    for tick in _ticks(low, high):
        out.append(f'<line x1="{_LEFT}" x2="{_WIDTH - _RIGHT}" y1="{v(tick):.1f}" y2="{v(tick):.1f}" stroke="#ddd"/>')
        out.append(f'<text x="{_LEFT - 6}" y="{v(tick) + 4:.1f}" text-anchor="end">{tick:g}</text>')
    named = [(float(k), name) for k, name in enumerate(plot.names)]
    for tick, name in named or [(tick, f"{tick:g}") for tick in _ticks(left, right)]:
        out.append(f'<text x="{u(tick):.1f}" y="{_HEIGHT - _BOTTOM + 16}" text-anchor="middle">{escape(name)}</text>')
    bars = [trace for trace in plot.traces if trace.style == "bars"]
    named_traces = sum(bool(trace.name) for trace in plot.traces)
    for place, trace in enumerate(plot.traces):
        k = place if trace.name else place - named_traces
        points = [(u(a), v(b)) for a, b in zip(trace.x, trace.y, strict=True) if np.isfinite(b)]
        if trace.style == "line":
            joined = " ".join(f"{a:.1f},{b:.1f}" for a, b in points)
            out.append(f'<polyline points="{joined}" fill="none" stroke="{COLOURS[k]}" stroke-width="1.2"/>')
        elif trace.style == "bars":
            wide = 0.8 * across / (right - left) / len(bars)
            first = wide * (bars.index(trace) - len(bars) / 2)
            for a, b in points:
                top, size = min(b, v(0.0)), abs(b - v(0.0))
                box = f'x="{a + first:.1f}" y="{top:.1f}" width="{0.92 * wide:.1f}" height="{size:.1f}"'
                out.append(f'<rect {box} fill="{COLOURS[k]}"/>')
        else:
            out += [f'<circle cx="{a:.1f}" cy="{b:.1f}" r="2" fill="{COLOURS[k]}"/>' for a, b in points]
    return out


def _limits(values: NDArray) -> tuple[float, float]:
    low, high = float(np.nanmin(values)), float(np.nanmax(values))
    room = 0.05 * (high - low) or 1.0
    return low - room, high + room


def _ticks(low: float, high: float) -> NDArray:
    size = 10.0 ** np.floor(np.log10((high - low) / 4.0))
    step = next(size * factor for factor in (1.0, 2.0, 5.0, 10.0) if (high - low) / (size * factor) <= 6.0)
    return np.round(np.arange(np.ceil(low / step), np.floor(high / step) + 1) * step, 12) + 0.0
