"""Distances between targets of a chain, or to a station, alone or with points: ball bars, wires, ranging."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from truing.arrays import Array, Index
from truing.simulation.cause import OBSERVED
from truing.simulation.effects_model import Prediction
from truing.simulation.mechanisms.chains.causes import ChainCause, ChainScene
from truing.simulation.mechanisms.chains.model import ChainModel


@dataclass(frozen=True)
class DistanceModel(ChainModel):
    """A chain of which numbers are measured: M coordinates of channels, then D distances, each between two channels.

    ``ends`` (D, 2) are the channels of a distance, ``coordinates`` (M, 2) channel and axis. A station is a channel on
    the ground with an unknown place.
    """

    ends: Index
    coordinates: Index = field(default_factory=lambda: np.zeros((0, 2), int))

    channel_word = "distance"

    @property
    def channel_names(self) -> tuple[str, ...]:
        """Names (M + D,) of coordinates, and of distances by their ends."""
        names = self.channels.names
        axes = (f"{names[k]} {'xyz'[axis]}" for k, axis in self.coordinates)
        return (*axes, *(f"{names[a]} to {names[b]}" for a, b in self.ends))

    @property
    def channel_kinds(self) -> tuple[str, ...]:
        """Link of each coordinate, and the word distance (M + D,)."""
        links = self.channels.links
        return (*(links[k] for k, _ in self.coordinates), *("distance",) * len(self.ends))

    @property
    def channel_groups(self) -> NDArray:
        """Noise group (M + D,): one for all distances, and those of the channels for coordinates."""
        of_channels = super().channel_groups[self.coordinates[:, 0]] + 1
        return np.concatenate([of_channels, np.zeros(len(self.ends), int)])

    @property
    def is_angle(self) -> NDArray:
        """Mask (M + D,) of the coordinates of orientations."""
        of_channels = super().is_angle[self.coordinates[:, 0]]
        return np.concatenate([of_channels, np.zeros(len(self.ends), bool)])

    @property
    def scene(self) -> ChainScene:
        """Scene from which causes propose candidates; single targets cannot be shifted in it."""
        return replace(
            super().scene, places=np.zeros((len(self.ends) + len(self.coordinates), 0)), distances=self._named_ends
        )

    @property
    def _named_ends(self) -> tuple[tuple[str, str], ...]:
        names = self.channels.names
        return tuple((names[a], names[b]) for a, b in self.ends)

    def predict(self, shared: NDArray, local: NDArray, by_shared: bool = True) -> Prediction:
        """Return the numbers (B, M + D, 1), m and rad, and derivatives at shared (G,) and local (B, H) unknowns."""
        found = super().predict(shared, local, by_shared)
        unit, _ = self._directions(found.values)
        slopes = self._along(unit, found.by_shared)
        for effect in self.effects(shared) if by_shared else ():
            if (excess := effect.cause.excess(self.machine, self._named_ends)) is not None:
                columns = self.layout[effect.cause.key]
                slopes[:, len(self.coordinates) :, 0, columns] += excess * self.effect_sigma(effect.cause)
        return replace(
            found,
            values=self._read(found.values, shared),
            by_shared=slopes,
            by_local=self._along(unit, found.by_local),
        )

    def points(self, shared: NDArray, local: NDArray) -> Array:
        """Return the numbers (B, M + D, 1), m and rad, at shared (G,) and local (B, H) unknowns."""
        return self._read(super().points(shared, local), shared)

    def _read(self, points: NDArray, shared: NDArray) -> Array:
        """Return coordinates and distances (B, M + D, 1) as read: with what is read too long."""
        numbers = self._numbers(points)
        for effect in self.effects(shared):
            if (excess := effect.cause.excess(self.machine, self._named_ends)) is not None:
                numbers[:, len(self.coordinates) :, 0] += excess @ effect.values
        return numbers

    def _other_designs(self, shared: NDArray, local: NDArray) -> Callable[[ChainCause], dict[str, NDArray]]:
        """Return the function from a cause to its twists, and shifts of numbers, of readings too."""
        moved = super()._other_designs(shared, local)

        def found(cause: ChainCause) -> dict[str, NDArray]:
            by = moved(cause)
            if (excess := cause.excess(self.machine, self._named_ends)) is not None:
                none = np.zeros((len(excess), len(self.coordinates), excess.shape[-1]))
                by[OBSERVED] = np.concatenate([none, excess], 1) * self.effect_scale(cause)
            return by

        return found

    def pathways(self, shared: NDArray, local: NDArray) -> dict[str, NDArray]:
        """Return the derivatives (B, M + D, 1, C) of the numbers by the twists of all nodes and by joints."""
        unit, _ = self._directions(super().points(shared, local))
        return {name: self._along(unit, slopes) for name, slopes in super().pathways(shared, local).items()}

    def rotations(self, shared: NDArray, local: NDArray) -> Array:
        """Return ones (B, M + D, 1, 1): a number has no direction."""
        return np.ones((len(local), len(self.ends) + len(self.coordinates), 1, 1))

    def _observed_shifts(self, shared: NDArray, local: NDArray) -> Callable[[NDArray], Array]:
        """Return the function from shifts (B, K, 3, P) of the targets in their links to changes (B, M + D, P) of
        the numbers."""
        turned = super().rotations(shared, local)
        unit, _ = self._directions(super().points(shared, local))
        return lambda shifts: self._along(unit, turned @ shifts)[:, :, 0]

    def _numbers(self, points: NDArray) -> Array:
        """Return coordinates and distances (B, M + D, 1) of points (B, K, 3)."""
        rows, axes = self.coordinates.T
        return np.concatenate([points[:, rows, axes], self._directions(points)[1]], 1)[..., None]

    def _directions(self, points: NDArray) -> tuple[Array, Array]:
        """Return unit vectors (B, D, 3) from the second to the first end, and distances (B, D)."""
        difference = points[:, self.ends[:, 0]] - points[:, self.ends[:, 1]]
        length = np.sqrt(np.sum(difference**2, -1))
        return difference / length[..., None], length

    def _along(self, unit: NDArray, slopes: NDArray) -> Array:
        """Return the derivatives (B, M + D, 1, P) of the numbers from those of the points (B, K, 3, P)."""
        difference = slopes[:, self.ends[:, 0]] - slopes[:, self.ends[:, 1]]
        points, axes = self.coordinates.T
        return np.concatenate([slopes[:, points, axes], np.einsum("bdi,bdip->bdp", unit, difference)], 1)[:, :, None]
