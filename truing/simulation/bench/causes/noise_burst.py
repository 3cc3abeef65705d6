"""Cause: larger noise in one run, by vibration, a loose plug, or weights in varying positions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truing.inference.model import ScatterCandidate
from truing.simulation.bench.causes.reading_causes import (
    FEWEST_READINGS,
    BenchScene,
    ReadingCause,
    channel_subject,
    is_signal,
)
from truing.simulation.bench.causes.zero_step import DISPLACEMENTS, SIGNALS
from truing.simulation.bench.load_steps import ReadingState
from truing.simulation.cause import Parameter, Step


@dataclass(frozen=True)
class NoisyRun(ReadingCause):
    """Readings of a ``run`` scatter more: one ``channel``, all displacements or all signals."""

    run: int | str = ""
    channel: str = DISPLACEMENTS

    id = "noise-burst"
    step = Step.INSTRUMENT
    is_persistent = False

    @property
    def subject(self) -> str:
        """Run, with the channels concerned."""
        several = self.channel in (DISPLACEMENTS, SIGNALS)
        return f"run {self.run} {self.channel if several else channel_subject(self.channel)}"

    def candidates(self, scene: BenchScene) -> Sequence[NoisyRun]:
        """Return none: noise has no mean effect."""
        return ()

    def scatters(self, scene: BenchScene) -> Sequence[ScatterCandidate[NoisyRun]]:
        """Return every run of several steps, for each kind of channel and each channel; none if there is only one
        run."""
        steps, names = scene.steps, np.array(scene.steps.channels)
        signals = np.array([is_signal(name) for name in names])
        candidates_of_runs: list[ScatterCandidate[NoisyRun]] = []
        for code in np.unique(steps.code) if np.ptp(steps.code) > 0 else ():
            within = steps.code == code
            read = scene.recorded[within].sum(0) >= FEWEST_READINGS
            parts = {str(name): names == name for name in names[read]}
            kinds = {DISPLACEMENTS: read & ~signals, SIGNALS: read & signals}
            parts |= {kind: is_in_part for kind, is_in_part in kinds.items() if is_in_part.sum() > 1}
            run = steps.run[int(np.argmax(within))]
            for channel, part in parts.items():
                candidates_of_runs.append(ScatterCandidate(NoisyRun(run, channel), within[:, None] & part, False))
        return candidates_of_runs

    def parameters(self, legs: int) -> tuple[Parameter, ...]:
        """Return the ratio of the noise to that of the other runs."""
        return (Parameter("noise_ratio", "1", 1.0),)

    def slopes(self, state: ReadingState, values: NDArray) -> NDArray:
        """Return zero: there is no mean effect."""
        return np.zeros((*state.readings.shape, 1))
