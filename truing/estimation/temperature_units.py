"""Temperatures in degrees Celsius that are likely kelvin or degrees Fahrenheit, by a reference beside them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

_ZERO_C_IN_K = 273.15
_ZERO_C_IN_F, _F_PER_K = 32.0, 1.8
# A campaign keeps within this of its reference; as it stands, a mistaken value is far beyond.
_NEAR_K, _FAR_K = 60.0, 200.0
# A fahrenheit value is less than 60 K off in a laboratory: every value has to fit, not one.
_NEAR_F, _FAR_F = 15.0, 30.0
_LIKELY_K, _LIKELY_F = (230.0, 350.0), (55.0, 90.0)


@dataclass(frozen=True)
class MistakenUnit:
    """A unit that values likely are in; of_reference: it is the reference's; certain: the two contradict each other;
    rows: how many values it concerns; celsius: a typical one in degrees Celsius."""

    unit: str
    of_reference: bool
    certain: bool
    rows: int
    celsius: float


def kelvin_in_celsius(value: ArrayLike) -> NDArray[np.float64]:
    """Return temperatures in degrees Celsius of temperatures in kelvin."""
    return np.asarray(value, float) - _ZERO_C_IN_K


def fahrenheit_in_celsius(value: ArrayLike) -> NDArray[np.float64]:
    """Return temperatures in degrees Celsius of temperatures in degrees Fahrenheit."""
    return (np.asarray(value, float) - _ZERO_C_IN_F) / _F_PER_K


def mistaken_unit(value_c: ArrayLike, reference_c: float) -> MistakenUnit | None:
    """Return the unit that temperatures (N,) or the reference beside them likely are in; None where both are likely
    degrees Celsius. Values that are NaN were not recorded.

    Kelvin is told by single rows, Fahrenheit by all: 68 is a temperature in degrees Celsius, too.
    """
    value = np.asarray(value_c, float)
    value = value[np.isfinite(value)]
    if not len(value):
        return _of_reference_alone(reference_c)
    reference = np.array(reference_c)
    kelvin = _are_kelvin(value, reference)
    is_warming = (~kelvin & (np.abs(value - reference) > _NEAR_K)).any()  # a furnace gets to 300 degC by and by
    if kelvin.any() and not is_warming:
        typical = float(np.median(kelvin_in_celsius(value[kelvin])))
        return MistakenUnit("K", False, True, int(kelvin.sum()), typical)
    if _are_kelvin(reference, value).all():
        return MistakenUnit("K", True, True, 1, float(kelvin_in_celsius(reference_c)))
    if _are_fahrenheit(value, reference).all():
        return MistakenUnit("degF", False, True, len(value), float(np.median(fahrenheit_in_celsius(value))))
    if _are_fahrenheit(reference, value).all():
        return MistakenUnit("degF", True, True, 1, float(fahrenheit_in_celsius(reference_c)))
    return _of_reference_alone(reference_c) if (np.abs(value - reference_c) < _NEAR_F).all() else None


def _are_kelvin(value: NDArray[np.float64], other: NDArray[np.float64]) -> NDArray[np.bool_]:
    near = np.abs(kelvin_in_celsius(value) - other) <= _NEAR_K
    return np.asarray(near & (value - other > _FAR_K))


def _are_fahrenheit(value: NDArray[np.float64], other: NDArray[np.float64]) -> NDArray[np.bool_]:
    near = np.abs(fahrenheit_in_celsius(value) - other) <= _NEAR_F
    return np.asarray(near & (value - other > _FAR_F))


def _of_reference_alone(reference_c: float) -> MistakenUnit | None:
    """What a reference with nothing to contradict it likely is in."""
    for unit, (low, high), celsius in (
        ("K", _LIKELY_K, kelvin_in_celsius),
        ("degF", _LIKELY_F, fahrenheit_in_celsius),
    ):
        if low <= reference_c <= high:
            return MistakenUnit(unit, True, False, 1, float(celsius(reference_c)))
    return None
