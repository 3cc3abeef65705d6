"""Write numbers as a table of coloured cells, an SVG file; nothing but the standard library and numpy."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path

import numpy as np

CELL_WIDTH, CELL_HEIGHT, LEFT, TOP, LEGEND = 118, 34, 150, 86, 62
LIGHT, DARK = np.array([255, 255, 255]), np.array([0, 68, 136])


@dataclass(frozen=True)
class HeatMap:
    """Rows and columns by name; what is written into each cell, and what colours it, on a scale of decades."""

    title: str
    rows: Sequence[str]
    columns: Sequence[str]
    words: Sequence[Sequence[str]]
    colour: Sequence[Sequence[float]]
    decades: tuple[float, float]
    legend: str


def write_heat_map(path: Path, chart: HeatMap) -> None:
    """Write the chart; NaN leaves a cell without colour."""
    width, height = LEFT + CELL_WIDTH * len(chart.columns) + 12, TOP + CELL_HEIGHT * len(chart.rows) + LEGEND
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="{height}" viewBox="0 0 {width} {height}" '
        'font-family="sans-serif" font-size="12">',
        f'<rect width="{width}" height="{height}" fill="white"/>',
        f'<text x="{width / 2}" y="20" text-anchor="middle" font-weight="bold">{escape(chart.title)}</text>',
        *_heads(chart),
        *_cells(chart),
        *_legend(chart, TOP + CELL_HEIGHT * len(chart.rows) + 24),
        "</svg>\n",
    ]
    path.write_text("\n".join(parts), encoding="utf-8")


def _heads(chart: HeatMap) -> list[str]:
    out = []
    for j, column in enumerate(chart.columns):
        x = LEFT + (j + 0.5) * CELL_WIDTH
        for k, line in enumerate(column.split("\n")):
            out.append(f'<text x="{x}" y="{TOP - 34 + 14 * k}" text-anchor="middle">{escape(line)}</text>')
    for i, row in enumerate(chart.rows):
        y = TOP + (i + 0.5) * CELL_HEIGHT + 4
        out.append(f'<text x="{LEFT - 10}" y="{y}" text-anchor="end">{escape(row)}</text>')
    return out


def _cells(chart: HeatMap) -> list[str]:
    out = []
    for i, (words, values) in enumerate(zip(chart.words, chart.colour, strict=True)):
        for j, (word, value) in enumerate(zip(words, values, strict=True)):
            x, y, share = LEFT + j * CELL_WIDTH, TOP + i * CELL_HEIGHT, _share(value, chart.decades)
            box = f'width="{CELL_WIDTH}" height="{CELL_HEIGHT}" fill="{_colour(share)}" stroke="#999"'
            out.append(f'<rect x="{x}" y="{y}" {box}/>')
            ink, middle = "#ffffff" if share > 0.55 else "#000000", f'x="{x + CELL_WIDTH / 2}" y="{y + 21}"'
            out.append(f'<text {middle} text-anchor="middle" fill="{ink}">{escape(word)}</text>')
    return out


def _legend(chart: HeatMap, y: float) -> list[str]:
    low, high = chart.decades
    out = [f'<text x="{LEFT - 10}" y="{y + 12}" text-anchor="end">{escape(chart.legend)}</text>']
    for k in range(60):
        out.append(f'<rect x="{LEFT + 5 * k}" y="{y}" width="5" height="16" fill="{_colour((k + 0.5) / 60)}"/>')
    out.append(f'<rect x="{LEFT}" y="{y}" width="300" height="16" fill="none" stroke="#999"/>')
    for power in range(int(np.ceil(np.log10(low))), int(np.floor(np.log10(high))) + 1):
        x = LEFT + 300 * _share(10.0**power, chart.decades)
        out.append(f'<text x="{x:.0f}" y="{y + 31}" text-anchor="middle">{10.0**power:g}</text>')
    return out


def _share(value: float, decades: tuple[float, float]) -> float:
    if not value > 0:
        return 0.0
    low, high = np.log10(decades)
    return float(np.clip((np.log10(value) - low) / (high - low), 0.0, 1.0))


def _colour(share: float) -> str:
    red, green, blue = np.round(LIGHT + (DARK - LIGHT) * share).astype(int)
    return f"#{red:02x}{green:02x}{blue:02x}"
