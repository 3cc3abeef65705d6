"""What no cause of the catalogue explains: legs whose effective reading follows something, in a form nobody declared.

It competes with the catalogue on equal terms, so that no named cause swallows what it does not explain.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truing.simulation.chain import Cause, Parameter, State, Step
from truing.simulation.legs import Change

# Effective readings off by this much are plausible of an actuator or a leg.
_PLAUSIBLE_M = 5e-6
OWN_DRIVE, APPROACH = "own drive", "approach"


@dataclass(frozen=True)
class Unexplained(Cause):
    """The effective reading of every leg follows a covariate, by Chebyshev polynomials of degree 1 .. degree.

    ``column`` names the covariate: ``own drive`` (m), ``approach`` (the direction of each actuator's last movement) or
    a column of the configurations; ``centre`` and ``half_range`` bring it to -1 .. 1.
    """

    column: str
    centre: float
    half_range: float
    degree: int

    id = "unexplained"
    step = Step.DRIVE

    @property
    def key(self) -> str:
        """Return the name that tells it from others of its kind."""
        return f"{self.id} {self.column} degree {self.degree}"

    @property
    def says(self) -> str:
        """Return what the data show of it."""
        return f"the legs' effective readings follow {self._in_words}"

    @property
    def confirm(self) -> str:
        """Return what to measure next."""
        return f"Repeat some poses at other values of {self._in_words}, everything else unchanged."

    @property
    def _in_words(self) -> str:
        return {OWN_DRIVE: "their own actuators' displacements", APPROACH: "the direction of approach"}.get(
            self.column, self.column
        )

    def follows(self, legs: int) -> tuple[str, ...]:
        """Return the columns of the configurations that it follows."""
        if self.column in (OWN_DRIVE, APPROACH):
            return tuple(f"rho{leg}_mm" for leg in range(1, legs + 1))
        return (self.column,)

    def parameters(self, legs: int) -> tuple[Parameter, ...]:
        """Return one amplitude per leg and degree, mm."""
        pairs = ((leg, degree) for leg in range(1, legs + 1) for degree in range(1, self.degree + 1))
        return tuple(Parameter(f"leg{leg}_degree{degree}", "mm", _PLAUSIBLE_M, 1e-3) for leg, degree in pairs)

    def settings(self) -> dict[str, str | float | int]:
        """Return what a model needs beside the parameters."""
        return {"column": self.column, "centre": self.centre, "half_range": self.half_range, "degree": self.degree}

    def change(self, state: State) -> Change:
        """Return d rho_i / d amplitude_jk = T_k(x_i) where i is j."""
        legs = state.legs.count
        basis = _chebyshev((self._value(state) - self.centre) / self.half_range, self.degree)
        rows = np.eye(legs)[:, :, None] * basis[:, :, None, :]
        return Change({"rho": rows.reshape(len(rows), legs, legs * self.degree)}, legs * self.degree)

    def _value(self, state: State) -> NDArray:
        if self.column == OWN_DRIVE:
            return state.indicated - state.legs.rho0
        value = state.covariates[self.column]
        return np.broadcast_to(value if value.ndim == 2 else value[:, None], state.rho.shape)


def _chebyshev(x: NDArray, degree: int) -> NDArray:
    """Return T_1 .. T_degree of x (...), (..., degree)."""
    values = [np.ones_like(x), x]
    while len(values) <= degree:
        values.append(2 * x * values[-1] - values[-2])
    return np.stack(values[1 : degree + 1], -1)
