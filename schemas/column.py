"""Definition of a column of an artifact: name, type, unit, bounds, meaning."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any, Literal

# Larger than any measurement in any unit; its fourth power is finite, so that later computations do not overflow.
LARGEST = 1e30
# Smaller than any measurement except 0; its square and the inverse of that are finite.
SMALLEST = 1e-30
# Plausible standard deviations of a coordinate, mm: from a picometre to a kilometre.
LEAST_SIGMA_MM, MOST_SIGMA_MM = 1e-9, 1e6
# Plausible standard deviations by unit, from below any resolution to beyond any measurement.
SIGMA_BOUNDS = {
    "mm": (LEAST_SIGMA_MM, MOST_SIGMA_MM),
    "m": (1e-12, 1e3),
    "um": (1e-6, 1e6),
    "arcsec": (1e-6, 1e6),
    "rad": (1e-12, 3.2),
    "deg": (1e-10, 180.0),
    "px": (1e-6, 1e4),
}

Kind = Literal["identifier", "text", "integer", "real", "flag"]


@dataclass(frozen=True)
class Column:
    """One named quantity; the same name has the same meaning in every table.

    ``identifier`` columns are int64 if every value of the campaign is an integer, else text. ``family`` is a regular
    expression if one definition covers numbered columns (``rho1_mm``, ``rho2_mm``, ...).
    """

    name: str
    kind: Kind
    meaning: str
    unit: str = ""
    minimum: float | None = None
    maximum: float | None = None
    nullable: bool = False
    choices: tuple[str, ...] = ()
    family: str = ""

    def matches(self, name: str) -> bool:
        """True if this definition covers the column called ``name``."""
        return re.fullmatch(self.family, name) is not None if self.family else name == self.name


def real(name: str, unit: str, meaning: str, **bounds: Any) -> Column:
    """A number with a unit."""
    return Column(name, "real", meaning, unit, **bounds)


def size(name: str, unit: str, meaning: str, *, nullable: bool = False) -> Column:
    """A number that is not below 0."""
    return Column(name, "real", meaning, unit, minimum=0.0, nullable=nullable)


def share(name: str, meaning: str, *, nullable: bool = False) -> Column:
    """A number from 0 to 1: a share or a probability."""
    return Column(name, "real", meaning, minimum=0.0, maximum=1.0, nullable=nullable)


def text(name: str, meaning: str, **rules: Any) -> Column:
    """Words, a name or a code."""
    return Column(name, "text", meaning, **rules)


def integer(name: str, meaning: str, **bounds: Any) -> Column:
    """A whole number."""
    return Column(name, "integer", meaning, **bounds)


def flag(name: str, meaning: str, *, nullable: bool = False) -> Column:
    """Yes or no."""
    return Column(name, "flag", meaning, nullable=nullable)
