"""Where a camera may stand, how it may be held, and which targets it would see from there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truing.estimation.bundle.camera import Camera
from truing.estimation.bundle.network import Array
from truing.estimation.bundle.projection import image_coordinates

Mask = NDArray[np.bool_]

_GOLDEN = np.pi * (3.0 - np.sqrt(5.0))
_BEYOND = 1.2  # half formats from the middle, beyond which the polynomials of the distortion mean nothing
_MARGIN = 0.01  # of the format, that targets keep from its edge


@dataclass(frozen=True)
class Stations:
    """Stations: R (K, 3, 3) turns camera axes into those of the object, centre (K, 3) in m, roll_rad (K,) about the
    view."""

    R: Array
    centre: Array
    roll_rad: Array

    @property
    def count(self) -> int:
        """How many."""
        return len(self.centre)

    def only(self, chosen: NDArray[np.int64]) -> Stations:
        """Some of them, in this order."""
        return Stations(self.R[chosen], self.centre[chosen], self.roll_rad[chosen])


@dataclass(frozen=True)
class Layout:
    """The object: its targets (P, 3) in m, the unit normals (P, 3) of those that have a side, NaN of others, and
    diameters (P,) in m, NaN where they do not matter."""

    points: Array
    normals: Array
    diameters: Array

    @property
    def middle(self) -> Array:
        """The centre (3,) of the smallest box around the targets."""
        return 0.5 * (self.points.min(axis=0) + self.points.max(axis=0))

    @property
    def radius(self) -> float:
        """Of the sphere about the middle that holds all targets, m."""
        return float(np.max(np.linalg.norm(self.points - self.middle, axis=1)))


@dataclass(frozen=True)
class Limits:
    """What a camera sees: distances in m between which it is sharp, the largest angle between a ray and a target's
    normal in rad, the smallest image of a target in px (the minor axis)."""

    nearest: float
    farthest: float
    incidence: float
    least_px: float


def filling_distance(camera: Camera, interior: Array, radius: float) -> float:
    """The distance in m from which a sphere of this radius fills the shorter side of the format."""
    half = 0.5 * min(camera.width_px, camera.height_px) * (1.0 - 2.0 * _MARGIN)
    return radius * float(np.hypot(1.0, interior[0] / half))


def shells(middle: Array, distances: Array, directions: int, elevations: tuple[float, float], rolls: Array) -> Stations:
    """Stations that look at the middle from shells about it: evenly spread directions (as of a spiral over the
    sphere) whose elevation above the xy-plane lies within bounds in rad, from each distance in m, held with each roll
    in rad."""
    low, high = np.sin(elevations)
    z = low + (np.arange(directions) + 0.5) / directions * (high - low)
    turn = _GOLDEN * np.arange(directions)
    flat = np.sqrt(1.0 - z**2)
    away = np.stack([flat * np.cos(turn), flat * np.sin(turn), z], axis=-1)
    upright = _looking(-away)
    c, s = np.cos(rolls), np.sin(rolls)
    zero, one = np.zeros_like(c), np.ones_like(c)
    about_view = np.stack([c, -s, zero, s, c, zero, zero, zero, one], axis=-1).reshape(-1, 3, 3)
    shape = (len(away), len(distances), len(rolls))
    R = np.broadcast_to((upright[:, None] @ about_view)[:, None], (*shape, 3, 3)).reshape(-1, 3, 3)
    places = middle + distances[:, None] * away[:, None]
    centre = np.broadcast_to(places[:, :, None], (*shape, 3)).reshape(-1, 3)
    return Stations(R, centre, np.broadcast_to(rolls, shape).reshape(-1))


def _looking(view: Array) -> Array:
    """Camera axes (K, 3, 3) as columns: z along unit vectors ``view`` (K, 3), x level, y downwards."""
    down = np.array([0.0, 0.0, -1.0])
    level = np.cross(down, view)
    length = np.linalg.norm(level, axis=1, keepdims=True)
    level = np.where(length > 1e-9, level / np.where(length > 0.0, length, 1.0), [1.0, 0.0, 0.0])
    return np.stack([level, np.cross(view, level), view], axis=-1)


def sees(camera: Camera, interior: Array, stations: Stations, layout: Layout, limits: Limits) -> Mask:
    """Which targets (K, P) each station sees: within the format, sharp, not too oblique, and large enough.

    Nothing is known of what stands in between.
    """
    arm = layout.points - stations.centre[:, None]
    own = np.einsum("kji,kpj->kpi", stations.R, arm)
    distance = np.linalg.norm(arm, axis=-1)
    depth = np.where(own[..., 2] > 0.0, own[..., 2], np.nan)
    size = np.array([camera.width_px, camera.height_px], dtype=float)
    ideal = interior[0] * own[..., :2] / depth[..., None]
    xy = image_coordinates(
        np.broadcast_to(interior, (depth.size, 10)),
        np.broadcast_to(camera.centre_px, (depth.size, 2)),
        np.full(depth.size, camera.balancing_radius_px),
        np.concatenate([own[..., :2], depth[..., None]], axis=-1).reshape(-1, 3),
    ).reshape(*depth.shape, 2)
    slant = np.einsum("kpi,pi->kp", -arm, layout.normals) / distance
    foreshortened = np.where(np.isnan(slant), 1.0, slant)
    image_px = interior[0] * layout.diameters * foreshortened / distance
    with np.errstate(invalid="ignore"):
        inside = np.all(np.abs(xy - camera.centre_px) < 0.5 * size * (1.0 - 2.0 * _MARGIN), axis=-1)
        inside &= np.all(np.abs(ideal) < _BEYOND * 0.5 * size, axis=-1)
        sharp = (distance >= limits.nearest) & (distance <= limits.farthest)
        faced = np.isnan(slant) | (slant >= np.cos(limits.incidence))
        large = np.isnan(image_px) | (image_px >= limits.least_px)
    return np.asarray(inside & sharp & faced & large)
