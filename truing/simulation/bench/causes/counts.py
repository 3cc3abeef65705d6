"""Causes: fringe slips of interferometers, and crosstalk between signals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from truing.arrays import Index
from truing.inference.model import Onsets
from truing.simulation.bench.causes.channels import RunChannelCause
from truing.simulation.bench.causes.reading_causes import (
    FEWEST_READINGS,
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
# Largest number of onsets that are tried; of more, every n-th, and then those about the best.
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
    recurs = True

    @property
    def subject(self) -> str:
        """Run, with its channel if there are several."""
        return self.in_run

    @property
    def key(self) -> str:
        """Unique name of the candidate."""
        return f"{self.family} {self.from_rank}"

    def candidates(self, scene: BenchScene) -> Sequence[FringeSlip]:
        """Return every run, linear channel and step with three readings on either side; of many steps, every few."""
        steps, is_observed = scene.steps, scene.recorded
        rows_of, spacing = _onset_rows(scene)
        of_platform = np.array([not is_signal(name) for name in steps.channels])
        is_single = {run: is_observed[steps.run == run].any(0)[of_platform].sum() == 1 for run, _ in rows_of}
        slip = replace(self, half_wavelength_m=steps.wavelength_m / 2.0)
        return [
            replace(slip, channel=channel, run=run, lone=bool(is_single[run]))._begun_at(steps, int(row))
            for (run, channel), rows in rows_of.items()
            for row in rows[::spacing]
        ]

    def onsets(self, scene: BenchScene) -> Onsets[FringeSlip]:
        """Return every step of its run with three readings of the channel on either side."""
        rows_of, spacing = _onset_rows(scene)
        rows, steps = rows_of[self.run, self.channel], scene.steps
        first_row = int(rows[np.argmax(steps.rank[rows] >= self.from_rank)])
        return Onsets(rows, spacing, first_row, lambda row: self._begun_at(steps, row))

    def _begun_at(self, steps: LoadSteps, row: int) -> FringeSlip:
        return replace(self, from_step=steps.step[row].item(), from_rank=int(steps.rank[row]))

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


def _onset_rows(scene: BenchScene) -> tuple[dict[tuple[int | str, str], Index], int]:
    """Return the rows of possible onsets of each run and linear channel, in order of steps, and the spacing of those
    that are tried."""
    steps, rows_of = scene.steps, dict[tuple[int | str, str], Index]()
    for code, first in enumerate(np.flatnonzero(steps.rank == 0)):
        of_run = np.flatnonzero(steps.code == code)
        of_run = of_run[np.argsort(steps.rank[of_run])]
        for index, channel in enumerate(steps.channels):
            rows = of_run[scene.recorded[of_run, index]]
            if is_linear(channel):
                rows_of[steps.run[first].item(), channel] = rows[FEWEST_READINGS : len(rows) - FEWEST_READINGS + 1]
    return rows_of, 1 + sum(map(len, rows_of.values())) // _MOST_ONSETS


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
