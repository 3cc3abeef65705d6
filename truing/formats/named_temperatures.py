"""Temperatures among the columns of an axis, by their names and units."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Collection, Sequence

from truing.formats.guess import MappingKeys
from truing.formats.units import bare_and_unit

_UNITS = ("degC", "degF")  # kelvins may be differences of anything
_WORD = re.compile(r"temp(eratur(en?|es)?)?(?![^\W\d_])", re.IGNORECASE)
_FAHRENHEIT = re.compile(r"(?P<bare>.*?[^\W\d_])[\s_]*[\[(/ _]\s*(°|deg)?\s*F\s*[\])]?", re.IGNORECASE)
_OF_AIR = re.compile(r"air|luft|ambient|umgebung|room|raum|lab|env(ironment)?", re.IGNORECASE)


def temperature_columns(names: Sequence[str], used_names: Collection[object] = ()) -> MappingKeys:
    """Return ``columns`` and ``units`` of all temperatures among names that are not used: ``temperature_c`` if nothing
    says of what, else with the words of the name before it, as in ``air_temperature_c``."""
    columns: dict[str, str] = {}
    units: dict[str, str] = {}
    for name in names:
        bare, unit = _bare_and_unit(name)
        if name in used_names or not (unit in _UNITS or (unit is None and _WORD.search(bare))):
            continue
        words = _words(bare)
        column = f"{words}_temperature_c" if words else "temperature_c"
        if column in columns or column in names:
            continue
        columns[column] = name
        if unit not in (None, "degC"):
            units[column] = str(unit)
    return {"columns": columns, **({"units": units} if units else {})}


def temperatures_of_positions(names: Sequence[str]) -> MappingKeys:
    """Return ``columns`` and ``units`` of the temperatures that a table of positioning runs can hold: of air, and the
    first one of anything else, which is taken for that of the machine."""
    found = temperature_columns(names)
    columns: dict[str, str] = {}
    units: dict[str, str] = {}
    for column, raw in found["columns"].items():
        kind = "air" if _OF_AIR.search(column) else "material"
        if f"{kind}_temperature_c" not in columns:
            columns[f"{kind}_temperature_c"] = raw
            if column in found.get("units", {}):
                units[f"{kind}_temperature_c"] = found["units"][column]
    return {"columns": columns, **({"units": units} if units else {})}


def _bare_and_unit(name: str) -> tuple[str, str | None]:
    """Return a name without its unit, and the unit; F next to a word for temperature is no capacity."""
    bare, unit = bare_and_unit(name)
    match = _FAHRENHEIT.fullmatch(name.strip())
    if unit is None and match is not None and _WORD.search(match["bare"]):
        return match["bare"], "degF"
    return bare, unit


def _words(bare: str) -> str:
    """Return the words of a name but those for temperature, in ASCII and joined by underscores."""
    plain = unicodedata.normalize("NFKD", _WORD.sub(" ", bare).casefold()).encode("ascii", "ignore").decode()
    words = [word for word in re.findall(r"[a-z0-9]+", plain) if word not in ("t", "c", "f")]
    return "_".join(words)
