"""Causes: scale bars whose thermal expansion exceeds the stated one; of one bar, or of all."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truing.simulation.cause import Parameter, Step
from truing.simulation.change import Change
from truing.simulation.inputs import TEMPERATURE
from truing.simulation.mechanisms.point_causes import PointCause, PointScene
from truing.simulation.mechanisms.state import State
from truing.simulation.photographs.causes.ray_causes import RayCause, RayScene, at_numbers
from truing.simulation.photographs.ray_poses import BAR, RayPoses

# Expansion per kelvin: steel 12e-6, carbon fibre nearly 0.
_PLAUSIBLE = 1e-5
_ONE_ALONE = 2  # least number of bars to distinguish one from the others
ID = "scale-bar-temperature"


def _parameters() -> tuple[Parameter, ...]:
    return (Parameter("alpha", "1/K", _PLAUSIBLE),)


@dataclass(frozen=True)
class OneBar(RayCause):
    """A bar expands by alpha times the temperature above the reference, beyond the stated expansion; observable with
    two bars."""

    bar: str = ""

    id = ID
    has_known_scale = True

    @property
    def subject(self) -> str:
        """Scale bar concerned."""
        return f"{BAR} {self.bar}"

    def candidates(self, scene: RayScene) -> Sequence[OneBar]:
        """Return every bar, if there are at least two and the temperature varies."""
        rays = scene.rays
        bars = rays.owners(BAR)
        return [OneBar(bar) for bar in bars] if len(bars) >= _ONE_ALONE and rays.varies(TEMPERATURE) else []

    def needs(self, legs: int) -> tuple[str, ...]:
        """Return no column: a bar does not move the machine."""
        return ()

    def parameters(self, legs: int) -> tuple[Parameter, ...]:
        """Return alpha, beyond the stated expansion."""
        return _parameters()

    def slopes(self, rays: RayPoses, values: NDArray) -> NDArray:
        """Return d strain / d alpha: the temperature above the reference."""
        return at_numbers(rays, rays.places(BAR, self.bar, ("strain",)), rays.temperature_rise)


@dataclass(frozen=True)
class AllBars(PointCause):
    """All scale bars expand equally: all points of a pose shrink by alpha times the temperature above the reference."""

    id = ID
    has_known_scale = True
    step = Step.INSTRUMENT
    reads = frozenset()

    def candidates(self, scene: PointScene) -> Sequence[AllBars]:
        """Return the cause if bars give the scale and the temperature varies."""
        return (self,) if scene.photographed and scene.photographed.scale_bars and scene.varies(TEMPERATURE) else ()

    def needs(self, legs: int) -> tuple[str, ...]:
        """Return no column: the scale of an instrument does not move the platform."""
        return ()

    def parameters(self, legs: int) -> tuple[Parameter, ...]:
        """Return alpha, beyond the stated expansion."""
        return _parameters()

    def change(self, state: State, values: NDArray) -> Change:
        """Return d point / d alpha: a bar longer than assumed makes all other lengths look shorter."""
        return Change({"points": -state.points[..., None] * state.temperature_rise[:, None, None, None]}, 1)

    def recorded(self, points: NDArray, state: State, values: NDArray) -> NDArray:
        """Return points, or their motions, (B, K, 3, ...), as measured with such bars."""
        factor = 1.0 - state.temperature_rise * values[0]
        return np.asarray(points * factor.reshape(-1, *([1] * (points.ndim - 1))))
