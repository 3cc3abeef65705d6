"""Air with a constant index gradient: corrected points agree with an adjustment of bent rays."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from tests.blind.generator.schedule import random_moves
from tests.photographs.as_network import network_of
from tests.photographs.hidden import AirGradient, CameraEffect
from tests.photographs.rays import BARS, Bar, Shooting, draw_rays
from tests.photographs.stations import Round
from truing.estimation.bundle.adjustment import adjust
from truing.simulation.mechanisms.state import State
from truing.simulation.photographs.causes.refraction import EvenAir

MOVES = random_moves(2, 0, np.random.default_rng(3))
GRADIENT_PER_M = 2e-5


def raised(bar: Bar, by_mm: float) -> Bar:
    (x, y, z), (u, v, w) = bar.ends_mm
    return replace(bar, ends_mm=((x, y, z + by_mm), (u, v, w + by_mm)), sigma_mm=0.0)


def adjusted(bars: tuple[Bar, ...], *effects: CameraEffect) -> np.ndarray:
    """Points (poses, points, 3), m, in the base frame or next to it."""
    shooting = Shooting(
        stations=Round(count=6), missing_share=0.0, gross_share=0.0, sigma_px=1e-12, stated_sigma_px=0.02, bars=bars
    )
    network, start = network_of(draw_rays(shooting, MOVES, [], effects, np.random.default_rng(5)))
    return adjust(network, start).state.points.reshape(len(MOVES), -1, 3)


def beside_a_motion(moved: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Shifts (K, 3) of points without the motion that they have as a whole."""
    arms = points - points.mean(0)
    columns = [np.broadcast_to(axis, arms.shape).ravel() for axis in np.eye(3)]
    columns += [np.cross(axis, arms).ravel() for axis in np.eye(3)]
    basis = np.stack(columns, 1)
    return moved - (basis @ np.linalg.lstsq(basis, moved.ravel(), rcond=None)[0]).reshape(moved.shape)


@pytest.mark.parametrize("by_mm", [0.0, 600.0])
def test_points_are_moved_as_an_adjustment_of_bent_rays_moves_them(by_mm: float) -> None:
    bars = tuple(raised(bar, by_mm) for bar in BARS)
    plain, bent = adjusted(bars), adjusted(bars, AirGradient(per_m=GRADIENT_PER_M))
    height = 1e-3 * float(np.mean([end[2] for bar in bars for end in bar.ends_mm]))
    state = cast(State, SimpleNamespace(points=plain))
    expected = EvenAir(height).change(state, np.zeros(1)).fields["points"][..., 0] * GRADIENT_PER_M
    for pose, points in enumerate(plain):
        found, due = (beside_a_motion(way[pose], points) for way in (bent - plain, expected))
        assert np.abs(due).max() > 1e-6
        assert np.abs(found - due).max() < 0.05 * np.abs(due).max()
