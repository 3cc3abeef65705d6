"""Camera stations: candidates, visible targets, information, and the predicted precision of an adjustment.

A station is a place with a viewing direction and a roll. Its information on targets and camera has the station's own
orientation eliminated. A plan is assessed by the covariance that the bundle adjustment of its photographs would have.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from truing.arrays import Array, Index, Mask
from truing.estimation.bundle.adjustment import adjust
from truing.estimation.bundle.bundle_covariance import BundleCovariance
from truing.estimation.bundle.camera import PARAMETERS, Camera, image_coordinates
from truing.estimation.bundle.determinable import determinable
from truing.estimation.bundle.network import Bars, KnownPoints, Network, NetworkState, Rays, linearise, project
from truing.estimation.rotation import rigid_motions

_GOLDEN = np.pi * (3.0 - np.sqrt(5.0))
_VALID_HALF_FORMATS = 1.2  # half formats from the centre, beyond which the distortion polynomials are not valid
_MARGIN = 0.01  # distance of targets from the edge, relative to the format
_FEWEST = 4  # targets that a useful station sees at least


@dataclass(frozen=True)
class Stations:
    """Stations: R (K, 3, 3) from camera axes to those of the object, centre (K, 3) in m, roll_rad (K,) about the
    view."""

    R: Array
    centre: Array
    roll_rad: Array

    @property
    def count(self) -> int:
        """Number of stations."""
        return len(self.centre)

    def subset(self, chosen: NDArray[np.int64]) -> Stations:
        """Return some of the stations, in the given order."""
        return Stations(self.R[chosen], self.centre[chosen], self.roll_rad[chosen])


@dataclass(frozen=True)
class PlannedObject:
    """Object: targets (P, 3) in m, unit normals (P, 3), NaN for targets visible from all sides, and diameters (P,) in
    m, NaN if irrelevant."""

    points: Array
    normals: Array
    diameters: Array

    @property
    def middle(self) -> Array:
        """Centre (3,) of the smallest box around the targets."""
        return 0.5 * (self.points.min(axis=0) + self.points.max(axis=0))

    @property
    def radius(self) -> float:
        """Radius in m of the sphere about the middle that holds all targets."""
        return float(np.max(np.linalg.norm(self.points - self.middle, axis=1)))


@dataclass(frozen=True)
class CameraLimits:
    """Limits of visibility: range of distances in m in focus, largest angle between a ray and a target's normal in rad;
    smallest image of a target in px (minor axis)."""

    nearest: float
    farthest: float
    incidence: float
    least_px: float


def filling_distance(camera: Camera, interior: Array, radius: float) -> float:
    """Return the distance in m from which a sphere of this radius fills the shorter side of the format."""
    half = 0.5 * min(camera.width_px, camera.height_px) * (1.0 - 2.0 * _MARGIN)
    return radius * float(np.hypot(1.0, interior[0] / half))


def shells(middle: Array, distances: Array, directions: int, elevations: tuple[float, float], rolls: Array) -> Stations:
    """Return stations on shells around the middle, looking at it.

    Directions are spread evenly (spiral on the sphere), elevations above the xy-plane within bounds, rad. They are
    repeated for each distance, m, and each roll, rad.
    """
    low, high = np.sin(elevations)
    z = low + (np.arange(directions) + 0.5) / directions * (high - low)
    azimuth = _GOLDEN * np.arange(directions)
    cosine = np.sqrt(1.0 - z**2)
    outward = np.stack([cosine * np.cos(azimuth), cosine * np.sin(azimuth), z], axis=-1)
    camera_rotation = _camera_axes(-outward)
    c, s = np.cos(rolls), np.sin(rolls)
    zero, ones = np.zeros_like(c), np.ones_like(c)
    about_view = np.stack([c, -s, zero, s, c, zero, zero, zero, ones], axis=-1).reshape(-1, 3, 3)
    shape = (len(outward), len(distances), len(rolls))
    R = np.broadcast_to((camera_rotation[:, None] @ about_view)[:, None], (*shape, 3, 3)).reshape(-1, 3, 3)
    positions = middle + distances[:, None] * outward[:, None]
    centre = np.broadcast_to(positions[:, :, None], (*shape, 3)).reshape(-1, 3)
    return Stations(R, centre, np.broadcast_to(rolls, shape).reshape(-1))


def _camera_axes(view: Array) -> Array:
    """Return camera axes (K, 3, 3) as columns: z along unit vectors ``view`` (K, 3), x level, y downwards."""
    down = np.array([0.0, 0.0, -1.0])
    level = np.cross(down, view)
    length = np.linalg.norm(level, axis=1, keepdims=True)
    level = np.where(length > 1e-9, level / np.where(length > 0.0, length, 1.0), [1.0, 0.0, 0.0])
    return np.stack([level, np.cross(view, level), view], axis=-1)


def visible(camera: Camera, interior: Array, stations: Stations, layout: PlannedObject, limits: CameraLimits) -> Mask:
    """Return the targets (K, P) that each station sees: within the format, in focus, not too oblique, and large enough.

    Obstacles between station and target are not considered.
    """
    ray_vector = layout.points - stations.centre[:, None]
    direction = np.einsum("kji,kpj->kpi", stations.R, ray_vector)
    distance = np.linalg.norm(ray_vector, axis=-1)
    depth = np.where(direction[..., 2] > 0.0, direction[..., 2], np.nan)
    size = np.array([camera.width_px, camera.height_px], dtype=float)
    ideal = interior[0] * direction[..., :2] / depth[..., None]
    xy = image_coordinates(
        np.broadcast_to(interior, (depth.size, 10)),
        np.broadcast_to(camera.centre_px, (depth.size, 2)),
        np.full(depth.size, camera.balancing_radius_px),
        np.concatenate([direction[..., :2], depth[..., None]], axis=-1).reshape(-1, 3),
    ).reshape(*depth.shape, 2)
    incidence_cosine = np.einsum("kpi,pi->kp", -ray_vector, layout.normals) / distance
    foreshortened = np.where(np.isnan(incidence_cosine), 1.0, incidence_cosine)
    image_px = interior[0] * layout.diameters * foreshortened / distance
    with np.errstate(invalid="ignore"):
        inside = np.all(np.abs(xy - camera.centre_px) < 0.5 * size * (1.0 - 2.0 * _MARGIN), axis=-1)
        inside &= np.all(np.abs(ideal) < _VALID_HALF_FORMATS * 0.5 * size, axis=-1)
        in_focus = (distance >= limits.nearest) & (distance <= limits.farthest)
        is_facing = np.isnan(incidence_cosine) | (incidence_cosine >= np.cos(limits.incidence))
        is_large = np.isnan(image_px) | (image_px >= limits.least_px)
    return np.asarray(inside & in_focus & is_facing & is_large)


@dataclass(frozen=True)
class PlannedNetwork:
    """Planned network: camera, its interior orientation (10,), sigma_px of an image coordinate, bars between targets,
    and targets."""

    camera: Camera
    interior: Array
    sigma_px: float
    layout: PlannedObject
    bars: Bars

    def with_stations(self, stations: Stations, visibility: Mask) -> tuple[Network, NetworkState]:
        """Return the network of stations (K) that see targets (K, P), and its state; rays are without error."""
        image, point = (index.astype(np.int64) for index in np.nonzero(visibility))
        rays = Rays(
            image,
            point,
            np.zeros((len(image), 2)),
            np.broadcast_to(self.sigma_px**2 * np.eye(2), (len(image), 2, 2)),
            np.zeros(len(image), np.int64),
        )
        camera = np.zeros(stations.count, np.int64)
        poses = np.zeros(len(self.layout.points), np.int64)
        network = Network((self.camera,), camera, camera, poses, rays, self.bars, KnownPoints.none())
        state = NetworkState(self.interior[None], stations.R, stations.centre, self.layout.points, self.bars.length_m)
        return replace(network, rays=replace(rays, xy_px=project(network, state, image, point))), state


def useful_stations(visibility: Mask) -> Index:
    """Return the stations that see enough targets to be worth a photograph."""
    return np.flatnonzero(visibility.sum(axis=1) >= _FEWEST)


def station_information(planned: PlannedNetwork, stations: Stations, visibility: Mask) -> Array:
    """Return the information (K, n, n) of each station on points (3 P) and free elements of the camera; in 1/m^2 and
    inverse squared units of these elements."""
    network, state = planned.with_stations(stations, visibility)
    rays = network.rays
    linearised = linearise(network, state, rays.image, rays.point)
    free = [PARAMETERS.index(name) for name in planned.camera.free]
    count, points = stations.count, len(planned.layout.points)
    # every station has a row for every target; rows of unseen targets are zero
    jacobian = np.zeros((count, points, 2, 6 + 3 + len(free)))
    jacobian[rays.image, rays.point] = np.concatenate(
        [linearised.by_image, linearised.by_point, linearised.by_interior[..., free]], axis=-1
    )
    jacobian = jacobian.reshape(count, 2 * points, -1) / planned.sigma_px
    by_image, by_point, by_camera = jacobian[..., :6], jacobian[..., 6:9], jacobian[..., 9:]
    derivative = np.einsum("kpai,pq->kpaqi", by_point.reshape(count, points, 2, 3), np.eye(points))
    by_others = np.concatenate([derivative.reshape(count, 2 * points, 3 * points), by_camera], axis=-1)
    scale = np.linalg.norm(by_image, axis=1, keepdims=True)
    basis, _ = np.linalg.qr(by_image / np.where(scale > 0.0, scale, 1.0))
    reduced = by_others - basis @ (np.swapaxes(basis, 1, 2) @ by_others)
    return np.swapaxes(reduced, 1, 2) @ reduced


def weak_prior(planned: PlannedNetwork) -> Array:
    """Return weak prior information (n, n): targets to the size of the object, camera to a tenth of its format, and
    bars."""
    points = planned.layout.points
    size = 2.0 * planned.layout.radius
    half = 0.5 * max(planned.camera.width_px, planned.camera.height_px)
    powers = {"c": 0, "x0": 0, "y0": 0, "A1": 3, "A2": 5, "A3": 7, "B1": 2, "B2": 2, "C1": 1, "C2": 1}
    camera_weights = [half ** powers[name] / (0.1 * half) for name in planned.camera.free]
    prior = np.diag(np.concatenate([np.full(points.size, 1.0 / size), camera_weights]) ** 2)
    bars = planned.bars
    bar_vector = points[bars.second] - points[bars.first]
    sigma = np.sqrt(bars.sigma_m[bars.bar] ** 2 + bars.repeat_sigma_m**2)
    design = np.zeros((len(bars.bar), len(prior)))
    direction = bar_vector / np.linalg.norm(bar_vector, axis=1, keepdims=True) / np.maximum(sigma, 1e-9)[:, None]
    for axis in range(3):
        np.add.at(design, (np.arange(len(design)), 3 * bars.second + axis), direction[:, axis])
        np.add.at(design, (np.arange(len(design)), 3 * bars.first + axis), -direction[:, axis])
    return prior + design.T @ design


@dataclass(frozen=True)
class PredictedPrecision:
    """Predicted precision of the targets.

    covariance (P, 3, 3) in m^2 in the free datum; the same (P, 3, 3) with a known camera and with exact bar lengths,
    NaN if undetermined; rays (P,), largest angle between two rays in rad (P,); redundancy; determined points (p,) and
    their joint covariance (3 p, 3 p).
    """

    covariance: Array
    with_known_camera: Array
    with_known_scale: Array
    rays: Index
    angle: Array
    redundancy: int
    points: Index
    together: Array

    @property
    def sigma(self) -> Array:
        """Standard deviation (P,) in m along the least determined direction of each target."""
        return largest_sigma(self.covariance)


def largest_sigma(covariance: Array) -> Array:
    """Return the standard deviation (P,) of covariances (P, 3, 3) along their longest axis; NaN without a
    covariance."""
    known = np.isfinite(covariance).all(axis=(1, 2))
    sigma = np.full(len(covariance), np.nan)
    sigma[known] = np.sqrt(np.linalg.eigvalsh(covariance[known])[:, -1])
    return sigma


def predict(planned: PlannedNetwork, stations: Stations, visibility: Mask) -> PredictedPrecision | None:
    """Return the predicted precision of stations (K) that see targets (K, P); None if they form no network."""
    network, state = planned.with_stations(stations, visibility)
    adjustable = determinable(network)
    if not adjustable.points.any() or adjustable.images.sum() < 2:
        return None
    try:
        adjustment = adjust(network, state, "free", used=adjustable.rays, max_iterations=1)
        covariance = adjustment.covariance
    except (ValueError, np.linalg.LinAlgError):
        return None
    count = len(planned.layout.points)
    points = covariance.point_numbers(0)
    joint_covariance = covariance.points(0)
    rays = np.bincount(network.rays.point[adjustable.rays], minlength=count)
    return PredictedPrecision(
        _blocks(joint_covariance, points, count),
        _blocks(_with_only(covariance, "bar", known=False), points, count),
        _blocks(_with_only(covariance, "bar", known=True), points, count),
        rays,
        _angles(stations, planned.layout.points, visibility),
        adjustment.redundancy,
        points,
        joint_covariance,
    )


def _with_only(covariance: BundleCovariance, kind: str, *, known: bool) -> Array:
    """Return the covariance (3 p, 3 p) of points if common unknowns of one kind are known, or those of all other
    kinds."""
    columns = [column for column, (name, _) in enumerate(covariance.names) if (name == kind) != known]
    information = np.linalg.inv(covariance.common)[np.ix_(columns, columns)]
    by_common = covariance.sensitivities(0)[:, columns]
    return covariance.points_given_common(0) + by_common @ np.linalg.inv(information) @ by_common.T


def _blocks(joint_covariance: Array, points: Index, count: int) -> Array:
    blocks = np.full((count, 3, 3), np.nan)
    diagonal = np.arange(len(points))
    blocks[points] = joint_covariance.reshape(len(points), 3, len(points), 3)[diagonal, :, diagonal, :]
    return blocks


def _angles(stations: Stations, points: Array, visibility: Mask) -> Array:
    """Return the largest angle (P,) in rad between two rays to a target, up to a right angle; 0 with fewer than two."""
    direction = points - stations.centre[:, None]
    direction = np.where(visibility[..., None], direction / np.linalg.norm(direction, axis=-1, keepdims=True), 0.0)
    sine = np.linalg.norm(np.cross(direction[:, None], direction[None]), axis=-1)
    return np.asarray(np.arcsin(np.clip(sine.max(axis=(0, 1)), 0.0, 1.0)))


def body_motion(joint_covariance: Array, points: Array, first: Index, reference: Index | None, origin: Array) -> Array:
    """Return the covariance (6, 6) of the motion of a body: translation of the `origin` (3,) in m, then rotation
    in rad.

    first, reference: indices of the bodies' points among those of ``joint_covariance``; with `reference` the motion is
    relative to that body.
    """
    design = np.zeros((6, len(joint_covariance)))
    for sign, body in ((1.0, first), (-1.0, reference)):
        if body is not None:
            motion = rigid_motions(points[body] - origin).reshape(-1, 6)
            design[:, (3 * body[:, None] + np.arange(3)).ravel()] += sign * np.linalg.pinv(motion)
    return design @ joint_covariance @ design.T
