"""The network that photographs make: rays, angles, format, noise, rejected rays, cameras, scale bars."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from stages.point_arrays import number_column, text_column
from stages.quality.check import PASS, WARN, Check, listed, without
from stages.quality.limits import CampaignLimits
from stages.quality.of_cameras import camera_stability
from truing.estimation.bundle.length_errors import LengthErrors, length_errors

if TYPE_CHECKING:
    import pyarrow as pa

Array = NDArray[np.float64]

_FEWEST_RAYS = 3
_WORST = 0.1
_BEYOND_CHANCE = 1e-3
_MATTERS = 0.1  # of the noise of a ray: a mean residual below it bends no point by more than noise does
_KNOWN = 3.0  # standard deviations by which a noise has to be off its stated one to count


def photograph_checks(tables: Mapping[str, pa.Table], limits: CampaignLimits) -> Iterator[Check]:
    """Every check of the network; none where the campaign's points do not come out of photographs."""
    if "bundle_statistics" not in tables:
        return
    figures = _Figures(tables["bundle_statistics"])
    points, residuals = tables["object_points"], tables["image_residuals"]
    yield from _oriented(tables["photographs"], tables["image_orientations"], limits)
    yield from _scale(figures)
    for pose in dict.fromkeys(points.column("pose").to_pylist()):
        rows = _of(points, "pose", pose)
        yield _rays_per_point(f"pose {pose}", rows, limits)
        yield _angles(f"pose {pose}", rows, limits)
    for camera in dict.fromkeys(residuals.column("camera").to_pylist()):
        yield _coverage(camera, figures, limits)
        yield _rejected(camera, _of(residuals, "camera", camera), limits)
        yield _systematic(camera, figures, residuals)
    yield from _noise(figures, limits)
    yield from camera_stability(tables.get("ray_statistics"), tables.get("ray_information"))
    yield from _bars(tables.get("scale_bar_lengths"), limits)


class _Figures:
    """The rows of bundle_statistics by figure and subject."""

    def __init__(self, table: pa.Table) -> None:
        rows = zip(*(table.column(name).to_pylist() for name in ("figure", "subject", "value")), strict=True)
        self.values: dict[str, dict[str, float]] = {}
        for figure, subject, value in rows:
            self.values.setdefault(figure, {})[subject] = value

    def told(self, figure: str) -> dict[str, float]:
        """Values by subject."""
        return self.values.get(figure, {})


def _of(table: pa.Table, column: str, value: object) -> pa.Table:
    import pyarrow.compute as pc

    return table.filter(pc.equal(table.column(column), value))


def _oriented(photographs: pa.Table, orientations: pa.Table, limits: CampaignLimits) -> Iterator[Check]:
    keys = ("pose", "image")
    known = set(zip(*(orientations.column(key).to_pylist() for key in keys), strict=True))
    images: dict[object, list[str]] = {}
    for pose, image in zip(*(photographs.column(key).to_pylist() for key in keys), strict=True):
        images.setdefault(pose, []).append(image)
    limit = limits.of("images-oriented")
    for pose, all_of_pose in images.items():
        lost = [image for image in all_of_pose if (pose, image) not in known]
        said = f"pose {pose}: {len(all_of_pose) - len(lost)} of {len(all_of_pose)} photographs have an orientation"
        said += f"; without: {listed(lost)}." if lost else "."
        yield limit.row(f"pose {pose}", len(lost) / len(all_of_pose), "1", said)


def _scale(figures: _Figures) -> Iterator[Check]:
    free = list(figures.told("scale from none"))
    known = sum(len(figures.told(f"scale from {what}")) for what in ("scale bars", "known points", "markers"))
    said = f"{known} poses have a scale."
    if free:
        said = f"Nothing gives the scale of {listed(free)}: all lengths there are open together."
    yield Check("scale", "", float(len(free)), 0.0, "1", "fail" if free else PASS, said)


def _rays_per_point(subject: str, points: pa.Table, limits: CampaignLimits) -> Check:
    rays = number_column(points, "rays")
    few = text_column(points, "point")[rays < _FEWEST_RAYS]
    said = f"{subject}: {len(rays)} points, {np.median(rays):.0f} rays each in the middle"
    said += f"; fewer than three to {listed(few.tolist())}." if len(few) else ", three or more to all."
    return limits.of("rays-per-point").row(subject, len(few) / len(rays), "1", said)


def _angles(subject: str, points: pa.Table, limits: CampaignLimits) -> Check:
    angle = number_column(points, "largest_angle_deg")
    worst = float(np.quantile(angle, _WORST))
    name = text_column(points, "point")[int(np.argmin(angle))]
    said = f"{subject}: rays meet at {np.median(angle):.0f} deg in the middle, those to the worst-placed tenth of the "
    said += f"points at {worst:.0f} deg at most; least at {name}, {angle.min():.1f} deg."
    return limits.of("intersection-angles").row(subject, worst, "deg", said)


def _coverage(camera: str, figures: _Figures, limits: CampaignLimits) -> Check:
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


def _systematic(camera: str, figures: _Figures, residuals: pa.Table) -> Check:
    subject = f"camera {camera}"
    p_value = figures.told("systematic residuals, p-value").get(camera)
    mean = figures.told("systematic residuals, largest mean").get(camera)
    if p_value is None or mean is None:
        return without("residuals by region", "residuals-systematic", subject, "no ray is left")
    sigma = float(np.median(number_column(_of(residuals, "camera", camera), "sigma_x_px")))
    trips = p_value < _BEYOND_CHANCE and mean > _MATTERS * sigma
    said = f"Camera {camera}: the largest mean residual of a part of its format is {mean:.3f} px"
    said += f" (p = {p_value:.2g} of all parts together), the noise of a ray {sigma:.3f} px."
    return Check("residuals-systematic", subject, p_value, _BEYOND_CHANCE, "1", WARN if trips else PASS, said)


def _noise(figures: _Figures, limits: CampaignLimits) -> Iterator[Check]:
    limit = limits.of("image-noise")
    spread = figures.told("noise over stated, sigma")
    for subject, ratio in figures.told("noise over stated").items():
        off = max(ratio, 1.0 / ratio)
        sigma = spread.get(subject, 0.0)
        said = f"{subject}: the noise of image coordinates is {ratio:.2f} ± {sigma:.2f} times what is stated."
        yield limit.row(subject, off, "times", said, counts=abs(ratio - 1.0) > _KNOWN * sigma)


def _bars(lengths: pa.Table | None, limits: CampaignLimits) -> Iterator[Check]:
    if lengths is None or not lengths.num_rows:
        yield without("scale bars", "bar-lengths", "", "no pose shows both ends of any bar")
        yield without("length errors", "length-errors", "", "no reference length checks the scale")
        return
    for bar in dict.fromkeys(lengths.column("bar").to_pylist()):
        yield _bar(bar, _of(lengths, "bar", bar), limits)
    checking = _of(lengths, "serves", "check")
    if not checking.num_rows:
        yield without("length errors", "length-errors", "", "no reference length checks the scale")
        return
    found, length = _errors(checking), number_column(checking, "length_mm")
    error = 1e3 * found.error_m
    relative = 1e6 * error / length
    worst = int(np.argmax(np.abs(relative)))
    said = f"{len(error)} reference lengths from {length.min():.0f} to {length.max():.0f} mm: errors of "
    said += f"{np.sqrt(np.mean(error**2)) * 1e3:.1f} um (rms), {relative[worst]:+.1f} um/m at most ("
    said += f"{checking.column('bar').to_pylist()[worst]} in pose {checking.column('pose').to_pylist()[worst]})."
    said += f" In common they have {1e6 * found.scale:+.1f} ± {1e6 * found.sigma_scale:.1f} um/m."
    said += f" For an acceptance test the guideline asks for more: {'; '.join(found.lacks)}." if found.lacks else ""
    yield limits.of("length-errors").row("", float(np.abs(relative[worst])), "um/m", said)


def _errors(checking: pa.Table) -> LengthErrors:
    """Errors of reference lengths; what poses have in common in them is left to the scale that is told beside."""
    measured, calibrated = number_column(checking, "adjusted_mm"), number_column(checking, "length_mm")
    sigma = 1e-3 * number_column(checking, "adjusted_sigma_mm")
    _, line = np.unique(text_column(checking, "bar").astype(str), return_inverse=True)
    return length_errors(
        1e-3 * measured,
        np.diag(sigma**2),
        1e-3 * calibrated,
        1e-3 * number_column(checking, "sigma_mm"),
        line=line,
    )


def _bar(bar: str, rows: pa.Table, limits: CampaignLimits) -> Check:
    subject = f"bar {bar}"
    deviation, sigma = number_column(rows, "deviation_mm"), number_column(rows, "deviation_sigma_mm")
    told = sigma > 1e-6 * number_column(rows, "length_mm") * 1e-3
    if not told.any():
        why = "it gives the scale alone, so that its adjusted length is the calibrated one"
        return without("deviation of the bar", "bar-lengths", subject, why)
    over = np.where(told, np.abs(deviation) / np.where(told, sigma, 1.0), 0.0)
    worst = int(np.argmax(over))
    said = f"Bar {bar} ({rows.column('serves').to_pylist()[0]}) is {1e3 * deviation[worst]:+.1f} ± "
    said += f"{1e3 * sigma[worst]:.1f} um from its calibrated {number_column(rows, 'length_mm')[worst]:.3f} mm in pose "
    said += f"{rows.column('pose').to_pylist()[worst]}, the furthest of {len(over)} poses."
    return limits.of("bar-lengths").row(subject, float(over[worst]), "sigma", said)
