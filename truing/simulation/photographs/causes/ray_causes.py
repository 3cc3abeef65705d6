"""Base class `RayCause` of causes that act on rays, and their scene `RayScene`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truing.simulation.cause import Cause, ChannelScene, Step
from truing.simulation.photographs.ray_poses import RayPoses

# Least number of poses on either side of an onset.
FEWEST_POSES = 3


@dataclass(frozen=True)
class RayScene(ChannelScene["RayCause"]):
    """Scene of causes that act on rays: camera, bar and air parameters as seen by the rays of each pose."""

    rays: RayPoses

    @property
    def covariates(self) -> Mapping[str, NDArray]:
        """Columns (B,) known at each pose."""
        return self.rays.covariates

    @property
    def size(self) -> tuple[int, int]:
        """Number of poses B and of channels K."""
        return len(self.rays.poses), len(self.rays.channels)


class RayCause(Cause[RayScene]):
    """Base class of causes that change parameters of cameras, scale bars or air from pose to pose."""

    step = Step.INSTRUMENT

    def slopes(self, rays: RayPoses, values: NDArray) -> NDArray:
        """Return the derivative (B, T, P) of the T ray parameters by the cause's parameters at values (P,), SI."""
        raise NotImplementedError

    def moved(self, rays: RayPoses, values: NDArray) -> NDArray:
        """Return the errors (B, T) of the ray parameters at values (P,); for a linear cause, slopes times values."""
        return np.asarray(self.slopes(rays, values) @ values)


def at_numbers(rays: RayPoses, indices: list[int], course: NDArray) -> NDArray:
    """Return slopes (B, T, n) of n ray parameters with a common course (B,) and separate amplitudes."""
    derivative = np.zeros((len(course), len(rays.parameters), len(indices)))
    derivative[:, indices, np.arange(len(indices))] = course[:, None]
    return derivative
