"""Legs give way under what they carry."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from truing.simulation.cause import Parameter, Step
from truing.simulation.change import Change
from truing.simulation.inputs import Missing
from truing.simulation.mechanisms.causes.per_leg import SharedOrPerLeg
from truing.simulation.mechanisms.point_causes import PointScene
from truing.simulation.mechanisms.state import State
from truing.simulation.mechanisms.weight import tensions

# What a pose's mass may be written down as, kg.
PAYLOAD = "payload_kg"
# A leg of 10 N/um.
_PLAUSIBLE = 1e-7
_DETERMINATE = 6  # legs whose forces follow from the load alone


@dataclass(frozen=True)
class LegCompliance(SharedOrPerLeg):
    """Legs are longer by compliance times the force that pulls at them: that of a mass which they carry.

    All legs by one compliance, or each of ``legs`` by its own. ``up`` is a unit vector of the base frame, ``mass_kg``
    what they carry (0: the column payload_kg), with its ``centre`` of gravity in the platform frame, m.
    """

    up: tuple[float, float, float] = (0.0, 0.0, 1.0)
    mass_kg: float = 0.0
    centre: tuple[float, float, float] = (0.0, 0.0, 0.0)

    id = "leg-compliance"
    lacking = Missing.PAYLOAD
    step = Step.STRUCTURE
    reads = frozenset({"pose", "rho", "a", "b", "u", "delta_bz"})
    parameter = Parameter("compliance", "um/N", _PLAUSIBLE, 1e-6)

    def candidates(self, scene: PointScene) -> Sequence[Self]:
        """Return all legs alike, every single one, every pair; none where nothing tells what legs carry, or where up
        is, and none for other than six legs, which share a load as their stiffness has it."""
        weight, column = scene.weight, scene.covariates.get(PAYLOAD)
        if weight is None or scene.legs != _DETERMINATE:
            return ()
        if column is not None and np.isfinite(column).all() and np.any(column != 0.0):
            own = replace(self, up=weight.up, centre=weight.centre)
        elif weight.mass_kg:
            own = replace(self, up=weight.up, mass_kg=weight.mass_kg, centre=weight.centre)
        else:
            return ()
        return super(LegCompliance, own).candidates(scene)

    def needs(self, legs: int) -> tuple[str, ...]:
        """Return the mass, where it is told pose by pose."""
        return () if self.mass_kg else (PAYLOAD,)

    def one_sided(self, legs: int) -> tuple[int, ...]:
        """Return every compliance: no leg grows under pressure."""
        return tuple(range(len(self.parameters(legs))))

    def change(self, state: State, values: NDArray) -> Change:
        """Return d l / d compliance: the tension of the leg."""
        mass = self.mass_kg or np.asarray(state.covariates[PAYLOAD])[..., None]
        return Change({"l": self.of_legs(mass * tensions(state, self.up, self.centre))}, len(values))
