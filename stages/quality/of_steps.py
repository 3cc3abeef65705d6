"""Quality of a loading programme: are steps and readings all there, did runs end early, how far the loads went."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from truing.estimation.interferometry.log_quality import runs_cut_short, steps_missing
from truing.estimation.interferometry.recorded_steps import CHANNELS, LOADS
from truing.quality.loading import LoadingView
from truing.report.numbers import count as counted
from truing.stages.common.reading_arrays import LOAD_COLUMNS
from truing.stages.common.words import listed
from truing.stages.quality.check import COUNTED, PASS, WARN, Check, without
from truing.stages.quality.limits import CampaignLimits

if TYPE_CHECKING:
    from truing.schemas.sections import Loading

_FEW = 0.1  # of a run's steps: where a table says nothing at more, it was not meant to
_RUNS_ALIKE = 3
_ROUNDED = 1e-9  # a load at its range is in it


def steps_there(view: LoadingView, limits: CampaignLimits) -> Check:
    """Numbers of steps that a run leaves out, or one of its tables; where all runs count in twos or tens, that is how
    they count."""
    steps = view.steps
    paces = np.diff(steps.step)[np.diff(steps.run) == 0]
    stride = max(math.gcd(*(int(pace) for pace in paces)), 1) if len(paces) else 1
    found = steps_missing(steps.run, (steps.step - _starts(view)[steps.run]) // stride)
    lost = np.union1d(_lost(steps.run, steps.reading), _lost(steps.run, steps.signal))
    missing = int(found.size.sum()) + len(lost)
    share = missing / max(missing + len(steps.step), 1)
    places = [f"{view.run_name(steps.run[row])} near step {steps.step[row]}" for row in found.where]
    places += [f"{view.run_name(steps.run[row])} step {steps.step[row]}" for row in lost]
    said = f"{counted(missing, 'step')} {'is' if missing == 1 else 'are'} missing: {listed(places)}."
    said = said if missing else "No step is missing."
    return limits.of("steps-missing").row("", share, "1", said)


def _lost(run: NDArray, values: NDArray) -> NDArray:
    """The few steps (N,) at which a table (B, K) of values says nothing, in runs (B,) of which it does."""
    there = np.isfinite(values).any(axis=1)
    lost = np.flatnonzero(~there & np.isin(run, np.unique(run[there])))
    return lost if len(lost) <= _FEW * there.sum() else lost[:0]


def _starts(view: LoadingView) -> NDArray[np.int64]:
    """The number (R,) that the steps of each run begin with; the lowest where most runs begin with it."""
    steps = view.steps
    first = np.full(len(steps.runs), np.iinfo(np.int64).max)
    np.minimum.at(first, steps.run, steps.step)
    return np.full(len(first), first.min()) if np.mean(first == first.min()) > 0.5 else first


def runs_whole(view: LoadingView) -> Check:
    """Runs that end before the others do, of the same axis where each has three."""
    steps = view.steps
    few = np.bincount(view.axis + 1)[view.axis + 1].min(initial=_RUNS_ALIKE) < _RUNS_ALIKE
    alike = np.zeros_like(view.axis) if few else view.axis
    found = runs_cut_short(steps.run, steps.step - _starts(view)[steps.run], alike[steps.run])
    names = [view.run_name(steps.run[row]) for row in found.where]
    said = f"Runs that end earlier than others like them: {listed(names)}." if names else "No run was cut short."
    return Check("runs-cut-short", "", float(len(names)), 0.0, "1", WARN if names else PASS, said)


def readings_there(view: LoadingView, limits: CampaignLimits) -> Iterator[Check]:
    """Per channel, the share of readings missing in the runs that it was watched in."""
    steps = view.steps
    seen = np.isfinite(steps.reading)
    for k, channel in enumerate(CHANNELS):
        watched = np.isin(steps.run, np.unique(steps.run[seen[:, k]]))
        if not watched.any():
            continue
        share = float(1.0 - seen[watched, k].mean())
        said = f"{channel}: {100.0 * share:.1f} % of the readings are missing in the runs that it was watched in."
        yield limits.of("completeness").row(f"channel {channel}", share, "1", said)
    if never := [channel for k, channel in enumerate(CHANNELS) if not seen[:, k].any()]:
        yield without("never read", "completeness", f"channels {' '.join(never)}", "what they would show stays unknown")


def pauses(view: LoadingView, limits: CampaignLimits) -> Check:
    """A pause within a run much longer than the usual pace: zeros and temperatures may have moved meanwhile."""
    steps = view.steps
    within = np.flatnonzero(np.diff(steps.run) == 0)
    pause = np.diff(steps.time_s)[within]
    if view.is_counted:
        return without("time gaps", "time-gaps", "", COUNTED)
    if len(pause) < 3 or np.median(pause) <= 0.0:
        return without("time gaps", "time-gaps", "", "too few steps with times")
    longest, usual = int(pause.argmax()), float(np.median(pause))
    after = within[longest] + 1
    where = f"{view.run_name(steps.run[after])} step {steps.step[after]}"
    times = pause[longest] / usual
    said = f"The longest pause within a run is {pause[longest]:.0f} s, {times:.1f} times the usual, before {where}."
    return limits.of("time-gaps", per=usual).row(where, float(pause[longest]), "s", said)


def load_range(view: LoadingView, loading: Loading, limits: CampaignLimits) -> Iterator[Check]:
    """Whether loads reach far enough into the range that the sensor is meant for."""
    largest = np.abs(view.steps.load).max(axis=0, initial=0.0)
    enough = limits.of("load-range")
    for k, name in enumerate(LOAD_COLUMNS):
        full, allowed = getattr(loading, name), loading.allowed(name)
        if full is None or allowed is None or largest[k] == 0.0:
            continue
        share = float(largest[k] / full)
        said = f"{LOADS[k]}: loads go to {100.0 * share:.0f} % of the range."
        if share > 1.0 + _ROUNDED:
            said += f" [loading] declares an overload test up to {100.0 * allowed / full:.0f} %."
        if enough.verdict(share) != PASS:
            said += " Beyond that, everything is extrapolated."
        yield enough.row(f"load {LOADS[k]}", share, "1", said)
