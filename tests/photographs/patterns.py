"""Patterns printed on planar objects: brightness and opacity of every sample of a plane.

A pattern is a function of plane coordinates in mm, u to the right and v down as seen from the front. It gives albedo
and opacity of each sample of a grid. Edges are exact to second order: a sample is a small square, and the share of it
that a straight edge leaves is known in closed form.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from tests.blind.generator.quaternions import Array


class Pattern(Protocol):
    """A printed pattern and its radius."""

    @property
    def reach_mm(self) -> float: ...

    def __call__(self, u: Array, v: Array) -> tuple[Array, Array]: ...


def covered(inside: Array) -> Array:
    """Share of each sample (rows, columns) inside an edge, from the signed distance ``inside`` at samples' centres in
    any unit.
    """
    down, right = np.gradient(inside)
    return beyond_edge(inside, np.abs(right), np.abs(down))


def beyond_edge(distance: Array, a: Array, b: Array) -> Array:
    """Share of a square inside a straight edge whose distance changes by a and b over its sides."""
    a, b = np.maximum(a, 1e-12), np.maximum(b, 1e-12)
    half, less = (a + b) / 2, (a - b) / 2
    parts = [np.maximum(distance + shift, 0.0) ** 2 for shift in (half, less, -less, -half)]
    slanted = (parts[0] - parts[1] - parts[2] + parts[3]) / (2 * a * b)
    return np.where(distance >= half, 1.0, np.where(distance <= -half, 0.0, slanted))


@dataclass(frozen=True)
class Colours:
    """Albedo of the mark and of the ground it is on."""

    mark: float = 1.0
    ground: float = 0.012


WHITE_ON_BLACK = Colours()
BLACK_ON_WHITE = Colours(mark=0.015, ground=0.85)


@dataclass(frozen=True)
class Dot:
    """A circle of this radius on a round sticker."""

    radius_mm: float
    sticker_mm: float
    colours: Colours = WHITE_ON_BLACK

    @property
    def reach_mm(self) -> float:
        return self.sticker_mm

    def __call__(self, u: Array, v: Array) -> tuple[Array, Array]:
        r = np.hypot(u, v)
        return _mix(self.colours, covered(self.radius_mm - r)), covered(self.sticker_mm - r)


@dataclass(frozen=True)
class Ring:
    """A dot within a ring of segments from twice to three times its radius, on a round sticker of four."""

    radius_mm: float
    segments: tuple[bool, ...]
    colours: Colours = WHITE_ON_BLACK
    turn_rad: float = 0.0  # of the ring on its sticker, clockwise

    @property
    def reach_mm(self) -> float:
        return 4 * self.radius_mm

    def __call__(self, u: Array, v: Array) -> tuple[Array, Array]:
        r = np.hypot(u, v)
        between = covered(3 * self.radius_mm - r) - covered(2 * self.radius_mm - r)
        mark = covered(self.radius_mm - r) + between * self._lit(u, v, r)
        return _mix(self.colours, mark), covered(self.reach_mm - r)

    def _lit(self, u: Array, v: Array, r: Array) -> Array:
        """Share of a sample in lit segments; across the edge between two its width counts alike in all directions."""
        count = len(self.segments)
        place = ((np.arctan2(v, u) - self.turn_rad) * count / (2 * np.pi)) % count
        edge = np.round(place)
        lit = np.array(self.segments, float)
        before, after = lit[(edge.astype(int) - 1) % count], lit[edge.astype(int) % count]
        sample = np.median(np.abs(np.gradient(u, axis=1)) + np.abs(np.gradient(u, axis=0)))
        share = np.clip(0.5 + (place - edge) * (2 * np.pi / count) * r / sample, 0.0, 1.0)
        return before + (after - before) * share


@dataclass(frozen=True)
class Cells:
    """A raster of square cells (rows, columns) with these albedos, centred on the plane's origin."""

    albedo: Array
    cell_mm: float

    @property
    def reach_mm(self) -> float:
        return float(np.hypot(*self.albedo.shape)) * self.cell_mm / 2

    def __call__(self, u: Array, v: Array) -> tuple[Array, Array]:
        rows, columns = self.albedo.shape
        column, right = _cell_edge(u / self.cell_mm + columns / 2)
        row, below = _cell_edge(v / self.cell_mm + rows / 2)
        light, there = np.zeros_like(u), np.zeros_like(u)
        for i, share_i in ((row - 1, 1 - below), (row, below)):
            for j, share_j in ((column - 1, 1 - right), (column, right)):
                on = (i >= 0) & (i < rows) & (j >= 0) & (j < columns)
                share = share_i * share_j * on
                light += share * self.albedo[np.clip(i, 0, rows - 1), np.clip(j, 0, columns - 1)]
                there += share
        return light / np.maximum(there, 1e-9), there


def _cell_edge(place: Array) -> tuple[Array, Array]:
    """The nearest edge between cells, and the share of each sample beyond it."""
    down, right = np.gradient(place)
    edge = np.round(place)
    return edge.astype(int), beyond_edge(place - edge, np.abs(right), np.abs(down))


@dataclass(frozen=True)
class Washer:
    """A light rim round a dark hole: a screw, a drilled hole."""

    outer_mm: float
    inner_mm: float
    rim: float = 0.35
    hole: float = 0.01

    @property
    def reach_mm(self) -> float:
        return self.outer_mm

    def __call__(self, u: Array, v: Array) -> tuple[Array, Array]:
        r = np.hypot(u, v)
        return self.rim + (self.hole - self.rim) * covered(self.inner_mm - r), covered(self.outer_mm - r)


@dataclass(frozen=True)
class Glint:
    """A reflection without an edge: light that fades from its middle."""

    width_mm: float
    light: float = 0.9

    @property
    def reach_mm(self) -> float:
        return 4 * self.width_mm

    def __call__(self, u: Array, v: Array) -> tuple[Array, Array]:
        fading = np.exp(-0.5 * (u**2 + v**2) / self.width_mm**2)
        return np.full_like(u, self.light), fading


def _mix(colours: Colours, mark: Array) -> Array:
    return colours.ground + (colours.mark - colours.ground) * mark
