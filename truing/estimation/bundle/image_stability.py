"""Did a camera stay what it was from image to image, and what does it do to points where it did not?

Every image of a pose gets a principal distance of its own, all else that cameras have being held; these are tested
against one that most of them share (a shift of one image, Baarda), so that a minority that changed bends no reference.
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

LEVEL = 1e-3  # probability that any image of a camera that stayed as it was is called changed
_ITERATIONS = 8
_FEWEST = 4  # images of a camera: of three nobody can say which is another one
_SETTINGS = 3  # that a camera had besides the most frequent: more are scatter, of what its model does not have
_MEDIAN_OF_NORMAL = 0.6745  # of absolute values, over the standard deviation
_C = PARAMETERS.index("c")
Own = tuple[Index, Array, Array]  # images, their principal distances in px, and the covariance of these
_FRAMING = 3  # points of a body
_SIMILARITY = 7  # freedoms of a pose whose scale nothing gives, either


@dataclass(frozen=True)
class ImageStability:
    """Of one camera: its images (n,) by number, by how much the principal distance of each is off that of most,
    off_px (n,) with sigma_px (n,); setting (n,): 0 as most, 1, 2, .. those that share another one; p_value of one
    principal distance for all images, with its redundancy."""

    camera: int
    images: Index
    off_px: Array
    sigma_px: Array
    setting: Index
    p_value: float


def image_stability(adjusted: Adjustment, variance_factor: Array) -> list[ImageStability]:
    """Principal distances of each camera's images by the rays used; none of cameras with few images, or whose network
    does not tell.

    variance_factor (N,): by which the covariances of rays were multiplied.
    """
    found = [own for own in _by_pose(adjusted, variance_factor) if own is not None]
    network, stable = adjusted.network, []
    for camera in range(len(network.cameras)):
        parts = [_of_camera(own, network.image_camera == camera) for own in found]
        images = np.concatenate([np.zeros(0, np.int64), *(images for images, _, _ in parts)])
        if len(images) >= _FEWEST:
            values = np.concatenate([values for _, values, _ in parts])
            stable.append(_settings(camera, images, values, [block for _, _, block in parts]))
    return stable


def _of_camera(own: Own, chosen: Mask) -> Own:
    images, values, covariance = own
    mine = chosen[images]
    return images[mine], values[mine], covariance[np.ix_(mine, mine)]


def _by_pose(adjusted: Adjustment, factor: Array) -> Iterator[Own | None]:
    """The principal distance of every image of a pose by itself, None where its rays do not tell them."""
    network = _one_camera_each(adjusted.network)
    state = replace(adjusted.state, interior=adjusted.state.interior[adjusted.network.image_camera])
    of_ray = network.image_pose[network.rays.image]
    for pose in np.unique(of_ray[adjusted.used]):
        used = adjusted.used & (of_ray == pose)
        try:
            yield _pose_by_itself(network, state, adjusted, used, factor)
        except (UndeterminedNetworkError, np.linalg.LinAlgError):
            yield None


def _pose_by_itself(network: Network, state: NetworkState, adjusted: Adjustment, used: Mask, factor: Array) -> Own:
    own = adjust(network, state, adjusted.datum, used=used, variance_factor=factor, max_iterations=_ITERATIONS)
    names = own.covariance.names
    places = [k for k, (_, parameter) in enumerate(names) if parameter == "c"]
    images = np.array([int(names[k][0]) for k in places], dtype=np.int64)
    return images, own.state.interior[images, _C], own.covariance.common[np.ix_(places, places)]


def _one_camera_each(network: Network) -> Network:
    """The network in which every image has a camera of its own, of which the principal distance alone is free."""
    cameras = tuple(
        replace(network.cameras[camera], name=str(image), free=("c",))
        for image, camera in enumerate(network.image_camera)
    )
    return replace(network, cameras=cameras, image_camera=np.arange(len(cameras)))


def _settings(camera: int, images: Index, values: Array, blocks: list[Array]) -> ImageStability:
    """Sort images by the principal distances that they share, the most frequent first."""
    from scipy.linalg import block_diag

    covariance = block_diag(*blocks)
    found = _sorted(camera, images, values, covariance)
    if found.setting.max(initial=0) <= _SETTINGS:
        return found
    scatter = float(np.median(np.abs(found.off_px) / found.sigma_px)) / _MEDIAN_OF_NORMAL
    again = _sorted(camera, images, values, covariance * max(scatter, 1.0) ** 2)
    return replace(again, p_value=found.p_value)


def _sorted(camera: int, images: Index, values: Array, covariance: Array) -> ImageStability:
    """Sort images, as `_settings`, by principal distances with this covariance (n, n)."""
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
    if len(apart):  # against the others of its pose a principal distance is known better than by itself
        found, cofactor, _ = _shifts(values, np.asarray(np.linalg.inv(covariance), np.float64), setting > 0)
        off[apart], sigma[apart] = found[1:], np.sqrt(np.diagonal(cofactor)[1:])
    return ImageStability(camera, images, off, sigma, setting, p_value)


def _shared(values: Array, covariance: Array) -> tuple[Mask, float, float]:
    """Mask (n,) of the values that most share, that value, and the chi2 of all of them sharing one."""
    from scipy.special import chdtri

    count = len(values)
    P: Array = np.asarray(np.linalg.inv(covariance), np.float64)
    critical = float(chdtri(1, LEVEL / count))
    every = np.ones(count)
    mean = float(every @ P @ values / (every @ P @ every))
    chi2 = float((values - mean) @ P @ (values - mean))
    sigma: Array = np.sqrt(np.diagonal(covariance))
    # Of all values the one that most others are near to: a median would lie between two settings.
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
    """The value that all share and a shift of each of those outside (n,), together (1 + k,), their cofactors and the
    design (n, 1 + k)."""
    design = np.concatenate([np.ones((len(values), 1)), np.eye(len(values))[:, outside]], 1)
    cofactor = np.linalg.inv(design.T @ P @ design)
    return cofactor @ design.T @ P @ values, cofactor, design


def _tests(values: Array, P: Array, inside: Mask) -> tuple[Array, float]:
    """Return the test value (n,) of a shift of each value, those outside having one anyway, and the value shared."""
    found, cofactor, design = _shifts(values, P, ~inside)
    W = P - P @ design @ cofactor @ design.T @ P
    T = np.zeros(len(values))
    T[~inside] = found[1:] ** 2 / np.diagonal(cofactor)[1:]
    shown = np.diagonal(W)[inside]
    with np.errstate(divide="ignore", invalid="ignore"):
        own = (W @ values)[inside] ** 2 / shown
    T[inside] = np.where(shown > 1e-9 * np.diagonal(P)[inside], own, 0.0)
    return T, float(found[0])


def moved_by_settings(found: AdjustedNetwork, stable: list[ImageStability]) -> Iterator[tuple[int, float]]:
    """Yield, by pose, how far its points move over their sigma where images that differ have a camera of their own."""
    apart = _apart(found, stable)
    if apart is None:
        return
    for pose in range(len(found.named.poses)):
        numbers = found.adjustment.covariance.point_numbers(pose)
        if len(numbers) > _FRAMING:
            yield pose, _over_sigma(found, apart, pose, numbers)


def _apart(found: AdjustedNetwork, stable: list[ImageStability]) -> Adjustment | None:
    """The network adjusted with a camera of its own for every setting; None where nothing differs, or cannot be."""
    adjusted = found.adjustment
    network, state = adjusted.network, adjusted.state
    cameras, image_camera = list(network.cameras), network.image_camera.copy()
    interior = [*state.interior]
    for own in stable:
        for setting in range(1, int(own.setting.max(initial=0)) + 1):
            camera = network.cameras[own.camera]
            free = tuple(name for name in WATCHED if name in camera.free) or ("c",)
            image_camera[own.images[own.setting == setting]] = len(cameras)
            cameras.append(replace(camera, name=f"{camera.name}, setting {setting}", free=free))
            start = state.interior[own.camera].copy()
            start[0] += np.median(own.off_px[own.setting == setting])
            interior.append(start)
    if len(cameras) == len(network.cameras):
        return None
    split = replace(network, cameras=tuple(cameras), image_camera=image_camera)
    begin = replace(state, interior=np.array(interior))
    factor = found.screened.components.of_rays()
    try:
        return adjust(split, begin, adjusted.datum, used=adjusted.used, variance_factor=factor)
    except UndeterminedNetworkError:
        return None


def _over_sigma(found: AdjustedNetwork, apart: Adjustment, pose: int, numbers: Index) -> float:
    """How far the points of a pose move at most: all of them (rms), or a body against the others."""
    adjusted = found.adjustment
    before, after = adjusted.state.points[numbers], apart.state.points[numbers]
    fit = umeyama(before, after, with_scale=bool(adjusted.defect[pose] == _SIMILARITY))
    shift = after - (fit.scale[0] * before @ fit.R[0].T + fit.t[0])
    factor = found.screened.covariance_factor
    covariance = adjusted.covariance.points(pose) * (factor if np.isfinite(factor) else 1.0)
    blocks = covariance.reshape(len(numbers), 3, len(numbers), 3)
    variance = np.einsum("nini->n", blocks)
    found_sizes = [float(np.sqrt(np.mean(np.sum(shift**2, -1) / np.maximum(variance, 1e-300))))]
    bodies = found.named.bodies[numbers]
    names = [name for name in dict.fromkeys(bodies.tolist()) if name and (bodies == name).sum() >= _FRAMING]
    for name in names if len(names) > 1 else []:
        own = bodies == name
        mean, cov = shift[own].mean(0), blocks[own][:, :, own].mean(axis=(0, 2))
        found_sizes.append(float(np.sqrt(mean @ np.linalg.solve(cov, mean) / 3.0)))
    return max(found_sizes)
