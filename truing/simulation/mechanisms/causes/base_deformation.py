"""The base deforms: targets and joints shift along its z, as a saddle or a bowl, with temperature or an actuator."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truing.simulation.cause import Cause, Parameter, Scene, Step, Told
from truing.simulation.change import Change
from truing.simulation.mechanisms.state import State

TEMPERATURE = "temperature"
_COLUMN = "temperature_c"
_READING = "rho"
# Shift at the joints' radius: m per K, and m per m of an actuator's way.
_PLAUSIBLE_PER_KELVIN, _PLAUSIBLE_PER_WAY = 5e-6, 0.01
_SHAPES = ("saddle_x", "saddle_y", "bowl")


@dataclass(frozen=True)
class BaseDeformation(Cause):
    """Base targets and joints shift along z by q (saddle_x (x^2 - y^2) + saddle_y 2 x y + bowl (x^2 + y^2)) / R^2.

    R is the mean radius of the joints; q is the temperature above the reference, or the displacement of the actuator
    that ``driver`` names (``rho1`` ..).
    """

    driver: str = TEMPERATURE

    id = "base-deformation"
    step = Step.STRUCTURE
    reads = frozenset({"rho", "a", "shape"})

    def candidates(self, scene: Scene) -> Sequence[Cause]:
        """Return the temperature, where it varies, and every actuator that moves as drivers."""
        moves = np.ptp(scene.readings, axis=0) > 0
        drivers = [f"{_READING}{leg}" for leg in range(1, scene.legs + 1) if moves[leg - 1]]
        warm = scene.varies(_COLUMN) and bool(np.isfinite(scene.covariates[_COLUMN]).all())
        return [BaseDeformation(driver) for driver in ([TEMPERATURE] if warm else []) + drivers]

    def prior(self, scene: Scene) -> float:
        """Return the share of this driver: temperature is as likely as all actuators together."""
        return 0.5 if self.driver == TEMPERATURE else 0.5 / scene.legs

    def needs(self, legs: int) -> tuple[str, ...]:
        """Return the temperature, where that drives it."""
        return (_COLUMN,) if self.driver == TEMPERATURE else ()

    def parameters(self, legs: int) -> tuple[Parameter, ...]:
        """Return saddle_x, saddle_y and bowl: the shift at the radius R, per unit of the driver."""
        warm = self.driver == TEMPERATURE
        unit, scale, si = ("mm/K", _PLAUSIBLE_PER_KELVIN, 1e-3) if warm else ("mm/mm", _PLAUSIBLE_PER_WAY, 1.0)
        return tuple(Parameter(name, unit, scale, si) for name in _SHAPES)

    def told(self, values: NDArray, covariance: NDArray, legs: int) -> tuple[Told, ...]:
        """Return the driver, then the sizes of the three shapes."""
        return (Told("driver", self.driver, None, ""), *super().told(values, covariance, legs))

    def change(self, state: State, values: NDArray) -> Change:
        """Return the shift of joints and base targets along z per size of each shape."""
        across = state.legs.a[..., :2]
        radius = np.mean(np.sqrt(np.sum(across * across, -1)), -1)[..., None]
        q = self._driven(state)[:, None, None]
        fields = {"a": _along_z(q * _shapes(across / radius[..., None]))}
        if state.targets is not None and len(state.shape):
            on_base = (state.targets.body == 0)[:, None]
            places = state.shape[:, :2] / radius[..., None]
            fields["moved"] = _along_z(q * _shapes(places) * on_base)
        return Change(fields, len(_SHAPES))

    def _driven(self, state: State) -> NDArray:
        if self.driver == TEMPERATURE:
            return state.heat
        return state.delta_rho[:, int(self.driver.removeprefix(_READING)) - 1]


def _shapes(place: NDArray) -> NDArray:
    """Return saddle_x, saddle_y and bowl (..., 3) at places (..., 2) in units of the joints' radius."""
    x, y = place[..., 0], place[..., 1]
    return np.stack([x * x - y * y, 2 * x * y, x * x + y * y], -1)


def _along_z(heights: NDArray) -> NDArray:
    """Return heights (..., P) as vectors along z (..., 3, P)."""
    return heights[..., None, :] * np.array([0.0, 0.0, 1.0])[:, None]
