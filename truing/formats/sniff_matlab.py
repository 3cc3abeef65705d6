"""Proposals for MATLAB files: poses, points, or loads and signals in variables with equally many rows."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from truing.formats.guess import Guess, MappingKeys
from truing.formats.matlab import Block, blocks_of, open_variables, shape_of
from truing.formats.matlab_stacks import guess_of_stacks
from truing.formats.raw import Unusable
from truing.formats.raw_tables import WRENCH
from truing.formats.sniff_cells import sniff_cells
from truing.formats.units import known_unit
from truing.schemas.mapping import FileMapping

if TYPE_CHECKING:
    from truing.formats.matlab import Variable

_LOOK, _SHOWN, _AXES, _CHANNELS = 60, 12, 3, 8
_FEWEST_STEPS = 4
_WRENCH_WORD = r"loads?|wrench(es)?|applied|reference|ref|known|kraft|lasten?|w|f"
_FORCE_WORD, _MOMENT_WORD = r"f|force|forces|kraft|kraefte", r"m|t|moment|moments|torque|torques|momente?"
_SIGNAL_WORD = r"u|v|s|signals?|volt(s|age|ages)?|mv|raw|bridges?|outputs?|counts?|adc|gauges?|sensors?|kanaele|y"
_TIME_WORD = r"t|time|zeit|times"
_VOLTAGE = "mV"


def sniff_matlab(path: Path) -> Guess:
    """Return a proposal for the variables of a MATLAB file; else the list of variables."""
    try:
        with open_variables(path) as variables:
            return _guess_variables(variables)
    except Unusable as error:
        return Guess(notes=(f"it cannot be read: expected {error.expected}",))


def _guess_variables(variables: Mapping[str, Variable]) -> Guess:
    variables = {name: value for name, value in variables.items() if name != "None"}  # unnamed objects
    listed = tuple(f"{name} {shape_of(value)}" for name, value in variables.items())
    text = f"variables: {', '.join(listed[:_SHOWN])}{', ...' if len(listed) > _SHOWN else ''}"
    tables = [name for name, value in variables.items() if isinstance(value, np.ndarray) and min(value.shape) > 1]
    for name in tables if len(tables) == 1 else ():
        if (guess := _guess_table(variables, name, text)) is not None:
            return guess
    if (guess := _guess_loads(variables, text)) is not None:
        return guess
    if (guess := guess_of_stacks(variables, text)) is not None:
        return guess
    example = next(iter(variables), "x")
    note = f"{text}; say which: variable = {example!r}, and transpose where rows are columns"
    return Guess(columns=listed, notes=(note,))


def _guess_table(variables: Mapping[str, Variable], name: str, text: str) -> Guess | None:
    keys = {} if len(variables) == 1 else {"variable": name}
    (block,) = blocks_of(variables, FileMapping(path="x.mat", variable=name))
    names = block.names
    cells = [[repr(float(value)) for value in row] for row in block.values[:_LOOK]]
    guess = sniff_cells(cells, {}) if len(cells) > 1 else Guess()
    plain = {key: value for key, value in guess.mapping.items() if key in ("columns", "constants", "number_rows")}
    if guess.table == "poses" and names[0] == "m00":
        plain.pop("columns")  # they have these names already
    if guess.table == "poses" or (guess.table == "points" and len(variables) == 1 and len(cells) > _AXES):
        return Guess({**keys, **plain}, names, guess.table, (*guess.notes, text))
    return None


def _guess_loads(variables: Mapping[str, Variable], text: str) -> Guess | None:
    """Return a proposal for loads and signals, in variables named so and with equally many rows; None without them."""
    blocks = _blocks_of_equal_length(variables)
    columns: MappingKeys = {}
    units: dict[str, str] = {}
    used: list[str] = []
    for block in blocks:
        word, unit = _word_and_unit(block.variable)
        meant = _meaning(word, len(block.names))
        if not meant or any(column in columns for column in meant):
            continue
        columns |= dict(zip(meant, block.names, strict=True))
        units |= {column: unit for column in meant if unit is not None and unit != _own_unit(column)}
        used.append(block.variable)
    has_loads = any(column.endswith(("_n", "_nm")) for column in columns)
    if not has_loads or not any(column.endswith("_mv") for column in columns):
        return None
    mapping = {
        "variable": used,
        "columns": columns,
        **({"units": units} if units else {}),
        "number_rows": {"step": 1},
        "constants": {"run": "1"},
    }
    doubt = f"{', '.join(used)} are assumed to be loads and signals, by their names"
    return Guess(mapping, tuple(columns.values()), "signals", (text,), doubts=(doubt,))


def _blocks_of_equal_length(variables: Mapping[str, Variable]) -> list[Block]:
    """Return the numeric variables whose number of rows most of them share."""
    blocks = []
    for name, value in variables.items():
        if isinstance(value, np.ndarray) and value.ndim == 2 and value.size > 1:
            blocks += blocks_of(variables, FileMapping(path="x.mat", variable=(name,)))
    rows = Counter(block.rows for block in blocks if block.rows >= _FEWEST_STEPS).most_common(1)
    equal_blocks = [block for block in blocks if rows and block.rows == rows[0][0]]
    return [_prefixed(block) for block in equal_blocks]


def _prefixed(block: Block) -> Block:
    """Return a block with the names that its columns have next to other variables."""
    if len(block.names) == 1:
        return block
    short = block.variable.rsplit(".", 1)[-1]
    return Block(block.variable, tuple(f"{short}_{number}" for number in range(1, len(block.names) + 1)), block.values)


def _word_and_unit(variable: str) -> tuple[str, str | None]:
    """Return the word of a variable's name, and the unit behind it: ``data.F_N`` is force in N."""
    word, _, behind = variable.rsplit(".", 1)[-1].partition("_")
    return word.casefold(), known_unit(behind.split("_")[0])


def _meaning(word: str, width: int) -> Sequence[str]:
    """Return the columns that a variable of this width means; empty if its name means none of them."""
    signals = tuple(f"v{number}_mv" for number in range(1, width + 1))
    if width == len(WRENCH) and re.fullmatch(_WRENCH_WORD, word):
        return WRENCH
    if width == _AXES and re.fullmatch(_FORCE_WORD, word):
        return WRENCH[:_AXES]
    if width == _AXES and re.fullmatch(_MOMENT_WORD, word):
        return WRENCH[_AXES:]
    if _AXES <= width <= _CHANNELS and re.fullmatch(_SIGNAL_WORD, word):
        return signals
    return ("time_s",) if width == 1 and re.fullmatch(_TIME_WORD, word) else ()


def _own_unit(column: str) -> str:
    if column.endswith("_mv"):
        return _VOLTAGE
    return "N m" if column.endswith("_nm") else "N" if column.endswith("_n") else "s"
