"""Quality of a loaded platform's readings: units, signs, noise, jumps, drift, zero and repetition by channel."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from truing.estimation.interferometry.log_quality import units_mistaken
from truing.estimation.pure_error import equal_scatter
from truing.estimation.quality import Scatter
from truing.quality.answers import Answers, beyond_simulation, same_sign, turned_round, typical_size
from truing.quality.loading import ChannelView, LoadingView
from truing.report.numbers import count as counted
from truing.report.numbers import handy
from truing.stages.common.words import listed
from truing.stages.quality.check import COUNTED, FAIL, PASS, WARN, Check, without
from truing.stages.quality.limits import CampaignLimits
from truing.stages.quality.unit_slips import unit_slip

_TOLERATED = 2.0  # noise beyond that multiple of the declared, or below that part of it: the declaration is unusable
_NOTED = 1.1
_REPEATS_NOTED = 1.5
_UNEQUAL = 1e-3
_NOTHING_TO_COMPARE = "no run whose readings can be compared with a simulation or with other runs"


def units(view: LoadingView, found: Answers) -> Iterator[Check]:
    """Runs whose readings are a thousand times too large, or off by another factor between units."""
    if not found.channel:
        yield without("units", "units", "", _NOTHING_TO_COMPARE)
        return
    expected = np.ones(len(found.slope)) if found.simulated else typical_size(found.slope, found.kind)
    wrong = units_mistaken(found.slope, found.sigma, expected)
    for where, factor in zip(wrong.where, wrong.size, strict=True):
        subject = f"{view.run_name(found.run[where])} {found.channel[where]}"
        said = f"{subject} reads {factor:.4g} times what is expected; is its unit, or that of the load, right?"
        yield Check("units", subject, float(factor), 1.0, "1", FAIL, said)
    beyond = beyond_simulation(found, wrong.where)
    for where in beyond:
        subject = f"{view.run_name(found.run[where])} {found.channel[where]}"
        said = f"{subject} reads {found.slope[where]:.3g} times what is simulated, and no unit explains that; "
        said += "are the elements, or the compliance, those of this sensor?"
        yield Check("units", subject, float(found.slope[where]), 1.0, "1", FAIL, said)
    if not len(wrong) and not beyond:
        said = f"The readings of {len(found.slope)} runs and channels are of a likely size."
        yield Check("units", "", 1.0, 1.0, "1", PASS, said)


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
    alike, count = int(np.count_nonzero(same_sign(found, share))), len(found.slope)
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
