"""What the encoders of an axis read at its commands, as a function of what is not known exactly."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import NDArray

from truing.simulation.axis.causes import AxisCause
from truing.simulation.axis.rows import Axis, AxisRows, AxisScene, encoder_targets
from truing.simulation.cause import OBSERVED, Cause
from truing.simulation.effects_model import EffectsModel
from truing.simulation.mechanisms.model import Prediction
from truing.simulation.targets import Targets

# Rows this far apart are left out of a fit together.
_EVERY = 5


@dataclass(frozen=True)
class AxisModel(EffectsModel):
    """An axis with K encoders; predicts readings minus commands (B, K, 1), rad or m.

    ``zero_sigma`` is the wide prior of each encoder's zero, ``command_sigma`` one sigma of how far the axis stands from
    its command, in all encoders alike.
    """

    axis: Axis
    rows: AxisRows
    zero_sigma: float
    command_sigma: float = 0.0

    @property
    def part_count(self) -> int:
        """Return the number of legs: none."""
        return 0

    @cached_property
    def layout(self) -> dict[str, slice]:
        """Return where each kind of shared unknown stands in the vector."""
        sizes = {"zero": len(self.axis.encoders), "shape": 0}
        sizes |= {cause.key: len(cause.parameters(0)) for cause in self.causes}
        ends = np.cumsum(list(sizes.values()))
        return {name: slice(int(end) - size, int(end)) for (name, size), end in zip(sizes.items(), ends, strict=True)}

    @property
    def local_size(self) -> int:
        """Return the number of local unknowns: how far the axis stands from its command, where that is not exact."""
        return int(self.command_sigma > 0.0)

    @property
    def unpredicted(self) -> NDArray:
        """Return which local unknowns the model says nothing of: none."""
        return np.zeros(self.local_size, bool)

    @property
    def channel_groups(self) -> NDArray:
        """Return the number of each encoder's noise (K,): one for all.

        A single encoder has too few readings to tell its noise from an effect on most of them.
        """
        return np.zeros(len(self.axis.encoders), int)

    @property
    def targets(self) -> Targets:
        """Return the encoders as what is measured."""
        return encoder_targets(self.axis)

    @property
    def blocks(self) -> NDArray:
        """Return which rows (B,) are left out of a fit together: every fifth, since what depends on the time is told
        between rows that were measured, not beyond them."""
        rank = np.argsort(np.argsort(self.rows.order, kind="stable"))
        return np.asarray(rank % _EVERY * len(rank) + rank // _EVERY)

    @property
    def scene(self) -> AxisScene:
        """Return what the campaign offers to causes when they propose candidates."""
        return AxisScene(self.axis, self.rows)

    def with_causes(self, causes: Sequence[Cause]) -> Self:
        """Return the model with these effects among its unknowns."""
        return replace(self, causes=tuple(causes))

    def at(self, conditions: AxisRows) -> Self:
        """Return the model at other rows."""
        return replace(self, rows=conditions)

    def rescaled(self, readings: float, survey: float) -> Self:
        """Return the model with the noise of commands so many times as large; there is no survey."""
        return replace(self, command_sigma=self.command_sigma * readings)

    def rotations(self, shared: NDArray, local: NDArray) -> NDArray:
        """Return how readings follow shifts of them, (B, K, 1, 1): by one."""
        return np.ones((len(self.rows.command), len(self.axis.encoders), 1, 1))

    def points(self, shared: NDArray, local: NDArray) -> NDArray:
        """Return readings minus commands (B, K, 1) at shared (G,) and local (B, H) unknowns."""
        found = np.tile(shared[self.layout["zero"]] * self.zero_sigma, (len(self.rows.command), 1))
        found = found + self.command_sigma * local.sum(1, keepdims=True)
        for effect in self.effects(shared):
            found = found + self._slopes(effect.cause) @ effect.values
        return found[..., None]

    def predict(self, shared: NDArray, local: NDArray, by_shared: bool = True) -> Prediction:
        """Return readings minus commands and derivatives at shared (G,) and local (B, H) unknowns."""
        points = self.points(shared, local)
        slopes = self._by_shared(points.shape) if by_shared else np.empty((*points.shape, 0))
        by_local = np.full((*points.shape, self.local_size), self.command_sigma)
        known = np.zeros(self.shared_size, bool)
        rows = np.empty(0), np.empty((0, self.shared_size if by_shared else 0))
        return Prediction(points, slopes, by_local, *rows, known, ~self.unpredicted)

    def pathways(self, shared: NDArray, local: NDArray) -> dict[str, NDArray]:
        """Return no channel: a cause tells what it does to the readings."""
        return {}

    def design_matrix(self, shared: NDArray, local: NDArray) -> Callable[[Cause], dict[str, NDArray]]:
        """Return what tells a cause's change of the pathway ``observed``, (B, K, P), per plausible scale."""
        return lambda cause: {OBSERVED: self._slopes(cause) * self.effect_scale(cause)}

    def _by_shared(self, shape: tuple[int, ...]) -> NDArray:
        slopes = np.zeros((*shape[:2], self.shared_size))
        slopes[..., self.layout["zero"]] = np.eye(len(self.axis.encoders)) * self.zero_sigma
        for cause in self.causes:
            slopes[..., self.layout[cause.key]] = self._slopes(cause) * self.effect_sigma(cause)
        return slopes[:, :, None]

    def _slopes(self, cause: Cause) -> NDArray:
        assert isinstance(cause, AxisCause)  # the catalogue of axes holds no other
        return cause.slopes(self.rows, self.axis)
