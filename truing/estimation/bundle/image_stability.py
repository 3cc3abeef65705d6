"""Test whether the principal distance of a camera changed from image to image, and how much that moves points.

Each image of a pose gets its own principal distance, with all other camera elements fixed. These are tested against
the value that most images share (a shift of one image, Baarda). A changed minority then does not bias the reference.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from truing.arrays import Array, Index, Mask
from truing.estimation.bundle.adjustment import Adjustment, adjust
from truing.estimation.bundle.camera import PARAMETERS
from truing.estimation.bundle.camera_stability import WATCHED
from truing.estimation.bundle.determinable import UndeterminedNetworkError
from truing.estimation.bundle.named_adjustment import AdjustedNetwork
from truing.estimation.bundle.network import Network, NetworkState
from truing.estimation.rigid_poses.umeyama import umeyama

LEVEL = 1e-3  # probability that any image of an unchanged camera is called changed
_ITERATIONS = 8
_FEWEST = 4  # images of a camera: among three, the changed one cannot be identified
_SETTINGS = 3  # further settings of a camera; more are scatter that its model does not describe
_MEDIAN_OF_NORMAL = 0.6745  # median absolute value over the standard deviation
_C = PARAMETERS.index("c")
Distances = tuple[Index, Array, Array]  # images, their principal distances in px, and the covariance of these
_FRAMING = 3  # points of a body
_SIMILARITY = 7  # freedoms of a pose that has no scale either


@dataclass(frozen=True)
class ImageStability:
    """Images (n,) of one camera by number, with their principal distances.

    off_px (n,) with sigma_px (n,): difference from the value of most images. setting (n,): 0 for the value of most, 1,
    2, .. for groups that share another value. p_value: of one principal distance for all images, with its redundancy.
    """

    camera: int
    images: Index
    off_px: Array
    sigma_px: Array
    setting: Index
    p_value: float


def image_stability(adjusted: Adjustment, variance_factor: Array) -> list[ImageStability]:
    """Return the principal distances of each camera's images, from the used rays.

    Cameras with few images, or whose network does not determine them, are left out. variance_factor (N,): factor of the
    rays' covariances.
    """
    pose_distances = [setting for setting in _deviations_by_pose(adjusted, variance_factor) if setting is not None]
    network, stable = adjusted.network, []
    for camera in range(len(network.cameras)):
        camera_parts = [_camera_part(setting, network.image_camera == camera) for setting in pose_distances]
        images = np.concatenate([np.zeros(0, np.int64), *(images for images, _, _ in camera_parts)])
        if len(images) >= _FEWEST:
            values = np.concatenate([values for _, values, _ in camera_parts])
            stable.append(_settings(camera, images, values, [block for _, _, block in camera_parts]))
    return stable


def _camera_part(distances: Distances, chosen: Mask) -> Distances:
    images, values, covariance = distances
    is_of_camera = chosen[images]
    return images[is_of_camera], values[is_of_camera], covariance[np.ix_(is_of_camera, is_of_camera)]


def _deviations_by_pose(adjusted: Adjustment, factor: Array) -> Iterator[Distances | None]:
    """Yield the principal distance of every image of each pose, None if the rays do not determine them."""
    network = _with_camera_per_image(adjusted.network)
    state = replace(adjusted.state, interior=adjusted.state.interior[adjusted.network.image_camera])
    of_ray = network.image_pose[network.rays.image]
    for pose in np.unique(of_ray[adjusted.used]):
        used = adjusted.used & (of_ray == pose)
        try:
            yield _pose_by_itself(network, state, adjusted, used, factor)
        except (UndeterminedNetworkError, np.linalg.LinAlgError):
            yield None


def _pose_by_itself(
    network: Network, state: NetworkState, adjusted: Adjustment, used: Mask, factor: Array
) -> Distances:
    adjustment = adjust(network, state, adjusted.datum, used=used, variance_factor=factor, max_iterations=_ITERATIONS)
    names = adjustment.covariance.names
    indices = [k for k, (_, parameter) in enumerate(names) if parameter == "c"]
    images = np.array([int(names[k][0]) for k in indices], dtype=np.int64)
    return images, adjustment.state.interior[images, _C], adjustment.covariance.common[np.ix_(indices, indices)]


def _with_camera_per_image(network: Network) -> Network:
    """Return the network in which every image has its own camera with only the principal distance free."""
    cameras = tuple(
        replace(network.cameras[camera], name=str(image), free=("c",))
        for image, camera in enumerate(network.image_camera)
    )
    return replace(network, cameras=cameras, image_camera=np.arange(len(cameras)))


def _settings(camera: int, images: Index, values: Array, blocks: list[Array]) -> ImageStability:
    """Group images by shared principal distances, the most frequent first."""
    from scipy.linalg import block_diag

    covariance = block_diag(*blocks)
    stability = _sorted(camera, images, values, covariance)
    if stability.setting.max(initial=0) <= _SETTINGS:
        return stability
    scatter = float(np.median(np.abs(stability.off_px) / stability.sigma_px)) / _MEDIAN_OF_NORMAL
    again = _sorted(camera, images, values, covariance * max(scatter, 1.0) ** 2)
    return replace(again, p_value=stability.p_value)


def _sorted(camera: int, images: Index, values: Array, covariance: Array) -> ImageStability:
    """Group images, as `_settings`, by principal distances with covariance (n, n)."""
    from scipy.special import chdtrc

    setting, left, p_value = np.full(len(images), -1), np.arange(len(images)), 1.0
    off, sigma = np.zeros(len(images)), np.sqrt(np.diagonal(covariance)).copy()
    reference = np.nan
    for number in range(len(images)):
        inside, common, chi2 = _shared(values[left], covariance[np.ix_(left, left)])
        if number == 0:
            reference, freedom = common, len(images) - 1
            p_value = float(chdtrc(freedom, chi2)) if freedom else 1.0
        setting[left[inside]] = number
        left = left[~inside]
        if not len(left):
            break
    off = values - reference
    apart = np.flatnonzero(setting > 0)
    if len(apart):  # the comparison within its pose is more precise than the value itself
        deviations, cofactor, _ = _shifts(values, np.asarray(np.linalg.inv(covariance), np.float64), setting > 0)
        off[apart], sigma[apart] = deviations[1:], np.sqrt(np.diagonal(cofactor)[1:])
    return ImageStability(camera, images, off, sigma, setting, p_value)


def _shared(values: Array, covariance: Array) -> tuple[Mask, float, float]:
    """Return the mask (n,) of values that most images share, that value, and the chi2 of all images sharing one."""
    from scipy.special import chdtri

    count = len(values)
    P: Array = np.asarray(np.linalg.inv(covariance), np.float64)
    critical = float(chdtri(1, LEVEL / count))
    every = np.ones(count)
    mean = float(every @ P @ values / (every @ P @ every))
    chi2 = float((values - mean) @ P @ (values - mean))
    sigma: Array = np.sqrt(np.diagonal(covariance))
    # Starts from the value with the most neighbours: a median could lie between two settings.
    near = np.abs(values[:, None] - values) <= np.sqrt(critical) * np.hypot(sigma[:, None], sigma)
    inside = near[int(np.argmax(near.sum(1)))]
    seen: set[bytes] = set()
    while inside.tobytes() not in seen:
        seen.add(inside.tobytes())
        tests, common = _tests(values, P, inside)
        fails, back = inside & (tests > critical), ~inside & (tests <= critical)
        following = inside.copy()
        if back.any():
            following |= back
        elif fails.any() and inside.sum() > 1:
            following[int(np.argmax(np.where(fails, tests, -1.0)))] = False
        if np.array_equal(following, inside):
            break
        inside = following
    return inside, common, chi2


def _shifts(values: Array, P: Array, outside: Mask) -> tuple[Array, Array, Array]:
    """Return the shared value and a shift for each value outside (n,), together (1 + k,), with cofactors and the design
    (n, 1 + k)."""
    design = np.concatenate([np.ones((len(values), 1)), np.eye(len(values))[:, outside]], 1)
    cofactor = np.linalg.inv(design.T @ P @ design)
    return cofactor @ design.T @ P @ values, cofactor, design


def _tests(values: Array, P: Array, inside: Mask) -> tuple[Array, float]:
    """Return the test value (n,) of a shift of each value, next to shifts of those outside, and the shared value."""
    deviations, cofactor, design = _shifts(values, P, ~inside)
    W = P - P @ design @ cofactor @ design.T @ P
    T = np.zeros(len(values))
    T[~inside] = deviations[1:] ** 2 / np.diagonal(cofactor)[1:]
    shown = np.diagonal(W)[inside]
    with np.errstate(divide="ignore", invalid="ignore"):
        contribution = (W @ values)[inside] ** 2 / shown
    T[inside] = np.where(shown > 1e-9 * np.diagonal(P)[inside], contribution, 0.0)
    return T, float(deviations[0])


def moved_by_settings(adjusted_network: AdjustedNetwork, stable: list[ImageStability]) -> Iterator[tuple[int, float]]:
    """Yield (pose, largest movement of its points over its sigma) if images with another setting get their own
    camera."""
    by_setting = _adjusted_by_setting(adjusted_network, stable)
    if by_setting is None:
        return
    for pose in range(len(adjusted_network.named.poses)):
        numbers = adjusted_network.adjustment.covariance.point_numbers(pose)
        if len(numbers) > _FRAMING:
            yield pose, _over_sigma(adjusted_network, by_setting, pose, numbers)


def _adjusted_by_setting(adjusted_network: AdjustedNetwork, stable: list[ImageStability]) -> Adjustment | None:
    """Return the network adjusted with one camera per setting; None if all agree or the adjustment fails."""
    adjusted = adjusted_network.adjustment
    network, state = adjusted.network, adjusted.state
    cameras, image_camera = list(network.cameras), network.image_camera.copy()
    interior = [*state.interior]
    for pose_shift in stable:
        for setting in range(1, int(pose_shift.setting.max(initial=0)) + 1):
            camera = network.cameras[pose_shift.camera]
            free = tuple(name for name in WATCHED if name in camera.free) or ("c",)
            image_camera[pose_shift.images[pose_shift.setting == setting]] = len(cameras)
            cameras.append(replace(camera, name=f"{camera.name}, setting {setting}", free=free))
            start = state.interior[pose_shift.camera].copy()
            start[0] += np.median(pose_shift.off_px[pose_shift.setting == setting])
            interior.append(start)
    if len(cameras) == len(network.cameras):
        return None
    split = replace(network, cameras=tuple(cameras), image_camera=image_camera)
    begin = replace(state, interior=np.array(interior))
    factor = adjusted_network.screened.components.ray_factors()
    try:
        return adjust(split, begin, adjusted.datum, used=adjusted.used, variance_factor=factor)
    except UndeterminedNetworkError:
        return None


def _over_sigma(adjusted_network: AdjustedNetwork, by_setting: Adjustment, pose: int, numbers: Index) -> float:
    """Return the largest movement of the points of a pose over its sigma: of all points (rms), or of a body relative to
    the others."""
    adjusted = adjusted_network.adjustment
    before, after = adjusted.state.points[numbers], by_setting.state.points[numbers]
    fit = umeyama(before, after, with_scale=bool(adjusted.defect[pose] == _SIMILARITY))
    shift = after - (fit.scale * before @ fit.R.T + fit.t)
    factor = adjusted_network.screened.covariance_factor
    factor = factor if np.isfinite(factor) else 1.0
    variance = np.einsum("nii->n", adjusted.covariance.point_blocks()[numbers]) * factor
    found_sizes = [float(np.sqrt(np.mean(np.sum(shift**2, -1) / np.maximum(variance, 1e-300))))]
    bodies = adjusted_network.named.bodies[numbers]
    names = [name for name in dict.fromkeys(bodies.tolist()) if name and (bodies == name).sum() >= _FRAMING]
    for name in names if len(names) > 1 else []:
        mask = bodies == name
        means = np.einsum("n,ij->inj", mask / mask.sum(), np.eye(3)).reshape(3, -1)
        mean, cov = shift[mask].mean(0), adjusted.covariance.combined(pose, means) * factor
        found_sizes.append(float(np.sqrt(mean @ np.linalg.solve(cov, mean) / 3.0)))
    return max(found_sizes)
