"""Quality of the zeros of runs: do they begin at zero, and come back to it?"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from truing.estimation.interferometry.run_starts import zeros_of_runs
from truing.quality.loading import ChannelView, LoadingView
from truing.report.numbers import count as counted
from truing.stages.common.words import listed
from truing.stages.quality.check import PASS, WARN, Check, without


def run_zeros(view: LoadingView) -> Iterator[Check]:
    """Does every run count from its own start, or were runs begun without setting their channels to zero?"""
    sigma, kept = np.full(6, np.nan), np.zeros(view.steps.reading.shape, dtype=bool)
    for channel in view.channels:
        sigma[channel.place] = channel.sigma * channel.noise_ratio
        kept[channel.rows[channel.fit.kept], channel.place] = True
    found = zeros_of_runs(view.steps, np.where(kept, view.steps.reading, np.nan), sigma)
    for channel in view.channels:
        k, own = channel.place, found.start[:, channel.place] * channel.in_files
        name, unit = f"channel {channel.name}", channel.unit
        if not np.isfinite(own).any():
            yield without("zeros of runs", "run-zeros", name, "no run begins without load")
            continue
        spread, noise = float(np.sqrt(np.nanmean(own**2))), float(np.sqrt(2.0) * sigma[k] * channel.in_files)
        said = f"{channel.name}: runs begin {spread:.2g} {unit} from zero; noise makes it {noise:.2g} {unit}."
        if found.wrong[k]:
            order = np.argsort(-np.abs(np.nan_to_num(own)))[: max(int(found.far[:, k].sum()), 1)]
            places = [f"{view.run_name(int(run))} {own[run]:+.3g} {unit}" for run in order]
            said += f" Furthest: {listed(places)}. Was it set to zero before each run?"
            said += " They are taken to count from zeros of their own."
        yield Check("run-zeros", name, spread, noise, unit, WARN if found.wrong[k] else PASS, said)


def zero_return(view: LoadingView, channel: ChannelView, share: float) -> Check:
    """Does a channel come back to its zero once the load is taken off?"""
    steps = view.steps
    good = [channel.rows[own[channel.fit.kept[own]]] for own in channel.of_runs]
    empty = [rows[~steps.load[rows].any(axis=1)] for rows in good]
    back = [own for own, (rows, at) in enumerate(zip(good, empty, strict=True)) if _came_back(rows, at)]
    if not back:
        return without("zero return", "zero-return", f"channel {channel.name}", "no run ends without load as it began")
    reading = steps.reading[:, channel.place]
    off = np.array([reading[empty[own][-1]] - reading[empty[own][0]] for own in back])
    sigma = np.sqrt(2.0) * channel.sigma * channel.noise_ratio
    limit = -float(ndtri(0.5 * share / len(back))) * sigma
    worst = int(np.argmax(np.abs(off)))
    value, unit = float(off[worst] * channel.in_files), channel.unit
    run = view.run_name(int(channel.runs[back[worst]]))
    said = (
        f"{channel.name}: after {run} it stands {value:+.3g} {unit} from its zero, the most of "
        f"{counted(len(back), 'run')}."
    )
    verdict = WARN if abs(off[worst]) > limit else PASS
    return Check("zero-return", f"channel {channel.name}", abs(value), limit * channel.in_files, unit, verdict, said)


def _came_back(rows: NDArray[np.int64], empty: NDArray[np.int64]) -> bool:
    """Whether a run's first and last of its unloaded steps have a load between them."""
    return len(empty) > 1 and bool(np.sum((rows > empty[0]) & (rows < empty[-1])) > len(empty) - 2)
