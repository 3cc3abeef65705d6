"""The points of a state as instruments record them, and how what is recorded moves when anything upstream does."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from truing.simulation.cause import OBSERVED, Cause, Effect, Step
from truing.simulation.change import Change
from truing.simulation.mechanisms.forward_pass import Met, Passage, carried
from truing.simulation.mechanisms.state import State
from truing.simulation.mechanisms.target_motion import LegFrames, motion, positions, target_motion, turns
from truing.simulation.targets import Targets


@dataclass(frozen=True)
class Recording:
    """What was recorded of a passage: ``state`` with its points and turns, ``met`` as in `Passage`, of instruments."""

    passage: Passage
    targets: Targets
    frames: LegFrames
    state: State
    met: tuple[Met, ...]

    def at(self, cause: Cause) -> State:
        """Return the state that a cause meets."""
        if cause.step is not Step.INSTRUMENT:
            return self.passage.at(cause)
        if not self.met:
            return self.state
        return {effect.cause.key: met for effect, met in self.met}.get(cause.key, self.state)

    def motion(self, change: Change, met: Sequence[Met]) -> NDArray:
        """Return how the targets move (B, K, 3, P), m, base frame, by a change that goes on to meet these effects."""
        bodies = motion(self.passage, self.passage.state.upright, carried(change, met))
        return target_motion(self.passage.state, self.targets, self.frames, bodies)

    def recorded(self, motions: NDArray, cause: Cause | None = None) -> NDArray:
        """Return motions of the points (B, K, 3, P) as recorded: by all instruments, or those after a cause."""
        for effect, state in self._after(cause):
            motions = effect.cause.recorded(motions, state, effect.values)
        return motions

    @cached_property
    def turn(self) -> NDArray:
        """Return how recorded points follow shifts along the axes of their bodies, (B, K, 3, 3)."""
        return self.recorded(self.state.turn)

    def _after(self, cause: Cause | None) -> tuple[Met, ...]:
        if cause is None:
            return self.met
        keys = [effect.cause.key for effect, _ in self.met]
        return self.met[keys.index(cause.key) + 1 :] if cause.key in keys else ()


def record(passage: Passage, targets: Targets, frames: LegFrames, effects: Sequence[Effect]) -> Recording:
    """Return what instruments record of a passage, their effects in order."""
    state = replace(
        passage.state,
        points=positions(passage.state, targets, frames),
        turn=turns(passage.state, targets, frames),
    )
    met = []
    for effect in effects:
        if effect.cause.step is Step.INSTRUMENT:
            met.append((effect, state))
            state = effect.apply(state)
    return Recording(passage, targets, frames, state, tuple(met))


def designs(recording: Recording, cause: Cause, scale: NDArray) -> dict[str, NDArray]:
    """Return a cause's change per scale (P,) of its parameters by pathway, (B or 1, n, P).

    The index within a pathway is leg, or 3 leg + axis; of what is observed, 3 target + axis.
    """
    found: dict[str, NDArray] = {}
    for name, slope in cause.change(recording.at(cause), np.zeros(len(scale))).fields.items():
        slope = slope * scale
        if name == "moved":
            slope = recording.turn @ slope
        pathway = OBSERVED if name in ("moved", "points") else name
        flat = slope.reshape(len(slope), -1, len(scale))
        found[pathway] = found[pathway] + flat if pathway in found else flat
    return found
