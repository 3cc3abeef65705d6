"""Did a camera stay what it was from pose to pose: principal distance and principal point common, or one set per pose.

Both are adjusted with the distortion held; the rise of the weighted sum of squares from one set per pose to a common
one is tested by F. What each pose's camera deviates from the common one comes with its covariance, the difference of
both covariances (the common estimate is the efficient one: Hausman 1978).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from truing.estimation.bundle.adjustment import Adjustment, adjust
from truing.estimation.bundle.camera import PARAMETERS, Camera
from truing.estimation.bundle.datum import Datum
from truing.estimation.bundle.determinable import UndeterminedNetworkError, determinable
from truing.estimation.bundle.intersection import Mask
from truing.estimation.bundle.network import Array, Index, Network, State
from truing.estimation.bundle.network_statistics import holm

WATCHED = ("c", "x0", "y0")
_FEWEST_IMAGES = 3  # of a camera in a pose, for a set of its own


@dataclass(frozen=True)
class CameraStability:
    """Per camera and pose with enough images: camera (G,) and pose (G,) by number, images (G,), deviation_px (G, 3) of
    c, x0, y0 from the common values with covariance_px2 (G, 3, 3), chi2 (G,) of it, its p_value (G,) adjusted for their
    number (Holm). Of all: F with its degrees of freedom and its overall_p_value, NaN where there was nothing to
    compare; left_out says why a camera has no set of its own in a pose."""

    camera: Index
    pose: Index
    images: Index
    deviation_px: Array
    covariance_px2: Array
    chi2: Array
    p_value: Array
    F: float
    freedom: tuple[int, int]
    overall_p_value: float
    left_out: tuple[str, ...]


def camera_stability(
    network: Network, state: State, datum: Datum, used: Mask, variance_factor: Array | None = None
) -> CameraStability:
    """Return whether the cameras of an adjusted network were the same in all poses.

    used (N,) rays take part, their covariances with variance_factor (N,). Elements that a camera does not have free are
    not watched.
    """
    used = determinable(network, used, known=datum == "known").rays
    pairs, count, left_out = _sets(network, used)
    if not len(pairs):
        return _nothing((*left_out, "no camera has enough images in two poses"))
    watched = replace(network, cameras=tuple(_watched(camera) for camera in network.cameras))
    split, split_state = _one_set_per_pose(watched, state, pairs)
    try:
        common = adjust(watched, state, datum, used=used, variance_factor=variance_factor)
        apart = adjust(split, split_state, datum, used=used, variance_factor=variance_factor)
        own = len(network.cameras) + np.arange(len(pairs))
        difference = _interior_covariance(apart, own) - _interior_covariance(common, pairs[:, 0])
    except (UndeterminedNetworkError, np.linalg.LinAlgError) as error:
        return _nothing((*left_out, f"one set per pose is not determined: {error}"))
    places = [PARAMETERS.index(name) for name in WATCHED]
    deviation = apart.state.interior[own][:, places] - common.state.interior[pairs[:, 0]][:, places]
    return _tested(pairs, count, deviation, difference, common, apart, left_out)


def _watched(camera: Camera) -> Camera:
    return replace(camera, free=tuple(name for name in WATCHED if name in camera.free))


def _sets(network: Network, used: Mask) -> tuple[Index, Index, tuple[str, ...]]:
    """Return the pairs (G, 2) of camera and pose that have a set of their own, the images (G,) of each, and which have
    none."""
    images = np.unique(network.rays.image[used])
    both = np.stack([network.image_camera[images], network.image_pose[images]], axis=1)
    pairs, count = np.unique(both, axis=0, return_counts=True)
    enough = count >= _FEWEST_IMAGES
    left_out = tuple(
        f"camera {network.cameras[k].name} in pose {p}: {n} images, at least {_FEWEST_IMAGES} are needed"
        for (k, p), n in zip(pairs[~enough], count[~enough], strict=True)
    )
    pairs, count = pairs[enough], count[enough]
    several = np.bincount(pairs[:, 0], minlength=len(network.cameras))[pairs[:, 0]] > 1
    return pairs[several], count[several], left_out


def _one_set_per_pose(network: Network, state: State, pairs: Index) -> tuple[Network, State]:
    """Return the network with a camera for each pair after its own cameras; those of images in no pair stay."""
    extra = tuple(replace(network.cameras[k], name=f"{network.cameras[k].name} in pose {p}") for k, p in pairs)
    image_camera = network.image_camera.copy()
    for number, (k, p) in enumerate(pairs):
        image_camera[(network.image_camera == k) & (network.image_pose == p)] = len(network.cameras) + number
    interior = np.concatenate([state.interior, state.interior[pairs[:, 0]]])
    split = replace(network, cameras=network.cameras + extra, image_camera=image_camera)
    return split, replace(state, interior=interior)


def _interior_covariance(adjusted: Adjustment, cameras: Index) -> Array:
    """Return the covariance (G, 3, 3) of c, x0, y0 of some cameras for sigma0 = 1, 0 for what is not free."""
    covariance = adjusted.covariance
    place = {name: number for number, name in enumerate(covariance.names)}
    found = np.zeros((len(cameras), 3, 3))
    for number, k in enumerate(cameras):
        keys = [(adjusted.network.cameras[k].name, name) for name in WATCHED]
        free = [i for i, key in enumerate(keys) if key in place]
        rows = [place[keys[i]] for i in free]
        found[number][np.ix_(free, free)] = covariance.common[np.ix_(rows, rows)]
    return found


def _tested(
    pairs: Index,
    count: Index,
    deviation: Array,
    difference: Array,
    common: Adjustment,
    apart: Adjustment,
    left_out: tuple[str, ...],
) -> CameraStability:
    from scipy.special import chdtrc, fdtrc

    covariance = difference * apart.variance_factor
    scale = np.sqrt(np.maximum(np.einsum("gii->gi", covariance), 1e-300))
    correlation = covariance / scale[:, :, None] / scale[:, None, :]
    unit = deviation / scale
    inverse = np.linalg.pinv(correlation, rcond=1e-9, hermitian=True)
    chi2 = np.einsum("gi,gij,gj->g", unit, inverse, unit)
    free = (np.einsum("gii->gi", difference) > 0).sum(axis=1)
    freedom = (common.redundancy - apart.redundancy, apart.redundancy)
    F = max(common.chi2 - apart.chi2, 0.0) / freedom[0] / apart.variance_factor
    return CameraStability(
        camera=pairs[:, 0],
        pose=pairs[:, 1],
        images=count,
        deviation_px=deviation,
        covariance_px2=covariance,
        chi2=chi2,
        p_value=holm(chdtrc(free, chi2)),
        F=float(F),
        freedom=freedom,
        overall_p_value=float(fdtrc(*freedom, F)),
        left_out=left_out,
    )


def _nothing(left_out: tuple[str, ...]) -> CameraStability:
    none, numbers = np.empty(0), np.empty(0, np.int64)
    deviation, covariance, nan = np.empty((0, 3)), np.empty((0, 3, 3)), float("nan")
    return CameraStability(
        numbers, numbers, numbers, deviation, covariance, none, none, nan, (0, 0), nan, left_out
    )  # fmt: skip
