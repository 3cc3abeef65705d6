"""The zero of channels stands elsewhere from a step on: a knock, a plug, an amplifier that was switched off and on."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby

import numpy as np
from numpy.typing import NDArray

from truing.inference.model import ChannelCandidates
from truing.simulation.bench.causes.reading_causes import (
    FEWEST,
    BenchScene,
    ReadingCause,
    is_linear,
    is_signal,
    unit_of,
    whose,
)
from truing.simulation.bench.load_steps import LoadSteps, ReadingState
from truing.simulation.cause import Parameter, ReportedParameter, Step

_PLAUSIBLE_SIGMAS = 10.0
# Onsets that are tried in all; in long campaigns, every so many-th.
_MOST_ONSETS = 400
DISPLACEMENTS, SIGNALS = "displacements", "signals"


@dataclass(frozen=True)
class ZeroStep(ReadingCause):
    """From ``from_step`` of a ``run`` on, to its end, ``channels`` read more, each by an amount of its own.

    ``from_rank`` is the place of the step in the run, from 0; ``scales`` are plausible amounts, SI. A single linear
    channel that jumps is a `FringeSlip`, which says whether it does so by whole half wavelengths.
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
        """Return the run with its channel, or whether these are all displacements or signals."""
        several = SIGNALS if is_signal(self.channels[0]) else DISPLACEMENTS
        return f"run {self.run} {whose(self.channels[0]) if len(self.channels) == 1 else several}"

    @property
    def family(self) -> str:
        """Return the kind, its channels and its run."""
        return f"{self.id} {' '.join(self.channels)} {self.run}"

    @property
    def key(self) -> str:
        """Return the name that tells this candidate from all others."""
        return f"{self.family} {self.from_rank}"

    def excludes(self, other: ReadingCause) -> bool:
        """Return whether another is the same, or one of channels of which this one is already, from the same step."""
        return self.key == other.key or (
            isinstance(other, ZeroStep)
            and (self.run, self.from_rank) == (other.run, other.from_rank)
            and bool(set(self.channels) & set(other.channels))
        )

    def candidates(self, scene: BenchScene) -> Sequence[ZeroStep]:
        """Return none: there are too many to be told one by one."""
        return ()

    def channel_candidates(self, scene: BenchScene) -> Sequence[ChannelCandidates[ZeroStep]]:
        """Return every rotation and signal, all displacements and all signals, from every step of a run on that has
        three readings on either side."""
        steps = scene.steps
        onsets = [row for row in range(len(steps.run)) if steps.rank[row] >= FEWEST]
        onsets = onsets[:: 1 + len(onsets) // _MOST_ONSETS]
        if not onsets:
            return ()
        late = np.stack([(steps.code == steps.code[row]) & (steps.rank >= steps.rank[row]) for row in onsets])
        early = np.stack([(steps.code == steps.code[row]) & (steps.rank < steps.rank[row]) for row in onsets])
        seen = scene.recorded.astype(int)
        usable = np.minimum(late.astype(int) @ seen, early.astype(int) @ seen) >= FEWEST
        return [_of_channels(steps, onsets, late, usable, places) for places in _groups(steps)]

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
        own = np.array([[name == one for one in self.channels] for name in state.steps.channels], float)
        return np.asarray(late[:, None, None] * own)

    def reported(self, values: NDArray, covariance: NDArray, legs: int) -> tuple[ReportedParameter, ...]:
        """Return the amounts, and the step from which on."""
        return (*super().reported(values, covariance, legs), ReportedParameter("from_step", self.from_step, None, ""))


def _groups(steps: LoadSteps) -> Iterator[NDArray]:
    """Yield the places of channels (T, 1) of one noise that are tried each by itself, and of those (1, n) that are
    tried together."""
    single = [place for place, name in enumerate(steps.channels) if not is_linear(name)]
    for _, own in groupby(
        sorted(single, key=lambda place: float(steps.sigma[place])), lambda place: steps.sigma[place]
    ):
        yield np.array(list(own))[:, None]
    for signals in (False, True):
        together = [place for place, name in enumerate(steps.channels) if is_signal(name) == signals]
        if len(together) > 1:
            yield np.array(together)[None]


def _of_channels(
    steps: LoadSteps, onsets: Sequence[int], late: NDArray, usable: NDArray, places: NDArray
) -> ChannelCandidates[ZeroStep]:
    """Return the steps of channels (T, n) at onsets (S,), late (S, B), where they were read often enough (S, K)."""
    scales = _PLAUSIBLE_SIGMAS * steps.sigma[places]
    scale = float(scales.max())

    def member(target: int, shape: int) -> ZeroStep:
        row = onsets[shape]
        names = tuple(steps.channels[place] for place in places[target])
        own = tuple(float(one) for one in scales[target])
        return ZeroStep(names, steps.run[row].item(), steps.step[row].item(), int(steps.rank[row]), own)

    values, reported = late[..., None].astype(float), usable[:, places]
    if places.shape[1] == 1:
        return ChannelCandidates(values, places[:, 0], reported[..., 0], scale, member)
    patterns = np.stack([np.diag(own / scale) for own in scales])[:, :, None, :]
    return ChannelCandidates(values, places, np.asarray(reported.all(-1)), scale, member, patterns)
