"""Cause: hysteresis of a sensor that shows its signals alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truing.simulation.bench.causes.load_path import OneOrAllAxesCause, with_all
from truing.simulation.bench.causes.reading_causes import BenchScene, loaded_axes
from truing.simulation.bench.load_steps import CHANNELS, LoadSteps, ReadingState
from truing.simulation.bench.six_upur.loading import AXES
from truing.simulation.cause import Parameter, Step
from truing.simulation.inputs import Missing

_PLAUSIBLE = 0.01
# Thresholds of the lag, as shares of the largest load; 0 is the loop that closes without load.
_THRESHOLDS = 0.0, 0.05, 0.15, 0.4
# Fewest loads on the way back.
_FEWEST = 2


@dataclass(frozen=True)
class SignalHysteresis(OneOrAllAxesCause):
    """Signals under loads along ``axis``, or all, are larger during unloading. The load seems to lag by up to half of
    ``width`` times the largest load.

    The lag reverses over twice the ``threshold``, a share of the largest load, whenever the load turns back
    (`PlayHysteresis`); ``exercised``: each run starts in the state that the same run would leave. If ``threshold`` is
    zero, the loop closes without load and at the largest load (`Hysteresis`), and ``width`` is its largest one.
    """

    axis: str = ""
    threshold: float = 0.0
    exercised: bool = False

    id = "signal-hysteresis"
    share_of_all = 0.3
    lacking = Missing.TURNS
    step = Step.DRIVE
    reach = 30.0

    def candidates(self, scene: BenchScene) -> Sequence[SignalHysteresis]:
        """Return every form for each axis that was loaded and unloaded, and for all; none next to readings of the
        deflection."""
        steps = scene.steps
        if scene.recorded[:, : len(CHANNELS)].any():
            return ()
        back = np.sum(steps.unloading & (steps.load != 0.0), 0)
        axes = [axis for axis in loaded_axes(scene) if back[AXES.index(axis)] >= _FEWEST]
        return [
            SignalHysteresis(axis, threshold, exercised)
            for axis in with_all(axes)
            for threshold in _THRESHOLDS
            for exercised in ((False, True) if threshold else (False,))
        ]

    def parameters(self, legs: int) -> tuple[Parameter, ...]:
        """Return the width, a share of the signal at the largest load."""
        return (Parameter("width", "1", _PLAUSIBLE),)

    def slopes(self, state: ReadingState, values: NDArray) -> NDArray:
        """Return d wrench / d width."""
        on_axis = np.array([not self.axis or axis == self.axis for axis in AXES])
        return np.asarray((self._lag(state.steps) * state.steps.largest * on_axis)[..., None])

    def _lag(self, steps: LoadSteps) -> NDArray:
        """Return the excess of the load felt (B, 6) per width, over the largest load; zero at the start of a run."""
        if not self.threshold:
            share = steps.share
            return np.where(steps.unloading, 4.0 * share * np.maximum(1.0 - np.abs(share), 0.0), 0.0)
        lag, _ = steps.lagging(self.threshold, exercised=self.exercised)
        return np.asarray(-0.5 * (lag - lag[steps.first]))
