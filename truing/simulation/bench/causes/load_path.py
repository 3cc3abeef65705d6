"""Causes: wrongly applied loads, off the origin or with parasitic moments and forces; base class of causes of loads."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from truing.simulation.bench.causes.reading_causes import MM, BenchScene, ReadingCause, is_force, loaded_axes
from truing.simulation.bench.load_steps import ReadingState
from truing.simulation.bench.six_upur.loading import AXES, share_wrench
from truing.simulation.cause import Parameter, ReportedParameter, Step

_PLAUSIBLE_M, _PLAUSIBLE_PER_M, _PLAUSIBLE_SHARE = 5e-3, 0.05, 0.05
_XYZ = "xyz"
# Forms of an imbalance: proportional to the load F, to its size, and to F |F| over the largest load.
RATIO, ASYMMETRY, GROWTH = "", "_asymmetry", "_growth"
# Forms with a mean ratio, and without.
_MEAN = ((RATIO,), ())


class LoadCause(ReadingCause):
    """A cause that concerns loads along ``axis``, or along all axes if empty."""

    axis: str

    @property
    def subject(self) -> str:
        """Load axis; empty for all."""
        return f"load {self.axis}" if self.axis else ""

    @property
    def family(self) -> str:
        """Kind and axis: a model holds at most one of its forms."""
        return f"{self.id} {self.axis}".strip()

    def excludes(self, other: ReadingCause) -> bool:
        """True if the other cause is of the same kind and shares an axis with this one."""
        if not isinstance(other, LoadCause) or self.id != other.id:
            return False
        return not self.axis or not other.axis or self.axis == other.axis

    @property
    def _axis_index(self) -> int:
        return AXES.index(self.axis)


class OneOrAllAxesCause(LoadCause):
    """A cause of one load axis, or of all axes together; ``share_of_all`` weighs the latter per loaded axis."""

    share_of_all: ClassVar[float]

    def prior(self, scene: BenchScene) -> float:
        """Return the relative prior weight of an axis, or of all together."""
        return 1.0 if self.axis else self.share_of_all * len(loaded_axes(scene))


def with_all(axes: Sequence[str]) -> list[str]:
    """Return the axes of candidates: each axis and, with several, all of them together (empty)."""
    return ["", *axes] if len(axes) > 1 else list(axes)


@dataclass(frozen=True)
class LoadEccentricity(OneOrAllAxesCause):
    """The line of action of a force, or of all forces, is offset from the origin; a torque is accompanied by a
    force."""

    axis: str = "fz"

    id = "load-eccentricity"
    share_of_all = 0.5
    step = Step.DRIVE
    reach = 30.0

    def candidates(self, scene: BenchScene) -> Sequence[LoadEccentricity]:
        """Return every axis that was loaded, and all forces together if there are at least two."""
        axes = loaded_axes(scene)
        common = [LoadEccentricity("")] if sum(is_force(axis) for axis in axes) > 1 else []
        return [*common, *(LoadEccentricity(axis) for axis in axes)]

    def parameters(self, legs: int) -> tuple[Parameter, ...]:
        """Return the offset across a force's axis, or the force per torque."""
        if self.axis and not is_force(self.axis):
            return tuple(Parameter(f"force_{c}", "1/m", _PLAUSIBLE_PER_M) for c in _XYZ)
        return tuple(Parameter(f"offset_{_XYZ[c]}", "mm", _PLAUSIBLE_M, MM) for c in self._transverse_components)

    def slopes(self, state: ReadingState, values: NDArray) -> NDArray:
        """Return d wrench / d offset: the axis crossed with the force; / d force: the torque along each direction."""
        return np.asarray(np.einsum("ipj,bj->bip", self._by_load, state.wrench))

    def passed_on(self, slopes: NDArray, state: ReadingState, values: NDArray) -> NDArray:
        """Return changes (B, 6, Q) of the wrench with the moment or force that comes with them."""
        return np.asarray(slopes + np.einsum("ipj,p,bjq->biq", self._by_load, values, slopes))

    @property
    def _by_load(self) -> NDArray:
        """Derivative (6, P, 6) of the wrench by each parameter and each applied load."""
        by_load = np.zeros((6, 3, 6))
        if self.axis and not is_force(self.axis):
            by_load[np.arange(3), np.arange(3), self._axis_index] = 1.0
            return by_load
        forces = [self._axis_index] if self.axis else [0, 1, 2]
        by_load[3:, :, forces] = np.cross(np.eye(3)[:, None], np.eye(3)).transpose(2, 0, 1)[..., forces]
        return by_load[:, self._transverse_components]

    @property
    def _transverse_components(self) -> list[int]:
        return [c for c in range(3) if not self.axis or c != self._axis_index]


@dataclass(frozen=True)
class LoadImbalance(LoadCause):
    """Two drive units of an axis differ: a force causes a parasitic moment, a torque a parasitic force.

    ``components`` of x, y, z. ``forms``: ``""`` proportional to the load F; ``_asymmetry`` to |F| / 2, which differs
    between positive and negative loads; ``_growth`` to F |F| over the largest load. ``arm``: place of the first of two
    declared units, m; the parameters are then its excess over half of the load.
    """

    axis: str = "fz"
    components: tuple[str, ...] = ("x",)
    forms: tuple[str, ...] = (RATIO, ASYMMETRY)
    arm: tuple[float, ...] = ()

    id = "load-imbalance"
    step = Step.DRIVE
    reach = 30.0

    def candidates(self, scene: BenchScene) -> Sequence[LoadImbalance]:
        """Return subsets of components and the shares of declared units, with asymmetry for axes loaded in both
        directions, and with growth for several levels."""
        load = scene.steps.load
        imbalances: list[LoadImbalance] = []
        for axis in loaded_axes(scene):
            loads = load[:, AXES.index(axis)]
            bases = self._of_axis(axis, tuple(scene.steps.arms.get(axis, ())))
            forms = [ASYMMETRY] if loads.min() < 0.0 < loads.max() else []
            forms += [GROWTH] if len(np.unique(np.abs(loads))) > 2 else []
            imbalances += [replace(base, forms=(*more, form)) for form in forms for base in bases for more in _MEAN]
        return imbalances

    @staticmethod
    def _of_axis(axis: str, arm: tuple[float, ...]) -> list[LoadImbalance]:
        """Return the share of declared units, and the subsets of components that differ from it."""
        sets = [tuple(chosen) for size in (1, 2, 3) for chosen in combinations(_XYZ, size)]
        if not arm:
            return [LoadImbalance(axis, chosen) for chosen in sets]
        units = LoadImbalance(axis, (), arm=arm)
        return [units, *(LoadImbalance(axis, chosen) for chosen in sets if chosen != units._brought)]

    @property
    def _brought(self) -> tuple[str, ...]:
        """Components of the parasitic load that an unequal share of the units brings."""
        return tuple(_XYZ[index % 3] for index in np.flatnonzero(share_wrench(self.axis, self.arm)))

    def parameters(self, legs: int) -> tuple[Parameter, ...]:
        """Return the parasitic load of each component, or the excess of the first unit, form by form."""
        if self.arm:
            return tuple(Parameter(f"share{form}", "1", _PLAUSIBLE_SHARE) for form in self.forms)
        force = is_force(self.axis)
        name, unit, scale = ("moment", "m", _PLAUSIBLE_M) if force else ("force", "1/m", _PLAUSIBLE_PER_M)
        return tuple(Parameter(f"{name}_{c}{form}", unit, scale) for c in self.components for form in self.forms)

    def slopes(self, state: ReadingState, values: NDArray) -> NDArray:
        """Return d wrench / d parameters."""
        courses, _ = self._courses(state)
        slopes = self._places[:, :, None] * courses[:, None, None]
        return np.asarray(slopes.reshape(len(courses), 6, -1))

    def passed_on(self, slopes: NDArray, state: ReadingState, values: NDArray) -> NDArray:
        """Return changes (B, 6, Q) of the wrench with the parasitic load that comes with them.

        A mean ratio is not separable from free gains of the signals. Therefore errors of loads must pass through it as
        loads do: otherwise their effect on readings, and with it the noise, would depend on a number without meaning.
        """
        brought = self._places @ values.reshape(-1, len(self.forms))
        _, by_load = self._courses(state)
        return np.asarray(slopes + (by_load @ brought.T)[..., None] * slopes[:, self._axis_index, None])

    def reported(self, values: NDArray, covariance: NDArray, legs: int) -> tuple[ReportedParameter, ...]:
        """Return the parameters; those of declared units are followed by the parasitic load that they bring."""
        base_parameters = super().reported(values, covariance, legs)
        if not self.arm:
            return base_parameters
        quantity, unit = ("moment", "m") if is_force(self.axis) else ("force", "1/m")
        brought = share_wrench(self.axis, self.arm)
        return base_parameters + tuple(
            ReportedParameter(
                f"{quantity}_{_XYZ[index % 3]}{form}",
                float(brought[index] * value),
                float(abs(brought[index]) * np.sqrt(variance)),
                unit,
            )
            for form, value, variance in zip(self.forms, values, np.diag(covariance), strict=True)
            for index in np.flatnonzero(brought)
        )

    @property
    def _places(self) -> NDArray:
        """Parasitic wrench (6, C) of each component, or of the declared units."""
        if self.arm:
            return share_wrench(self.axis, self.arm)[:, None]
        first = 3 if is_force(self.axis) else 0
        return np.eye(6)[:, [first + _XYZ.index(component) for component in self.components]]

    def _courses(self, state: ReadingState) -> tuple[NDArray, NDArray]:
        """Return the load course (B, forms), N or N m, of each form, and its derivative by the load."""
        load, largest = state.wrench[:, self._axis_index], state.steps.largest[self._axis_index]
        direction = np.sign(load.real)
        size = direction * load
        by_form = {
            RATIO: (load, np.ones(len(load))),
            ASYMMETRY: (0.5 * size, 0.5 * direction),
            GROWTH: (load * size / largest, 2.0 * size / largest),
        }
        courses, slopes = zip(*(by_form[form] for form in self.forms), strict=True)
        return np.stack(courses, -1), np.stack(slopes, -1)
