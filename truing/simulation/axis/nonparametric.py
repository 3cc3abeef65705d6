"""Nonparametric effects on an axis: an encoder or the transmission depends smoothly on inputs.

A dependence of exactly the form of a catalogued cause is no candidate, because data could not distinguish the two. Such
forms are: proportional to the command, also times a temperature, and dependent on the direction of approach only.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from truing.arrays import Index
from truing.inference.model import ChannelCandidates
from truing.simulation.axis.causes import (
    ELEMENTS,
    AxisScene,
    ElementCause,
    is_temperature,
    onset_rows,
    shown_elements,
)
from truing.simulation.axis.rows import (
    COMMAND,
    DIRECTION,
    SINCE_TURN,
    TRANSMISSION,
    Axis,
    AxisRows,
)
from truing.simulation.cause import Parameter, Step
from truing.simulation.inputs import ORDER, STOPS, TIME, middle_and_half, varying_columns
from truing.simulation.nonparametric import (
    PER_FUNCTION,
    POLYNOMIAL,
    SETTLINGS,
    WAVES,
    NonparametricEffect,
    chebyshev,
    dependence,
)

# Forms: a curve over the travel since the axis turned, times the direction of approach; an offset during a period; a
# sum of stop operators of the command: friction with memory.
LOOP, STRETCH, HISTORY = "loop", "stretch", "history"
# Plausible amplitude, in standard deviations of a reading.
_PLAUSIBLE_SIGMAS = 4.0
_SMOOTH = (1, 2, 3)
_WAVES_OF_TIME, _WAVES_OF_PLACE = (2, 4, 8, 12), (4, 8)
_LOOPS = (2, 3, 4)
# Prior weights of friction with memory, and of each form of the command, relative to another form. Next to some fifteen
# other forms of an element, its place and its previous movements have about a fifth of the whole each.
_OF_HISTORY, _OF_PLACE = 8.0, 2.0
# Plausible amplitude of the slowest wave relative to other forms; that of the k-th is k times smaller.
_OF_A_WALK = 2.0
# Least number of rows of a stretch, and its largest share of all rows.
_FEWEST, _LONGEST = 3, 0.35
# Relative tolerance at the ends of a range, for rounding.
_EDGE = 1e-6


@dataclass(frozen=True)
class NonparametricAxisEffect(NonparametricEffect[AxisScene], ElementCause):
    """An encoder or the transmission depends on columns of the rows, on previous movements, or on a product of two
    inputs.

    Further forms: ``loop``, the direction of approach times Chebyshev polynomials, with the constant, of the travel
    since the axis turned; ``stretch``, a constant offset during a period of time; ``history``, a sum of stop operators.
    """

    element: str = TRANSMISSION

    step = Step.INSTRUMENT
    reach = 100.0
    letters: ClassVar[dict[str, str]] = {
        **NonparametricEffect.letters,
        LOOP: "loop",
        STRETCH: "offset",
        HISTORY: "stop",
    }
    series: ClassVar[frozenset[str]] = NonparametricEffect.series | {LOOP}
    boundless = frozenset({STRETCH})

    @property
    def is_persistent(self) -> bool:
        """True if the effect stays with the machine; False if it depends on time or on the rows before."""
        return super().is_persistent and self.form != HISTORY

    def prior(self, scene: AxisScene) -> float:
        """Return the relative prior weight: larger of friction, and of the place."""
        if self.form == HISTORY:
            return _OF_HISTORY
        return _OF_PLACE if self.columns == (COMMAND,) else super().prior(scene)

    def inputs(self, legs: int) -> tuple[str, ...]:
        """Return the inputs that it depends on, as the rows of an axis name them."""
        return tuple(COMMAND if column == SINCE_TURN else column for column in super().inputs(legs))

    def needs(self, legs: int) -> tuple[str, ...]:
        """Return the columns, except the command, that a prediction needs."""
        known = {TIME, ORDER, COMMAND, DIRECTION, SINCE_TURN}
        return tuple(column for column in self.columns if column not in known)

    def candidates(self, scene: AxisScene) -> Sequence[NonparametricAxisEffect]:
        """Return all dependences of distinguishable elements for which there are enough readings."""
        effects: list[NonparametricAxisEffect] = []
        for bare, count in self._distinguishable(scene):
            for columns, form, degree in _dependences(scene.rows):
                if count >= PER_FUNCTION * degree:
                    settings = dependence(columns, partial(_range_of, scene.rows), form, degree)
                    effects.append(replace(bare, **settings))
        return effects

    def channel_candidates(self, scene: AxisScene) -> Sequence[ChannelCandidates[NonparametricAxisEffect]]:
        """Return every period of time during which a distinguishable element may have an offset."""
        elements = [bare for bare, _ in self._distinguishable(scene)]
        first, last = _stretches(scene.rows)
        if not len(first) or not elements:
            return ()
        timed = _column_of_time(scene.rows)
        order, time = scene.rows.order, _values_of(scene.rows, timed)
        within = (order >= order[first][:, None]) & (order <= order[last][:, None])
        usable = within @ scene.recorded.astype(int) >= _FEWEST

        def member(element: int, stretch: int) -> NonparametricAxisEffect:
            start, end = float(time[first[stretch]]), float(time[last[stretch]])
            limits = {"centres": ((start + end) / 2.0,), "half_ranges": ((end - start) / 2.0,)}
            return replace(elements[element], columns=(timed,), form=STRETCH, degree=1, **limits)  # type: ignore[arg-type]

        each = np.tile(np.arange(len(scene.axis.encoders)), (len(elements), 1))
        patterns = np.stack([scene.axis.response(bare.element) for bare in elements])[..., None, None]
        read = np.stack([usable[:, patterns[e, :, 0, 0] != 0.0].any(1) for e in range(len(elements))], 1)
        return [ChannelCandidates(within[..., None].astype(float), each, read, elements[0].plausible, member, patterns)]

    def parameters(self, legs: int) -> tuple[Parameter, ...]:
        """Return one amplitude per function; those of faster waves are smaller, as in a random walk."""
        base_parameters = super().parameters(legs)
        if self.form != WAVES:
            return base_parameters
        return tuple(replace(p, scale=_OF_A_WALK * p.scale / k) for k, p in enumerate(base_parameters, self.first))

    def slopes(self, rows: AxisRows, axis: Axis) -> NDArray:
        """Return the values of the functions, for the encoders that respond."""
        return np.asarray(self._functions(rows)[:, None] * axis.response(self.element)[:, None])

    def _functions(self, rows: AxisRows) -> NDArray:
        """Return the values (B, m) of the functions."""
        values = partial(_values_of, rows)
        if self.form == STRETCH:
            return (np.abs(self.scaled(values)[0]) <= 1.0 + _EDGE).astype(float)[:, None]
        if self.form == HISTORY:
            return rows.stops
        if self.form != LOOP:
            return self.basis(values)
        direction, travel = self.scaled(values)
        curves = np.concatenate([np.ones_like(travel)[:, None], chebyshev(travel, max(self.degree - 1, 1))], 1)
        return direction[:, None] * curves[:, self.first - 1 : self.degree]

    @property
    def _terms(self) -> str:
        if self.form != STRETCH:
            return super()._terms
        return f"{self.centres[0] - self.half_ranges[0]:.9g} to {self.centres[0] + self.half_ranges[0]:.9g}"

    @property
    def _in_key(self) -> tuple[tuple[str, ...], tuple[str, ...]]:
        return (self.element,), ()

    @property
    def _amplitude(self) -> tuple[str, float, float]:
        return *self.unit, self.plausible

    def _distinguishable(self, scene: AxisScene) -> Iterator[tuple[NonparametricAxisEffect, int]]:
        """Yield the effect for each element that readings distinguish from the others, and the number of rows that
        show it."""
        known: list[NDArray] = []
        for element in shown_elements(scene.axis, ELEMENTS):
            response = scene.axis.response(element)
            if any(np.array_equal(np.abs(response), np.abs(other)) for other in known):
                continue
            known.append(response)
            bare = replace(
                self,
                element=element,
                kind_of_axis=scene.axis.kind,
                plausible=_PLAUSIBLE_SIGMAS * scene.axis.noise,
            )
            yield bare, int(scene.recorded[:, response != 0.0].any(1).sum())


def _dependences(rows: AxisRows) -> Iterator[tuple[tuple[str, ...], str, int]]:
    """Yield inputs, form and degree of all dependences."""
    columns = varying_columns(rows.covariates)
    timed = _column_of_time(rows)
    for column in columns:
        smooth = [degree for degree in _SMOOTH if column != COMMAND or degree > 1]
        for degree in smooth if column != DIRECTION else ():
            yield (column,), POLYNOMIAL, degree
        if column not in (COMMAND, DIRECTION) and not is_temperature(column):
            yield (column, COMMAND), POLYNOMIAL, 1
    for form in SETTLINGS if timed in columns else ():
        yield (timed,), form, 1
    for column, counts in ((timed, _WAVES_OF_TIME), (COMMAND, _WAVES_OF_PLACE)):
        for count in counts if column in columns else ():
            yield (column,), WAVES, count
    if DIRECTION in columns:
        yield (DIRECTION, COMMAND), POLYNOMIAL, 1
        for degree in _LOOPS:
            yield (DIRECTION, SINCE_TURN), LOOP, degree
        yield (COMMAND,), HISTORY, len(STOPS)


def _stretches(rows: AxisRows) -> tuple[Index, Index]:
    """Return the first and last rows (S,) of periods with rows before and after them."""
    starts = onset_rows(rows, _FEWEST)
    in_time = np.argsort(rows.order, kind="stable")
    longest = max(int(_LONGEST * len(in_time)), _FEWEST)
    rank = np.empty(len(in_time), int)
    rank[in_time] = np.arange(len(in_time))
    stretches = [
        (start, in_time[end - 1]) for start in starts for end in rank[starts] if _FEWEST <= end - rank[start] <= longest
    ]
    first, last = zip(*stretches, strict=True) if stretches else ((), ())
    return np.array(first, int), np.array(last, int)


def _range_of(rows: AxisRows, column: str) -> tuple[float, float]:
    """Return the centre and half the range of a column."""
    centre, half = middle_and_half(_values_of(rows, column))
    return centre, half or 1.0


def _values_of(rows: AxisRows, column: str) -> NDArray:
    """Return the values (B,) of a column."""
    known = {SINCE_TURN: rows.since_turn, TIME: rows.time_s}
    return known[column] if column in known else np.asarray(rows.covariates[column], float)


def _column_of_time(rows: AxisRows) -> str:
    """Return the column that stands for time: the order of the rows, if no times were recorded."""
    return TIME if rows.is_timed else ORDER
