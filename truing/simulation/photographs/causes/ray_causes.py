"""What causes share that act on rays: numbers that all poses should share differ from pose to pose."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truing.simulation.cause import Cause, ChannelScene, Step
from truing.simulation.photographs.ray_poses import RayPoses

# Poses on either side of what begins at one, and per function of a form that nobody declared.
FEWEST = 3


@dataclass(frozen=True)
class RayScene(ChannelScene["RayCause"]):
    """What the photographs of a campaign offer to causes: what their rays tell, pose by pose."""

    rays: RayPoses

    @property
    def covariates(self) -> Mapping[str, NDArray]:
        """The columns that are known of each pose, (B,)."""
        return self.rays.covariates

    @property
    def size(self) -> tuple[int, int]:
        """The number of poses B and of channels K."""
        return len(self.rays.poses), len(self.rays.channels)


class RayCause(Cause[RayScene]):
    """A cause that moves the numbers which rays tell of, pose by pose."""

    step = Step.INSTRUMENT

    def slopes(self, rays: RayPoses, values: NDArray) -> NDArray:
        """Return the derivative (B, T, P) of the numbers by the parameters at values (P,), SI."""
        raise NotImplementedError

    def moved(self, rays: RayPoses, values: NDArray) -> NDArray:
        """Return by how much the numbers (B, T) are off at values (P,); where that is linear, slopes times values."""
        return np.asarray(self.slopes(rays, values) @ values)


def at_numbers(rays: RayPoses, places: list[int], course: NDArray) -> NDArray:
    """Return slopes (B, T, n) of n numbers that each follow a course (B,) with an amplitude of their own."""
    found = np.zeros((len(course), len(rays.parameters), len(places)))
    found[:, places, np.arange(len(places))] = course[:, None]
    return found
