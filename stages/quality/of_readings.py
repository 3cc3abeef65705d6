"""Quality of a loaded platform's readings: units, signs, noise, jumps, drift, zero and repetition by channel."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from stages.common.words import listed
from stages.quality.check import COUNTED, FAIL, PASS, WARN, Check, without
from stages.quality.limits import CampaignLimits
from stages.quality.loading_view import ChannelView, LoadingView
from stages.quality.unit_slips import unit_slip
from truing.estimation.interferometry.log_quality import signs_flipped, signs_sure, units_mistaken
from truing.estimation.pure_error import equal_scatter
from truing.estimation.quality import Scatter
from truing.report.numbers import count as counted
from truing.report.numbers import handy

Array = NDArray[np.float64]

_TOLERATED = 2.0  # noise beyond that multiple of the declared, or below that part of it: the declaration is unusable
_NOTED = 1.1
_REPEATS_NOTED = 1.5
_UNEQUAL = 1e-3
FEWEST = 4  # readings of a run that a slope is told by
_EXACT = 1e-6
_BEYOND, _BEYOND_SIGMA = 20.0, 0.3  # a stiffness off by that factor is another sensor's
_NOTHING_TO_COMPARE = "no run whose readings can be compared with a simulation or with other runs"


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


_Answer = tuple[str, int, float, float, int]


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


def units(view: LoadingView, found: Answers) -> Iterator[Check]:
    """Runs whose readings are a thousand times too large, or off by another factor between units."""
    if not found.channel:
        yield without("units", "units", "", _NOTHING_TO_COMPARE)
        return
    expected = np.ones(len(found.slope)) if found.simulated else _typical(found.slope, found.kind)
    wrong = units_mistaken(found.slope, found.sigma, expected)
    for where, factor in zip(wrong.where, wrong.size, strict=True):
        subject = f"{view.run_name(found.run[where])} {found.channel[where]}"
        said = f"{subject} reads {factor:.4g} times what is expected; is its unit, or that of the load, right?"
        yield Check("units", subject, float(factor), 1.0, "1", FAIL, said)
    beyond = _beyond_simulation(found, wrong.where)
    for where in beyond:
        subject = f"{view.run_name(found.run[where])} {found.channel[where]}"
        said = f"{subject} reads {found.slope[where]:.3g} times what is simulated, and no unit explains that; "
        said += "are the elements, or the compliance, those of this sensor?"
        yield Check("units", subject, float(found.slope[where]), 1.0, "1", FAIL, said)
    if not len(wrong) and not beyond:
        said = f"The readings of {len(found.slope)} runs and channels are of a likely size."
        yield Check("units", "", 1.0, 1.0, "1", PASS, said)


def _beyond_simulation(found: Answers, told: NDArray[np.int64]) -> list[int]:
    """Answers that are another size than the simulated by more than any sensor departs from it."""
    if not found.simulated:
        return []
    size = np.abs(found.slope)
    clear = found.sigma < _BEYOND_SIGMA * size
    apart = clear & ((size > _BEYOND) | (size < 1.0 / _BEYOND))
    return [int(at) for at in np.flatnonzero(apart) if at not in told]


def _typical(value: Array, kind: NDArray[np.int64]) -> Array:
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


def signs(view: LoadingView, found: Answers, of: str, share: float) -> Iterator[Check]:
    """Runs that answer with the opposite sign; of: readings or signals."""
    if not found.channel:
        yield without("signs", "signs", of, _NOTHING_TO_COMPARE)
        return
    flipped = turned_round(found, share)
    for number in dict.fromkeys(found.run[flipped].tolist()):
        names = " ".join(found.channel[at] for at in flipped if found.run[at] == number)
        said = f"{view.run_name(number)}: {names} with the opposite sign; of the load, or of the channel?"
        yield Check("signs", f"{view.run_name(number)} {names}", -1.0, 0.0, "1", FAIL, said)
    alike, count = int(np.count_nonzero(_same_sign(found, share))), len(found.slope)
    if not flipped and not alike:
        why = "no run answers clearly that another one under the same axis, or a simulation, could be compared with"
        yield without("signs", "signs", of, why)
    elif not flipped:
        against = "the simulation" if found.simulated else "each other"
        some = f"{count}" if alike == count else f"{alike} of {count}"
        said = f"{of}: {some} runs and channels have the same sign as {against}."
        if alike < count:
            said += " The others answer too little, or have no like run to be compared with."
        yield Check("signs", of, 1.0, 0.0, "1", PASS, said)


def _same_sign(found: Answers, share: float) -> NDArray[np.bool_]:
    """Which answers (G,) clearly have the sign of the simulated, or of another of their kind."""
    sure = signs_sure(found.slope, found.sigma, share)
    if found.simulated:
        return sure & (found.slope > 0.0)
    groups = np.unique(np.stack([found.kind, found.slope > 0.0]), axis=1, return_inverse=True)[1].ravel()
    return sure & (np.bincount(groups, sure)[groups] > 1)


def noise(channel: ChannelView, share: float) -> Check:
    """The scatter of what follows neither loads nor time, against the declared noise."""
    name = f"channel {channel.name}"
    if not np.isfinite(channel.declared):
        return without("noise", "noise", name, "no noise is declared for it")
    if channel.fit.dof < 4:
        return without("noise", "noise", name, "too few readings beside what they may follow")
    scatter = Scatter(np.array([channel.fit.chi_square]), np.array([float(channel.fit.dof)]))
    ratio = float(scatter.ratio[0])
    unusable = min(scatter.p_above(_TOLERATED)[0], scatter.p_below(1.0 / _TOLERATED)[0]) < share
    noted = min(scatter.p_above(_NOTED)[0], scatter.p_below(1.0 / _NOTED)[0]) < share
    said = (
        f"{channel.name}: the scatter is {ratio:.2f} times the declared noise "
        f"({counted(channel.fit.dof, 'degree')} of freedom)."
    )
    said += unit_slip(ratio, channel.declared * channel.in_files, channel.unit)
    verdict = FAIL if unusable else WARN if noted else PASS
    return Check("noise", name, ratio, _TOLERATED, "1", verdict, said)


def gross_errors(view: LoadingView, channel: ChannelView, limits: CampaignLimits) -> Check:
    """Single readings far from their place."""
    out = np.flatnonzero(~channel.fit.kept)
    share = len(out) / len(channel.rows)
    steps = view.steps
    places = [f"{view.run_name(steps.run[row])} step {steps.step[row]}" for row in channel.rows[out]]
    said = f"{channel.name}: {len(out)} of {len(channel.rows)} readings are far from their place"
    said += f" ({listed(places)})." if places else "."
    return limits.of("gross-errors").row(f"channel {channel.name}", share, "1", said)


def jumps(view: LoadingView, share: float) -> Iterator[Check]:
    """Runs in which a channel jumps from some step on."""
    count = sum(len(channel.runs) for channel in view.channels)
    found = False
    for channel in view.channels:
        for at in np.flatnonzero(channel.fit.jump_p < share / max(count, 1)):
            found = True
            size = float(channel.fit.jump_size[at] * channel.in_files)
            row = channel.rows[channel.fit.jump_row[at]]
            run = view.run_name(int(channel.runs[at]))
            by = f"{'+' if size > 0.0 else ''}{handy(size, None, channel.unit)}"
            said = f"{run}: {channel.name} jumps by {by} before step {view.steps.step[row]}."
            yield Check("jumps", f"{run} {channel.name}", size, 0.0, channel.unit, WARN, said)
    if not found:
        yield Check("jumps", "", 0.0, 0.0, "", PASS, f"No run jumps, of {count} runs and channels.")


def drift(view: LoadingView, channel: ChannelView, share: float) -> Check:
    """The zero of a run that walks with time, beyond chance and three sigmas."""
    value, sigma = channel.fit.drift, channel.fit.drift_sigma * channel.noise_ratio
    known = np.isfinite(sigma) & (sigma > 0.0)
    if not known.any():
        return without("drift", "drift", f"channel {channel.name}", "no run tells time from load")
    z = np.where(known, np.abs(value) / np.where(known, sigma, 1.0), 0.0)
    limit = -float(ndtri(0.5 * share / known.sum()))
    worst = int(np.argmax(z))
    noise = 3.0 * channel.sigma
    walks = z[worst] > limit and abs(value[worst]) > noise
    if view.is_counted and not walks:
        return without("drift", "drift", f"channel {channel.name}", COUNTED)
    run = view.run_name(int(channel.runs[worst]))
    shown, spread, unit = value[worst] * channel.in_files, sigma[worst] * channel.in_files, channel.unit
    by = handy(float(shown), float(spread), unit)
    said = f"{channel.name}: the zero walks by {by} over {run}, where it is clearest."
    verdict = WARN if walks else PASS
    return Check("drift", f"channel {channel.name}", abs(float(shown)), noise * channel.in_files, unit, verdict, said)


def repeatability(view: LoadingView, channel: ChannelView, share: float) -> Check:
    """Runs of the same loads in the same order, each from its own zero: their scatter against the declared noise.

    All programmes of loads together, and each by itself: those that scatter differently are never told as one.
    """
    name = f"channel {channel.name}"
    groups = list(_repeated(view, channel))
    if not groups or not np.isfinite(channel.declared):
        return without("repeatability", "repeatability", name, "no two runs of the same loads, or no declared noise")
    scatter = Scatter(np.array([one.square for one in groups]), np.array([one.freedom for one in groups]))
    pooled = Scatter(scatter.chi_square.sum(keepdims=True), scatter.dof.sum(keepdims=True))
    noted = pooled.p_above(_REPEATS_NOTED)[0] < 0.5 * share
    noted |= bool((scatter.p_above(_REPEATS_NOTED) < 0.5 * share / len(groups)).any())
    ratio = float(pooled.ratio[0])
    said = f"{channel.name}: runs of the same loads scatter by {ratio:.2f} times the declared noise"
    apart = equal_scatter(scatter.chi_square, scatter.dof)
    if apart is not None and apart.p_value < _UNEQUAL:
        ratio, noted = float(scatter.ratio[apart.worst]), True
        said = f"{channel.name}: repeats of {groups[apart.worst].run} scatter by {ratio:.2f} times the declared noise, "
        said += f"those of all other loads by {apart.others:.2f} times"
    said += f" ({counted(round(pooled.dof[0]), 'degree')} of freedom)."
    return Check("repeatability", name, ratio, _REPEATS_NOTED, "1", WARN if noted else PASS, said)


@dataclass(frozen=True)
class _Programme:
    """Loads that were run more than once: the first run of them, chi-square and degrees of freedom of all."""

    run: str
    square: float
    freedom: float


def _repeated(view: LoadingView, channel: ChannelView) -> Iterator[_Programme]:
    steps = view.steps
    alike: dict[bytes, list[NDArray[np.int64]]] = {}
    for mine in channel.of_runs:
        alike.setdefault((steps.load[channel.rows[mine]].round(9) + 0.0).tobytes(), []).append(mine)
    for group in (np.array(rows) for rows in alike.values() if len(rows) > 1):
        used = channel.fit.kept[group].all(axis=0)
        if used.sum() < 2:
            continue
        values = steps.reading[channel.rows[group], channel.place][:, used]
        left = values - values.mean(axis=1, keepdims=True)
        left = left - left.mean(axis=0)
        square = float(np.sum((left / channel.fit.sigma[group][:, used]) ** 2))
        first = int(steps.run[channel.rows[group[0][0]]])
        yield _Programme(view.run_name(first), square, (len(group) - 1.0) * (float(used.sum()) - 1.0))
