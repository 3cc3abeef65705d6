"""Checks of a photogrammetric network: rays, angles, format, noise, rejected rays, known points, camera stability."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator, Mapping

import numpy as np
import pyarrow as pa

from truing.arrays import Array, TableRow
from truing.estimation.bundle.camera_stability import WATCHED as _WATCHED
from truing.estimation.bundle.camera_stability import camera_stability as camera_deviations
from truing.report.numbers import count_text, listed
from truing.schemas.photograph_artifacts import BENT, SHARED, subject_and_name
from truing.stages.common.point_arrays import number_column, text_column
from truing.stages.quality.check import FAIL, PASS, WARN, CampaignLimits, Check, not_evaluated
from truing.stages.quality.scale_checks import Figures, bar_lengths, figures_of, rows_of, scale, target_sizes

_FEWEST_RAYS = 3
_WORST = 0.1
_BEYOND_CHANCE = 1e-3
_MATTERS = 0.1  # of the noise of a ray: a mean residual below it bends no point by more than noise does
_KNOWN = 3.0  # standard deviations by which a noise has to be off its stated one to count
_MOVES_POINTS = 1.0  # of their standard deviations: points that move less are as good as they were
_FAR = 3.0  # times their uncertainty: poses that differ by less in what no image shows by itself
_SHOWN_IMAGES = 8  # as many images as a sentence holds
_LEVEL = 1e-3
_SHOWN_POINTS = 4  # as many as a sentence holds


def photograph_checks(tables: Mapping[str, pa.Table], limits: CampaignLimits) -> Iterator[Check]:
    """Yield all checks of the network; none if the points do not come from photographs."""
    if "bundle_statistics" not in tables:
        return
    figures = figures_of(tables["bundle_statistics"])
    images = tables.get("image_cameras")
    points, residuals = tables["object_points"], tables["image_residuals"]
    yield from _oriented(tables["photographs"], tables["image_orientations"], limits)
    survey = tables.get("survey")
    yield from scale(figures, tables.get("scale_bar_lengths"), surveyed=survey is not None and survey.num_rows > 0)
    yield from target_sizes(figures, limits)
    yield from known_points(tables.get("known_point_errors"))
    for pose in dict.fromkeys(points.column("pose").to_pylist()):
        rows = rows_of(points, "pose", pose)
        yield _rays_per_point(f"pose {pose}", rows, limits)
        yield _angles(f"pose {pose}", rows, limits)
    for camera in dict.fromkeys(residuals.column("camera").to_pylist()):
        yield _coverage(camera, figures, limits)
        yield _rejected(camera, rows_of(residuals, "camera", camera), limits)
        yield _systematic(camera, figures, residuals)
    yield from _noise(figures, limits)
    yield from camera_stability(tables.get("ray_statistics"), tables.get("ray_information"), images, figures)
    yield from bar_lengths(tables.get("scale_bar_lengths"), limits)


def _oriented(photographs: pa.Table, orientations: pa.Table, limits: CampaignLimits) -> Iterator[Check]:
    keys = ("pose", "image")
    known = set(zip(*(orientations.column(key).to_pylist() for key in keys), strict=True))
    images: dict[object, list[str]] = {}
    for pose, image in zip(*(photographs.column(key).to_pylist() for key in keys), strict=True):
        images.setdefault(pose, []).append(image)
    limit = limits.of("images-oriented")
    for pose, all_of_pose in images.items():
        lost = [image for image in all_of_pose if (pose, image) not in known]
        text = (
            f"pose {pose}: {len(all_of_pose) - len(lost)} of "
            f"{count_text(len(all_of_pose), 'photograph')} with an orientation"
        )
        text += f"; without: {listed(lost)}." if lost else "."
        yield limit.row(f"pose {pose}", len(lost) / len(all_of_pose), "1", text)


def _rays_per_point(subject: str, points: pa.Table, limits: CampaignLimits) -> Check:
    rays = number_column(points, "rays")
    few = text_column(points, "point")[rays < _FEWEST_RAYS]
    text = f"{subject}: {count_text(len(rays), 'point')}, {np.median(rays):.0f} rays each (median)"
    text += f"; fewer than three to {listed(few.tolist())}." if len(few) else ", three or more to all."
    return limits.of("rays-per-point").row(subject, len(few) / len(rays), "1", text)


def _angles(subject: str, points: pa.Table, limits: CampaignLimits) -> Check:
    angle = number_column(points, "largest_angle_deg")
    worst = float(np.quantile(angle, _WORST))
    name = text_column(points, "point")[int(np.argmin(angle))]
    text = f"{subject}: rays meet at {np.median(angle):.0f} deg (median), those to the worst tenth of the "
    text += f"points at {worst:.0f} deg at most; least at {name}, {angle.min():.1f} deg."
    return limits.of("intersection-angles").row(subject, worst, "deg", text)


def _coverage(camera: str, figures: Figures, limits: CampaignLimits) -> Check:
    share = figures["covered share of the format"].get(camera, 0.0)
    text = f"Camera {camera}: image points lie in {100 * share:.0f} % of its format's cells."
    return limits.of("format-coverage").row(f"camera {camera}", share, "1", text)


def _rejected(camera: str, residuals: pa.Table, limits: CampaignLimits) -> Check:
    """Check the share of rejected rays to named points; circles that only one image shows do not count."""
    named = text_column(residuals, "point") != ""
    rejected = np.asarray(residuals.column("rejected").to_pylist(), dtype=bool) & named
    count = int(named.sum())
    image = text_column(residuals, "image")[rejected]
    names, times = np.unique(image.astype(str), return_counts=True)
    first = [f"{name} ({k})" for k, name in sorted(zip(times.tolist(), names.tolist(), strict=True), reverse=True)[:3]]
    text = f"Camera {camera}: {int(rejected.sum())} of {count} rays are left out"
    text += f", most in {', '.join(first)}." if first else "."
    return limits.of("rejected-rays").row(f"camera {camera}", rejected.sum() / max(count, 1), "1", text)


def _systematic(camera: str, figures: Figures, residuals: pa.Table) -> Check:
    subject = f"camera {camera}"
    p_value = figures["systematic residuals, p-value"].get(camera)
    mean = figures["systematic residuals, largest mean"].get(camera)
    if p_value is None or mean is None:
        return not_evaluated("residuals by region", "residuals-systematic", subject, "no ray is left")
    sigma = float(np.median(number_column(rows_of(residuals, "camera", camera), "sigma_x_px")))
    trips = p_value < _BEYOND_CHANCE and mean > _MATTERS * sigma
    text = f"Camera {camera}: the largest mean residual of a part of its format is {mean:.3f} px"
    text += f" (p = {p_value:.2g} of all parts together), the noise of a ray {sigma:.3f} px."
    return Check("residuals-systematic", subject, p_value, _BEYOND_CHANCE, "1", WARN if trips else PASS, text)


def _noise(figures: Figures, limits: CampaignLimits) -> Iterator[Check]:
    limit = limits.of("image-noise")
    spread = figures["noise over stated, sigma"]
    for subject, ratio in figures["noise over stated"].items():
        off = max(ratio, 1.0 / ratio)
        sigma = spread.get(subject, 0.0)
        text = f"{subject}: the noise of image coordinates is {ratio:.2f} ± {sigma:.2f} times what is stated."
        yield limit.row(subject, off, "times", text, counts=abs(ratio - 1.0) > _KNOWN * sigma)


def camera_stability(
    statistics: pa.Table | None, information: pa.Table | None, images: pa.Table | None, figures: Figures
) -> Iterator[Check]:
    """Yield one row per camera: principal distance of each image against the majority, otherwise principal distance and
    point of each pose against the common values."""
    changed = {} if images is None else _changed(images)
    for camera, rows in changed.items():
        yield _deviating_images_check(camera, rows, figures)
    if statistics is None or information is None or not statistics.num_rows:
        yield not_evaluated("stability of cameras", "camera-stability", "", "rays of a single pose do not show it")
        return
    poses = list(dict.fromkeys(statistics.column("pose").to_pylist()))
    cameras: dict[str, dict[str, str]] = {}
    for number in dict.fromkeys(statistics.column("shared_number").to_pylist()):
        kind, owner, name = subject_and_name(number)
        if kind == "camera":
            cameras.setdefault(owner, {})[name] = number
    for camera, numbers in cameras.items():
        if camera in changed or _WATCHED[0] not in numbers:
            continue
        watched = [numbers.get(name, "") for name in _WATCHED]  # an element that is held has no parameter
        if len(poses) < 2:
            yield _stability_within_pose(camera, figures)
            continue
        yield _stability(camera, poses, _scores(statistics, poses, watched), _blocks(information, poses, watched))


def _stability_within_pose(camera: str, figures: Figures) -> Check:
    """Return the check of one principal distance for all images of a single pose, of which none stands out."""
    p_value = figures[SHARED].get(camera)
    if p_value is None:
        why = "there is only one pose, and its photographs do not determine a principal distance each"
        return not_evaluated("stability", "camera-stability", f"camera {camera}", why)
    trips = p_value < _BEYOND_CHANCE
    text = f"Camera {camera}: one principal distance fits all photographs (p = {p_value:.2g})."
    if trips:
        text = (
            f"Camera {camera}: one principal distance does not fit all photographs (p = {p_value:.2g}), and no few of "
            "them are the cause. The lens moves with the camera's roll or focus, the object moved, or the model of "
            "the distortion lacks a term. Points are less certain than stated."
        )
    return Check("camera-stability", f"camera {camera}", p_value, _BEYOND_CHANCE, "1", WARN if trips else PASS, text)


def _scores(table: pa.Table, poses: list[object], watched: list[str]) -> Array:
    """Return the gradients (S, 3) of each pose's log-likelihood by the camera's parameters."""
    out = np.zeros((len(poses), len(watched)))
    rows = zip(*(table.column(name).to_pylist() for name in ("pose", "shared_number", "score")), strict=True)
    for pose, parameter, value in rows:
        if parameter in watched:
            out[poses.index(pose), watched.index(parameter)] = value
    return out


def _blocks(table: pa.Table, poses: list[object], watched: list[str]) -> Array:
    """Return each pose's information (S, 3, 3) on the camera's parameters, given all other common parameters."""
    out = np.zeros((len(poses), len(watched), len(watched)))
    names = ("pose", "shared_number", "other_number", "information")
    for pose, first_part, other, value in zip(*(table.column(name).to_pylist() for name in names), strict=True):
        if first_part in watched and other in watched:
            i, j = watched.index(first_part), watched.index(other)
            out[poses.index(pose), i, j] = out[poses.index(pose), j, i] = value
    return out


def _stability(camera: str, poses: list[object], score: Array, information: Array) -> Check:
    """Return the check of the poses' own parameters against the common ones."""
    deviations = camera_deviations(score, information)
    if not deviations.freedom:
        return not_evaluated("stability", "camera-stability", f"camera {camera}", "fewer than two poses show it")
    sigma = np.sqrt(np.diagonal(deviations.covariance_px2, axis1=1, axis2=2))
    worst = int(np.nanargmax(deviations.chi2))
    deviation = deviations.deviation_px[worst]
    shown = ", ".join(f"{name} by {deviation[k]:+.2f} ± {sigma[worst, k]:.2f} px" for k, name in enumerate(_WATCHED))
    p_value, ratio = deviations.overall_p_value, np.sqrt(deviations.overall_chi2 / deviations.freedom)
    text = f"Camera {camera}: poses differ in principal distance and point by {ratio:.2f} times their uncertainty "
    text += f"(p = {p_value:.2g}); most in pose {poses[worst]} (p = {deviations.p_value[worst]:.2g}): {shown}."
    verdict = PASS if p_value >= _BEYOND_CHANCE else FAIL if ratio > _FAR else WARN
    return Check("camera-stability", f"camera {camera}", p_value, _BEYOND_CHANCE, "1", verdict, text)


def _changed(images: pa.Table) -> dict[str, list[TableRow]]:
    """Yield the images of each camera with some principal distances different from the majority."""
    rows_by_camera: dict[str, list[TableRow]] = {}
    for row in images.to_pylist():
        rows_by_camera.setdefault(row["camera"], []).append(row)
    return {camera: rows for camera, rows in rows_by_camera.items() if any(row["setting"] for row in rows)}


def _deviating_images_check(camera: str, rows: list[TableRow], figures: Figures) -> Check:
    """Return the check of images with another principal distance: size, effect on points, entry that gives them a
    camera of their own."""
    changed = [row for row in rows if row["setting"]]
    p_value = figures[SHARED].get(camera, 0.0)
    moved = figures[BENT]
    worst = max(moved, key=lambda pose: moved[pose], default="")
    text = (
        f"Camera {camera}: {len(changed)} of {len(rows)} photographs have a different principal distance from "
        "the others "
    )
    text += f"(p = {p_value:.2g}): {'; '.join(_reported_settings(changed, rows))}."
    if moved:
        text += f" Points of {worst} move by {moved[worst]:.1f} standard deviations if these have a camera of their "
        text += "own."
    text += f' Declare it: [[cameras]] name = "{camera} 2", of = "{camera}", {_setting_keys(changed, rows)}.'
    fails = not moved or moved[worst] > _MOVES_POINTS
    return Check("camera-stability", f"camera {camera}", p_value, _BEYOND_CHANCE, "1", FAIL if fails else WARN, text)


def _reported_settings(deviating: list[TableRow], rows: list[TableRow]) -> Iterator[str]:
    for setting in sorted({row["setting"] for row in deviating}):
        rows_of_setting = [row for row in deviating if row["setting"] == setting]
        off = np.array([row["principal_distance_off_px"] for row in rows_of_setting])
        sigma = np.array([row["principal_distance_sigma_px"] for row in rows_of_setting])
        poses = _complete_poses(rows_of_setting, rows)
        named = [f"{row['image']} of pose {row['pose']}" for row in rows_of_setting if row["pose"] not in poses]
        which = [f"all of pose {pose}" for pose in poses] + named
        yield f"{listed(which, _SHOWN_IMAGES)} by {np.median(off):+.2f} ± {np.median(sigma):.2f} px each"


def _complete_poses(body_rows: list[TableRow], rows: list[TableRow]) -> list[object]:
    """Return the poses all of whose images are among these."""
    count = Counter(row["pose"] for row in rows)
    return [pose for pose, number in Counter(row["pose"] for row in body_rows).items() if number == count[pose]]


def _setting_keys(deviating: list[TableRow], rows: list[TableRow]) -> str:
    """Return the keys of campaign.toml that select the images of the first different setting."""
    rows_of_setting = [row for row in deviating if row["setting"] == deviating[0]["setting"]]
    poses = _complete_poses(rows_of_setting, rows)
    if len({row["pose"] for row in rows_of_setting}) == len(poses):
        return f"poses = [{', '.join(map(_toml, poses))}]"
    chosen, poses = (
        {row["image"] for row in rows_of_setting},
        list(dict.fromkeys(row["pose"] for row in rows_of_setting)),
    )
    images = f"images = [{', '.join(_toml(row['image']) for row in rows_of_setting)}]"
    if sum(row["image"] in chosen for row in rows) == len(rows_of_setting):
        return images
    here = [
        row for row in rows_of_setting if row["pose"] == poses[0]
    ]  # names that come again in other poses: pose by pose
    return f"poses = [{_toml(poses[0])}], images = [{', '.join(_toml(row['image']) for row in here)}]"


def _toml(value: object) -> str:
    return str(value) if isinstance(value, int) else json.dumps(str(value), ensure_ascii=False)


def known_points(errors: pa.Table | None) -> Iterator[Check]:
    """Yield one row per pose whose known points are the datum."""
    if errors is None or not errors.num_rows:
        yield not_evaluated("known points", "known-points", "", "they do not define the datum")
        return
    for pose in dict.fromkeys(errors.column("pose").to_pylist()):
        yield _known_points_check(f"pose {pose}", rows_of(errors, "pose", pose).to_pylist())


def _known_points_check(subject: str, rows: list[TableRow]) -> Check:
    """Return the check of a pose's known points; its value is the number of those that contradict or have no ray."""
    tested = [row for row in rows if row["p_value"] is not None]
    lost = [row["point"] for row in rows if not row["rays"]]
    doubted = sorted((row for row in tested if row["reason"]), key=_distance, reverse=True)
    if not tested and not lost:
        return not_evaluated("known points", "known-points", subject, "rays alone do not check them")
    # Points may contradict each other together, while none of them differs beyond chance.
    named = [row for row in doubted if row["rejected"] or row["p_value"] * len(tested) < _LEVEL]
    text = f"{subject}: {count_text(len(rows), 'known point')}"
    text += ", each compared with where the rays and the other known points place it" if tested else ""
    if named:
        text += f"; {named[0]['reason']}: {'; '.join(map(_deviation_words, named[:_SHOWN_POINTS]))}"
        text += f"; and {len(named) - _SHOWN_POINTS} more" if len(named) > _SHOWN_POINTS else ""
    elif doubted:
        text += "; together they differ by more than their sigmas allow, and none stands out: are the sigmas too small?"
        text += f" The largest difference is that of {_deviation_words(doubted[0])}"
    elif tested:
        text += f"; the largest difference is that of {_deviation_words(max(tested, key=_distance))}"
    text += f"; without any remaining ray, so not measured: {listed(lost)}" if lost else ""
    faulty = {row["point"] for row in doubted} | set(lost)
    return Check("known-points", subject, float(len(faulty)), 0.0, "1", FAIL if faulty else PASS, f"{text}.")


def _distance(row: TableRow) -> float:
    return float(np.linalg.norm([row["dx_mm"], row["dy_mm"], row["dz_mm"]]))


def _deviation_words(row: TableRow) -> str:
    """Return the deviation of a known point and its direction in words."""
    off = np.array([row["dx_mm"], row["dy_mm"], row["dz_mm"]])
    size, spread = float(np.linalg.norm(off)), [row[f"sigma_{axis}_mm"] for axis in "xyz"]
    uncertainty_words = "" if None in spread else f" ± {np.linalg.norm(off / max(size, 1e-12) * np.array(spread)):.2g}"
    along = ", ".join(f"{axis} {value:+.3g}" for axis, value in zip("xyz", off, strict=True))
    return f"{row['point']}, {size:.3g}{uncertainty_words} mm ({along})"
