"""Small charts with a logarithmic axis as SVG, for pages that must render without scripts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path

import numpy as np

WIDTH, HEIGHT = 360, 270
LEFT, RIGHT, TOP, BOTTOM = 62, 14, 34, 44
STYLES = {  # colours that colour-blind readers can distinguish, and marks that differ in print
    "bound": ("#000000", "6 4", ""),
    "line": ("#d55e00", "", "square"),
    "least squares": ("#0072b2", "", "circle"),
    "Haralick": ("#009e73", "", "triangle"),
    "default": ("#cc79a7", "", "cross"),
    "random": ("#d55e00", "", "square"),
    "IOOPS-like": ("#009e73", "", "triangle"),
    "direct": ("#0072b2", "", "circle"),
    "exchange": ("#cc79a7", "", "cross"),
    "Table 3": ("#000000", "", "square"),
}


@dataclass(frozen=True)
class Series:
    """One curve: its name, a key of STYLES, its values, NaN where it has none, and how far they spread to each side."""

    name: str
    values: Sequence[float]
    spread: Sequence[float] = ()


@dataclass(frozen=True)
class Panel:
    """One chart: title, label of the vertical axis, horizontal values, curves."""

    title: str
    y_label: str
    x: Sequence[float]
    series: Sequence[Series]


def write_chart(path: Path, panels: Sequence[Panel], columns: int, x_label: str) -> None:
    """Write panels row by row, with one legend below."""
    rows = -(-len(panels) // columns)
    width, height = columns * WIDTH, rows * HEIGHT + 40
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="{height}" viewBox="0 0 {width} {height}" '
        'font-family="sans-serif" font-size="12">',
        f'<rect width="{width}" height="{height}" fill="white"/>',
    ]
    for k, panel in enumerate(panels):
        parts.append(f'<g transform="translate({k % columns * WIDTH},{k // columns * HEIGHT})">')
        parts += [*_panel(panel, x_label), "</g>"]
    parts += [*_legend(panels[0].series, rows * HEIGHT + 22, width), "</svg>\n"]
    path.write_text("\n".join(parts), encoding="utf-8")


def _panel(panel: Panel, x_label: str) -> list[str]:
    values = np.array([s.values for s in panel.series], dtype=float)
    low, high = np.nanmin(values) / 1.3, np.nanmax(values) * 1.3

    def at(x: float, y: float) -> tuple[float, float]:
        u = (x - panel.x[0]) / (panel.x[-1] - panel.x[0])
        v = np.log(y / low) / np.log(high / low)
        return LEFT + u * (WIDTH - LEFT - RIGHT), HEIGHT - BOTTOM - v * (HEIGHT - TOP - BOTTOM)

    middle = (LEFT + WIDTH - RIGHT) / 2
    out = [f'<text x="{middle}" y="20" text-anchor="middle" font-weight="bold">{escape(panel.title)}</text>']
    out.append(f'<text x="{middle}" y="{HEIGHT - 8}" text-anchor="middle">{escape(x_label)}</text>')
    out.append(f'<text transform="translate(14,{HEIGHT / 2}) rotate(-90)" text-anchor="middle">{panel.y_label}</text>')
    for y in _ticks(low, high):
        _, v = at(panel.x[0], y)
        out.append(f'<line x1="{LEFT}" x2="{WIDTH - RIGHT}" y1="{v:.1f}" y2="{v:.1f}" stroke="#ddd"/>')
        out.append(f'<text x="{LEFT - 6}" y="{v + 4:.1f}" text-anchor="end">{y:g}</text>')
    for x in panel.x[::2]:
        u, _ = at(x, low)
        out.append(f'<text x="{u:.1f}" y="{HEIGHT - BOTTOM + 16}" text-anchor="middle">{x:g}</text>')
    frame = f'width="{WIDTH - LEFT - RIGHT}" height="{HEIGHT - TOP - BOTTOM}"'
    out.append(f'<rect x="{LEFT}" y="{TOP}" {frame} fill="none" stroke="#666"/>')
    for s in panel.series:
        places = [at(x, y) for x, y in zip(panel.x, s.values, strict=True) if np.isfinite(y)]
        out += _curve(s.name, places)
        for x, y, spread in zip(panel.x, s.values, s.spread, strict=False):
            if np.isfinite(y) and 0 < spread < y:
                (u, v), (_, w) = at(x, y - spread), at(x, y + spread)
                out.append(f'<path d="M{u:.1f},{v:.1f}V{w:.1f}" stroke="{STYLES[s.name][0]}" stroke-width="1"/>')
    return out


def _ticks(low: float, high: float) -> list[float]:
    decades = range(int(np.floor(np.log10(low))), int(np.ceil(np.log10(high))) + 1)
    steps = (1, 1.5, 2, 3, 4, 5, 7) if high / low < 8 else (1, 2, 5)
    return [m * 10.0**d for d in decades for m in steps if low < m * 10.0**d < high]


def _curve(name: str, places: Sequence[tuple[float, float]]) -> list[str]:
    colour, dash, mark = STYLES[name]
    if not places:
        return []
    points = " ".join(f"{u:.1f},{v:.1f}" for u, v in places)
    dashed = f' stroke-dasharray="{dash}"' if dash else ""
    line = f'<polyline points="{points}" fill="none" stroke="{colour}" stroke-width="1.5"{dashed}/>'
    return [line, *(_mark(mark, colour, u, v) for u, v in places if mark)]


def _mark(mark: str, colour: str, u: float, v: float) -> str:
    shapes = {
        "square": f"M{u - 3.5:.1f},{v - 3.5:.1f}h7v7h-7z",
        "circle": f"M{u - 3:.1f},{v:.1f}a3,3 0 1,0 6,0a3,3 0 1,0 -6,0z",
        "triangle": f"M{u:.1f},{v - 4.5:.1f}l4,7h-8z",
        "cross": f"M{u - 4:.1f},{v - 4:.1f}l8,8m0,-8l-8,8",
    }
    return f'<path d="{shapes[mark]}" fill="white" fill-opacity="0.6" stroke="{colour}" stroke-width="1.3"/>'


def _legend(series: Sequence[Series], y: float, width: float) -> list[str]:
    out, step = [], width / (len(series) + 1)
    for k, s in enumerate(series):
        x = (k + 0.6) * step
        out += _curve(s.name, [(x, y - 4), (x + 30, y - 4)])
        out.append(f'<text x="{x + 38}" y="{y}">{escape(s.name)}</text>')
    return out
