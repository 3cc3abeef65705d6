"""Causes: wrong or nonlinear stiffness of the sensor along load axes, asymmetry, hysteresis and joint clearance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from truing.simulation.bench.causes.load_path import LoadCause
from truing.simulation.bench.causes.reading_causes import (
    BenchScene,
    is_linear,
    loaded_axes,
    unit_of,
)
from truing.simulation.bench.load_steps import CHANNELS, LoadSteps, ReadingState
from truing.simulation.bench.six_upur.loading import AXES
from truing.simulation.cause import Parameter, Step
from truing.simulation.inputs import Missing

# Prior weights of a change along the load's own axis only, and of all axes together.
_OWN_SHARE, _ALL_SHARE = 0.4, 0.3
_PLAUSIBLE_CLEARANCE = {True: 2e-6, False: 2.0 * np.pi / 180.0 / 3600.0}
# Least number of distinct load sizes to distinguish a course from a proportional one.
_LEVELS = 2


@dataclass(frozen=True)
class Deflection(LoadCause):
    """Base class: the elastic deflection under loads along an axis, or all axes if empty, is multiplied by a factor.

    If ``own``, only the component along the load's own axis is multiplied, otherwise all six.
    """

    axis: str = ""
    own: bool = False

    step = Step.STRUCTURE
    plausible: ClassVar[float] = 0.03
    parameter: ClassVar[str]

    def candidates(self, scene: BenchScene) -> Sequence[Deflection]:
        """Return all axes together, each axis that can show it, and its own component only if others were read."""
        axes = [axis for axis in loaded_axes(scene) if self.shows(scene.steps, AXES.index(axis))]
        deflections: list[Deflection] = [replace(self, axis="")] if len(axes) > 1 else []
        for axis in axes:
            deflections.append(replace(self, axis=axis))
            if _is_observable(scene, AXES.index(axis), own_component=False) and _is_observable(
                scene, AXES.index(axis), own_component=True
            ):
                deflections.append(replace(self, axis=axis, own=True))
        return deflections

    def shows(self, steps: LoadSteps, axis: int) -> bool:
        """True if loads of an axis could show it."""
        return True

    def prior(self, scene: BenchScene) -> float:
        """Return the relative prior weight of an axis, its own component only, or all axes together."""
        if not self.axis:
            return _ALL_SHARE * len(loaded_axes(scene))
        return _OWN_SHARE if self.own else 1.0 - _OWN_SHARE

    def parameters(self, legs: int) -> tuple[Parameter, ...]:
        """Return the single parameter."""
        return (Parameter(self.parameter, "1", self.plausible),)

    def excess(self, steps: LoadSteps, values: NDArray) -> tuple[NDArray, NDArray]:
        """Return the factor of the deflection minus one (B, 6), and its derivative by parameters (B, 6, P)."""
        course = self.course(steps)
        return course * values[0], course[..., None]

    def course(self, steps: LoadSteps) -> NDArray:
        """Return the excess (B, 6) per unit of its parameter, for a linear cause."""
        raise NotImplementedError

    def slopes(self, state: ReadingState, values: NDArray) -> NDArray:
        """Return d deflection / d parameters."""
        by_axis = self.excess(state.steps, values)[1]
        return np.asarray(state.deflection[..., None] * by_axis[:, None] * self._affected_responses[..., None])

    def moved(self, state: ReadingState, values: NDArray) -> NDArray:
        """Return the change of the deflection."""
        return np.asarray(state.deflection * self._factor(state.steps, values))

    def passed_on(self, slopes: NDArray, state: ReadingState, values: NDArray) -> NDArray:
        """Return changes of the deflection times the same factor."""
        return np.asarray(slopes * (1.0 + self._factor(state.steps, values)[..., None]))

    def _factor(self, steps: LoadSteps, values: NDArray) -> NDArray:
        return np.asarray(self.excess(steps, values)[0][:, None] * self._affected_responses)

    @property
    def _affected_responses(self) -> NDArray:
        """Mask (6, 6) of the responses and loads concerned."""
        axes = np.array([not self.axis or axis == self.axis for axis in AXES])
        return np.where(np.eye(6, dtype=bool) if self.own else np.ones((6, 6), bool), axes, False).astype(float)


@dataclass(frozen=True)
class StiffnessScale(Deflection):
    """The stiffness along an axis is 1 + scale times the simulated one."""

    id = "stiffness-scale"
    parameter = "scale"

    def excess(self, steps: LoadSteps, values: NDArray) -> tuple[NDArray, NDArray]:
        """Return 1 / (1 + scale) - 1 and its derivative."""
        stiffer = 1.0 + values[0] * np.ones((len(steps.load), 6))
        return 1.0 / stiffer - 1.0, -(stiffer[..., None] ** -2.0)


@dataclass(frozen=True)
class StiffnessAsymmetry(Deflection):
    """The deflection is 1 + asymmetry/2 times as large under positive loads, 1 - asymmetry/2 under negative ones."""

    id = "stiffness-asymmetry"
    parameter = "asymmetry"

    def shows(self, steps: LoadSteps, axis: int) -> bool:
        """True if an axis was loaded in both directions."""
        return bool(steps.load[:, axis].min() < 0.0 < steps.load[:, axis].max())

    def course(self, steps: LoadSteps) -> NDArray:
        """Return half the loads' signs."""
        return 0.5 * np.sign(steps.load)


@dataclass(frozen=True)
class StiffnessNonlinear(Deflection):
    """The deflection is 1 + cubic (F / F_max)^2 times as large."""

    id = "stiffness-nonlinear"
    parameter = "cubic"

    def shows(self, steps: LoadSteps, axis: int) -> bool:
        """True if an axis was loaded by several amounts."""
        sizes = np.abs(steps.load[:, axis])
        return len(np.unique(sizes[sizes > 0.0])) >= _LEVELS

    def course(self, steps: LoadSteps) -> NDArray:
        """Return the squares of the loads over the largest."""
        return steps.share**2


@dataclass(frozen=True)
class Hysteresis(Deflection):
    """On unloading the deflection is larger, by width times the largest, at half of the largest load; zero at both
    ends."""

    id = "hysteresis"
    lacking = Missing.TURNS
    parameter = "width"
    plausible = 0.02

    def shows(self, steps: LoadSteps, axis: int) -> bool:
        """True if an axis was unloaded step by step."""
        return int(np.sum(steps.unloading[:, axis] & (steps.load[:, axis] != 0.0))) >= _LEVELS

    def one_sided(self, legs: int) -> tuple[int, ...]:
        """Return the width: on unloading a passive body lags and never leads."""
        return (0,)

    def course(self, steps: LoadSteps) -> NDArray:
        """Return 4 (1 - x) during unloading; times the deflection, which is proportional to x, it gives the loop.

        Beyond the largest load, in an overload test, it is zero.
        """
        return np.where(steps.unloading, 4.0 * np.maximum(1.0 - np.abs(steps.share), 0.0), 0.0)


@dataclass(frozen=True)
class JointClearance(LoadCause):
    """Play in the joints: half the clearance is added along the load's own axis, in its direction."""

    axis: str = "fz"

    id = "joint-clearance"
    step = Step.STRUCTURE
    reach = 30.0

    def candidates(self, scene: BenchScene) -> Sequence[JointClearance]:
        """Return every axis that was loaded by several amounts, if its own component was read."""
        steps = scene.steps
        return [
            JointClearance(axis)
            for axis in loaded_axes(scene)
            if _is_observable(scene, AXES.index(axis), own_component=True)
            and len(np.unique(steps.load[:, AXES.index(axis)])) > _LEVELS
        ]

    def one_sided(self, legs: int) -> tuple[int, ...]:
        """Return the clearance: it cannot be negative."""
        return (0,)

    def parameters(self, legs: int) -> tuple[Parameter, ...]:
        """Return the clearance, the full gap."""
        channel = CHANNELS[self._axis_index]
        unit, si = unit_of(channel)
        return (Parameter("clearance", unit, _PLAUSIBLE_CLEARANCE[is_linear(channel)], si),)

    def slopes(self, state: ReadingState, values: NDArray) -> NDArray:
        """Return d deflection / d clearance: half the load's sign, in its own component."""
        derivative = np.zeros((*state.deflection.shape, 1))
        derivative[:, self._axis_index, self._axis_index, 0] = 0.5 * np.sign(state.steps.load[:, self._axis_index])
        return derivative


def _is_observable(scene: BenchScene, axis: int, *, own_component: bool) -> bool:
    """True if, under loads of an axis, its own component was read, or any other of the platform's."""
    under_load = scene.recorded[scene.steps.load[:, axis] != 0.0][:, : len(CHANNELS)].any(0)
    return bool(under_load[axis] if own_component else np.delete(under_load, axis).any())
