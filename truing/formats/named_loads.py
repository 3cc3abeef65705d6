"""Recognition of loads of a bench and of channels of a sensor by names of columns."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from truing.formats.guess import Guess, MappingKeys
from truing.formats.raw_tables import WRENCH
from truing.formats.units import bare_and_unit, known_unit, may_be
from truing.schemas.columns import find_column

_UNIT = r"(?:[\s_]*[\[(/]\s*(?P<unit>[^\])]+?)\s*[\])]?)?"
_REFERENCE = "known|applied|nominal|ref|reference|soll|vorgabe"  # loads that are no readings
_BEHIND_NAME = rf"(?:[ _.-](?P<after>{_REFERENCE}))?"
_LETTER = re.compile(
    rf"(?:(?:kraft|moment|force|torque|last|load)[ _.-])?(?P<of>{_REFERENCE})?[ _.-]?(?P<what>[fm])_?(?P<axis>[xyz])"
    rf"{_BEHIND_NAME}{_UNIT}",
    re.I,
)
_SPELT = re.compile(
    rf"(?P<axis>[xyz])[ _.-](?P<what>force|moment|torque|displacement|translation|rotation){_UNIT}", re.I
)
_BEHIND = re.compile(
    rf"(?P<of>{_REFERENCE})?[ _.-]?(?P<what>force|moment|torque|displacement|translation|rotation)"
    rf"[ _.-](?P<axis>[xyz]){_BEHIND_NAME}{_UNIT}",
    re.I,
)
_LOGGED = re.compile(r"\d{1,4}\s*<(?P<name>[^<>]+)>\s*(?P<unit>\(.*\))?")  # number, name, unit of a channel
_CHANNEL = re.compile(
    r"(?:s|v|u|ch|channel|adc|raw|signal|bridge|sensor|gauge|dms|kanal)[ _.-]?(?:\d+|[xyz])|g\d", re.IGNORECASE
)
_NO_SIGNAL = re.compile(r"excit|suppl|speis|batter|power|versorg|ref", re.I)  # voltages that are no signals
_RUN = re.compile(
    r"(run|lauf|sequence|sequenz|serie|series|test|versuch|messreihe|essai|s(é|e)rie)([ _-]?(nr|no|id|name)\.?)?", re.I
)
_OF_ONE_AXIS = re.compile(
    rf"(?:(?:{_REFERENCE}|nenn|test|pr(?:ü|ue)f)[ _.-]?)?(?:kraft|force|load|last|gewicht|weight|masse?)"
    rf"(?:[ _.-]?(?:{_REFERENCE}))?",
    re.IGNORECASE,
)
_STEPS_PER_RUN = 3  # least rows of a run, on average
_TIME = re.compile(r"(?:t|time|zeit|zeitstempel|timestamp|x[ _]?value)\b.*", re.I)
_MOST_CHANNELS = 8
_COLUMN = {
    "f": "f{}_n",
    "force": "f{}_n",
    "m": "m{}_nm",
    "moment": "m{}_nm",
    "torque": "m{}_nm",
    "displacement": "d{}_mm",
    "translation": "d{}_mm",
    "rotation": "r{}_rad",
}
_OWN = {"n": "N", "nm": "N m", "mm": "mm", "rad": "rad"}  # unit by the end of a column's name
_LOWER = {"nmm": "N mm", "nm": "N m", "n": "N", "kn": "kN"}  # as some programs write them
_RATIO = "/V"  # end of the units of bridges
_PATH = re.compile(r"(?P<path>[^\[\]()]*?)(?P<unit>\s*[\[(].*)?")
_FEWEST = 3  # components: fewer may have such names by chance


@dataclass(frozen=True)
class LoadMapping:
    """Proposal for a table of loads: keys for its [files.<table>], what it is, and statements to confirm.

    otherwise: the proposal if the loads are applied instead of shown by the sensor itself, or the reverse.
    """

    table: str
    mapping: MappingKeys
    note: str
    doubts: tuple[str, ...] = ()
    otherwise: LoadMapping | None = None

    @property
    def is_shown(self) -> bool:
        """True if the sensor shows the loads itself."""
        return any(column.startswith("shown_") for column in self.mapping["columns"])


def load_columns(names: Sequence[str]) -> LoadMapping | None:
    """Return a proposal for a table of loads; None if no names say it.

    Of names that are paths in a model, such as ``Root/Fx/Out1 [N]``, the parts that differ count.
    """
    raw_names = _parts_of_paths(names)
    if raw_names is None:
        return _load_columns(names)
    found = _load_columns(tuple(raw_names))
    return None if found is None else _with_raw_names(found, raw_names)


def _parts_of_paths(names: Sequence[str]) -> dict[str, str] | None:
    """Return raw names by those without the parts before and behind that all paths have in common; None without
    paths."""
    halves = {name: _PATH.fullmatch(name) for name in names}
    paths = {name: half["path"].split("/") for name, half in halves.items() if half is not None and "/" in half["path"]}
    columns = list(zip(*paths.values(), strict=False))
    if len(paths) < _FEWEST or len({len(parts) for parts in paths.values()}) > 1:
        return None
    varying = [k for k, column in enumerate(columns) if len(set(column)) > 1]
    short = {
        name: "/".join(parts[k] for k in varying) + (half["unit"] or "") if (half := halves[name]) is not None else name
        for name, parts in paths.items()
    }
    raw_names = {short.get(name, name): name for name in names}
    return raw_names if len(raw_names) == len(names) else None


def _with_raw_names(found: LoadMapping, raw_names: Mapping[str, str]) -> LoadMapping:
    columns = {column: raw_names.get(name, name) for column, name in found.mapping["columns"].items()}
    otherwise = None if found.otherwise is None else _with_raw_names(found.otherwise, raw_names)
    return replace(found, mapping={**found.mapping, "columns": columns}, otherwise=otherwise)


def _load_columns(names: Sequence[str]) -> LoadMapping | None:
    plain, applied = _components(names)
    channels = _channels(names)
    fewest = 1 if any(map(_is_voltage, channels)) else _FEWEST
    if len(plain) + len(applied) < fewest or not any(column[0] in "fm" for column in (*plain, *applied)):
        return None if plain or applied else _load_of_one_axis(names)
    steps: MappingKeys = {"number_rows": {"step": 1}, "constants": {"run": "1"}}
    if any(column[0] in "dr" for column in plain):
        return LoadMapping("displacement", {**_keys(plain), **steps}, "displacements under load")
    if applied:
        signals = {f"v{WRENCH.index(column) + 1}_mv": name for column, name in plain.items()}
        if not signals:
            load_columns_given, doubts = _map_applied_loads(applied, channels, steps)
            return replace(load_columns_given, doubts=doubts)
        keys = {**_keys(applied), **steps}
        return LoadMapping(
            "signals", {**keys, "columns": {**signals, **applied}}, "known loads, next to the channels of a sensor"
        )
    load_columns_given, doubts = _map_applied_loads(plain, channels, steps)
    shown_keys = _keys({f"shown_{column}": name for column, name in plain.items()})
    note = 'indications of a sensor; no column has the applied load: constants = { load_axis = "fz", load = 10.0 }'
    shown = LoadMapping("signals", {**shown_keys, **steps}, note)
    if channels:
        return replace(load_columns_given, doubts=doubts, otherwise=shown)
    if not any(_TIME.fullmatch(name.strip()) for name in names):
        return load_columns_given
    return replace(shown, otherwise=load_columns_given)


def _load_of_one_axis(names: Sequence[str]) -> LoadMapping | None:
    """Return the proposal for a load cell: one column of forces without an axis, next to one channel of an amplifier
    or more; else None."""
    channels = [name for name in names if _is_voltage(name)]
    force = find_column("fz_n")
    loads = {
        name: unit
        for name in names
        if (unit := unit_of(name)) is not None
        and may_be(unit, force)
        and _OF_ONE_AXIS.fullmatch(bare_and_unit(name)[0].strip()) is not None
    }
    if len(loads) != 1 or not 1 <= len(channels) <= _MOST_CHANNELS:
        return None
    ((name, unit),) = loads.items()
    keys = _keys({f"v{number}_mv": channel for number, channel in enumerate(channels, start=1)})
    mapping: MappingKeys = {"columns": {**keys["columns"], "load": name}, "number_rows": {"step": 1}}
    mapping["units"] = {**keys.get("units", {}), "load": unit}
    mapping["constants"] = {"run": "1", "load_axis": "fz"}
    note = "loads of one axis, taken to be applied, next to the channels of a sensor"
    return LoadMapping("signals", mapping, note, _doubts_on_ratios(channels))


def with_recorded_runs(found: LoadMapping, names: Sequence[str], rows: Sequence[Sequence[str]]) -> LoadMapping:
    """Return the proposal with the column that names the run of each row, if there is one; else unchanged.

    A column of that name that differs from row to row counts rows.
    """
    for position, name in enumerate(names):
        if _RUN.fullmatch(bare_and_unit(name)[0].strip()) is None or name in found.mapping["columns"].values():
            continue
        values = [row[position].strip() for row in rows if position < len(row)]
        if all(values) and len(values) >= _STEPS_PER_RUN * len(set(values)):
            otherwise = None if found.otherwise is None else with_recorded_runs(found.otherwise, names, rows)
            return replace(found, mapping=_of_runs(found.mapping, name), otherwise=otherwise)
    return found


def _of_runs(mapping: MappingKeys, name: str) -> MappingKeys:
    """Return keys that take the run from a column in place of a constant."""
    constants = {key: value for key, value in mapping.get("constants", {}).items() if key != "run"}
    others = {key: value for key, value in mapping.items() if key not in ("columns", "constants")}
    columns = {"run": name, **mapping["columns"]}
    return {"columns": columns, **others, **({"constants": constants} if constants else {})}


def channels_without_loads(names: Sequence[str]) -> tuple[str, ...]:
    """Return the channels of an amplifier in a table whose other columns hold no loads."""
    plain, applied = _components(names)
    return () if plain or applied else tuple(name for name in _channels(names) if _is_voltage(name))


def with_unit_of_channels(guess: Guess, unit: str | None) -> Guess:
    """Return a file of an amplifier's channels with the voltage that words of the file state, where no name has one."""
    channels, components = _channels(guess.columns), _components(guess.columns)
    is_known = any(components) or any(map(_is_voltage, channels)) or unit is None
    if guess.table is not None or not channels or is_known or not may_be(str(unit), find_column("v1_mv")):
        return guess
    units = {f"v{number}_mv": str(unit) for number in range(1, len(channels) + 1)}
    return replace(guess, mapping={**guess.mapping, "units": units})


def channel_mapping(names: Sequence[str]) -> tuple[MappingKeys, tuple[str, ...]]:
    """Return the keys of an amplifier's channels, as signals, and a doubt if these are ratios of a bridge."""
    channels = _channels(names)
    signals = {f"v{number}_mv": name for number, name in enumerate(channels, start=1)}
    return _keys(signals), _doubts_on_ratios(channels)


def _doubts_on_ratios(channels: Sequence[str]) -> tuple[str, ...]:
    ratios = [name for name in channels if (unit_of(name) or "").endswith(_RATIO)]
    return (f"{ratios[0]} and others in {unit_of(ratios[0])} are read as at a supply of 1 V",) if ratios else ()


def _map_applied_loads(
    plain: dict[str, str], channels: Sequence[str], steps: MappingKeys
) -> tuple[LoadMapping, tuple[str, ...]]:
    """Return the proposal for applied loads, and a doubt if channels are ratios of a bridge."""
    signals = {f"v{number}_mv": name for number, name in enumerate(channels, start=1)}
    note = "loads, taken to be applied"
    note += ", next to the channels of a sensor" if channels else "; no column has the readings under them"
    return LoadMapping("signals", {**_keys({**signals, **plain}), **steps}, note), _doubts_on_ratios(channels)


def _keys(columns: dict[str, str]) -> MappingKeys:
    """Return ``columns``, and ``units`` of names that give another unit than the column's."""
    unit_of_column = {column: _unit_for(column, name) for column, name in columns.items()}
    units = {column: unit for column, unit in unit_of_column.items() if unit is not None}
    return {"columns": columns, **({"units": units} if units else {})}


def _unit_for(column: str, name: str) -> str | None:
    """Return the unit that a raw name gives, if a column may have it and has another one."""
    unit_of_load = "mV" if column.endswith("_mv") else _OWN[column.rsplit("_", 1)[-1]]
    match = _match(name)
    text = (match["unit"] if match else None) or ""
    unit = _LOWER.get(re.sub(r"[\s·*.]", "", text)) or known_unit(text) or unit_of(name)
    return (
        None if unit in (None, unit_of_load) or not may_be(unit, find_column(column.removeprefix("shown_"))) else unit
    )


def _match(name: str) -> re.Match[str] | None:
    """Return the match of a raw name of a load or motion, with its unit in brackets or behind it; else None."""
    texts = (_bare(name), bare_and_unit(_bare(name))[0])
    return next((m for text in texts for p in (_LETTER, _SPELT, _BEHIND) if (m := p.fullmatch(text))), None)


def unit_of(name: str) -> str | None:
    """Return the unit in a raw name, also behind the name that a data logger gives a channel."""
    return bare_and_unit(_bare(name))[1]


def _bare(name: str) -> str:
    """Return a raw name without a data logger's number: ``104 <Fx> (N)`` is ``Fx (N)``."""
    match = _LOGGED.fullmatch(name.strip())
    return f"{match['name']} {match['unit'] or ''}".strip() if match else name.strip()


def _channels(names: Sequence[str]) -> list[str]:
    """Return the channels of an amplifier: columns with a unit of voltage, or else columns with such names."""
    volts = [name for name in names if _is_voltage(name)]
    named = [name for name in names if _CHANNEL.fullmatch(bare_and_unit(_bare(name))[0])]
    return next(
        (channels_of_kind for channels_of_kind in (volts, named) if _FEWEST <= len(channels_of_kind) <= _MOST_CHANNELS),
        [],
    )


def _is_voltage(name: str) -> bool:
    unit = unit_of(name)
    return unit is not None and may_be(unit, find_column("v1_mv")) and _NO_SIGNAL.search(name) is None


def _components(names: Sequence[str]) -> tuple[dict[str, str], dict[str, str]]:
    """Return columns by component: measured ones, and reference ones."""
    plain: dict[str, str] = {}
    applied: dict[str, str] = {}
    for name in names:
        match = _match(name)
        if match is not None:
            column = _COLUMN[match["what"].lower()].format(match["axis"].lower())
            of_reference = any(match.groupdict().get(word) is not None for word in ("of", "after"))
            (applied if of_reference else plain).setdefault(column, name)
    return plain, applied
