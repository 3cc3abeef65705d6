"""Cause: rate-independent hysteresis by play with friction; the loop does not close at zero load."""

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
from truing.simulation.inputs import Missing

_PLAUSIBLE = 0.02
_PLAUSIBLE_LOG = 0.5  # prior sigma of the logarithm of the threshold
_COUNT, _SMALLEST, _LARGEST = 3, 0.02, 0.4  # thresholds of the candidates, as shares of the largest load
_OF_A_STEP = 0.5  # thresholds below this share of a load step give equal readings
_FEWEST_REVERSALS = 2


@dataclass(frozen=True)
class PlayHysteresis(OneOrAllAxesCause):
    """The deflection under loads along ``axis``, or all, lags by up to half of ``width`` times its largest value.

    The lag reverses over twice the ``threshold``, a share of the largest load, whenever the load turns back.
    ``exercised``: each run starts in the state that the same run would leave, instead of at rest. If ``free``, the
    logarithm of the threshold over ``threshold`` is a further parameter.

    Source: play operator (Prandtl and Ishlinskii), Visintin, Differential models of hysteresis (1994), chapter III.
    """

    axis: str = ""
    threshold: float = 0.1
    exercised: bool = False
    free: bool = False

    id = "play-hysteresis"
    share_of_all = 0.3
    lacking = Missing.TURNS
    step = Step.STRUCTURE

    def candidates(self, scene: BenchScene) -> Sequence[PlayHysteresis]:
        """Return thresholds from half a step of the loads on, from rest and exercised, for axes whose load turns back.

        There is a candidate for each such axis and one for all axes.
        """
        steps = scene.steps
        axes = [axis for axis in loaded_axes(scene) if _reversals(steps, AXES.index(axis)) >= _FEWEST_REVERSALS]
        if not axes:
            return ()
        smallest = min(max(_SMALLEST, _OF_A_STEP * _usual_step(steps)), _LARGEST / _COUNT)
        return [
            PlayHysteresis(axis, float(threshold), exercised)
            for axis in with_all(axes)
            for threshold in np.geomspace(smallest, _LARGEST, _COUNT)
            for exercised in (False, True)
        ]

    def refined(self) -> Self:
        """Return the form with a fitted threshold."""
        return replace(self, free=True)

    def with_fixed_shape(self, shape: NDArray) -> Self | None:
        """Return the form with a fixed threshold, from its logarithm."""
        return replace(self, threshold=self.threshold * float(np.exp(shape[0])), free=False)

    def one_sided(self, legs: int) -> tuple[int, ...]:
        """Return the width: a passive body always lags."""
        return (0,)

    def parameters(self, legs: int) -> tuple[Parameter, ...]:
        """Return the width, then the logarithm of the threshold if it is free."""
        width = (Parameter("width", "1", _PLAUSIBLE),)
        return (*width, Parameter("log_threshold", "1", _PLAUSIBLE_LOG)) if self.free else width

    def slopes(self, state: ReadingState, values: NDArray) -> NDArray:
        """Return d deflection / d width, and by the logarithm of the threshold."""
        lag, by_log = self._lags(state.steps, values)
        response = _at_largest(state.steps, state.deflection)
        derivatives = [response * lag[:, None]]
        if self.free:
            derivatives.append(values[0] * response * by_log[:, None])
        return np.stack(derivatives, -1)

    def moved(self, state: ReadingState, values: NDArray) -> NDArray:
        """Return the lag of the deflection."""
        lag, _ = self._lags(state.steps, values)
        return np.asarray(values[0] * _at_largest(state.steps, state.deflection) * lag[:, None])

    def passed_on(self, slopes: NDArray, state: ReadingState, values: NDArray) -> NDArray:
        """Return changes of the deflection, plus those of its lag."""
        lag, _ = self._lags(state.steps, values)
        return np.asarray(slopes + values[0] * _at_largest(state.steps, slopes) * lag[:, None, :, None])

    def reported(self, values: NDArray, covariance: NDArray, legs: int) -> tuple[ReportedParameter, ...]:
        """Return the width, and the threshold as a share of the largest load."""
        width = ReportedParameter("width", float(values[0]), float(np.sqrt(covariance[0, 0])), "1")
        if not self.free:
            return (width, ReportedParameter("threshold", self.threshold, self.threshold * _PLAUSIBLE_LOG, "1"))
        threshold = self.threshold * float(np.exp(values[1]))
        return (width, ReportedParameter("threshold", threshold, threshold * float(np.sqrt(covariance[1, 1])), "1"))

    def _lags(self, steps: LoadSteps, values: NDArray) -> tuple[NDArray, NDArray]:
        """Return the change of deflections (B, 6) per width, over their largest, and its derivative by the threshold's
        logarithm.

        Readings are relative to the start of their run, and so is the lag.
        """
        shape = values[1] if self.free else 0.0
        lag, by_log = steps.lagging(self.threshold * float(np.exp(np.real(shape))), exercised=self.exercised)
        by_log = by_log - by_log[steps.first]
        lag = lag - lag[steps.first] + by_log * (shape - np.real(shape))
        is_on_axis = np.array([not self.axis or axis == self.axis for axis in AXES])
        return -0.5 * lag * is_on_axis, -0.5 * by_log * is_on_axis


def _at_largest(steps: LoadSteps, deflection: NDArray) -> NDArray:
    """Return deflections (1, 6, 6, ...) under each axis' largest load, scaled from those (B, 6, 6, ...) at its
    largest step."""
    step, axis = np.argmax(np.abs(steps.share), 0), np.arange(len(AXES))
    share = steps.share[step, axis]
    response = np.moveaxis(deflection[step, :, axis], 0, 1) / np.where(share != 0.0, share, np.inf).reshape(
        -1, *([1] * (deflection.ndim - 3))
    )
    return np.asarray(response[None])


def _reversals(steps: LoadSteps, axis: int) -> int:
    direction = steps.direction[:, axis]
    return int(np.sum(direction * direction[steps.before] < 0.0))


def _usual_step(steps: LoadSteps) -> float:
    """Return the median step of the loads that change, as a share of their largest."""
    changes = np.abs(steps.share - steps.share[steps.before])
    return float(np.median(changes[changes > 0.0])) if np.any(changes > 0.0) else 0.0
