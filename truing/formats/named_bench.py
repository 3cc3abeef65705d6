"""Recognition of columns of benches by names: readings under a load, positions of an axis, and axes with encoders."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from truing.arrays import Array
from truing.formats.axis_directions import DIRECTION, direction_of
from truing.formats.guess import MappingKeys
from truing.formats.named_temperatures import temperatures_of_positions
from truing.formats.units import bare_and_unit, conversion, is_convertible

_LOADED = {
    "run": r"run([ _]?(nr|no|id))?|lauf|versuch|test([ _]?(nr|no|id))?|essai",
    "step": r"step([ _]?(nr|no|id))?|(last)?stufe|schritt|load[ _]?step|palier",
    "time_s": r"t|time|zeit|zeitstempel|temps|timestamp",
    "load_axis": r"load[ _]?(axis|direction)|axis|lastachse|lastrichtung|achse|axe",
    "load": r"(applied[ _]?)?(load|force)|(auf)?last|kraft|charge",
    "channel": r"channel|kanal|voie",
    "reading": r"reading|anzeige|messwert|indication|lecture",
    "air_temperature_c": r"(air|luft)[ _-]?temp(erature?|eratur)?",
    "air_pressure_hpa": r"(air|luft)[ _-]?(pressure|druck)|pressure|druck",
    "relative_humidity_pct": r"(relative[ _]?)?humidity|(luft)?feuchte",
    "material_temperature_c": r"(material|werkstück)[ _-]?temp(erature?|eratur)?",
}
_MOTION = ("dx", "dy", "dz", "rx", "ry", "rz")
_TARGET = r"(target|tgt|nominal|soll|ziel|command(ed)?)([ _-]?(position|pos|wert))?(\(i\))?|position[ _]?nominale"
_DEVIATION = r"deviation|error|abweichung|(positioning|positions)[ _-]?(error|abweichung)|fehler|erreur"
_ACTUAL = r"(actual|measured|ist|reference)([ _-]?(position|pos|wert))?|istposition|istwert|position"
_CYCLE = r"cycle|zyklus|run([ _]?(nr|no))?|lauf|pass|repeat|wiederholung"
_COMMAND = (
    r"(command(ed)?|target|nominal|soll|ziel|set)([ _-]?(angle|position|pos|winkel|wert))?"
    r"|(angle|position|pos|winkel)[ _-](command|target|nominal|soll)|setpoint|angle|winkel|position|.*pos[_-]?cmd"
    r"|((angle|position)[ _-])?consigne|(.*[ _.])?(theoretical|theoretische?|théorique)[ _]?pos(ition)?"
    r"|.*[ _.]set[ _]?pos(ition)?|(rotary[ _]?)?(table|rundtisch|tisch)([ _-]?(angle|position|pos|winkel))?"
)
_COMMANDED = r"command|target|nominal|soll|ziel|set[ _-]?point|consigne|theoretical"
_MOTOR = (
    r"motor([ _-]?(encoder|angle|position|winkel))?|encoder|(dreh)?geber|messsystem|resolver|.*pos[_-]?(fb|feedback)"
    r"|.*[ _.]act[ _]?pos(ition)?|(.*[ _.])?real[ _]?pos(ition)?"
    r"|enc(oder)?[ _-]?mot(or)?"
)
_LOAD_SIDE = (
    r"(load|second|direct|output)([ _-]?(encoder|angle|position|winkel))|abtrieb|encoder[._ ]?\d+([._ ]?pos(ition)?)?"
    r"|enc(oder)?[ _-]?(load|last|abtrieb)"
)
_OUTSIDE = (
    r"(reference|measured|autocollimator|autokollimator|akf|interferometer|laser|polygon|ist|error|deviation|abweichung)"
    r".*|(reading|anzeige|ablesung|lecture)([ _]hz)?|hz|mesur(e|é)e?|(ron|rod|rpn|rcn|ecn|ern|lip|lida|lif) ?\d{3,4}"
)
_NUMBERED = re.compile(
    r"(axis|achse|channel|kanal|encoder|counter|z(ä|ae)hler)[ _]?\d([ _](position|pos|angle|winkel))?", re.I
)
# Numbers of rows, faces and scatter next to an instrument's reading: no condition on which an error may depend.
_NO_CONDITION = re.compile(
    r"(face|facette|(poly(gon)?[ _]?)?fl(ä|ae)che|run|lauf|turn|umlauf|nr|no|#)"
    r"|(sd|std|sigma|stdev|streuung)([ _].*)?|" + DIRECTION,
    re.IGNORECASE,
)
_OF_MIRROR = re.compile("[xy]", re.IGNORECASE)  # both angles of an autocollimator's mirror
_SMALL = ("arcsec", "urad", "mrad")
_OF_LENGTHS = r"laser|interferometer|lip|lida|lif"  # instruments that mostly measure lengths
_IN_COUNTS = re.compile(
    r"[\s_\[(/.-](cnts?|cts|counts?|incr?|increments?|ink|inkremente|ticks?|pulses?)[\])]?$", re.IGNORECASE
)
_UNITS_OF_AXES = {"angle": "deg", "length": "mm"}
_OF_AXIS = re.compile(r"[ _](axis|achse|axe)?[ _]?[xyzabcuvw]\d?$")  # the axis behind a name


@dataclass(frozen=True)
class Proposal:
    """A table, keys of its [files.<table>], its description, and statements to confirm."""

    table: str
    mapping: MappingKeys
    note: str
    doubts: tuple[str, ...] = ()


def readings_under_load(names: Sequence[str]) -> Proposal | None:
    """Return readings of an interferometer under loads: a row per channel, or channels side by side."""
    columns = _meanings(names, _LOADED)
    side_by_side = {bare_and_unit(name)[0].lower(): name for name in names}
    channels = {axis: side_by_side[axis] for axis in _MOTION if axis in side_by_side}
    is_long = {"channel", "reading"} <= set(columns)
    if not {"load_axis", "load"} <= set(columns) or not (is_long or channels):
        return None
    constants = {} if "run" in columns else {"constants": {"run": "1"}}
    numbered = {} if "step" in columns else {"number_rows": {"step": 1}}
    columns = {key: name for key, name in columns.items() if is_long or key not in ("channel", "reading")}
    values = channels.values() if not is_long else [columns["reading"]]
    units = _units(columns) | _unit_of_readings(values)
    wide = {} if is_long else {"channels": channels}
    mapping = {**wide, "columns": columns, **({"units": units} if units else {}), **constants, **numbered}
    return Proposal("interferometer", mapping, "readings under loads")


def _meanings(names: Sequence[str], words: Mapping[str, str]) -> dict[str, str]:
    """Return the raw name of each column that a name means, first come first served."""
    meanings: dict[str, str] = {}
    for name in names:
        bare = bare_and_unit(name)[0].casefold()
        column = next((c for c, pattern in words.items() if re.fullmatch(pattern, bare)), None)
        if column is not None:
            meanings.setdefault(column, name)
    return meanings


def _units(columns: Mapping[str, str]) -> dict[str, str]:
    """Return units by names of columns other than the reading, if they differ from the column's own."""
    unit_of_column = {"time_s": "s", "load": "N", "air_pressure_hpa": "hPa", "relative_humidity_pct": "%"}
    unit_of_name = {column: bare_and_unit(name)[1] for column, name in columns.items() if column != "reading"}
    return {
        column: unit
        for column, unit in unit_of_name.items()
        if unit is not None and unit != unit_of_column.get(column, "degC")
    }


def _unit_of_readings(names: Iterable[str]) -> dict[str, str]:
    """Return the common unit of lengths among readings; arc seconds of angles are taken as they are."""
    units = {unit for name in names if (unit := bare_and_unit(name)[1]) not in (None, "arcsec")}
    return {"reading": str(units.pop())} if len(units) == 1 and units != {"um"} else {}


def positions_of_axis(names: Sequence[str], data: Sequence[Sequence[str]], values: Array) -> Proposal | None:
    """Return approaches of an axis to its targets, a row each, with the direction and the deviation or position."""
    meanings = _meanings(
        names, {"target_mm": _TARGET, "direction": DIRECTION, "off": _DEVIATION, "at": _ACTUAL, "cycle": _CYCLE}
    )
    if "target_mm" not in meanings or "direction" not in meanings or not {"off", "at"} & set(meanings):
        return None
    if _kind(meanings["target_mm"]) == "angle":
        return None  # a rotary axis: its order of commands gives the direction of approach
    cells = {row[list(names).index(meanings["direction"])].strip() for row in data}
    renames = {cell: direction_of(cell) for cell in sorted(cells)}
    if not all(renames.values()):
        return None
    pair = ("position_mm", "at") if "at" in meanings else ("deviation_um", "off")
    columns = {
        "target_mm": meanings["target_mm"],
        "direction": meanings["direction"],
        pair[0]: meanings[pair[1]],
    }
    columns |= {"cycle": meanings["cycle"]} if "cycle" in meanings else {}
    units = {column: bare_and_unit(columns[column])[1] for column in ("target_mm", pair[0])}
    unit_of_column = {column: unit for column, unit in units.items() if unit not in (None, column.rsplit("_", 1)[-1])}
    warm = temperatures_of_positions(names)
    columns |= warm["columns"]
    unit_of_column |= warm.get("units", {})
    words = {raw: word for raw, word in renames.items() if raw != word}
    mapping: MappingKeys = {
        "columns": columns,
        "constants": {"run": "1"},
        **({"units": unit_of_column} if unit_of_column else {}),
    }
    mapping |= {"rename": {"direction": {re.escape(raw): word for raw, word in words.items()}}} if words else {}
    return Proposal("positioning", mapping, "approaches of an axis to its targets")


_RUN_HEAD = re.compile(
    r"(?P<head>[^\d{}]*)(?P<cycle>\d+)(?P<between>[\s_-]*[(\[]?)(?P<direction>[^\s\d{}()\[\]]+)(?P<tail>[^{}]*)"
)


_WORD = re.compile(r"[^\s\d{}()\[\]._,;:]+")


def positions_side_by_side(names: Sequence[str], values: Array) -> Proposal | None:
    """Return approaches of an axis to its targets, with a column for each run and direction.

    values (N, W): numbers that go along with the targets are positions, others deviations.
    """
    target = _meanings(names, {"target_mm": _TARGET}).get("target_mm")
    numbered = [name for name in names if _NUMBER_OF_TARGET.fullmatch(name.strip(" ."))]
    other_columns = [name for name in names if name and name != target and name not in numbered]
    templates = [template for name in other_columns if (template := _of_run(name)) is not None]
    if target is None or len(templates) < max(2, len(other_columns)):
        return None
    words = {word: direction_of(word) for _, word in templates}
    if len({wide for wide, _ in templates}) != 1 or set(words.values()) != {"forward", "backward"}:
        return None
    value = "position_mm" if _goes_along(names, values, target, other_columns[0]) else "deviation_um"
    units = {"target_mm": bare_and_unit(target)[1], value: bare_and_unit(other_columns[0])[1]}
    unit_of_column = {column: unit for column, unit in units.items() if unit not in (None, column.rsplit("_", 1)[-1])}
    mapping: MappingKeys = {"columns": {"target_mm": target}, "wide": templates[0][0]}
    mapping |= {
        "wide_values": value,
        "constants": {"run": "1"},
        **({"units": unit_of_column} if unit_of_column else {}),
    }
    mapping |= {"rename": {"direction": {re.escape(raw): str(word) for raw, word in words.items() if raw != word}}}
    mapping |= {"ignore": "|".join(map(re.escape, numbered))} if numbered else {}
    return Proposal("positioning", mapping, "approaches of an axis to its targets, a column for each run")


def _of_run(name: str) -> tuple[str, str] | None:
    """Return the template of the name of a run's column, and its word of the direction: ``Run 1 Fwd(um)``, ``1 (+)``,
    ``Ist (hin) Lauf 1``; None for other names."""
    if match := _RUN_HEAD.fullmatch(name):
        template = f"{match['head']}{{cycle}}{match['between']}{{direction}}{match['tail']}"
        if direction_of(match["direction"]) is not None:
            return template, match["direction"]
    words = [match for match in _WORD.finditer(name) if direction_of(match[0]) is not None]
    numbers = list(re.finditer(r"\d+", name))
    if len(words) != 1 or len(numbers) != 1 or set("{}") & set(name):
        return None
    parts = sorted([(words[0].span(), "{direction}"), (numbers[0].span(), "{cycle}")], reverse=True)
    template = name
    for (begin, end), place in parts:
        template = template[:begin] + place + template[end:]
    return template, words[0][0]


def _goes_along(names: Sequence[str], values: Array, target: str, name: str) -> bool:
    """True if the numbers of a column span at least half as much as the targets, both in the units of their names."""
    spans = []
    for raw in (target, name):
        column, unit = values[:, list(names).index(raw)], bare_and_unit(raw)[1]
        factor = conversion(unit, "mm")[0] if unit is not None and is_convertible(unit, "mm") else 1.0
        spans.append(float(np.nanmax(column) - np.nanmin(column)) * factor)
    return spans[1] > 0.5 * spans[0] > 0.0


_CYCLE_HEAD = re.compile(r"(?P<head>[^\d{}]+)(?P<cycle>\d+)(?P<tail>[^\d{}]*)")
_NUMBER_OF_TARGET = re.compile(
    r"#|i|((pos(ition)?|target|point|punkt|ziel)[ _.]*)?(nr|no|number|index|nummer)|point|punkt", re.IGNORECASE
)
_OF_DEVIATION = re.compile(r"dev|err|abw|fehler", re.IGNORECASE)
_SIDES = (("forward", "backward"), ("fwd", "bwd"), ("up", "down"), ("plus", "minus"), ("vorwärts", "rückwärts"))


def cycles_side_by_side(names: Sequence[str], file_name: str) -> Proposal | None:
    """Return approaches of an axis to its targets from one side, with a column for each cycle; the file's name says
    from which side. None if it does not, or without such columns."""
    target = _meanings(names, {"target_mm": _TARGET}).get("target_mm")
    sides = next((pair for pair in _SIDES if re.search(_whole_word(*pair), file_name)), None)
    other_columns = [
        name for name in names if name and name != target and not _NUMBER_OF_TARGET.fullmatch(name.strip())
    ]
    matches = [match for name in other_columns if (match := _CYCLE_HEAD.fullmatch(name))]
    common = {(match["head"], match["tail"]) for match in matches}
    if target is None or sides is None or len(matches) < max(2, len(other_columns)) or len(common) != 1:
        return None
    ((head, tail),) = common
    value = "deviation_um" if _OF_DEVIATION.search(head) else "position_mm"
    units = {"target_mm": bare_and_unit(target)[1], value: bare_and_unit(other_columns[0])[1]}
    unit_of_column = {column: unit for column, unit in units.items() if unit not in (None, column.rsplit("_", 1)[-1])}
    mapping: MappingKeys = {
        "columns": {"target_mm": target},
        "wide": f"{head}{{cycle}}{tail}",
        "wide_values": value,
        "constants": {"run": "1"},
        "from_name": _whole_word(*sides),
        **({"units": unit_of_column} if unit_of_column else {}),
    }
    words = {f"(?i){side}": word for side, word in zip(sides, _SIDES[0], strict=True)}
    mapping["rename"] = {"direction": words}
    doubt = "no unit is given; deviations are assumed in um" if units[value] is None else ""
    note = "approaches of an axis to its targets from one side, a column for each cycle; the file's name says the side"
    return Proposal("positioning", mapping, note, (doubt,) if doubt and value == "deviation_um" else ())


def _whole_word(forward: str, backward: str) -> str:
    """Return the regular expression for either word in a file's name, as the direction."""
    return rf"(?i)(?:^|[\W\d_])(?P<direction>{forward}|{backward})(?=$|[\W\d_])"


def axis_rows(names: Sequence[str], values: Array) -> tuple[Proposal, ...]:
    """Return commands of a single axis next to its encoders and an outside instrument, as configurations.

    Two proposals, in degrees and in millimetres, if no name gives a unit; lengths first next to a laser. None without
    such columns.
    """
    kinds_given = {_kind(name) for name in names}
    kinds = [kind for kind in ("angle", "length") if kind in kinds_given]
    axes = [axis for kind in kinds if (axis := _axis_of_kind(names, values, kind, kind)) is not None]
    if axes:
        return tuple(axes) if len(axes) == 1 else ()
    is_linear = any(re.match(_OF_LENGTHS, bare_and_unit(name)[0], re.IGNORECASE) for name in names)
    order = ("length", "angle") if is_linear else ("angle", "length")
    bare = [_axis_of_kind(names, values, None, kind) for kind in order]
    return tuple(axis for axis in bare if axis is not None) or _encoders_alone(names)


def _encoders_alone(names: Sequence[str]) -> tuple[Proposal, ...]:
    """Return the recorded positions of two encoders, the first of which is taken for the reference of the second."""
    for kind, unit in _UNITS_OF_AXES.items():
        encoders = [name for name in names if _kind(name) == kind and _NUMBERED.fullmatch(bare_and_unit(name)[0])]
        if len(encoders) == 2:
            columns = {f"command_{unit}": encoders[0], f"measured_{unit}": encoders[1]}
            units = {column: given for column, name in columns.items() if (given := bare_and_unit(name)[1]) != unit}
            doubt = f"{encoders[0]} is assumed to be the reference with which {encoders[1]} is compared"
            mapping = {"columns": columns, **({"units": units} if units else {})}
            return (Proposal("configurations", mapping, "positions of two encoders of an axis", (doubt,)),)
    return ()


def _axis_of_kind(names: Sequence[str], values: Array, kind: str | None, meant: str) -> Proposal | None:
    """Return an axis whose columns have units of a kind (None: no units), read as angles or lengths."""
    command = _first(names, _COMMAND, (), kind)
    if command is None:
        return None
    motor, load = _first(names, _MOTOR, (command,), kind), _first(names, _LOAD_SIDE, (command,), kind)
    outside = _first(names, _OUTSIDE, (command, motor, load), kind) or _of_autocollimator(names, command, kind)
    if outside is None and motor is None and load is None and re.search(_COMMANDED, command, re.IGNORECASE):
        encoders = [name for name in names if name != command and kind is not None and _kind(name) == kind]
        outside = encoders[0] if len(encoders) == 1 else None
    if outside is None and (motor is None or load is None):
        return None
    unit = _UNITS_OF_AXES[meant]
    columns = {f"command_{unit}": command}
    columns |= {f"{what}_{unit}": name for what, name in (("motor", motor), ("load", load)) if name is not None}
    doubts: tuple[str, ...] = ()
    if outside is not None:
        what = "deviation" if _is_deviation(names, values, command, outside, unit) else "measured"
        columns[f"{what}_{unit}"] = outside
        meaning = "the deviation from the command" if what == "deviation" else "the measured place of the axis"
        is_asked = what == "deviation" and not is_deviation_by_name(outside)  # the question of its sign says it
        doubts = () if is_asked else (f"{outside} is assumed to be {meaning}",)
    units = {
        column: unit_of_column
        for column, name in columns.items()
        if (unit_of_column := bare_and_unit(name)[1]) not in (None, unit)
    }
    mapping: MappingKeys = {"columns": columns, **({"units": units} if units else {})}
    computed = [
        re.escape(name).replace("\\ ", " ")
        for name in names
        if name not in columns.values()
        and (
            re.fullmatch(_DEVIATION, bare := bare_and_unit(name)[0].casefold())
            or _NO_CONDITION.fullmatch(bare)
            or (outside is not None and _OF_MIRROR.fullmatch(bare_and_unit(outside)[0]) and _OF_MIRROR.fullmatch(bare))
        )
    ]  # from command and measured place: no condition on which an error may depend
    mapping |= {"ignore": "|".join(computed)} if computed else {}
    return Proposal("configurations", mapping, "commands of an axis, and what recorded them", doubts)


def columns_in_counts(names: Sequence[str]) -> list[str]:
    """Return the columns of encoders in counts, such as ``motor_cnt`` or ``Load [counts]``."""
    return [name for name in names if _IN_COUNTS.search(name.strip())]


def is_over_angle(names: Sequence[str]) -> bool:
    """True if one column is an angle in degrees, and another one a length."""
    of_angle = [name for name in names if _kind(name) == "angle"]
    is_command = len(of_angle) == 1 and re.fullmatch(_COMMAND, bare_and_unit(of_angle[0])[0].casefold()) is not None
    is_length = any(re.search(r"[\s\[(](mm|[uµμ]m)\b", name) for name in names if name not in of_angle)
    return is_command and bare_and_unit(of_angle[0])[1] == "deg" and is_length


def _of_autocollimator(names: Sequence[str], command: str, kind: str | None) -> str | None:
    """Return X of an autocollimator, in a small unit of angle next to a command in degrees; None without one."""
    small = [name for name in names if name != command and _kind(name) == kind and bare_and_unit(name)[1] in _SMALL]
    return next((name for name in small if bare_and_unit(name)[0].casefold() == "x"), None) if kind == "angle" else None


def is_deviation_by_name(name: str) -> bool:
    """True if words of a column's name say deviation or error, and not only what recorded it."""
    return re.search(rf"{_DEVIATION}|dev|err|abw", bare_and_unit(name)[0], re.IGNORECASE) is not None


def _first(names: Sequence[str], pattern: str, used_names: Sequence[str | None], kind: str | None) -> str | None:
    """Return the first free name with such words and a unit of a kind, or without a unit."""
    for name in names:
        bare = _OF_AXIS.sub("", bare_and_unit(name)[0].casefold())
        if name not in used_names and re.fullmatch(pattern, bare) and _kind(name) == kind:
            return name if kind is not None or bare_and_unit(name)[1] is None else None
    return None


def _kind(name: str) -> str | None:
    """Return the kind of a name's unit, angle or length; None without a unit, or with another one."""
    unit = bare_and_unit(name)[1]
    if unit is None:
        return None
    return next((kind for kind, units_of_axis in _UNITS_OF_AXES.items() if is_convertible(unit, units_of_axis)), None)


def _is_deviation(names: Sequence[str], values: Array, command: str, outside: str, own_column: str) -> bool:
    """True if an instrument's numbers span less than a hundredth of the commands', in the units of their names."""
    spans = []
    for name in (command, outside):
        column = values[:, list(names).index(name)]
        unit = bare_and_unit(name)[1] or own_column
        spans.append(float(np.nanmax(column) - np.nanmin(column)) * conversion(unit, own_column)[0])
    return spans[1] < 0.01 * spans[0]
