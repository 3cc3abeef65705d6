"""Solids of a scene: plates and tubes, hit by rays of a camera."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tests.blind.generator.quaternions import Array, rotate, unit
from tests.photographs.lens import Complex, View

FAR = 1e9  # depth where nothing is hit, mm


@dataclass(frozen=True)
class Hit:
    """Depth Z of rays (w, 1) where they meet a solid (FAR: they do not), and the cosine of incidence there."""

    depth: Array
    cosine: Array


@dataclass(frozen=True)
class Plate:
    """A flat ring: centre (3,), normal (3,), inner and outer radius, mm; a table is one without an end."""

    centre: Array
    normal: Array
    inner_mm: float
    outer_mm: float
    albedo: float

    def hit(self, w: Complex, view: View) -> Hit:
        """Rays of one camera; seen from the front alone."""
        centre, normal = view.seen(self.centre), rotate(view.turn, self.normal)
        ray = normal[0] * w.real + normal[1] * w.imag + normal[2]
        with np.errstate(divide="ignore", invalid="ignore"):
            depth = (centre @ normal) / ray
            away = _squared(w.real * depth - centre[0], w.imag * depth - centre[1], depth - centre[2])
        met = (depth > 0) & (ray < 0) & (away <= self.outer_mm**2) & (away >= self.inner_mm**2)
        return Hit(np.where(met, depth, FAR), np.where(met, -ray / np.sqrt(1 + np.abs(w) ** 2), 0.0))

    def outline(self) -> Array:
        """Points (K, 3) round it."""
        across = unit(np.cross(self.normal, [0.3, 0.5, 0.8]))
        other = np.cross(self.normal, across)
        angle = np.linspace(0, 2 * np.pi, 48)[:, None]
        return self.centre + 1.02 * self.outer_mm * (np.cos(angle) * across + np.sin(angle) * other)


@dataclass(frozen=True)
class Tube:
    """A round bar from one end (3,) to another, mm; its ends are open."""

    start: Array
    end: Array
    radius_mm: float
    albedo: float

    def hit(self, w: Complex, view: View) -> Hit:
        """Rays of one camera."""
        start, axis = view.seen(self.start), rotate(view.turn, self.end - self.start)
        length = np.linalg.norm(axis)
        axis = axis / length
        along = axis[0] * w.real + axis[1] * w.imag + axis[2]
        to_start = start @ axis
        # Components across the axis, of the ray and of the way to the start: a circle in the plane across it.
        rr = 1 + np.abs(w) ** 2 - along**2
        rs = start[0] * w.real + start[1] * w.imag + start[2] - along * to_start
        ss = start @ start - to_start**2
        root = rs**2 - rr * (ss - self.radius_mm**2)
        depth = (rs - np.sqrt(np.maximum(root, 0.0))) / np.maximum(rr, 1e-12)
        reached = depth * along - to_start
        met = (root > 0) & (depth > 0) & (reached >= 0) & (reached <= length)
        cosine = np.sqrt(np.maximum(root, 0.0) / np.maximum(rr, 1e-12)) * rr / self.radius_mm
        return Hit(np.where(met, depth, FAR), np.where(met, cosine / np.sqrt(1 + np.abs(w) ** 2), 0.0))

    def outline(self) -> Array:
        """Points (K, 3) round it."""
        corners = self.radius_mm * 1.2 * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
        return np.concatenate([self.start + corners, self.end + corners])


Solid = Plate | Tube


def _squared(x: Array, y: Array, z: Array) -> Array:
    return x**2 + y**2 + z**2


def hidden_by(solid: Solid, w: Complex, view: View, depth: Array) -> NDArray[np.bool_]:
    """Return True for rays that a solid meets before ``depth``."""
    return solid.hit(w, view).depth < depth - 0.5
