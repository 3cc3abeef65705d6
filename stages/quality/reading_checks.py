"""Checks of a loaded platform's readings by channel: units, signs, labels, noise, jumps, drift, zeros, repeats."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.special import ndtri

from truing.arrays import Index
from truing.estimation.interferometry.load_run import zeros_of_runs
from truing.estimation.interferometry.log_quality import units_mistaken
from truing.estimation.interferometry.recorded_steps import CHANNELS
from truing.estimation.quality import Scatter
from truing.estimation.repeatability import equal_scatter
from truing.quality.load_responses import (
    RunResponses,
    as_others,
    beyond_simulation,
    most_similar_channels,
    same_sign,
    sign_reversed,
    typical_size,
)
from truing.quality.loading import ChannelView, LoadingView, repeated_programmes
from truing.report.numbers import count_text, in_suitable_unit, listed
from truing.stages.quality.check import (
    COUNTED,
    FAIL,
    PASS,
    WARN,
    CampaignLimits,
    Check,
    gross_error_count,
    not_evaluated,
)
from truing.stages.quality.unit_slips import IMPLAUSIBLE_RATIO, unit_slip

_TOLERATED = 2.0  # noise beyond that multiple of the declared, or below that part of it: the declaration is unusable
_NOTED = 1.1
_FOLLOWS = 0.05  # level of the test whether scatter follows products of loads: so much of plain noise only warns
_NONLINEAR = 0.02  # share of a channel's response (rms) that a sensor's nonlinearity may be
_REPEATS_NOTED = 1.5
_UNEQUAL = 1e-3
_NOTHING_TO_COMPARE = "no run whose readings can be compared with a simulation or with other runs"


def units(view: LoadingView, responses: RunResponses) -> Iterator[Check]:
    """Yield the check for runs whose readings are in another unit, such as a factor of 1000."""
    if not responses.channel:
        yield not_evaluated("units", "units", "", _NOTHING_TO_COMPARE)
        return
    expected = np.ones(len(responses.slope)) if responses.simulated else typical_size(responses.slope, responses.kind)
    wrong = units_mistaken(responses.slope, responses.sigma, expected)
    for where, factor in zip(wrong.where, wrong.size, strict=True):
        subject = f"{view.run_name(responses.run[where])} {responses.channel[where]}"
        text = f"{subject} reads {factor:.4g} times the expected value; is its unit, or that of the load, right?"
        yield Check("units", subject, float(factor), 1.0, "1", FAIL, text)
    beyond = beyond_simulation(responses, wrong.where)
    for where in beyond:
        subject = f"{view.run_name(responses.run[where])} {responses.channel[where]}"
        text = f"{subject} reads {responses.slope[where]:.3g} times the simulated value, and no unit explains this; "
        text += "are the elements, or the compliance, those of this sensor?"
        yield Check("units", subject, float(responses.slope[where]), 1.0, "1", FAIL, text)
    if not len(wrong) and not beyond:
        text = f"The readings of {len(responses.slope)} runs and channels have a plausible size."
        yield Check("units", "", 1.0, 1.0, "1", PASS, text)


def signs(view: LoadingView, responses: RunResponses, quantity: str, share: float) -> Iterator[Check]:
    """Yield the check for runs that respond with the opposite sign; ``quantity``: readings or signals."""
    if not responses.channel:
        yield not_evaluated("signs", "signs", quantity, _NOTHING_TO_COMPARE)
        return
    flipped = sign_reversed(responses, share)
    for number in dict.fromkeys(responses.run[flipped].tolist()):
        names = " ".join(responses.channel[at] for at in flipped if responses.run[at] == number)
        text = f"{view.run_name(number)}: {names} with the opposite sign; of the load, or of the channel?"
        yield Check("signs", f"{view.run_name(number)} {names}", -1.0, 0.0, "1", FAIL, text)
    alike, count = int(np.count_nonzero(same_sign(responses, share))), len(responses.slope)
    if not flipped and not alike:
        why = "no run with a clear response can be compared with another run under the same axis or with a simulation"
        yield not_evaluated("signs", "signs", quantity, why)
    elif not flipped:
        against = "in the simulation" if responses.simulated else "in other runs"
        some = f"{count}" if alike == count else f"{alike} of {count}"
        text = f"{quantity}: in {some} cases (channel and run), the response has the same sign as {against}."
        if alike < count:
            text += " The others respond too little, or have no similar run to compare with."
        yield Check("signs", quantity, 1.0, 0.0, "1", PASS, text)


def not_only_noise(view: LoadingView, share: float) -> frozenset[str]:
    """Return the channels whose scatter above the declared noise may be a response that is no sum of those to single
    axes: it follows products of loads, or it is as small as a sensor's nonlinearity.

    Only where most steps load several axes at once: there no repeat of a single axis shows the noise alone.
    """
    above = [c for c in view.channels if view.is_combined(c) and _scatter(c).p_above(_TOLERATED)[0] < share]
    if view.p_of_products(above) < _FOLLOWS:
        return frozenset(channel.name for channel in above)
    small = (
        c
        for c in above
        if c.noise_ratio < IMPLAUSIBLE_RATIO and c.noise_ratio * c.sigma < _NONLINEAR * view.response(c)
    )
    return frozenset(channel.name for channel in small)


def _scatter(channel: ChannelView) -> Scatter:
    return Scatter(np.array([channel.fit.chi_square]), np.array([float(channel.fit.dof)]))


def noise(channel: ChannelView, share: float, is_response: bool = False) -> Check:
    """Check the scatter that depends neither on loads nor on time against the declared noise.

    ``is_response``: scatter above the declared noise may be a response, so that it only warns.
    """
    name = f"channel {channel.name}"
    if not np.isfinite(channel.declared):
        return not_evaluated("noise", "noise", name, "no noise is declared for it")
    if channel.fit.dof < 4:
        return not_evaluated("noise", "noise", name, "too few readings for the number of possible inputs")
    scatter = _scatter(channel)
    ratio = float(scatter.ratio[0])
    above, below = scatter.p_above(_TOLERATED)[0] < share, scatter.p_below(1.0 / _TOLERATED)[0] < share
    noted = min(scatter.p_above(_NOTED)[0], scatter.p_below(1.0 / _NOTED)[0]) < share
    text = (
        f"{channel.name}: the scatter is {ratio:.2f} times the declared noise "
        f"({count_text(channel.fit.dof, 'degree')} of freedom)."
    )
    if above and is_response:
        text += " It may be a response that is not the sum of those to single axes: repeat some combined loads."
    else:
        text += unit_slip(ratio, channel.declared * channel.in_files, channel.unit)
    verdict = FAIL if below or (above and not is_response) else WARN if noted else PASS
    return Check("noise", name, ratio, _TOLERATED, "1", verdict, text)


def gross_errors(view: LoadingView, channel: ChannelView, limits: CampaignLimits) -> Check:
    """Check for single readings far from the fitted response."""
    out = np.flatnonzero(~channel.fit.kept)
    share = len(out) / len(channel.rows)
    steps = view.places(channel.rows[out])
    text = f"{channel.name}: {gross_error_count(len(out), len(channel.rows))}"
    text += f" ({listed(steps)})." if steps else "."
    return limits.of("gross-errors").row(f"channel {channel.name}", share, "1", text)


def jumps(view: LoadingView, share: float) -> Iterator[Check]:
    """Check for runs in which a channel jumps at a step."""
    count = sum(len(channel.runs) for channel in view.channels)
    any_jump = False
    for channel in view.channels:
        for at in np.flatnonzero(channel.fit.jump_p < share / max(count, 1)):
            any_jump = True
            size = float(channel.fit.jump_size[at] * channel.in_files)
            row = channel.rows[channel.fit.jump_row[at]]
            run = view.run_name(int(channel.runs[at]))
            by = f"{'+' if size > 0.0 else ''}{in_suitable_unit(size, None, channel.unit)}"
            text = f"{run}: {channel.name} jumps by {by} before step {view.steps.step[row]}."
            yield Check("jumps", f"{run} {channel.name}", size, 0.0, channel.unit, WARN, text)
    if not any_jump:
        yield Check("jumps", "", 0.0, 0.0, "", PASS, f"No reading jumps within a run ({count} runs and channels).")


def drift(view: LoadingView, channel: ChannelView, share: float) -> Check:
    """Check for a drift of a run's zero beyond chance and three sigmas."""
    value, sigma = channel.fit.drift, channel.fit.drift_sigma * channel.noise_ratio
    known = np.isfinite(sigma) & (sigma > 0.0)
    if not known.any():
        return not_evaluated("drift", "drift", f"channel {channel.name}", "no run separates time from load")
    z = np.where(known, np.abs(value) / np.where(known, sigma, 1.0), 0.0)
    limit = -float(ndtri(0.5 * share / known.sum()))
    worst = int(np.argmax(z))
    noise = 3.0 * channel.sigma
    walks = z[worst] > limit and abs(value[worst]) > noise
    if view.is_counted and not walks:
        return not_evaluated("drift", "drift", f"channel {channel.name}", COUNTED)
    run = view.run_name(int(channel.runs[worst]))
    shown, spread, unit = value[worst] * channel.in_files, sigma[worst] * channel.in_files, channel.unit
    by = in_suitable_unit(float(shown), float(spread), unit)
    text = f"{channel.name}: the zero drifts by {by} over {run}, where the drift is clearest."
    verdict = WARN if walks else PASS
    return Check("drift", f"channel {channel.name}", abs(float(shown)), noise * channel.in_files, unit, verdict, text)


def repeatability(view: LoadingView, channel: ChannelView, share: float) -> Check:
    """Runs of the same loads in the same order, each from its own zero: their scatter against the declared noise.

    All load programmes together, and each alone: programmes of different scatter are reported separately.
    """
    name = f"channel {channel.name}"
    groups = list(repeated_programmes(view, channel))
    if not groups or not np.isfinite(channel.declared):
        return not_evaluated(
            "repeatability", "repeatability", name, "no two runs of the same loads, or no declared noise"
        )
    scatter = Scatter(np.array([group.square for group in groups]), np.array([group.freedom for group in groups]))
    pooled = scatter.pooled
    noted = pooled.p_above(_REPEATS_NOTED)[0] < 0.5 * share
    noted |= bool((scatter.p_above(_REPEATS_NOTED) < 0.5 * share / len(groups)).any())
    ratio = float(pooled.ratio[0])
    text = f"{channel.name}: runs of the same loads scatter by {ratio:.2f} times the declared noise"
    equality = equal_scatter(scatter.chi_square, scatter.dof)
    if equality is not None and equality.p_value < _UNEQUAL:
        ratio, noted = float(scatter.ratio[equality.worst]), True
        text = (
            f"{channel.name}: repeats of {groups[equality.worst].run} scatter by {ratio:.2f} times the declared noise, "
        )
        text += f"those of all other loads by {equality.others:.2f} times"
    text += f" ({count_text(round(pooled.dof[0]), 'degree')} of freedom)."
    return Check("repeatability", name, ratio, _REPEATS_NOTED, "1", WARN if noted else PASS, text)


def run_zeros(view: LoadingView) -> Iterator[Check]:
    """Does every run count from its own start, or were runs begun without setting their channels to zero?"""
    sigma, is_used = np.full(6, np.nan), np.zeros(view.steps.reading.shape, dtype=bool)
    for channel in view.channels:
        sigma[channel.place] = channel.sigma * channel.noise_ratio
        is_used[channel.rows[channel.fit.kept], channel.place] = True
    zeros = zeros_of_runs(view.steps, np.where(is_used, view.steps.reading, np.nan), sigma)
    for channel in view.channels:
        k, zero = channel.place, zeros.start[:, channel.place] * channel.in_files
        name, unit = f"channel {channel.name}", channel.unit
        if not np.isfinite(zero).any():
            yield not_evaluated("zeros of runs", "run-zeros", name, "no run begins without load")
            continue
        spread, noise = float(np.sqrt(np.nanmean(zero**2))), float(np.sqrt(2.0) * sigma[k] * channel.in_files)
        text = f"{channel.name}: runs begin {spread:.2g} {unit} (rms) from zero; "
        text += f"noise of two readings makes {noise:.2g} {unit}."
        if zeros.has_wrong_zero[k]:
            order = np.argsort(-np.abs(np.nan_to_num(zero)))[: max(int(zeros.far[:, k].sum()), 1)]
            texts = [f"{view.run_name(int(run))} {zero[run]:+.3g} {unit}" for run in order]
            text += f" Largest: {listed(texts)}. Was it set to zero before each run?"
            text += " Each is treated as relative to its own zero."
        yield Check("run-zeros", name, spread, None, unit, WARN if zeros.has_wrong_zero[k] else PASS, text)


def zero_return(view: LoadingView, channel: ChannelView, share: float) -> Check:
    """Does a channel come back to its zero once the load is taken off?"""
    steps = view.steps
    accepted_rows = [channel.rows[rows_of_run[channel.fit.kept[rows_of_run]]] for rows_of_run in channel.of_runs]
    empty = [rows[~steps.load[rows].any(axis=1)] for rows in accepted_rows]
    back = [
        place_of_run
        for place_of_run, (rows, at) in enumerate(zip(accepted_rows, empty, strict=True))
        if _has_load_between(rows, at)
    ]
    if not back:
        return not_evaluated(
            "zero return", "zero-return", f"channel {channel.name}", "no run ends without load as it began"
        )
    reading = steps.reading[:, channel.place]
    off = np.array([reading[empty[place_of_run][-1]] - reading[empty[place_of_run][0]] for place_of_run in back])
    sigma = np.sqrt(2.0) * channel.sigma * channel.noise_ratio
    limit = -float(ndtri(0.5 * share / len(back))) * sigma
    worst = int(np.argmax(np.abs(off)))
    value, unit = float(off[worst] * channel.in_files), channel.unit
    run = view.run_name(int(channel.runs[back[worst]]))
    text = (
        f"{channel.name}: the zero return after {run} is {value:+.3g} {unit}, the largest of "
        f"{count_text(len(back), 'run')}."
    )
    verdict = WARN if abs(off[worst]) > limit else PASS
    return Check("zero-return", f"channel {channel.name}", abs(value), limit * channel.in_files, unit, verdict, text)


def _has_load_between(rows: Index, empty: Index) -> bool:
    """Return True if the first and the last unloaded step of a run have a load between them."""
    return len(empty) > 1 and bool(np.sum((rows > empty[0]) & (rows < empty[-1])) > len(empty) - 2)


def exchanged_channels(view: LoadingView) -> Iterator[Check]:
    """Runs in which a channel has the readings of another: of a pair both ways, or one that reads a main response."""
    expected = view.simulated if view.simulated is not None else as_others(view)
    reported, count = most_similar_channels(view, expected)
    pairs = {(int(view.axis[run]), has, like) for run, has, like, _ in reported}
    wrong: dict[int, list[tuple[int, int]]] = {}
    for run, has, like, is_main in reported:
        if is_main or (int(view.axis[run]), like, has) in pairs:
            wrong.setdefault(run, []).append((has, like))
    for run, source_channel in wrong.items():
        names = " ".join(dict.fromkeys(CHANNELS[has] for has, _ in source_channel))
        what = " and ".join(
            f"{CHANNELS[has]} reads the response expected of {CHANNELS[like]}" for has, like in source_channel
        )
        text = f"{view.run_name(run)}: {what}; are the labels of channels or loads exchanged?"
        yield Check(
            "channels-exchanged", f"{view.run_name(run)} {names}", float(len(source_channel)), 0.0, "1", FAIL, text
        )
    if not count:
        why = "no run has channels with sufficiently different expected responses"
        yield not_evaluated("labels of channels", "channels-exchanged", "", why)
    elif not wrong:
        text = f"In {count} cases (channel and run), the response is the one expected of this channel, not of another."
        yield Check("channels-exchanged", "", 0.0, 0.0, "1", PASS, text)
