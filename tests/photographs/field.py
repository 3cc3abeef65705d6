"""A test field: circles of many sizes and ring codes of all families on a wall, with other objects between them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from tests.blind.generator.quaternions import Array, unit
from tests.photographs.drawing import radiance
from tests.photographs.lens import Lens, View, direction
from tests.photographs.markers import words
from tests.photographs.patterns import BLACK_ON_WHITE, WHITE_ON_BLACK, Colours, Dot, Glint, Ring, Washer
from tests.photographs.ring_words import ring_words, segments
from tests.photographs.scene import Decal, Scene, decal
from tests.photographs.sensor import Grey, Sensor
from tests.photographs.solids import Plate, Tube
from tests.photographs.stations import looking

FACING = np.array([0.0, 0.0, 1.0])
FAMILIES = (0, 8, 12, 14)
OUTLINE = 2 * np.pi * np.arange(720) / 720


@dataclass(frozen=True)
class Shown:
    """A target of the field: bits of its code (0: none) and the code's number, dot's radius in mm, whether it is
    lighter than its ground, and the decal.
    """

    bits: int
    number: int
    radius_mm: float
    white: bool
    decal: Decal

    @property
    def name(self) -> str:
        return f"ring{self.bits}-{self.number}" if self.bits else ""


@dataclass(frozen=True)
class Field:
    """Targets, things next to them that are none, and solids."""

    shown: tuple[Shown, ...]
    clutter: tuple[Decal, ...]
    solids: tuple[Plate | Tube, ...]
    albedo: float

    def scene(self) -> Scene:
        """All of it."""
        return Scene(self.solids, (*(target.decal for target in self.shown), *self.clutter), nominal_mm=900.0)


def draw_field(
    rng: np.random.Generator, *, white: bool = True, columns: int = 9, rows: int = 7, step_mm: float = 60.0
) -> Field:
    """Targets on a grid of places, each turned and tilted in its own way, no code twice; every seventh place is left
    to what is no target. White: reflecting on a dark wall; else printed on stickers on a light one.
    """
    colours = WHITE_ON_BLACK if white else BLACK_ON_WHITE
    free = {bits: list(rng.permutation(len(ring_words(bits))) + 1) for bits in FAMILIES[1:]}
    shown, clutter = [], []
    for k in range(columns * rows):
        place = step_mm * np.array([k % columns - (columns - 1) / 2, k // columns - (rows - 1) / 2, 0.0])
        place = place + np.array([*rng.uniform(-2.0, 2.0, 2), 12.0])
        if k % 7 == 3:
            clutter.extend(_no_target(place, colours, rng))
            continue
        bits = FAMILIES[k % len(FAMILIES)]
        if bits and not free[bits]:
            bits = 0
        number = int(free[bits].pop()) if bits else 0
        radius = float(rng.uniform(3.0, 6.5)) if bits else float(rng.uniform(2.2, 13.0))
        pattern = Ring(radius, segments(bits, number), colours) if bits else Dot(radius, 1.8 * radius, colours)
        normal = unit(FACING + rng.normal(0.0, 0.25, 3) * [1.0, 1.0, 0.0])
        thing = decal(f"target {k}", pattern, place, normal, rng.uniform(0, 2 * np.pi), reflector=white)
        shown.append(Shown(bits, number, radius, white, thing))
    albedo = 0.05 if white else 0.6
    wall = Plate(np.array([0.0, 0.0, -40.0]), FACING, 0.0, 5000.0, albedo)
    return Field(tuple(shown), tuple(clutter), (wall,), albedo)


def _no_target(place: Array, colours: Colours, rng: np.random.Generator) -> Iterator[Decal]:
    """A false target at a place: concentric circles, lettering, a hole, a reflection."""
    kind = rng.integers(4)
    if kind == 0:
        half = 3.4 * np.array([1.0, 0.0, 0.0])
        yield decal("merged", Dot(4.0, 9.0, colours), place - half, FACING, reflector=True)
        yield decal("merged", Dot(4.0, 4.0, colours), place + half + 0.1 * FACING, FACING, reflector=True)
    elif kind == 1:
        yield decal("lettering", words("No. 46 B", 11.0), place, FACING, rng.uniform(-0.5, 0.5))
    elif kind == 2:
        yield decal("washer", Washer(9.0, 4.0), place, FACING)
    else:
        yield decal("glint", Glint(3.0, 0.8), place, FACING, reflector=True)


def stand(azimuth: float, tilt: float, distance_mm: float, roll: float) -> View:
    """A camera that looks at the field's middle from ``tilt`` (rad) off its normal."""
    away = np.array([np.sin(tilt) * np.cos(azimuth), np.sin(tilt) * np.sin(azimuth), np.cos(tilt)])
    centre = distance_mm * away[None]
    return View(looking(centre, np.zeros((1, 3)), np.array([roll]))[0], centre[0])


def photograph(field: Field, lens: Lens, view: View, sensor: Sensor, rng: np.random.Generator | None) -> Grey:
    """The field in a photograph."""
    return sensor.expose(radiance(lens, view, field.scene(), sensor.blur_px), lens, rng)


def centres_of_images(field: Field, lens: Lens, view: View) -> Array:
    """The centres (N, 2) of the circles' images, px: centroids of the areas within the imaged outlines."""
    return np.array([_centroid(_pixels(lens, view, _outline(target))) for target in field.shown])


def holes_of_washers(field: Field, lens: Lens, view: View) -> Array:
    """Images of the holes of washers (N, 2), px: circles that are no targets."""
    return _pixels(lens, view, np.array([one.centre for one in field.clutter if one.name == "washer"]).reshape(-1, 3))


def semi_minor_px(field: Field, lens: Lens, view: View) -> Array:
    """The shorter semi-axis (N,) of the circles' images, px."""
    outlines = [_pixels(lens, view, _outline(target)) for target in field.shown]
    return np.array([np.linalg.norm(o - o.mean(axis=0), axis=1).min() for o in outlines])


def _outline(target: Shown) -> Array:
    across, along = np.cos(OUTLINE)[:, None] * target.decal.right, np.sin(OUTLINE)[:, None] * target.decal.down
    return target.decal.centre + target.radius_mm * (across + along)


def _pixels(lens: Lens, view: View, points: Array) -> Array:
    pixel = lens.image_of(direction(view.seen(points)))
    return np.stack([pixel.real, pixel.imag], axis=-1)


def _centroid(corners: Array) -> Array:
    middle = corners.mean(axis=0)
    corners = corners - middle
    following = np.roll(corners, -1, axis=0)
    cross = corners[:, 0] * following[:, 1] - corners[:, 1] * following[:, 0]
    return middle + ((corners + following) * cross[:, None]).sum(axis=0) / (3 * cross.sum())
