"""How runs and channels answer loads, or the simulation: slopes, signs and sizes that can be compared."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truing.estimation.interferometry.log_quality import signs_flipped, signs_sure
from truing.quality.loading import ChannelView, LoadingView

Array = NDArray[np.float64]
FEWEST = 4  # readings of a run that a slope is told by
_EXACT = 1e-6
_BEYOND, _BEYOND_SIGMA = 20.0, 0.3  # a stiffness off by that factor is another sensor's
_Answer = tuple[str, int, float, float, int]


@dataclass(frozen=True)
class Answers:
    """Per run and channel (G,): readings over what they should follow, its sigma by their own scatter, and its kind.

    With a simulation readings follow it, and a kind is a channel; without one they follow the load of runs under one
    axis, and a kind is an axis and a channel. Those of one kind should be alike.
    """

    channel: tuple[str, ...]
    run: NDArray[np.int64]
    slope: Array
    sigma: Array
    kind: NDArray[np.int64]
    simulated: bool


def _gathered(found: list[_Answer], *, simulated: bool) -> Answers:
    return Answers(
        tuple(one[0] for one in found),
        np.array([one[1] for one in found], np.int64),
        np.array([one[2] for one in found], float),
        np.array([one[3] for one in found], float),
        np.array([one[4] for one in found], np.int64),
        simulated,
    )


def answers(view: LoadingView) -> Answers:
    """The answers of all runs and channels that are clear enough to be compared."""
    found = []
    for channel in view.channels:
        for own, run in zip(channel.of_runs, channel.runs.tolist(), strict=True):
            rows = channel.rows[own]
            drive, kind = _drive(view, channel, run, rows)
            if drive is not None and len(rows) >= FEWEST:
                found.append((channel.name, run, *slope_of(drive, view.steps.reading[rows, channel.place]), kind))
    return _gathered(found, simulated=view.simulated is not None)


def signal_answers(view: LoadingView) -> Answers:
    """The answers of signals to the loads of runs under one axis; a kind is an axis and a signal."""
    steps, found = view.steps, []
    for run in np.flatnonzero(view.loaded_alone).tolist():
        axis = int(view.axis[run])
        for at, name in enumerate(steps.signals):
            rows = np.flatnonzero((steps.run == run) & np.isfinite(steps.signal[:, at]))
            if len(rows) >= FEWEST:
                kind = len(steps.signals) * axis + at
                found.append((name, run, *slope_of(steps.load[rows, axis], steps.signal[rows, at]), kind))
    return _gathered(found, simulated=False)


def _drive(view: LoadingView, channel: ChannelView, run: int, rows: NDArray[np.int64]) -> tuple[Array | None, int]:
    if view.simulated is None:
        axis = int(view.axis[run])
        return (view.steps.load[rows, axis] if view.loaded_alone[run] else None), 6 * axis + channel.place
    clear = view.simulated.is_clear(channel.place, rows, channel.sigma)
    return (view.simulated.value[rows, channel.place] if clear else None), channel.place


def slope_of(drive: Array, reading: Array) -> tuple[float, float]:
    """Slope and its standard deviation by the scatter about a zero and a straight line."""
    x, y = drive - drive.mean(), reading - reading.mean()
    square = float(x @ x)
    if square == 0.0:
        return np.nan, np.inf
    value = float(x @ y) / square
    left = y - value * x
    return value, float(np.sqrt(left @ left / max(len(x) - 2, 1) / square))


def beyond_simulation(found: Answers, told: NDArray[np.int64]) -> list[int]:
    """Answers that are another size than the simulated by more than any sensor departs from it."""
    if not found.simulated:
        return []
    size = np.abs(found.slope)
    clear = found.sigma < _BEYOND_SIGMA * size
    apart = clear & ((size > _BEYOND) | (size < 1.0 / _BEYOND))
    return [int(at) for at in np.flatnonzero(apart) if at not in told]


def typical_size(value: Array, kind: NDArray[np.int64]) -> Array:
    """The median size (G,) of the others of the same kind; NaN where there are fewer than two."""
    out = np.full(len(value), np.nan)
    for at in range(len(value)):
        others = np.flatnonzero((kind == kind[at]) & (np.arange(len(value)) != at))
        if len(others) > 1:
            out[at] = np.median(np.abs(value[others]))
    return out


def turned_round(found: Answers, share: float) -> list[int]:
    """Which of the answers have the sign opposite to the simulated, or to that of most of their kind."""
    slope, sigma, kind, count = found.slope, found.sigma, found.kind, len(found.slope)
    if found.simulated:  # each by itself against it: all of them may have been turned round
        slope, sigma = np.append(slope, np.ones(count)), np.append(sigma, np.full(count, _EXACT))
        kind = np.tile(np.arange(count), 2)
    return [int(at) for at in signs_flipped(slope, sigma, kind, share).where if at < count]


def same_sign(found: Answers, share: float) -> NDArray[np.bool_]:
    """Which answers (G,) clearly have the sign of the simulated, or of another of their kind."""
    sure = signs_sure(found.slope, found.sigma, share)
    if found.simulated:
        return sure & (found.slope > 0.0)
    groups = np.unique(np.stack([found.kind, found.slope > 0.0]), axis=1, return_inverse=True)[1].ravel()
    return sure & (np.bincount(groups, sure)[groups] > 1)
