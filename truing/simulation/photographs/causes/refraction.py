"""Causes: bent rays, by air whose refractive index changes with height, or by a pane of glass in front of a camera.

An index that changes linearly with height bends all rays to circles. Rays of a network still meet in points, and no
image shows an error: n = 1 + g . x is a conformally flat metric without curvature, to first order. But points are found
at x + (g . x) x - x^2 g / 2, which only a survey of the bodies can show. The rays show a nonlinear change of the index.
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
# Unit ppm. A temperature gradient of 1 K per metre of height lowers the index by 0.93e-6 per metre.
_PPM = 1e-6
CURVATURES = ("xx", "yy", "zz", "xy", "xz", "yz")  # second derivatives of the index along the axes of a measurement
_PLAUSIBLE_GRADIENT, _PLAUSIBLE_CURVATURE = 2.0 * _PPM, 2.0 * _PPM
_PLAUSIBLE_PANE = 3e-3
_SHARE_OF_AIR, _SHARE_OF_PANES = 0.5, 0.5


@dataclass(frozen=True)
class Refraction(RayCause):
    """Rays are bent: of all cameras by air (no ``camera``), or of one by a pane of glass in front of it.

    The index of air changes with the square of the height, by curvature / 2: a layer of warm or cold air. A pane of
    index 1.52 across the axis of a camera shifts rays by an amount that grows with their angle.
    """

    camera: str = ""

    id = ID
    reach = 100.0

    @property
    def subject(self) -> str:
        """Camera behind a pane; empty for air."""
        return f"camera {self.camera}" if self.camera else ""

    def candidates(self, scene: RayScene) -> Sequence[Refraction]:
        """Return air and panes, if rays can show them."""
        rays = scene.rays
        air = rays.owners(AIR) if rays.up is not None else ()
        return [Refraction(owner) for owner in (*air, *rays.owners(WINDOW))]

    def prior(self, scene: RayScene) -> float:
        """Return the share of air, or of panes, equal for all cameras."""
        return _SHARE_OF_PANES / max(len(scene.rays.owners(WINDOW)), 1) if self.camera else _SHARE_OF_AIR

    def needs(self, legs: int) -> tuple[str, ...]:
        """Return no column: refraction does not move the machine."""
        return ()

    def parameters(self, legs: int) -> tuple[Parameter, ...]:
        """Return the thickness of the pane, or the second derivative of the index by the height."""
        if self.camera:
            return (Parameter("thickness", "mm", _PLAUSIBLE_PANE, 1e-3),)
        return (Parameter("curvature", "ppm/m^2", _PLAUSIBLE_CURVATURE, _PPM),)

    def one_sided(self, legs: int) -> tuple[int, ...]:
        """Return the thickness: it cannot be negative."""
        return (0,) if self.camera else ()

    def slopes(self, rays: RayPoses, values: NDArray) -> NDArray:
        """Return the derivative of the ray parameters: one for a pane; for air, the second derivative of the index
        along the vertical in the axes of each pose's measurement."""
        if self.camera:
            return at_numbers(rays, rays.places(WINDOW, self.camera, ("thickness",)), np.ones(len(rays.poses)))
        assert rays.up is not None
        derivative = np.zeros((len(rays.poses), len(rays.parameters), 1))
        for name in CURVATURES:
            first, second = (rays.up[:, "xyz".index(axis)] for axis in name)
            derivative[:, rays.places(AIR, "", (name,)), 0] = (first * second)[:, None]
        return derivative


@dataclass(frozen=True)
class EvenAir(PointCause):
    """The index of air changes linearly with height, by gradient: points are displaced without contradiction between
    rays.

    Lengths are correct at the height of the scale bars; points above or below are scaled.
    """

    scale_height_m: float = 0.0

    id = ID
    step = Step.INSTRUMENT
    reads = frozenset()
    reach = 30.0

    def candidates(self, scene: PointScene) -> Sequence[EvenAir]:
        """Return the cause if points come from photographs."""
        return (EvenAir(scene.photographed.scale_height_m),) if scene.photographed else ()

    def needs(self, legs: int) -> tuple[str, ...]:
        """Return no column: refraction does not move the platform."""
        return ()

    def parameters(self, legs: int) -> tuple[Parameter, ...]:
        """Return the derivative of the index by the height."""
        return (Parameter("gradient", "ppm/m", _PLAUSIBLE_GRADIENT, _PPM),)

    def change(self, state: State, values: NDArray) -> Change:
        """Return d point / d gradient = z x - x^2 e_z / 2, with x relative to the height of the bars.

        The horizontal origin of x is arbitrary: another one adds only a motion of the whole.
        """
        return Change({"points": _ray_displacement(state.points, self.scale_height_m)[..., None]}, 1)


def _ray_displacement(points: NDArray, scale_height_m: float) -> NDArray:
    """Return the displacement (B, K, 3) of points (B, K, 3) per gradient."""
    arms = points - points.mean(1, keepdims=True)
    arms[..., 2] = points[..., 2] - scale_height_m
    displacement = arms[..., 2:] * arms
    displacement[..., 2] -= 0.5 * np.sum(arms**2, -1)
    return np.asarray(displacement)
