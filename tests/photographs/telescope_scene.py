"""Scene of the sample telescope: bodies, targets, scale bars, and other objects of a laboratory."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from tests.blind.generator.campaign import Campaign
from tests.blind.generator.quaternions import Array, from_vector, rotate, unit
from tests.photographs.markers import words
from tests.photographs.patterns import Dot, Glint, Ring, Washer
from tests.photographs.ring_words import segments
from tests.photographs.scene import Decal, Scene, decal
from tests.photographs.solids import Plate, Solid, Tube

FAMILY = "ring12"
DOT_MM = 3.5
DOT_STICKER_MM = 9.0
UP = np.array([0.0, 0.0, 1.0])
BASE_TOP_MM, PLATFORM_TOP_MM, TABLE_MM = -14.0, -14.0, -60.0


@dataclass(frozen=True)
class PosedTelescope:
    """One pose: campaign, names of all points, where they are and which way they face (M, 3), number of the pose."""

    campaign: Campaign
    names: tuple[tuple[str, str], ...]
    points: Array
    normals: Array
    n: int

    def platform(self, place: Array) -> Array:
        """Places (..., 3) of the platform's frame in the base frame."""
        truth = self.campaign.truth
        return rotate(from_vector(truth.rotation_vector[self.n]), place) + truth.position[self.n]

    @property
    def platform_up(self) -> Array:
        """The platform's z (3,)."""
        return rotate(from_vector(self.campaign.truth.rotation_vector[self.n]), UP)


def code_of(body: str, target: str) -> int:
    """The number of a target's ring code; 0 where it is a plain circle."""
    if body == "bars":
        return {"S": 100, "T": 110}[target[0]] + int(target[1])
    number = int(target[1:])
    if target[0] == "A" or number % 2 == 0:
        return 0
    return {"base": 10, "platform": 40}[body] + number


def telescope_scene(posed: PosedTelescope) -> Scene:
    """Everything in sight in one pose."""
    return Scene(
        solids=(*_bodies(posed), *_legs(posed), *_posts(posed)),
        decals=(*_targets(posed), *_clutter(posed)),
    )


def _bodies(posed: PosedTelescope) -> Iterator[Solid]:
    top, up = posed.platform(np.array([0.0, 0.0, PLATFORM_TOP_MM])), posed.platform_up
    base = np.array([0.0, 0.0, BASE_TOP_MM])
    yield Plate(np.array([0.0, 0.0, TABLE_MM]), UP, 0.0, 3000.0, 0.03)
    yield Plate(base, UP, 110.0, 262.0, 0.14)
    yield Tube(base - 22 * UP, base, 262.0, 0.09)
    yield Plate(top, up, 45.0, 152.0, 0.15)
    yield Tube(top - 12 * up, top, 152.0, 0.10)


def _legs(posed: PosedTelescope) -> Iterator[Solid]:
    truth, n = posed.campaign.truth, posed.n
    built = truth.built
    lower = built.a + (built.rho0 + truth.drho[n])[:, None] * built.u
    upper = posed.platform(built.b) + 0.0
    for low, high in zip(lower, upper, strict=True):
        yield Tube(low, high - 16 * unit(high - low), 6.0, 0.17)
        yield Tube(np.array([low[0], low[1], BASE_TOP_MM]), low, 13.0, 0.13)


def _posts(posed: PosedTelescope) -> Iterator[Solid]:
    """Under each target what it is glued to."""
    for (body, target), place, normal in zip(posed.names, posed.points, posed.normals, strict=True):
        radius = 0.55 * _reach(body, target)
        if body == "bars":
            continue
        foot = place - (place[2] - BASE_TOP_MM) * UP if body == "base" else _foot(posed, place)
        yield Tube(foot, place - 1.0 * normal, radius, 0.08)
    ends = np.reshape([p for (body, _), p in zip(posed.names, posed.points, strict=True) if body == "bars"], (-1, 2, 3))
    for start, end in ends:
        along = unit(end - start)
        yield Tube(start - 25 * along - 11 * UP, end + 25 * along - 11 * UP, 10.0, 0.05)


def _foot(posed: PosedTelescope, place: Array) -> Array:
    up, top = posed.platform_up, posed.platform(np.array([0.0, 0.0, PLATFORM_TOP_MM]))
    return place - ((place - top) @ up) * up


def _reach(body: str, target: str) -> float:
    return 4 * DOT_MM if code_of(body, target) else DOT_STICKER_MM


def _targets(posed: PosedTelescope) -> Iterator[Decal]:
    for k, (body, target) in enumerate(posed.names):
        code = code_of(body, target)
        pattern = Ring(DOT_MM, segments(12, code)) if code else Dot(DOT_MM, DOT_STICKER_MM)
        place, normal = posed.points[k], posed.normals[k]
        yield decal(f"{body}/{target}", pattern, place, normal, turn_rad=2.4 * k, reflector=True)


def _clutter(posed: PosedTelescope) -> Iterator[Decal]:
    """Screws and holes, a type plate, glints, and scraps of reflecting tape, some of them as round as a target."""
    top, up = PLATFORM_TOP_MM + 0.2, posed.platform_up
    for angle in np.arange(24) * 2 * np.pi / 24 + 0.06:
        place = np.array([252 * np.cos(angle), 252 * np.sin(angle), BASE_TOP_MM + 0.2])
        yield decal("screw", Washer(5.0, 2.6, rim=0.2), place, UP)
    for angle in np.arange(8) * 2 * np.pi / 8 + 0.2:
        place = posed.platform(np.array([56 * np.cos(angle), 56 * np.sin(angle), top]))
        yield decal("screw", Washer(3.5, 1.8, rim=0.22), place, up)
        glint = posed.platform(np.array([52 * np.cos(angle), 56 * np.sin(angle) + 2.0, top]))
        yield decal("glint", Glint(0.9, 1.2), glint, up, reflector=True)
    yield decal("type plate", words("TYPE 6-PUS  No. 46", 11.0), np.array([-128.0, 40.0, BASE_TOP_MM + 0.3]), UP, 1.9)
    yield decal("type plate", words("PLATFORM", 9.0), posed.platform(np.array([20.0, 70.0, top])), up, 0.5)
    scraps = ((180.0, 380.0), (-330.0, -60.0), (330.0, 120.0))
    for number, (x, y) in enumerate(scraps):
        yield decal("scrap", Dot(2.2 + 1.2 * number, 14.0), np.array([x, y, TABLE_MM + 0.5]), UP, reflector=True)
    # Two circles that touch: one spot in a photograph, and no target.
    for x in (-186.0, -179.2):
        yield decal("merged", Dot(3.5, 3.8), np.array([x, 341.0, TABLE_MM + 0.5]), UP, reflector=True)
