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
    "dms": ("angle", _ARC, 0.0),  # texts of degrees, minutes and seconds: truing.formats.sexagesimal
    "N": ("force", 1.0, 0.0),
    "mN": ("force", 1e-3, 0.0),
    "kN": ("force", 1e3, 0.0),
    "daN": ("force", 10.0, 0.0),
    "kgf": ("force", 9.80665, 0.0),
    "gf": ("force", 9.80665e-3, 0.0),
    "lbf": ("force", _POUND_FORCE, 0.0),
    "ozf": ("force", _POUND_FORCE / 16.0, 0.0),
    "kip": ("force", 1e3 * _POUND_FORCE, 0.0),
    "N m": ("torque", 1.0, 0.0),
    "N mm": ("torque", 1e-3, 0.0),
    "kN m": ("torque", 1e3, 0.0),
    "lbf in": ("torque", _POUND_FORCE * _INCH, 0.0),
    "lbf ft": ("torque", _POUND_FORCE * 12.0 * _INCH, 0.0),
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
    "V/V": ("voltage", 1.0, 0.0),
    "mV/V": ("voltage", 1e-3, 0.0),  # of a bridge, at a supply of 1 V
    "uV/V": ("voltage", 1e-6, 0.0),
    "px": ("pixels", 1.0, 0.0),
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
_SPELT |= dict.fromkeys(("pix", "pixel", "pixels"), "px")
LONGEST_NAME = 200  # characters of a column: the search for its meaning tries many ways to split it
_BRACKETS = re.compile(r"^(?P<name>.*?)\s*[\[({]\s*(?P<unit>[^\[\](){}]+?)\s*[\])}]$")
_BEHIND = re.compile(
    r"^(?P<name>.*?)(?:\s*/\s*|[\s_]+)(?P<unit>mm|cm|um|µm|μm|nm|m|in|deg|rad|mrad|urad|arcsec|arcmin|s|ms|us|ns|K|degC|°C|°)$"
)
_FORCES = {  # other spellings, in lower case
    "kgf": "kgf",
    "kp": "kgf",
    "gf": "gf",
    **dict.fromkeys(("lbf", "lb", "lbs", "pound", "pounds", "pound-force", "pounds-force"), "lbf"),
    **dict.fromkeys(("ozf", "oz", "ounce", "ounces", "ounce-force"), "ozf"),
    **dict.fromkeys(("kip", "kips", "klbf"), "kip"),
    **dict.fromkeys(("newton", "newtons"), "N"),
}
_WEIGHTS = {"kg": "kgf", "g": "gf"}  # masses by themselves; forces times a length
_LENGTHS = {
    **dict.fromkeys(("in", "inch", "inches"), "in"),
    **dict.fromkeys(("ft", "foot", "feet"), "ft"),
    **dict.fromkeys(("m", "meter", "meters", "metre", "metres"), "m"),
    **{length: length for length in ("cm", "mm")},
}
_LENGTH_NAMES = tuple(_LENGTHS)
_TIMES = re.compile(r"[\s·⋅∙•*×._-]*$")  # between the two units of a torque
_STROKE = re.compile(r"\s*/\s*")
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
    "sec": "s",
    "knm": "kN m",
    **dict.fromkeys(("volt", "volts"), "V"),
    **dict.fromkeys(("millivolt", "millivolts"), "mV"),
    "newton": "N",
    "newtons": "N",
    "deg c": "degC",
    "deg f": "degF",
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
_MARKED = re.compile(r"(?P<between>\s+in\s+|\s*[/,]\s*|[\s_]+)(?=(?P<unit>[^\s\d/,_].*)$)")  # of forces and voltages
_MARKED_DIMENSIONS = ("force", "torque", "voltage")
_NO_UNIT = {"", "-", "--", "x", "y", "z", "none", "n/a"}
_TOKENS = re.compile(r"[^\W\d_]+|[%°]")
# parts of units that are not converted here
_OTHER_UNITS = {"kg", "g", "t", "lbm", "slug", "dyn", "mm", "counts", "count", "cts", "digit", "digits", "lsb", "inc"}
_OTHER_UNITS |= {"bit", "bits", "psi", "hz", "khz", "a", "ma", "w", "j", "ohm", "ppm", "fs", "fso", "ro", "yd", "mile"}
_OTHER_UNITS |= {"step", "steps", "pulse", "pulses", "rev", "turn", "turns", "tick", "ticks", "thou", "tons", "ton"}
_K = {"1": 1.0, "2": 2.0, "3": 3.0}
_SIGMAS = re.compile(r"(?<![\d.])(?P<k>[123])[\s_*·-]*(?:σ|sigma|s|sd|std)(?![a-z])", re.IGNORECASE)
_FACTOR = re.compile(r"\bk\s*=\s*(?P<k>\d+(?:[.,]\d+)?)", re.IGNORECASE)
_EXPANDED = re.compile(r"(?<![A-Za-z])U(?:[\s_]?\(?\s*(?:95|0[.,]95)\s*%?\s*\)?)?[\s_]*(?:[XYZxyz]|pos|P)?(?![A-Za-z])")
_LIMIT = re.compile(r"(?<![A-Za-z])MPE(?![a-z])")
_TWO = 2.0


class UnknownUnit(ValueError):
    """A unit that is unknown, or cannot be converted as requested."""


class _UnknownName(UnknownUnit):
    """A name of no unit; the closest one is searched where the message is read, not for each cell of a table."""

    def __str__(self) -> str:
        close = difflib.get_close_matches(self.args[0], _UNITS, n=1)
        hint = f"did you mean {close[0]}?" if close else f"one of {', '.join(_UNITS)}"
        return f"a known unit; {hint}"


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
    name = _spelling(unit)
    if name not in _UNITS:
        if (parts := _torque_parts(name)) is not None:
            (_, force, _), (_, length, _) = map(_parsed_unit, parts)
            return "torque", force * length, 0.0
        raise _UnknownName(name)
    return _UNITS[name]


def _spelling(unit: str) -> str:
    """Return a unit in our notation; the text itself if it is no known unit."""
    text = _STROKE.sub("/", unit.strip())
    if text in _UNITS or text in _SPELT:
        return _SPELT.get(text, text)
    parts = _torque_parts(text)
    return " ".join(parts) if parts is not None else _FORCES.get(text.casefold(), text)


def _torque_parts(text: str) -> tuple[str, str] | None:
    """Return force and length of a torque such as ``lbf-in``, ``in·lb`` or ``Nmm``; None for other texts."""
    folded = text.casefold()
    if not folded.startswith(_LENGTH_NAMES) and not folded.endswith(_LENGTH_NAMES):
        return None
    for index in range(1, len(text)):
        head, length = _TIMES.sub("", text[:index]), _LENGTHS.get(text[index:].casefold())
        if length is not None and (force := _force_of(head)) is not None:
            return force, length
        is_parted = head != text[:index]
        length, force = _LENGTHS.get(head.casefold()), _force_of(text[index:])
        if length is not None and force is not None and (is_parted or (length in ("in", "ft") and force != "gf")):
            return force, length  # without a mark between them, mN is no torque
    return None


def _force_of(text: str) -> str | None:
    """Return the unit of force of a text, in which a mass means its weight; None for other texts."""
    if text in _UNITS:
        return text if _UNITS[text][0] == "force" else None
    return _FORCES.get(text.casefold()) or _WEIGHTS.get(text.casefold())


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
    text = name.strip()
    for match in (_BRACKETS.match(text), *_MARKED.finditer(text), _BEHIND.match(text)):
        if match is None or (unit := known_unit(match["unit"])) is None:
            continue
        bare = re.sub(r"\s+in$", "", match["name"] if match.re is not _MARKED else text[: match.start()]).strip(" _,")
        if bare and (match.re is not _MARKED or _is_marked(unit, match["between"])):
            return bare, unit
    return text, None


def _is_marked(unit: str, between: str) -> bool:
    """True if a unit behind a name is of a force or voltage; V after a blank or stroke is an angle's name."""
    return dimension(unit) in _MARKED_DIMENSIONS and (unit != "V" or between.strip(" ") in ("_", ",", "in"))


def known_unit(text: str) -> str | None:
    """Return the unit of a text; None if it is none."""
    bare = _STROKE.sub("/", text.strip())
    unit = _spelling(_SPELT_OUT.get(bare.casefold(), bare))
    try:
        conversion(unit, unit)
    except UnknownUnit:
        return None
    return unit


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


def dimension(unit: str) -> str:
    """Dimension of a known unit, such as length; raises UnknownUnit."""
    return _counted(unit)[0]


def unread_unit(name: str, column: Column) -> str | None:
    """Return the words in brackets after a raw name, if they are no unit that its column may have; else None."""
    match = _BRACKETS.match(name.strip())
    if match is None or match["unit"].strip().casefold() in _NO_UNIT or match["unit"].strip().isdigit():
        return None
    unit = known_unit(match["unit"])
    return match["unit"].strip() if unit is None or not may_be(unit, column) else None


def is_like_a_unit(words: str) -> bool:
    """True if words are symbols of units, also of such that are not converted here, or one word with such a part."""
    tokens = _TOKENS.findall(words)
    known = [known_unit(token) is not None or token.casefold() in _OTHER_UNITS for token in tokens]
    return bool(tokens) and (all(known) or (any(known) and " " not in words))


def unit_in_brackets(name: str) -> str | None:
    """Return the unit in brackets after a name, which cannot be part of it; None without one."""
    match = _BRACKETS.match(name.strip())
    return known_unit(match["unit"]) if match else None


def expanded(name: str) -> Expanded | None:
    """Return the expanded uncertainty or limit of error that a raw name means; None for other names."""
    bare, _ = bare_and_unit(name)
    if match := _FACTOR.search(name):
        return Expanded(float(match["k"].replace(",", ".")), f"{match[0]} in its name")
    if match := _SIGMAS.search(bare):
        if match["k"] == "1":
            return None
        return Expanded(_K[match["k"]], f"{match['k']} sigma in its name")
    if _LIMIT.search(bare):
        return Expanded(round(math.sqrt(3.0), 4), "a limit of error (MPE) whose values are equally likely")
    if _EXPANDED.search(bare):
        return Expanded(_TWO, "U stands for an expanded uncertainty, usually with k = 2 (95 %)")
    return None
