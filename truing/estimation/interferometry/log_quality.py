"""Faults in a log of loads and readings: functions of arrays that return affected rows or runs with their size."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from truing.arrays import Array, Index, Mask

_SAME_SIZE = 0.5  # of the logarithm of a factor: within a factor of 1.6, responses have the same size
_FEWEST_AT_WALL, _FEWEST_AT_DRIVES = 8, 3
_MEDIAN = 1.4826
# What a clipped signal would have been: its spread over the range and over the scatter, and the share of others below.
_DIFFERS, _SCATTERS, _BEYOND_OTHERS = 0.01, 5.0, 0.75
_MOST_NEIGHBOURS = 4.0  # a clipped value occurs this many times as often as its neighbour


@dataclass(frozen=True)
class LogFaults:
    """Faulty rows or runs (F,) as indices, with the size (F,) of the fault and its limit."""

    where: Index
    size: Array
    limit: float

    def __len__(self) -> int:
        return len(self.where)


def _log_faults(wrong: Mask, size: ArrayLike, limit: float) -> LogFaults:
    where = np.flatnonzero(wrong)
    return LogFaults(where, np.broadcast_to(np.asarray(size, float), wrong.shape)[where], limit)


def signs_flipped(slope: ArrayLike, sigma: ArrayLike, alike: Index, false_alarm: float = 0.01) -> LogFaults:
    """Return runs whose response has the opposite sign of most runs of the same load axis and channel.

    slope (G,): response per load of each run, with sigma (G,); alike (G,): equal numbers for the same axis and channel;
    a simulated response may be one of them. Size: slope over the median of its kind. Only runs of similar absolute size
    count; if two runs contradict each other and no third one decides, both are returned.
    """
    value = np.asarray(slope, float)
    _, kind = np.unique(alike, return_inverse=True)
    sure = significant_signs(slope, sigma, false_alarm)
    positive = np.bincount(kind, sure & (value > 0.0))[kind]
    negative = np.bincount(kind, sure & (value < 0.0))[kind]
    against = np.where(value > 0.0, negative, positive)
    along = np.where(value > 0.0, positive, negative)
    typical = _typical(np.where(sure, np.abs(value), np.nan), kind)
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = value / (np.where(value > 0.0, -1.0, 1.0) * typical)
        alike_in_size = np.abs(np.log(np.abs(ratio))) < _SAME_SIZE
    wrong = sure & alike_in_size & (against >= along) & (against > 0)
    return _log_faults(wrong, ratio, _sigmas(len(value), false_alarm))


def significant_signs(slope: ArrayLike, sigma: ArrayLike, false_alarm: float = 0.01) -> Mask:
    """Return the responses (G,) with sigma (G,) whose sign is significant, at false_alarm for all of them together."""
    value = np.asarray(slope, float)
    return np.isfinite(value) & (np.abs(value) > _sigmas(len(value), false_alarm) * np.asarray(sigma, float))


def _sigmas(count: int, false_alarm: float) -> float:
    from scipy.special import ndtri

    return float(-ndtri(0.5 * false_alarm / max(count, 1)))


def _typical(size: Array, kind: Index) -> Array:
    """Return the median (G,) of sizes (G,) of the same kind; NaN without one."""
    out = np.full(len(size), np.nan)
    for kind_number in np.unique(kind[np.isfinite(size)]):
        out[kind == kind_number] = np.nanmedian(size[kind == kind_number])
    return out


UNIT_FACTORS = (1e3, 1e-3, 1e6, 1e-6, 206264.806, 1.0 / 206264.806, 3600.0, 1.0 / 3600.0)


def units_mistaken(slope: ArrayLike, sigma: ArrayLike, expected: ArrayLike, tolerance: float = 0.3) -> LogFaults:
    """Return runs whose response is the expected one times a unit factor: mm for um, degrees or rad for arcsec.

    slope (G,); expected (G,): of the simulation, or the median of similar runs; sigma (G,): of the slope from the run's
    own scatter, since noise has the wrong unit too; tolerance: relative uncertainty of the
    expectation. Size: factor by which the readings are too large.
    """
    value = np.asarray(slope, float)
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.abs(value / np.asarray(expected, float))
        share = np.abs(np.asarray(sigma, float) / value)
        off = np.abs(np.log(ratio)[:, None] - np.log(np.asarray(UNIT_FACTORS)))
    near = np.where(np.isfinite(off), off, np.inf)
    factor = np.asarray(UNIT_FACTORS)[near.argmin(1)]
    wrong = (near.min(1) < np.log1p(tolerance)) & (share < tolerance)
    return _log_faults(wrong, factor, tolerance)


def steps_missing(run: Index, step: Index) -> LogFaults:
    """Return rows after which steps are missing; size: their number.

    Steps of a run count up by one, in any order of rows; every run starts with the lowest first step of all runs.
    """
    order = np.lexsort((step, run))
    same = np.diff(run[order]) == 0
    gap = np.where(same, np.diff(step[order]) - 1, 0)
    first = np.concatenate([[True], ~same]) if len(run) else np.zeros(0, bool)
    begin = step[order][first]
    late = begin - begin.min(initial=np.iinfo(np.int64).max) if len(begin) else begin
    missing = np.zeros(len(run))
    missing[order[:-1]] += np.maximum(gap, 0) if len(run) else 0
    missing[order[first]] += late
    return _log_faults(missing > 0.0, missing, 0.0)


def runs_cut_short(run: Index, step: Index, alike: Index) -> LogFaults:
    """Return the last rows of runs with fewer steps than most of the same kind, alike (N,); size: number of missing
    steps."""
    runs, at = np.unique(run, return_inverse=True)
    last = np.full(len(runs), -1)
    np.maximum.at(last, at, step)
    kind = np.zeros(len(runs), alike.dtype)
    kind[at] = alike
    usual = (
        np.array([np.median(last[kind == kind_number]) for kind_number in kind], float) if len(runs) else np.zeros(0)
    )
    fewer = np.where(step == last[at], usual[at] - last[at], 0.0)
    return _log_faults(fewer >= 1.0, fewer, 0.0)


def saturated(signal: ArrayLike, drive: ArrayLike | None = None) -> LogFaults:
    """Return samples (N,) at a clipped end of a signal's range; size: the value there.

    An end is clipped if its value is the largest or smallest and occurs at least eight times. It must occur many times
    as often as its neighbours, because a signal that turns there comes close often. With the drive (N,) of the signal,
    three times at different drives beyond most others are enough: this excludes a held or repeated load, and a signal
    that is constant for another reason.
    """
    value = np.asarray(signal, float)
    levels, count = np.unique(value[np.isfinite(value)], return_counts=True)
    fewest = _FEWEST_AT_WALL if drive is None else _FEWEST_AT_DRIVES
    is_at_end = np.zeros(len(value), bool)
    if len(levels) < 3:
        return _log_faults(is_at_end, value, float(fewest))
    resolution = float(np.min(np.diff(levels)))
    for end, sign in ((0, 1.0), (-1, -1.0)):
        distance = sign * (levels - levels[end])
        beside = float(count[(distance > 0.0) & (distance < 3.5 * resolution)].max(initial=0))
        there = value == levels[end]
        if count[end] >= max(fewest, _MOST_NEIGHBOURS * beside) and (
            drive is None or _is_driven_beyond(value, drive, there, sign)
        ):
            is_at_end |= there
    return _log_faults(is_at_end, value, float(fewest))


def _is_driven_beyond(value: Array, drive: ArrayLike, there: Mask, sign: float) -> bool:
    """True if the samples at an end differ more in drive (N,) than others scatter about a line over it, and lie beyond
    most others; sign 1 for the lower end."""
    level = np.asarray(drive, float)
    compared = ~there & np.isfinite(level) & np.isfinite(value)
    if compared.sum() < 3 or np.ptp(level[compared]) == 0.0:
        return False
    slope, zero = np.polyfit(level[compared], value[compared], 1)
    expected = slope * level + zero
    scatter = _MEDIAN * float(np.median(np.abs(value[compared] - expected[compared])))
    if np.ptp(expected[there]) <= max(_DIFFERS * np.ptp(expected[compared]), _SCATTERS * scatter):
        return False
    below = np.searchsorted(np.sort(expected[compared]), expected[there]) / compared.sum()
    return float(np.mean(1.0 - below if sign > 0.0 else below)) > _BEYOND_OTHERS


@dataclass(frozen=True)
class RunSurroundings:
    """Quantity of the surroundings per run (G,): first value, span, largest change from the first, and share of rows
    without a value."""

    first: Array
    span: Array
    change: Array
    missing: Array


def surroundings(value: ArrayLike, run: Index) -> RunSurroundings:
    """Return the course of a temperature, pressure or humidity (N,) in the runs 0 .. G-1 of its rows (N,), in order."""
    value = np.asarray(value, float)
    count = int(run.max(initial=-1)) + 1
    is_observed = np.isfinite(value)
    rows = np.bincount(run, minlength=count)
    low, high, first = np.full(count, np.inf), np.full(count, -np.inf), np.full(count, np.nan)
    np.minimum.at(low, run[is_observed], value[is_observed])
    np.maximum.at(high, run[is_observed], value[is_observed])
    begin, at = np.unique(run[is_observed], return_index=True)
    first[begin] = value[is_observed][at]
    change = np.zeros(count)
    np.maximum.at(change, run[is_observed], np.abs(value[is_observed] - first[run[is_observed]]))
    with np.errstate(invalid="ignore"):
        missing = 1.0 - np.bincount(run, is_observed, minlength=count) / np.where(rows > 0, rows, 1)
    known = np.isfinite(first)
    span = np.where(known, np.where(known, high, 0.0) - np.where(known, low, 0.0), np.nan)
    return RunSurroundings(first, span, np.where(known, change, np.nan), missing)


def air_effect_m(index_change: ArrayLike, dead_path: ArrayLike, displacement: ArrayLike) -> Array:
    """Return the error (m) of an uncompensated reading by a change of the index, over dead path and displacement."""
    return np.abs(np.asarray(index_change, float)) * (
        np.abs(np.asarray(dead_path, float)) + np.abs(np.asarray(displacement, float))
    )


def temperatures_out_of_reach(value_c: ArrayLike) -> LogFaults:
    """Return rows with a temperature outside of any laboratory: wrong units or a sensor that is off; size: the
    value."""
    return _outside_range(value_c, -10.0, 50.0)


def pressures_out_of_reach(value_pa: ArrayLike) -> LogFaults:
    """Return rows with an air pressure outside of any laboratory: wrong units or a sensor that is off; size: the
    value."""
    return _outside_range(value_pa, 6e4, 1.1e5)


def _outside_range(values: ArrayLike, lowest: float, highest: float) -> LogFaults:
    value = np.asarray(values, float)
    return _log_faults(np.isfinite(value) & ((value < lowest) | (value > highest)), value, highest)
