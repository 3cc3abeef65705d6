"""Figures 8 and 9 of the force-sensor paper, redrawn with the uncertainty of a hundred samples, as SVG."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from docs.experiments.force_sensor_sets import ARCSEC, SETS, sigmas
from docs.experiments.force_sensor_tolerances import SAMPLES, geometries
from truing.simulation.bench.six_upur.assembly import CODES, closed_loop_map, comprehensive, open_chain_map
from truing.simulation.bench.six_upur.tolerances import box_muller, first_order_covariances, rms_band

# Colours that colour-blind readers can distinguish.
DOTS, BAND, TRUTH = "#0072b2", "#d55e00", "#000000"
WIDTH, HEIGHT = 300, 300
LEFT, RIGHT, TOP, BOTTOM = 54, 10, 48, 34


def draw(path: Path, kind: int) -> None:
    """Draw the position (0, figure 8) or the attitude error (1, figure 9) of each source, three panels side by side."""
    names = [name for name in geometries() if name.startswith("twist") and "20.0" not in name]
    maps = {"mean of open chains (eq. 14)": open_chain_map(SETS["S"].joints())}
    maps |= {f"closed loops, {name}": closed_loop_map(geometries()[name]) for name in names}
    unit, label = ((1e6, "position error, µm"), (1 / ARCSEC, "attitude error, arcsec"))[kind]
    panels = [_panel(name, unit * _drawn(each, kind), unit * _first_order(each, kind)) for name, each in maps.items()]
    width, height = WIDTH * len(panels) + 20, HEIGHT + 40
    parts = [f'<rect width="{width}" height="{height}" fill="white"/>', _text(14, HEIGHT / 2, label, "middle", -90)]
    for k, panel in enumerate(panels):
        parts += [f'<g transform="translate({20 + k * WIDTH},0)">', *panel, "</g>"]
    parts += _legend(HEIGHT + 20)
    head = f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="{height}" viewBox="0 0 {width} {height}"'
    whole = [f'{head} font-family="sans-serif" font-size="12">', *parts, "</svg>\n"]
    path.write_text("\n".join(whole), encoding="utf-8")


def _drawn(slopes: NDArray, kind: int) -> NDArray:
    """Return comprehensive errors (5, SAMPLES) as the paper draws them: source by source, eq. 17 and 15."""
    rng = np.random.default_rng(8)
    uniform = rng.random((2, 5, SAMPLES, 6))
    errors = box_muller(sigmas()[:, None, None], 1.0 - uniform[0], uniform[1])
    return comprehensive(np.einsum("kni,qik->knq", errors, slopes))[kind]


def _first_order(slopes: NDArray, kind: int) -> NDArray:
    C = first_order_covariances(slopes, sigmas())[:, 3 * kind : 3 * kind + 3, 3 * kind : 3 * kind + 3]
    return np.sqrt(np.trace(C, axis1=1, axis2=2))


def _panel(title: str, drawn: NDArray, truth: NDArray) -> list[str]:
    """Return dots of all samples, the rms with its band, and the first order, source by source."""
    largest, inner = float(drawn.max()), HEIGHT - TOP - BOTTOM
    top = 1.05 * largest if largest > 0.0 else 1.0
    parts = [_text((LEFT + WIDTH - RIGHT) / 2, 22, title, weight="bold")]
    if largest == 0.0:
        parts.append(_text((LEFT + WIDTH - RIGHT) / 2, HEIGHT / 2, "identically zero"))

    def at(value: float) -> float:
        return HEIGHT - BOTTOM - value / top * inner

    for value in _ticks(top) if largest > 0.0 else (0.0,):
        parts.append(_line(LEFT, at(value), WIDTH - RIGHT, at(value), "#ddd"))
        parts.append(_text(LEFT - 5, at(value) + 4, f"{value:g}", "end"))
    step = (WIDTH - LEFT - RIGHT) / len(CODES)
    aside = np.random.default_rng(0).uniform(-0.32, 0.06, drawn.shape[1])
    for k, code in enumerate(CODES):
        middle = LEFT + (k + 0.5) * step
        parts.append(_text(middle, HEIGHT - BOTTOM + 18, code))
        parts += [_dot(middle + step * x, at(y)) for x, y in zip(aside, drawn[k], strict=True)]
        band = rms_band(drawn[k])
        x = middle + 0.24 * step
        parts.append(_line(x, at(float(band.low)), x, at(float(band.high)), BAND, 3))
        parts.append(_line(middle - 0.42 * step, at(truth[k]), middle + 0.42 * step, at(truth[k]), TRUTH, 1.3))
    frame = f'width="{WIDTH - LEFT - RIGHT}" height="{inner}"'
    return [*parts, f'<rect x="{LEFT}" y="{TOP}" {frame} fill="none" stroke="#666"/>']


def _ticks(top: float) -> Sequence[float]:
    size = 10.0 ** np.floor(np.log10(top))
    step = next(m * size for m in (0.1, 0.2, 0.5, 1.0, 2.0) if top / (m * size) <= 7)
    return [k * step for k in range(int(top / step) + 1)]


def _legend(y: float) -> list[str]:
    return [
        _dot(80, y),
        _text(90, y + 4, f"one of {SAMPLES} samples", "start"),
        _line(260, y - 7, 260, y + 7, BAND, 3),
        _text(270, y + 4, f"rms of the {SAMPLES}, 95 % band", "start"),
        _line(480, y, 510, y, TRUTH, 1.3),
        _text(518, y + 4, "rms to first order, exact", "start"),
    ]


def _text(x: float, y: float, text: str, anchor: str = "middle", turn: float = 0.0, weight: str = "normal") -> str:
    place = f'transform="translate({x:.1f},{y:.1f}) rotate({turn:g})"' if turn else f'x="{x:.1f}" y="{y:.1f}"'
    return f'<text {place} text-anchor="{anchor}" font-weight="{weight}">{escape(text)}</text>'


def _line(x1: float, y1: float, x2: float, y2: float, colour: str, width: float = 1.0) -> str:
    ends = f'x1="{x1:.1f}" y1="{y1:.1f}" x2="{x2:.1f}" y2="{y2:.1f}"'
    return f'<line {ends} stroke="{colour}" stroke-width="{width:g}"/>'


def _dot(x: float, y: float) -> str:
    return f'<circle cx="{x:.1f}" cy="{y:.1f}" r="1.6" fill="{DOTS}" fill-opacity="0.5"/>'
