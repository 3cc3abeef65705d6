"""Positions of stations and targets from distances, also if the points lie near one plane."""

from __future__ import annotations

import numpy as np
import pytest

from truing.estimation.rotation import exp_so3
from truing.simulation.mechanisms.chains.measured_lines import MeasuredLines, fitted_places

POSES, STATIONS, TARGETS = 40, 3, 3


def _of_links(rng: np.random.Generator, thickness: float) -> tuple[np.ndarray, np.ndarray]:
    """Rotations (B, K, 3, 3) and origins (B, K, 3), m, of a still link with stations, and of one that moves in a plane
    but for a ``thickness``, m, and turns about a normal of the plane and about an axis in it."""
    channels = STATIONS + TARGETS
    turn, tilt = rng.uniform(-2.5, 2.5, (2, POSES))
    upright, level = np.array([0.0, 0.0, 1.0]), np.array([0.0, 1.0, 0.0])
    R = np.tile(np.eye(3), (POSES, channels, 1, 1))
    R[:, STATIONS:] = (exp_so3(turn[:, None] * upright) @ exp_so3(tilt[:, None] * level))[:, None]
    t = np.zeros((POSES, channels, 3))
    t[:, STATIONS:] = np.column_stack(
        [*rng.uniform(-0.8, 0.8, (2, POSES)), 0.4 + thickness * rng.standard_normal(POSES)]
    )[:, None]
    return R, t


@pytest.mark.parametrize("thickness", [0.0, 0.3])
def test_stations_on_either_side_of_their_points_are_found(thickness: float) -> None:
    ends = np.array([[s, STATIONS + k] for s in range(STATIONS) for k in range(TARGETS)])
    is_station = np.arange(STATIONS + TARGETS) < STATIONS
    for seed in range(12):
        rng = np.random.default_rng([seed, int(10 * thickness)])
        R, t = _of_links(rng, thickness)
        places = rng.uniform(-0.12, 0.12, (STATIONS + TARGETS, 3))
        places[is_station] = rng.uniform(-2.5, 2.5, (STATIONS, 3))
        without = MeasuredLines(R, t, ends, np.zeros((POSES, len(ends))), np.ones((POSES, len(ends)), bool))
        lengths = np.linalg.norm(without.apart(places), axis=-1)
        lines = MeasuredLines(R, t, ends, lengths, without.is_observed)
        found = fitted_places(lines, np.zeros_like(places), np.arange(len(places)), is_station)
        np.testing.assert_allclose(lines.errors(found), 0.0, atol=1e-6)
