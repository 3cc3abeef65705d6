"""Rows of a temperature column that are in another unit than the rest, by the steps that a conversion undoes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from truing.estimation.temperature_units import fahrenheit_in_celsius, kelvin_in_celsius

Array = NDArray[np.float64]

_CONVERSIONS = {"K": kelvin_in_celsius, "degF": fahrenheit_in_celsius}
_LEAST_STEP_K = 25.0  # from 0 degC on, a value in degrees Fahrenheit stands further off than that
_OVER_SCATTER = 6.0  # times: how much larger the step is than what the conversion may leave of it
_SIGMAS = 4.0  # medians of ordinary changes
_FAR_SHARE = 0.1  # of the changes of unit, that may fall on a true step
_FEWEST = 6
_FLOOR_K = 0.2  # two thermometers, or one before and after, agree no better
_MOST_PLACES = 4


@dataclass(frozen=True)
class MistakenRows:
    """Rows (K,) of a column, in its own order, that likely are in ``unit``; celsius: their median in degrees Celsius;
    others: the median of the rest."""

    unit: str
    rows: NDArray[np.int64]
    celsius: float
    others: float


def mistaken_rows(value_c: ArrayLike, order: NDArray[np.int64] | None = None) -> MistakenRows | None:
    """Return the rows of temperatures (N,) that likely are in kelvin or degrees Fahrenheit; None where none stand out.

    order (N,): rows as they were taken. They are told where every change of unit is a step that the conversion undoes
    to within the ordinary change from row to row; NaN was not recorded. Steps below 25 K are never told.
    """
    value = np.asarray(value_c, float)
    rows = np.arange(len(value)) if order is None else order
    rows = rows[np.isfinite(value[rows])]
    if len(rows) < _FEWEST:
        return None
    for high in _upper_parts(value[rows]):
        for unit, converted in _CONVERSIONS.items():
            celsius = np.where(high, converted(value[rows]), value[rows])
            if _is_undone(value[rows], celsius, high):
                median = float(np.median(celsius[high])), float(np.median(celsius[~high]))
                return MistakenRows(unit, np.sort(rows[high]), *median)
    return None


def _upper_parts(value: Array) -> Iterator[NDArray[np.bool_]]:
    """Which values (N,) lie above each wide gap between them."""
    ordered = np.sort(value)
    for at in np.flatnonzero(np.diff(ordered) >= _LEAST_STEP_K):
        yield value > ordered[at]


def _is_undone(value: Array, celsius: Array, high: NDArray[np.bool_]) -> bool:
    """Whether values (N,) go on without a step once those that are high are converted."""
    change = np.abs(np.diff(celsius))
    steps = change[np.diff(high.astype(int)) != 0]
    ordinary = np.concatenate([np.abs(np.diff(celsius[high])), np.abs(np.diff(celsius[~high]))])
    floor = _FLOOR_K + _rounding(value[high]) + _rounding(value[~high])
    limit = max(_SIGMAS * float(np.median(ordinary)), floor)
    least = float(value[high].min() - value[~high].max())
    return bool(np.mean(steps > limit) <= _FAR_SHARE and least >= _OVER_SCATTER * limit)


def _rounding(value: Array) -> float:
    """Half of the last decimal place that values are written to."""
    for places in range(_MOST_PLACES):
        if np.allclose(value, np.round(value, places), rtol=0.0, atol=1e-9):
            return float(0.5 * 10.0**-places)
    return 0.0
