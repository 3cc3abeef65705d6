"""Whether channels carry each other's labels: what runs read, against what each channel should."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from truing.estimation.interferometry.recorded_steps import CHANNELS
from truing.quality.answers import FEWEST, slope_of
from truing.quality.loading import ChannelView, ExpectedReadings, LoadingView
from truing.stages.quality.check import FAIL, PASS, Check, without

Index = NDArray[np.int64]

_ITS_OWN = 0.3  # of how far apart two channels' answers are: readings that near to one of them are its own
_APART = 0.7  # of the larger answer: nearer to each other, what the sensor does otherwise than simulated tells as much
_REGULAR = 0.9  # of a run's readings: the others may be gross errors
_OTHERS = 2  # runs that an answer is typical of


def exchanged_channels(view: LoadingView) -> Iterator[Check]:
    """Runs in which a channel reads what another should: of a pair both ways, or one that reads a main answer."""
    expected = view.simulated if view.simulated is not None else _as_others(view)
    told, count = _read_as(view, expected)
    pairs = {(int(view.axis[run]), has, like) for run, has, like, _ in told}
    wrong: dict[int, list[tuple[int, int]]] = {}
    for run, has, like, is_main in told:
        if is_main or (int(view.axis[run]), like, has) in pairs:
            wrong.setdefault(run, []).append((has, like))
    for run, found in wrong.items():
        names = " ".join(dict.fromkeys(CHANNELS[has] for has, _ in found))
        what = " and ".join(f"{CHANNELS[has]} reads what {CHANNELS[like]} should" for has, like in found)
        said = f"{view.run_name(run)}: {what}; are labels exchanged, of the channels or of the load?"
        yield Check("channels-exchanged", f"{view.run_name(run)} {names}", float(len(found)), 0.0, "1", FAIL, said)
    if not count:
        why = "no run whose channels should answer differently enough"
        yield without("labels of channels", "channels-exchanged", "", why)
    elif not wrong:
        said = f"{count} runs and channels read what they should, and not what another should."
        yield Check("channels-exchanged", "", 0.0, 0.0, "1", PASS, said)


def _read_as(view: LoadingView, expected: ExpectedReadings) -> tuple[list[tuple[int, int, int, bool]], int]:
    """Run, channel, the other that it reads like, and whether that other's answer is the larger; and how many runs and
    channels were asked."""
    found, count = [], 0
    for channel in view.channels:
        beside = [k for k in range(6) if k // 3 == channel.place // 3 and k != channel.place]
        for own, run in zip(channel.of_runs, channel.runs.tolist(), strict=True):
            rows = channel.rows[own]  # all: a run of another channel's readings may stand out as gross
            asked = [_nearness(view, channel, expected, rows, other) for other in beside]
            count += any(one is not None for one in asked)
            for other, one in zip(beside, asked, strict=True):
                if one is not None and one[0] < _ITS_OWN:
                    found.append((run, channel.place, other, one[1]))
    return found, count


def _nearness(
    view: LoadingView, channel: ChannelView, expected: ExpectedReadings, rows: Index, other: int
) -> tuple[float, bool] | None:
    """How far a channel's readings are from another's answer, over how far that is from its own; whether the other's is
    the larger. None where these are too near to each other, or too small."""
    if len(rows) < FEWEST:
        return None
    answer = expected.value[rows][:, [channel.place, other]]
    answer = answer - answer.mean(axis=0)
    size = np.sqrt(np.mean(answer**2, axis=0))
    apart = float(np.sqrt(np.mean((answer[:, 0] - answer[:, 1]) ** 2)))
    larger = int(size.argmax())
    if not apart > _APART * size[larger]:
        return None
    if not expected.is_clear((channel.place, other)[larger], rows, channel.sigma):
        return None
    off = view.steps.reading[rows, channel.place] - answer[:, 1]
    square = np.sort((off - np.median(off)) ** 2)[: int(np.ceil(_REGULAR * len(rows)))]
    return float(np.sqrt(np.mean(square))) / apart, larger == 1


def _as_others(view: LoadingView) -> ExpectedReadings:
    """Readings as the other runs under the same axis answer, by their median; NaN where they are too few."""
    slope = np.full((len(view.steps.runs), 6), np.nan)
    for channel in view.channels:
        for own, run in zip(channel.of_runs, channel.runs.tolist(), strict=True):
            rows = channel.rows[own[channel.fit.kept[own]]]
            if view.loaded_alone[run] and len(rows) >= FEWEST:
                load, reading = view.steps.load[rows, view.axis[run]], view.steps.reading[rows, channel.place]
                slope[run, channel.place] = slope_of(load, reading)[0]
    typical = np.full(slope.shape, np.nan)
    for run in np.flatnonzero(view.loaded_alone):
        others = (view.axis == view.axis[run]) & view.loaded_alone & (np.arange(len(slope)) != run)
        enough = np.isfinite(slope[others]).sum(axis=0) >= _OTHERS
        typical[run, enough] = np.nanmedian(slope[others][:, enough], axis=0)
    along = np.take_along_axis(view.steps.load, np.maximum(view.axis, 0)[view.steps.run, None], axis=1)
    return ExpectedReadings(along * typical[view.steps.run])
