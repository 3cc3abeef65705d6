"""Feasible region between limits, minus forbidden boxes: corners, uniform sampling, and projection into it.

Points are coordinates x (B, n). Limits apply to K quantities of x, nearly linear and zero at the origin, given by a
function with exact derivatives. Corners are those of the linearised region, moved to the exact limits by Newton's
method.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

Quantities = Callable[[NDArray], tuple[NDArray, NDArray]]  # x (B, n) -> values (B, K), derivatives (B, K, n)

_ROUNDS = 8  # of Newton and of pulling in, both with quadratic convergence
_STEPS_OF_A_WALK = 60
_SWEEPS = 60
_TOUCHING = 1e-9  # of a half range
_BEYOND = 1e-6  # of a half range
_STEADY = 1e-10  # change of a pull between sweeps, at convergence
_DRAWS = 50  # points drawn per point asked for, before the region counts as fully forbidden


@dataclass(frozen=True)
class _Faces:
    """Conditions sign * quantity[index] <= bound."""

    index: NDArray
    sign: NDArray
    bound: NDArray

    def and_also(self, index: int, sign: float, bound: float) -> _Faces:
        return _Faces(np.append(self.index, index), np.append(self.sign, sign), np.append(self.bound, bound))


@dataclass(frozen=True)
class FeasibleRegion:
    """Points x (B, size) whose quantities lie within half ranges (K,) and in no forbidden box.

    half_range: infinite without a limit. lower, upper (F, K): boxes in the quantities, infinite without an end; their
    faces are allowed.
    """

    size: int
    quantities: Quantities
    half_range: NDArray
    lower: NDArray
    upper: NDArray

    @cached_property
    def normals(self) -> NDArray:
        """Return the derivative (K, size) of the quantities at the origin."""
        return self.quantities(np.zeros((1, self.size)))[1][0]

    @cached_property
    def limited(self) -> NDArray:
        """Indices of the quantities with limits."""
        return np.flatnonzero(np.isfinite(self.half_range))

    def excess(self, x: NDArray) -> NDArray:
        """Return the largest quantity (B,) in units of its half range: at most 1 within the limits."""
        return np.asarray(np.max(np.abs(self.quantities(x)[0] / self.half_range), -1))

    def within(self, x: NDArray) -> NDArray:
        """Return the mask (B,) of points within the limits, to a millionth of them."""
        return self.excess(x) <= 1.0 + _BEYOND

    def allowed(self, x: NDArray) -> NDArray:
        """Return the mask (B,) of points in no forbidden box."""
        value = self.quantities(x)[0][:, None]
        slack = _TOUCHING * np.where(np.isfinite(self.half_range), self.half_range, 0.0)
        return ~np.any(np.all((value > self.lower + slack) & (value < self.upper - slack), -1), -1)

    def pulled_in(self, x: NDArray) -> NDArray:
        """Return points moved towards the origin until they are within the limits."""
        for _ in range(_ROUNDS):
            excess = self.excess(x)
            if excess.max(initial=0.0) <= 1.0 + 1e-12:
                break
            x = x / np.maximum(1.0, excess)[:, None]
        return x

    def draw(self, count: int, rng: np.random.Generator) -> NDArray:
        """Return points (count, size) spread evenly over the region; raises ValueError if all of it is forbidden."""
        points = np.empty((0, self.size))
        for _ in range(_DRAWS):
            x = self.pulled_in(self._hit_and_run(count, rng))
            points = np.concatenate([points, x[self.allowed(x) & self.within(x)]])
            if len(points) >= count:
                return points[:count]
        raise ValueError("forbidden regions that do not cover the whole workspace")

    def _hit_and_run(self, count: int, rng: np.random.Generator) -> NDArray:
        """Return points spread evenly within the linearised limits (hit and run, Smith, Oper. Res. 32 (1984) 1296)."""
        normals = self.normals[self.limited] / self.half_range[self.limited, None]
        x = np.zeros((count, self.size))
        for _ in range(_STEPS_OF_A_WALK):
            along = rng.normal(size=x.shape)
            slope, at = along @ normals.T, x @ normals.T
            reach = (np.sign(slope) - at) / slope, (-np.sign(slope) - at) / slope
            far, near = reach[0].min(-1), reach[1].max(-1)
            x = x + (near + (far - near) * rng.uniform(size=count))[:, None] * along
        return x

    def corners(self) -> NDArray:
        """Return the corners (C, size) of the limits, and of the parts that one face of a forbidden box leaves of them.

        With one box, their convex hull contains every allowed point. Corners cut by two overlapping boxes are not
        included.
        """
        k = self.limited
        faces = _Faces(np.tile(k, 2), np.repeat([1.0, -1.0], len(k)), np.tile(self.half_range[k], 2))
        parts = [self._corners_between(faces)]
        for low, high in zip(self.lower, self.upper, strict=True):
            parts += [
                self._corners_between(faces.and_also(int(i), 1.0, low[i])) for i in np.flatnonzero(np.isfinite(low))
            ]
            parts += [
                self._corners_between(faces.and_also(int(i), -1.0, -high[i])) for i in np.flatnonzero(np.isfinite(high))
            ]
        x = np.concatenate(parts)
        return _distinct(x[self.allowed(x) & self.within(x)])

    def _corners_between(self, faces: _Faces) -> NDArray:
        """Return the corners (C, size) of the points between faces; empty without such points."""
        from scipy.spatial import HalfspaceIntersection

        normals = self.normals[faces.index] * faces.sign[:, None]
        length = np.linalg.norm(normals, axis=-1)
        inside = (
            np.zeros(self.size)
            if (faces.bound > 0).all()
            else _deepest(normals / length[:, None], faces.bound / length)
        )
        if inside is None:
            return np.empty((0, self.size))
        x = HalfspaceIntersection(np.column_stack([normals, -faces.bound]) / length[:, None], inside).intersections
        x = _distinct(x[np.isfinite(x).all(-1)])
        touched = np.abs(x @ normals.T - faces.bound) <= 1e-7 * length * np.linalg.norm(x, axis=-1).max()
        return self._projected_onto_faces(x, faces, touched)

    def _projected_onto_faces(self, x: NDArray, faces: _Faces, touched: NDArray) -> NDArray:
        """Return points moved by Newton's method until they meet the touched faces (B, M) exactly."""
        for _ in range(_ROUNDS):
            value, slope = self.quantities(x)
            scale = touched / np.linalg.norm(self.normals[faces.index], axis=-1)
            missing = (faces.sign * faces.bound - value[:, faces.index]) * scale
            inverse = np.linalg.pinv(slope[:, faces.index] * scale[..., None], rcond=1e-6)
            x = x + (inverse @ missing[..., None])[..., 0]
        return self.pulled_in(x)

    def project(self, x: NDArray, about: NDArray) -> NDArray:
        """Return the nearest points within the limits, linearised at the points ``about`` (Dykstra 1983)."""
        value, slope = self.quantities(about)
        half = self.half_range[self.limited]
        normal = slope[:, self.limited] / half[:, None]
        at = value[:, self.limited] / half + np.einsum("bki,bi->bk", normal, x - about)
        pull = _multipliers(at, normal @ np.swapaxes(normal, 1, 2))
        return x - np.einsum("bk,bki->bi", pull, normal)


def _multipliers(at: NDArray, gram: NDArray) -> NDArray:
    """Return the multipliers (B, K) of limits -1 .. 1 that project points with quantities ``at`` (B, K); gram of the
    normals. This is the dual form of Dykstra's projections: one limit after the other, in sweeps."""
    pull = np.zeros(at.shape)
    for _ in range(_SWEEPS):
        before = pull.copy()
        for k in range(at.shape[1]):
            curvature = gram[:, k, k]
            free = at[:, k] + pull[:, k] * curvature
            wanted = (free - np.minimum(np.maximum(free, -1.0), 1.0)) / curvature
            at = at - (wanted - pull[:, k])[:, None] * gram[:, k]
            pull[:, k] = wanted
        if np.abs(pull - before).max() <= _STEADY:
            break
    return pull


def _deepest(normals: NDArray, bound: NDArray) -> NDArray | None:
    """Return the centre of the largest ball between faces ``normals x <= bound`` of unit normals, None without one."""
    from scipy.optimize import linprog

    size = normals.shape[1]
    aim = np.append(np.zeros(size), -1.0)
    solution = linprog(
        aim, np.column_stack([normals, np.ones(len(normals))]), bound, bounds=[(None, None)] * size + [(0, None)]
    )
    return solution.x[:size] if solution.status == 0 and solution.x[size] > 1e-9 * np.abs(bound).max() else None


def _distinct(x: NDArray) -> NDArray:
    """Return points (C, n) without duplicates, to a billionth of the largest coordinate."""
    if not len(x):
        return x
    grid = np.round(x / (_TOUCHING * 10 * np.abs(x).max()))
    return x[np.sort(np.unique(grid, axis=0, return_index=True)[1])]
