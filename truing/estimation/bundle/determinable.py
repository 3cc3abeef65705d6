"""Rays, points and images of a network that the adjustment can determine."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from truing.arrays import Array, Index, Mask
from truing.estimation.bundle.network import Network

RAYS_OF_A_POINT = 2
RAYS_OF_AN_IMAGE = 3


class UndeterminedNetworkError(ValueError):
    """Some points or images have too few rays, or the network has free directions; the message lists them.

    images and points: numbers of those that free directions move; elements: (camera, name) of undetermined interior
    elements.
    """

    def __init__(
        self,
        message: str,
        *,
        images: Iterable[int] = (),
        points: Iterable[int] = (),
        elements: Iterable[tuple[str, str]] = (),
    ) -> None:
        super().__init__(message)
        self.images, self.points, self.elements = tuple(images), tuple(points), tuple(elements)


@dataclass(frozen=True)
class Determinable:
    """Masks of the adjustable rays (N,), points (P,), images (I,)."""

    rays: Mask
    points: Mask
    images: Mask


def determinable(network: Network, used: Mask | None = None, *, known: bool = False) -> Determinable:
    """Return the largest part of a network in which every point has two rays and every image three within this part.

    used (N,): rays that may be used, by default all. known: known points need one ray only. Rays of one point in one
    image count once. Counting cannot detect images that share too few points with the rest; `adjust` detects that in
    its normal equations.
    """
    rays = network.rays
    active = np.ones(rays.count, bool) if used is None else np.asarray(used, bool).copy()
    active &= network.image_pose[rays.image] == network.point_pose[rays.point]
    required = np.full(len(network.point_pose), RAYS_OF_A_POINT)
    if known:
        required[network.known.point] = 1
    while True:
        points, images = ray_counts(network, active)
        remaining = active & (points >= required)[rays.point] & (images >= RAYS_OF_AN_IMAGE)[rays.image]
        if np.array_equal(remaining, active):
            return Determinable(active, points >= required, images >= RAYS_OF_AN_IMAGE)
        active = remaining


def ray_counts(network: Network, used: Mask) -> tuple[Index, Index]:
    """Return the number of images that see each point (P,) and of points that each image (I,) sees, from the used
    rays."""
    rays = network.rays
    observed = np.zeros((len(network.image_pose), len(network.point_pose)), bool)
    observed[rays.image[used], rays.point[used]] = True
    return observed.sum(0), observed.sum(1)


def check_determined(network: Network, used: Mask, known: bool) -> None:
    """Raise `UndeterminedNetworkError` if points or images have rays, but too few.

    The error also lists rays and distances that join different poses, and covariances that are not positive definite.
    """
    rays, faults = network.rays, []
    mismatched_rays = np.flatnonzero(used & (network.image_pose[rays.image] != network.point_pose[rays.point]))
    if len(mismatched_rays):
        faults.append(f"rays {_listed(mismatched_rays)} join an image and a point of different poses")
    bars = network.bars
    mismatched_bars = np.flatnonzero(network.point_pose[bars.first] != network.point_pose[bars.second])
    if len(mismatched_bars):
        faults.append(f"distances {_listed(mismatched_bars)} join points of different poses")
    indefinite = np.flatnonzero(used & ~_definite(rays.cov_px2))
    if len(indefinite):
        faults.append(f"rays {_listed(indefinite)} have a covariance that is not positive definite")
    indefinite = np.flatnonzero(~_definite(network.known.cov_m2)) if known else indefinite[:0]
    if len(indefinite):
        faults.append(f"known points {_listed(indefinite)} have a covariance that is not positive definite")
    points, images = ray_counts(network, used)
    required = np.full(len(points), RAYS_OF_A_POINT)
    if known:
        required[network.known.point] = 1
    underdetermined = np.flatnonzero((points > 0) & (points < required))
    if len(underdetermined):
        faults.append(f"points {_listed(underdetermined)} have one ray, expected at least {RAYS_OF_A_POINT}")
    underdetermined = np.flatnonzero((images > 0) & (images < RAYS_OF_AN_IMAGE))
    if len(underdetermined):
        faults.append(f"images {_listed(underdetermined)} have fewer than {RAYS_OF_AN_IMAGE} rays")
    if not used.any():
        faults.append("found no ray, expected a network")
    if faults:
        raise UndeterminedNetworkError("; ".join(faults))


def _definite(covariance: Array) -> Mask:
    """Return the mask (n,) of positive definite matrices (n, 2, 2) or (n, 3, 3): leading minors above 0."""
    c = covariance
    minors = [c[:, 0, 0], c[:, 0, 0] * c[:, 1, 1] - c[:, 0, 1] * c[:, 1, 0]]
    if c.shape[1] > 2:
        minors.append(np.linalg.det(c))
    return np.all(np.array(minors) > 0, axis=0)


def _listed(numbers: Index, max_shown: int = 20) -> str:
    """Return numbers as text, shortened after `max_shown` with the count of the rest."""
    text = ", ".join(map(str, numbers[:max_shown]))
    return f"{text} and {len(numbers) - max_shown} more" if len(numbers) > max_shown else text
