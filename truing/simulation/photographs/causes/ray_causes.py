"""What causes share that act on rays: numbers that all poses should share differ from pose to pose."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from truing.simulation.cause import RAYS, Cause, Scene, Step
from truing.simulation.change import Change
from truing.simulation.photographs.ray_poses import RayPoses

# Poses on either side of what begins at one, and per function of a form that nobody declared.
FEWEST = 3


class RayCause(Cause):
    """A cause that moves the numbers which rays tell of, pose by pose."""

    acts_on: ClassVar[str] = RAYS
    step = Step.INSTRUMENT
    reads = frozenset()

    def slopes(self, rays: RayPoses, values: NDArray) -> NDArray:
        """Return the derivative (B, T, P) of the numbers by the parameters at values (P,), SI."""
        raise NotImplementedError

    def moved(self, rays: RayPoses, values: NDArray) -> NDArray:
        """Return by how much the numbers (B, T) are off at values (P,); where that is linear, slopes times values."""
        return np.asarray(self.slopes(rays, values) @ values)

    def change(self, state: Any, values: NDArray) -> Change:
        """Return the derivative of the numbers by the parameters at values (P,)."""
        found = self.slopes(state, values)
        return Change({"numbers": found}, found.shape[-1])


def rays_of(scene: Scene) -> RayPoses:
    """Return the rays of a scene; raises ValueError where it has none."""
    if scene.rays is None:
        raise ValueError("scene: found no rays, expected those of photographs")
    return scene.rays


def at_numbers(rays: RayPoses, places: list[int], course: NDArray) -> NDArray:
    """Return slopes (B, T, n) of n numbers that each follow a course (B,) with an amplitude of their own."""
    found = np.zeros((len(course), len(rays.parameters), len(places)))
    found[:, places, np.arange(len(places))] = course[:, None]
    return found
