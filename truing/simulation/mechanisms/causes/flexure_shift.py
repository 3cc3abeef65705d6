"""Flexures at both ends of the legs bend as beams, which brings a leg's joints nearer to each other, or apart."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truing.simulation.cause import Cause, Parameter, Scene, Step
from truing.simulation.change import Change
from truing.simulation.mechanisms.legs.flexure import circle_distance
from truing.simulation.mechanisms.legs.kinematics import leg_vectors, unit
from truing.simulation.mechanisms.state import State

_PLAUSIBLE_M = 0.01


@dataclass(frozen=True)
class FlexureShift(Cause):
    """Legs end in flexures of one length whose ends stay on a circle as they bend (telescope report, eq. 13-17).

    They are straight at the machine's reference, where it was assembled; bent ones change the distance between the
    joints' ideal pivots.
    """

    id = "flexure-shift"
    step = Step.STRUCTURE
    reads = frozenset({"pose", "rho", "a", "b", "u", "delta_bz", "straight", "home"})

    def candidates(self, scene: Scene) -> Sequence[Cause]:
        """Return the cause where there are legs."""
        return (self,) if scene.legs else ()

    def parameters(self, legs: int) -> tuple[Parameter, ...]:
        """Return the length of a flexure."""
        return (Parameter("flexure_length", "mm", _PLAUSIBLE_M, 1e-3),)

    def change(self, state: State, values: NDArray) -> Change:
        """Return how much longer a leg is between its pivots per length of its flexures: two ends less two halves."""
        z = unit(leg_vectors(state.legs, state.p, state.R, state.rho, state.delta_bz))
        seen = np.einsum("...ij,...kj,...lk->...li", state.R, state.home, state.straight)
        low, high = np.sum(z * state.straight, -1), np.sum(z * seen, -1)
        one = np.ones_like(low)
        shift = circle_distance(one, low).value + circle_distance(one, high).value - 1.0
        return Change({"l": shift[..., None]}, 1)
