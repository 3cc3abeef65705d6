"""Distances between ends of a chain, and the places of ends that fit them, with the nominal chain."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from truing.arrays import Array, Index, Mask
from truing.simulation.mechanisms.chains.conditions import ChainConditions
from truing.simulation.mechanisms.chains.tree import Node, Tree

_ROUNDS = 60
_SETTLED = 1e-9  # largest step, in scales of a place
_SCALE = 0.05  # of a place, m
_POSSIBLE = 10.0  # squares of a place to start from, over those of another fit
_WEAK = 1e-7  # of a free place's prior, against residuals in m
# Link of the stations, which does not move with the base.
GROUND = "ground of the stations"


def with_ground(tree: Tree) -> Tree:
    """Return the tree with one more link, parallel to the base, for the stations."""
    return replace(tree, nodes=(*tree.nodes, Node("", GROUND, -1, np.eye(3), np.zeros(3))))


@dataclass(frozen=True)
class MeasuredLines:
    """Distances (B, D), m, at frames R (B, K, 3, 3), t (B, K, 3) of the links of the channels, between ``ends``
    (D, 2)."""

    R: NDArray
    t: NDArray
    ends: Index
    lengths: NDArray
    is_observed: Mask

    def points(self, shape: NDArray) -> Array:
        """Return the channels (B, K, 3) at places (K, 3) in their links."""
        return np.asarray(self.t + np.einsum("bkij,kj->bki", self.R, shape))

    def apart(self, shape: NDArray) -> Array:
        """Return the first end of each distance as seen from the second (B, D, 3)."""
        points = self.points(shape)
        return np.asarray(points[:, self.ends[:, 0]] - points[:, self.ends[:, 1]])

    def errors(self, shape: NDArray) -> Array:
        """Return measured less predicted distances (B, D); NaN where not seen."""
        return np.where(self.is_observed, self.lengths - np.linalg.norm(self.apart(shape), axis=-1), np.nan)

    def squares(self, shape: NDArray) -> float:
        """Return the sum of squared errors."""
        return float(np.nansum(self.errors(shape) ** 2))

    def slopes(self, shape: NDArray, modes: NDArray) -> Array:
        """Return the derivatives (B, D, W) of the distances by errors of the places (K, 3, W)."""
        vectors = self.apart(shape)
        unit = vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-300)
        moved = self.R @ modes
        return np.einsum("bdi,bdiw->bdw", unit, moved[:, self.ends[:, 0]] - moved[:, self.ends[:, 1]])

    def spread(self, shape: NDArray) -> float:
        """Return the root mean square of distances about their means, and of one end as seen from the other."""
        is_observed = self.is_observed[..., None]
        moved = np.concatenate([self.lengths[..., None], self.apart(shape)], -1)
        mean = np.sum(moved * is_observed, 0) / np.maximum(np.sum(is_observed, 0), 1)
        return float(np.sqrt(np.mean(((moved - mean) ** 2)[self.is_observed])))


def lines_at(
    tree: Tree,
    node: Index,
    ends: Index,
    conditions: ChainConditions,
    lengths: NDArray,
    is_observed: Mask,
    base: tuple[NDArray, NDArray] | None = None,
) -> MeasuredLines:
    """Return distances (B, D) between channels of nodes (K,), by the nominal chain at its readings.

    ``base``: R (S, 3, 3), t (S, 3) of the base in each frame of the measurement; the base is the frame if absent.
    """
    base_of_rows = None if base is None else (base[0][conditions.series], base[1][conditions.series])
    frames = tree.frames(conditions.readings, conditions.deviations, base_of_rows)
    return MeasuredLines(frames.R[:, node], frames.t[:, node], ends, lengths, is_observed)


def fitted_places(lines: MeasuredLines, shape: NDArray, free: Index, stations: Mask) -> Array:
    """Return places (K, 3) of channels, of which those ``free`` are fitted.

    Stations (K,) start from squares of their distances. Distances to points near one plane hardly determine the side of
    a station, so both sides are tried.
    """
    found = shape.copy()
    for k in np.flatnonzero(stations):
        found[k] = _station(lines, int(k), shape)
    errors = np.zeros((len(shape), 3, len(free), 3))
    errors[free, :, np.arange(len(free))] = _SCALE * np.eye(3)
    modes = errors.reshape(len(shape), 3, -1)
    best = _settled(lines, found, modes)
    for k in np.flatnonzero(stations):
        image = best.copy()
        image[k] = _mirror_image(lines, int(k), best)
        if lines.squares(image) <= _POSSIBLE * lines.squares(best):
            best = min(best, _settled(lines, image, modes), key=lines.squares)
    return best


def _station(lines: MeasuredLines, k: int, shape: NDArray) -> Array:
    """Return the place (3,) of a station in its stationary link, by linear equations: differences of its squared
    distances to places (K, 3)."""
    points, lengths = _measured_from(lines, k, shape)
    rows = np.concatenate([-2.0 * points, np.ones((len(points), 1))], 1)
    found = np.linalg.lstsq(rows, lengths**2 - np.sum(points**2, -1), rcond=1e-9)[0]
    return np.asarray(lines.R[0, k].T @ (found[:3] - lines.t[0, k]))


def _mirror_image(lines: MeasuredLines, k: int, shape: NDArray) -> Array:
    """Return the place (3,) of a station in its stationary link, mirrored in the plane nearest to its points."""
    points, _ = _measured_from(lines, k, shape)
    mean = points.mean(0)
    normal = np.linalg.svd(points - mean, full_matrices=False)[2][-1]
    return np.asarray(shape[k] - 2.0 * (lines.R[0, k].T @ normal) * ((lines.points(shape)[0, k] - mean) @ normal))


def _measured_from(lines: MeasuredLines, k: int, shape: NDArray) -> tuple[Array, Array]:
    """Return the points (n, 3) whose distances from a channel were measured, and the distances (n,)."""
    distances = [(d, b if a == k else a) for d, (a, b) in enumerate(lines.ends) if k in (a, b)]
    points, is_observed = lines.points(shape), lines.is_observed
    of_points = [points[is_observed[:, d], end] for d, end in distances]
    return np.concatenate(of_points), np.concatenate([lines.lengths[is_observed[:, d], d] for d, _ in distances])


def _settled(lines: MeasuredLines, shape: NDArray, modes: NDArray) -> Array:
    """Return the places (K, 3) of the least-squares fit, by damped steps over their errors (K, 3, W)."""
    damping, best = 1e-6, lines.squares(shape)
    for _ in range(_ROUNDS if modes.shape[-1] else 0):
        rows = lines.slopes(shape, modes)[lines.is_observed]
        normal = rows.T @ rows + _WEAK**2 * np.eye(modes.shape[-1])
        step = np.linalg.solve(
            normal + damping * np.diag(np.diag(normal)), rows.T @ lines.errors(shape)[lines.is_observed]
        )
        moved = shape + modes @ step
        now = lines.squares(moved)
        if now > best:
            damping *= 10.0
        else:
            shape, best, damping = moved, now, max(damping / 10.0, 1e-12)
        if np.abs(step).max() < _SETTLED or damping > 1e6:
            break
    return np.asarray(shape)
