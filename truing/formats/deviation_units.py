"""Unit of the deviations of an axis from its targets, where no name of a column gives it."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from truing.arrays import Array
from truing.formats.guess import Guess, OtherWay
from truing.formats.units import bare_and_unit, may_be
from truing.schemas.columns import find_column

_COLUMN, _TARGET = "deviation_um", "target_mm"
_LARGEST_MM = 0.5  # deviations below are probably in mm: as micrometres they would be finer than an interferometer
_QUESTION = "Unit of the deviations, which the file does not give; it scales all of them"


def with_unit_of_deviations(guess: Guess, names: Sequence[str], values: Array, unit: str | None) -> Guess:
    """Return a proposal for positions of an axis with the unit of its deviations.

    values (N, W): the numbers of the columns with these names. unit: by words of the file; None: the user decides
    between µm and mm, and the size of the numbers says which one is assumed.
    """
    raw = _columns_of_deviations(guess, names)
    if guess.table != "positioning" or not raw or any(bare_and_unit(name)[1] is not None for name in raw):
        return guess
    if unit is not None and may_be(unit, find_column(_COLUMN)):
        note = f"the file's words give the unit of deviations: {unit}"
        return replace(_in_unit(_with_unit_of_targets(guess, unit), unit), notes=(*guess.notes, note))
    numbers = np.abs(values[:, [list(names).index(name) for name in raw]])
    is_in_mm = bool(np.isfinite(numbers).any()) and float(np.nanmax(numbers)) < _LARGEST_MM
    taken, alternative = ("mm", "um") if is_in_mm else ("um", "mm")
    way = OtherWay(
        "unit",
        _QUESTION,
        taken,
        alternative,
        _in_unit(guess, alternative),
        f"no unit is given; deviations are assumed in {taken}",
    )
    return replace(_in_unit(guess, taken), ways=(*guess.ways, way))


def _columns_of_deviations(guess: Guess, names: Sequence[str]) -> list[str]:
    """Return the raw names of columns with deviations; empty if the file gives positions."""
    named = guess.mapping.get("columns", {})
    if guess.mapping.get("wide_values") == _COLUMN:
        head = re.escape(str(guess.mapping["wide"]).partition("{")[0])
        return [name for name in names if name not in named.values() and re.match(head, name)]
    return [named[_COLUMN]] if _COLUMN in named else []


def _with_unit_of_targets(guess: Guess, unit: str) -> Guess:
    """Return a proposal whose targets have the unit of the file's words; micrometres are those of deviations alone."""
    units = guess.mapping.get("units", {})
    if unit in ("um", "mm") or _TARGET in units or bare_and_unit(guess.mapping["columns"][_TARGET])[1] is not None:
        return guess
    return replace(guess, mapping={**guess.mapping, "units": {**units, _TARGET: unit}})


def _in_unit(guess: Guess, unit: str) -> Guess:
    units = {key: value for key, value in guess.mapping.get("units", {}).items() if key != _COLUMN}
    units |= {} if unit == "um" else {_COLUMN: unit}
    mapping = {key: value for key, value in guess.mapping.items() if key != "units"}
    return replace(guess, mapping={**mapping, **({"units": units} if units else {})})
