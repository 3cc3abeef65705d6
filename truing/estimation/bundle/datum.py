"""The datum of a pose: what rays leave free, and how coordinates and covariances pass from one choice to another.

Rays alone leave a pose seven freedoms, three shifts, three turns and the scale; a bar takes the scale, known points
take what they fix. What is left is settled by conditions B^T (p - p0) = 0 on the points: inner constraints (B the
freedoms themselves, free network) or as many coordinates held (minimal). Any solution passes into that datum by
S = 1 - G (B^T G)^-1 B^T (Baarda 1973; Luhmann et al., section 4.4.3); residuals and distances do not change.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.linalg import qr

from truing.estimation.bundle.layout import Layout
from truing.estimation.bundle.network import Array, Index, State
from truing.estimation.rotation import skew

Datum = Literal["free", "minimal", "known"]

_SQUARED = 1e-8  # of the size: the next step of Newton's method would be rounding
_FIXED = 1e-6  # a freedom moves known points by less than this part of its movement of all points: it is left


@dataclass(frozen=True)
class Freedom:
    """What the observations of a pose leave free: movements of its images (i, 6, d) and points (p, 3, d), of its points
    as a whole orthonormal, and the combination (7, d) of the shifts, turns and scale that they are."""

    images: Array
    points: Array
    mixture: Array

    @property
    def count(self) -> int:
        """How many there are: the defect of the datum."""
        return self.points.shape[-1]


def freedom(centres: Array, points: Array, has_length: bool, known: Index) -> Freedom:
    """Return what is left free of a pose with projection centres (i, 3) and points (p, 3) in m, where bars give the
    length or not and the points known, by number (m,), are known."""
    if not len(points):
        return Freedom(np.zeros((len(centres), 6, 0)), np.zeros((0, 3, 0)), np.zeros((7, 0)))
    middle = points.mean(0)
    size = np.sqrt(np.mean((points - middle) ** 2) * 3)
    of_images, of_points = np.zeros((len(centres), 6, 7)), _movements((points - middle) / size)
    of_images[:, :3], of_images[:, 3:, 3:6] = _movements((centres - middle) / size), np.eye(3) / size
    mixture = np.eye(7)[:, : 6 if has_length else 7]
    if len(known):
        mixture = mixture @ _null_space(of_points[known].reshape(-1, 7) @ mixture)
    if mixture.shape[1]:
        flat = (of_points @ mixture).reshape(-1, mixture.shape[1])
        mixture = mixture @ np.linalg.inv(np.linalg.cholesky(flat.T @ flat)).T
    of_images, of_points = of_images.reshape(-1, 7) @ mixture, of_points.reshape(-1, 7) @ mixture
    free = mixture.shape[1]
    return Freedom(of_images.reshape(len(centres), 6, free), of_points.reshape(len(points), 3, free), mixture)


def _movements(points: Array) -> Array:
    """Return the movements (n, 3, 7) of points by shifts, turns and scale about the origin."""
    found = np.zeros((len(points), 3, 7))
    found[:, :, :3], found[:, :, 6] = np.eye(3), points
    x, y, z = points.T
    found[:, 0, 4], found[:, 0, 5], found[:, 1, 5] = z, -y, x
    found[:, 1, 3], found[:, 2, 3], found[:, 2, 4] = -z, y, -x
    return found


def _null_space(rows: Array) -> Array:
    """Return directions (d, f) that rows (n, d) leave free, orthonormal."""
    _, s, vt = np.linalg.svd(rows)
    return vt[np.count_nonzero(s > _FIXED * s.max(initial=0)) :].T


def conditions(free: Freedom, datum: Datum) -> Array:
    """Return B (3 p, d): what of the points is held, so that nothing is left free."""
    rows = free.points.reshape(3 * len(free.points), free.count)
    if datum != "minimal" or not free.count:
        return rows
    # The coordinates that hold the network most firmly come first in a QR with pivots.
    chosen = qr(rows.T, mode="r", pivoting=True)[1][: free.count]
    held = np.zeros_like(rows)
    held[chosen, np.arange(free.count)] = 1.0
    return held


def freedoms(layout: Layout, state: State) -> tuple[Freedom, ...]:
    """Return what the observations leave free of every pose."""
    found = []
    for pose in range(layout.poses):
        start, stop = layout.point_start[pose], layout.point_start[pose + 1]
        known = layout.known_slot[(layout.known_slot >= start) & (layout.known_slot < stop)] - start
        images = layout.images[layout.image_start[pose] : layout.image_start[pose + 1]]
        has_length = bool(np.any(layout.distance_pose == pose))
        found.append(freedom(state.centre[images], state.points[layout.points[start:stop]], has_length, known))
    return tuple(found)


def in_datum(layout: Layout, state: State, start: State, held: tuple[Array, ...]) -> State:
    """Return a state moved and scaled so that nothing that is held, B (3 p, d) per pose, deviates from the start.

    The similarity is exact, not linearised: Newton's method on its seven numbers.
    """
    R, centre, points = state.R.copy(), state.centre.copy(), state.points.copy()
    for pose, free in enumerate(freedoms(layout, state)):
        if free.count:
            images = layout.images[layout.image_start[pose] : layout.image_start[pose + 1]]
            own = layout.points[layout.point_start[pose] : layout.point_start[pose + 1]]
            turn, scale, shift = _similarity(points[own], start.points[own], free, held[pose])
            points[own] = scale * points[own] @ turn.T + shift
            centre[images] = scale * centre[images] @ turn.T + shift
            R[images] = turn @ R[images]
    return State(state.interior, R, centre, points, state.bar_length_m)


def _similarity(points: Array, start: Array, free: Freedom, held: Array) -> tuple[Array, float, Array]:
    """Return rotation, scale and shift after which the points deviate from the start by nothing that is held."""
    whole = np.eye(4)
    middle = points.mean(0)
    size = np.sqrt(np.mean((points - middle) ** 2) * 3)
    for _ in range(50):
        now = (points - middle) @ whole[:3, :3].T + whole[:3, 3]
        by = held.T @ (_movements(now / size) @ free.mixture).reshape(-1, free.count)
        change = free.mixture @ np.linalg.solve(by, held.T @ (start - middle - now).ravel())
        generator = np.zeros((4, 4))
        generator[:3] = np.column_stack([skew(change[3:6]) / size + change[6] / size * np.eye(3), change[:3]])
        whole = _exponential(generator) @ whole  # along the freedoms exactly: what is known stays where it is
        if np.abs(change).max() <= _SQUARED * size:
            break
    scale = float(np.cbrt(np.linalg.det(whole[:3, :3])))
    turn = whole[:3, :3] / scale
    return turn, scale, whole[:3, 3] + middle - scale * turn @ middle


def _exponential(generator: Array) -> Array:
    """Return the exponential of a small matrix: Taylor's series of what is halved until it is short, then squared."""
    halvings = max(0, int(np.ceil(np.log2(max(np.abs(generator).sum(), 1e-300)))) + 3)
    part = term = generator / 2**halvings
    for order in range(2, 14):
        term = term @ (generator / 2**halvings) / order
        part = part + term
    for _ in range(halvings):  # of exp - 1, so that what is small keeps its digits
        part = 2 * part + part @ part
    return part + np.eye(len(generator))


def into_datum(free: Freedom, held: Array) -> Array:
    """Return F (d, 3 p): by how much each freedom is to be taken back from a change of the points."""
    if not free.count:
        return held.T
    return np.asarray(np.linalg.solve(held.T @ free.points.reshape(-1, free.count), held.T), np.float64)
