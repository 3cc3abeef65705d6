"""Units that raw files come in, and what a table's column is given in."""

from __future__ import annotations

import difflib
import math
import re

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
    "1": ("share", 1.0, 0.0),
    "%": ("share", 1e-2, 0.0),
    "s": ("time", 1.0, 0.0),
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


class UnknownUnit(ValueError):
    """A unit that is not known, or that cannot become the unit it is to become."""


def conversion(unit: str, wanted: str) -> tuple[float, float]:
    """Factor and offset with ``wanted = factor * unit + offset``; raises UnknownUnit with what would do.

    A unit may be so many of another, as a count of 0.618 nm: "0.618 nm".
    """
    dimension, factor, offset = _counted(unit)
    wanted_dimension, wanted_factor, wanted_offset = _counted(wanted)
    if dimension != wanted_dimension:
        raise UnknownUnit(f"a unit of {wanted_dimension}: {', '.join(_of_dimension(wanted_dimension))}")
    return factor / wanted_factor, (offset - wanted_offset) / wanted_factor


def _counted(unit: str) -> tuple[str, float, float]:
    """The dimension, factor and offset of a unit, or of so many of it where a number stands before."""
    number, _, bare = unit.strip().partition(" ")
    if not bare or _NUMBER.fullmatch(number) is None:
        return _known(unit)
    dimension, factor, offset = _known(bare)
    if offset or not 0.0 < float(number) < math.inf:
        raise UnknownUnit("a unit, or a positive number of a unit that begins at zero, such as 0.618 nm")
    return dimension, float(number) * factor, 0.0


def _known(unit: str) -> tuple[str, float, float]:
    name = _SPELT.get(unit.strip(), unit.strip())
    if name not in _UNITS:
        close = difflib.get_close_matches(name, _UNITS, n=1)
        hint = f"did you mean {close[0]}?" if close else f"one of {', '.join(_UNITS)}"
        raise UnknownUnit(f"a known unit; {hint}")
    return _UNITS[name]


def _of_dimension(dimension: str) -> list[str]:
    return [unit for unit, (found, _, _) in _UNITS.items() if found == dimension]
