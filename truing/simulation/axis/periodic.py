"""Cause `AxisPeriodicError`: a sine of the position, of a known or searched period."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Self

import numpy as np
from numpy.typing import NDArray

from truing.simulation.axis.causes import AxisScene, ElementCause, shown_elements
from truing.simulation.axis.rows import ROTARY, TRANSMISSION, Axis, AxisRows
from truing.simulation.cause import Parameter, ReportedParameter, Step

_TURN = 2.0 * math.pi
# Fewest periods over the travel: of a searched period, and of a known one.
_FEWEST_PERIODS, _FEWEST_OF_KNOWN = 2.0, 0.75
# Orders of an error per turn of a rotary axis that are tried besides searched periods.
_ORDERS = (1, 2)
# Frequency steps per additional period over the travel, and the largest deviation from a step, in steps.
_OVERSAMPLING, _GRID_DISTANCE = 4.0, 1.0
# Most searched periods: the shortest are omitted.
_MOST = 800
# Different commands at which waves are compared: more of them change no angle by as much as counts below.
_MOST_COMMANDS = 1000
_AT_ONCE = 64  # waves whose products are held in memory
# Frequencies are searched, and compared for the same wave, up to this multiple of one per step of the commands.
_WIDER = 8.0
# Waves count as equal if the sine of the angle between their spans is below this.
_ALIKE = 0.2


@dataclass(frozen=True)
class AxisPeriodicError(ElementCause):
    """An encoder or the transmission adds sine x sin(2 pi c / period) + cosine x cos(2 pi c / period) at command c.

    ``period`` in rad or m. If ``free``, the frequency is a further parameter, limited by a hyperbolic tangent to
    ``frequency_sigma`` (1/rad, 1/m) about 1 / period. If ``aliased``, other periods give the same waves at the
    commands.
    """

    element: str = TRANSMISSION
    period: float = 1.0
    frequency_sigma: float = 0.0
    free: bool = False
    aliased: bool = False

    id = "periodic-error"
    step = Step.STRUCTURE

    @property
    def has_set_shape(self) -> bool:
        """True for a period of the turn, or a declared one."""
        return self.frequency_sigma == 0.0

    @property
    def shifts_with_others(self) -> bool:
        """True for a searched period: at few commands, waves of many periods pass for what else is missing."""
        return not self.has_set_shape

    def candidates(self, scene: AxisScene) -> Sequence[AxisPeriodicError]:
        """Return every observable element at the declared period, or at each period that the commands distinguish."""
        with_axis = replace(self, kind_of_axis=scene.axis.kind, plausible=scene.axis.spread)
        elements = [replace(with_axis, element=name) for name in shown_elements(scene.axis)]
        return [
            replace(element, period=period, frequency_sigma=sigma, aliased=aliased)
            for period, sigma, aliased in _periods(scene.axis, scene.rows.command)
            for element in elements
        ]

    def refined(self) -> Self:
        """Return the form with a fitted period; unchanged if the period is known or ambiguous."""
        return replace(self, free=True) if self.frequency_sigma > 0.0 and not self.aliased else self

    def parameters(self, legs: int) -> tuple[Parameter, ...]:
        """Return sine and cosine, then the frequency if it is free."""
        waves = self._length("sine"), self._length("cosine")
        unit, si = self.unit
        return (*waves, Parameter("frequency", f"1/{unit}", self.frequency_sigma, 1.0 / si)) if self.free else waves

    def slopes(self, rows: AxisRows, axis: Axis) -> NDArray:
        """Return the waves at the given period, for the encoders that respond."""
        return self.slopes_at(rows, axis, np.zeros(2 + self.free))

    def slopes_at(self, rows: AxisRows, axis: Axis, values: NDArray) -> NDArray:
        """Return the waves, and the derivative by a free frequency, for the encoders that respond."""
        waves = self._waves(rows, values)
        if self.free:
            by_phase = waves @ np.array([-values[1], values[0]])
            slope = _TURN * rows.command * self._frequency(values[2])[1] * by_phase
            waves = np.column_stack([waves, slope])
        return np.asarray(waves[:, None] * axis.response(self.element)[:, None])

    def shift(self, rows: AxisRows, axis: Axis, values: NDArray) -> NDArray:
        """Return the shift (B, K) of the readings."""
        return np.asarray((self._waves(rows, values) @ values[:2])[:, None] * axis.response(self.element))

    def reported(self, values: NDArray, covariance: NDArray, legs: int) -> tuple[ReportedParameter, ...]:
        """Return amplitude, period and phase, with sigmas to first order: amplitude x sin(2 pi c / period + phase)."""
        (sine, cosine), (unit, si) = values[:2], self.unit
        size, phase = math.hypot(sine, cosine), math.atan2(cosine, sine)
        turn = np.array([[math.cos(phase), math.sin(phase)], [-math.sin(phase), math.cos(phase)]])
        along, across = np.sqrt(np.maximum(np.diag(turn @ covariance[:2, :2] @ turn.T), 0.0))
        return (
            ReportedParameter("amplitude", size / si, float(along) / si, unit),
            self._reported_period(values, covariance),
            ReportedParameter("phase", phase, min(float(across) / max(size, 1e-300), math.pi), "rad"),
        )

    def _reported_period(self, values: NDArray, covariance: NDArray) -> ReportedParameter:
        unit, si = self.unit
        period, sigma = self.period, self.period**2 * self.frequency_sigma
        if self.aliased:
            sigma = period
        elif self.free:
            frequency, slope = self._frequency(values[2])
            period = 1.0 / frequency
            sigma = min(period**2 * slope * math.sqrt(max(covariance[2, 2], 0.0)), sigma)
        return ReportedParameter("period", period / si, sigma / si or None, unit)

    def _frequency(self, away: float) -> tuple[float, float]:
        """Return the frequency at a value of the last parameter, and its derivative by that."""
        share = math.tanh(away / self.frequency_sigma)
        return 1.0 / self.period + self.frequency_sigma * share, 1.0 - share**2

    def _waves(self, rows: AxisRows, values: NDArray) -> NDArray:
        """Return sine and cosine (B, 2) of the commands."""
        if self.free:
            return _waves(rows.command, self._frequency(float(values[2]))[0])
        if self.period not in rows.waves:
            rows.waves[self.period] = _waves(rows.command, 1.0 / self.period)
        return rows.waves[self.period]


def _waves(command: NDArray, frequency: float) -> NDArray:
    return np.stack([np.sin(_TURN * frequency * command), np.cos(_TURN * frequency * command)], -1)


def _periods(axis: Axis, command: NDArray) -> list[tuple[float, float, bool]]:
    """Return periods worth trying, the range of their frequency (0 if known), and whether commands leave them open."""
    travel = float(np.ptp(command))
    if axis.period is not None:
        return [(axis.period, 0.0, False)] if travel >= _FEWEST_OF_KNOWN * axis.period else []
    turns = [_TURN / order for order in _ORDERS] if axis.kind == ROTARY else []
    known = [(period, 0.0, False) for period in turns if travel >= _FEWEST_OF_KNOWN * period]
    return known + _searched(command, travel)


def _searched(command: NDArray, travel: float) -> list[tuple[float, float, bool]]:
    """Return the longest of all periods with like waves at the commands. Commands in even steps leave none below two
    steps; uneven ones resolve far shorter periods."""
    return _searched_once(np.ascontiguousarray(command, dtype=float).tobytes(), travel) if travel > 0.0 else []


@lru_cache(maxsize=8)  # every round of a search asks for the same commands
def _searched_once(commands: bytes, travel: float) -> list[tuple[float, float, bool]]:
    command = np.frombuffer(commands)
    distinct = np.unique(np.round(command / travel, 2))
    step, spacing = travel / max(len(distinct) - 1, 1), 1.0 / (_OVERSAMPLING * travel)
    # Slower waves are no candidates, but exclude those that they equal at the commands.
    frequencies = np.arange(spacing, _WIDER / step, spacing)[:_MOST]
    spans = _spans(_TURN * frequencies[:, None] * _some(command))
    tried = np.arange(len(frequencies))
    alike = _same_spans(spans) & (np.abs(tried - tried[:, None]) > _OVERSAMPLING)
    is_first = spans.any((1, 2)) & ~np.tril(alike).any(1) & (frequencies * travel >= _FEWEST_PERIODS)
    return [
        (1.0 / float(frequencies[k]), _GRID_DISTANCE * spacing, bool(alike[k].any())) for k in np.flatnonzero(is_first)
    ]


def _some(command: NDArray) -> NDArray:
    """Return the different commands, at most `_MOST_COMMANDS` of them, drawn without a period of their own."""
    different = np.unique(command)
    if len(different) <= _MOST_COMMANDS:
        return different
    return np.random.default_rng(0).choice(different, _MOST_COMMANDS, replace=False)


def _spans(turns: NDArray) -> NDArray:
    """Return orthonormal bases (F, B, 2) of sine and cosine of turns (F, B) minus means; zero for waves that vanish."""
    waves = np.stack([np.sin(turns), np.cos(turns)], -1)
    directions, sizes, _ = np.linalg.svd(waves - waves.mean(1, keepdims=True), full_matrices=False)
    return np.asarray(directions * (sizes > 0.05 * math.sqrt(turns.shape[1]))[:, None])


def _same_spans(spans: NDArray) -> NDArray:
    """Return the mask (F, F) of spans (F, B, 2), of the column, within which that of the row lies."""
    sides = spans.swapaxes(1, 2).reshape(2 * len(spans), -1)
    within = np.zeros((len(spans), 2, len(spans)))
    for start in range(0, len(sides), _AT_ONCE):
        part = (sides[start : start + _AT_ONCE] @ sides.T) ** 2
        within.reshape(len(sides), -1)[start : start + _AT_ONCE] = part.reshape(len(part), -1, 2).sum(2)
    return np.asarray((np.sum(spans**2, 1)[..., None] - within < _ALIKE**2).all(1))
