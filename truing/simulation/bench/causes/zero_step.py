"""Cause: the zero of channels changes at a step, by a knock, a plug, or an amplifier switched off and on."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import groupby

import numpy as np
from numpy.typing import NDArray

from truing.arrays import Index
from truing.inference.model import ChannelCandidates, Onsets
from truing.simulation.bench.causes.reading_causes import (
    FEWEST_READINGS,
    BenchScene,
    ReadingCause,
    channel_subject,
    is_linear,
    is_signal,
    unit_of,
)
from truing.simulation.bench.load_steps import LoadSteps, ReadingState
from truing.simulation.cause import Parameter, ReportedParameter, Step

_PLAUSIBLE_SIGMAS = 10.0
# Largest number of onsets that are tried; of more, every n-th, and then those about the best.
_MOST_ONSETS = 400
DISPLACEMENTS, SIGNALS = "displacements", "signals"


@dataclass(frozen=True)
class ZeroStep(ReadingCause):
    """From ``from_step`` of a ``run`` to its end, ``channels`` are shifted, each by its own amount.

    ``from_rank`` is the index of the step in the run, from 0; ``scales`` are plausible amounts, SI. A jump of a single
    linear channel is a `FringeSlip`, which reports whether it is an integer number of half wavelengths.
    """

    channels: tuple[str, ...] = ("rz",)
    run: int | str = ""
    from_step: int | str = ""
    from_rank: int = 0
    scales: tuple[float, ...] = (1.0,)

    id = "zero-step"
    step = Step.INSTRUMENT
    reach = 1e3
    is_persistent = False

    @property
    def subject(self) -> str:
        """Run with its channel, or with all displacements or signals."""
        several = SIGNALS if is_signal(self.channels[0]) else DISPLACEMENTS
        return f"run {self.run} {channel_subject(self.channels[0]) if len(self.channels) == 1 else several}"

    @property
    def affected_part(self) -> str:
        """Channel, in whichever run; the subject of a step of several channels."""
        return channel_subject(self.channels[0]) if len(self.channels) == 1 else self.subject

    @property
    def family(self) -> str:
        """Kind, channels and run."""
        return f"{self.id} {' '.join(self.channels)} {self.run}"

    @property
    def key(self) -> str:
        """Unique name of the candidate."""
        return f"{self.family} {self.from_rank}"

    def excludes(self, other: ReadingCause) -> bool:
        """True if the other is the same, or shares a channel from the same step on."""
        return self.key == other.key or (
            isinstance(other, ZeroStep)
            and (self.run, self.from_rank) == (other.run, other.from_rank)
            and bool(set(self.channels) & set(other.channels))
        )

    def candidates(self, scene: BenchScene) -> Sequence[ZeroStep]:
        """Return none: `channel_candidates` has them."""
        return ()

    def channel_candidates(self, scene: BenchScene) -> Sequence[ChannelCandidates[ZeroStep]]:
        """Return every rotation and signal, all displacements and all signals, from each possible step on.

        There must be three readings of the run before and after the step.
        """
        steps, (onsets, spacing) = scene.steps, _onset_rows(scene.steps)
        onsets = onsets[::spacing]
        if not len(onsets):
            return ()
        late = np.stack([(steps.code == steps.code[row]) & (steps.rank >= steps.rank[row]) for row in onsets])
        early = np.stack([(steps.code == steps.code[row]) & (steps.rank < steps.rank[row]) for row in onsets])
        seen = scene.recorded.astype(int)
        usable = np.minimum(late.astype(int) @ seen, early.astype(int) @ seen) >= FEWEST_READINGS
        return [_channel_steps(steps, onsets, late, usable, group) for group in _groups(steps)]

    def onsets(self, scene: BenchScene) -> Onsets[ZeroStep]:
        """Return every step of its run with three readings before it and from it on."""
        steps, (rows, spacing) = scene.steps, _onset_rows(scene.steps)
        seen = scene.recorded[:, [steps.channels.index(name) for name in self.channels]]
        rows = rows[steps.run[rows] == self.run]
        rows = rows[np.argsort(steps.rank[rows], kind="stable")]
        of_run = steps.run == self.run
        later = np.stack([seen[of_run & (steps.rank >= steps.rank[row])].sum(0) for row in rows])
        usable = np.minimum(later, seen[of_run].sum(0) - later).min(1) >= FEWEST_READINGS
        first_row = int(rows[np.argmax(steps.rank[rows] >= self.from_rank)])

        def begun_at(row: int) -> ZeroStep:
            return replace(self, from_step=steps.step[row].item(), from_rank=int(steps.rank[row]))

        return Onsets(rows[usable], spacing, first_row, begun_at)

    def parameters(self, legs: int) -> tuple[Parameter, ...]:
        """Return the amounts."""
        several = len(self.channels) > 1
        named = [(f"shift_{name}" if several else "shift", *unit_of(name)) for name in self.channels]
        return tuple(
            Parameter(name, unit, scale, si) for (name, unit, si), scale in zip(named, self.scales, strict=True)
        )

    def slopes(self, state: ReadingState, values: NDArray) -> NDArray:
        """Return d readings / d amount: one, from the step on."""
        late = (state.steps.run == self.run) & (state.steps.rank >= self.from_rank)
        is_on_channel = np.array(
            [[name == channel for channel in self.channels] for name in state.steps.channels], float
        )
        return np.asarray(late[:, None, None] * is_on_channel)

    def reported(self, values: NDArray, covariance: NDArray, legs: int) -> tuple[ReportedParameter, ...]:
        """Return the amounts, and the first affected step."""
        return (*super().reported(values, covariance, legs), ReportedParameter("from_step", self.from_step, None, ""))


def _onset_rows(steps: LoadSteps) -> tuple[Index, int]:
    """Return the rows of possible onsets, and the spacing of those that are tried."""
    rows = np.flatnonzero(steps.rank >= FEWEST_READINGS)
    return rows, 1 + len(rows) // _MOST_ONSETS


def _groups(steps: LoadSteps) -> Iterator[NDArray]:
    """Yield indices of channels of equal noise: (T, 1) to try one by one, and (1, n) to try together."""
    single = [channel for channel, name in enumerate(steps.channels) if not is_linear(name)]
    for _, group in groupby(
        sorted(single, key=lambda channel: float(steps.sigma[channel])), lambda channel: steps.sigma[channel]
    ):
        yield np.array(list(group))[:, None]
    for signals in (False, True):
        together = [channel for channel, name in enumerate(steps.channels) if is_signal(name) == signals]
        if len(together) > 1:
            yield np.array(together)[None]


def _channel_steps(
    steps: LoadSteps, onsets: Index, late: NDArray, usable: NDArray, channels: NDArray
) -> ChannelCandidates[ZeroStep]:
    """Return the candidates for channels (T, n) at onsets (S,), with masks late (S, B) and usable (S, K)."""
    scales = _PLAUSIBLE_SIGMAS * steps.sigma[channels]
    scale = float(scales.max())

    def member(target: int, shape: int) -> ZeroStep:
        row = onsets[shape]
        names = tuple(steps.channels[channel] for channel in channels[target])
        scales_of_target = tuple(float(value) for value in scales[target])
        return ZeroStep(names, steps.run[row].item(), steps.step[row].item(), int(steps.rank[row]), scales_of_target)

    values, reported = late[..., None].astype(float), usable[:, channels]
    if channels.shape[1] == 1:
        return ChannelCandidates(values, channels[:, 0], reported[..., 0], scale, member)
    patterns = np.stack([np.diag(scale_of_step / scale) for scale_of_step in scales])[:, :, None, :]
    return ChannelCandidates(values, channels, np.asarray(reported.all(-1)), scale, member, patterns)
