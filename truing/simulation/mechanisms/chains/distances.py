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


@dataclass(frozen=True)
class _Lines:
    """Distances (B, D), m, at frames R (B, K, 3, 3), t (B, K, 3) of the links of the channels, between ``ends``
    (D, 2)."""

    R: NDArray
    t: NDArray
    ends: Index
    lengths: NDArray
    seen: Mask

    def points(self, shape: NDArray) -> Array:
        """Return the channels (B, K, 3) at places (K, 3) in their links."""
        return np.asarray(self.t + np.einsum("bkij,kj->bki", self.R, shape))

    def apart(self, shape: NDArray) -> Array:
        """Return the first end of each distance as seen from the second (B, D, 3)."""
        points = self.points(shape)
        return np.asarray(points[:, self.ends[:, 0]] - points[:, self.ends[:, 1]])

    def errors(self, shape: NDArray) -> Array:
        """Return measured less predicted distances (B, D); NaN where not seen."""
        return np.where(self.seen, self.lengths - np.linalg.norm(self.apart(shape), axis=-1), np.nan)

    def slopes(self, shape: NDArray, modes: NDArray) -> Array:
        """Return the derivatives (B, D, W) of the distances by errors of the places (K, 3, W)."""
        apart = self.apart(shape)
        unit = apart / np.maximum(np.linalg.norm(apart, axis=-1, keepdims=True), 1e-300)
        moved = self.R @ modes
        return np.einsum("bdi,bdiw->bdw", unit, moved[:, self.ends[:, 0]] - moved[:, self.ends[:, 1]])

    def spread(self, shape: NDArray) -> float:
        """Return the root mean square of distances about their means, and of one end as seen from the other."""
        seen = self.seen[..., None]
        moved = np.concatenate([self.lengths[..., None], self.apart(shape)], -1)
        mean = np.sum(moved * seen, 0) / np.maximum(np.sum(seen, 0), 1)
        return float(np.sqrt(np.mean(((moved - mean) ** 2)[self.seen])))


def distance_start(model: DistanceModel, values: NDArray, seen: Mask, stations: Mask) -> StartValues:
    """Return the best places of stations, a mask (K,) of the channels, and targets for numbers (B, M + D, 1).

    Places of channels are the only unknowns of the model. The spread includes the movement of one end as seen from the
    other: the length of a bar shows none.
    """
    known, first = model.known, len(model.coordinates)
    lines = _lines(model, values[:, first:, 0], seen[:, first:])
    shape = known.shape.copy()
    for k in np.flatnonzero(stations):
        shape[k] = _station(lines, int(k), known.shape)
    shape = _settled(lines, shape, known.shape_modes)
    errors = lines.errors(shape)[..., None]
    rms = float(np.sqrt(np.nanmean(errors**2)))
    return StartValues(known.base_R, known.base_t, shape, known.tool, rms, lines.spread(shape), errors)


def distance_errors(model: DistanceModel, values: NDArray, seen: Mask) -> Array:
    """Return the errors (B, D, 1) of distances at the places that the model starts from, m; NaN where not seen."""
    return _lines(model, values[..., 0], seen).errors(model.known.shape)[..., None]


def _lines(model: DistanceModel, lengths: NDArray, seen: Mask) -> _Lines:
    frames = model.tree_frames(np.zeros(model.shared_size), np.zeros((len(lengths), model.local_size)))
    own = model.channels.node
    return _Lines(frames.R[:, own], frames.t[:, own], model.ends, lengths, seen)


def _station(lines: _Lines, k: int, shape: NDArray) -> Array:
    """Return the place (3,) of a station in its link, which stands still, by the squares of its distances to places
    (K, 3), which are linear in it."""
    rows, squares, nominal = [], [], lines.points(shape)
    for d, (a, b) in enumerate(lines.ends):
        if k in (a, b):
            own = lines.seen[:, d]
            points = nominal[own, b if a == k else a]
            rows.append(np.concatenate([-2.0 * points, np.ones((len(points), 1))], 1))
            squares.append(lines.lengths[own, d] ** 2 - np.sum(points**2, -1))
    found = np.linalg.lstsq(np.concatenate(rows), np.concatenate(squares), rcond=1e-9)[0]
    return np.asarray(lines.R[0, k].T @ (found[:3] - lines.t[0, k]))


def _settled(lines: _Lines, shape: NDArray, modes: NDArray) -> Array:
    """Return the places (K, 3) of the least-squares fit, by damped steps over their errors (K, 3, W)."""
    damping, best = 1e-6, float(np.nansum(lines.errors(shape) ** 2))
    for _ in range(_ROUNDS if modes.shape[-1] else 0):
        rows = lines.slopes(shape, modes)[lines.seen]
        normal = rows.T @ rows + _WEAK**2 * np.eye(modes.shape[-1])
        step = np.linalg.solve(normal + damping * np.diag(np.diag(normal)), rows.T @ lines.errors(shape)[lines.seen])
        moved = shape + modes @ step
        now = float(np.nansum(lines.errors(moved) ** 2))
        if now > best:
            damping *= 10.0
        else:
            shape, best, damping = moved, now, max(damping / 10.0, 1e-12)
        if np.abs(step).max() < _SETTLED or damping > 1e6:
            break
    return np.asarray(shape)
