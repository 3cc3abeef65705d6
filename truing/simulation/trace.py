"""Class `Trace`: a state in the chain drive -> structure -> instrument, with all intermediate states and effects."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Generic, Self, TypeVar

from truing.simulation.cause import CauseT, Effect, Step

S = TypeVar("S")


@dataclass(frozen=True)
class Trace(Generic[CauseT, S]):
    """State after some steps of the chain, with its history.

    ``effects`` holds every effect in order of action, with the state that it acted on; ``after`` the state after each
    step.
    """

    state: S
    effects: tuple[tuple[Effect[CauseT], S], ...]
    after: dict[Step, S]

    def through(self, step: Step, effects: Sequence[Effect[CauseT]], applied: Callable[[Effect[CauseT], S], S]) -> Self:
        """Return the trace after the effects of one step, applied one after the other."""
        state, traced = self.state, list(self.effects)
        for effect in effects:
            if effect.cause.step is step:
                traced.append((effect, state))
                state = applied(effect, state)
        return replace(self, state=state, effects=tuple(traced), after={**self.after, step: state})

    def entering(self, state: S) -> Self:
        """Return the trace with another state as the input of the next step."""
        return replace(self, state=state)

    def at(self, cause: CauseT) -> S:
        """Return the state that a cause acts on; the state after its step if the cause is not in force."""
        return (
            self._state_by_key[cause.key] if cause.key in self._state_by_key else self.after.get(cause.step, self.state)
        )

    def subsequent_effects(self, cause: CauseT | None, *steps: Step) -> tuple[tuple[Effect[CauseT], S], ...]:
        """Return the effects of the given steps that act after a cause, each with the state that it acts on.

        All of these effects for None; a cause that is not in force counts as the last of its step.
        """
        later = self.effects
        if cause is not None:
            order = list(Step)
            index = next((n for n, (effect, _) in enumerate(later) if effect.cause.key == cause.key), None)
            passed = sum(order.index(effect.cause.step) <= order.index(cause.step) for effect, _ in later)
            later = later[passed if index is None else index + 1 :]
        return tuple(effect for effect in later if effect[0].cause.step in steps)

    @cached_property
    def _state_by_key(self) -> dict[str, S]:
        return {effect.cause.key: state for effect, state in self.effects}
