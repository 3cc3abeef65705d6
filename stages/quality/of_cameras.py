"""Whether a camera stays as it is, from image to image and from pose to pose."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from truing.estimation.bundle.camera_stability import WATCHED as _WATCHED
from truing.estimation.bundle.camera_stability import camera_stability as camera_deviations
from truing.schemas.photograph_artifacts import BENT, SHARED
from truing.stages.common.words import listed
from truing.stages.quality.bundle_figures import Figures
from truing.stages.quality.check import FAIL, PASS, WARN, Check, without

if TYPE_CHECKING:
    import pyarrow as pa

Array = NDArray[np.float64]

_BEYOND_CHANCE = 1e-3
_MATTERS = 1.0  # of their standard deviations: points that move less are as good as they were
_FAR = 3.0  # times their uncertainty: poses that differ by less in what no image shows by itself
_TOLD = 8  # as many images as a sentence holds


def camera_stability(
    statistics: pa.Table | None, information: pa.Table | None, images: pa.Table | None, figures: Figures
) -> Iterator[Check]:
    """A row per camera: the principal distance of each image against that of most, else principal distance and point
    of each pose against those that all poses share."""
    changed = {} if images is None else _changed(images)
    for camera, rows in changed.items():
        yield _images_apart(camera, rows, figures)
    if statistics is None or information is None or not statistics.num_rows:
        yield without("stability of cameras", "camera-stability", "", "the rays of single poses tell nothing of it")
        return
    poses = list(dict.fromkeys(statistics.column("pose").to_pylist()))
    cameras = [name for name in dict.fromkeys(statistics.column("shared_number").to_pylist()) if name.endswith(" c")]
    for named in cameras:
        camera = named.removesuffix(" c").removeprefix("camera ")
        if camera in changed:
            continue
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
    verdict = PASS if p_value >= _BEYOND_CHANCE else FAIL if ratio > _FAR else WARN
    return Check("camera-stability", f"camera {camera}", p_value, _BEYOND_CHANCE, "1", verdict, said)


Row = dict[str, Any]


def _changed(images: pa.Table) -> dict[str, list[Row]]:
    """The images of every camera of which some have another principal distance than most."""
    found: dict[str, list[Row]] = {}
    for row in images.to_pylist():
        found.setdefault(row["camera"], []).append(row)
    return {camera: rows for camera, rows in found.items() if any(row["setting"] for row in rows)}


def _images_apart(camera: str, rows: list[Row], figures: Figures) -> Check:
    """Images that differ, by how much, what it does to points, and how to let them have a camera of their own."""
    apart = [row for row in rows if row["setting"]]
    p_value = figures.told(SHARED).get(camera, 0.0)
    moved = figures.told(BENT)
    worst = max(moved, key=lambda pose: moved[pose], default="")
    said = f"Camera {camera}: {len(apart)} of {len(rows)} photographs have another principal distance than the others "
    said += f"(p = {p_value:.2g}): {'; '.join(_told_settings(apart, rows))}."
    if moved:
        said += f" Points of {worst} move by {moved[worst]:.1f} standard deviations where these have a camera of their "
        said += "own."
    said += f' Give them one: [[cameras]] name = "{camera} 2", of = "{camera}", {_chosen(apart, rows)}.'
    fails = not moved or moved[worst] > _MATTERS
    return Check("camera-stability", f"camera {camera}", p_value, _BEYOND_CHANCE, "1", FAIL if fails else WARN, said)


def _told_settings(apart: list[Row], rows: list[Row]) -> Iterator[str]:
    for setting in sorted({row["setting"] for row in apart}):
        own = [row for row in apart if row["setting"] == setting]
        off = np.array([row["principal_distance_off_px"] for row in own])
        sigma = np.array([row["principal_distance_sigma_px"] for row in own])
        poses = _whole_poses(own, rows)
        named = [f"{row['image']} of pose {row['pose']}" for row in own if row["pose"] not in poses]
        which = [f"all of pose {pose}" for pose in poses] + named
        yield f"{listed(which, _TOLD)} by {np.median(off):+.2f} ± {np.median(sigma):.2f} px each"


def _whole_poses(own: list[Row], rows: list[Row]) -> list[object]:
    """Poses of which all images are among these."""
    count = Counter(row["pose"] for row in rows)
    return [pose for pose, number in Counter(row["pose"] for row in own).items() if number == count[pose]]


def _chosen(apart: list[Row], rows: list[Row]) -> str:
    """The keys of campaign.toml that choose the first setting that differs."""
    own = [row for row in apart if row["setting"] == apart[0]["setting"]]
    poses = _whole_poses(own, rows)
    if len({row["pose"] for row in own}) == len(poses):
        return f"poses = [{', '.join(map(_toml, poses))}]"
    chosen, poses = {row["image"] for row in own}, list(dict.fromkeys(row["pose"] for row in own))
    images = f"images = [{', '.join(_toml(row['image']) for row in own)}]"
    if sum(row["image"] in chosen for row in rows) == len(own):
        return images
    here = [row for row in own if row["pose"] == poses[0]]  # names that come again in other poses: pose by pose
    return f"poses = [{_toml(poses[0])}], images = [{', '.join(_toml(row['image']) for row in here)}]"


def _toml(value: object) -> str:
    return str(value) if isinstance(value, int) else json.dumps(str(value), ensure_ascii=False)
