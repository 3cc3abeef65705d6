"""How a state passes the simulated chain drive -> structure -> instrument, whatever is simulated."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Generic, Self, TypeVar

from truing.simulation.cause import CauseT, Effect, Step

S = TypeVar("S")


@dataclass(frozen=True)
class Trace(Generic[CauseT, S]):
    """A state as far as it has passed the chain, and how it came about.

    ``met`` is every effect so far, in the order in which they acted, with the state that it met; ``after`` the state
    that each step left.
    """

    state: S
    effects: tuple[tuple[Effect[CauseT], S], ...]
    after: dict[Step, S]

    def through(self, step: Step, effects: Sequence[Effect[CauseT]], applied: Callable[[Effect[CauseT], S], S]) -> Self:
        """Return the trace after the effects of a step, each of which acts on what those before it left."""
        state, met = self.state, list(self.effects)
        for effect in effects:
            if effect.cause.step is step:
                met.append((effect, state))
                state = applied(effect, state)
        return replace(self, state=state, effects=tuple(met), after={**self.after, step: state})

    def entering(self, state: S) -> Self:
        """Return the trace with the state that the next step meets."""
        return replace(self, state=state)

    def at(self, cause: CauseT) -> S:
        """Return the state that a cause meets, the last of its step where it is not in force."""
        return (
            self._state_by_key[cause.key] if cause.key in self._state_by_key else self.after.get(cause.step, self.state)
        )

    def subsequent_effects(self, cause: CauseT | None, *steps: Step) -> tuple[tuple[Effect[CauseT], S], ...]:
        """Return the effects of some steps: all, or those after a cause, the last of its step where not in force."""
        later = self.effects
        if cause is not None:
            order = list(Step)
            place = next((n for n, (own, _) in enumerate(later) if own.cause.key == cause.key), None)
            passed = sum(order.index(own.cause.step) <= order.index(cause.step) for own, _ in later)
            later = later[passed if place is None else place + 1 :]
        return tuple(one for one in later if one[0].cause.step in steps)

    @cached_property
    def _state_by_key(self) -> dict[str, S]:
        return {effect.cause.key: met for effect, met in self.effects}
