"""Printed names and units of a mechanism's parameters."""

from __future__ import annotations

import re

from truing.report.numbers import sign

_SYMBOLS = {"kappa": "κ", "rho0": "ρ0", "beta": "β"}
_UNITS = {"N m2": "N·m²"}
_STIFFNESS = r"stiffness of (\d+) (\w+) (\w+)"
_LENGTHS = ("platform_radius", "base_radius", "lower_clearance", "middle_clearance", "sensor_installation")

# Keeps a number and its uncertainty in one line of a table.
UNBROKEN = "\u00a0"
MEANING = (
    "a: lower joint, b: upper joint, u: direction of the actuator, l: length of the leg, ρ0: reading at the reference, "
    "κ: shift of its attachment per displacement of its own actuator; K, ρ2: per displacement of actuator 2; Kx, Ky: "
    "the same along x and y of the platform."
)


def symbols(words: str) -> str:
    """Return a combination of parameters with its symbols: ``a_z1 : ρ0_1`` for ``a_z1 : rho01``."""
    return re.sub(r"\brho0(?=\d)", "ρ0_", re.sub(r"\brho0\b", "ρ0", re.sub(r"\bkappa(?=\d|\b)", "κ", words)))


def kind_of(parameter: str, leg: float) -> str:
    """Return the kind of a parameter, equal in every leg: ``a_x``, ``κ``, ``K, ρ2`` for the second entry of K's row."""
    column = _column_of(parameter, leg)
    return f"{_matrix_of(parameter)}, ρ{column}" if column else _name_in_words(parameter)


def _matrix_of(parameter: str) -> str:
    """Return the matrix of a coefficient: K, or Kx and Ky for shifts in the platform's plane."""
    return next((name for name in ("Kx", "Ky") if parameter.startswith(name)), "K")


def _column_of(parameter: str, leg: float) -> str:
    """Return the drive of an entry of K, ``2`` of ``K12`` or ``10`` of ``K1_10``; empty for other parameters."""
    matrix_row = _matrix_of(parameter) + (f"{int(leg)}" if leg == leg else "")
    column = parameter.removeprefix(matrix_row).removeprefix("_")
    return column if parameter.startswith(matrix_row) and column.isdigit() else ""


def _name_in_words(parameter: str) -> str:
    """Return a parameter's symbol, or its words: ``axial stiffness of spring 3`` (the third element of a leg)."""
    element = re.fullmatch(_STIFFNESS, parameter)
    if element:
        return f"{element[3]} stiffness of {element[2]} {element[1]}".replace("scale stiffness", "stiffness")
    words = parameter.replace("_", " ") if parameter in _LENGTHS else parameter
    return _SYMBOLS.get(parameter, words)


def name_of(parameter: str, leg: float) -> str:
    """Return the name of one parameter in a sentence: ``u_x of leg 1``, ``K12``."""
    if leg != leg or _column_of(parameter, leg):
        return _name_in_words(parameter)
    return f"{_name_in_words(parameter)} of leg {int(leg)}"


def print_unit(parameter: str, unit: str) -> tuple[float, str]:
    """Return factor and unit in which a parameter is printed: directions in mrad, deformation in um per mm."""
    if unit == "1" and parameter.startswith("u_"):
        return 1e3, "mrad"
    if unit == "1" and (parameter == "kappa" or parameter.startswith("K")):
        return 1e3, "µm/mm"
    return 1.0, _UNITS.get(unit, sign(unit))
