"""Cause: creep, a deflection that grows with time under constant load."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from truing.simulation.bench.causes.load_path import OneOrAllAxesCause, with_all
from truing.simulation.bench.causes.reading_causes import BenchScene, loaded_axes
from truing.simulation.bench.load_steps import LoadSteps, ReadingState
from truing.simulation.bench.six_upur.loading import AXES
from truing.simulation.cause import Parameter, ReportedParameter, Step
from truing.simulation.inputs import TIME, Missing

_PLAUSIBLE = 0.02
_SHORTEST_S = 10.0
# Ratio of neighbouring time constants of the candidates, and prior sigma of the log of the time constant.
_RATIO, _PLAUSIBLE_LOG = 2.0, 0.5
_MOST_CONSTANTS = 10
# Shortest time constant over the usual time between readings: faster creep looks like a softer sensor.
_LEAST_TAU = 0.5
_TINY = 1e-30
_WITHIN_95 = 1.959964


@dataclass(frozen=True)
class Creep(OneOrAllAxesCause):
    """A fraction of the deflection, delayed by a first-order lag with a time constant, is added to it within each run.

    It concerns loads along ``axis``, or all. If ``free``, the logarithm of tau over ``tau_s`` is a further parameter.
    """

    axis: str = ""
    tau_s: float = 60.0
    free: bool = False

    id = "creep"
    share_of_all = 0.5
    lacking = Missing.TIME
    step = Step.STRUCTURE

    def candidates(self, scene: BenchScene) -> Sequence[Creep]:
        """Return time constants from ten seconds to the longest run, for all axes and each; none without times."""
        steps = scene.steps
        if not steps.is_timed:
            return ()
        hold_times, longest = steps.held_s[steps.held_s > 0.0], steps.longest_s
        shortest = max(_SHORTEST_S, _LEAST_TAU * float(np.median(hold_times))) if len(hold_times) else longest
        if not shortest < longest:
            return ()
        count = min(_MOST_CONSTANTS, 1 + int(np.ceil(np.log(longest / shortest) / np.log(_RATIO))))
        axes = with_all(loaded_axes(scene))
        return [Creep(axis, float(tau)) for tau in np.geomspace(shortest, longest, count) for axis in axes]

    def refined(self) -> Self:
        """Return the form with a fitted time constant."""
        return replace(self, free=True)

    def with_fixed_shape(self, shape: NDArray) -> Self | None:
        """Return the form with a fixed time constant, from the logarithm of tau over tau_s."""
        return replace(self, tau_s=self.tau_s * float(np.exp(shape[0])), free=False)

    def needs(self, legs: int) -> tuple[str, ...]:
        """Return the time."""
        return (TIME,)

    def one_sided(self, legs: int) -> tuple[int, ...]:
        """Return the fraction: creep continues in the direction of the load."""
        return (0,)

    def parameters(self, legs: int) -> tuple[Parameter, ...]:
        """Return the fraction, then the logarithm of the time constant if it is free."""
        fraction = (Parameter("fraction", "1", _PLAUSIBLE),)
        return (*fraction, Parameter("log_tau", "1", _PLAUSIBLE_LOG)) if self.free else fraction

    def slopes(self, state: ReadingState, values: NDArray) -> NDArray:
        """Return d deflection / d fraction, and by the logarithm of the time constant."""
        followed = self._lagged(state.deflection, state.steps, values)
        if not self.free:
            return followed[..., None]
        nudged = np.array([0.0, 1j * _TINY]) + values
        by_tau = values[0] * self._lagged(state.deflection, state.steps, nudged).imag / _TINY
        return np.stack([followed, by_tau], -1)

    def moved(self, state: ReadingState, values: NDArray) -> NDArray:
        """Return the creep of the deflection."""
        return np.asarray(values[0] * self._lagged(state.deflection, state.steps, values))

    def passed_on(self, slopes: NDArray, state: ReadingState, values: NDArray) -> NDArray:
        """Return changes of the deflection, plus their creep."""
        return np.asarray(slopes + values[0] * self._lagged(slopes, state.steps, values))

    def reported(self, values: NDArray, covariance: NDArray, legs: int) -> tuple[ReportedParameter, ...]:
        """Return the fraction, and the time constant in s."""
        fraction = ReportedParameter("fraction", float(values[0]), float(np.sqrt(covariance[0, 0])), "1")
        if not self.free:
            return (fraction, ReportedParameter("tau", self.tau_s, self.tau_s * _PLAUSIBLE_LOG, "s"))
        tau = self.tau_s * float(np.exp(values[1]))
        # The sigma covers the wider side of the 95 % interval, which is the upper one for a logarithm.
        wider = np.expm1(_WITHIN_95 * float(np.sqrt(covariance[1, 1]))) / _WITHIN_95
        return (fraction, ReportedParameter("tau", tau, tau * float(wider), "s"))

    def _lagged(self, deflection: NDArray, steps: LoadSteps, values: NDArray) -> NDArray:
        """Return lagged deflections (B, 6, 6, ...), zero under loads that are not concerned."""
        tau: object = self.tau_s * np.exp(values[1] if self.free else 0.0)
        remaining = np.exp(-steps.held_s / tau)
        if not self.axis:
            return steps.filtered(deflection, remaining)
        columns = np.s_[:, :, AXES.index(self.axis)]
        followed = np.zeros(deflection.shape, np.result_type(deflection, remaining))
        followed[columns] = steps.filtered(deflection[columns], remaining)
        return followed
