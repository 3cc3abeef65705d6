"""Units of raw files: conversion to a column's unit, and units in the names of raw columns."""

from __future__ import annotations

import difflib
import math
import re
from dataclasses import dataclass

from truing.schemas.column import Column

_ARC = math.pi / 180.0
_POUND_FORCE = 4.4482216152605
_INCH = 0.0254
# unit -> (dimension, factor to SI, offset in SI)
_UNITS: dict[str, tuple[str, float, float]] = {
    "m": ("length", 1.0, 0.0),
    "cm": ("length", 1e-2, 0.0),
    "mm": ("length", 1e-3, 0.0),
    "um": ("length", 1e-6, 0.0),
    "nm": ("length", 1e-9, 0.0),
    "in": ("length", _INCH, 0.0),
    "mil": ("length", 1e-3 * _INCH, 0.0),
    "ft": ("length", 12.0 * _INCH, 0.0),
    "rad": ("angle", 1.0, 0.0),
    "mrad": ("angle", 1e-3, 0.0),
    "urad": ("angle", 1e-6, 0.0),
    "deg": ("angle", _ARC, 0.0),
    "arcmin": ("angle", _ARC / 60.0, 0.0),
    "arcsec": ("angle", _ARC / 3600.0, 0.0),
    "gon": ("angle", math.pi / 200.0, 0.0),
    "N": ("force", 1.0, 0.0),
    "mN": ("force", 1e-3, 0.0),
    "kN": ("force", 1e3, 0.0),
    "kgf": ("force", 9.80665, 0.0),
    "lbf": ("force", _POUND_FORCE, 0.0),
    "kip": ("force", 1e3 * _POUND_FORCE, 0.0),
    "N m": ("torque", 1.0, 0.0),
    "N mm": ("torque", 1e-3, 0.0),
    "kN m": ("torque", 1e3, 0.0),
    "lbf in": ("torque", _POUND_FORCE * _INCH, 0.0),
    "lbf ft": ("torque", _POUND_FORCE * 12.0 * _INCH, 0.0),
    "kip in": ("torque", 1e3 * _POUND_FORCE * _INCH, 0.0),
    "kip ft": ("torque", 1e3 * _POUND_FORCE * 12.0 * _INCH, 0.0),
    "Pa": ("pressure", 1.0, 0.0),
    "hPa": ("pressure", 1e2, 0.0),
    "kPa": ("pressure", 1e3, 0.0),
    "mbar": ("pressure", 1e2, 0.0),
    "bar": ("pressure", 1e5, 0.0),
    "mmHg": ("pressure", 133.322387415, 0.0),
    "inHg": ("pressure", 3386.389, 0.0),
    "V": ("voltage", 1.0, 0.0),
    "mV": ("voltage", 1e-3, 0.0),
    "uV": ("voltage", 1e-6, 0.0),
    "mV/V": ("voltage", 1e-3, 0.0),  # of a bridge, at a supply of 1 V
    "uV/V": ("voltage", 1e-6, 0.0),
    "1": ("share", 1.0, 0.0),
    "%": ("share", 1e-2, 0.0),
    "s": ("time", 1.0, 0.0),
    "ns": ("time", 1e-9, 0.0),
    "ms": ("time", 1e-3, 0.0),
    "us": ("time", 1e-6, 0.0),
    "min": ("time", 60.0, 0.0),
    "h": ("time", 3600.0, 0.0),
    "d": ("time", 86400.0, 0.0),
    "K": ("temperature", 1.0, 0.0),
    "degC": ("temperature", 1.0, 273.15),
    "degF": ("temperature", 5.0 / 9.0, 459.67 * 5.0 / 9.0),
}
_NUMBER = re.compile(r"\d+(\.\d*)?([eE][-+]?\d+)?")
_SPELT = {"µm": "um", "μm": "um", "°": "deg", '"': "in", "inch": "in", "°C": "degC", "°F": "degF", "Nm": "N m"}
LONGEST_NAME = 200  # characters of a column: the search for its meaning tries many ways to split it
_BRACKETS = re.compile(r"^(?P<name>.*?)\s*[\[({]\s*(?P<unit>[^\[\](){}]+?)\s*[\])}]$")
_BEHIND = re.compile(
    r"^(?P<name>.*?)(?:\s*/\s*|[\s_]+)(?P<unit>mm|cm|um|µm|μm|nm|m|in|deg|rad|mrad|urad|arcsec|arcmin|s|ms|us|ns|K|degC|°C|°)$"
)
_SPELT_OUT = {
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
    "c": "degC",
    "inches": "in",
    "feet": "ft",
    "foot": "ft",
    "millimeters": "mm",
    "millimetres": "mm",
    "micrometer": "um",
    "micrometers": "um",
    "seconds": "s",
    "minutes": "min",
    "nmm": "N mm",
    "n·mm": "N mm",
    "n*mm": "N mm",
    "n·m": "N m",
    "n*m": "N m",
    "n.m": "N m",
    "sec": "s",
    "knm": "kN m",
    "newton": "N",
    "newtons": "N",
    "mv/v": "mV/V",
    "µv/v": "uV/V",
    "μv/v": "uV/V",
    "vdc": "V",
    "mvdc": "mV",
    "v dc": "V",
    "mv dc": "mV",
    "micron": "um",
    "microns": "um",
    '"': "arcsec",
    "''": "arcsec",
}
_K = {"1": 1.0, "2": 2.0, "3": 3.0}
_SIGMAS = re.compile(r"(?<![\d.])(?P<k>[123])[\s_*·-]*(?:σ|sigma|s|sd|std)(?![a-z])", re.IGNORECASE)
_FACTOR = re.compile(r"\bk\s*=\s*(?P<k>\d+(?:[.,]\d+)?)", re.IGNORECASE)
_EXPANDED = re.compile(r"(?<![A-Za-z])U(?:[\s_]?\(?\s*(?:95|0[.,]95)\s*%?\s*\)?)?[\s_]*(?:[XYZxyz]|pos|P)?(?![A-Za-z])")
_LIMIT = re.compile(r"(?<![A-Za-z])MPE(?![a-z])")
_TWO = 2.0


class UnknownUnit(ValueError):
    """A unit that is unknown, or cannot be converted as requested."""


def conversion(unit: str, wanted: str) -> tuple[float, float]:
    """Return factor and offset of ``wanted = factor * unit + offset``; raises UnknownUnit with valid alternatives.

    A unit may be a multiple of another one, such as a count of 0.618 nm: "0.618 nm".
    """
    dimension, factor, offset = _counted(unit)
    wanted_dimension, wanted_factor, wanted_offset = _counted(wanted)
    if dimension != wanted_dimension:
        raise UnknownUnit(f"a unit of {wanted_dimension}: {', '.join(_units_of_dimension(wanted_dimension))}")
    return factor / wanted_factor, (offset - wanted_offset) / wanted_factor


def _counted(unit: str) -> tuple[str, float, float]:
    """Return dimension, factor and offset of a unit, or of a multiple of it with a leading number."""
    number, _, bare = unit.strip().partition(" ")
    if not bare or _NUMBER.fullmatch(number) is None:
        return _parsed_unit(unit)
    dimension, factor, offset = _parsed_unit(bare)
    if offset or not 0.0 < float(number) < math.inf:
        raise UnknownUnit("a unit, or a positive number of a unit that begins at zero, such as 0.618 nm")
    return dimension, float(number) * factor, 0.0


def _parsed_unit(unit: str) -> tuple[str, float, float]:
    name = _SPELT.get(unit.strip(), unit.strip())
    if name not in _UNITS:
        close = difflib.get_close_matches(name, _UNITS, n=1)
        hint = f"did you mean {close[0]}?" if close else f"one of {', '.join(_UNITS)}"
        raise UnknownUnit(f"a known unit; {hint}")
    return _UNITS[name]


def _units_of_dimension(dimension: str) -> list[str]:
    return [unit for unit, (kind_of_unit, _, _) in _UNITS.items() if kind_of_unit == dimension]


@dataclass(frozen=True)
class Expanded:
    """An expanded uncertainty: its coverage factor, and the reason to assume it."""

    coverage: float
    why: str


def bare_and_unit(name: str) -> tuple[str, str | None]:
    """Return a raw name without its unit, and the unit in our notation; None without one.

    A text of more than LONGEST_NAME characters is no name: it keeps what it ends with.
    """
    if len(name) > LONGEST_NAME:
        return name.strip(), None
    for pattern in (_BRACKETS, _BEHIND):
        match = pattern.match(name.strip())
        unit = match and known_unit(match["unit"])
        if match and unit and match["name"].strip(" _"):
            return match["name"].strip(" _"), unit
    return name.strip(), None


def known_unit(text: str) -> str | None:
    """Return the unit of a text; None if it is none."""
    unit = _SPELT_OUT.get(text.strip().casefold(), text.strip())
    try:
        conversion(unit, unit)
    except UnknownUnit:
        return None
    return _SPELT.get(unit, unit)


def may_be(unit: str | None, column: Column | None) -> bool:
    """True if a column may have a unit: a length in radians may not."""
    return unit is None or column is None or not column.unit or is_convertible(unit, column.unit)


def is_convertible(unit: str, wanted: str) -> bool:
    """True if numbers in a unit can be given in another one."""
    try:
        conversion(unit, wanted)
    except UnknownUnit:
        return False
    return True


def unit_in_brackets(name: str) -> str | None:
    """Return the unit in brackets after a name, which cannot be part of it; None without one."""
    match = _BRACKETS.match(name.strip())
    return known_unit(match["unit"]) if match else None


def expanded(name: str) -> Expanded | None:
    """Return the expanded uncertainty or limit of error that a raw name means; None for other names."""
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
