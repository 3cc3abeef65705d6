"""Whether recorded temperatures and the reference beside them are in degrees Celsius."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from truing.estimation.mixed_temperature_units import MistakenRows, mistaken_rows
from truing.estimation.temperature_units import MistakenUnit, mistaken_unit
from truing.report.numbers import count
from truing.stages.common.words import listed
from truing.stages.quality.check import FAIL, PASS, WARN, Check, without

_WORDS = {"K": "kelvin", "degF": "degrees Fahrenheit"}


def temperature_columns(names: Iterable[str]) -> list[str]:
    """Return which columns hold temperatures in degrees Celsius, by their names."""
    return [name for name in names if name.endswith("_c")]


def temperature_units(
    recorded: Mapping[str, NDArray[np.float64]],
    reference_c: float,
    rows: Sequence[str] = (),
    order: NDArray[np.int64] | None = None,
) -> Iterator[Check]:
    """A row per column of temperatures (N,), held against [mechanism] reference_temperature_c, and against itself.

    rows (N,): what each row is called; order (N,): rows as they were taken. A contradiction fails: it would pass as an
    expansion by tens or hundreds of kelvins. A reference that looks like another unit by itself warns.
    """
    columns = {name: value for name, value in recorded.items() if np.isfinite(value).any()}
    for name, value in columns.items():
        part = mistaken_rows(value, order)
        if part is not None:
            yield _of_part(name, value, part, reference_c, rows)
        else:
            yield _check(name, value, reference_c, mistaken_unit(value, reference_c))
    if not columns:
        alone = mistaken_unit([], reference_c)
        if alone is None:
            yield without("unit of temperatures", "temperature-unit", "", "no temperatures were recorded")
        else:
            yield _check("reference", np.array([reference_c]), reference_c, alone)


def _of_part(
    name: str, value: NDArray[np.float64], part: MistakenRows, reference_c: float, rows: Sequence[str]
) -> Check:
    """The check of a column of which a part is in another unit."""
    low, high = float(value[part.rows].min()), float(value[part.rows].max())
    read = f"{low:.5g}" if low == high else f"{low:.5g} to {high:.5g}"
    known = int(np.isfinite(value).sum())
    said = f"{name}: {len(part.rows)} of {count(known, 'row')} ({read}) likely in {_WORDS[part.unit]}, the others in "
    said += f"degrees Celsius: did you mean {part.celsius:.5g} degC, beside {part.others:.5g}? "
    said += f"Convert {listed(_stretches(part.rows, rows))}."
    return Check("temperature-unit", name, high, reference_c, "degC", FAIL, said)


def _stretches(at: NDArray[np.int64], names: Sequence[str]) -> list[str]:
    """Rows (K,) by their names, those that follow one another as one."""
    parts = np.split(at, np.flatnonzero(np.diff(at) > 1) + 1)
    called = [(_named(part[0], names), _named(part[-1], names)) for part in parts]
    return [first if first == last else f"{first} to {last}" for first, last in called]


def _named(row: int, names: Sequence[str]) -> str:
    return names[row] if names else f"row {row + 1}"


def _check(name: str, value: NDArray[np.float64], reference_c: float, found: MistakenUnit | None) -> Check:
    typical = float(np.nanmedian(value))
    if found is None:
        said = f"{name}: {typical:.5g} degC, beside a reference of {reference_c:g} degC."
        return Check("temperature-unit", name, typical, reference_c, "degC", PASS, said)
    what = f"reference_temperature_c = {reference_c:g}" if found.of_reference else f"{name}: {typical:.5g}"
    beside = f" beside a reference of {reference_c:g}" if not found.of_reference else f" beside {typical:.5g} in {name}"
    said = f"{what}{beside if found.certain else ''} is likely in {_WORDS[found.unit]}; "
    said += f"did you mean {found.celsius:.5g} degC"
    if found.of_reference:
        said += "?"
    elif found.rows < np.isfinite(value).sum():
        said += f"? It concerns {count(found.rows, 'row')}; convert these, for the others are in degrees Celsius."
    else:
        said += f'? It concerns {count(found.rows, "row")}; units = {{ {name} = "{found.unit}" }}.'
    return Check("temperature-unit", name, typical, reference_c, "degC", FAIL if found.certain else WARN, said)
