"""Sizes of effects in units that laboratories use: micrometres per millimetre, per cent, ppm per kelvin."""

from __future__ import annotations

import math
import re

from truing.report.numbers import rough, with_uncertainty

# Units for dimensionless parameters.
_PER_CENT = (100.0, "%")
_BARE = {
    **dict.fromkeys(("kappa", "kappa_x", "kappa_y"), (1e3, "um/mm")),
    "K": (1e3, "um/mm"),
    "gain": _PER_CENT,
    "scale": (1e6, "ppm"),
    "loss": (1e6, "ppm"),
    **dict.fromkeys(("asymmetry", "cubic", "width", "fraction"), _PER_CENT),
    **dict.fromkeys(("share", "share_asymmetry", "share_growth"), _PER_CENT),
}
# Scales from this size on are given in per cent.
_LARGE_SCALE = 5e-4
_OTHERS = {
    "1/K": (1e6, "ppm/K"),
    "1/mm": (1e3, "um/mm2"),
    "1/mm2": (1e3, "um/mm3"),
    "mm/K": (1e3, "um/K"),
    "mm/mm": (1e3, "um/mm"),
    "rad": (180.0 / math.pi, "deg"),
    "m": (1e3, "N·m per kN"),  # a moment that comes with a force
    "rad/(N m)": (1e6, "urad/(N m)"),
    "1/m": (1e3, "N per kN·m"),  # a force that comes with a torque
}
_SPANS = ((5400.0, 1.0 / 3600.0, "h"), (120.0, 1.0 / 60.0, "min"))
# Lengths that come from a drawing or a ruler, not from an instrument.
_DRAWN = r"pitch|period|flexure_length|dead_path|(offset|arm)_[xyz]"
# Angles below this size, in rad, are given in arc seconds: 0.01 degrees.
_ARCSEC, _FEW_ARCSEC = 648e3 / math.pi, math.radians(0.01)
# Angles between a beam and an axis, not of an oscillation.
_SMALL_ANGLE = r"angle|tilt_\w+"


def stem(parameter: str) -> str:
    """Return the kind of a parameter, equal in every leg: ``gain`` of ``gain_3``, ``K`` of ``K16``."""
    if re.fullmatch(r"K\d+(_\d+)?", parameter):
        return "K"
    return re.sub(r"_\d+$", "", parameter)


def handy_unit(parameter: str, unit: str, size: float) -> tuple[float, str]:
    """Return factor and unit in which a parameter of about this size, or the first of several, is given."""
    quantity = stem(parameter.partition(" ")[0])
    if unit in ("", "1"):
        return _PER_CENT if quantity == "scale" and abs(size) >= _LARGE_SCALE else _BARE.get(quantity, (1.0, ""))
    if unit == "mm":
        return (1e3, "um") if abs(size) < 1.0 and not re.fullmatch(_DRAWN, quantity) else (1.0, "mm")
    if unit == "rad" and re.fullmatch(_SMALL_ANGLE, quantity):
        return 1e3, "mrad"
    if unit == "rad" and quantity != "phase" and 0.0 < abs(size) < _FEW_ARCSEC:
        return _ARCSEC, "arcsec"
    if unit == "s":
        return next(((factor, span) for least, factor, span in _SPANS if abs(size) >= least), (1.0, "s"))
    return _OTHERS.get(unit, (1.0, unit))


def size_text(parameter: str, value: object, sigma: float | None, unit: str) -> str:
    """Return a parameter in its handy unit, ``13.2 ± 0.4 um/mm``; text and counts as they are."""
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return "" if value is None else str(value)
    known = sigma is not None and math.isfinite(sigma)
    factor, handy = handy_unit(parameter, unit, max(abs(value), sigma or 0.0) if known else value)
    return with_uncertainty(factor * value, factor * sigma if known and sigma is not None else None, handy)


def plain_size(parameter: str, size: float, unit: str) -> str:
    """Return a size without uncertainty, to two digits: ``3.1 um/mm``."""
    factor, handy = handy_unit(parameter, unit, size)
    return f"{rough(factor * size)} {handy}".strip()
