"""Cause: elastic elongation of legs under the weight that they carry."""

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

# Column with the mass on the platform at each pose, kg.
PAYLOAD = "payload_kg"
# Compliance of a leg of 10 N/um, m/N.
_PLAUSIBLE = 1e-7
_DETERMINATE = 6  # number of legs whose forces follow from the load alone


@dataclass(frozen=True)
class LegCompliance(SharedOrPerLeg):
    """Legs are longer by compliance times the tensile force from the weight of a mass on the platform.

    All legs share one compliance, or each of ``legs`` has its own. ``up`` is a unit vector of the base frame,
    ``mass_kg`` the mass (0: the column payload_kg), ``centre`` its centre of gravity in the platform frame, m.
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
        """Return one candidate for all legs together, every single leg and every pair, if the mass and the up direction
        are known.

        None for other than six legs, whose forces do not follow from the load alone.
        """
        weight, column = scene.weight, scene.covariates.get(PAYLOAD)
        if weight is None or scene.legs != _DETERMINATE:
            return ()
        if column is not None and np.isfinite(column).all() and np.any(column != 0.0):
            with_weight = replace(self, up=weight.up, centre=weight.centre)
        elif weight.mass_kg:
            with_weight = replace(self, up=weight.up, mass_kg=weight.mass_kg, centre=weight.centre)
        else:
            return ()
        return super(LegCompliance, with_weight).candidates(scene)

    def needs(self, legs: int) -> tuple[str, ...]:
        """Return the mass column, if the mass is given for each pose."""
        return () if self.mass_kg else (PAYLOAD,)

    def one_sided(self, legs: int) -> tuple[int, ...]:
        """Return every compliance: none can be negative."""
        return tuple(range(len(self.parameters(legs))))

    def change(self, state: State, values: NDArray) -> Change:
        """Return d l / d compliance: the tension of the leg."""
        mass = self.mass_kg or np.asarray(state.covariates[PAYLOAD])[..., None]
        return Change({"l": self.of_legs(mass * tensions(state, self.up, self.centre))}, len(values))
