"""What no cause of the catalogue explains of a bench: a channel follows columns, in a form that nobody declared.

It competes with the catalogue on equal terms. What a cause already does in the very same form (a channel in proportion
to the load of its own axis, or to the time in a run) is not told again: data could not tell the two apart.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from truing.simulation.cause import Cause, Parameter, Scene, Step
from truing.simulation.causes.following import POLYNOMIAL, WAVES, chebyshev, waves
from truing.simulation.causes.of_readings import (
    ReadingCause,
    is_signal,
    seen_channels,
    seen_of,
    steps_of,
    unit_of,
    whose,
)
from truing.simulation.reading_state import (
    AIR,
    CHANNELS,
    HUMIDITY,
    IN_RUN,
    LOADS,
    MATERIAL,
    ORDER,
    PRESSURE,
    TIME,
    LoadSteps,
    ReadingState,
)

UNLOADING = "unloading "  # before a load's name: one where that is smaller in size than at the step before
_SMOOTH, _WAVES = 3, 6
# A smooth dependence wants this many readings per function.
_PER_FUNCTION = 4
_FURTHER = 2
_IN_PROPORTION = 4.0
_EDGE = 1e-6
# Plausible, in sigmas of the channel.
_PLAUSIBLE_SIGMAS = 4.0
# What the catalogue has in proportion to a column already.
_NAMED_LINEAR = (IN_RUN, MATERIAL, AIR)


@dataclass(frozen=True)
class UnexplainedReadings(ReadingCause):
    """A channel follows columns (several: their product), brought to -1 .. 1 by centre and half range.

    Forms are Chebyshev polynomials of degree ``first`` .. ``degree``, or so many slow waves (cosines). ``scale`` is
    plausible, in the channel's own unit.
    """

    channel: str = "dz"
    columns: tuple[str, ...] = (TIME,)
    centres: tuple[float, ...] = (0.0,)
    half_ranges: tuple[float, ...] = (1.0,)
    form: str = POLYNOMIAL
    degree: int = 1
    first: int = 1
    scale: float = 1.0

    id = "unexplained"
    catalogued = False
    step = Step.INSTRUMENT
    reach = 100.0

    @property
    def subject(self) -> str:
        """Return the channel."""
        return whose(self.channel)

    @property
    def key(self) -> str:
        """Return the name that tells it from others of its kind."""
        degrees = f"{self.first} to {self.degree}" if self.goes_on else self.degree
        return f"{self.id} {self.channel} {' '.join(self.columns)} {self.form} {degrees}"

    @property
    def goes_on(self) -> bool:
        """Return whether it holds the further terms of a form of lower degree."""
        return self.first > 1

    @property
    def lasts(self) -> bool:
        """Return whether it stays with the bench: not what follows the time."""
        return not {TIME, ORDER, IN_RUN} & set(self.columns)

    @property
    def says(self) -> str:
        """Return what the data show of it."""
        return f"{self.subject} follows {self._followed}"

    @property
    def confirm(self) -> str:
        """Return what to measure next."""
        return f"Repeat some load steps with another value of {self._followed}, everything else unchanged."

    @property
    def _followed(self) -> str:
        said = [_words(column) for column in self.columns]
        if len(said) == 1:
            return said[0]
        return f"the square of {said[0]}" if said[0] == said[1] else f"the product of {said[0]} and {said[1]}"

    def covers(self, covariates: Mapping[str, NDArray], poses: int) -> NDArray:
        """Return the steps (B,) within the range of what it follows, beyond which its form says nothing."""
        inside = np.ones(poses, bool)
        for column, centre, half in zip(self.columns, self.centres, self.half_ranges, strict=True):
            if (values := covariates.get(column)) is not None:
                inside &= np.abs(values - centre) <= half * (1.0 + _EDGE)
        return inside

    def follows(self, legs: int) -> tuple[str, ...]:
        """Return the columns that it follows."""
        names = (TIME if column in (ORDER, IN_RUN) else column.removeprefix(UNLOADING) for column in self.columns)
        return tuple(dict.fromkeys(names))

    def candidates(self, scene: Scene) -> Sequence[Cause]:
        """Return everything that each channel may follow, as far as its readings allow."""
        steps, seen = steps_of(scene), seen_of(scene)
        found: list[Cause] = []
        for channel in seen_channels(scene):
            place = steps.channels.index(channel)
            count = int(seen[:, place].sum())
            scale = _PLAUSIBLE_SIGMAS * float(steps.sigma[place])
            for columns, form, degree in _followings(steps, seen[:, place], channel):
                if count >= _PER_FUNCTION * degree:
                    found.append(_following(steps, channel, columns, form, degree, scale))
        return found

    def further(self, scene: Scene) -> Sequence[Cause]:
        """Return its next terms."""
        return [replace(self, first=self.degree + 1, degree=self.degree + more) for more in range(1, _FURTHER + 1)]

    def prior(self, scene: Scene) -> float:
        """Return the weight: what is in proportion to one column is likelier than other forms."""
        return _IN_PROPORTION if len(self.columns) == self.degree == 1 else 1.0

    def parameters(self, legs: int) -> tuple[Parameter, ...]:
        """Return one amplitude per function."""
        unit, si = unit_of(self.channel)
        letter = "degree" if self.form == POLYNOMIAL else "wave"
        return tuple(Parameter(f"{letter}{k}", unit, self.scale, si) for k in range(self.first, self.degree + 1))

    def slopes(self, state: ReadingState, values: NDArray) -> NDArray:
        """Return the functions' values at the channel's readings."""
        x = np.ones(len(state.steps.load))
        for column, centre, half in zip(self.columns, self.centres, self.half_ranges, strict=True):
            x = x * (_values(state.steps, column) - centre) / half
        basis = (waves if self.form == WAVES else chebyshev)(x, self.degree)[:, self.first - 1 :]
        own = np.array([name == self.channel for name in state.steps.channels])
        return np.asarray(basis[:, None] * own[:, None])


def _followings(steps: LoadSteps, seen: NDArray, channel: str) -> Iterator[tuple[tuple[str, ...], str, int]]:
    """Yield columns, form and degree of what a channel, seen at steps (B,), may follow."""
    loads = [name for name, loaded in zip(LOADS, steps.loaded, strict=True) if loaded]
    own = LOADS[CHANNELS.index(channel)] if channel in CHANNELS else ""
    others = [name for name in _columns(steps, seen) if name not in LOADS]

    def levels(*columns: str) -> int:
        values = np.prod([_values(steps, column)[seen] for column in columns], axis=0)
        return len(np.unique(np.round(values, 12)))

    for load in loads:
        first = 2 if load == own or is_signal(channel) else 1
        for degree in range(first, _SMOOTH + 1):
            if levels(load) > degree:
                yield (load,), POLYNOMIAL, degree
        if load != own and levels(UNLOADING + load, load) > 1:
            yield (UNLOADING + load, load), POLYNOMIAL, 1
        if levels(UNLOADING + load) > 1:
            yield (UNLOADING + load,), POLYNOMIAL, 1
    for pair in combinations(loads, 2):
        if levels(*pair) > 1:
            yield pair, POLYNOMIAL, 1
    for column in others:
        if column not in _NAMED_LINEAR:
            yield (column,), POLYNOMIAL, 1
        if levels(column) > _SMOOTH:
            yield (column,), POLYNOMIAL, _SMOOTH
    timed = TIME if TIME in others else ORDER
    if timed in others:
        yield (timed,), WAVES, _WAVES
    for load in loads if not is_signal(channel) else ():
        for column in others:
            if levels(load) > 1:
                yield (load, column), POLYNOMIAL, 1


def _columns(steps: LoadSteps, seen: NDArray) -> list[str]:
    """Return the columns that vary while a channel is seen; the order only where there is no time."""
    found = [
        name
        for name, values in steps.covariates.items()
        if values.ndim == 1 and values.dtype.kind in "fiu" and np.isfinite(values).all() and np.ptp(values[seen]) > 0
    ]
    return [name for name in found if name != ORDER or TIME not in found]


def _following(
    steps: LoadSteps, channel: str, columns: tuple[str, ...], form: str, degree: int, scale: float
) -> UnexplainedReadings:
    ranges = [_range(steps, column) for column in columns]
    centres, halves = tuple(c for c, _ in ranges), tuple(h for _, h in ranges)
    return UnexplainedReadings(channel, columns, centres, halves, form, degree, 1, scale)


def _range(steps: LoadSteps, column: str) -> tuple[float, float]:
    """Return the centre and half the range of a column; of a load, zero and its largest."""
    if column in LOADS:
        return 0.0, float(steps.largest[LOADS.index(column)])
    if column.startswith(UNLOADING):
        return 0.0, 1.0
    values = _values(steps, column)
    return float(values.max() + values.min()) / 2, (float(np.ptp(values)) / 2) or 1.0


def _values(steps: LoadSteps, column: str) -> NDArray:
    """Return a column's values (B,)."""
    if column.startswith(UNLOADING):
        return steps.unloading[:, LOADS.index(column.removeprefix(UNLOADING))].astype(float)
    if column in LOADS:
        return steps.load[:, LOADS.index(column)]
    return np.asarray(steps.covariates[column], float)


def _words(column: str) -> str:
    known = {
        TIME: "time",
        IN_RUN: "the time in the run",
        ORDER: "the order of the steps",
        AIR: "the temperature of the air",
        MATERIAL: "the temperature of the material",
        PRESSURE: "the pressure of the air",
        HUMIDITY: "the humidity of the air",
    }
    if column.startswith(UNLOADING):
        return f"the direction in which {_words(column.removeprefix(UNLOADING))} changes"
    return f"the load {column.partition('_')[0]}" if column in LOADS else known.get(column, column)
