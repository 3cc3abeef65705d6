"""Causes: misaligned interferometer beams, at an angle to the channel's axis or offset from the origin."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truing.estimation.rotation import skew
from truing.simulation.bench.causes.channels import ChannelCause, linear_or_all
from truing.simulation.bench.causes.reading_causes import (
    FEWEST_READINGS,
    MM,
    BenchScene,
    read_channels,
)
from truing.simulation.bench.load_steps import CHANNELS, LINEAR, ReadingState
from truing.simulation.cause import Parameter, ReportedParameter

_PLAUSIBLE_RAD, _PLAUSIBLE_M = 0.03, 0.01
_XYZ = "xyz"
# Least effect of a plausible tilt on all readings, in sigmas, for the tilt to be observable.
_SHOWS = 1.0
_LARGEST = 3.0  # scale of the loss, relative to the loss by a plausible tilt
_TINY = 1e-30


@dataclass(frozen=True)
class CosineError(ChannelCause):
    """The beam is inclined to the channel's axis: it reads the cosine of the motion along it and the sin of the motion
    across.

    Parameters are the tilts towards the two other axes of the same kind. If nothing moves across the axis, only the
    loss along it (``along``) is a parameter: one minus the cosine, whose derivative does not vanish at zero angle.
    """

    channel: str = "dz"
    along: bool = False

    id = "cosine-error"

    def candidates(self, scene: BenchScene) -> Sequence[CosineError]:
        """Return every channel of the platform by its tilts, if something moves across it.

        Return the loss along it, if all motion across is proportional to the motion along it.
        """
        errors = []
        for channel in (c for c in read_channels(scene) if c in CHANNELS):
            across, beside = self._are_observable(scene, channel)
            errors += [CosineError(channel)] if across else []
            errors += [] if beside else [CosineError(channel, along=True)]
        return errors

    def parameters(self, legs: int) -> tuple[Parameter, ...]:
        """Return the tilts, rad, or the loss along the axis."""
        if self.along:
            return (Parameter("loss", "1", 0.5 * _PLAUSIBLE_RAD**2 * _LARGEST),)
        return tuple(
            Parameter(f"tilt_{CHANNELS[other_channel]}", "rad", _PLAUSIBLE_RAD)
            for other_channel in self._other_channels
        )

    def one_sided(self, legs: int) -> tuple[int, ...]:
        """Return the loss: a cosine is at most one."""
        return (0,) if self.along else ()

    @property
    def _channel_index(self) -> int:
        return CHANNELS.index(self.channel)

    @property
    def _other_channels(self) -> list[int]:
        return _other_channels(self._channel_index)

    def slopes(self, state: ReadingState, values: NDArray) -> NDArray:
        """Return d readings / d tilts, or / d loss."""
        readings = state.readings[:, self._channel_index]
        derivative = np.zeros((*state.readings.shape, len(values)), np.result_type(state.readings, values))
        if self.along:
            derivative[:, self._channel_index, 0] = -readings
            return derivative
        _, lost_by, _, across_by = _cosine_and_sines(values)
        motion = state.readings[:, self._other_channels]
        derivative[:, self._channel_index] = -readings[:, None] * lost_by + motion @ across_by
        return derivative

    def moved(self, state: ReadingState, values: NDArray) -> NDArray:
        """Return the change of the channel's readings."""
        return np.asarray(self._linear(state.readings, values))

    def passed_on(self, slopes: NDArray, state: ReadingState, values: NDArray) -> NDArray:
        """Return changes of the readings as the inclined beam reads them."""
        return np.asarray(slopes + self._linear(slopes, values))

    def _linear(self, readings: NDArray, values: NDArray) -> NDArray:
        """Return the change of readings (B, K, ...), which is proportional to them."""
        slope = np.zeros(readings.shape, np.result_type(readings, values))
        if self.along:
            slope[:, self._channel_index] = -values[0] * readings[:, self._channel_index]
            return slope
        lost, _, across, _ = _cosine_and_sines(values)
        slope[:, self._channel_index] = -lost * readings[:, self._channel_index]
        for other, share in zip(self._other_channels, across, strict=True):
            slope[:, self._channel_index] += share * readings[:, other]
        return slope

    def reported(self, values: NDArray, covariance: NDArray, legs: int) -> tuple[ReportedParameter, ...]:
        """Return the angle between beam and axis, and its tilts towards the other channels' axes if these are
        observable."""
        if self.along:
            lost, sigma = max(float(values[0]), 0.0), float(np.sqrt(covariance[0, 0]))
            angle = float(np.arccos(max(1.0 - lost, -1.0)))
            return (
                ReportedParameter(
                    "angle", angle, min(sigma / max(np.sin(angle), 1e-12), float(np.sqrt(2.0 * sigma))), "rad"
                ),
            )
        angle = float(np.linalg.norm(values))
        along = values / max(angle, 1e-12)
        parameter = ReportedParameter("angle", angle, float(np.sqrt(along @ covariance @ along)), "rad")
        return (parameter, *super().reported(values, covariance, legs))

    def _are_observable(self, scene: BenchScene, channel: str) -> tuple[bool, bool]:
        """Observability in a channel of motion across it: alone, and next to motion along it."""
        steps, index = scene.steps, CHANNELS.index(channel)
        is_observed = scene.recorded[:, index]
        if is_observed.sum() < FEWEST_READINGS:
            return False, False
        along, across = steps.motion[is_observed, index], steps.motion[is_observed][:, _other_channels(index)]
        beside = across - np.outer(along, along @ across) / max(float(along @ along), _TINY)
        least = _SHOWS * (steps.sigma[index] / _PLAUSIBLE_RAD) ** 2
        return bool(np.sum(across**2) > least), bool(np.sum(beside**2) > least)


@dataclass(frozen=True)
class AbbeOffset(ChannelCause):
    """The beam of a linear channel meets the platform at an arm from its origin, and also reads rotation x arm."""

    channel: str = "dz"

    id = "abbe-offset"
    reach = 30.0

    def candidates(self, scene: BenchScene) -> Sequence[AbbeOffset]:
        """Return every linear channel, and all of them with one common arm."""
        return [AbbeOffset(channel) for channel in linear_or_all(scene)]

    def parameters(self, legs: int) -> tuple[Parameter, ...]:
        """Return the arm across the channel's axis; for all channels, the full arm."""
        return tuple(Parameter(f"arm_{_XYZ[axis]}", "mm", _PLAUSIBLE_M, MM) for axis in self._arms)

    @property
    def _arms(self) -> list[int]:
        return [axis for axis in range(LINEAR) if not self.channel or axis != CHANNELS.index(self.channel)]

    def slopes(self, state: ReadingState, values: NDArray) -> NDArray:
        """Return d readings / d arm: the rotation crossed with each direction."""
        return self._by_arm(state.readings)[..., self._arms]

    def passed_on(self, slopes: NDArray, state: ReadingState, values: NDArray) -> NDArray:
        """Return changes of the readings, plus the effect of their rotation."""
        return np.asarray(slopes + self._by_arm(slopes)[..., self._arms] @ values)

    def _by_arm(self, readings: NDArray) -> NDArray:
        """Return the rotations of readings (B, K, ...) crossed with each direction, at its channels: (B, K, ..., 3)."""
        acts_on = [float(not self.channel or CHANNELS[n] == self.channel) for n in range(LINEAR)]
        by_arm_rows = np.zeros((*readings.shape, LINEAR), readings.dtype)
        crossed = np.array(acts_on)[:, None, None] * -skew(np.eye(LINEAR)).transpose(1, 2, 0)
        by_arm_rows[:, :LINEAR] = np.einsum("nia,bi...->bn...a", crossed, readings[:, LINEAR : 2 * LINEAR])
        return by_arm_rows


def _other_channels(channel: int) -> list[int]:
    """Return the two other channels of the same kind."""
    first = channel // LINEAR * LINEAR
    return [n for n in range(first, first + LINEAR) if n != channel]


def _cosine_and_sines(tilts: NDArray) -> tuple[NDArray, NDArray, NDArray, NDArray]:
    """Return 1 - cos of the length of tilts (2,), its derivative (2,); their sines (2,) and the derivative of these."""
    square = tilts @ tilts
    size = np.sqrt(square)
    small = abs(square) < 1e-8
    sinc = 1.0 - square / 6.0 if small else np.sin(size) / size
    bend = -1.0 / 3.0 + square / 30.0 if small else (np.cos(size) - sinc) / square
    lost = square / 2.0 - square**2 / 24.0 if small else 1.0 - np.cos(size)
    return lost, sinc * tilts, sinc * tilts, sinc * np.eye(2) + bend * np.outer(tilts, tilts)
