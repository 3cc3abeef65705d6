"""Nonparametric effects on a bench: a channel depends smoothly on inputs.

A dependence of exactly the form of a catalogued cause is no candidate, because data could not distinguish the two. Such
forms are: a channel proportional to the load of its own axis, or to the time in a run.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations
from math import prod
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from truing.inference.model import ChannelCandidates
from truing.simulation.bench.causes.reading_causes import (
    FEWEST_READINGS,
    BenchScene,
    ReadingCause,
    channel_subject,
    is_signal,
    read_channels,
    unit_of,
)
from truing.simulation.bench.load_steps import (
    AIR,
    CHANNELS,
    IN_RUN,
    LOADS,
    MATERIAL,
    LoadSteps,
    ReadingState,
)
from truing.simulation.cause import Step
from truing.simulation.inputs import ORDER, TIME, middle_and_half, varying_columns
from truing.simulation.nonparametric import PER_FUNCTION, POLYNOMIAL, WAVES, NonparametricEffect, dependence

# Prefixes of a load's name: whether its size decreases; its largest size so far in the run; sign of its last change.
UNLOADING, SO_FAR, WAY = "unloading ", "largest so far ", "direction of "
# Forms: a load one and two steps before; sine and cosine of a period.
MEMORY, PERIOD = "memory", "period"
_PREVIOUS_STEPS, _SINE_AND_COSINE = 2, 2
# Form: a jump beyond a size of the load, with an amount for each sign; largest number of sizes.
BEYOND, _SIDES = "beyond", 2
_MOST_SIZES = 5
# Form: a load and its product with a column; two factors, because the column has no known zero.
GAIN, _FACTORS = "gain", 2
# Form: a decay after a break in a run; ratio of neighbouring time constants and their largest number.
REST = "rest"
_FADES, _MOST_FADES = 2.0, 8
_SMOOTH = 3
_WAVES = 6
# Plausible amplitude, in sigmas of the channel.
_PLAUSIBLE_SIGMAS = 4.0
# Columns with a linear cause in the catalogue.
_NAMED_LINEAR = (IN_RUN, MATERIAL, AIR)
# Periods of time: least steps per period, least periods per campaign, largest number, frequency step in 1 / campaign.
_STEPS_PER_PERIOD, _PERIODS_AT_LEAST, _MOST_PERIODS, _APART = 2.5, 3.0, 300, 0.5
# Periods of a load: least levels per period, as waves fit any fewer levels, and least periods in the range of loads, as
# polynomials cover slower waves.
_LEVELS_PER_PERIOD, _LOAD_PERIODS_AT_LEAST = 4, 2.0
# Loads that differ by less than this share of their range are repetitions of one level.
_ONE_LEVEL = 0.01


@dataclass(frozen=True)
class NonparametricReadingEffect(NonparametricEffect[BenchScene], ReadingCause):
    """A channel depends on inputs: columns of the steps, loads, and the history of loads.

    Further forms: ``memory``, a load one and two steps before; ``period``, sine and cosine with the half range as
    period of time or of a load; ``beyond``, a jump if a load exceeds the half range, on either side; ``gain``, a load
    and its product with a column; ``rest``, a decay after a break, with the half range as time constant. ``scale`` is a
    plausible amplitude, SI; ``weight`` the relative prior weight among forms.
    """

    channel: str = "dz"
    scale: float = 1.0
    weight: float = 1.0

    step = Step.INSTRUMENT
    reach = 100.0
    of_time = frozenset({TIME, ORDER, IN_RUN})
    letters: ClassVar[dict[str, str]] = {
        **NonparametricEffect.letters,
        MEMORY: "before",
        PERIOD: "part",
        BEYOND: "side",
        GAIN: "gain",
        REST: "rest",
    }
    boundless = frozenset({PERIOD, BEYOND, REST})

    @property
    def subject(self) -> str:
        """Channel concerned."""
        return channel_subject(self.channel)

    def inputs(self, legs: int) -> tuple[str, ...]:
        """Return the columns of the tables that it depends on."""
        plain = tuple(column.removeprefix(UNLOADING).removeprefix(SO_FAR).removeprefix(WAY) for column in self.columns)
        return tuple(dict.fromkeys(TIME if column == IN_RUN else column for column in plain))

    def candidates(self, scene: BenchScene) -> Sequence[NonparametricReadingEffect]:
        """Return all dependences of each channel for which there are enough readings."""
        steps, is_observed = scene.steps, scene.recorded
        effects: list[NonparametricReadingEffect] = []
        for channel in read_channels(scene):
            is_seen = is_observed[:, index := steps.channels.index(channel)]
            bare = NonparametricReadingEffect(channel=channel, scale=_PLAUSIBLE_SIGMAS * float(steps.sigma[index]))
            for columns, form, degree in _dependences(steps, is_seen, channel):
                if is_seen.sum() >= PER_FUNCTION * degree:
                    effects.append(replace(bare, **dependence(columns, partial(_range_of, steps), form, degree)))
            effects += _jump_candidates(bare, steps, is_seen)
            fades = fading_times(steps, is_seen)
            rest = replace(bare, form=REST, weight=1.0 / max(len(fades), 1))
            effects += [replace(rest, half_ranges=(float(tau),)) for tau in fades]
        return effects

    def channel_candidates(self, scene: BenchScene) -> Sequence[ChannelCandidates[NonparametricReadingEffect]]:
        """Return periodic dependences of each channel on time and on loads, for all periods that the campaign can
        distinguish."""
        steps, is_observed = scene.steps, scene.recorded
        return [
            periodic_candidate
            for column in (*({TIME} & steps.covariates.keys()), *_applied(steps))
            for periodic_candidate in _periodic_candidates(steps, is_observed, column)
        ]

    def prior(self, scene: BenchScene) -> float:
        """Return the relative prior weight: proportionality to one input is more probable than the other forms."""
        return super().prior(scene) * self.weight

    def channel_slopes(self, steps: LoadSteps) -> tuple[NDArray, NDArray]:
        """Return its channel and the values of the functions."""
        return np.array([name == self.channel for name in steps.channels]), self.functions(steps)

    def slopes(self, state: ReadingState, values: NDArray) -> NDArray:
        """Return the values of the functions at the channel's readings."""
        response, basis = self.channel_slopes(state.steps)
        return np.asarray(basis[:, None] * response[:, None])

    def functions(self, steps: LoadSteps) -> NDArray:
        """Return the values (B, m) of the functions, the same for all channels."""
        key = replace(self, channel="", scale=1.0, weight=1.0)
        if key not in steps.functions:
            steps.functions[key] = self._functions(steps)
        return steps.functions[key]

    def _functions(self, steps: LoadSteps) -> NDArray:
        if self.form == MEMORY:
            return _previous_loads(steps, self.columns[0])
        if self.form == REST:
            return np.exp(-steps.since_break_s / self.half_ranges[0])[:, None]
        if self.form in (POLYNOMIAL, WAVES):
            return self.basis(lambda column: _values_of(steps, column))
        inputs = self.scaled(lambda column: _values_of(steps, column))
        x = np.asarray(prod(inputs))
        if self.form == GAIN:
            return np.stack([inputs[0], x], -1)
        if self.form == BEYOND:
            return np.stack([x > 1.0, x < -1.0], -1).astype(float)[:, : self.degree]
        return np.stack([np.sin(2.0 * np.pi * x), np.cos(2.0 * np.pi * x)], -1)

    @property
    def _terms(self) -> str:
        return f"{self.half_ranges[0]:.6g}" if self.form in self.boundless else super()._terms

    @property
    def _in_key(self) -> tuple[tuple[str, ...], tuple[str, ...]]:
        return (self.channel,), ()

    @property
    def _amplitude(self) -> tuple[str, float, float]:
        return *unit_of(self.channel), self.scale


def _applied(steps: LoadSteps) -> list[str]:
    return [name for name, loaded in zip(LOADS, steps.loaded, strict=True) if loaded]


def _periodic_candidates(steps: LoadSteps, is_observed: NDArray, column: str) -> list[ChannelCandidates]:
    """Return periodic dependences of channels on a column, grouped by noise; ``is_observed`` (B, K): readings."""
    periods = _periods_of(steps, column)
    start = float(steps.time_s[0]) if column == TIME else 0.0
    moved = is_observed & (_values_of(steps, column) != start)[:, None]
    read = np.flatnonzero(moved.sum(0) >= PER_FUNCTION * _SINE_AND_COSINE)
    if not len(periods) or not len(read):
        return []
    inputs = {"columns": (column,), "centres": (start,), "form": PERIOD, "degree": _SINE_AND_COSINE}
    forms = [NonparametricReadingEffect(half_ranges=(float(period),), **inputs) for period in periods]  # type: ignore[arg-type]
    shapes = np.stack([form.functions(steps) for form in forms])

    def with_equal_noise(columns: NDArray) -> ChannelCandidates[NonparametricReadingEffect]:
        scale = _PLAUSIBLE_SIGMAS * float(steps.sigma[columns[0]])

        def member(target: int, shape: int) -> NonparametricReadingEffect:
            return replace(forms[shape], channel=steps.channels[columns[target]], scale=scale)

        return ChannelCandidates(shapes, columns, np.ones((len(periods), len(columns)), bool), scale, member)

    return [with_equal_noise(read[steps.sigma[read] == sigma]) for sigma in np.unique(steps.sigma[read])]


def _jump_candidates(
    bare: NonparametricReadingEffect, steps: LoadSteps, is_observed: NDArray
) -> list[NonparametricReadingEffect]:
    """Return jumps of a channel beyond several sizes of each load, if there are enough readings.

    ``is_observed`` (B,): steps at which it was read.
    """
    effects: list[NonparametricReadingEffect] = []
    for load in _applied(steps):
        values, sizes = _values_of(steps, load)[is_observed], _sizes_between(steps, load, is_observed)
        for size in sizes:
            beyond = int(np.sum(values > size)), int(np.sum(values < -size))
            sides = _SIDES if min(beyond) else 1
            if beyond[0] >= PER_FUNCTION and len(values) >= PER_FUNCTION * sides:
                jump = replace(bare, columns=(load,), half_ranges=(float(size),), form=BEYOND, degree=sides)
                effects.append(replace(jump, weight=1.0 / len(sizes)))
    return effects


def _dependences(steps: LoadSteps, is_observed: NDArray, channel: str) -> Iterator[tuple[tuple[str, ...], str, int]]:
    """Yield columns, form and degree of dependences of a channel that was read at steps ``is_observed`` (B,)."""
    loads = _applied(steps)
    main_load = LOADS[CHANNELS.index(channel)] if channel in CHANNELS else ""
    other_columns = [name for name in varying_columns(steps.covariates, is_observed) if name not in LOADS]

    def levels(*columns: str) -> int:
        values = np.prod([_values_of(steps, column)[is_observed] for column in columns], axis=0)
        return len(np.unique(np.round(values, 12)))

    for load in loads:
        first = 2 if load == main_load or is_signal(channel) else 1
        for degree in range(first, _SMOOTH + 1):
            if levels(load) > degree:
                yield (load,), POLYNOMIAL, degree
        if load != main_load and levels(UNLOADING + load, load) > 1:
            yield (UNLOADING + load, load), POLYNOMIAL, 1
        if levels(UNLOADING + load) > 1:
            yield (UNLOADING + load,), POLYNOMIAL, 1
            yield (load,), MEMORY, _PREVIOUS_STEPS
        for text in (SO_FAR, WAY):
            if levels(text + load) > 1:
                yield (text + load,), POLYNOMIAL, 1
    for pair in combinations(loads, 2):
        if levels(*pair) > 1:
            yield pair, POLYNOMIAL, 1
    for column in other_columns:
        if column not in _NAMED_LINEAR:
            yield (column,), POLYNOMIAL, 1
        if levels(column) > _SMOOTH:
            yield (column,), POLYNOMIAL, _SMOOTH
    timed = TIME if TIME in other_columns else ORDER
    if timed in other_columns:
        yield (timed,), WAVES, _WAVES
    for load in loads if not is_signal(channel) else ():
        for column in other_columns:
            if levels(load) > 1:
                yield (load, column), GAIN, _FACTORS


def _sizes_between(steps: LoadSteps, load: str, is_observed: NDArray) -> NDArray:
    """Return sizes of a load, N or N m, between the levels applied at the steps ``is_observed`` (B,) of a channel.

    No size is below the smallest level: a jump there would only mean that the load is applied.
    """
    sizes = np.sort(np.abs(_values_of(steps, load)[is_observed]))
    one_level = _ONE_LEVEL * sizes.max(initial=0.0)
    sizes = sizes[sizes > one_level]
    gaps = np.flatnonzero(np.diff(sizes) > one_level)
    between = (sizes[gaps] + sizes[gaps + 1]) / 2.0
    chosen = np.linspace(0, max(len(between) - 1, 0), min(_MOST_SIZES, len(between))).round().astype(int)
    return np.asarray(between[chosen])


def fading_times(steps: LoadSteps, is_observed: NDArray) -> NDArray:
    """Return time constants, s, of decays after a break, for a channel read at steps ``is_observed`` (B,); none
    without a break or times.

    They range from a usual pause to the longest run.
    """
    hold_times = steps.held_s[steps.held_s > 0.0]
    if not steps.is_timed or np.isfinite(steps.since_break_s[is_observed]).sum() < FEWEST_READINGS:
        return np.zeros(0)
    shortest, longest = float(np.median(hold_times)), steps.longest_s
    count = min(_MOST_FADES, 1 + int(np.ceil(np.log(longest / shortest) / np.log(_FADES))))
    return np.geomspace(shortest, longest, count)


def _range_of(steps: LoadSteps, column: str) -> tuple[float, float]:
    """Return the centre and half the range of a column; for a load, zero and its largest value."""
    if column.removeprefix(SO_FAR) in LOADS:
        return 0.0, float(steps.largest[LOADS.index(column.removeprefix(SO_FAR))])
    if column.startswith((UNLOADING, WAY)):
        return 0.0, 1.0
    centre, half = middle_and_half(_values_of(steps, column))
    return centre, half or 1.0


def _values_of(steps: LoadSteps, column: str) -> NDArray:
    """Return the values (B,) of a column."""
    if column.startswith(UNLOADING):
        return steps.unloading[:, LOADS.index(column.removeprefix(UNLOADING))].astype(float)
    if column.startswith(SO_FAR):
        return steps.largest_so_far[:, LOADS.index(column.removeprefix(SO_FAR))]
    if column.startswith(WAY):
        return steps.direction[:, LOADS.index(column.removeprefix(WAY))]
    if column in LOADS:
        return steps.load[:, LOADS.index(column)]
    return np.asarray(steps.covariates[column], float)


def _previous_loads(steps: LoadSteps, load: str) -> NDArray:
    """Return a load (B, 2) over its largest, one and two steps before in the run; zero before the run's start."""
    share = steps.share[:, LOADS.index(load)]
    once = np.where(steps.rank >= 1, share[steps.before], 0.0)
    return np.stack([once, np.where(steps.rank >= _PREVIOUS_STEPS, share[steps.before[steps.before]], 0.0)], -1)


def _periods_of(steps: LoadSteps, column: str) -> NDArray:
    """Return the periods (S,) of time, s, or of a load, N or N m, that a campaign can distinguish."""
    values = _values_of(steps, column)
    span = float(np.ptp(values)) if np.isfinite(values).all() else 0.0
    if not span > 0.0:
        return np.zeros(0)
    if column != TIME:
        return periods_of_levels(np.unique(np.round(values / (_ONE_LEVEL * span))) * (_ONE_LEVEL * span))
    hold_times = steps.held_s[steps.held_s > 0.0]
    if not len(hold_times):
        return np.zeros(0)
    fastest = 1.0 / (_STEPS_PER_PERIOD * float(np.median(hold_times)))
    frequencies = np.arange(_PERIODS_AT_LEAST / span, fastest, _APART / span)
    return np.asarray(1.0 / frequencies[:_MOST_PERIODS])


def periods_of_levels(levels: NDArray) -> NDArray:
    """Return the periods (S,) that loads at these levels (L,), ascending, can distinguish."""
    span, count = float(levels[-1] - levels[0]), len(levels)
    counted = np.arange(_LOAD_PERIODS_AT_LEAST, count / _LEVELS_PER_PERIOD, _APART)
    periods = span / counted[:_MOST_PERIODS]
    nearly = 0.5 * _ONE_LEVEL * span
    within = np.searchsorted(levels, levels + periods[:, None] - nearly) - np.arange(count)
    is_complete = levels + periods[:, None] <= levels[-1] + nearly
    return np.asarray(periods[np.all((within >= _LEVELS_PER_PERIOD) | ~is_complete, axis=1)])
