"""Renderer: the light that reaches each pixel of a photograph.

The lens blurs what pixels then collect, in this order: pixels that were blurred only after they had collected their
light would show edges shifted by some thousandths, as their sampling had already cut off what blur takes away.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from tests.blind.generator.quaternions import Array, rotate
from tests.photographs.lens import Complex, Lens, View, direction
from tests.photographs.scene import Decal, Scene
from tests.photographs.solids import FAR, Solid, hidden_by

COARSE = 2  # pixels of the format per pixel of the background
REACH = 4.0  # standard deviations of blur that count
NODES = 8  # per axis, where the lens is undone exactly within a patch


@dataclass(frozen=True)
class Background:
    """Light, depth and number of the solid (-1: none), on the coarse grid."""

    light: Array
    depth: Array
    solid: NDArray[np.int64]


def radiance(lens: Lens, view: View, scene: Scene, blur_px: float, samples: int = 3) -> Array:
    """Light (height, width) of a scene in one photograph, blurred by a Gaussian of one sigma ``blur_px``; decals have
    ``samples`` squared samples per pixel.
    """
    behind = background(lens, view, scene)
    light = np.repeat(np.repeat(behind.light, COARSE, axis=0), COARSE, axis=1)[: lens.height_px, : lens.width_px]
    light = blurred(light, blur_px)
    seen = [view.seen(decal.centre)[2] for decal in scene.decals]
    for k in np.argsort(seen)[::-1]:
        _draw(scene.decals[k], lens, view, scene, behind, light, Fineness(samples, blur_px))
    return light


def background(lens: Lens, view: View, scene: Scene) -> Background:
    """Solids alone, the nearest first to be met."""
    w = _directions(lens)
    depth, light = np.full(w.shape, FAR), np.zeros(w.shape)
    number = np.full(w.shape, -1)
    for k, solid in enumerate(scene.solids):
        box = _box(lens, view, solid.outline(), COARSE, w.shape)
        if box is None:
            continue
        hit = solid.hit(w[box], view)
        nearer = hit.depth < depth[box]
        away = hit.depth * np.sqrt(1 + np.abs(w[box]) ** 2)
        lit = solid.albedo * (hit.cosine * (scene.nominal_mm / np.maximum(away, 1.0)) ** 2 + scene.ambient)
        depth[box] = np.where(nearer, hit.depth, depth[box])
        light[box] = np.where(nearer, lit, light[box])
        number[box] = np.where(nearer, k, number[box])
    return Background(light, depth, number)


@lru_cache(maxsize=8)
def _directions(lens: Lens) -> Complex:
    """Directions of the coarse grid."""
    middle = (COARSE - 1) / 2
    x = np.arange(middle, lens.width_px, COARSE)
    y = np.arange(middle, lens.height_px, COARSE)
    return lens.direction_of(x + 1j * y[:, None])


def _box(
    lens: Lens, view: View, outline: Array, step: int, shape: tuple[int, ...], margin: int = 0
) -> tuple[slice, slice] | None:
    """Rows and columns of a grid with one entry per ``step`` pixels that points (K, 3) round a thing bound, with a
    margin; None where it is out of sight.
    """
    seen = view.seen(outline)
    if np.all(seen[:, 2] <= 0):
        return None
    if np.any(seen[:, 2] <= 1.0):
        return np.s_[: shape[0], : shape[1]]
    w = direction(seen)
    if np.min(np.abs(w)) > 2.0:
        return None
    # A lens' polynomial is only good near its format: what lies far outside is cut to a frame round it.
    limit = 1.5 * max(lens.width_px, lens.height_px) / lens.focal_px
    pixel = lens.image_of(w / np.maximum(1.0, np.abs(w) / limit))
    first = np.floor([pixel.imag.min() / step, pixel.real.min() / step]).astype(int) - 2 - margin
    last = np.ceil([pixel.imag.max() / step, pixel.real.max() / step]).astype(int) + 3 + margin
    (top, left), (bottom, right) = np.maximum(first, 0), np.minimum(last, shape)
    return None if top >= bottom or left >= right else np.s_[top:bottom, left:right]


@dataclass(frozen=True)
class Fineness:
    """Samples per pixel and axis, and the blur in pixels."""

    samples: int
    blur_px: float

    @property
    def margin_px(self) -> int:
        """Reach of the blur, px."""
        return int(np.ceil(REACH * self.blur_px)) + 1


@dataclass(frozen=True)
class Patch:
    """The samples of the pixels that a decal may reach: box of pixels, directions, depth, and places on its plane."""

    box: tuple[slice, slice]
    w: Complex
    depth: Array
    u: Array
    v: Array


def patch(decal: Decal, lens: Lens, view: View, samples: int, margin_px: int = 0) -> Patch | None:
    """Place of a decal in a photograph; None if it is out of sight."""
    centre, normal = view.seen(decal.centre), rotate(view.turn, decal.normal)
    if centre[2] <= 0 or centre @ normal >= 0:
        return None
    angle = np.linspace(0, 2 * np.pi, 24, endpoint=False)[:, None]
    outline = decal.centre + 1.05 * decal.reach_mm * (np.cos(angle) * decal.right + np.sin(angle) * decal.down)
    box = _box(lens, view, outline, 1, (lens.height_px, lens.width_px), margin_px)
    if box is None:
        return None
    w = _patch_directions(lens, box, samples)
    right, down = rotate(view.turn, decal.right), rotate(view.turn, decal.down)
    depth = (centre @ normal) / _along(normal, w)
    return Patch(box, w, depth, depth * _along(right, w) - centre @ right, depth * _along(down, w) - centre @ down)


def _draw(
    decal: Decal, lens: Lens, view: View, scene: Scene, behind: Background, light: Array, fineness: Fineness
) -> None:
    on = patch(decal, lens, view, fineness.samples, fineness.margin_px)
    if on is None:
        return
    albedo, opacity = decal.pattern(on.u, on.v)
    opacity = opacity * _in_sight(scene.solids, behind, on, view)
    lit = albedo * _lit(decal, scene, on.w, rotate(view.turn, decal.normal), on.depth)
    there, shown = (collected(part, fineness) for part in (opacity, lit * opacity))
    light[on.box] = light[on.box] * (1 - there) + shown


def collected(samples: Array, fineness: Fineness) -> Array:
    """Grey values of pixels from samples blurred by the lens."""
    return pixels(blurred(samples, fineness.blur_px * fineness.samples), fineness.samples)


def blurred(light: Array, sigma: float) -> Array:
    """Light (rows, columns) after a lens that spreads it as a Gaussian, sigma in entries of the grid."""
    width = 2 * int(np.ceil(REACH * sigma)) + 1
    return cv2.GaussianBlur(light, (width, width), sigma, borderType=cv2.BORDER_REPLICATE) if sigma else light


def _along(vector: Array, w: Complex) -> Array:
    """Scalar product of a vector in the camera's axes with rays (w, 1)."""
    return vector[0] * w.real + vector[1] * w.imag + vector[2]


def _lit(decal: Decal, scene: Scene, w: Complex, normal: Array, depth: Array) -> Array:
    reach = np.sqrt(1 + np.abs(w) ** 2)
    cosine = -_along(normal, w) / reach
    flash = (scene.nominal_mm / (depth * reach)) ** 2
    back = 0.55 + 0.45 * cosine if decal.reflector else cosine
    return back * flash + scene.ambient * cosine


def _in_sight(solids: tuple[Solid, ...], behind: Background, on: Patch, view: View) -> Array:
    """0 where a solid stands before a sample, else 1; only solids that the background has nearer are asked."""
    rows, columns = (slice(max(part.start // COARSE - 1, 0), part.stop // COARSE + 2) for part in on.box)
    near = behind.depth[rows, columns] < on.depth.max() - 0.5
    free = np.ones(on.w.shape)
    for k in np.unique(behind.solid[rows, columns][near]):
        free[hidden_by(solids[k], on.w, view, on.depth)] = 0.0
    return free


def _patch_directions(lens: Lens, box: tuple[slice, slice], samples: int) -> Complex:
    """Directions of all samples of a patch: exact at a few nodes, between them by the polynomial through them, which
    no lens can be distinguished from.
    """
    rows, columns = ((part.start - 0.5, part.stop - 0.5) for part in box)
    y, x = (low + _nodes() * (high - low) for low, high in (rows, columns))
    exact = lens.direction_of(x + 1j * y[:, None])
    down, across = (_weights(samples * (part.stop - part.start)) for part in box)
    return down @ exact @ across.T


def _nodes() -> Array:
    """Places between 0 and 1 where a polynomial is best held (Chebyshev's)."""
    return 0.5 - 0.5 * np.cos(np.pi * (np.arange(NODES) + 0.5) / NODES)


@lru_cache(maxsize=512)
def _weights(count: int) -> Array:
    """Weights (count, nodes) of the polynomial through values at the nodes, at evenly spaced samples."""
    nodes, places = _nodes(), (np.arange(count) + 0.5) / count
    apart = places[:, None, None] - nodes
    between = nodes[:, None] - nodes
    others = ~np.eye(len(nodes), dtype=bool)
    return np.prod(np.where(others, apart / np.where(others, between, 1.0), 1.0), axis=-1)


def pixels(samples: Array, count: int) -> Array:
    """Samples averaged over pixels."""
    rows, columns = (size // count for size in samples.shape)
    return samples.reshape(rows, count, columns, count).mean(axis=(1, 3))
