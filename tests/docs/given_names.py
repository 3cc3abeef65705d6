"""Data that code blocks of the pages assume as the reader's own: one function per page."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tests.simulation.mechanisms.telescope import readings, telescope
from truing.estimation.rotation import exp_so3
from truing.estimation.sensor.calibrated_sensor import calibrated_sensor, sensor_text
from truing.estimation.sensor.contenders import hold_out
from truing.simulation.mechanisms.legs.kinematics import inverse
from truing.simulation.mechanisms.state import State

Names = dict[str, Any]
HEIGHT = np.array([0.0, 0.0, 0.5])


def _cloud(rng: np.random.Generator, points: int) -> NDArray:
    return rng.uniform(-0.1, 0.1, (points, 3))


def _in_python(names: Names) -> Names:
    rng = np.random.default_rng(1)
    survey, hexapod = _cloud(rng, 8), telescope("ups")
    p, R = rng.uniform(-5e-3, 5e-3, (24, 3)) + HEIGHT, exp_so3(rng.uniform(-0.03, 0.03, (24, 3)))
    return {
        "survey_points": survey,
        "measured_points": survey @ exp_so3(np.array([0.1, -0.2, 0.3])).T + rng.normal(0.0, 5e-6, (8, 3)),
        "a": hexapod.a,
        "b": hexapod.b,
        "length": hexapod.l,
        "rho0": hexapod.rho0,
        "p": p,
        "R": R,
        "rho": inverse(hexapod, p, R),
        "covariance": np.broadcast_to(np.eye(12) * 1e-6**2, (24, 12, 12)),
    }


def _poses(names: Names) -> Names:
    rng = np.random.default_rng(2)
    survey = _cloud(rng, 6)
    return {
        "survey": survey,
        "points": survey + rng.normal(0.0, 5e-6, (9, 6, 3)),
        "cov_survey": np.broadcast_to(np.eye(3) * 5e-6**2, (6, 3, 3)),
        "cov_points": np.broadcast_to(np.eye(3) * 5e-6**2, (9, 6, 3, 3)),
        "is_observed": np.ones((9, 6), bool),
    }


def _sensor_calibration(names: Names) -> Names:
    rng = np.random.default_rng(3)
    loads = rng.uniform(-1e3, 1e3, (60, 6))
    signal_cov, load_cov = np.eye(6) * 0.01**2, np.eye(6) * 0.5**2
    signals = loads @ rng.normal(0.0, 1e-3, (6, 6)) + rng.normal(0.0, 0.01, (60, 6))
    return {
        "signals": signals,
        "loads": loads,
        "run": np.repeat(np.arange(12), 5),
        "signal_cov": signal_cov,
        "load_cov": load_cov,
        "new_signals": signals[:4],
        "new_covariates": np.zeros((4, 0)),
        "run_folder": _run_of_a_sensor(names),
        "signals_mv": signals[0],
    }


def _run_of_a_sensor(names: Names) -> Path:
    """The run at hand, with the page's own calibration once it was made."""
    folder = Path("runs/telescope")
    if "bench" in names:
        held = hold_out(names["bench"], names["fit"].model)
        text = sensor_text(calibrated_sensor(held, names["bench"], 20.0, is_tared=False), {})
        (folder / "sensor.toml").write_text(text, encoding="utf-8")
    return folder


def _unlabelled(names: Names) -> Names:
    rng = np.random.default_rng(4)
    base, platform = _cloud(rng, 7), _cloud(rng, 6)
    return {"base_survey_m": base, "platform_survey_m": platform, "points_m": np.concatenate([base, platform + 0.3])}


def _own_cause(names: Names) -> Names:
    rho = readings(np.random.default_rng(5), 4)
    damp = {"humidity_pct": np.array([30.0, 45.0, 60.0, 75.0])}
    state = State(telescope(), rho, np.zeros_like(rho), covariates=damp)
    return {"cause": names["LegSwelling"](), "state": state, "values": np.array([1e-6]), "j": 0}


def _own_mechanism(names: Names) -> Names:
    legs = telescope("ups")
    upper = legs.b + HEIGHT
    return {"closure": names["OffsetLeg"](), "legs": legs, "upper": upper, "rho": np.zeros(6), "axis": 2}


GIVEN: dict[str, Callable[[Names], Names]] = {
    "docs/in-python.md": _in_python,
    "docs/own-cause.md": _own_cause,
    "docs/own-mechanism.md": _own_mechanism,
    "docs/poses.md": _poses,
    "docs/sensor-calibration.md": _sensor_calibration,
    "docs/unlabelled.md": _unlabelled,
}
