"""One column of an artifact: name, type, unit, bounds, meaning."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Literal

# No measurement, in whatever unit; its fourth power is still a number, so that nothing later overflows.
LARGEST = 1e30
# Nor is anything this small but nothing; its square is still a number, and so is one over that.
SMALLEST = 1e-30
# Standard deviations of a coordinate, mm: a picometre is a hundredth of an atom, a kilometre no measurement.
LEAST_SIGMA_MM, MOST_SIGMA_MM = 1e-9, 1e6
# Standard deviations by unit: from what no instrument resolves to what is no measurement.
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
    """One named quantity; the same name means the same thing in every table.

    ``identifier`` columns are int64 where every value of the campaign is an integer, else text. ``family`` is a
    regular expression where one definition stands for numbered columns (``rho1_mm``, ``rho2_mm``, ...).
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
        """Whether this definition covers the column called ``name``."""
        return re.fullmatch(self.family, name) is not None if self.family else name == self.name


def real(name: str, unit: str, meaning: str, **bounds: object) -> Column:
    return Column(name, "real", meaning, unit, **bounds)  # type: ignore[arg-type]
