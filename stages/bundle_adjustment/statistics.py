"""Figures of an adjustment, one row each: network, sources of scale, stability of cameras."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np
import pyarrow as pa

from truing.arrays import Array
from truing.estimation.bundle.image_stability import image_stability, moved_by_settings
from truing.estimation.bundle.named_adjustment import AdjustedNetwork
from truing.estimation.bundle.network import NetworkState
from truing.estimation.bundle.network_statistics import camera_coverage, residual_regions
from truing.estimation.bundle.start_values import scale_ratio
from truing.estimation.bundle.variance_components import POOLED_GROUPS, VarianceComponents
from truing.report.numbers import count_text
from truing.schemas.artifacts import ARTIFACTS
from truing.schemas.photograph_artifacts import BENT, FROM_MARKER, FROM_SURVEY, LENGTH, LENGTH_SIGMA, SHARED
from truing.stages.bundle_adjustment.survey_distances import SurveyedPoints
from truing.stages.bundle_adjustment.tables import table_of_rows

Figure = tuple[str, str, float | None, str]

_SIMILARITY = 7  # degrees of freedom of a pose without scale
_FEWEST = 4  # points of a body; fewer give no scale


def statistics_table(adjustment: AdjustedNetwork, more: Sequence[Figure]) -> pa.Table:
    """The table bundle_statistics, with more figures behind those of the adjustment."""
    adjusted, snooped, named = adjustment.adjustment, adjustment.screened, adjustment.named
    used, rays = adjusted.used, named.network.rays
    unknowns = 2 * int(used.sum()) + int(adjusted.defect.sum()) - adjusted.redundancy
    figures = [
        ("sigma0", "", float(np.sqrt(snooped.sigma0.variance_factor)), "1"),
        ("sigma0, p-value", "", snooped.sigma0.p_value, "1"),
        ("redundancy", "", float(adjusted.redundancy), "1"),
        ("rays", "", float(used.sum()), "1"),
        ("rejected rays", "", float(rays.count - used.sum()), "1"),
        ("untested rays", "", float(len(snooped.untested)), "1"),
        ("circles without a point", "", float(len(adjustment.unmatched)), "1"),
        ("unknowns less distances and known coordinates", "", float(unknowns), "1"),
        ("defect of the datum", "", float(adjusted.defect.sum()), "1"),
        ("iterations", "", float(adjusted.iterations), "1"),
        ("converged", "", float(adjusted.converged), "1"),
        ("false alarm of a ray's test", "", float(snooped.alpha), "1"),
        ("false alarm of all rays' tests", "", float(snooped.family_level), "1"),
        *_components(adjustment, snooped.components),
        *_coverage(adjustment),
        *_regions(adjustment),
        *_origins(adjustment),
        *_sizes(adjustment),
        *more,
    ]
    rows = [
        dict(zip(("figure", "subject", "value", "unit"), figure, strict=True))
        for figure in figures
        if figure[2] is None or np.isfinite(figure[2])
    ]
    return pa.Table.from_pylist(rows, schema=ARTIFACTS["bundle_statistics"].arrow_schema())


def _components(adjusted: AdjustedNetwork, components: VarianceComponents) -> list[Figure]:
    """Noise of each camera and kind of target over the stated noise, with its uncertainty."""
    cameras, kinds = adjusted.named.network.cameras, adjusted.named.kinds
    rows: list[Figure] = []
    for g, factor in enumerate(components.factor):
        camera = "several cameras" if components.camera[g] == POOLED_GROUPS else cameras[components.camera[g]].name
        kind = "several kinds" if components.kind[g] == POOLED_GROUPS else kinds[components.kind[g]]
        subject = f"{camera} {kind}"
        relative = components.sigma[g] / (2 * factor) if factor > 0 else np.inf
        rows.append(("noise over stated", subject, float(np.sqrt(factor)), "1"))
        rows.append(("noise over stated, sigma", subject, float(np.sqrt(factor) * relative), "1"))
        rows.append(("redundancy of a component", subject, float(components.redundancy[g]), "1"))
    return rows


def _coverage(adjusted: AdjustedNetwork) -> list[Figure]:
    network = adjusted.named.network
    coverage = camera_coverage(network, adjusted.adjustment.used)
    named = list(enumerate(network.cameras))
    rows: list[Figure] = [("covered share of the format", c.name, float(coverage.cells[n]), "1") for n, c in named]
    return rows + [("hull over the format", c.name, float(coverage.hull[n]), "1") for n, c in named]


def _regions(adjustment: AdjustedNetwork) -> list[Figure]:
    """Common part of residuals in regions of the format: least p-value of each camera."""
    adjusted = adjustment.adjustment
    network = adjusted.network
    C = network.rays.cov_px2 * adjustment.screened.components.ray_factors()[:, None, None]
    residuals = np.where(adjusted.used[:, None], adjusted.residuals_px, np.nan)
    regions = residual_regions(network, residuals, np.where(adjusted.used[:, None, None], C, 1.0))
    rows: list[Figure] = []
    for number, camera in enumerate(network.cameras):
        in_camera = regions.camera == number
        if in_camera.any():
            worst = np.linalg.norm(regions.mean_px[in_camera], axis=1).max()
            rows.append(("systematic residuals, p-value", camera.name, float(regions.p_value[in_camera].min()), "1"))
            rows.append(("systematic residuals, largest mean", camera.name, float(worst), "px"))
    return rows


def _origins(adjusted: AdjustedNetwork) -> list[Figure]:
    """Source of each pose's scale; value 1 for each. Known points outside the datum give only the initial scale."""
    poses, free = adjusted.named.poses, adjusted.adjustment.defect == _SIMILARITY
    scales = ["none" if free[p] else scale for p, scale in enumerate(adjusted.start.scale)]
    return [(f"scale from {scale}", f"pose {poses[p]}", 1.0, "1") for p, scale in enumerate(scales)]


def _sizes(adjusted: AdjustedNetwork) -> list[Figure]:
    """Median ratio of measured to stated target sizes: circles, and markers that do not give the scale."""
    markers, points = adjusted.named.markers, adjusted.adjustment.state.points[adjusted.named.markers.corners]
    stated = markers.size_m > 0.0
    edges = np.linalg.norm(points - np.roll(points, -1, axis=1), axis=-1).mean(axis=1)
    sizes = {"circles": adjusted.width_over_stated}
    if not any(bar.startswith(FROM_MARKER) for bar in adjusted.named.bars) and "markers" not in adjusted.start.scale:
        sizes["markers"] = edges[stated] / markers.size_m[stated]
    known = {kind: size[np.isfinite(size)] for kind, size in sizes.items()}
    return [("size over stated", kind, float(np.median(size)), "1") for kind, size in known.items() if len(size)]


def scale_sources(adjusted: AdjustedNetwork, bars: pa.Table | None, survey: SurveyedPoints | None) -> list[Figure]:
    """Figures: lengths of each bar, of the survey and of known points over those of the rays, as median over all poses,
    with sigma.

    A factor common to all of them is the scale of the rays.
    """
    state = adjusted.screened.by_rays.state
    ratios: dict[str, list[tuple[float, float]]] = {}
    for pose in range(len(adjusted.named.poses)):
        numbers = np.flatnonzero(adjusted.named.network.point_pose == pose)
        points = {str(adjusted.named.points[n]): state.points[n] for n in numbers if np.isfinite(state.points[n, 0])}
        for name, ratio, sigma in (
            *_lengths_of_bars(points, bars),
            *_lengths_of_survey(points, survey),
            *_known_point_lengths(adjusted, state, pose),
        ):
            ratios.setdefault(name, []).append((ratio, sigma))
    figures: list[Figure] = []
    for name, values in ratios.items() if len(ratios) > 1 else ():
        ratio, sigma = np.array(values).T
        spread = float(np.std(ratio) / np.sqrt(len(ratio))) if len(ratio) > 1 else 0.0
        figures.append((LENGTH, name, float(np.median(ratio)), "1"))
        figures.append((LENGTH_SIGMA, name, float(np.hypot(np.median(sigma), spread)), "1"))
    return figures


def _lengths_of_bars(points: dict[str, Array], bars: pa.Table | None) -> list[tuple[str, float, float]]:
    lengths = []
    for row in [] if bars is None else bars.to_pylist():
        if row["bar"].startswith((FROM_SURVEY, FROM_MARKER)) or not {row["first"], row["second"]} <= points.keys():
            continue
        length = 1e3 * float(np.linalg.norm(points[row["second"]] - points[row["first"]]))
        sigma = float(np.hypot(row["sigma_mm"], row["repeat_sigma_mm"] or 0.0)) / row["length_mm"]
        lengths.append((f"bar {row['bar']}", row["length_mm"] / length, sigma))
    return lengths


def _lengths_of_survey(points: dict[str, Array], survey: SurveyedPoints | None) -> list[tuple[str, float, float]]:
    """Survey of each body with enough targets in a pose, assumed rigid."""
    if survey is None:
        return []
    lengths = []
    for body in dict.fromkeys(survey.bodies.tolist()):
        places_of_body = [k for k in np.flatnonzero(survey.bodies == body) if survey.names[k] in points]
        if len(places_of_body) >= _FEWEST:
            reported = scale_ratio(
                np.array([points[survey.names[k]] for k in places_of_body]), 1e-3 * survey.xyz_mm[places_of_body]
            )
            lengths += [(f"survey of {body}", *reported)] if reported else []
    return lengths


def _known_point_lengths(adjusted: AdjustedNetwork, state: NetworkState, pose: int) -> list[tuple[str, float, float]]:
    """Known points whose shape agrees with the rays."""
    network = adjusted.adjustment.network
    is_of_pose = network.point_pose[network.known.point] == pose
    rows = np.flatnonzero(is_of_pose & np.isfinite(state.points[network.known.point, 0]))
    if adjusted.adjustment.datum != "known" or len(rows) < _FEWEST:
        return []
    reported = scale_ratio(state.points[network.known.point[rows]], network.known.xyz_m[rows])
    return [("known points", *reported)] if reported else []


def image_cameras(adjusted: AdjustedNetwork) -> tuple[pa.Table, list[tuple[str, str, float, str]]]:
    """Table image_cameras, one row per image whose rays determine its principal distance; and figures: a p-value per
    camera, and the shift of each pose's points if deviating images get a separate camera."""
    named, network = adjusted.named, adjusted.adjustment.network
    stable = image_stability(adjusted.screened.by_rays, adjusted.screened.components.ray_factors())
    rows = [
        {
            "pose": named.poses[network.image_pose[image]],
            "image": str(named.images[image]),
            "camera": network.cameras[setting.camera].name,
            "principal_distance_off_px": float(setting.off_px[k]),
            "principal_distance_sigma_px": float(setting.sigma_px[k]),
            "setting": int(setting.setting[k]),
        }
        for setting in stable
        for k, image in enumerate(setting.images.tolist())
    ]
    figures = [(SHARED, network.cameras[setting.camera].name, setting.p_value, "1") for setting in stable]
    moved = [(BENT, f"pose {named.poses[pose]}", value, "1") for pose, value in moved_by_settings(adjusted, stable)]
    return table_of_rows("image_cameras", rows, named), figures + moved


def left_out(adjusted: AdjustedNetwork, unseen: Sequence[str]) -> str:
    """Rejected rays with reasons, fixed camera parameters, and bars that no pose shows, in words."""
    reasons = Counter([*adjusted.screened.rejected.reason, *adjusted.unmatched_reason])
    texts = [f"{count_text(count, 'ray')}: {reason}" for reason, count in reasons.most_common()]
    fixed_elements = ", ".join(f"{camera} {element}" for camera, element in adjusted.screened.fixed_elements)
    texts += [f"kept fixed, because these images do not determine them: {fixed_elements}"] if fixed_elements else []
    return "; ".join([*texts, *unseen]) or "nothing"


def main_figure(adjustment: AdjustedNetwork) -> str:
    """Size and fit of the adjustment, in words."""
    adjusted = adjustment.adjustment
    sigma0 = adjustment.screened.sigma0.variance_factor**0.5
    points = set(adjustment.named.network.rays.point[adjusted.used].tolist())
    poses = count_text(len({int(adjustment.named.network.point_pose[point]) for point in points}), "pose")
    return (
        f"{count_text(len(points), 'object point')} of {poses}, redundancy {adjusted.redundancy:,}, sigma0 {sigma0:.3f}"
    )
