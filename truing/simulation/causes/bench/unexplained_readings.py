"""What no cause of the catalogue explains of a bench: a channel follows columns, in a form that nobody declared.

It competes with the catalogue on equal terms, so that no named cause swallows what it does not explain.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from truing.simulation.bench.reading_state import IN_RUN, LOADS, ORDER, TIME, LoadSteps, ReadingState
from truing.simulation.cause import Cause, Parameter, Profiles, Scene, Step
from truing.simulation.causes.bench.of_readings import ReadingCause, seen_channels, seen_of, steps_of, unit_of, whose
from truing.simulation.causes.bench.readings_followed import (
    BEYOND,
    GAIN,
    MEMORY,
    PERIOD,
    REMEMBERED,
    REST,
    SIDES,
    fading_times,
    followings,
    follows_of,
    periods_of,
    range_of,
    remembered,
    sizes_between,
    values_of,
)
from truing.simulation.causes.following import POLYNOMIAL, WAVES, chebyshev, waves
from truing.simulation.causes.undeclared import FURTHER, IN_PROPORTION, Undeclared

# A smooth dependence wants this many readings per function.
_PER_FUNCTION = 4
# Plausible, in sigmas of the channel.
_PLAUSIBLE_SIGMAS = 4.0
_LETTERS = {POLYNOMIAL: "degree", MEMORY: "before", PERIOD: "part", BEYOND: "side", GAIN: "gain", REST: "rest"}


@dataclass(frozen=True)
class UnexplainedReadings(Undeclared, ReadingCause):
    """A channel follows columns (several: their product), brought to -1 .. 1 by centre and half range.

    Forms are Chebyshev polynomials of degree ``first`` .. ``degree``, so many slow waves (cosines), a load at so many
    steps before, sine and cosine of a period of time or a load, which is the half range, a jump where a load is beyond
    the half range, on its positive and its negative side, a load and its product with a column, or what comes with a
    break in a run and fades with the half range as time constant. ``scale`` is plausible, SI; ``weight`` how likely
    beforehand among forms.
    """

    channel: str = "dz"
    columns: tuple[str, ...] = (TIME,)
    centres: tuple[float, ...] = (0.0,)
    half_ranges: tuple[float, ...] = (1.0,)
    form: str = POLYNOMIAL
    degree: int = 1
    first: int = 1
    scale: float = 1.0
    weight: float = 1.0

    id = "unexplained"
    catalogued = False
    of_time = frozenset({TIME, ORDER, IN_RUN})
    step = Step.INSTRUMENT
    reach = 100.0

    @property
    def subject(self) -> str:
        """Return the channel."""
        return whose(self.channel)

    @property
    def key(self) -> str:
        """Return the name that tells it from others of its kind."""
        degrees = self.terms
        if self.form in (PERIOD, BEYOND, REST):
            degrees = f"{self.half_ranges[0]:.6g}"
        return f"{self.id} {self.channel} {' '.join(self.columns)} {self.form} {degrees}"

    def covers(self, covariates: Mapping[str, NDArray], poses: int) -> NDArray:
        """Return the steps (B,) within the range of what it follows, beyond which its form says nothing."""
        return np.ones(poses, bool) if self.form in (PERIOD, BEYOND, REST) else self.within(covariates, poses)

    def follows(self, legs: int) -> tuple[str, ...]:
        """Return the columns that it follows."""
        return follows_of(self.columns)

    def candidates(self, scene: Scene) -> Sequence[Cause]:
        """Return everything that each channel may follow, as far as its readings allow."""
        steps, seen = steps_of(scene), seen_of(scene)
        found: list[Cause] = []
        for channel in seen_channels(scene):
            place = steps.channels.index(channel)
            count = int(seen[:, place].sum())
            scale = _PLAUSIBLE_SIGMAS * float(steps.sigma[place])
            for columns, form, degree in followings(steps, seen[:, place], channel):
                if count >= _PER_FUNCTION * degree:
                    found.append(_following(steps, channel, columns, form, degree, scale))
            found += _jumping(steps, seen[:, place], channel, scale)
            fades = fading_times(steps, seen[:, place])
            rest = UnexplainedReadings(channel, form=REST, scale=scale, weight=1.0 / max(len(fades), 1))
            found += [replace(rest, half_ranges=(float(tau),)) for tau in fades]
        return found

    def profiles(self, scene: Scene) -> Sequence[Profiles]:
        """Return what each channel may follow to and fro: every period of time, and of a load, that the campaign tells
        apart."""
        steps, seen = steps_of(scene), seen_of(scene)
        loads = [name for name, loaded in zip(LOADS, steps.loaded, strict=True) if loaded]
        return [own for column in (TIME, *loads) for own in _to_and_fro(steps, seen, column)]

    def further(self, scene: Scene) -> Sequence[Cause]:
        """Return its next terms."""
        if self.form in (MEMORY, PERIOD, BEYOND, GAIN, REST):
            return ()
        return [replace(self, first=self.degree + 1, degree=self.degree + more) for more in range(1, FURTHER + 1)]

    def prior(self, scene: Scene) -> float:
        """Return the weight: what is in proportion to one column is likelier than other forms."""
        return IN_PROPORTION if self.form == POLYNOMIAL and self.in_proportion else self.weight

    def parameters(self, legs: int) -> tuple[Parameter, ...]:
        """Return one amplitude per function."""
        unit, si = unit_of(self.channel)
        letter = _LETTERS.get(self.form, "wave")
        return tuple(Parameter(f"{letter}{k}", unit, self.scale, si) for k in range(self.first, self.degree + 1))

    def slopes(self, state: ReadingState, values: NDArray) -> NDArray:
        """Return the functions' values at the channel's readings."""
        basis = self._functions(state.steps)[:, self.first - 1 :]
        own = np.array([name == self.channel for name in state.steps.channels])
        return np.asarray(basis[:, None] * own[:, None])

    def _functions(self, steps: LoadSteps) -> NDArray:
        """Return the functions' values (B, degree)."""
        if self.form == MEMORY:
            return remembered(steps, self.columns[0])
        if self.form == REST:
            return np.exp(-steps.since_break_s / self.half_ranges[0])[:, None]
        if self.form == GAIN:
            load, other = self._brought(steps)
            return np.stack([load, load * other], -1)
        x = np.prod(self._brought(steps), axis=0)
        if self.form == BEYOND:
            return np.stack([x > 1.0, x < -1.0], -1).astype(float)[:, : self.degree]
        if self.form == PERIOD:
            return np.stack([np.sin(2.0 * np.pi * x), np.cos(2.0 * np.pi * x)], -1)
        return (waves if self.form == WAVES else chebyshev)(x, self.degree)

    def _brought(self, steps: LoadSteps) -> list[NDArray]:
        """Return the columns (B,) each, brought to their ranges."""
        ranges = zip(self.columns, self.centres, self.half_ranges, strict=True)
        return [(values_of(steps, column) - centre) / half for column, centre, half in ranges]


def _to_and_fro(steps: LoadSteps, seen: NDArray, column: str) -> list[Profiles]:
    """Return what channels, seen (B, K), may follow with the periods of a column, by their noise."""
    periods = periods_of(steps, column)
    values = values_of(steps, column)
    start = float(steps.time_s[0]) if column == TIME else 0.0
    followed = seen & (values != start)[:, None]
    read = np.flatnonzero(followed.sum(0) >= _PER_FUNCTION * REMEMBERED)
    if not len(periods) or not len(read):
        return []
    turns = 2.0 * np.pi * (values - start) / periods[:, None]
    shapes = np.stack([np.sin(turns), np.cos(turns)], -1)

    def alike(places: NDArray) -> Profiles:
        scale = _PLAUSIBLE_SIGMAS * float(steps.sigma[places[0]])

        def member(target: int, shape: int) -> Cause:
            own, period = steps.channels[places[target]], (float(periods[shape]),)
            return UnexplainedReadings(own, (column,), (start,), period, PERIOD, REMEMBERED, 1, scale)

        return Profiles(shapes, places, np.ones((len(periods), len(places)), bool), scale, member)

    return [alike(read[steps.sigma[read] == sigma]) for sigma in np.unique(steps.sigma[read])]


def _following(
    steps: LoadSteps, channel: str, columns: tuple[str, ...], form: str, degree: int, scale: float
) -> UnexplainedReadings:
    ranges = [range_of(steps, column) for column in columns]
    centres, halves = tuple(c for c, _ in ranges), tuple(h for _, h in ranges)
    return UnexplainedReadings(channel, columns, centres, halves, form, degree, 1, scale)


def _jumping(steps: LoadSteps, seen: NDArray, channel: str, scale: float) -> list[Cause]:
    """Return jumps of a channel, seen at steps (B,), beyond sizes of each load, where there are readings enough."""
    found: list[Cause] = []
    for load in (name for name, loaded in zip(LOADS, steps.loaded, strict=True) if loaded):
        values, sizes = values_of(steps, load)[seen], sizes_between(steps, load, seen)
        for size in sizes:
            beyond = int(np.sum(values > size)), int(np.sum(values < -size))
            sides = SIDES if min(beyond) else 1
            if beyond[0] >= _PER_FUNCTION and len(values) >= _PER_FUNCTION * sides:
                form = UnexplainedReadings(channel, (load,), (0.0,), (float(size),), BEYOND, sides, 1, scale)
                found.append(replace(form, weight=1.0 / len(sizes)))
    return found
