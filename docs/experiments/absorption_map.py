"""Which parameters of the telescope swallow what its model leaves out, before any fit: numbers and figure of a page."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from docs.experiments.heat_map import HeatMap, write_heat_map
from docs.experiments.sample_telescope import LEGS, NOISE_M, SIX, closings, nominal, problem, scales, tolerances
from docs.experiments.telescope_report_data import published
from truing.estimation.design.absorption import Absorption, absorb
from truing.simulation.beam_model import BeamModel
from truing.simulation.calibration_problem import CalibrationProblem


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
    """What the report's parameters of each leg do with the closings that they are not made for."""
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
