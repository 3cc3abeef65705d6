"""Numbers of elastic parts, held to what materials and parts have; a likely other unit is told with the fault."""

from __future__ import annotations

from typing import Annotated

from pydantic import AfterValidator, Field

from truing.schemas.section import Positive

_STIFFEST_GPA = 2000.0  # diamond has 1200
_IN_GPA = {"MPa": 1e-3, "Pa": 1e-9}
_LIKELY_GPA = (0.5, _STIFFEST_GPA)
# No rod of a machine is thinner over its length; in metres it is a thousandth of what it was.
_THINNEST = 5e-4


def _is_modulus(value: float) -> float:
    if value <= _STIFFEST_GPA:
        return value
    low, high = _LIKELY_GPA
    known = ((unit, value * factor) for unit, factor in _IN_GPA.items())
    meant = [f"{size:g} ({value:g} in {unit})" for unit, size in known if low <= size <= high]
    raise ValueError(f"at most {_STIFFEST_GPA:g}" + (f"; did you mean {' or '.join(meant)}?" if meant else ""))


def thin_rod(what: str, diameter_mm: float, length_mm: float | None) -> None:
    """Raise ValueError where a rod is thinner than any, as one is whose diameter is in metres."""
    if length_mm and diameter_mm < _THINNEST * length_mm:
        raise ValueError(
            f"{what}.diameter_mm of at least 1/{1 / _THINNEST:g} of its length, {length_mm:g} mm; "
            f"did you mean {1e3 * diameter_mm:g} ({diameter_mm:g} in m)?"
        )


Modulus = Annotated[Positive, AfterValidator(_is_modulus)]
Poisson = Annotated[float, Field(gt=-1.0, lt=0.5)]
