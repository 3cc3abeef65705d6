"""Looking at workbooks and MATLAB files: which sheet or variable holds a table, and what it seems to be."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from truing.formats.guess import Guess
from truing.formats.raw import Unusable
from truing.schemas.mapping import FileMapping

if TYPE_CHECKING:
    from truing.formats.matlab_variables import Variable

Sniff = Callable[[list[list[str]], dict[str, Any]], Guess]

_LOOK = 60
_SHOWN = 12
_AXES = 3


def sniff_workbook(path: Path, sniff: Sniff) -> Guess:
    """A proposal for the sheet that holds most; the others are named in a note."""
    from truing.formats.workbook import first_rows, text_of

    try:
        sheets = first_rows(path, _LOOK)
    except Unusable as error:
        return Guess(notes=(f"it cannot be read: expected {error.expected}",))
    guesses: dict[str, Guess] = {}
    for name, rows in sheets.items():
        texts = [[text_of(cell) for cell in row] for row in rows]
        width = max(len(row) for row in texts)
        texts = [[*row, *[""] * (width - len(row))] for row in texts]
        filled = [sum(cell != "" for cell in row) for row in texts]
        first = next(i for i, count in enumerate(filled) if count >= 0.6 * max(filled))
        keys: dict[str, Any] = {"sheet": name} if len(sheets) > 1 else {}
        guesses[name] = sniff(texts[first:], {**keys, **({"skip_lines": first} if first else {})})
    if not guesses:
        return Guess(notes=("no sheet holds anything",))
    name, best = next(((n, g) for n, g in guesses.items() if g.table is not None), next(iter(guesses.items())))
    others = [other for other in guesses if other != name]
    more = (f"sheet {name} is read; there are {', '.join(others[:_SHOWN])}",) if others else ()
    return replace(best, notes=(*best.notes, *more))


def sniff_matlab(path: Path, sniff: Sniff) -> Guess:
    """A proposal for the one variable that is a table of poses or points; else its variables, to choose from."""
    from truing.formats.matlab_variables import open_variables

    try:
        with open_variables(path) as variables:
            return _of_variables(variables, sniff)
    except Unusable as error:
        return Guess(notes=(f"it cannot be read: expected {error.expected}",))


def _of_variables(variables: Mapping[str, Variable], sniff: Sniff) -> Guess:
    from truing.formats.matlab import blocks_of, shape_of

    variables = {name: value for name, value in variables.items() if name != "None"}  # objects without a name
    listed = [f"{name} {shape_of(value)}" for name, value in variables.items()]
    told = f"variables: {', '.join(listed[:_SHOWN])}{', ...' if len(listed) > _SHOWN else ''}"
    tables = [name for name, value in variables.items() if isinstance(value, np.ndarray) and min(value.shape) > 1]
    for name in tables if len(tables) == 1 else ():
        keys = {} if len(variables) == 1 else {"variable": name}
        (block,) = blocks_of(variables, FileMapping(path="x.mat", variable=name))
        names = block.names
        cells = [[repr(float(value)) for value in row] for row in block.values[:_LOOK]]
        guess = sniff(cells, {}) if len(cells) > 1 else Guess()
        plain = {key: value for key, value in guess.mapping.items() if key in ("columns", "constants", "number_rows")}
        if guess.table == "poses" and names[0] == "m00":
            plain.pop("columns")  # they have these names already
        if guess.table == "poses" or (guess.table == "points" and len(variables) == 1 and len(cells) > _AXES):
            return Guess({**keys, **plain}, names, guess.table, (*guess.notes, told))
    example = next(iter(variables), "x")
    return Guess(notes=(f"{told}; say which: variable = {example!r}, and transpose where rows are columns",))
