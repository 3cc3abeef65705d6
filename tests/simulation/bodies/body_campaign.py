"""A small model of two bodies without a mechanism: a freely moving tool, and a base at rest."""

from __future__ import annotations

import numpy as np

from truing.estimation.rotation import exp_so3
from truing.simulation.bodies.model import FIRST_BODY, BodyConditions, BodyModel, KnownBodies
from truing.simulation.cause import Cause
from truing.simulation.targets import Targets, shape_unknowns

TOOL, BASE = ("T1", "T2", "T3", "T4"), ("B1", "B2", "B3")


def body_model(
    rng: np.random.Generator, poses: int, causes: tuple[Cause, ...] = (), still: bool = True, levels: int = 1
) -> BodyModel:
    """Tool and base over some poses, with time, temperature and a drive; the base leads where it is not still."""
    shape = np.concatenate([rng.normal(size=(4, 3)) * 0.1, rng.normal(size=(3, 3)) * 0.3])
    targets = Targets(
        np.repeat([FIRST_BODY, FIRST_BODY + 1], [4, 3]), np.full(7, -1), (*TOOL, *BASE), ("tool",) * 4 + ("base",) * 3
    )
    cov = np.broadcast_to(np.eye(3) * 1e-10, (7, 3, 3))
    jitter = np.tile(np.diag([1e-5] * 3 + [2e-5] * 3), (2, 1, 1))
    known = KnownBodies(
        shape,
        shape_unknowns(targets, shape, cov),
        np.array([True] * 6 + [False] * 3),
        np.array([0, levels if still else 0]),
        jitter,
        -1 if still else 1,
        ("elevation_deg",),
    )
    return BodyModel(targets, _conditions(rng, poses, still, levels), known, causes=causes)


def _conditions(rng: np.random.Generator, poses: int, still: bool, levels: int) -> BodyConditions:
    R = np.stack([exp_so3(rng.normal(size=(poses, 3))), np.tile(np.eye(3), (poses, 1, 1))], 1)
    t = np.stack([rng.normal(size=(poses, 3)), np.zeros((poses, 3))], 1)
    level = np.stack([np.zeros(poses, int), np.arange(poses) % levels], 1)
    if still:
        place = exp_so3(rng.normal(size=(levels, 3))), rng.normal(size=(levels, 3))
        R[:, 1], t[:, 1] = place[0][level[:, 1]], place[1][level[:, 1]]
    covariates = {
        "order": np.arange(poses, dtype=float),
        "time_s": 60.0 * np.arange(poses),
        "temperature_c": 20.0 + rng.normal(size=poses),
        "elevation_deg": 40.0 + 10.0 * (np.arange(poses) % max(levels, 3)),
        "approach elevation_deg": np.where(np.arange(poses) < poses / 2, 1.0, -1.0),
    }
    span = 0.0, 60.0 * (poses - 1)
    return BodyConditions(np.zeros((poses, 0)), covariates, tuple(range(poses)), span, R, t, level)
