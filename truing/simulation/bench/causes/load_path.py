"""Loads that are not applied as they should be: off the origin, with a force beside a torque, by two uneven units."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from truing.simulation.bench.causes.reading_causes import MM, BenchScene, ReadingCause, is_force, loaded_axes
from truing.simulation.bench.load_steps import LoadSteps, ReadingState
from truing.simulation.bench.six_upur.loading import AXES
from truing.simulation.cause import Parameter, Step

_PLAUSIBLE_M, _PLAUSIBLE_PER_M = 5e-3, 0.05
_XYZ = "xyz"
# Forms of an imbalance: what depends on the load F in proportion, on its size, and on F |F| over the largest.
RATIO, ASYMMETRY, GROWTH = "", "_asymmetry", "_growth"
# With a mean ratio, or without.
_MEAN = ((RATIO,), ())
# A force off the origin: of one axis each; all forces' common one is less likely.
_COMMON_SHARE = 0.5


class LoadCause(ReadingCause):
    """A cause that concerns loads along ``axis``, or along all axes where that is empty."""

    axis: str

    @property
    def subject(self) -> str:
        """Return the load axis; empty for all."""
        return f"load {self.axis}" if self.axis else ""

    @property
    def family(self) -> str:
        """Return the kind and its axis: a model takes up one of its forms."""
        return f"{self.id} {self.axis}".strip()

    def excludes(self, other: ReadingCause) -> bool:
        """Return whether another is of the same kind and concerns an axis that this one does."""
        if not isinstance(other, LoadCause) or self.id != other.id:
            return False
        return not self.axis or not other.axis or self.axis == other.axis

    @property
    def _place(self) -> int:
        return AXES.index(self.axis)


@dataclass(frozen=True)
class LoadEccentricity(LoadCause):
    """A force's line of action is offset from the origin, or that of all forces; a torque brings a force along."""

    axis: str = "fz"

    id = "load-eccentricity"
    step = Step.DRIVE
    reach = 30.0

    def candidates(self, scene: BenchScene) -> Sequence[LoadEccentricity]:
        """Return every axis that was loaded, and all forces together where there are two of them."""
        axes = loaded_axes(scene)
        common = [LoadEccentricity("")] if sum(is_force(axis) for axis in axes) > 1 else []
        return [*common, *(LoadEccentricity(axis) for axis in axes)]

    def prior(self, scene: BenchScene) -> float:
        """Return the weight of an axis, and of all forces together."""
        return 1.0 if self.axis else _COMMON_SHARE * len(loaded_axes(scene))

    def parameters(self, legs: int) -> tuple[Parameter, ...]:
        """Return the offset across a force's axis, or what a torque brings along."""
        if self.axis and not is_force(self.axis):
            return tuple(Parameter(f"force_{c}", "1/m", _PLAUSIBLE_PER_M) for c in _XYZ)
        return tuple(Parameter(f"offset_{_XYZ[c]}", "mm", _PLAUSIBLE_M, MM) for c in self._across)

    def slopes(self, state: ReadingState, values: NDArray) -> NDArray:
        """Return d wrench / d offset: the axis crossed with the force; / d force: the torque along each direction."""
        load = state.steps.load
        wrench = np.zeros((*load.shape, 3))
        if self.axis and not is_force(self.axis):
            wrench[:, np.arange(3), np.arange(3)] = load[:, self._place, None]
            return wrench
        force = load[:, :3] * (np.eye(3)[self._place] if self.axis else 1.0)
        wrench[:, 3:] = np.cross(np.eye(3)[None], force[:, None]).swapaxes(1, 2)
        return wrench[..., self._across]

    @property
    def _across(self) -> list[int]:
        return [c for c in range(3) if not self.axis or c != self._place]


@dataclass(frozen=True)
class LoadImbalance(LoadCause):
    """Two units drive an axis: a parasitic moment (beside a force) or force (beside a torque) per load.

    ``components`` of x, y, z; ``forms``: in proportion to the load F, to half its size (so that it differs between
    positive and negative loads by the asymmetry), or growing with it.
    """

    axis: str = "fz"
    components: tuple[str, ...] = ("x",)
    forms: tuple[str, ...] = (RATIO, ASYMMETRY)

    id = "load-imbalance"
    step = Step.DRIVE
    reach = 30.0

    def candidates(self, scene: BenchScene) -> Sequence[LoadImbalance]:
        """Return, for every axis that was loaded both ways, components with what differs; for any what grows."""
        load = scene.steps.load
        found: list[LoadImbalance] = []
        for axis in loaded_axes(scene):
            own = load[:, AXES.index(axis)]
            sets = [tuple(chosen) for size in (1, 2, 3) for chosen in combinations(_XYZ, size)]
            if own.min() < 0.0 < own.max():
                found += [LoadImbalance(axis, chosen, (*more, ASYMMETRY)) for chosen in sets for more in _MEAN]
            if len(np.unique(np.abs(own))) > 2:
                found += [LoadImbalance(axis, chosen, (*more, GROWTH)) for chosen in sets for more in _MEAN]
        return found

    def parameters(self, legs: int) -> tuple[Parameter, ...]:
        """Return the parasitic load of each component, form by form."""
        force = is_force(self.axis)
        name, unit, scale = ("moment", "m", _PLAUSIBLE_M) if force else ("force", "1/m", _PLAUSIBLE_PER_M)
        return tuple(Parameter(f"{name}_{c}{form}", unit, scale) for c in self.components for form in self.forms)

    def slopes(self, state: ReadingState, values: NDArray) -> NDArray:
        """Return d wrench / d parameters."""
        load = self._courses(state.steps)
        wrench = np.zeros((len(load), 6, len(self.components), len(self.forms)))
        first = 3 if is_force(self.axis) else 0
        for place, component in enumerate(self.components):
            wrench[:, first + _XYZ.index(component), place] = load
        return wrench.reshape(len(load), 6, -1)

    def _courses(self, steps: LoadSteps) -> NDArray:
        """Return what each form is in proportion to (B, forms), N or N m."""
        load, largest = steps.load[:, self._place], steps.largest[self._place]
        by_form = {RATIO: load, ASYMMETRY: 0.5 * np.abs(load), GROWTH: load * np.abs(load) / largest}
        return np.stack([by_form[form] for form in self.forms], -1)
