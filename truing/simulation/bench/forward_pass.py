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
from truing.simulation.cause import Effect, Step
from truing.simulation.trace import Trace


@dataclass(frozen=True)
class ReadingPassage(Trace[ReadingCause, ReadingState]):
    """How loads pass the chain: compliance (6, 6), rows (S, 6) of signals by wrench, and the view (6, 6) that channels
    have of the platform's motion."""

    compliance: NDArray
    rows: NDArray
    view: NDArray

    def from_wrench(self, slopes: NDArray, cause: ReadingCause | None = None) -> NDArray:
        """Return how readings (B, K, P) follow changes of the wrench (B, 6, P), upstream of all or after a cause."""
        for effect, state in self.downstream(cause, Step.DRIVE):
            slopes = effect.cause.passed_on(slopes, state, effect.values)
        signals = self.rows @ slopes
        if not self.downstream(None, Step.STRUCTURE):
            return self.from_motion(self.compliance @ slopes, signals)
        return self.from_deflection(self.compliance[..., None] * slopes[:, None], signals)

    def from_deflection(
        self, slopes: NDArray, signals: NDArray | None = None, cause: ReadingCause | None = None
    ) -> NDArray:
        """Return how readings (B, K, P) follow changes of the deflection (B, 6, 6, P), and of the signals (B, S, P)."""
        for effect, state in self.downstream(cause, Step.STRUCTURE):
            slopes = effect.cause.passed_on(slopes, state, effect.values)
        motion = slopes.sum(2)
        if signals is None:
            signals = np.zeros((len(motion), len(self.rows), motion.shape[-1]))
        return self.from_motion(motion, signals)

    def from_motion(self, slopes: NDArray, signals: NDArray) -> NDArray:
        """Return how readings (B, K, P) follow changes of the motion (B, 6, P), and of the signals (B, S, P)."""
        return self.from_readings(np.concatenate([self.view @ slopes, signals], 1))

    def from_readings(self, slopes: NDArray, cause: ReadingCause | None = None) -> NDArray:
        """Return what becomes of changes of the readings (B, K, P)."""
        for effect, state in self.downstream(cause, Step.INSTRUMENT):
            slopes = effect.cause.passed_on(slopes, state, effect.values)
        return slopes

    def of_cause(self, cause: ReadingCause, values: NDArray) -> NDArray:
        """Return how readings (B, K, P) follow a cause's parameters; its own field is all that it changes."""
        slopes = cause.slopes(self.at(cause), values)
        if cause.step is Step.DRIVE:
            return self.from_wrench(slopes, cause)
        if cause.step is Step.STRUCTURE:
            return self.from_deflection(slopes, None, cause)
        return self.from_readings(slopes, cause)


def passed(
    steps: LoadSteps,
    wrench: NDArray,
    compliance: NDArray,
    rows: NDArray,
    seen: tuple[NDArray, NDArray],
    effects: Sequence[Effect[ReadingCause]],
) -> ReadingPassage:
    """Return how wrenches (B, 6) pass the chain with a compliance (6, 6), rows of signals by wrench (S, 6), effects.

    seen: how channels follow the motion (6, 6), and what they read beside it (B, 6).
    """
    count = len(wrench)
    start = ReadingState(steps, wrench, np.zeros((count, len(compliance), 0)), np.zeros((count, 0)))
    driven = ReadingPassage(start, (), {}, compliance, rows, seen[0]).through(Step.DRIVE, effects, _applied)
    bent = replace(driven.state, deflection=compliance * driven.state.wrench[:, None])
    built = driven.entering(bent).through(Step.STRUCTURE, effects, _applied)
    state = built.state
    motion = state.deflection.sum(-1) @ seen[0].T + seen[1]
    read = replace(state, readings=np.concatenate([motion, state.wrench @ rows.T], 1))
    return built.entering(read).through(Step.INSTRUMENT, effects, _applied)


def _applied(effect: Effect[ReadingCause], state: ReadingState) -> ReadingState:
    name = FIELDS[effect.cause.step]
    return replace(state, **{name: getattr(state, name) + effect.cause.moved(state, effect.values)})
