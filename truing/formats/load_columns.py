"""Columns of forces and moments, by their names: loads of a bench, which are no coordinates of targets."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

_UNIT = r"(?:[\s_]*[\[(/]\s*(?P<unit>[^\])]+?)\s*[\])]?)?"
_LETTER = re.compile(rf"(?P<of>known|applied|ref|reference|soll)?[ _.-]?(?P<what>[fm])_?(?P<axis>[xyz]){_UNIT}", re.I)
_SPELT = re.compile(
    rf"(?P<axis>[xyz])[ _.-](?P<what>force|moment|torque|displacement|translation|rotation){_UNIT}", re.I
)
_BEHIND = re.compile(
    rf"(?P<of>known|applied|ref|reference|soll)?[ _.-]?(?P<what>force|moment|torque|displacement|translation|rotation)"
    rf"[ _.-](?P<axis>[xyz]){_UNIT}",
    re.I,
)
_CHANNEL = re.compile(r"(?:s|v|u|ch|channel|adc|raw|signal|bridge|sensor|gauge)[ _.-]?(?:\d+|[xyz])", re.I)
_TIME = re.compile(r"(?:t|time|zeit|timestamp)\b.*", re.I)
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
_UNITS = {"nmm": "N mm", "nm": None, "n": None, "kn": "kN", "mm": None, "rad": None, "deg": "deg", "in": "in"}
_FEWEST = 3  # components, as fewer may be called so by chance
_CHANNELS = ("fx_n", "fy_n", "fz_n", "mx_nm", "my_nm", "mz_nm")
Loads = tuple[str, dict[str, Any], str]


def load_columns(names: Sequence[str]) -> Loads | None:
    """The table of loads that columns make, keys for its [files.<table>], and what to look at again."""
    plain, applied, units = _components(names)
    if len(plain) + len(applied) < _FEWEST or not any(column[0] in "fm" for column in (*plain, *applied)):
        return None
    steps: dict[str, Any] = {"number_rows": {"step": 1}, "constants": {"run": "1"}}
    told = {"units": units} if units else {}
    if any(column[0] in "dr" for column in plain):
        return "displacement", {"columns": plain, **told, **steps}, "displacements under load"
    if applied:
        signals = {f"v{_CHANNELS.index(column) + 1}_mv": name for column, name in plain.items()}
        note = "known loads, beside the channels of a sensor"
        return "signals", {"columns": {**signals, **applied}, **steps}, note
    if (channels := _channels(names)) or not any(_TIME.fullmatch(name.strip()) for name in names):
        signals = {f"v{number}_mv": name for number, name in enumerate(channels, start=1)}
        note = "loads, taken to be applied"
        note += ", beside the channels of a sensor" if channels else "; what was read under them no column says"
        return "signals", {"columns": {**signals, **plain}, **told, **steps}, note
    shown = {f"shown_{column}": name for column, name in plain.items()}
    told = {"units": {f"shown_{column}": unit for column, unit in units.items()}} if units else {}
    note = 'what a sensor shows; which load was applied no column says: constants = { load_axis = "fz", load = 10.0 }'
    return "signals", {"columns": shown, **told, **steps}, note


def _channels(names: Sequence[str]) -> list[str]:
    """Columns called as the channels of an amplifier are, where there are several."""
    found = [name for name in names if _CHANNEL.fullmatch(name.strip())]
    return found if _FEWEST <= len(found) <= _MOST_CHANNELS else []


def _components(names: Sequence[str]) -> tuple[dict[str, str], dict[str, str], dict[str, str]]:
    """Columns by component: those that stand for themselves, those called known, and units where a name holds one."""
    plain: dict[str, str] = {}
    applied: dict[str, str] = {}
    units: dict[str, str] = {}
    for name in names:
        match = next((m for p in (_LETTER, _SPELT, _BEHIND) if (m := p.fullmatch(name.strip()))), None)
        if match is None:
            continue
        column = _COLUMN[match["what"].lower()].format(match["axis"].lower())
        is_applied = match.groupdict().get("of") is not None
        (applied if is_applied else plain).setdefault(column, name)
        unit = _UNITS.get(re.sub(r"[\s·*.]", "", match["unit"] or "").lower())
        if unit is not None and not is_applied:
            units[column] = unit
    return plain, applied, units
