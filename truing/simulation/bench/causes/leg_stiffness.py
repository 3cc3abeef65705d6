"""Cause: one leg of a sensor is softer or stiffer than simulated, as a whole or in one part."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truing.simulation.bench.causes.reading_causes import BenchScene, ReadingCause
from truing.simulation.bench.load_steps import CHANNELS, LegElasticity, ReadingState
from truing.simulation.cause import Parameter, ReportedParameter, Step

_PLAUSIBLE_LOG = 0.2
_WHOLE_SHARE = 0.5


@dataclass(frozen=True)
class LegStiffness(ReadingCause):
    """The stiffness of a ``leg`` (from 1), or of one ``part`` of it, is 1 + scale times the simulated one.

    It changes all entries of the compliance; the distribution of the load over the legs, and thus the signals, are
    assumed unchanged. The fitted parameter is the logarithm of 1 + scale.
    """

    leg: int = 1
    part: str = ""

    id = "leg-stiffness"
    step = Step.STRUCTURE

    @property
    def subject(self) -> str:
        """Leg concerned."""
        return f"leg{self.leg}"

    @property
    def family(self) -> str:
        """Kind and leg."""
        return f"{self.id} {self.leg}"

    def candidates(self, scene: BenchScene) -> Sequence[LegStiffness]:
        """Return every leg, and every part of it, if the legs' elements are known and displacements were read."""
        legs = scene.steps.legs
        if legs is None or not scene.recorded[:, : len(CHANNELS)].any():
            return ()
        parts = legs.names if len(legs.names) > 1 else ()
        return [LegStiffness(leg, part) for leg in range(1, len(legs.parts) + 1) for part in ("", *parts)]

    def prior(self, scene: BenchScene) -> float:
        """Return the relative prior weight of a leg as a whole, or of one part of it."""
        legs = scene.steps.legs
        count = len(legs.names) if legs is not None else 1
        return 1.0 if count < 2 else _WHOLE_SHARE if not self.part else (1.0 - _WHOLE_SHARE) / count

    def parameters(self, legs: int) -> tuple[Parameter, ...]:
        """Return the logarithm of the stiffness over the simulated one."""
        return (Parameter("log_stiffness", "1", _PLAUSIBLE_LOG),)

    def slopes(self, state: ReadingState, values: NDArray) -> NDArray:
        """Return d deflection / d logarithm."""
        return self._scaled_deflections(state.deflection, state.steps.legs, values, 1)[..., None]

    def moved(self, state: ReadingState, values: NDArray) -> NDArray:
        """Return the change of the deflection."""
        return self._scaled_deflections(state.deflection, state.steps.legs, values, 0) - state.deflection

    def passed_on(self, slopes: NDArray, state: ReadingState, values: NDArray) -> NDArray:
        """Return changes of the deflection for a sensor with such a leg."""
        return self._scaled_deflections(slopes, state.steps.legs, values, 0)

    def ratios(self, legs: LegElasticity, values: NDArray) -> tuple[NDArray, NDArray]:
        """Return the left factor (6, 6) of the compliance, and its derivative by the logarithm."""
        parts = legs.parts[self.leg - 1]
        softer = np.exp(-values[0])
        which = np.array([not self.part or name == self.part for name in legs.names])
        compliance = np.linalg.inv(parts.sum(0))
        compliance_of_leg = parts[which].sum(0)
        changed = np.linalg.inv(parts[~which].sum(0) + softer * compliance_of_leg)
        # derivative of the leg's compliance, then factor of the sensor's compliance
        slope = changed @ (softer * compliance_of_leg) @ changed
        ratio = np.linalg.inv(np.eye(len(compliance)) + legs.compliance @ (changed - compliance))
        return ratio, -ratio @ legs.compliance @ slope @ ratio

    def reported(self, values: NDArray, covariance: NDArray, legs: int) -> tuple[ReportedParameter, ...]:
        """Return the relative change of the stiffness, and the part of the leg."""
        stiffer = float(np.exp(values[0]))
        scale = ReportedParameter("scale", stiffer - 1.0, stiffer * float(np.sqrt(covariance[0, 0])), "1")
        return (scale, ReportedParameter("part", self.part, None, "")) if self.part else (scale,)

    def _scaled_deflections(
        self, deflection: NDArray, legs: LegElasticity | None, values: NDArray, index: int
    ) -> NDArray:
        """Return deflections (B, 6, 6, ...) times the factor, or times its derivative; without legs unchanged, or
        zero."""
        if legs is None:
            return deflection * (1.0 - index)
        return np.asarray(np.einsum("ik,bk...->bi...", self.ratios(legs, values)[index], deflection))
