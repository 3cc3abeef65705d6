"""Camera stations around an object: place and attitude."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tests.blind.generator.quaternions import Array, compose, from_vector, unit
from tests.photographs.lens import View


@dataclass(frozen=True)
class Round:
    """Stations round a vertical axis in two heights alternately: how many, how far from the middle of what is looked
    at (mm), at which elevations (deg), turned by quarters about the camera's axis, and unsteady by these amounts.
    """

    count: int = 10
    distance_mm: float = 1500.0
    elevation_deg: tuple[float, ...] = (42.0, 51.0)
    middle_mm: tuple[float, float, float] = (0.0, 0.0, 220.0)
    quarters: tuple[int, ...] = (0, 1, 0, 3, 2)
    unsteady_mm: float = 25.0
    unsteady_rad: float = 0.02


def stand_round(plan: Round, rng: np.random.Generator) -> View:
    """One round (S,) of stations, each with its own small errors of a photographer's hand."""
    azimuth = 2 * np.pi * (np.arange(plan.count) + rng.uniform(-0.15, 0.15, plan.count)) / plan.count
    elevation = np.deg2rad(np.resize(plan.elevation_deg, plan.count))
    away = np.stack([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)], -1)
    middle = np.array(plan.middle_mm)
    centre = middle + plan.distance_mm * away + rng.normal(0.0, plan.unsteady_mm, (plan.count, 3))
    aim = middle + rng.normal(0.0, plan.unsteady_mm, (plan.count, 3))
    roll = np.pi / 2 * np.resize(plan.quarters, plan.count) + rng.normal(0.0, plan.unsteady_rad, plan.count)
    return View(looking(centre, aim, roll), centre)


def looking(centre: Array, aim: Array, roll: Array) -> Array:
    """Turns (S, 4) from the scene into axes of cameras at ``centre`` that look at ``aim``, upright but for ``roll``."""
    forward = unit(aim - centre)
    right = unit(np.cross(forward, np.array([0.0, 0.0, 1.0])))
    axes = np.stack([right, np.cross(forward, right), forward], axis=-2)
    spin = np.zeros((len(centre), 3))
    spin[:, 2] = roll
    return compose(from_vector(spin), from_matrix(axes))


def from_matrix(axes: Array) -> Array:
    """The quaternion (..., 4) that turns as the rows of ``axes`` (..., 3, 3) say; from the largest of its squares."""
    m = axes
    trace = np.trace(m, axis1=-2, axis2=-1)
    diagonal = np.diagonal(m, axis1=-2, axis2=-1)
    square = np.concatenate([(1 + trace)[..., None], 1 - trace[..., None] + 2 * diagonal], axis=-1)
    # Row k of four times the outer product of the quaternion with itself.
    x, y, z = m[..., 2, 1] - m[..., 1, 2], m[..., 0, 2] - m[..., 2, 0], m[..., 1, 0] - m[..., 0, 1]
    xy, xz, yz = m[..., 0, 1] + m[..., 1, 0], m[..., 0, 2] + m[..., 2, 0], m[..., 1, 2] + m[..., 2, 1]
    rows = [
        np.stack(row, axis=-1)
        for row in (
            (square[..., 0], x, y, z),
            (x, square[..., 1], xy, xz),
            (y, xy, square[..., 2], yz),
            (z, xz, yz, square[..., 3]),
        )
    ]
    largest = np.argmax(square, axis=-1)
    return unit(np.take_along_axis(np.stack(rows, axis=-2), largest[..., None, None], axis=-2)[..., 0, :])
