"""Stage bundle: rays of photographs give object points, orientations and cameras with full covariance."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from truing.report.numbers import count_text
from truing.schemas.faults import CampaignFaults
from truing.schemas.photograph_artifacts import FROM_MARKER
from truing.stages.declaration import Outcome, Progress, Stage

if TYPE_CHECKING:
    import pyarrow as pa

    from truing.formats.source import CampaignFiles
    from truing.schemas.campaign import Campaign

DECLARATION = Stage(
    name="bundle",
    reads=("image_points", "photographs", "image_targets?", "scale_bars?", "known_points?", "cameras_given?"),
    leaves=(
        *("object_points", "point_correlations", "point_sensitivities", "cameras", "camera_correlations"),
        *("image_orientations", "image_residuals", "scale_bar_lengths?", "known_point_errors?", "image_cameras"),
        *("bundle_statistics", "ray_statistics", "ray_information", "ray_effects"),
    ),
    settings=(
        *("photographs.datum", "photographs.false_alarm", "photographs.variance_components"),
        *("photographs.marker_mm", "photographs.target_mm", "photographs.boards", "photographs.eccentricity"),
        *("bodies.reference", "mechanism.type", "noise.point_mm", "files.targets"),
    ),
    summary="bundle adjustment of the rays of all photographs: object points, cameras, rejected rays",
)


def run(tables: Mapping[str, pa.Table], settings: Campaign, progress: Progress, source: CampaignFiles) -> Outcome:
    """The adjusted network as tables; raises CampaignFaults if the rays form no network."""
    from truing.estimation.bundle.determinable import UndeterminedNetworkError
    from truing.estimation.bundle.named_adjustment import Choices, KnownPointMismatchError, adjust_network
    from truing.stages.bundle_adjustment import statistics
    from truing.stages.bundle_adjustment.rays_as_network import given_cameras, image_points, named_network, radii
    from truing.stages.bundle_adjustment.survey_distances import (
        PRINTED_TO,
        surveyed_points,
        unobserved_bars,
        with_scale,
    )
    from truing.stages.bundle_adjustment.tables import NetworkTables, faults_of, known_points_table, undetermined
    from truing.stages.common.ray_statistics import ray_tables

    given = settings.photographs
    unseen = unobserved_bars(tables.get("scale_bars"), tables["image_points"])
    tables = with_scale(tables, settings, source)
    photographs, bars = tables["photographs"], tables.get("scale_bars")
    rays = image_points(tables["image_points"], photographs)
    cameras, interior = given_cameras(photographs, tables.get("cameras_given"))
    named = named_network(rays, photographs, cameras, tables, given.marker_mm)
    radius_m = radii(tables.get("image_targets"), given.target_mm)
    choices = Choices(given.datum, given.false_alarm, given.variance_components, given.eccentricity, radius_m)
    try:
        adjusted_network = adjust_network(named, rays, interior, choices, progress)
        survey = surveyed_points(source, frozenset(map(str, adjusted_network.named.points)), settings)
        network_tables = NetworkTables(
            adjusted_network, rays, frozenset() if survey is None else frozenset(survey.names.tolist())
        )
        artifacts = network_tables.all(bars)
    except KnownPointMismatchError as error:
        raise CampaignFaults(faults_of(error)) from None
    except UndeterminedNetworkError as error:
        raise CampaignFaults([undetermined(error, len(rays.point), named.network.rays.count)]) from None
    artifacts["image_cameras"], of_cameras = statistics.image_cameras(adjusted_network)
    of_scale = statistics.scale_sources(adjusted_network, bars, survey)
    artifacts["bundle_statistics"] = statistics.statistics_table(adjusted_network, [*of_cameras, *of_scale])
    adjusted = adjusted_network.adjustment
    if adjusted.datum == "known" and "known_points" in tables:
        artifacts["known_point_errors"] = known_points_table(named, adjusted_network.known, adjusted.used)
    named = adjusted_network.named
    artifacts |= ray_tables(adjusted.observed, adjusted.state, named.poses, named.points.tolist(), named.bars)
    read = f"{count_text(len(rays.point), 'ray')} of {count_text(len(photographs), 'image')}"
    if settings.noise.point_mm is None and any(bar.startswith(FROM_MARKER) for bar in named.bars):
        read += (
            f"; sizes of markers and boards assumed known to {PRINTED_TO:.1%}, because [noise] point_mm is not declared"
        )
    figure = statistics.main_figure(adjusted_network)
    return Outcome(
        artifacts,
        read=read,
        left_out=statistics.left_out(adjusted_network, [*unseen, *network_tables.unpaired()]),
        figure=figure,
    )
