"""What images whose camera differs do to object points."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from truing.estimation.bundle.adjustment import Adjustment, adjust
from truing.estimation.bundle.determinable import UndeterminedNetworkError
from truing.estimation.bundle.image_stability import ImageStability
from truing.estimation.bundle.named_adjustment import AdjustedNetwork
from truing.estimation.bundle.network import Index
from truing.estimation.rigid_poses.umeyama import umeyama

_OF_GROUP = ("c", "x0", "y0")
_FRAMING = 3  # points of a body
_SIMILARITY = 7  # freedoms of a pose whose scale nothing gives, either


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
            free = tuple(name for name in _OF_GROUP if name in camera.free) or ("c",)
            image_camera[own.images[own.setting == setting]] = len(cameras)
            cameras.append(replace(camera, name=f"{camera.name}, setting {setting}", free=free))
            start = state.interior[own.camera].copy()
            start[0] += np.median(own.off_px[own.setting == setting])
            interior.append(start)
    if len(cameras) == len(network.cameras):
        return None
    split = replace(network, cameras=tuple(cameras), image_camera=image_camera)
    begin = replace(state, interior=np.array(interior))
    factor = found.snooped.components.of_rays()
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
    factor = found.snooped.covariance_factor
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
