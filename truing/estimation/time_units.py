"""Times in seconds that likely are days, hours, minutes, milliseconds or smaller: by what a campaign can last."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

SECONDS = {"d": 86400.0, "h": 3600.0, "min": 60.0, "ms": 1e-3, "us": 1e-6, "100 ns": 1e-7, "ns": 1e-9}
_SINCE_EPOCH = {"ms": (1e12, 2.5e12), "us": (1e15, 2.5e15), "ns": (1e18, 2.5e18), "100 ns": (6.2e17, 6.6e17)}
_DAY_NUMBERS = ((20_000.0, 80_000.0), (710_000.0, 760_000.0))  # of our days, as Excel and as MATLAB count them
_RATES_HZ = (10, 20, 25, 30, 50, 60, 100, 120, 200, 240, 250, 300, 500, 1000)  # of cameras and controllers
_FASTEST_S, _SLOWEST_S = 0.2, 20_000.0  # from pose to pose, or step to step: no hand is faster, no robot slower
_LIKELY_S, _USUAL_S = (5.0, 7200.0), 120.0
FEWEST = 12
_EVEN = 0.01  # of the pace: a clock's, which may run as fast or as slowly as it is asked to
_HOUR, _DAY, _NIGHT = 3600.0, 86400.0, 10.0 / 24.0
_AWAKE = 0.9  # of the rows, outside one night's hours: people measure by day


@dataclass(frozen=True)
class MistakenTimes:
    """unit: in which times likely are, a key of SECONDS; pace: median from row to row as it stands; others: units that
    would be as possible."""

    unit: str
    pace: float
    others: tuple[str, ...] = ()


def mistaken_times(time: Array, run: NDArray[np.int64] | None = None) -> MistakenTimes | None:
    """Return the unit that times (N,) likely are in; None where seconds are possible, or too few tell.

    run (N,): rows of which the pace is that within runs. A clock's even pace passes: cameras and controllers are faster
    and slower than hands.
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
        return _likeliest(typical, ("d", "h", "min"))
    if typical > _SLOWEST_S and not _is_by_the_clock(typical, is_even) and not _is_by_day(time):
        return _likeliest(typical, ("ms", "us", "ns"))
    return None


def _likeliest(pace: float, units: tuple[str, ...]) -> MistakenTimes | None:
    """The unit in which a pace is nearest to the usual, among those in which it is likely at all."""
    likely = [unit for unit in units if _LIKELY_S[0] <= pace * SECONDS[unit] <= _LIKELY_S[1]]
    likely.sort(key=lambda unit: abs(np.log(pace * SECONDS[unit] / _USUAL_S)))
    return MistakenTimes(likely[0], pace, tuple(likely[1:])) if likely else None


def _are_days(low: float, high: float) -> bool:
    return any(first <= low and high <= last for first, last in _DAY_NUMBERS)


def _is_rate(pace: float) -> bool:
    return any(abs(pace * rate - 1.0) < _EVEN for rate in _RATES_HZ)


def _is_by_the_clock(pace: float, is_even: bool) -> bool:
    return is_even and abs(pace / _HOUR - round(pace / _HOUR)) < _EVEN


def _is_by_day(time: Array) -> bool:
    """Whether nearly all times of day leave out a night."""
    of_day = np.sort(np.mod(time, _DAY) / _DAY)
    twice = np.concatenate([of_day, of_day + 1.0])
    last = np.searchsorted(twice, of_day + (1.0 - _NIGHT), side="right")
    return bool((last - np.arange(len(of_day))).max() >= _AWAKE * len(of_day))
