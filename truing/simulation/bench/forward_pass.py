"""How loads pass the chain wrench -> deflection -> readings, and how readings follow what changes on the way.

Every effect changes one field, in proportion to it or by what is known of the steps: changes pass what comes downstream
by the same linear maps.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from truing.simulation.bench.causes.reading_causes import FIELDS, ReadingCause
from truing.simulation.bench.load_steps import LoadSteps, ReadingState
from truing.simulation.cause import Cause, Effect, Step


@dataclass(frozen=True)
class ReadingPassage:
    """How loads pass the chain: the state at its end, and every effect with the state that it met."""

    state: ReadingState
    met: tuple[tuple[Effect, ReadingState], ...]
    before: dict[Step, ReadingState]  # the state after a step's last effect
    compliance: NDArray  # (6, 6)
    rows: NDArray  # (S, 6) signals by wrench
    view: NDArray  # (6, 6) channels by the platform's motion

    def at(self, cause: Cause) -> ReadingState:
        """Return the state that a cause meets: the last of its step where it is not in force."""
        return {effect.cause.key: met for effect, met in self.met}.get(cause.key, self.before[cause.step])

    def after(self, step: Step, cause: Cause | None) -> list[tuple[ReadingCause, ReadingState, NDArray]]:
        """Return the effects of a step, or those of them after a cause, which comes last if it is not in force."""
        own = [(_of_readings(e.cause), met, e.values) for e, met in self.met if e.cause.step is step]
        if cause is None or cause.step is not step:
            return own
        keys = [other.key for other, _, _ in own]
        return own[keys.index(cause.key) + 1 :] if cause.key in keys else []

    def from_wrench(self, slopes: NDArray, cause: Cause | None = None) -> NDArray:
        """Return how readings (B, K, P) follow changes of the wrench (B, 6, P), upstream of all or after a cause."""
        for own, state, values in self.after(Step.DRIVE, cause):
            slopes = own.passed_on(slopes, state, values)
        signals = self.rows @ slopes
        if not self.after(Step.STRUCTURE, None):
            return self.from_motion(self.compliance @ slopes, signals)
        return self.from_deflection(self.compliance[..., None] * slopes[:, None], signals)

    def from_deflection(self, slopes: NDArray, signals: NDArray | None = None, cause: Cause | None = None) -> NDArray:
        """Return how readings (B, K, P) follow changes of the deflection (B, 6, 6, P), and of the signals (B, S, P)."""
        for own, state, values in self.after(Step.STRUCTURE, cause):
            slopes = own.passed_on(slopes, state, values)
        motion = slopes.sum(2)
        if signals is None:
            signals = np.zeros((len(motion), len(self.rows), motion.shape[-1]))
        return self.from_motion(motion, signals)

    def from_motion(self, slopes: NDArray, signals: NDArray) -> NDArray:
        """Return how readings (B, K, P) follow changes of the motion (B, 6, P), and of the signals (B, S, P)."""
        return self.from_readings(np.concatenate([self.view @ slopes, signals], 1))

    def from_readings(self, slopes: NDArray, cause: Cause | None = None) -> NDArray:
        """Return what becomes of changes of the readings (B, K, P)."""
        for own, state, values in self.after(Step.INSTRUMENT, cause):
            slopes = own.passed_on(slopes, state, values)
        return slopes

    def of_cause(self, cause: Cause, values: NDArray) -> NDArray:
        """Return how readings (B, K, P) follow a cause's parameters; its own field is all that it changes."""
        slopes = _of_readings(cause).slopes(self.at(cause), values)
        if cause.step is Step.DRIVE:
            return self.from_wrench(slopes, cause)
        if cause.step is Step.STRUCTURE:
            return self.from_deflection(slopes, None, cause)
        return self.from_readings(slopes, cause)


def _of_readings(cause: Cause) -> ReadingCause:
    assert isinstance(cause, ReadingCause)  # the catalogue of readings holds no other
    return cause


def passed(
    steps: LoadSteps,
    wrench: NDArray,
    compliance: NDArray,
    rows: NDArray,
    seen: tuple[NDArray, NDArray],
    effects: Sequence[Effect],
) -> ReadingPassage:
    """Return how wrenches (B, 6) pass the chain with a compliance (6, 6), rows of signals by wrench (S, 6), effects.

    seen: how channels follow the motion (6, 6), and what they read beside it (B, 6).
    """
    count = len(wrench)
    state = ReadingState(steps, wrench, np.zeros((count, len(compliance), 0)), np.zeros((count, 0)))
    met: list[tuple[Effect, ReadingState]] = []
    before = {}
    for step in (Step.DRIVE, Step.STRUCTURE, Step.INSTRUMENT):
        if step is Step.STRUCTURE:
            state = replace(state, deflection=compliance * state.wrench[:, None])
        if step is Step.INSTRUMENT:
            motion = state.deflection.sum(-1) @ seen[0].T + seen[1]
            state = replace(state, readings=np.concatenate([motion, state.wrench @ rows.T], 1))
        for effect in effects:
            if effect.cause.step is step:
                met.append((effect, state))
                name = FIELDS[step]
                by = _of_readings(effect.cause).moved(state, effect.values)
                state = replace(state, **{name: getattr(state, name) + by})
        before[step] = state
    return ReadingPassage(state, tuple(met), before, compliance, rows, seen[0])
