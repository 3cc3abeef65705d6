"""Figures of an adjustment and of its network, one row each."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from truing.estimation.bundle.named_adjustment import AdjustedNetwork
from truing.estimation.bundle.network_statistics import camera_coverage, residual_regions
from truing.estimation.bundle.variance_components import POOLED, VarianceComponents
from truing.schemas.artifacts import ARTIFACTS
from truing.schemas.photograph_artifacts import FROM_MARKER

if TYPE_CHECKING:
    import pyarrow as pa

Figure = tuple[str, str, float | None, str]

_SIMILARITY = 7  # freedoms of a pose whose scale nothing gives, either


def statistics_table(found: AdjustedNetwork, more: Sequence[Figure] = ()) -> pa.Table:
    """The table bundle_statistics, with more figures behind those of the adjustment."""
    import pyarrow as pa

    adjusted, snooped, named = found.adjustment, found.snooped, found.named
    used, rays = adjusted.used, named.network.rays
    unknowns = 2 * int(used.sum()) + int(adjusted.defect.sum()) - adjusted.redundancy
    figures = [
        ("sigma0", "", float(np.sqrt(snooped.sigma0.variance_factor)), "1"),
        ("sigma0, p-value", "", snooped.sigma0.p_value, "1"),
        ("redundancy", "", float(adjusted.redundancy), "1"),
        ("rays", "", float(used.sum()), "1"),
        ("rejected rays", "", float(rays.count - used.sum()), "1"),
        ("untested rays", "", float(len(snooped.untested)), "1"),
        ("circles without a point", "", float(len(found.unmatched)), "1"),
        ("unknowns less distances and known coordinates", "", float(unknowns), "1"),
        ("defect of the datum", "", float(adjusted.defect.sum()), "1"),
        ("iterations", "", float(adjusted.iterations), "1"),
        ("converged", "", float(adjusted.converged), "1"),
        ("false alarm of a ray's test", "", float(snooped.alpha), "1"),
        ("false alarm of all rays' tests", "", float(snooped.family_level), "1"),
        *_components(found, snooped.components),
        *_coverage(found),
        *_regions(found),
        *_origins(found),
        *_sizes(found),
        *more,
    ]
    rows = [
        dict(zip(("figure", "subject", "value", "unit"), figure, strict=True))
        for figure in figures
        if figure[2] is None or np.isfinite(figure[2])
    ]
    return pa.Table.from_pylist(rows, schema=ARTIFACTS["bundle_statistics"].arrow_schema())


def _components(found: AdjustedNetwork, components: VarianceComponents) -> list[Figure]:
    """What each camera and kind of target scatters over what is stated, and how well that is known."""
    cameras, kinds = found.named.network.cameras, found.named.kinds
    rows: list[Figure] = []
    for g, factor in enumerate(components.factor):
        camera = "several cameras" if components.camera[g] == POOLED else cameras[components.camera[g]].name
        kind = "several kinds" if components.kind[g] == POOLED else kinds[components.kind[g]]
        subject = f"{camera} {kind}"
        relative = components.sigma[g] / (2 * factor) if factor > 0 else np.inf
        rows.append(("noise over stated", subject, float(np.sqrt(factor)), "1"))
        rows.append(("noise over stated, sigma", subject, float(np.sqrt(factor) * relative), "1"))
        rows.append(("redundancy of a component", subject, float(components.redundancy[g]), "1"))
    return rows


def _coverage(found: AdjustedNetwork) -> list[Figure]:
    network = found.named.network
    coverage = camera_coverage(network, found.adjustment.used.astype(float))
    named = list(enumerate(network.cameras))
    rows: list[Figure] = [("covered share of the format", c.name, float(coverage.cells[n]), "1") for n, c in named]
    return rows + [("hull over the format", c.name, float(coverage.hull[n]), "1") for n, c in named]


def _regions(found: AdjustedNetwork) -> list[Figure]:
    """What residuals keep in common in some part of the format: the least p-value of each camera."""
    adjusted = found.adjustment
    network = adjusted.network
    C = network.rays.cov_px2 * found.snooped.components.of_rays()[:, None, None]
    residuals = np.where(adjusted.used[:, None], adjusted.residuals_px, np.nan)
    regions = residual_regions(network, residuals, np.where(adjusted.used[:, None, None], C, 1.0))
    rows: list[Figure] = []
    for number, camera in enumerate(network.cameras):
        own = regions.camera == number
        if own.any():
            worst = np.linalg.norm(regions.mean_px[own], axis=1).max()
            rows.append(("systematic residuals, p-value", camera.name, float(regions.p_value[own].min()), "1"))
            rows.append(("systematic residuals, largest mean", camera.name, float(worst), "px"))
    return rows


def _origins(found: AdjustedNetwork) -> list[Figure]:
    """What gives each pose its scale; 1 behind each. Known points that are no datum give it to the start alone."""
    poses, free = found.named.poses, found.adjustment.defect == _SIMILARITY
    scales = ["none" if free[p] else scale for p, scale in enumerate(found.start.scale)]
    return [(f"scale from {scale}", f"pose {poses[p]}", 1.0, "1") for p, scale in enumerate(scales)]


def _sizes(found: AdjustedNetwork) -> list[Figure]:
    """How large targets are over what is stated of them, in the middle: circles, and markers where these do not give
    the scale."""
    markers, points = found.named.markers, found.adjustment.state.points[found.named.markers.corners]
    stated = markers.size_m > 0.0
    edges = np.linalg.norm(points - np.roll(points, -1, axis=1), axis=-1).mean(axis=1)
    sizes = {"circles": found.width_over_stated}
    if not any(bar.startswith(FROM_MARKER) for bar in found.named.bars) and "markers" not in found.start.scale:
        sizes["markers"] = edges[stated] / markers.size_m[stated]
    known = {kind: own[np.isfinite(own)] for kind, own in sizes.items()}
    return [("size over stated", kind, float(np.median(own)), "1") for kind, own in known.items() if len(own)]
