"""The network that photographs make: rays, angles, format, noise, rejected rays, cameras, scale bars."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING

import numpy as np

from truing.report.numbers import count as counted
from truing.stages.common.point_arrays import number_column, text_column
from truing.stages.common.words import listed
from truing.stages.quality.bundle_figures import Figures, rows_of
from truing.stages.quality.check import PASS, WARN, Check, without
from truing.stages.quality.limits import CampaignLimits
from truing.stages.quality.of_cameras import camera_stability
from truing.stages.quality.of_known_points import known_points
from truing.stages.quality.of_scale import bar_lengths, scale, target_sizes

if TYPE_CHECKING:
    import pyarrow as pa


_FEWEST_RAYS = 3
_WORST = 0.1
_BEYOND_CHANCE = 1e-3
_MATTERS = 0.1  # of the noise of a ray: a mean residual below it bends no point by more than noise does
_KNOWN = 3.0  # standard deviations by which a noise has to be off its stated one to count


def photograph_checks(tables: Mapping[str, pa.Table], limits: CampaignLimits) -> Iterator[Check]:
    """Every check of the network; none where the campaign's points do not come out of photographs."""
    if "bundle_statistics" not in tables:
        return
    figures = Figures(tables["bundle_statistics"])
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
        said = (
            f"pose {pose}: {len(all_of_pose) - len(lost)} of "
            f"{counted(len(all_of_pose), 'photograph')} with an orientation"
        )
        said += f"; without: {listed(lost)}." if lost else "."
        yield limit.row(f"pose {pose}", len(lost) / len(all_of_pose), "1", said)


def _rays_per_point(subject: str, points: pa.Table, limits: CampaignLimits) -> Check:
    rays = number_column(points, "rays")
    few = text_column(points, "point")[rays < _FEWEST_RAYS]
    said = f"{subject}: {counted(len(rays), 'point')}, {np.median(rays):.0f} rays each in the middle"
    said += f"; fewer than three to {listed(few.tolist())}." if len(few) else ", three or more to all."
    return limits.of("rays-per-point").row(subject, len(few) / len(rays), "1", said)


def _angles(subject: str, points: pa.Table, limits: CampaignLimits) -> Check:
    angle = number_column(points, "largest_angle_deg")
    worst = float(np.quantile(angle, _WORST))
    name = text_column(points, "point")[int(np.argmin(angle))]
    said = f"{subject}: rays meet at {np.median(angle):.0f} deg in the middle, those to the worst-placed tenth of the "
    said += f"points at {worst:.0f} deg at most; least at {name}, {angle.min():.1f} deg."
    return limits.of("intersection-angles").row(subject, worst, "deg", said)


def _coverage(camera: str, figures: Figures, limits: CampaignLimits) -> Check:
    share = figures.told("covered share of the format").get(camera, 0.0)
    said = f"Camera {camera}: image points lie in {100 * share:.0f} % of its format's cells."
    return limits.of("format-coverage").row(f"camera {camera}", share, "1", said)


def _rejected(camera: str, residuals: pa.Table, limits: CampaignLimits) -> Check:
    """Of rays to points with a name: circles that no other image shows are no rejected rays."""
    named = text_column(residuals, "point") != ""
    rejected = np.asarray(residuals.column("rejected").to_pylist(), dtype=bool) & named
    count = int(named.sum())
    image = text_column(residuals, "image")[rejected]
    names, times = np.unique(image.astype(str), return_counts=True)
    first = [f"{name} ({k})" for k, name in sorted(zip(times.tolist(), names.tolist(), strict=True), reverse=True)[:3]]
    said = f"Camera {camera}: {int(rejected.sum())} of {count} rays are left out"
    said += f", most in {', '.join(first)}." if first else "."
    return limits.of("rejected-rays").row(f"camera {camera}", rejected.sum() / max(count, 1), "1", said)


def _systematic(camera: str, figures: Figures, residuals: pa.Table) -> Check:
    subject = f"camera {camera}"
    p_value = figures.told("systematic residuals, p-value").get(camera)
    mean = figures.told("systematic residuals, largest mean").get(camera)
    if p_value is None or mean is None:
        return without("residuals by region", "residuals-systematic", subject, "no ray is left")
    sigma = float(np.median(number_column(rows_of(residuals, "camera", camera), "sigma_x_px")))
    trips = p_value < _BEYOND_CHANCE and mean > _MATTERS * sigma
    said = f"Camera {camera}: the largest mean residual of a part of its format is {mean:.3f} px"
    said += f" (p = {p_value:.2g} of all parts together), the noise of a ray {sigma:.3f} px."
    return Check("residuals-systematic", subject, p_value, _BEYOND_CHANCE, "1", WARN if trips else PASS, said)


def _noise(figures: Figures, limits: CampaignLimits) -> Iterator[Check]:
    limit = limits.of("image-noise")
    spread = figures.told("noise over stated, sigma")
    for subject, ratio in figures.told("noise over stated").items():
        off = max(ratio, 1.0 / ratio)
        sigma = spread.get(subject, 0.0)
        said = f"{subject}: the noise of image coordinates is {ratio:.2f} ± {sigma:.2f} times what is stated."
        yield limit.row(subject, off, "times", said, counts=abs(ratio - 1.0) > _KNOWN * sigma)
