"""Causes: fringe slips of interferometers, and crosstalk between signals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truing.simulation.bench.causes.channels import RunChannelCause
from truing.simulation.bench.causes.reading_causes import (
    FEWEST,
    UM,
    BenchScene,
    ReadingCause,
    is_linear,
    is_signal,
    read_channels,
)
from truing.simulation.bench.load_steps import LoadSteps, ReadingState
from truing.simulation.cause import Parameter, ReportedParameter, Step

_PLAUSIBLE_COUNT = 3.0
_PLAUSIBLE_SHARE = 0.02
# A jump is no fringe slip if it is this many sigmas from the nearest integer.
_NO_WHOLE_NUMBER = 3.3
# Largest number of onsets; in long campaigns, every n-th is tried.
_MOST_ONSETS = 800


@dataclass(frozen=True)
class FringeSlip(RunChannelCause):
    """From a step to the end of its run, a channel reads an integer number of half wavelengths too much.

    ``from_rank`` is the index of ``from_step`` in the run, from 0.
    """

    channel: str = "dz"
    run: int | str = ""
    from_step: int | str = ""
    from_rank: int = 0
    lone: bool = False
    half_wavelength_m: float = 316.495e-9

    id = "fringe-slip"
    reach = 1e3
    is_persistent = False

    @property
    def subject(self) -> str:
        """Run, with its channel if there are several."""
        return self.in_run

    @property
    def key(self) -> str:
        """Unique name of the candidate."""
        return f"{self.family} {self.from_rank}"

    def candidates(self, scene: BenchScene) -> Sequence[FringeSlip]:
        """Return every run, linear channel and step with three readings on either side."""
        steps, is_observed = scene.steps, scene.recorded
        half, slips = steps.wavelength_m / 2.0, []
        for code, first in enumerate(np.flatnonzero(steps.rank == 0)):
            indices = np.flatnonzero(steps.code == code)
            read = [steps.channels[index] for index in np.flatnonzero(is_observed[indices].any(0))]
            is_single_channel = sum(not is_signal(name) for name in read) == 1
            for index, channel in enumerate(steps.channels):
                rows = indices[is_observed[indices, index]]
                rows = rows[np.argsort(steps.rank[rows])]
                if is_linear(channel):
                    slips += [
                        FringeSlip(
                            channel,
                            steps.run[first].item(),
                            steps.step[row].item(),
                            int(steps.rank[row]),
                            is_single_channel,
                            half,
                        )
                        for row in rows[FEWEST : len(rows) - FEWEST + 1]
                    ]
        return slips[:: 1 + len(slips) // _MOST_ONSETS]

    def parameters(self, legs: int) -> tuple[Parameter, ...]:
        """Return the number of half wavelengths."""
        return (Parameter("count", "1", _PLAUSIBLE_COUNT),)

    def along(self, steps: LoadSteps) -> NDArray:
        """Return d readings / d count: half a wavelength, from the step on."""
        late = (steps.run == self.run) & (steps.rank >= self.from_rank)
        return np.asarray(self.half_wavelength_m * late[:, None])

    def reported(self, values: NDArray, covariance: NDArray, legs: int) -> tuple[ReportedParameter, ...]:
        """Return the nearest integer, or the shift in um if the data exclude an integer; and the first affected
        step."""
        since = ReportedParameter("from_step", self.from_step, None, "")
        count, sigma = int(np.rint(values[0])) or (1 if values[0] >= 0 else -1), float(np.sqrt(covariance[0, 0]))
        if 0.0 < sigma < abs(values[0] - count) / _NO_WHOLE_NUMBER:
            half_um = self.half_wavelength_m / UM
            return (ReportedParameter("shift", float(values[0]) * half_um, sigma * half_um, "um"), since)
        return (ReportedParameter("count", count, None, "1"), since)


@dataclass(frozen=True)
class Crosstalk(ReadingCause):
    """A signal contains a fraction of another signal."""

    signal: str = "v1"
    source: str = "v2"

    id = "crosstalk"
    step = Step.INSTRUMENT
    reach = 30.0

    @property
    def subject(self) -> str:
        """Signal that contains the other."""
        return f"signal {self.signal}"

    def candidates(self, scene: BenchScene) -> Sequence[Crosstalk]:
        """Return every pair of signals."""
        signals = [channel for channel in read_channels(scene) if is_signal(channel)]
        return [Crosstalk(signal, other) for signal in signals for other in signals if signal != other]

    def parameters(self, legs: int) -> tuple[Parameter, ...]:
        """Return the fraction."""
        return (Parameter("fraction", "1", _PLAUSIBLE_SHARE),)

    def slopes(self, state: ReadingState, values: NDArray) -> NDArray:
        """Return d readings / d fraction: the other signal."""
        return self._leaks(state, state.readings[..., None])

    def passed_on(self, slopes: NDArray, state: ReadingState, values: NDArray) -> NDArray:
        """Return changes of the readings, plus their crosstalk."""
        return np.asarray(slopes + values[0] * self._leaks(state, slopes))

    def reported(self, values: NDArray, covariance: NDArray, legs: int) -> tuple[ReportedParameter, ...]:
        """Return the fraction, and the source signal."""
        return (*super().reported(values, covariance, legs), ReportedParameter("source", self.source, None, ""))

    def _leaks(self, state: ReadingState, readings: NDArray) -> NDArray:
        names = state.steps.channels
        leaks = np.zeros(readings.shape, readings.dtype)
        if self.signal in names and self.source in names:
            leaks[:, names.index(self.signal)] = readings[:, names.index(self.source)]
        return leaks
