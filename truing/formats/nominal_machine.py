"""Recognition of a machine's nominal geometry: rows of Denavit and Hartenberg, masses of links, and legs."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from truing.arrays import Array, TableRow
from truing.formats.guess import Guess, OtherWay
from truing.formats.named_columns import position_groups
from truing.formats.proposed_poses import NamedCells
from truing.formats.units import bare_and_unit, conversion, is_convertible

_ROWS = {  # names without blanks, underscores and braces
    "theta_deg": r"(theta|θ|ϑ|th)\w*|q[0i]?",
    "d_mm": r"di?",
    "a_mm": r"a(i1?)?|ri?",
    "alpha_deg": r"(alpha|α)\w*|twist",
    "kind": r"(joint)?(type|typ|kind)|art|gelenkart",
    "number": r"joint|achse|axis|gelenk|link|glied|i|nr|no|#",
}
_MASSES = {
    "mass": r"(mass|masse|m|gewicht)(i|kg|g)?",
    **{axis: rf"(s|c|r|com|cog|center|centre|sp|schwerpunkt){axis}|{axis}(com|cog|s|c)|{axis}" for axis in "xyz"},
}
_LEGS = {
    "length": r"(leg|strut|bein)?(home|nominal|initial|rest)?(length|len|l(ä|ae)nge|l0?|home)"
    r"((at|bei)?(zero|home|null|nominal|0))?(mm)?"
    r"|leghome|homelength",
    "number": r"leg|strut|bein|strebe|joint|gelenk|i|nr|no|#",
}
_NO_GEOMETRY = r"pose|frame|time|t|zeit|run|lauf|stellung|messung"
_OF_BASE = r"base|basis|lower|bottom|fixed|unten|gestell|ground"
_OF_PLATFORM = r"plat\w*|upper|top|moving|oben|plattform"
_PRISMATIC = r"p|prismatic|linear|translational|t|schub\w*|1"
_REVOLUTE = r"r|revolute|rotary|rotational|dreh\w*|0"
_TOOL = r"tool|werkzeug|payload|nutzlast|last|gripper|greifer|load"
_MODIFIED = r"modified|modifi(ziert|é)\w*|craig|proximal"
_STANDARD = r"classic\w*|standard|klassisch\w*|classique|distal|original"
_SYMBOL = re.compile(r"\s*[^\W\d]\w*\*?\s*(?P<shift>[-+]\s*\d+(?:\.\d*)?)?\s*°?\s*")
_COMPOUND = re.compile(r"([a-z])([XYZ])(?![a-z])")  # BaseX
_FEWEST, _MOST = 2, 12
_FEWEST_LEGS = 3
_LARGEST_RAD = 2.0 * np.pi
_LONGEST_LINK_M = 5.0  # lengths that all stay below this number are in m
OF_CHAIN, OF_LEGS = "table of Denavit and Hartenberg, for [mechanism]", "geometry of legs, for [mechanism]"
_OF_MASSES = "masses of links, for [mechanism]"
_LEGS_WITHOUT_LENGTH = "looks like the nominal geometry of legs without their lengths: docs/calibration.md, [mechanism]"


def machine_of(cells: NamedCells, text_above: str, unit: str | None) -> Guess | None:
    """Return keys of [mechanism] from a table of nominal geometry; None for other tables.

    text_above: lines above the table, which may name the convention. unit: of lengths, as the file states it.
    """
    if not _FEWEST <= len(cells.rows) <= _MOST:
        return None
    return _chain(cells, text_above, unit) or _masses(cells) or _legs(cells, text_above, unit)


def with_convention(guess: Guess, text_above: str) -> Guess:
    """Return a table of Denavit and Hartenberg with the convention that words name, such as the file's name."""
    convention = _convention(text_above)
    way = next((way for way in guess.ways if way.key == "convention"), None)
    if way is None or convention is None:
        return guess
    return replace(way.guess if way.other == convention else guess, ways=())


def _meanings(names: Sequence[str], text_above: Mapping[str, str]) -> dict[str, str]:
    """Return the first column of each meaning; its name is read without unit, blanks and underscores."""
    column_of: dict[str, str] = {}
    for name in names:
        bare = re.sub(r"[\[(].*?[\])]|[\s_{}.\-]+", "", bare_and_unit(name)[0]).casefold()
        meaning = next((key for key, pattern in text_above.items() if re.fullmatch(pattern, bare)), None)
        if meaning is not None:
            column_of.setdefault(meaning, name)
    return column_of


def _chain(cells: NamedCells, text_above: str, unit: str | None) -> Guess | None:
    column_of = _meanings(cells.names, _ROWS)
    if not {"theta_deg", "d_mm", "a_mm", "alpha_deg"} <= set(column_of):
        return None
    numbers = {key: _with_symbols(cells, column_of[key]) for key in ("theta_deg", "d_mm", "a_mm", "alpha_deg")}
    if not all(np.isfinite(column).all() for column in numbers.values()) or not _is_numbered(cells, column_of):
        return None
    kinds = _kinds(cells, column_of)
    if kinds is None:
        return None
    lengths = np.concatenate([numbers["d_mm"], numbers["a_mm"]])
    doubts = [*_in_mm(numbers, column_of, lengths, unit), *_in_deg(numbers, column_of)]
    if not _is_offset(cells, column_of["theta_deg"]):
        doubts.append(f"{column_of['theta_deg']} is assumed to be the angle of each joint where its reading is zero")
    convention = _convention(" ".join((text_above, *(column_of[key] for key in ("a_mm", "alpha_deg")))))
    standard, modified = (
        Guess(
            *({}, cells.names, None, (OF_CHAIN,)),
            known=True,
            doubts=tuple(doubts),
            machine={"type": "chain", "dh": _rows(numbers, kinds, name)},
        )
        for name in ("standard", "modified")
    )
    if convention is not None:
        return modified if convention == "modified" else standard
    text = "Convention of the table of Denavit and Hartenberg; modified: alpha and a of a row come before theta and d"
    doubt = 'the convention "standard" is assumed (else "modified", as by Craig)'
    return replace(standard, ways=(OtherWay("convention", text, "standard", "modified", modified, doubt),))


def _convention(text_above: str) -> str | None:
    spaced = re.sub(r"[_\W]+", " ", text_above.casefold())
    if re.search(rf"\b({_MODIFIED})\b", spaced) or re.search(r"\bi 1\b", spaced):
        return "modified"
    return "standard" if re.search(rf"\b({_STANDARD})\b", spaced) else None


def _with_symbols(cells: NamedCells, name: str) -> Array:
    """Return the numbers of a column (N,), where a joint's variable such as ``q2 - 90`` counts as its shift."""
    column = cells.numbers(name).copy()
    for row, text in enumerate(cells.texts(name)):
        if not np.isfinite(column[row]) and (match := _SYMBOL.fullmatch(text)):
            column[row] = float((match["shift"] or "0").replace(" ", ""))
    return column


def _is_offset(cells: NamedCells, name: str) -> bool:
    """True if a column of angles holds variables, or is called that of reading zero."""
    return bool(np.isnan(cells.numbers(name)).any()) or re.search(r"0|off|null", name, re.IGNORECASE) is not None


def _is_numbered(cells: NamedCells, column_of: Mapping[str, str]) -> bool:
    """True if rows stand in the order of their numbers, or have none; ``A1`` is the number 1."""
    if "number" not in column_of:
        return True
    numbers = [re.fullmatch(r"\D*(\d+)", text.strip()) for text in cells.texts(column_of["number"])]
    found = [int(match[1]) for match in numbers if match is not None]
    return len(found) == len(numbers) and bool(np.all(np.diff(found) == 1))


def _kinds(cells: NamedCells, column_of: Mapping[str, str]) -> list[str] | None:
    """Return the motion of each joint: by its own column, or by the variable under d; None for unknown words."""
    if "kind" not in column_of:
        is_slide = np.isnan(cells.numbers(column_of["d_mm"])) & ~np.isnan(cells.numbers(column_of["theta_deg"]))
        return ["prismatic" if slides else "revolute" for slides in is_slide]
    texts = [text.strip().casefold() for text in cells.texts(column_of["kind"])]
    if not all(re.fullmatch(f"{_PRISMATIC}|{_REVOLUTE}", text) for text in texts):
        return None
    return ["prismatic" if re.fullmatch(_PRISMATIC, text) else "revolute" for text in texts]


def _in_mm(numbers: dict[str, Array], column_of: Mapping[str, str], lengths: Array, unit: str | None) -> list[str]:
    """Convert lengths in place, and return the doubt on a unit that nothing gives."""
    stated = {key: bare_and_unit(column_of[key])[1] or unit for key in ("d_mm", "a_mm")}
    assumed = "m" if np.abs(lengths).max() < _LONGEST_LINK_M else "mm"
    for key, stated_unit in stated.items():
        numbers[key] = _converted(numbers[key], stated_unit or assumed, "mm")
    return [] if all(stated.values()) else [f"no unit of lengths is given; they are assumed to be in {assumed}"]


def _in_deg(numbers: dict[str, Array], column_of: Mapping[str, str]) -> list[str]:
    """Convert angles in place, and return the doubt on a unit that nothing gives."""
    doubts = []
    for key in ("theta_deg", "alpha_deg"):
        unit, values = bare_and_unit(column_of[key])[1], numbers[key]
        if unit is None and values.any():
            unit = "rad" if np.abs(values).max() <= _LARGEST_RAD and (values % 1.0).any() else "deg"
            doubts.append(f"no unit of {column_of[key]} is given; it is assumed to be in {unit}")
        numbers[key] = _converted(values, unit or "deg", "deg")
    return doubts


def _converted(values: Array, unit: str, wanted: str) -> Array:
    factor = conversion(unit, wanted)[0] if is_convertible(unit, wanted) else np.nan
    return np.asarray(np.round(values * factor, 9) + 0.0)


def _rows(numbers: Mapping[str, Array], kinds: Sequence[str], convention: str) -> list[TableRow]:
    order = ("a_mm", "alpha_deg", "d_mm", "theta_deg")
    return [
        {key: float(numbers[key][row]) for key in order}
        | ({"kind": kind} if kind != "revolute" else {})
        | ({"convention": convention} if convention != "standard" else {})
        for row, kind in enumerate(kinds)
    ]


def _masses(cells: NamedCells) -> Guess | None:
    """Return masses and centres of links in the order of the rows, and of the tool if the last row names one."""
    column_of = _meanings(cells.names, _MASSES)
    of_mass = re.search(r"(?<![a-z])(k?)g(?![a-z])", column_of.get("mass", ""))
    if set(column_of) != set(_MASSES) or of_mass is None:
        return None
    units = {bare_and_unit(column_of[axis])[1] for axis in "xyz"}
    unit = units.pop()
    if units or unit is None or not is_convertible(unit, "mm"):
        return None
    numbered = cells.values[:, 0]
    is_row = np.isfinite(np.column_stack([cells.numbers(name) for name in column_of.values()])).all(axis=1)
    links, unnumbered = is_row & np.isfinite(numbered), np.flatnonzero(is_row & ~np.isfinite(numbered))
    if links.sum() < _FEWEST or not np.array_equal(numbered[links], np.arange(1.0, links.sum() + 1.0)):
        return None
    mass = np.round(cells.numbers(column_of["mass"]) * (1.0 if of_mass[1] else 1e-3), 9)
    centre = np.column_stack([_converted(cells.numbers(column_of[axis]), unit, "mm") for axis in "xyz"])
    machine: dict[str, object] = {
        "masses": [{"mass_kg": float(mass[k]), "com_mm": centre[k].tolist()} for k in np.flatnonzero(links)]
    }
    if len(unnumbered) == 1 and re.search(rf"\b({_TOOL})\b", cells.rows[unnumbered[0]][0], re.IGNORECASE):
        k = unnumbered[0]
        machine["payload"] = {"payload_kg": float(mass[k]), "payload_com_mm": centre[k].tolist()}
    doubt = (
        "centres of masses are assumed in frames of Denavit and Hartenberg, and com_mm has them in those of the joints"
    )
    return Guess({}, cells.names, None, (_OF_MASSES,), known=True, doubts=(doubt,), machine=machine)


def _legs(cells: NamedCells, text_above: str, unit: str | None) -> Guess | None:
    """Return legs of variable length: joints on the base and on the platform in one row, with the length."""
    spelt = {_COMPOUND.sub(r"\1 \2", name): name for name in cells.names}
    column_of, named = _meanings(cells.names, _LEGS), position_groups(tuple(spelt))
    groups = {
        key: [tuple(spelt[name] for name in group) for before, group in named.items() if re.fullmatch(pattern, before)]
        for key, pattern in (("a_mm", _OF_BASE), ("b_mm", _OF_PLATFORM))
    }
    if len(cells.rows) < _FEWEST_LEGS or len(named) != 2 or any(len(group) != 1 for group in groups.values()):
        return None
    is_measured = any(re.fullmatch(_NO_GEOMETRY, bare_and_unit(name)[0], re.IGNORECASE) for name in cells.names)
    if is_measured or not column_of:
        return None
    if "length" not in column_of:
        return Guess({}, cells.names, None, (_LEGS_WITHOUT_LENGTH,), known=True)
    columns = {key: list(group[0]) for key, group in groups.items()} | {"length_mm": [column_of["length"]]}
    stated = {bare_and_unit(name)[1] for names in columns.values() for name in names} - {None}
    given = stated.pop() if len(stated) == 1 else unit or _unit_of(text_above)
    values = {key: _converted(cells.of(names)[1], given or "mm", "mm") for key, names in columns.items()}
    if stated or not all(np.isfinite(column).all() for column in values.values()):
        return None
    legs = [
        {"a_mm": a.tolist(), "b_mm": b.tolist(), "length_mm": float(length[0])}
        for a, b, length in zip(values["a_mm"], values["b_mm"], values["length_mm"], strict=True)
    ]
    of_unit = () if given else ("no unit of the geometry is given; it is assumed to be in mm",)
    doubts = ("legs of variable length are assumed, whose length_mm is that at reading zero", *of_unit)
    return Guess({}, cells.names, None, (OF_LEGS,), known=True, doubts=doubts, machine={"type": "ups", "legs": legs})


def _unit_of(text_above: str) -> str | None:
    """Return the unit of lengths in words such as ``all mm`` or ``[mm]``; None without a single one."""
    units = set(re.findall(r"(?<![A-Za-z])(mm|cm|inches)(?![A-Za-z])", text_above))
    return {"inches": "in"}.get(unit := units.pop(), unit) if len(units) == 1 else None
