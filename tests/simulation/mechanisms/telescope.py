"""The telescope of the reference values, in SI, and random variations of it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from truing.simulation.catalogue import catalogue
from truing.simulation.mechanisms.legs.closures import Legs, mechanism
from truing.simulation.mechanisms.model import MechanismModel, PriorKnowledge
from truing.simulation.mechanisms.recording import Conditions
from truing.simulation.targets import BASE, LEG, PLATFORM, Targets, shape_unknowns

REFERENCE: dict[str, Any] = json.loads((Path(__file__).parent / "telescope_vectors.json").read_text(encoding="utf-8"))
_NOMINAL = REFERENCE["nominal"]
KAPPA, K = float(_NOMINAL["kappa"]), np.array(_NOMINAL["K"])
LINEAR, MATRIX = (catalogue()[f"platform-deformation-{kind}"] for kind in ("linear", "matrix"))
SURVEY_M = 5e-6
GEOMETRY = {"a": 5e-4, "b": 5e-4, "u": 2e-3, "l": 5e-4}  # one sigma, m and rad


def telescope(kind: str = "6-pus") -> Legs:
    """The nominal telescope, or a hexapod of the same joints whose legs have the same length at mid range."""
    a, b, l, rho0 = (np.array(_NOMINAL[name]) * 1e-3 for name in ("a", "b", "l", "rho0"))  # noqa: E741
    return mechanism(kind, a, b, _NOMINAL["u"], l, rho0)


def vector(name: str) -> tuple[dict[str, Any], dict[str, Any]]:
    """Inputs and outputs of a reference vector."""
    found = REFERENCE["vectors"][name]
    return found["inputs"], found["outputs"]


def readings(rng: np.random.Generator, poses: int, reach_m: float = 1.3e-3) -> NDArray:
    """Readings (poses, 6) within reach of the reference, m."""
    return telescope().rho0 + rng.uniform(-reach_m, reach_m, (poses, 6))


def sample_targets(per_body: int = 5, per_leg: int = 3) -> Targets:
    """Targets on base, platform, every attachment and every leg."""
    body = [BASE] * per_body + [PLATFORM] * (per_body + 6) + [LEG] * (6 * per_leg)
    leg = [-1] * (2 * per_body) + list(range(6)) + [i for i in range(6) for _ in range(per_leg)]
    return Targets(np.array(body), np.array(leg))


def sample_model(
    rng: np.random.Generator, poses: int, causes: tuple[Any, ...] = (), kind: str = "6-pus"
) -> MechanismModel:
    """A model over all kinds of targets, surveyed with anisotropic noise, at random readings."""
    targets = sample_targets()
    count = len(targets.body)
    shape = rng.normal(0.0, 0.1, (count, 3))
    shape[targets.at_attachment] = telescope().b
    square = rng.normal(size=(count, 3, 3))
    covariance = (square @ np.swapaxes(square, 1, 2) + np.eye(3)) * SURVEY_M**2
    survey = shape_unknowns(targets, shape, covariance)
    seats = np.linalg.qr(rng.normal(size=(6, 3, 3)))[0]
    seats = seats * np.sign(np.linalg.det(seats))[:, None, None]
    geometry = {name: sigma for name, sigma in GEOMETRY.items() if kind == "6-pus" or name != "u"}
    known = PriorKnowledge(geometry, shape, survey, 1e-6, np.arange(6), seats, rng.normal(0.0, 0.05, (6, 3)))
    time = np.linspace(0.0, 3600.0, poses)
    conditions = Conditions(readings(rng, poses), {"time_s": time})
    return MechanismModel(targets, conditions, telescope(kind), known, causes=causes)
