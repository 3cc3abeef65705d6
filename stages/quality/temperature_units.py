"""Whether recorded temperatures and the reference beside them are in degrees Celsius."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping

import numpy as np
from numpy.typing import NDArray

from stages.quality.check import FAIL, PASS, WARN, Check, without
from truing.estimation.temperature_units import MistakenUnit, mistaken_unit

_WORDS = {"K": "kelvin", "degF": "degrees Fahrenheit"}


def temperature_columns(names: Iterable[str]) -> list[str]:
    """Return which columns hold temperatures in degrees Celsius, by their names."""
    return [name for name in names if name.endswith("_c")]


def temperature_units(recorded: Mapping[str, NDArray[np.float64]], reference_c: float) -> Iterator[Check]:
    """A row per column of temperatures (N,), held against [mechanism] reference_temperature_c.

    A contradiction fails: it would pass as an expansion by hundreds of kelvins. A reference that looks like another
    unit by itself warns.
    """
    columns = {name: value for name, value in recorded.items() if np.isfinite(value).any()}
    found = {name: mistaken_unit(value, reference_c) for name, value in columns.items()}
    for name, value in columns.items():
        yield _check(name, value, reference_c, found[name])
    if not columns:
        alone = mistaken_unit([], reference_c)
        if alone is None:
            yield without("unit of temperatures", "temperature-unit", "", "no temperatures were recorded")
        else:
            yield _check("reference", np.array([reference_c]), reference_c, alone)


def _check(name: str, value: NDArray[np.float64], reference_c: float, found: MistakenUnit | None) -> Check:
    typical = float(np.nanmedian(value))
    if found is None:
        said = f"{name}: {typical:.5g} degC, beside a reference of {reference_c:g} degC."
        return Check("temperature-unit", name, typical, reference_c, "degC", PASS, said)
    what = f"reference_temperature_c = {reference_c:g}" if found.of_reference else f"{name}: {typical:.5g}"
    beside = f" beside a reference of {reference_c:g}" if not found.of_reference else f" beside {typical:.5g} in {name}"
    said = f"{what}{beside if found.certain else ''} is likely in {_WORDS[found.unit]}; "
    said += f"did you mean {found.celsius:.5g} degC"
    said += "?" if found.of_reference else f'? It concerns {found.rows} rows; units = {{ {name} = "{found.unit}" }}.'
    return Check("temperature-unit", name, typical, reference_c, "degC", FAIL if found.certain else WARN, said)
