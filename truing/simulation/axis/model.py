"""Class `AxisModel`: encoder readings of an axis at its commands as a function of the unknowns."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from truing.simulation.axis.causes import AxisCause, AxisScene
from truing.simulation.axis.rows import TRANSMISSION, Axis, AxisRows
from truing.simulation.effects_model import ChannelModel, Prediction
from truing.simulation.inputs import ranks

# Number of blocks of rows that are left out of a fit in turn.
_EVERY = 5


@dataclass(frozen=True)
class AxisModel(ChannelModel[AxisCause]):
    """An axis with K encoders; predicts readings minus commands (B, K, 1), rad or m.

    ``zero_sigma`` is the wide prior of each encoder's zero, ``command_sigma`` one sigma of the axis' deviation from its
    command, common to all encoders; ``stop_sigma`` that of the load behind the motor at each stop. Both are rad or m,
    times ``input_factor`` (B, H) or (1, 1).
    """

    axis: Axis
    rows: AxisRows
    zero_sigma: float
    command_sigma: float = 0.0
    stop_sigma: float = 0.0
    input_factor: NDArray = field(default_factory=lambda: np.ones((1, 1)))

    channel_word = "encoder"

    @property
    def _sizes(self) -> dict[str, int]:
        return {"zero": len(self.axis.encoders)}

    @property
    def local_size(self) -> int:
        """Number of local unknowns H: stops about the command and behind the motor, unless they are exact."""
        return len(self.stops)

    @property
    def stops(self) -> tuple[str, ...]:
        """Elements (H,) whose stops are unknown: empty for the axis as a whole, and the transmission.

        A transmission to which all encoders respond equally is the axis as a whole.
        """
        response = self.axis.response(TRANSMISSION)
        moves = self.stop_sigma > 0.0 and bool(response.any())
        has_noise = self.command_sigma > 0.0
        return ("",) * has_noise + (TRANSMISSION,) * (moves and not (has_noise and np.ptp(response) == 0.0))

    @property
    def input_scale(self) -> NDArray:
        """Prior sigma (H,) of the stops, rad or m."""
        sigmas = {"": self.command_sigma, TRANSMISSION: self.stop_sigma}
        return np.array([sigmas[name] for name in self.stops])

    def with_input_factor(self, factor: NDArray) -> Self:
        """Return the model with the prior sigmas of the stops multiplied by factors (B, H)."""
        return replace(self, input_factor=factor)

    @property
    def _by_stops(self) -> NDArray:
        """Derivatives (B, K, H) of the readings by the stops in prior sigmas."""
        responses = [self.axis.response(name) if name else np.ones(len(self.axis.encoders)) for name in self.stops]
        unit = np.array(responses).reshape(-1, len(self.axis.encoders)).T * self.input_scale
        return np.broadcast_to(unit, (len(self.rows.command), *unit.shape)) * self.input_factor[:, None]

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
        return AxisScene(self.axis, self.rows, self.stops)

    def at(self, conditions: AxisRows) -> Self:
        """Return the model at other rows."""
        return replace(self, rows=conditions, input_factor=np.ones((1, 1)))

    def rescaled(self, readings: float, survey: float) -> Self:
        """Return the model with the noise of the stops multiplied by a factor; there is no survey."""
        return replace(self, command_sigma=self.command_sigma * readings, stop_sigma=self.stop_sigma * readings)

    def points(self, shared: NDArray, local: NDArray) -> NDArray:
        """Return readings minus commands (B, K, 1) at shared (G,) and local (B, H) unknowns."""
        values = np.tile(shared[self.layout["zero"]] * self.zero_sigma, (len(self.rows.command), 1))
        values = values + np.einsum("bkh,bh->bk", self._by_stops, local)
        for effect in self.effects(shared):
            values = values + effect.cause.shift(self.rows, self.axis, effect.values)
        return values[..., None]

    def predict(self, shared: NDArray, local: NDArray, by_shared: bool = True) -> Prediction:
        """Return readings minus commands and derivatives at shared (G,) and local (B, H) unknowns."""
        points = self.points(shared, local)
        slopes = None
        if by_shared:
            slopes = np.zeros((*points.shape, self.shared_size))
            slopes[..., 0, self.layout["zero"]] = np.eye(len(self.axis.encoders)) * self.zero_sigma
            self._fill_effects(slopes[:, :, 0], shared, self._slopes_at(shared, local))
        return self._prediction(shared, points, slopes, self._by_stops[:, :, None])

    @property
    def _shared_known(self) -> NDArray:
        return np.zeros(self.shared_size, bool)

    def _slopes_at(self, shared: NDArray, local: NDArray) -> Callable[[AxisCause, NDArray], NDArray]:
        return lambda cause, values: cause.slopes_at(self.rows, self.axis, values)
