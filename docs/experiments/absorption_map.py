"""Numbers and figure of the absorption map: bias of the telescope's parameters by effects that its model leaves out."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from html import escape
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from docs.experiments.sample_telescope import LEGS, NOISE_M, SIX, closings, nominal, problem, scales, tolerances
from docs.experiments.telescope_report_data import published
from truing.estimation.design.absorption import Absorption, absorb
from truing.simulation.mechanisms.calibration_problem import CalibrationProblem
from truing.simulation.mechanisms.structures.beam_model import BeamModel

CELL_WIDTH, CELL_HEIGHT, LEFT, TOP, LEGEND = 118, 34, 150, 86, 62
LIGHT, DARK = np.array([255, 255, 255]), np.array([0, 68, 136])


@dataclass(frozen=True)
class Effect:
    """Something that is true of the telescope and not of the model: its name, and the poses that it leads to."""

    name: str
    truth: Callable[[], CalibrationProblem]


def _deforming(K: NDArray) -> Callable[[], CalibrationProblem]:
    return lambda: problem(SIX, replace(nominal(), deformation=K))


def _changed(**arrays: NDArray) -> Callable[[], CalibrationProblem]:
    return lambda: problem(SIX, replace(nominal(), legs=nominal().legs.replace(**arrays)))


def _gained(gain: float) -> CalibrationProblem:
    of, legs = problem(SIX), nominal().legs
    return replace(of, rho=legs.rho0 + (of.rho - legs.rho0) / (1.0 + gain))


def effects() -> list[Effect]:
    """The effects of the map, at sizes that a laboratory meets."""
    legs, K = nominal().legs, published().K
    turned = np.broadcast_to([0.0, tolerances()["u"], np.sqrt(1 - tolerances()["u"] ** 2)], (6, 3))
    lifted = legs.a + np.array([0.0, 0.0, tolerances()["a"]])
    return [
        Effect("platform\nfollows K", _deforming(K)),
        Effect("K off its\ndiagonal", _deforming(K - np.diag(np.diag(K)))),
        Effect("flexures of\n10 mm bend", lambda: problem(SIX, nominal(), BeamModel())),
        Effect("actuators\ngo 1e-3 far", lambda: _gained(1e-3)),
        Effect("platform\n10 K warmer", _changed(b=legs.b * (1 + 10 * 12e-6))),
        Effect("a_z off by a\ntolerance", _changed(a=lifted)),
        Effect("u_y off by a\ntolerance", _changed(u=turned)),
    ]


def absorbed_by_leg(of: CalibrationProblem) -> list[Absorption]:
    """Absorption of each omitted effect by the report's parameters, leg by leg."""
    value, slope = closings(of)
    columns = [slice(6 * leg, 6 * leg + 6) for leg in LEGS]
    return [absorb(slope[:, leg, columns[leg]] / NOISE_M, value[:, leg] / NOISE_M, SIX) for leg in LEGS]


@cache
def absorption_map() -> tuple[NDArray, NDArray, NDArray, NDArray]:
    """Root mean squares over legs: shifts (P, E) in the tables' units, closings before and after (E,), um; shares."""
    found = [absorbed_by_leg(effect.truth()) for effect in effects()]
    shift = np.array([[leg.shift[:, 0] for leg in legs] for legs in found])
    left = np.array([[np.sqrt(np.mean(leg.left**2)) for leg in legs] for legs in found]) * NOISE_M * 1e6
    share = np.array([[leg.absorbed[0] for leg in legs] for legs in found])
    whole = left / np.sqrt(1 - share)
    rms = [np.sqrt(np.mean(array**2, axis=1)) for array in (shift, whole, left)]
    return rms[0].T, rms[1], rms[2], 1 - (rms[2] / rms[1]) ** 2


def draw(path: Path) -> None:
    """Draw the absorption map."""
    shift, whole, left, share = absorption_map()
    words = [[_word(value, name) for value in row] for name, row in zip(SIX, shift, strict=True)]
    words += [[_small(v) for v in whole], [_small(v) for v in left], [f"{100 * v:.2f} %" for v in share]]
    colour = [*(shift / scales(SIX)[:, None]).tolist(), *([[np.nan] * len(whole)] * 3)]
    write_heat_map(
        path,
        HeatMap(
            "Who swallows what the model leaves out (rms over the six legs)",
            [*SIX, "closing before the fit", "and after it", "absorbed"],
            [effect.name for effect in effects()],
            words,
            colour,
            (0.01, 100.0),
            "shift, tolerances",
        ),
    )


def _word(value: float, name: str) -> str:
    if value < 1e-4 * scales(SIX)[SIX.index(name)]:
        return "nothing"
    return f"{value:.2g}" if name == "u_x" else f"{value:.2g} mm"


def _small(value: float) -> str:
    return f"{value:.2f} µm" if value < 100 else f"{value:.0f} µm"


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
