"""Cause: a scale error of the instrument, constant or proportional to temperature."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truing.simulation.cause import Parameter, Step
from truing.simulation.change import Change
from truing.simulation.mechanisms.point_causes import PointCause, PointScene
from truing.simulation.mechanisms.state import State

TEMPERATURE = "temperature_c"
CONSTANT, PER_KELVIN, BOTH = "constant", "per kelvin", "both"
_PLAUSIBLE = {CONSTANT: 5e-5, PER_KELVIN: 1e-5}
_SHARE = {CONSTANT: 0.45, PER_KELVIN: 0.45, BOTH: 0.1}


@dataclass(frozen=True)
class MeasurementScale(PointCause):
    """All points of a pose are scaled by 1 + scale + scale_per_k times the temperature above the reference."""

    form: str = CONSTANT

    id = "measurement-scale"
    step = Step.INSTRUMENT
    reads = frozenset()

    def candidates(self, scene: PointScene) -> Sequence[MeasurementScale]:
        """Return the constant factor and, if the temperature varies, a factor proportional to it, and both."""
        forms = (CONSTANT, PER_KELVIN, BOTH) if scene.varies(TEMPERATURE) else (CONSTANT,)
        return [MeasurementScale(form) for form in forms]

    def prior(self, scene: PointScene) -> float:
        """Return the share of this form: one parameter is more probable than two."""
        return _SHARE[self.form]

    def needs(self, legs: int) -> tuple[str, ...]:
        """Return no column: the scale of an instrument does not move the platform."""
        return ()

    def parameters(self, legs: int) -> tuple[Parameter, ...]:
        """Return scale, scale_per_k or both."""
        constant = Parameter("scale", "1", _PLAUSIBLE[CONSTANT])
        per_kelvin = Parameter("scale_per_k", "1/K", _PLAUSIBLE[PER_KELVIN])
        return {CONSTANT: (constant,), PER_KELVIN: (per_kelvin,), BOTH: (constant, per_kelvin)}[self.form]

    def change(self, state: State, values: NDArray) -> Change:
        """Return d point / d parameter: the point times the factor of the parameter."""
        factors = self._factors(state, len(state.points))
        return Change({"points": state.points[..., None] * factors[:, None, None]}, factors.shape[-1])

    def recorded(self, points: NDArray, state: State, values: NDArray) -> NDArray:
        """Return points, or their motions, (B, K, 3, ...), as an instrument with this scale records them."""
        factor = 1 + self._factors(state, len(points)) @ values
        return points * factor.reshape(-1, *([1] * (points.ndim - 1)))

    def _factors(self, state: State, poses: int) -> NDArray:
        """Return the factor of each parameter (B, P): 1, the temperature above the reference, or both."""
        if self.form == CONSTANT:
            return np.ones((poses, 1))
        rise = state.temperature_rise[:, None]
        return rise if self.form == PER_KELVIN else np.concatenate([np.ones_like(rise), rise], 1)
