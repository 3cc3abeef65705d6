"""Responses of channels to loads or to the simulation, run by run: slopes, signs and sizes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from truing.arrays import Array, Index, Mask
from truing.estimation.interferometry.log_quality import significant_signs, signs_flipped
from truing.quality.loading import ChannelView, ExpectedReadings, LoadingView

FEWEST = 4  # fewest readings of a run for a slope
_EXACT = 1e-6
_BEYOND, _BEYOND_SIGMA = 20.0, 0.3  # factor by which no response of the same sensor differs; largest relative sigma
_ITS_OWN = 0.3  # share of the difference between two channels' responses within which readings belong to a channel
_APART = 0.7  # least difference of two responses, relative to the larger one; below it model errors are as large
_REGULAR = 0.9  # share of a run's readings that must agree; the others may be gross errors
_OTHERS = 2  # fewest other runs that define a typical response
_Response = tuple[str, int, float, float, int]


@dataclass(frozen=True)
class RunResponses:
    """Per run and channel (G,): slope of readings over their expectation, its sigma from their own scatter, and its
    kind.

    With a simulation, the expectation is the simulated reading, and a kind is a channel. Without one, it is the load of
    runs under one axis, and a kind is an axis and a channel. Responses of one kind should be equal.
    """

    channel: tuple[str, ...]
    run: Index
    slope: Array
    sigma: Array
    kind: Index
    simulated: bool


def _collected(responses: list[_Response], *, simulated: bool) -> RunResponses:
    return RunResponses(
        tuple(response[0] for response in responses),
        np.array([response[1] for response in responses], np.int64),
        np.array([response[2] for response in responses], float),
        np.array([response[3] for response in responses], float),
        np.array([response[4] for response in responses], np.int64),
        simulated,
    )


def run_responses(view: LoadingView) -> RunResponses:
    """Return the responses of all runs and channels that are clear enough to be compared."""
    runs = []
    for channel in view.channels:
        for of_run, run in zip(channel.of_runs, channel.runs.tolist(), strict=True):
            rows = channel.rows[of_run]
            drive, kind = _drive(view, channel, run, rows)
            if drive is not None and len(rows) >= FEWEST:
                runs.append((channel.name, run, *slope_of(drive, view.steps.reading[rows, channel.place]), kind))
    return _collected(runs, simulated=view.simulated is not None)


def signal_responses(view: LoadingView) -> RunResponses:
    """Return the responses of signals to the loads of runs under one axis; a kind is an axis and a signal."""
    steps, runs = view.steps, []
    for run in np.flatnonzero(view.loaded_alone).tolist():
        axis = int(view.axis[run])
        for at, name in enumerate(steps.signals):
            rows = np.flatnonzero((steps.run == run) & np.isfinite(steps.signal[:, at]))
            if len(rows) >= FEWEST:
                kind = len(steps.signals) * axis + at
                runs.append((name, run, *slope_of(steps.load[rows, axis], steps.signal[rows, at]), kind))
    return _collected(runs, simulated=False)


def _drive(view: LoadingView, channel: ChannelView, run: int, rows: Index) -> tuple[Array | None, int]:
    if view.simulated is None:
        axis = int(view.axis[run])
        return (view.steps.load[rows, axis] if view.loaded_alone[run] else None), 6 * axis + channel.place
    clear = view.simulated.is_clear(channel.place, rows, channel.sigma)
    return (view.simulated.value[rows, channel.place] if clear else None), channel.place


def slope_of(drive: Array, reading: Array) -> tuple[float, float]:
    """Return the slope and its standard deviation, by the scatter about a straight line."""
    x, y = drive - drive.mean(), reading - reading.mean()
    square = float(x @ x)
    if square == 0.0:
        return np.nan, np.inf
    value = float(x @ y) / square
    residual = y - value * x
    return value, float(np.sqrt(residual @ residual / max(len(x) - 2, 1) / square))


def beyond_simulation(responses: RunResponses, excluded: Index) -> list[int]:
    """Return the responses whose size differs from the simulation by more than any sensor can."""
    if not responses.simulated:
        return []
    size = np.abs(responses.slope)
    clear = responses.sigma < _BEYOND_SIGMA * size
    differs = clear & ((size > _BEYOND) | (size < 1.0 / _BEYOND))
    return [int(at) for at in np.flatnonzero(differs) if at not in excluded]


def typical_size(value: Array, kind: Index) -> Array:
    """Return the median size (G,) of the other responses of the same kind; NaN where there are fewer than two."""
    out = np.full(len(value), np.nan)
    for at in range(len(value)):
        same_kind = np.flatnonzero((kind == kind[at]) & (np.arange(len(value)) != at))
        if len(same_kind) > 1:
            out[at] = np.median(np.abs(value[same_kind]))
    return out


def sign_reversed(responses: RunResponses, share: float) -> list[int]:
    """Return the responses with the opposite sign to the simulated one, or to most of their kind."""
    slope, sigma, kind, count = responses.slope, responses.sigma, responses.kind, len(responses.slope)
    if responses.simulated:  # each by itself, because all of them may have the wrong sign
        slope, sigma = np.append(slope, np.ones(count)), np.append(sigma, np.full(count, _EXACT))
        kind = np.tile(np.arange(count), 2)
    return [int(at) for at in signs_flipped(slope, sigma, kind, share).where if at < count]


def same_sign(responses: RunResponses, share: float) -> Mask:
    """Return the responses (G,) that clearly have the sign of the simulated one, or of another of their kind."""
    sure = significant_signs(responses.slope, responses.sigma, share)
    if responses.simulated:
        return sure & (responses.slope > 0.0)
    groups = np.unique(np.stack([responses.kind, responses.slope > 0.0]), axis=1, return_inverse=True)[1].ravel()
    return sure & (np.bincount(groups, sure)[groups] > 1)


def most_similar_channels(
    view: LoadingView, expected: ExpectedReadings
) -> tuple[list[tuple[int, int, int, bool]], int]:
    """Return run, channel, the channel that it reads like, and whether its response is larger; and the number of tests.

    A test is a run and channel with at least one other channel whose response differs clearly.
    """
    similar, count = [], 0
    for channel in view.channels:
        candidates = [k for k in range(6) if k // 3 == channel.place // 3 and k != channel.place]
        for of_run, run in zip(channel.of_runs, channel.runs.tolist(), strict=True):
            rows = channel.rows[of_run]  # all: a run of another channel's readings may stand out as gross
            asked = [_nearness(view, channel, expected, rows, candidate) for candidate in candidates]
            count += any(answer is not None for answer in asked)
            for candidate, answer in zip(candidates, asked, strict=True):
                if answer is not None and answer[0] < _ITS_OWN:
                    similar.append((run, channel.place, candidate, answer[1]))
    return similar, count


def _nearness(
    view: LoadingView, channel: ChannelView, expected: ExpectedReadings, rows: Index, candidate: int
) -> tuple[float, bool] | None:
    """Return the distance of a channel's readings to another's response, over the distance of the two. The second
    value is True if the other's response is larger. None where the two are too similar or too small."""
    if len(rows) < FEWEST:
        return None
    response = expected.value[rows][:, [channel.place, candidate]]
    response = response - response.mean(axis=0)
    size = np.sqrt(np.mean(response**2, axis=0))
    rms_difference = float(np.sqrt(np.mean((response[:, 0] - response[:, 1]) ** 2)))
    larger = int(size.argmax())
    if not rms_difference > _APART * size[larger]:
        return None
    if not expected.is_clear((channel.place, candidate)[larger], rows, channel.sigma):
        return None
    off = view.steps.reading[rows, channel.place] - response[:, 1]
    square = np.sort((off - np.median(off)) ** 2)[: int(np.ceil(_REGULAR * len(rows)))]
    return float(np.sqrt(np.mean(square))) / rms_difference, larger == 1


def as_others(view: LoadingView) -> ExpectedReadings:
    """Return readings as the other runs under the same axis respond, by their median; NaN where there are too few."""
    slope = np.full((len(view.steps.runs), 6), np.nan)
    for channel in view.channels:
        for of_run, run in zip(channel.of_runs, channel.runs.tolist(), strict=True):
            rows = channel.rows[of_run[channel.fit.kept[of_run]]]
            if view.loaded_alone[run] and len(rows) >= FEWEST:
                load, reading = view.steps.load[rows, view.axis[run]], view.steps.reading[rows, channel.place]
                slope[run, channel.place] = slope_of(load, reading)[0]
    typical = np.full(slope.shape, np.nan)
    for run in np.flatnonzero(view.loaded_alone):
        comparable = (view.axis == view.axis[run]) & view.loaded_alone & (np.arange(len(slope)) != run)
        enough = np.isfinite(slope[comparable]).sum(axis=0) >= _OTHERS
        typical[run, enough] = np.nanmedian(slope[comparable][:, enough], axis=0)
    along = np.take_along_axis(view.steps.load, np.maximum(view.axis, 0)[view.steps.run, None], axis=1)
    return ExpectedReadings(along * typical[view.steps.run])
