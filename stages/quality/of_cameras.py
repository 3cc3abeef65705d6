"""Whether a camera stays as it is from pose to pose, by what the rays of each pose tell of it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from stages.quality.check import PASS, WARN, Check, without
from truing.estimation.bundle.camera_stability import WATCHED as _WATCHED
from truing.estimation.bundle.camera_stability import camera_stability as camera_deviations

if TYPE_CHECKING:
    import pyarrow as pa

Array = NDArray[np.float64]

_BEYOND_CHANCE = 1e-3


def camera_stability(statistics: pa.Table | None, information: pa.Table | None) -> Iterator[Check]:
    """A row per camera: principal distance and point of each pose against those that all poses share."""
    if statistics is None or information is None or not statistics.num_rows:
        yield without("stability of cameras", "camera-stability", "", "the rays of single poses tell nothing of it")
        return
    poses = list(dict.fromkeys(statistics.column("pose").to_pylist()))
    cameras = [name for name in dict.fromkeys(statistics.column("shared_number").to_pylist()) if name.endswith(" c")]
    for named in cameras:
        camera = named.removesuffix(" c").removeprefix("camera ")
        watched = [named.removesuffix("c") + name for name in _WATCHED]
        if len(poses) < 2:
            yield without("stability", "camera-stability", f"camera {camera}", "there is but one pose")
            continue
        yield _stability(camera, poses, _scores(statistics, poses, watched), _blocks(information, poses, watched))


def _scores(table: pa.Table, poses: list[object], watched: list[str]) -> Array:
    """(S, 3) what the residuals of each pose say of the parameters."""
    out = np.zeros((len(poses), len(watched)))
    rows = zip(*(table.column(name).to_pylist() for name in ("pose", "shared_number", "score")), strict=True)
    for pose, parameter, value in rows:
        if parameter in watched:
            out[poses.index(pose), watched.index(parameter)] = value
    return out


def _blocks(table: pa.Table, poses: list[object], watched: list[str]) -> Array:
    """(S, 3, 3) how well each pose tells them, given all else that is common."""
    out = np.zeros((len(poses), len(watched), len(watched)))
    names = ("pose", "shared_number", "other_number", "information")
    for pose, one, other, value in zip(*(table.column(name).to_pylist() for name in names), strict=True):
        if one in watched and other in watched:
            i, j = watched.index(one), watched.index(other)
            out[poses.index(pose), i, j] = out[poses.index(pose), j, i] = value
    return out


def _stability(camera: str, poses: list[object], score: Array, information: Array) -> Check:
    """The poses' own values against their common one."""
    found = camera_deviations(score, information)
    if not found.freedom:
        return without("stability", "camera-stability", f"camera {camera}", "fewer than two poses tell of it")
    sigma = np.sqrt(np.diagonal(found.covariance_px2, axis1=1, axis2=2))
    worst = int(np.nanargmax(found.chi2))
    deviation = found.deviation_px[worst]
    shown = ", ".join(f"{name} by {deviation[k]:+.2f} ± {sigma[worst, k]:.2f} px" for k, name in enumerate(_WATCHED))
    p_value, ratio = found.overall_p_value, np.sqrt(found.overall_chi2 / found.freedom)
    said = f"Camera {camera}: poses differ in principal distance and point by {ratio:.2f} times their uncertainty "
    said += f"(p = {p_value:.2g}); most in pose {poses[worst]} (p = {found.p_value[worst]:.2g}): {shown}."
    trips = p_value < _BEYOND_CHANCE
    return Check("camera-stability", f"camera {camera}", p_value, _BEYOND_CHANCE, "1", WARN if trips else PASS, said)
