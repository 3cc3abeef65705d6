"""Units of the tables as D-SI writes units of the SI, and by how much numbers change with them."""

from __future__ import annotations

import math
import re

_BASE = {
    "mm": (1e-3, r"\metre"),
    "um": (1e-6, r"\metre"),
    "m": (1.0, r"\metre"),
    "rad": (1.0, r"\radian"),
    "mrad": (1e-3, r"\radian"),
    "urad": (1e-6, r"\radian"),
    "arcsec": (math.pi / 648000.0, r"\radian"),
    "deg": (math.pi / 180.0, r"\radian"),
    "N": (1.0, r"\newton"),
    "V": (1.0, r"\volt"),
    "mV": (1e-3, r"\volt"),
    "K": (1.0, r"\kelvin"),
    "s": (1.0, r"\second"),
    "min": (60.0, r"\second"),
    "h": (3600.0, r"\second"),
    "Hz": (1.0, r"\hertz"),
    "Pa": (1.0, r"\pascal"),
    "hPa": (1e2, r"\pascal"),
    "%": (1e-2, ""),
    "1": (1.0, ""),
}
_PART = re.compile(r"^([A-Za-z%]+|1)\^?(-?\d+)?$")


def si_unit(unit: str) -> tuple[float, str] | None:
    """The factor to SI and the D-SI unit of ``N m/mV``, ``1/K``, ``m/(N m)``; None for a unit that it cannot write."""
    parts = unit.strip().split("/")
    factor, written = 1.0, []
    for place, part in enumerate(parts):
        for token in part.strip().strip("()").replace("*", " ").split():
            found = _PART.match(token)
            if found is None or found[1] not in _BASE:
                return None
            power = int(found[2] or 1) * (-1 if place else 1)
            scale, name = _BASE[found[1]]
            factor *= scale**power
            if name:
                written.append(name if power == 1 else rf"{name}\tothe{{{power}}}")
    return factor, "".join(written) or r"\one"
