"""Light that does not go straight: air whose index changes with height, a pane of glass before the camera.

An index that changes evenly with height bends all rays to circles; those of a whole network then meet in points again,
and no image shows anything: n = 1 + g . x is a conformally flat metric without curvature, to first order. What is left
is that points are found at x + (g . x) x - x^2 g / 2, which only a survey of the bodies can show. Rays themselves show
where the index changes unevenly with height.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truing.simulation.cause import Parameter, Step
from truing.simulation.change import Change
from truing.simulation.mechanisms.point_causes import PointCause, PointScene
from truing.simulation.mechanisms.state import State
from truing.simulation.photographs.causes.ray_causes import RayCause, RayScene, at_numbers
from truing.simulation.photographs.ray_poses import AIR, WINDOW, RayPoses

ID = "refraction"
# Air that is warmer by a kelvin per metre of height: its index falls by 0.93e-6; the same per metre again.
_PPM = 1e-6
CURVATURES = ("xx", "yy", "zz", "xy", "xz", "yz")  # of the index, by the axes of a measurement
_PLAUSIBLE_GRADIENT, _PLAUSIBLE_CURVATURE = 2.0 * _PPM, 2.0 * _PPM
_PLAUSIBLE_PANE = 3e-3
_SHARE_OF_AIR, _SHARE_OF_PANES = 0.5, 0.5


@dataclass(frozen=True)
class Refraction(RayCause):
    """Rays are bent, of all cameras by air (no ``camera``), or of one by a pane of glass before it.

    The index of air changes with the square of the height, by curvature / 2: a layer of warm or cold air. A pane of
    index 1.52 across the axis of a camera shifts rays the more the more they lean.
    """

    camera: str = ""

    id = ID
    reach = 100.0

    @property
    def subject(self) -> str:
        """Return the camera that looks through a pane; empty for air."""
        return f"camera {self.camera}" if self.camera else ""

    def candidates(self, scene: RayScene) -> Sequence[Refraction]:
        """Return air and panes, where rays could show them."""
        rays = scene.rays
        air = rays.owners(AIR) if rays.up is not None else ()
        return [Refraction(owner) for owner in (*air, *rays.owners(WINDOW))]

    def prior(self, scene: RayScene) -> float:
        """Return the share of air, and of panes, evenly among cameras."""
        return _SHARE_OF_PANES / max(len(scene.rays.owners(WINDOW)), 1) if self.camera else _SHARE_OF_AIR

    def needs(self, legs: int) -> tuple[str, ...]:
        """Return no column: what bends rays moves no machine."""
        return ()

    def parameters(self, legs: int) -> tuple[Parameter, ...]:
        """Return the thickness of the pane, or the second derivative of the index by the height."""
        if self.camera:
            return (Parameter("thickness", "mm", _PLAUSIBLE_PANE, 1e-3),)
        return (Parameter("curvature", "ppm/m^2", _PLAUSIBLE_CURVATURE, _PPM),)

    def one_sided(self, legs: int) -> tuple[int, ...]:
        """Return the thickness: no pane is thinner than none."""
        return (0,) if self.camera else ()

    def slopes(self, rays: RayPoses, values: NDArray) -> NDArray:
        """Return d number / d parameter: one of a pane; of the index what its second derivative along the vertical is
        in the axes of each pose's measurement."""
        if self.camera:
            return at_numbers(rays, rays.places(WINDOW, self.camera, ("thickness",)), np.ones(len(rays.poses)))
        assert rays.up is not None
        found = np.zeros((len(rays.poses), len(rays.parameters), 1))
        for name in CURVATURES:
            first, second = (rays.up[:, "xyz".index(axis)] for axis in name)
            found[:, rays.places(AIR, "", (name,)), 0] = (first * second)[:, None]
        return found


@dataclass(frozen=True)
class EvenAir(PointCause):
    """The index of air changes evenly with height, by gradient: points are found where no ray contradicts them.

    Lengths are right at the height where scale bars lie; what is above or below is scaled.
    """

    scale_height_m: float = 0.0

    id = ID
    step = Step.INSTRUMENT
    reads = frozenset()
    reach = 30.0

    def candidates(self, scene: PointScene) -> Sequence[EvenAir]:
        """Return the cause where points come from photographs."""
        return (EvenAir(scene.photographed.scale_height_m),) if scene.photographed else ()

    def needs(self, legs: int) -> tuple[str, ...]:
        """Return no column: what bends rays moves no platform."""
        return ()

    def parameters(self, legs: int) -> tuple[Parameter, ...]:
        """Return the derivative of the index by the height."""
        return (Parameter("gradient", "ppm/m", _PLAUSIBLE_GRADIENT, _PPM),)

    def change(self, state: State, values: NDArray) -> Change:
        """Return d point / d gradient = z x - x^2 e_z / 2, x from the height of the bars; from which point there, makes
        but a motion of the whole."""
        return Change({"points": _bent(state.points, self.scale_height_m)[..., None]}, 1)


def _bent(points: NDArray, scale_height_m: float) -> NDArray:
    """Return how far points (B, K, 3) are moved per gradient (B, K, 3)."""
    arms = points - points.mean(1, keepdims=True)
    arms[..., 2] = points[..., 2] - scale_height_m
    found = arms[..., 2:] * arms
    found[..., 2] -= 0.5 * np.sum(arms**2, -1)
    return np.asarray(found)
