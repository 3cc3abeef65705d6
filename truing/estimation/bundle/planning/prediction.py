"""What a plan is good for: the covariance that the bundle adjustment of its photographs would have."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from truing.estimation.bundle.adjustment import adjust
from truing.estimation.bundle.bundle_covariance import BundleCovariance
from truing.estimation.bundle.determinable import determinable
from truing.estimation.bundle.network import Array, Index
from truing.estimation.bundle.planning.information import PlannedNetwork
from truing.estimation.bundle.planning.stations import Mask, Stations


@dataclass(frozen=True)
class Prediction:
    """Of each target: covariance (P, 3, 3) in m^2 in the free datum, and what would be left of it with a camera known
    beforehand and with bars of exactly known length (P, 3, 3), NaN where it is not determined; rays (P,), largest angle
    between two of them in rad (P,); the redundancy; the points that take part (p,), their covariance together (3 p, 3
    p)."""

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
        """The standard deviation (P,) in m along the direction in which each target is known least."""
        return largest_sigma(self.covariance)


def largest_sigma(covariance: Array) -> Array:
    """The standard deviation (P,) of covariances (P, 3, 3) along their longest axis; NaN where there is none."""
    known = np.isfinite(covariance).all(axis=(1, 2))
    found = np.full(len(covariance), np.nan)
    found[known] = np.sqrt(np.linalg.eigvalsh(covariance[known])[:, -1])
    return found


def predict(planned: PlannedNetwork, stations: Stations, seen: Mask) -> Prediction | None:
    """Predict from the rays of stations (K) to what they see (K, P); None where they make no network."""
    network, state = planned.with_stations(stations, seen)
    part = determinable(network)
    if not part.points.any() or part.images.sum() < 2:
        return None
    try:
        found = adjust(network, state, "free", used=part.rays, max_iterations=1)
        covariance = found.covariance
    except (ValueError, np.linalg.LinAlgError):
        return None
    count = len(planned.layout.points)
    points = covariance.point_numbers(0)
    together = covariance.points(0)
    rays = np.bincount(network.rays.point[part.rays], minlength=count)
    return Prediction(
        _blocks(together, points, count),
        _blocks(_with_only(covariance, "bar", known=False), points, count),
        _blocks(_with_only(covariance, "bar", known=True), points, count),
        rays,
        _angles(stations, planned.layout.points, seen),
        found.redundancy,
        points,
        together,
    )


def _with_only(covariance: BundleCovariance, kind: str, *, known: bool) -> Array:
    """The covariance (3 p, 3 p) of points where common unknowns of one kind are known, or those of all others are."""
    left = [place for place, (name, _) in enumerate(covariance.names) if (name == kind) != known]
    information = np.linalg.inv(covariance.common)[np.ix_(left, left)]
    by_common = covariance.sensitivities(0)[:, left]
    return covariance.points_given_common(0) + by_common @ np.linalg.inv(information) @ by_common.T


def _blocks(together: Array, points: Index, count: int) -> Array:
    found = np.full((count, 3, 3), np.nan)
    each = np.arange(len(points))
    found[points] = together.reshape(len(points), 3, len(points), 3)[each, :, each, :]
    return found


def _angles(stations: Stations, points: Array, seen: Mask) -> Array:
    """The largest angle (P,) in rad between two rays to a target, up to a right angle; 0 with less than two."""
    way = points - stations.centre[:, None]
    way = np.where(seen[..., None], way / np.linalg.norm(way, axis=-1, keepdims=True), 0.0)
    sine = np.linalg.norm(np.cross(way[:, None], way[None]), axis=-1)
    return np.asarray(np.arcsin(np.clip(sine.max(axis=(0, 1)), 0.0, 1.0)))


def body_motion(together: Array, points: Array, one: Index, other: Index | None, about: Array) -> Array:
    """The covariance (6, 6) of the motion of a body's points (by place among those of ``together``) about a place
    (3,): of its translation in m, then of its rotation in rad, seen from another body's where one is given."""
    rows = np.zeros((6, len(together)))
    for sign, body in ((1.0, one), (-1.0, other)):
        if body is not None:
            rows[:, (3 * body[:, None] + np.arange(3)).ravel()] += sign * np.linalg.pinv(_rigid(points[body] - about))
    return rows @ together @ rows.T


def _rigid(arm: Array) -> Array:
    """How points at arm (n, 3) follow a translation and a rotation vector (3 n, 6)."""
    turned = -np.cross(arm[:, None], np.eye(3)).transpose(0, 2, 1)
    return np.concatenate([np.broadcast_to(np.eye(3), (len(arm), 3, 3)), turned], axis=2).reshape(-1, 6)
