"""Distances between targets of a chain, or to a station, alone or beside points: ball bars, wires, ranging."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from truing.arrays import Array, Index, Mask
from truing.simulation.effects_model import Prediction
from truing.simulation.mechanisms.chains.causes import ChainScene
from truing.simulation.mechanisms.chains.model import ChainModel
from truing.simulation.mechanisms.chains.start_values import StartValues
from truing.simulation.mechanisms.chains.tree import Node, Tree

_ROUNDS = 60
_SETTLED = 1e-9  # largest step, in prior sigmas
_WEAK = 1e-7  # of a free place's prior, against residuals in m
# Link of the stations, which does not move with the base.
GROUND = "ground of the stations"


def with_ground(tree: Tree) -> Tree:
    """Return the tree with one more link, beside the base, for the stations."""
    return replace(tree, nodes=(*tree.nodes, Node("", GROUND, -1, np.eye(3), np.zeros(3))))


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
        return replace(super().scene, places=np.zeros((len(self.ends) + len(self.coordinates), 0)))

    def predict(self, shared: NDArray, local: NDArray, by_shared: bool = True) -> Prediction:
        """Return the numbers (B, M + D, 1), m and rad, and derivatives at shared (G,) and local (B, H) unknowns."""
        found = super().predict(shared, local, by_shared)
        unit, _ = self._directions(found.values)
        return replace(
            found,
            values=self._numbers(found.values),
            by_shared=self._along(unit, found.by_shared),
            by_local=self._along(unit, found.by_local),
        )

    def points(self, shared: NDArray, local: NDArray) -> Array:
        """Return the numbers (B, M + D, 1), m and rad, at shared (G,) and local (B, H) unknowns."""
        return self._numbers(super().points(shared, local))

    def pathways(self, shared: NDArray, local: NDArray) -> dict[str, NDArray]:
        """Return the derivatives (B, M + D, 1, C) of the numbers by the twists of all nodes and by joints."""
        unit, _ = self._directions(super().points(shared, local))
        return {name: self._along(unit, own) for name, own in super().pathways(shared, local).items()}

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
        places, axes = self.coordinates.T
        return np.concatenate([points[:, places, axes], self._directions(points)[1]], 1)[..., None]

    def _directions(self, points: NDArray) -> tuple[Array, Array]:
        """Return unit vectors (B, D, 3) from the second to the first end, and distances (B, D)."""
        apart = points[:, self.ends[:, 0]] - points[:, self.ends[:, 1]]
        length = np.sqrt(np.sum(apart**2, -1))
        return apart / length[..., None], length

    def _along(self, unit: NDArray, slopes: NDArray) -> Array:
        """Return the derivatives (B, M + D, 1, P) of the numbers from those of the points (B, K, 3, P)."""
        apart = slopes[:, self.ends[:, 0]] - slopes[:, self.ends[:, 1]]
        places, axes = self.coordinates.T
        return np.concatenate([slopes[:, places, axes], np.einsum("bdi,bdip->bdp", unit, apart)], 1)[:, :, None]


def distance_start(model: DistanceModel, values: NDArray, seen: Mask, stations: Mask) -> StartValues:
    """Return the best places of stations, a mask (K,) of the channels, and targets for numbers (B, M + D, 1)."""
    known = model.known
    R, t = known.base_R[0], known.base_t[0]
    shape = known.shape.copy()
    nominal = ChainModel.points(model, np.zeros(model.shared_size), np.zeros((len(values), model.local_size)))
    for k in np.flatnonzero(stations):
        first = len(model.coordinates)
        shape[k] = R.T @ (_station(model, values[:, first:, 0], seen[:, first:], int(k), nominal) - t)
    started = replace(model, known=replace(known, shape=shape))
    weight = seen[..., None].astype(float)
    shared = _settled(started, values, weight)
    places = shape + known.shape_modes @ shared[model.layout["shape"]]
    left = (values - started.points(shared, np.zeros((len(values), model.local_size)))) * weight
    count = max(int(seen.sum()), 1)
    mean = np.sum(values * weight, 0) / np.maximum(weight.sum(0), 1.0)
    spread = float(np.sqrt(np.sum(((values - mean) * weight) ** 2) / count))
    return StartValues(known.base_R, known.base_t, places, known.tool, float(np.sqrt(np.sum(left**2) / count)), spread)


def _station(model: DistanceModel, lengths: NDArray, seen: Mask, k: int, nominal: NDArray) -> Array:
    """Return the place (3,) of a station by the squares of its distances to nominal places, which are linear in it."""
    rows, squares = [], []
    for d, (a, b) in enumerate(model.ends):
        if k in (a, b):
            own = seen[:, d]
            points = nominal[own, b if a == k else a]
            rows.append(np.concatenate([-2.0 * points, np.ones((len(points), 1))], 1))
            squares.append(lengths[own, d] ** 2 - np.sum(points**2, -1))
    found = np.linalg.lstsq(np.concatenate(rows), np.concatenate(squares), rcond=1e-9)[0]
    return np.asarray(found[:3])


def _settled(model: ChainModel, values: NDArray, weight: NDArray) -> Array:
    """Return the shared unknowns (G,) of the least-squares fit to values (B, K, d) of given weight, by damped steps."""
    shared, local = np.zeros(model.shared_size), np.zeros((len(values), model.local_size))
    damping, best = 1e-6, _misfit(model, shared, values, weight)
    for _ in range(_ROUNDS if model.shared_size else 0):
        found = model.predict(shared, local)
        rows = (found.by_shared * weight[..., None]).reshape(-1, model.shared_size)
        gap = ((values - found.values) * weight).ravel()
        normal = rows.T @ rows + _WEAK**2 * np.eye(model.shared_size)
        step = np.linalg.solve(normal + damping * np.diag(np.diag(normal)), rows.T @ gap)
        now = _misfit(model, shared + step, values, weight)
        if now > best:
            damping *= 10.0
        else:
            shared, best, damping = shared + step, now, max(damping / 10.0, 1e-12)
        if np.abs(step).max() < _SETTLED or damping > 1e6:
            break
    return shared


def _misfit(model: ChainModel, shared: NDArray, values: NDArray, weight: NDArray) -> float:
    return float(np.sum(((values - model.points(shared, np.zeros((len(values), model.local_size)))) * weight) ** 2))
