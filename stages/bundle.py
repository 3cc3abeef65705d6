"""Bundle: rays of photographs become object points, orientations and cameras, with their whole covariance."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from truing.report.numbers import count as counted
from truing.schemas.faults import CampaignFaults, Fault
from truing.schemas.photograph_artifacts import FROM_MARKER
from truing.stages.declaration import Outcome, Progress, Stage

if TYPE_CHECKING:
    import pyarrow as pa

    from truing.estimation.bundle.named_adjustment import AdjustedNetwork
    from truing.formats.source import CampaignFiles

DECLARATION = Stage(
    name="bundle",
    reads=("image_points", "photographs", "image_targets?", "scale_bars?", "known_points?", "cameras_given?"),
    leaves=(
        *("object_points", "point_correlations", "point_sensitivities", "cameras", "camera_correlations"),
        *(
            "image_orientations",
            "image_residuals",
            "scale_bar_lengths?",
            "known_point_errors?",
            "image_cameras",
            "bundle_statistics",
        ),
        *("ray_statistics", "ray_information", "ray_effects"),
    ),
    settings=(
        *("photographs.datum", "photographs.false_alarm", "photographs.variance_components"),
        *("photographs.marker_mm", "photographs.target_mm", "photographs.boards", "photographs.eccentricity"),
        *("bodies.reference", "mechanism.type", "noise.point_mm", "files.targets"),
    ),
    summary="adjusts the rays of all photographs together: object points, cameras, what is wrong with which ray",
)


def run(tables: Mapping[str, pa.Table], settings: Any, progress: Progress, source: CampaignFiles) -> Outcome:
    """The adjusted network as tables; raises CampaignFaults where the rays do not make one."""
    from truing.estimation.bundle.determinable import UndeterminedNetworkError
    from truing.estimation.bundle.named_adjustment import Choices, KnownElsewhereError, adjust_network
    from truing.stages.bundle_adjustment.rays_as_network import given_cameras, image_points, named_network
    from truing.stages.bundle_adjustment.statistics import image_cameras, scale_sources, statistics_table
    from truing.stages.bundle_adjustment.survey_distances import (
        PRINTED_TO,
        Printed,
        Survey,
        never_seen,
        surveyed_points,
        with_scale,
    )
    from truing.stages.bundle_adjustment.tables import NetworkTables, faults_of, known_points_table
    from truing.stages.common.ray_statistics import ray_tables

    given = settings.photographs
    known = given.datum == "known" and "known_points" in tables
    unseen = never_seen(tables.get("scale_bars"), tables["image_points"])
    tables = with_scale(tables, Survey.of(settings), source, Printed(given.marker_mm, given.boards), known=known)
    photographs = tables["photographs"]
    rays = image_points(tables["image_points"], photographs)
    cameras = given_cameras(photographs, tables.get("cameras_given"))
    named = named_network(rays, photographs, cameras, tables, given.marker_mm)
    radii = _radii(tables.get("image_targets"), given.target_mm)
    choices = Choices(given.datum, given.false_alarm, given.variance_components, given.eccentricity, radii)
    try:
        found = adjust_network(named, rays, cameras.interior, choices, progress)
        artifacts = NetworkTables(found, rays).all(tables.get("scale_bars"))
    except KnownElsewhereError as error:
        raise CampaignFaults(faults_of(error)) from None
    except UndeterminedNetworkError as error:
        expected = "rays that make a network: images that see points in common, from different sides"
        if not named.network.rays.count:  # circles find each other along lines of sight of images that codes oriented
            expected = (
                f"targets with a code or a name, four in common to neighbouring images; none of {len(rays.point):,} "
            )
            raise CampaignFaults([Fault("image_points", f"{expected}rays has one", column="point")]) from None
        raise CampaignFaults([Fault("image_points", expected, value=str(error))]) from None
    points = frozenset(map(str, found.named.points))
    artifacts["image_cameras"], of_cameras = image_cameras(found)
    artifacts["bundle_statistics"] = statistics_table(
        found, [*of_cameras, *scale_sources(found, tables.get("scale_bars"), surveyed_points(source, points))]
    )
    adjusted = found.adjustment
    if known:
        artifacts["known_point_errors"] = known_points_table(named, named.network, found.known, adjusted.used)
    named = found.named
    artifacts |= ray_tables(adjusted.observed, adjusted.state, named.poses, named.points.tolist(), named.bars)
    read = f"{counted(len(rays.point), 'ray')} of {counted(len(photographs), 'image')}"
    if settings.noise.point_mm is None and any(bar.startswith(FROM_MARKER) for bar in named.bars):
        read += f"; sizes of markers and boards counted as known to {PRINTED_TO:.1%}, for lack of [noise] point_mm"
    return Outcome(artifacts, read=read, left_out=_left_out(found, unseen), figure=_figure(found))


def _radii(targets: pa.Table | None, target_mm: float | None) -> dict[str, float]:
    """The radii in m of circular targets by the names of their points; of those that no table tells under ""."""
    radii = {} if target_mm is None else {"": 0.5e-3 * target_mm}
    if targets is None or "diameter_mm" not in targets.column_names:
        return radii
    rows = targets.select(["body", "target", "diameter_mm"]).to_pylist()
    return radii | {f"{row['body']}/{row['target']}": 0.5e-3 * row["diameter_mm"] for row in rows if row["diameter_mm"]}


def _left_out(found: AdjustedNetwork, unseen: list[str]) -> str:
    reasons = Counter([*found.snooped.rejected.reason, *found.unmatched_reason])
    said = [f"{counted(count, 'ray')}: {reason}" for reason, count in reasons.most_common()]
    held = ", ".join(f"{camera} {element}" for camera, element in found.snooped.held)
    said += [f"held, since these images do not determine them: {held}"] if held else []
    return "; ".join([*said, *unseen]) or "nothing"


def _figure(found: AdjustedNetwork) -> str:
    adjusted = found.adjustment
    sigma0 = found.snooped.sigma0.variance_factor**0.5
    points = set(found.named.network.rays.point[adjusted.used].tolist())
    count = len({int(found.named.network.point_pose[point]) for point in points})
    poses = counted(count, "pose")
    return f"{counted(len(points), 'object point')} of {poses}, redundancy {adjusted.redundancy:,}, sigma0 {sigma0:.3f}"
