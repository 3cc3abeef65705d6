"""What the name of a raw column says beside its name: the unit behind it, and that it is an expanded uncertainty."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

from truing.formats.units import UnknownUnit, conversion
from truing.schemas.column import Column

_BRACKETS = re.compile(r"^(?P<name>.*?)\s*[\[({]\s*(?P<unit>[^\[\](){}]+?)\s*[\])}]$")
_BEHIND = re.compile(
    r"^(?P<name>.*?)(?:\s*/\s*|[\s_]+)(?P<unit>mm|cm|um|µm|μm|nm|m|in|deg|rad|mrad|urad|s|ms|K|degC|°C|°)$"
)
_SPELT = {
    "meter": "m",
    "metre": "m",
    "meters": "m",
    "metres": "m",
    "millimeter": "mm",
    "millimetre": "mm",
    "degree": "deg",
    "degrees": "deg",
    "grad": "deg",
    "radian": "rad",
    "radians": "rad",
    "celsius": "degC",
    "nmm": "N mm",
    "n·mm": "N mm",
    "n*mm": "N mm",
    "n·m": "N m",
    "n*m": "N m",
    "n.m": "N m",
    "sec": "s",
    "micron": "um",
    "microns": "um",
    '"': "arcsec",
    "''": "arcsec",
}
_K = {"1": 1.0, "2": 2.0, "3": 3.0}
_SIGMAS = re.compile(r"(?<![\d.])(?P<k>[123])[\s_*·]*(?:σ|sigma|s|sd|std)(?![a-z])", re.IGNORECASE)
_FACTOR = re.compile(r"\bk\s*=\s*(?P<k>\d+(?:[.,]\d+)?)", re.IGNORECASE)
_EXPANDED = re.compile(r"(?<![A-Za-z])U(?:[\s_]?\(?\s*(?:95|0[.,]95)\s*%?\s*\)?)?[\s_]*(?:[XYZxyz]|pos|P)?(?![A-Za-z])")
_LIMIT = re.compile(r"(?<![A-Za-z])MPE(?![a-z])")
_TWO = 2.0


@dataclass(frozen=True)
class Expanded:
    """An expanded uncertainty: its coverage factor, and why it is taken for that."""

    coverage: float
    why: str


def bare_and_unit(name: str) -> tuple[str, str | None]:
    """A raw name without its unit, and the unit as it is known here; None where it names none."""
    for pattern in (_BRACKETS, _BEHIND):
        match = pattern.match(name.strip())
        unit = match and known_unit(match["unit"])
        if match and unit and match["name"].strip(" _"):
            return match["name"].strip(" _"), unit
    return name.strip(), None


def known_unit(text: str) -> str | None:
    """The unit that a text means; None where it is none."""
    unit = _SPELT.get(text.strip().casefold(), text.strip())
    try:
        conversion(unit, unit)
    except UnknownUnit:
        return None
    return unit


def may_be(unit: str | None, column: Column | None) -> bool:
    """Whether a column may come in a unit: a length in radians is none."""
    if unit is None or column is None or not column.unit:
        return True
    try:
        conversion(unit, column.unit)
    except UnknownUnit:
        return False
    return True


def unit_in_brackets(name: str) -> str | None:
    """The unit that stands in brackets behind a name, which cannot be part of it; None where none does."""
    match = _BRACKETS.match(name.strip())
    return known_unit(match["unit"]) if match else None


def expanded(name: str) -> Expanded | None:
    """Whether a raw name says that it holds an expanded uncertainty, or a limit of error; None where it does not."""
    bare, _ = bare_and_unit(name)
    if match := _FACTOR.search(name):
        return Expanded(float(match["k"].replace(",", ".")), f"{match[0]} in its name")
    if (match := _SIGMAS.search(bare)) and match["k"] != "1":
        return Expanded(_K[match["k"]], f"{match['k']} sigma in its name")
    if _LIMIT.search(bare):
        return Expanded(round(math.sqrt(3.0), 4), "a limit of error (MPE) whose values are equally likely")
    if _EXPANDED.search(bare):
        return Expanded(_TWO, "U stands for an expanded uncertainty, usually with k = 2 (95 %)")
    return None
