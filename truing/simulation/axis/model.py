"""Class `AxisModel`: encoder readings of an axis at its commands as a function of the unknowns."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from truing.simulation.axis.causes import AxisCause, AxisScene
from truing.simulation.axis.rows import Axis, AxisRows
from truing.simulation.effects_model import ChannelModel, Prediction
from truing.simulation.inputs import ranks

# Number of blocks of rows that are left out of a fit in turn.
_EVERY = 5


@dataclass(frozen=True)
class AxisModel(ChannelModel[AxisCause]):
    """An axis with K encoders; predicts readings minus commands (B, K, 1), rad or m.

    ``zero_sigma`` is the wide prior of each encoder's zero, ``command_sigma`` one sigma of the axis' deviation from its
    command, common to all encoders.
    """

    axis: Axis
    rows: AxisRows
    zero_sigma: float
    command_sigma: float = 0.0

    channel_word = "encoder"

    @property
    def _sizes(self) -> dict[str, int]:
        return {"zero": len(self.axis.encoders)}

    @property
    def local_size(self) -> int:
        """Number of local unknowns: the deviation from the command, unless it is exact."""
        return int(self.command_sigma > 0.0)

    @property
    def channel_names(self) -> tuple[str, ...]:
        """Names (K,) of the encoders."""
        return self.axis.encoders

    @property
    def blocks(self) -> NDArray:
        """Block (B,) of each row for leaving out data: every fifth row, because effects of time can only be
        interpolated."""
        rank = ranks(self.rows.order)
        return np.asarray(rank % _EVERY * len(rank) + rank // _EVERY)

    @property
    def scene(self) -> AxisScene:
        """Scene from which causes propose candidates."""
        return AxisScene(self.axis, self.rows)

    def at(self, conditions: AxisRows) -> Self:
        """Return the model at other rows."""
        return replace(self, rows=conditions)

    def rescaled(self, readings: float, survey: float) -> Self:
        """Return the model with the noise of commands multiplied by a factor; there is no survey."""
        return replace(self, command_sigma=self.command_sigma * readings)

    def points(self, shared: NDArray, local: NDArray) -> NDArray:
        """Return readings minus commands (B, K, 1) at shared (G,) and local (B, H) unknowns."""
        found = np.tile(shared[self.layout["zero"]] * self.zero_sigma, (len(self.rows.command), 1))
        found = found + self.command_sigma * local.sum(1, keepdims=True)
        for effect in self.effects(shared):
            found = found + effect.cause.shift(self.rows, self.axis, effect.values)
        return found[..., None]

    def predict(self, shared: NDArray, local: NDArray, by_shared: bool = True) -> Prediction:
        """Return readings minus commands and derivatives at shared (G,) and local (B, H) unknowns."""
        points = self.points(shared, local)
        slopes = None
        if by_shared:
            slopes = np.zeros((*points.shape, self.shared_size))
            slopes[..., 0, self.layout["zero"]] = np.eye(len(self.axis.encoders)) * self.zero_sigma
            self._fill_effects(slopes[:, :, 0], shared, self._slopes_at(shared, local))
        by_local = np.full((*points.shape, self.local_size), self.command_sigma)
        return self._prediction(shared, points, slopes, by_local)

    @property
    def _shared_known(self) -> NDArray:
        return np.zeros(self.shared_size, bool)

    def _slopes_at(self, shared: NDArray, local: NDArray) -> Callable[[AxisCause, NDArray], NDArray]:
        return lambda cause, values: cause.slopes_at(self.rows, self.axis, values)
