"""The unit that an air pressure likely is in, where it is none in hPa."""

from __future__ import annotations

# Laboratories lie between the sea and 4000 m; in mmHg that begins where hPa of 2300 m end.
_LOWEST_HPA, _HIGHEST_HPA = 600.0, 1100.0
_NEAR_SEA_HPA = (980.0, 1040.0)
_IN_HPA = {"Pa": 1e-2, "kPa": 10.0, "bar": 1e3, "inHg": 33.86389, "atm": 1013.25}
_MMHG = 1.333224


def likely_pressure_unit(value: float) -> str:
    """Return what a pressure (its median, in hPa as it stands) likely is, in words; empty where it is likely hPa.

    Millimetres of mercury are suspected where they make a pressure as near the sea, for hPa would be that of 2300 m.
    """
    if _LOWEST_HPA <= value <= _HIGHEST_HPA:
        meant = value * _MMHG
        return f"{meant:.5g} hPa, in mmHg {value:.5g}" if _NEAR_SEA_HPA[0] <= meant <= _NEAR_SEA_HPA[1] else ""
    for unit, factor in _IN_HPA.items():
        if _LOWEST_HPA <= value * factor <= _HIGHEST_HPA:
            return f"{value * factor:.5g} hPa, in {unit} {value:.6g}"
    return ""
