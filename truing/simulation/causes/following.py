"""What an effect follows, in a form that nobody declared: one or two columns, and functions of them without a name."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truing.simulation.state import State

OWN_DRIVE, APPROACH, ORDER, TIME = "own drive", "approach", "order", "time_s"
LAST_STEP, MEMORY = "last step", "memory"
POLYNOMIAL, WAVES, ALL_DRIVES = "polynomial", "waves", "all drives"
# What is known of each actuator by itself: its own displacement, and how it came to the pose.
LOOKING_BACK = (APPROACH, LAST_STEP, MEMORY)
PER_ACTUATOR = (OWN_DRIVE, *LOOKING_BACK)


@dataclass(frozen=True)
class Following:
    """Functions of columns: ``columns`` (several: their product), brought to -1 .. 1 by centre and half range.

    A column is one of the configurations, ``rho3_mm`` (the displacement of that actuator, m), ``own drive`` (of each
    leg's own), ``approach``, ``last step`` or ``memory`` (the direction and the size of each actuator's last movement,
    the sum of all of them, fading). The form is Chebyshev polynomials of degree ``first`` .. ``degree``, cosines (slow
    waves) of so many half periods, or the displacements of all drives.
    """

    columns: tuple[str, ...] = ()
    centres: tuple[float, ...] = ()
    half_ranges: tuple[float, ...] = ()
    form: str = POLYNOMIAL
    degree: int = 1
    first: int = 1

    def basis(self, state: State) -> NDArray:
        """Return the functions' values (B, L or 1, m) at the poses of a state."""
        if self.form == ALL_DRIVES:
            return ((state.indicated - state.legs.rho0) / self.half_ranges[0])[:, None, :]
        x = self._product(state)
        functions = waves if self.form == WAVES else chebyshev
        return functions(x, self.degree)[..., self.first - 1 :]

    def size(self, legs: int) -> int:
        """Return the number of functions m."""
        return legs if self.form == ALL_DRIVES else self.degree - self.first + 1

    def names(self, legs: int, concerned: tuple[int, ...]) -> tuple[str, ...]:
        """Return the columns of the configurations that it follows, for the legs concerned."""
        found: list[str] = []
        for column in self.columns:
            own = column in PER_ACTUATOR
            found += [f"rho{leg}_mm" for leg in concerned] if own else [TIME if column == ORDER else column]
        if self.form == ALL_DRIVES:
            found = [f"rho{leg}_mm" for leg in range(1, legs + 1)]
        return tuple(dict.fromkeys(found))

    def needs(self, legs: int, concerned: tuple[int, ...]) -> tuple[str, ...]:
        """Return the columns without which it cannot be predicted: an order in time where it looks back."""
        looks_back = any(column in (*LOOKING_BACK, ORDER) for column in self.columns)
        return tuple(dict.fromkeys((*self.names(legs, concerned), *([TIME] if looks_back else []))))

    def _product(self, state: State) -> NDArray:
        product: NDArray | float = 1.0
        for column, centre, half in zip(self.columns, self.centres, self.half_ranges, strict=True):
            product = product * ((_value(state, column) - centre) / half)
        return np.asarray(product)


def chebyshev(x: NDArray, degree: int) -> NDArray:
    """Return T_1 .. T_degree of x (...), (..., degree)."""
    values = [np.ones_like(x), x]
    while len(values) <= degree:
        values.append(2 * x * values[-1] - values[-2])
    return np.stack(values[1 : degree + 1], -1)


def waves(x: NDArray, count: int) -> NDArray:
    """Return the first cosines of x (...) over -1 .. 1, of half a period, one, .., (..., count)."""
    return np.asarray(np.cos(np.pi / 2 * (x[..., None] + 1) * np.arange(1, count + 1)))


def drive_of(column: str) -> int | None:
    """Return which leg's displacement a column is, counted from 1; none where it is another."""
    number = column.removeprefix("rho").removesuffix("_mm")
    return int(number) if column == f"rho{number}_mm" and number.isdigit() else None


def _value(state: State, column: str) -> NDArray:
    """Return a column's values (B, L or 1)."""
    moved = state.indicated - state.legs.rho0
    leg = drive_of(column)
    if leg is not None and leg <= moved.shape[1]:  # bodies without legs may have such a column, too
        return moved[:, leg - 1 : leg]
    if column == OWN_DRIVE:
        return moved
    value = state.covariates[column]
    return value if value.ndim == 2 else value[:, None]
