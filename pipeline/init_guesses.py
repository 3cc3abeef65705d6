"""What `truing init` writes into a starter although no file says it: marked, until a person has looked."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from truing.schemas.columns import find_column

if TYPE_CHECKING:
    from truing.formats.sniff import Guess

MARK = "# check:"
_WHOLE_UNITS = {"metashape": "m", "vstars": "mm", "aicon": "mm", "tracker": "mm"}  # formats that name no unit
_SHOWN = 8


def guess_lines(mapping: Mapping[str, Any], guess: Guess) -> Iterator[str]:
    """Yield one marked remark on all keys of an entry that the files themselves do not say; none where they say all."""
    said = (*_of_constants(mapping.get("constants", {})), *_of_units(mapping, guess), *_of_rows(mapping))
    if said:
        yield f"{MARK} {'; '.join(said)}"


def unconfirmed(file: Path) -> str:
    """Return which guesses nobody has confirmed yet, by lines of campaign.toml; empty where there are none."""
    lines = file.read_text(encoding="utf-8").splitlines()
    found = [str(number) for number, line in enumerate(lines, 1) if line.strip().startswith(MARK)]
    if not found:
        return ""
    shown = ", ".join(found[:_SHOWN]) + (f" and {len(found) - _SHOWN} more" if len(found) > _SHOWN else "")
    many = len(found) > 1
    what = f"line{'s' * many} {shown} of {file.name} mark{'s' * (not many)} {'guesses' if many else 'a guess'}"
    return f"{what} of truing init ({MARK}): correct what is wrong, and take the remark out once it is right"


def _of_constants(constants: Mapping[str, Any]) -> Iterator[str]:
    if "body" in constants:
        yield f'body = "{constants["body"]}" is a guess, all of this is taken for one rigid body'
    if "channel" in constants:
        yield f'channel = "{constants["channel"]}" is a guess, no file says which channel this is'
    if "load_axis" in constants:
        yield f'load_axis = "{constants["load_axis"]}", load = {constants.get("load")}, taken to be without a load'
    for name in ("run", "pose"):
        if name in constants:
            yield f"{name} = {constants[name]!r}, all rows are taken for one {name}".replace("'", '"')


def _of_units(mapping: Mapping[str, Any], guess: Guess) -> Iterator[str]:
    by_unit: dict[str, list[str]] = {}
    for column, raw in mapping.get("columns", {}).items():
        if unit := _taken_unit(column, raw, mapping):
            by_unit.setdefault(unit, []).append(f"column {raw}" if isinstance(raw, int) else raw)
    whole = _whole_unit(mapping, guess)
    if whole:
        yield f'no unit is named, coordinates are taken for {whole} (else: unit = "in")'
    elif by_unit:
        words = ", ".join(f"{unit} for {_span(names)}" for unit, names in by_unit.items())
        yield f'no unit is named, taken are {words} (else: units = {{ dx_mm = "in" }})'


def _taken_unit(column: str, raw: Any, mapping: Mapping[str, Any]) -> str | None:
    """The unit that a raw column without one is taken to be in; None where it is told."""
    from truing.formats.units import bare_and_unit

    known = find_column(column)
    is_told = column == raw or column in mapping.get("units", {}) or (column.endswith("_mm") and "unit" in mapping)
    if known is None or not known.unit or known.unit == "1" or is_told:
        return None
    return known.unit if isinstance(raw, int) or bare_and_unit(raw)[1] is None else None


def _whole_unit(mapping: Mapping[str, Any], guess: Guess) -> str | None:
    """The unit that all coordinates of files without one are taken to be in; None where columns have one each."""
    if "unit" in mapping:
        return None
    is_bare = guess.table in ("points", "scans", "surfaces") and guess.columns == ("x", "y", "z")
    if "wide" in mapping or "rows_per_pose" in mapping or (is_bare and "columns" not in mapping):
        return "mm"
    return _WHOLE_UNITS.get(mapping.get("format", ""))


def _span(names: list[str]) -> str:
    return " ".join(names) if len(names) < 4 else f"{names[0]} to {names[-1]}"


def _of_rows(mapping: Mapping[str, Any]) -> Iterator[str]:
    if told := re.findall(r"\(\?P<(\w+)>", mapping.get("from_name", "")):
        yield f"the files' names tell {' and '.join(told)}"
    if "coverage" in mapping:
        yield f"coverage = {mapping['coverage']:g}, uncertainties are taken for expanded ones (1: one sigma)"
    if (axes := mapping.get("number_rows")) and "pose" in axes:
        yield "number_rows, every row is taken for a pose, in the order taken"
