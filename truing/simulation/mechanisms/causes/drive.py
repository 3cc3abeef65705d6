"""Causes that act on actuators: wrong gain, backlash, and the periodic error of a leadscrew."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from truing.simulation.cause import Parameter, ReportedParameter, Step
from truing.simulation.change import Change
from truing.simulation.inputs import Missing
from truing.simulation.mechanisms.causes.per_leg import PerLeg, choice_share, choices
from truing.simulation.mechanisms.point_causes import PointScene
from truing.simulation.mechanisms.state import State

APPROACH = "approach"
_PLAUSIBLE_GAIN = 0.01
_PLAUSIBLE_BACKLASH_M = 3e-6
_PLAUSIBLE_AMPLITUDE_M = 3e-6
_MM = 1e-3
# Search for the pitch: (largest number of pitches, largest number of legs tried together).
_MOST_LEGS = ((60, 2), (200, 1))
# The pitch is ambiguous if readings distinguish less than this share of the pitches of the grid.
_UNAMBIGUOUS = 0.6
# Plausible distance of a pitch from the grid, in steps of the frequency.
_GRID_DISTANCE = 0.75


@dataclass(frozen=True)
class ActuatorGain(PerLeg):
    """The true displacement of the actuator is 1 + gain times the indicated one."""

    id = "actuator-gain"
    step = Step.DRIVE
    reads = frozenset({"indicated"})

    def parameters(self, legs: int) -> tuple[Parameter, ...]:
        """Return the gain of each leg concerned."""
        return tuple(Parameter(name, "1", _PLAUSIBLE_GAIN) for name in self.numbered("gain", legs))

    def change(self, state: State, values: NDArray) -> Change:
        """Return d rho_i / d gain_i: the indicated displacement of actuator i."""
        rows = self.spread(state.indicated - state.legs.rho0)
        return Change({"rho": rows}, rows.shape[-1])


@dataclass(frozen=True)
class ActuatorBacklash(PerLeg):
    """The actuator lags by the backlash, against the direction of its last movement."""

    id = "actuator-backlash"
    lacking = Missing.APPROACH
    step = Step.DRIVE
    reads = frozenset()

    def candidates(self, scene: PointScene) -> Sequence[ActuatorBacklash]:
        """Return every choice of legs that were approached from both directions; none without an order in time."""
        if not scene.varies(APPROACH):
            return ()
        both = np.ptp(scene.covariates[APPROACH], axis=0) > 0
        chosen = [cause for cause in super().candidates(scene) if isinstance(cause, ActuatorBacklash)]
        return [cause for cause in chosen if all(both[leg - 1] for leg in cause.legs)]

    def needs(self, legs: int) -> tuple[str, ...]:
        """Return the time, from which the direction of approach follows."""
        return ("time_s",)

    def parameters(self, legs: int) -> tuple[Parameter, ...]:
        """Return the backlash of each leg concerned, half the full gap; negative if compensated too much."""
        return tuple(Parameter(name, "mm", _PLAUSIBLE_BACKLASH_M, _MM) for name in self.numbered("backlash", legs))

    def change(self, state: State, values: NDArray) -> Change:
        """Return d rho_i / d backlash_i: minus the direction of approach of actuator i."""
        rows = self.spread(-state.covariates[APPROACH])
        return Change({"rho": rows}, rows.shape[-1])


@dataclass(frozen=True)
class PeriodicError(PerLeg):
    """The leadscrew adds a sine of its own pitch: rho_i + S_i sin(2 pi d_i / pitch) + C_i cos(2 pi d_i / pitch).

    S and C are amplitude times cosine and sine of the phase. If ``free``, the frequency is a further parameter,
    relative to 1 / ``pitch_mm`` and limited by a hyperbolic tangent to ``frequency_sigma`` (1/m), its plausible range;
    beyond that, another candidate applies. If ``aliased``, the actuators were on so few levels that other pitches give
    the same waves.
    """

    pitch_mm: float = 1.0
    frequency_sigma: float = 0.0
    free: bool = False
    aliased: bool = False

    id = "actuator-periodic-error"
    step = Step.DRIVE
    reads = frozenset({"indicated"})

    def candidates(self, scene: PointScene) -> Sequence[PeriodicError]:
        """Return the choices of legs at the declared pitch, or at every pitch that the readings can distinguish."""
        moved = scene.readings - scene.rho0
        if scene.pitch_m is not None:
            return [PeriodicError(chosen, scene.pitch_m / _MM) for chosen in choices(scene.legs)]
        sigma, pitches = _GRID_DISTANCE * pitch_spacing(moved), distinct_pitches(moved)
        most = next((legs for count, legs in _MOST_LEGS if len(pitches) <= count), 0)
        aliased = len(pitches) < _UNAMBIGUOUS * min(grid_size(moved), MOST_PITCHES)
        return [
            PeriodicError(chosen, pitch / _MM, sigma, aliased=aliased)
            for pitch in pitches
            for chosen in choices(scene.legs, most)
        ]

    def prior(self, scene: PointScene) -> float:
        """Return the share of this choice of legs; all pitches are equally probable."""
        return choice_share(len(self.legs), scene.legs)

    def like_sized(self, legs: int) -> tuple[int, ...]:
        """Return none: S and C of waves of like amplitude may have any size."""
        return ()

    def refined(self) -> Self:
        """Return the form with a fitted pitch; unchanged if the pitch was declared or is ambiguous."""
        return replace(self, free=True) if self.frequency_sigma > 0 and not self.aliased else self

    def parameters(self, legs: int) -> tuple[Parameter, ...]:
        """Return S and C of each leg concerned, then the frequency if it is free."""
        pairs = zip(self.numbered("sine", legs), self.numbered("cosine", legs), strict=True)
        waves = tuple(Parameter(name, "mm", _PLAUSIBLE_AMPLITUDE_M, _MM) for pair in pairs for name in pair)
        return (*waves, Parameter("frequency", "1/mm", self.frequency_sigma, 1 / _MM)) if self.free else waves

    def change(self, state: State, values: NDArray) -> Change:
        """Return the derivatives of rho_i by S_i and C_i of every leg concerned, then by the frequency if it is
        free."""
        sine, cosine = self._waves(state, values)
        waves = np.stack([self.spread(sine), self.spread(cosine)], -1)
        columns = waves.reshape(*waves.shape[:-2], -1)
        if self.free:
            along = columns @ self._quarter_turn(values[:-1])
            turned = 2 * math.pi * self._frequency(values[-1])[1] * (state.indicated - state.legs.rho0) * along
            columns = np.concatenate([columns, turned[..., None]], -1)
        return Change({"rho": columns}, columns.shape[-1])

    def shift(self, state: State, values: NDArray) -> dict[str, NDArray]:
        """Return the shift of the actuators, m."""
        sine, cosine = self._waves(state, values)
        waves = np.stack([self.spread(sine), self.spread(cosine)], -1)
        amplitudes = values[:-1] if self.free else values
        return {"rho": waves.reshape(*waves.shape[:-2], -1) @ amplitudes}

    def reported(self, values: NDArray, covariance: NDArray, legs: int) -> tuple[ReportedParameter, ...]:
        """Return amplitude and phase of each leg concerned, with the pitch between them, and sigmas to first order."""
        numbers = self.leg_numbers(legs)
        amplitudes, phases = [], []
        for index, leg in enumerate(numbers):
            size, phase, by_both = _polar(values[2 * index], values[2 * index + 1])
            part = slice(2 * index, 2 * index + 2)
            # Rounding may make the variance of an unobserved direction slightly negative.
            sigma = np.sqrt(np.maximum(np.diag(by_both @ covariance[part, part] @ by_both.T), 0.0))
            amplitudes.append(ReportedParameter(f"amplitude_{leg}", size / _MM, float(sigma[0]) / _MM, "mm"))
            phases.append(ReportedParameter(f"phase_{leg}", phase, min(float(sigma[1]), math.pi), "rad"))
        return (*amplitudes, self._reported_pitch(values, covariance), *phases)

    def _reported_pitch(self, values: NDArray, covariance: NDArray) -> ReportedParameter:
        if self.aliased:
            return ReportedParameter("pitch", self.pitch_mm, self.pitch_mm, "mm")
        if not self.free:
            return ReportedParameter(
                "pitch", self.pitch_mm, self.pitch_mm**2 * self.frequency_sigma * _MM or None, "mm"
            )
        frequency, slope = self._frequency(values[-1])
        pitch = 1 / float(frequency) / _MM
        sigma = pitch**2 * float(slope) * math.sqrt(covariance[-1, -1]) * _MM
        return ReportedParameter("pitch", pitch, min(sigma, pitch**2 * self.frequency_sigma * _MM), "mm")

    def _frequency(self, away: NDArray) -> tuple[NDArray, NDArray]:
        """Return the frequency (1/m) at a value of the last parameter, and its derivative by that."""
        share = np.tanh(away / self.frequency_sigma)
        return 1 / (self.pitch_mm * _MM) + self.frequency_sigma * share, 1 - share**2

    def _waves(self, state: State, values: NDArray) -> tuple[NDArray, NDArray]:
        """Return sine and cosine (B, L) of the indicated displacements."""
        frequency = self._frequency(values[-1])[0] if self.free else 1 / (self.pitch_mm * _MM)
        turn = 2 * math.pi * frequency * (state.indicated - state.legs.rho0)
        return np.sin(turn), np.cos(turn)

    @staticmethod
    def _quarter_turn(amplitudes: NDArray) -> NDArray:
        """Return the amplitudes of the waves' derivatives: S cos - C sin has -C for its sine and S for its cosine."""
        pairs = amplitudes.reshape(-1, 2)
        return np.stack([-pairs[:, 1], pairs[:, 0]], -1).ravel()


def _polar(sine: float, cosine: float) -> tuple[float, float, NDArray]:
    """Return amplitude and phase of sine sin(x) + cosine cos(x), and their derivative (2, 2) by the two."""
    size, phase = math.hypot(sine, cosine), math.atan2(cosine, sine)
    per_size = max(size, 1e-12)
    return (
        size,
        phase,
        np.array([[math.cos(phase), math.sin(phase)], [-math.sin(phase) / per_size, math.cos(phase) / per_size]]),
    )


SHORTEST_M, LONGEST_M = 0.2e-3, 5e-3
# Frequency steps per additional turn over the range of displacements: dense enough to miss no pitch.
_OVERSAMPLING = 2.5
# Waves count as equal if the sine of the angle between their spans is below this.
_ALIKE = 0.2
# Displacements over hundreds of turns distinguish more pitches than can be tried; the shortest are omitted.
MOST_PITCHES = 400


def pitch_spacing(moved: NDArray) -> float:
    """Return the spacing (1/m) of the grid of frequencies for displacements (B, L), m."""
    longest = float(np.ptp(moved, axis=0).max()) if len(moved) else 0.0
    return 1 / (_OVERSAMPLING * max(longest, SHORTEST_M))


def grid_size(moved: NDArray) -> int:
    """Return the number of pitches from 0.2 to 5 mm that displacements (B, L), m, over this range could resolve."""
    return int(np.ceil((1 / SHORTEST_M - 1 / LONGEST_M) / pitch_spacing(moved))) + 1


def distinct_pitches(moved: NDArray) -> list[float]:
    """Return pitches (m) from 0.2 to 5 mm, longest first, at most 400, with distinct waves of displacements (B, L).

    Displacements on a few levels show the same waves for many pitches; only the longest of these is returned.
    """
    first = 1 / LONGEST_M + pitch_spacing(moved) / 2
    frequencies = np.linspace(first, 1 / SHORTEST_M, grid_size(moved))[:MOST_PITCHES]
    alike = _has_same_span(_spans(2 * np.pi * frequencies[:, None, None] * moved))
    distinct: list[int] = []
    for wave in range(len(frequencies)):
        if not alike[wave, distinct].any():
            distinct.append(wave)
    return [1 / float(frequency) for frequency in frequencies[distinct]]


def _spans(turns: NDArray) -> NDArray:
    """Return orthonormal bases (F, L, B, 2) of sine and cosine of turns (F, B, L) minus means; zero for vanishing
    waves."""
    waves = np.stack([np.sin(turns), np.cos(turns)], -1)
    centred = np.moveaxis(waves - waves.mean(1, keepdims=True), 2, 1)
    directions, sizes, _ = np.linalg.svd(centred, full_matrices=False)
    return directions * (sizes > 0.05 * np.sqrt(turns.shape[1]))[:, :, None]


def _has_same_span(spans: NDArray) -> NDArray:
    """Return the mask (F, F): whether the span (F, L, B, 2) of the row lies within that of the column, leg by leg."""
    waves, _, poses, _ = spans.shape
    alike = np.ones((waves, waves), bool)
    for leg in np.moveaxis(spans, 1, 0):
        columns = np.moveaxis(leg, 1, 0).reshape(poses, 2 * waves)
        within = ((columns.T @ columns) ** 2).reshape(waves, 2, waves, 2).sum(3)
        beside = np.sum(leg**2, 1)[:, :, None] - within
        alike &= (beside < _ALIKE**2).all(1)
    return alike
