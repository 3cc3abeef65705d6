"""Which rays, points and images of a network can take part: the others determine nothing, or are not determined."""

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

    images and points, by number, that free directions move, and elements (camera, name) of interiors left open.
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
    """What takes part: rays (N,), points (P,), images (I,), True where it does."""

    rays: Mask
    points: Mask
    images: Mask


def determinable(network: Network, used: Mask | None = None, *, known: bool = False) -> Determinable:
    """Return the largest part of a network in which every point has two rays and every image three, counted to what
    takes part itself; used (N,) are the rays that may, all where not given.

    known: known points need one ray only. Rays of one point in one image count once. Where images share too few points
    with the rest, counts do not tell: `adjust` finds that by its normal equations.
    """
    rays = network.rays
    on = np.ones(rays.count, bool) if used is None else np.asarray(used, bool).copy()
    on &= network.image_pose[rays.image] == network.point_pose[rays.point]
    needed = np.full(len(network.point_pose), RAYS_OF_A_POINT)
    if known:
        needed[network.known.point] = 1
    while True:
        points, images = ray_counts(network, on)
        stays = on & (points >= needed)[rays.point] & (images >= RAYS_OF_AN_IMAGE)[rays.image]
        if np.array_equal(stays, on):
            return Determinable(on, points >= needed, images >= RAYS_OF_AN_IMAGE)
        on = stays


def ray_counts(network: Network, used: Mask) -> tuple[Index, Index]:
    """Return in how many images each point (P,) is seen, and how many points each image (I,) sees, by the rays used."""
    rays = network.rays
    seen = np.zeros((len(network.image_pose), len(network.point_pose)), bool)
    seen[rays.image[used], rays.point[used]] = True
    return seen.sum(0), seen.sum(1)


def check_determined(network: Network, used: Mask, known: bool) -> None:
    """Raise `UndeterminedNetworkError` that lists every point and image with some rays, but too few of them, every ray
    and distance that joins what is of different poses, and every covariance that is none."""
    rays, faults = network.rays, []
    astray = np.flatnonzero(used & (network.image_pose[rays.image] != network.point_pose[rays.point]))
    if len(astray):
        faults.append(f"rays {_listed(astray)} join an image and a point of different poses")
    bars = network.bars
    apart = np.flatnonzero(network.point_pose[bars.first] != network.point_pose[bars.second])
    if len(apart):
        faults.append(f"distances {_listed(apart)} join points of different poses")
    bad = np.flatnonzero(used & ~_definite(rays.cov_px2))
    if len(bad):
        faults.append(f"rays {_listed(bad)} have a covariance that is not positive definite")
    bad = np.flatnonzero(~_definite(network.known.cov_m2)) if known else bad[:0]
    if len(bad):
        faults.append(f"known points {_listed(bad)} have a covariance that is not positive definite")
    points, images = ray_counts(network, used)
    needed = np.full(len(points), RAYS_OF_A_POINT)
    if known:
        needed[network.known.point] = 1
    few = np.flatnonzero((points > 0) & (points < needed))
    if len(few):
        faults.append(f"points {_listed(few)} have one ray, expected at least {RAYS_OF_A_POINT}")
    few = np.flatnonzero((images > 0) & (images < RAYS_OF_AN_IMAGE))
    if len(few):
        faults.append(f"images {_listed(few)} have fewer than {RAYS_OF_AN_IMAGE} rays")
    if not used.any():
        faults.append("found no ray, expected a network")
    if faults:
        raise UndeterminedNetworkError("; ".join(faults))


def _definite(covariance: Array) -> Mask:
    """Mask (n,) of symmetric matrices (n, 2, 2) or (n, 3, 3) that are positive definite: leading minors above 0."""
    c = covariance
    minors = [c[:, 0, 0], c[:, 0, 0] * c[:, 1, 1] - c[:, 0, 1] * c[:, 1, 0]]
    if c.shape[1] > 2:
        minors.append(np.linalg.det(c))
    return np.all(np.array(minors) > 0, axis=0)


def _listed(numbers: Index, most: int = 20) -> str:
    """Return numbers as text, with how many are left out."""
    text = ", ".join(map(str, numbers[:most]))
    return f"{text} and {len(numbers) - most} more" if len(numbers) > most else text
