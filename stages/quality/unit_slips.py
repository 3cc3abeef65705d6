"""Probable unit of a declared standard deviation, by its ratio to the scatter."""

from __future__ import annotations

import math

IMPLAUSIBLE_RATIO = 100.0  # times either way: no instrument is misjudged so far, a unit soon is
_CONSTANT = 1e-8  # of the declared noise: numbers that do not scatter but for rounding tell nothing of its unit
_NEAR = 5.0  # times about a unit's own factor, and twice that where so much was declared that gross errors count in
_SIZES = {  # of other units, in the one of the key
    "mm": {"um": 1e-3, "nm": 1e-6, "m": 1e3},
    "um": {"nm": 1e-3, "mm": 1e3, "m": 1e6},
    "mV": {"uV": 1e-3, "nV": 1e-6, "V": 1e3},
    "arcsec": {"mas": 1e-3, "deg": 3600.0, "mrad": 206.265, "rad": 206264.8},
}


def unit_slip(ratio: float, declared: float, unit: str) -> str:
    """Return a suggestion as the end of a message: the unit slip in a declared noise that explains the ratio of scatter
    to noise.

    Empty if both are of one size. ``declared`` is in the unit of its key.
    """
    if not (math.isfinite(ratio) and ratio > _CONSTANT) or 1.0 / IMPLAUSIBLE_RATIO <= ratio <= IMPLAUSIBLE_RATIO:
        return ""
    sizes = _SIZES.get(unit, {})
    near = {meant: abs(math.log(size / ratio)) for meant, size in sizes.items()}
    meant = min(near, key=lambda name: near[name], default="")
    if not meant or near[meant] > math.log(_NEAR if ratio > 1.0 else 2.0 * _NEAR):
        return f" No declared noise is wrong by so much: is the declared {declared:.3g} {unit} in the unit of its key?"
    return f" Did you mean {declared:.3g} {meant}, that is {declared * sizes[meant]:.3g} {unit}?"
