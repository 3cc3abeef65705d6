"""Figures of the blind benchmark as SVG: power, every campaign by cause, and confusions between causes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from html import escape
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tests.blind import rates
from tests.blind.judging import Assessed

MATRIX = "platform-deformation-matrix"
UNSIZED = ("targets-swapped", "rows-exchanged", "joints-exchanged")
EDGES = (2.4, 3.6, 4.5, 5.2, 6.0, 7.0, 8.7, 11.0, 14.0, 18.5)
MATRIX_EDGES = (3.4, 6.0, 7.5, 8.7, 11.0, 15.0, 26.5)
CANDIDATES, LEVEL = 2000, 0.03  # what one parameter must stand against, as the theory next to the curve has it
COLOURS = {"named": "#0072b2", "found": "#e69f00", "missed": "#d55e00"}


def _svg(width: float, height: float, parts: list[str]) -> str:
    head = (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:.0f}" height="{height:.0f}" '
        f'viewBox="0 0 {width:.0f} {height:.0f}" font-family="sans-serif" font-size="12">'
    )
    return "\n".join([head, f'<rect width="{width:.0f}" height="{height:.0f}" fill="white"/>', *parts, "</svg>\n"])


def _text(x: float, y: float, words: str, anchor: str = "middle", more: str = "") -> str:
    return f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}" {more}>{escape(words)}</text>'


def _singles(campaigns: Sequence[Assessed]) -> list[Assessed]:
    """Campaigns with one effect of the catalogue whose size could be chosen."""
    return [campaign for campaign in campaigns if len(campaign.hidden) == 1 and _is_scaled(campaign)]


def _is_scaled(assessed: Assessed) -> bool:
    return assessed.hidden[0].cause != "unexplained" and bool(np.isfinite(assessed.hidden[0].strength))


def theory(strength: NDArray, parameters: int, candidates: int) -> NDArray:
    """Return the power of a chi-square test of so many parameters against so many candidates, at LEVEL over all."""
    from scipy.stats import chi2, ncx2

    return np.asarray(ncx2.sf(chi2.isf(LEVEL / candidates, parameters), parameters, strength**2))


def power_figure(path: Path, campaigns: Sequence[Assessed]) -> None:
    """Write how often effects are found and named against their signal-to-noise, with exact 95 % bounds."""
    own = _singles(campaigns)
    few = [one for one in own if one.hidden[0].cause != MATRIX]
    many = [one for one in own if one.hidden[0].cause == MATRIX]
    parts = [
        *_power_panel(0, "all causes but K" if many else "all causes", few, EDGES, (1, CANDIDATES)),
        *_legend(330, {"found": COLOURS["found"], "named": COLOURS["named"], "theory": "#000000"}),
    ]
    if many:
        parts += _power_panel(420, "K, 36 parameters", many, MATRIX_EDGES, (36, CANDIDATES))
    path.write_text(_svg(840 if many else 660, 350, parts), encoding="utf-8")


def _power_panel(
    left: float, title: str, campaigns: Sequence[Assessed], edges: Sequence[float], test: tuple[int, int]
) -> list[str]:
    low, high = np.log(edges[0]), np.log(edges[-1])

    def at(strength: float, share: float) -> tuple[float, float]:
        return left + 50 + 350 * (np.log(strength) - low) / (high - low), 270 - 230 * share

    out = [_text(left + 225, 22, title, more='font-weight="bold"'), _text(left + 225, 306, "signal-to-noise")]
    for share in (0.0, 0.25, 0.5, 0.75, 0.95, 1.0):
        y = at(edges[0], share)[1]
        out += [f'<path d="M{left + 50},{y:.1f}h350" stroke="#ddd"/>', _text(left + 44, y + 4, f"{share:.0%}", "end")]
    for strength in (3, 4, 5, 6, 8.7, 12, 18):
        if edges[0] <= strength <= edges[-1]:
            out.append(_text(at(strength, 0)[0], 286, f"{strength:g}"))
    grid = np.geomspace(edges[0], edges[-1], 80)
    line = " ".join("{:.1f},{:.1f}".format(*at(s, p)) for s, p in zip(grid, theory(grid, *test), strict=True))
    out.append(f'<polyline points="{line}" fill="none" stroke="#000" stroke-dasharray="6 4"/>')
    for side, name in ((-2.5, "found"), (2.5, "named")):
        out += _bins(campaigns, edges, at, name, side)
    return [*out, f'<rect x="{left + 50}" y="40" width="350" height="230" fill="none" stroke="#666"/>']


def _bins(
    campaigns: Sequence[Assessed],
    edges: Sequence[float],
    at: Callable[[float, float], tuple[float, float]],
    name: str,
    side: float,
) -> list[str]:
    out, colour = [], COLOURS[name]
    for low, high in pairwise(edges):
        own = [campaign for campaign in campaigns if low <= campaign.hidden[0].strength < high]
        if own:
            count = (rates.detected if name == "found" else rates.named)(own)
            x, y = at(np.exp(np.mean([np.log(one.hidden[0].strength) for one in own])), count.share)
            (_, down), (_, up) = (at(low, bound) for bound in rates.interval(count.good, count.trials))
            out.append(f'<path d="M{x + side:.1f},{down:.1f}V{up:.1f}" stroke="{colour}"/>')
            out.append(f'<circle cx="{x + side:.1f}" cy="{y:.1f}" r="4" fill="{colour}"/>')
    return out


def _legend(y: float, names: dict[str, str]) -> list[str]:
    out = []
    for k, (name, colour) in enumerate(names.items()):
        mark = f'<path d="M{60 + 200 * k},{y - 4}h24" stroke="{colour}" stroke-width="2"'
        out.append(mark + (' stroke-dasharray="6 4"/>' if name == "theory" else "/>"))
        out.append(_text(92 + 200 * k, y, name, "start"))
    return out


def strip_figure(path: Path, campaigns: Sequence[Assessed], catalogue: Sequence[str]) -> None:
    """Write every campaign with one effect as a dot at its signal-to-noise, a row per cause."""
    strongest = max((single.hidden[0].strength for single in _singles(campaigns)), default=0.0)
    names = [cause for cause in catalogue if cause not in UNSIZED]
    low, high, width = np.log(2.3), np.log(max(27.0, 1.05 * strongest)), 560
    ticks = [tick for tick in (3, 4, 5, 6, 8, 10, 14, 20, 30, 60, 120, 240) if np.log(tick) < high]

    def x(strength: float) -> float:
        return float(230 + width * (np.log(strength) - low) / (high - low))

    bottom = 30 + 26 * len(names)
    out = [f'<path d="M{x(s):.1f},20V{bottom}" stroke="#ddd"/>' for s in ticks]
    out += [_text(x(s), bottom + 16, f"{s:g}") for s in ticks]
    for row, cause in enumerate(names):
        y = 36 + 26 * row
        own = [single for single in _singles(campaigns) if single.hidden[0].cause == cause]
        out.append(_text(220, y + 4, cause, "end"))
        clear = x(rates.clear_from(cause))
        out.append(f'<path d="M{clear:.1f},{y - 11}v22" stroke="#000"/>')
        for k, one in enumerate(sorted(own, key=lambda one: one.hidden[0].strength)):
            outcome = "missed" if not one.found else "named" if not one.missed else "found"
            place = f'cx="{x(one.hidden[0].strength):.1f}" cy="{y + (-5, 0, 5)[k % 3]}"'
            out.append(f'<circle {place} r="3.2" fill="{COLOURS[outcome]}" fill-opacity="0.75"/>')
    words = {"named": COLOURS["named"], "found under another name": COLOURS["found"], "not found": COLOURS["missed"]}
    path.write_text(_svg(810, bottom + 50, [*out, *_legend(bottom + 42, words)]), encoding="utf-8")


def confusion_figure(path: Path, rows: Sequence[str], columns: Sequence[str], counts: NDArray) -> None:
    """Draw the number of campaigns by hidden (rows) and reported (columns) cause."""
    size, left, top = 34, 220, 200
    out = []
    for j, name in enumerate(columns):
        x = left + size * (j + 0.62)
        out.append(_text(x, top - 8, name, "start", f'transform="rotate(-60 {x:.1f} {top - 8})"'))
    for i, name in enumerate(rows):
        out.append(_text(left - 8, top + size * (i + 0.62), name, "end"))
        for j, count in enumerate(counts[i]):
            share = count / max(counts[i].sum(), 1)
            colour = f"rgb({255 - 255 * share:.0f},{255 - 141 * share:.0f},{255 - 77 * share:.0f})"
            place = f'x="{left + size * j}" y="{top + size * i}" width="{size}" height="{size}"'
            out.append(f'<rect {place} fill="{colour}" stroke="#ccc"/>')
            if count:
                ink = f'fill="{"white" if share > 0.5 else "black"}"'
                out.append(_text(left + size * (j + 0.5), top + size * (i + 0.62), f"{count:.0f}", more=ink))
    path.write_text(_svg(left + size * len(columns) + 130, top + size * len(rows) + 20, out), encoding="utf-8")
