"""Meaning and unit of the columns of an unknown table, by their names."""

from __future__ import annotations

import re
from collections.abc import Collection, Sequence

from truing.formats.guess import MappingKeys
from truing.formats.raw_tables import COORDINATE_SIGMAS, COORDINATES
from truing.formats.units import bare_and_unit, expanded, may_be
from truing.schemas.columns import find_column
from truing.schemas.mapping import is_uncertainty

_MEASURED = r"(meas(ured)?|actual|act|mess|gemessen|ist)"  # next to nominal coordinates
_OF_MEASURED = rf"{_MEASURED}[ _.]?{{0}}|{{0}}[ _.]?{_MEASURED}"
_SPREAD = r"(sigma|std|sd|prec(ision)?)"
_EXPANDED = r"(u|u[ _]?\(?95\)?|[23][ _-]?(σ|sigma))"
_KNOWN = {
    "pose": r"pose|frame|(pose?|position|measurement|meas|shot)[ _]?(nr|no|id|number|name|index)|measurement|epoche?"
    r"|station|piece|aufnahme|messung|stellung",
    "role": r"role|rolle",
    "body": r"body|rigid[ _]?body|k(ö|oe)rper|corps|(point[ _]?)?group|(punkt)?gruppe",
    "target": r"\w+(::\w+)+|(target|marker|point)([ _-]?(id|name|no|nr))?|label"
    r"|(mess)?punkt([ _-]?(nr|nummer|name|id|bezeichnung))?|(ziel)?marke"
    r"|ziel(punkt)?|name|nom|cible|smr|reflector|reflektor|nest|feature([ _]?(id|name))?|merkmal",
    **{f"{a}_mm": f"{a}|{_OF_MEASURED.format(a)}" for a in "xyz"},
    **{
        f"sigma_{a}_mm": rf"(s0?|m{a}|{_SPREAD})[ _]?{a}|{a}[ _]?{_SPREAD}|{_EXPANDED}[ _]?{a}"
        rf"|[us][ _]?{a}[ _]*\(?[123][ _-]?(s|σ|sigma)\)?"
        for a in "xyz"
    },
    "time_s": r"(t|%?_*(date[ _/]?)?time([ _]?stamp)?|time +\d+ - .*|zeit(stempel)?|temps|timestamp"
    r"|(field\.)?header\.stamp)( ?[\[(](utc|gmt|mez|mesz|cet|cest|local)[\])])?",
    "temperature_c": r"temp(erature?|eratur)?",
    "leg": r"leg|bein|jambe",
    "phase_deg": r"phase",
    "radius": r"radius",
    "signal_x": r"signal[ _]?x|cos(ine|inus)?",
    "signal_y": r"signal[ _]?y|sin(e|us)?",
}
_TEMPERATURES = ("t", "temp.", "t_mat", "t_machine")  # with a unit of temperature alone: t is also a time
_OF_ALL_AXES = r"(mess|punkt)?unsicherheit|(coordinate |point )?uncertainty|incertitude|std(dev| dev)?|sigma|precision"
_GRID = (  # of surveys: east, north, height
    r"e(ast(ing)?)?|rechts(wert)?|ost(wert)?",
    r"n(orth(ing)?)?|hoch(wert)?|nord(wert)?",
    r"h|height|elev(ation)?|h(ö|oe)he|up|z",
)
_LENGTH = re.compile(r"[Ll](\d+)")
_LEGS = 6
_READING = re.compile(
    r"(?:rho|leg|strut|bein|strebe|jambe|act(?:uator)?|aktor|stroke|hub|antrieb|st(?:ö|oe)(?:ß|ss)el|v(?:é|e)rin)"
    r"[ _]?([1-9]\d*)"
)


def columns_by_names(names: tuple[str, ...], without: Collection[str] = ()) -> tuple[MappingKeys, list[str]]:
    """Return the probable meaning and unit of each column whose name is not the contract's.

    without: columns that the table does not have.
    """
    columns, units, notes = _recognised(names, without)
    if set(COORDINATES) <= {*names, *columns} and not any(map(is_uncertainty, (*names, *columns))):
        spread, unit, note = _common_uncertainty(names)
        columns |= spread
        units |= dict.fromkeys(spread, unit) if unit is not None else {}
        notes += note
    notes = ["; ".join(notes)] if notes else []
    mapping: MappingKeys = {"columns": columns} if columns else {}
    expanded_columns = {
        raw: one for column, raw in columns.items() if is_uncertainty(column) and (one := expanded(raw)) is not None
    }
    if expanded_columns:
        k = next(iter(expanded_columns.values())).coverage
        mapping["coverage"] = k
        text = ", ".join(expanded_columns)
        notes.append(f"{text}: expanded uncertainties, k = {k:g} is taken; coverage = 1 for one sigma")
    return mapping | _units(names, units), notes


def _recognised(names: tuple[str, ...], without: Collection[str]) -> tuple[dict[str, str], dict[str, str], list[str]]:
    """Return raw names and units by the contract's column, and a note on each."""
    columns: dict[str, str] = {}
    units: dict[str, str] = {}
    notes: list[str] = []
    grid, legs, nominal = _grid_axes(names), _numbered_lengths(names), _nominal_beside_measured(names)
    for name in names:
        bare, unit = bare_and_unit(name)
        if unit is not None and find_column(name) is not None:
            continue  # has the contract's name: target_mm is no target
        known = grid.get(name) or legs.get(name) or _probable_column(bare, unit) or _probable_column(name)
        if (
            known is None
            or name in nominal
            or known in without
            or name == known
            or known in columns
            or known in names
            or not may_be(unit, find_column(known))
        ):
            continue
        columns[known] = name
        if unit is not None and unit not in ("s", "degC"):
            units[known] = unit
        notes.append(f"{name} is taken for {known}" + (f", in {unit}" if unit else ""))
    return columns, units, notes


def _common_uncertainty(names: tuple[str, ...]) -> tuple[dict[str, str], str | None, list[str]]:
    """Return the columns of one uncertainty for all coordinates, its unit and a note; empty without such a column."""
    name = next((name for name in names if _is_of_all_axes(name)), None)
    if name is None:
        return {}, None, []
    columns = dict.fromkeys(COORDINATE_SIGMAS, name)
    return columns, bare_and_unit(name)[1], [f"{name} is taken for the uncertainty of each coordinate"]


def _units(names: tuple[str, ...], units: dict[str, str]) -> MappingKeys:
    """Return the keys ``unit`` and ``units`` of a mapping, for columns whose unit differs from the contract's."""
    of_coordinates = {units.get(name) for name in COORDINATES}
    common = of_coordinates.pop() if len(of_coordinates) == 1 and not set(COORDINATES) & set(names) else None
    if common == "mm":
        common = None
    # `unit` holds for all coordinates, and for uncertainties without a unit of their own
    other_units = {
        name: unit
        for name, unit in units.items()
        if unit != (common if common and name.endswith("_mm") else _unit_suffix(name))
    }
    return ({"unit": common} if common is not None else {}) | ({"units": other_units} if other_units else {})


def _nominal_beside_measured(names: Sequence[str]) -> set[str]:
    """Return the columns ``X``, ``Y``, ``Z`` that are nominal, because others are called measured."""
    bare = {name: bare_and_unit(name)[0].casefold() for name in names}
    measured = {axis for axis in "xyz" for name in bare.values() if re.fullmatch(_OF_MEASURED.format(axis), name)}
    return {name for name, axis in bare.items() if axis in measured}


def _grid_axes(names: Sequence[str]) -> dict[str, str]:
    """Return the columns of east, north and height, of which x, y and z are right-handed, by their names."""
    result = {}
    for column, pattern in zip(COORDINATES, _GRID, strict=True):
        axes = [name for name in names if re.fullmatch(pattern, bare_and_unit(name)[0].casefold())]
        if len(axes) != 1:
            return {}
        result[axes[0]] = column
    return result


def _numbered_lengths(names: Sequence[str]) -> dict[str, str]:
    """Return the readings of six legs or more, ``L1 [mm]`` and so on, by their names; empty without such a family."""
    matches = [(name, _LENGTH.fullmatch(bare_and_unit(name)[0])) for name in names]
    found = {name: int(m[1]) for name, m in matches if m is not None and bare_and_unit(name)[1] in ("mm", "m", "in")}
    numbers = sorted(found.values())
    is_complete = len(numbers) >= _LEGS and numbers == list(range(1, len(numbers) + 1))
    return {name: f"rho{number}_mm" for name, number in found.items()} if is_complete else {}


def _is_of_all_axes(name: str) -> bool:
    """True if a name means one uncertainty for all three coordinates, in a unit of length."""
    bare, unit = bare_and_unit(name)
    bare = re.sub(r"\(.*?\)|\bU\b", "", bare).strip(" _.,-").casefold()
    return unit is not None and may_be(unit, find_column("x_mm")) and re.fullmatch(_OF_ALL_AXES, bare) is not None


def _unit_suffix(column: str) -> str | None:
    """Return the unit at the end of a column's name."""
    return column.rsplit("_", 1)[-1] if "_" in column else None


def _probable_column(bare: str, unit: str | None = None) -> str | None:
    """Return the contract's column that a name without its unit seems to mean."""
    if unit == "degC" and bare.casefold() in _TEMPERATURES:
        return "temperature_c"
    if reading := _READING.fullmatch(bare.lower()):
        return f"rho{reading[1]}_mm"
    word = bare.casefold().rstrip(" .")
    return next((column for column, pattern in _KNOWN.items() if re.fullmatch(pattern, word)), None)
