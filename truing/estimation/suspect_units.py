"""Detection of columns in another unit than their name says: temperatures, times and air pressures."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from truing.arrays import Array, Index, Mask

_ZERO_C_IN_K = 273.15
_ZERO_C_IN_F, _F_PER_K = 32.0, 1.8
# Temperatures of a campaign stay within this of their reference; values in a wrong unit are far beyond.
_NEAR_K, _FAR_K = 60.0, 200.0
# Fahrenheit values in a laboratory are less than 60 K off; all values have to fit, not only one.
_NEAR_F, _FAR_F = 15.0, 30.0
_LIKELY_K, _LIKELY_F = (230.0, 350.0), (55.0, 90.0)
_LEAST_STEP_K = 25.0  # from 0 degC on, a value in degrees Fahrenheit is further off than that
_OVER_SCATTER = 6.0  # least ratio of the step to its remainder after the conversion
_SIGMAS = 4.0  # medians of ordinary changes
_FAR_SHARE = 0.1  # share of the unit changes that may coincide with a true step
_FEWEST = 6
_FLOOR_K = 0.2  # K, agreement of two thermometers, or of one before and after
_MOST_PLACES = 4
SECONDS_PER_UNIT = {"d": 86400.0, "h": 3600.0, "min": 60.0, "ms": 1e-3, "us": 1e-6, "100 ns": 1e-7, "ns": 1e-9}
_SINCE_EPOCH = {"ms": (1e12, 2.5e12), "us": (1e15, 2.5e15), "ns": (1e18, 2.5e18), "100 ns": (6.2e17, 6.6e17)}
_DAY_NUMBERS = ((20_000.0, 80_000.0), (710_000.0, 760_000.0))  # day numbers of present dates in Excel and in MATLAB
_RATES_HZ = (10, 20, 25, 30, 50, 60, 100, 120, 200, 240, 250, 300, 500, 1000)  # common rates of cameras and controllers
_FASTEST_S, _SLOWEST_S = 0.2, 20_000.0  # from pose to pose or step to step, by hand or robot
_LIKELY_S, _USUAL_S = (5.0, 7200.0), 120.0
FEWEST = 12
_EVEN = 0.01  # relative scatter of a clock's pace, which may be any
_HOUR, _DAY, _NIGHT = 3600.0, 86400.0, 10.0 / 24.0
_AWAKE = 0.9  # share of the rows outside one night's hours: people measure by day
# Laboratories are between sea level and 4000 m; pressures in mmHg at sea level look like hPa at 2300 m.
_LOWEST_HPA, _HIGHEST_HPA = 600.0, 1100.0
_NEAR_SEA_HPA = (980.0, 1040.0)
_IN_HPA = {"Pa": 1e-2, "kPa": 10.0, "bar": 1e3, "inHg": 33.86389, "atm": 1013.25}
_MMHG = 1.333224


@dataclass(frozen=True)
class MistakenUnit:
    """A likely unit of values.

    of_reference: it is the unit of the reference; certain: values and reference contradict each other; rows: number of
    affected values; celsius: a typical one in degrees Celsius.
    """

    unit: str
    of_reference: bool
    certain: bool
    rows: int
    celsius: float


def kelvin_in_celsius(value: ArrayLike) -> Array:
    """Return temperatures in degrees Celsius of temperatures in kelvin."""
    return np.asarray(value, float) - _ZERO_C_IN_K


def fahrenheit_in_celsius(value: ArrayLike) -> Array:
    """Return temperatures in degrees Celsius of temperatures in degrees Fahrenheit."""
    return (np.asarray(value, float) - _ZERO_C_IN_F) / _F_PER_K


def mistaken_unit(value_c: ArrayLike, reference_c: float) -> MistakenUnit | None:
    """Return the likely unit of temperatures (N,) or of their reference; None if both are likely degrees Celsius.

    NaN means not recorded. Kelvin is recognised in single rows, Fahrenheit only in all rows: 68 is a possible
    temperature in degrees Celsius, too.
    """
    value = np.asarray(value_c, float)
    value = value[np.isfinite(value)]
    if not len(value):
        return _mistaken_reference(reference_c)
    reference = np.array(reference_c)
    kelvin = _are_kelvin(value, reference)
    is_warming = (~kelvin & (np.abs(value - reference) > _NEAR_K)).any()  # a furnace reaches 300 degC gradually
    if kelvin.any() and not is_warming:
        typical = float(np.median(kelvin_in_celsius(value[kelvin])))
        return MistakenUnit("K", False, True, int(kelvin.sum()), typical)
    if _are_kelvin(reference, value).all():
        return MistakenUnit("K", True, True, 1, float(kelvin_in_celsius(reference_c)))
    if _are_fahrenheit(value, reference).all():
        return MistakenUnit("degF", False, True, len(value), float(np.median(fahrenheit_in_celsius(value))))
    if _are_fahrenheit(reference, value).all():
        return MistakenUnit("degF", True, True, 1, float(fahrenheit_in_celsius(reference_c)))
    return _mistaken_reference(reference_c) if (np.abs(value - reference_c) < _NEAR_F).all() else None


def _are_kelvin(value: Array, others_c: Array) -> Mask:
    near = np.abs(kelvin_in_celsius(value) - others_c) <= _NEAR_K
    return np.asarray(near & (value - others_c > _FAR_K))


def _are_fahrenheit(value: Array, others_c: Array) -> Mask:
    near = np.abs(fahrenheit_in_celsius(value) - others_c) <= _NEAR_F
    return np.asarray(near & (value - others_c > _FAR_F))


def _mistaken_reference(reference_c: float) -> MistakenUnit | None:
    """Return the likely unit of a reference without values to compare with."""
    for unit, (low, high), celsius in (
        ("K", _LIKELY_K, kelvin_in_celsius),
        ("degF", _LIKELY_F, fahrenheit_in_celsius),
    ):
        if low <= reference_c <= high:
            return MistakenUnit(unit, True, False, 1, float(celsius(reference_c)))
    return None


_CONVERSIONS = {"K": kelvin_in_celsius, "degF": fahrenheit_in_celsius}


@dataclass(frozen=True)
class MistakenRows:
    """Rows (K,) of a column, in its own order, that are likely in ``unit``; celsius: their median in degrees Celsius;
    others: median of the rest."""

    unit: str
    rows: Index
    celsius: float
    others: float


def mistaken_rows(value_c: ArrayLike, order: Index | None = None) -> MistakenRows | None:
    """Return the rows of temperatures (N,) that are likely in kelvin or degrees Fahrenheit; None without any.

    order (N,): rows in the order of measurement. Rows are recognised if every change of unit is a step that the
    conversion removes to within the ordinary change from row to row; NaN means not recorded. Steps below 25 K are not
    recognised.
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


def _upper_parts(value: Array) -> Iterator[Mask]:
    """Yield the mask (N,) of values above each wide gap between them."""
    ordered = np.sort(value)
    for at in np.flatnonzero(np.diff(ordered) >= _LEAST_STEP_K):
        yield value > ordered[at]


def _is_undone(value: Array, celsius: Array, high: Mask) -> bool:
    """True if values (N,) continue without a step after conversion of the high ones."""
    change = np.abs(np.diff(celsius))
    steps = change[np.diff(high.astype(int)) != 0]
    ordinary = np.concatenate([np.abs(np.diff(celsius[high])), np.abs(np.diff(celsius[~high]))])
    floor = _FLOOR_K + _rounding(value[high]) + _rounding(value[~high])
    limit = max(_SIGMAS * float(np.median(ordinary)), floor)
    least = float(value[high].min() - value[~high].max())
    return bool(np.mean(steps > limit) <= _FAR_SHARE and least >= _OVER_SCATTER * limit)


def _rounding(value: Array) -> float:
    """Return half of the last decimal place of the values."""
    for digits in range(_MOST_PLACES):
        if np.allclose(value, np.round(value, digits), rtol=0.0, atol=1e-9):
            return float(0.5 * 10.0**-digits)
    return 0.0


@dataclass(frozen=True)
class MistakenTimes:
    """unit: likely unit of the times, a key of SECONDS_PER_UNIT; pace: median from row to row as recorded; others:
    units that are as possible."""

    unit: str
    pace: float
    others: tuple[str, ...] = ()


def mistaken_times(time: Array, run: Index | None = None) -> MistakenTimes | None:
    """Return the likely unit of times (N,); None if seconds are possible, or if there are too few rows.

    run (N,): the pace is computed within runs. An even pace is accepted: cameras and controllers are faster and slower
    than hands.
    """
    time = np.asarray(time, float)
    run = np.zeros(len(time), dtype=np.int64) if run is None else run
    known = np.isfinite(time)
    order = np.lexsort((time[known], run[known]))
    time, run = time[known][order], run[known][order]
    pace = np.diff(time)[np.diff(run) == 0]
    if len(pace) < FEWEST - 1 or float(np.median(pace)) <= 0.0:
        return None
    typical, low, high = float(np.median(pace)), float(time.min()), float(time.max())
    for unit, (least, most) in _SINCE_EPOCH.items():
        if least <= low and high <= most:
            return MistakenTimes(unit, typical)
    is_even = float(np.ptp(pace)) <= _EVEN * typical
    if typical < _FASTEST_S and _are_days(low, high) and not (is_even and _is_rate(typical)):
        return MistakenTimes("d", typical)
    if typical < _FASTEST_S and not is_even:
        return _likeliest_unit(typical, ("d", "h", "min"))
    if typical > _SLOWEST_S and not _is_by_the_clock(typical, is_even) and not _is_by_day(time):
        return _likeliest_unit(typical, ("ms", "us", "ns"))
    return None


def _likeliest_unit(pace: float, units: tuple[str, ...]) -> MistakenTimes | None:
    """Return the unit in which a pace is closest to the usual one, among the plausible units."""
    likely = [unit for unit in units if _LIKELY_S[0] <= pace * SECONDS_PER_UNIT[unit] <= _LIKELY_S[1]]
    likely.sort(key=lambda unit: abs(np.log(pace * SECONDS_PER_UNIT[unit] / _USUAL_S)))
    return MistakenTimes(likely[0], pace, tuple(likely[1:])) if likely else None


def _are_days(low: float, high: float) -> bool:
    return any(first <= low and high <= last for first, last in _DAY_NUMBERS)


def _is_rate(pace: float) -> bool:
    return any(abs(pace * rate - 1.0) < _EVEN for rate in _RATES_HZ)


def _is_by_the_clock(pace: float, is_even: bool) -> bool:
    """True for a pace of whole hours by which a day, or several, begin alike; every 25 hours nobody measures."""
    hours = round(pace / _HOUR)
    return is_even and abs(pace / _HOUR - hours) < _EVEN and hours > 0 and (24 % hours == 0 or hours % 24 == 0)


def _is_by_day(time: Array) -> bool:
    """True if nearly all times of day leave out a night."""
    of_day = np.sort(np.mod(time, _DAY) / _DAY)
    twice = np.concatenate([of_day, of_day + 1.0])
    last = np.searchsorted(twice, of_day + (1.0 - _NIGHT), side="right")
    return bool((last - np.arange(len(of_day))).max() >= _AWAKE * len(of_day))


def likely_pressure_unit(value: float) -> str:
    """Return the likely unit of a pressure (its median, in hPa as recorded) in words; empty if likely hPa.

    Millimetres of mercury are suspected if they give a pressure near sea level, where hPa would give that of 2300 m.
    """
    if _LOWEST_HPA <= value <= _HIGHEST_HPA:
        meant = value * _MMHG
        return f"{meant:.5g} hPa, in mmHg {value:.5g}" if _NEAR_SEA_HPA[0] <= meant <= _NEAR_SEA_HPA[1] else ""
    for unit, factor in _IN_HPA.items():
        if _LOWEST_HPA <= value * factor <= _HIGHEST_HPA:
            return f"{value * factor:.5g} hPa, in {unit} {value:.6g}"
    return ""
