"""Figures of docs/telescope-report.md, as SVG that renders without a browser's scripts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from docs.experiments.telescope_report_absorption import by_row, leg_fits, simulated
from docs.experiments.telescope_report_data import published
from docs.experiments.telescope_report_geometry import best_shape
from docs.experiments.telescope_report_remainder import ROWS, TOGETHER, Ignorance, explain, remainder
from truing.simulation.mechanisms.structures.beam_model import flexure_path

# Colours that colour-blind readers can distinguish; marks that differ in print.
BLUE, ORANGE, GREY = "#0072b2", "#d55e00", "#999999"
UNITS = {"u_x": "", "kappa": "1e-3", "a_x": "mm", "a_y": "mm", "b_x": "mm", "b_y": "mm", "l": "mm"}
SIGNS = {"u_x": "u_x", "kappa": "Δκ", "a_x": "Δa_x", "a_y": "Δa_y", "b_x": "Δb_x", "b_y": "Δb_y", "l": "Δl"}
TITLES = {"5a": "Table 5a (deformation ignored)", "6a": "Table 6a (κ alone)"}


def _svg(width: float, height: float, parts: Sequence[str]) -> str:
    head = (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:g}" height="{height:g}" '
        f'viewBox="0 0 {width:g} {height:g}" font-family="sans-serif" font-size="12">'
    )
    return "\n".join([head, f'<rect width="{width:g}" height="{height:g}" fill="white"/>', *parts, "</svg>\n"])


def _text(x: float, y: float, text: str, anchor: str = "middle", more: str = "") -> str:
    return f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}" {more}>{escape(text)}</text>'


def _line(x1: float, y1: float, x2: float, y2: float, colour: str, more: str = "") -> str:
    return f'<line x1="{x1:.1f}" y1="{y1:.1f}" x2="{x2:.1f}" y2="{y2:.1f}" stroke="{colour}" {more}/>'


def _dot(x: float, y: float, colour: str, radius: float = 3.5, fill: str | None = None) -> str:
    return f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{radius:g}" stroke="{colour}" fill="{fill or colour}"/>'


def _cross(x: float, y: float, colour: str) -> str:
    shape = f"M{x - 3.5:.1f},{y - 3.5:.1f}l7,7m0,-7l-7,7"
    return f'<path d="{shape}" fill="none" stroke="{colour}" stroke-width="1.3"/>'


def _ticks(low: float, high: float) -> list[float]:
    """Return three to six round values in a range."""
    raw = (high - low) / 4
    size = 10.0 ** np.floor(np.log10(raw))
    step = size * min((m for m in (1, 2, 5, 10) if m * size >= raw), default=10)
    return [k * step for k in range(int(np.ceil(low / step)), int(np.floor(high / step)) + 1)]


SIDE, LEFT, TOP = 176, 46, 30
PANEL_W, PANEL_H = SIDE + LEFT + 12, SIDE + TOP + 44


def draw_absorption(path: Path) -> None:
    """Draw every parameter of Tables 5a and 6a: predicted by K against identified on the machine."""
    parts, width, block = [], 3 * PANEL_W + 8, 2 * PANEL_H + 34
    for r, table in enumerate(TITLES):
        top = 26 + r * block
        parts.append(_text(width / 2, top - 6, TITLES[table], more='font-weight="bold" font-size="14"'))
        full, seen = simulated(best_shape().machine, table), published().moved(table)
        first = by_row(full.parameters, leg_fits(best_shape().machine, table).shift.ravel())
        for k, name in enumerate(seen):
            parts.append(f'<g transform="translate({k % 3 * PANEL_W + 4},{top + k // 3 * PANEL_H})">')
            scale = 1e3 if name == "kappa" else 1.0
            parts += [*_scatter(name, *(scale * rows[name] for rows in (full.rows, first, seen))), "</g>"]
    parts += _legend(2 * block + 12)
    path.write_text(_svg(width, 2 * block + 42, parts), encoding="utf-8")


def _legend(y: float) -> list[str]:
    return [
        _dot(30, y - 4, BLUE),
        _text(40, y, "full calibration of the simulated machine, number of the leg", "start"),
        _cross(400, y - 4, ORANGE),
        _text(410, y, "first order", "start"),
        _line(490, y - 4, 525, y - 4, GREY, 'stroke-dasharray="4 3"'),
        _text(532, y, "predicted = identified", "start"),
    ]


def _scatter(name: str, full: NDArray, first: NDArray, is_observed: NDArray) -> list[str]:
    values = np.concatenate([full, first, is_observed])
    margin = 0.09 * (values.max() - values.min())
    low, high = values.min() - margin, values.max() + margin

    def at(x: float, y: float) -> tuple[float, float]:
        return LEFT + (x - low) / (high - low) * SIDE, TOP + (high - y) / (high - low) * SIDE

    unit = f", {UNITS[name]}" if UNITS[name] else ""
    correlation = np.corrcoef(full, is_observed)[0, 1]
    out = [_text(LEFT + SIDE / 2, TOP - 8, f"{SIGNS[name]}{unit} — r = {correlation:.3f}", more='font-weight="bold"')]
    for tick in _ticks(low, high):
        (u, _), (_, v) = at(tick, low), at(low, tick)
        out += [_line(u, TOP, u, TOP + SIDE, "#eee"), _line(LEFT, v, LEFT + SIDE, v, "#eee")]
        out += [_text(u, TOP + SIDE + 15, f"{tick:g}"), _text(LEFT - 5, v + 4, f"{tick:g}", "end")]
    out.append(f'<rect x="{LEFT}" y="{TOP}" width="{SIDE}" height="{SIDE}" fill="none" stroke="#666"/>')
    out.append(_line(*at(low, low), *at(high, high), GREY, 'stroke-dasharray="4 3"'))
    for leg in range(6):
        out.append(_cross(*at(first[leg], is_observed[leg]), ORANGE))
        u, v = at(full[leg], is_observed[leg])
        out += [_dot(u, v, BLUE), _text(u + 6, v - 5, str(leg + 1), "start", f'fill="{BLUE}" font-size="11"')]
    out.append(_text(LEFT + SIDE / 2, TOP + SIDE + 32, "predicted"))
    out.append(f'<g transform="translate(11,{TOP + SIDE / 2}) rotate(-90)">{_text(0, 0, "identified")}</g>')
    return out


@dataclass(frozen=True)
class _View:
    """Top view: from x, y of the base in mm to the drawing."""

    x: float
    y: float
    scale: float

    def at(self, point: NDArray) -> tuple[float, float]:
        return self.x + self.scale * float(point[0]), self.y - self.scale * float(point[1])


AMPLIFIED = 12.0


def draw_geometry(path: Path) -> None:
    """Draw the inferred rings from above, and how far ignoring K moved their joints (Table 6a less 7a), amplified."""
    view = _View(330, 300, 1.55)
    shape, machine = best_shape(), best_shape().machine
    seen = published().moved("6a")
    predicted = dict(zip(ROWS, 1e3 * leg_fits(machine, "6a").shift, strict=True))
    parts = []
    for ring, colour in (("a", GREY), ("b", "#333333")):
        radius = 1e3 * shape.numbers["ab".index(ring)] * view.scale
        parts.append(f'<circle cx="{view.x}" cy="{view.y}" r="{radius:.1f}" fill="none" stroke="{colour}"/>')
    joints = {ring: 1e3 * getattr(machine.legs, ring)[:, :2] for ring in "ab"}
    for leg in range(6):
        ends = (*view.at(joints["a"][leg]), *view.at(joints["b"][leg]))
        parts.append(_line(*ends, "#bbb", 'stroke-width="5" stroke-linecap="round"'))
    for ring, joint in joints.items():
        for leg in range(6):
            start = view.at(joint[leg])
            for rows, colour, width in ((seen, ORANGE, 2.6), (predicted, BLUE, 1.4)):
                moved = np.array([rows[f"{ring}_x"][leg], rows[f"{ring}_y"][leg]])
                end = view.at(joint[leg] + AMPLIFIED * moved)
                parts.append(_line(*start, *end, colour, f'stroke-width="{width}"') + _dot(*end, colour, 3))
            outwards = view.at(joint[leg] * (1.14 if ring == "a" else 0.84))
            parts += [_dot(*start, "black", 3.5, "white"), _text(outwards[0], outwards[1] + 4, f"{ring}{leg + 1}")]
    notes = (
        (BLUE, "predicted from K"),
        (ORANGE, "identified: Table 6a less Table 7a"),
        (GREY, f"grey bars: legs; outer ring: base; joints' moves {AMPLIFIED:g} times as long"),
    )
    for k, (colour, note) in enumerate(notes):
        parts += [_dot(40, 606 + 20 * k, colour, 4), _text(52, 610 + 20 * k, note, "start")]
    parts += [_line(560, 560, 600, 560, "black"), _line(560, 560, 560, 520, "black")]
    parts += [_text(608, 564, "x", "start"), _text(560, 512, "y")]
    path.write_text(_svg(660, 668, parts), encoding="utf-8")


def draw_remainder(path: Path, by: Ignorance) -> None:
    """Draw Table 7a row by row: as printed, and with frames and the five common numbers taken out."""
    values, left = remainder(), explain(TOGETHER, by).residual
    sigma = np.sqrt(np.einsum("irr->ri", by.covariance()))
    row_h, width, middle = 62, 760, 400
    parts = [_text(width / 2, 22, "Table 7a: identified less nominal", more='font-weight="bold" font-size="14"')]
    for r, name in enumerate(ROWS):
        y = 58 + r * row_h
        scale = 26.0 if name == "kappa" else 95.0
        unit = "1e-3" if name == "kappa" else "mm"
        parts.append(_text(20, y + 4, f"{SIGNS[name]}, {unit}", "start"))
        band = scale * float(np.mean(sigma[r]))
        box = f'x="{middle - band:.1f}" y="{y - 22}" width="{2 * band:.1f}" height="46"'
        parts.append(f'<rect {box} fill="#e8f1f8"/>')
        parts.append(_line(middle, y - 22, middle, y + 24, GREY))
        for table, colour, dy in ((values, ORANGE, -10), (left, BLUE, 12)):
            for leg in range(6):
                x = middle + scale * table[r, leg]
                parts += [_dot(x, y + dy, colour), _text(x, y + dy - 5, str(leg + 1), more='font-size="10"')]
        ends = [-8, -4, 4, 8] if name == "kappa" else [-2, -1, 1, 2]
        parts += [_text(middle + scale * end, y + 36, f"{end:g}", more='font-size="10" fill="#666"') for end in ends]
    foot = 58 + len(ROWS) * row_h
    notes = (
        (ORANGE, "as printed"),
        (BLUE, "with the frames and five common numbers fitted"),
        ("#b5d2e6", "one sigma of tolerance, noise and K"),
    )
    for x, (colour, note) in zip((40, 150, 490), notes, strict=True):
        parts += [_dot(x, foot, colour, 4), _text(x + 10, foot + 4, note, "start")]
    path.write_text(_svg(width, foot + 24, parts), encoding="utf-8")


FLEXURE_MM, BENT_DEG = 10.0, 1.0
PATHS = {
    "ideal pivot in the middle": (GREY, "6 4", 1.5),
    "beam theory (eq. 12)": (BLUE, "", 4.0),
    "circle (eq. 13)": (ORANGE, "2 4", 2.5),
}


def draw_flexure(path: Path) -> None:
    """Draw figure 9 of the report: the end of a flexure of 10 mm, bent by up to one degree."""
    found = flexure_path(1e-3 * FLEXURE_MM, np.radians(np.linspace(0.0, BENT_DEG, 61)))
    width, height, left, top = 420, 300, 60, 30
    x_end, y_end = 1.02e6 * found.beam[1].max(), 1.05e6 * found.pivot[0].max()

    def at(x: float, y: float) -> tuple[float, float]:
        return left + x / x_end * (width - left - 20), top + y / y_end * (height - top - 80)

    title = f"End of a flexure of {FLEXURE_MM:g} mm, bent by 0 to {BENT_DEG:g}°"
    parts = [_text(width / 2, 18, title, more='font-weight="bold"')]
    for x in _ticks(0.0, x_end):
        parts += [_line(*at(x, 0.0), *at(x, y_end), "#ddd"), _text(at(x, 0.0)[0], at(x, y_end)[1] + 16, f"{x:g}")]
    for y in _ticks(0.0, y_end):
        parts += [_line(*at(0.0, y), *at(x_end, y), "#ddd"), _text(left - 5, at(0.0, y)[1] + 4, f"{y:.1f}", "end")]
    for k, ((name, (colour, dash, wide)), (along, across)) in enumerate(
        zip(PATHS.items(), (found.pivot, found.beam, found.circle), strict=True)
    ):
        points = " ".join("{:.1f},{:.1f}".format(*at(1e6 * x, 1e6 * y)) for x, y in zip(across, along, strict=True))
        look = f'stroke-width="{wide:g}" stroke-dasharray="{dash}"'
        parts.append(f'<polyline points="{points}" stroke="{colour}" {look} fill="none"/>')
        x = 20 + (0, 180, 300)[k]
        parts.append(_line(x, height - 12, x + 22, height - 12, colour, look))
        parts.append(_text(x + 26, height - 8, name.partition(" (")[0], "start"))
    parts.append(_text(width / 2, height - 30, "across, µm"))
    upright = f'transform="rotate(-90 14 {height / 2 - 20:g})"'
    parts.append(_text(14, height / 2 - 20, "towards the root, µm", more=upright))
    path.write_text(_svg(width, height, parts), encoding="utf-8")
