"""Input of a campaign of points, poses or scans: tables read in turn, each checked against the earlier ones."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, cast

import numpy as np
import pyarrow as pa

from truing.arrays import TableRow
from truing.formats.faultlog import FaultLog
from truing.formats.file_search import words_on_unread_files
from truing.formats.source import CampaignFiles, skipped_files
from truing.report.numbers import count_text
from truing.schemas.artifacts import ARTIFACTS
from truing.schemas.faults import Fault
from truing.stages.common.table_arrays import SmallTable
from truing.stages.declaration import Outcome, Progress
from truing.stages.ingestion.adjusted_points import AdjustedPoints, EstimatedCovariance, in_inner_datum, paired_points
from truing.stages.ingestion.dense_scans import DenseScans, identifier_of, read_scans
from truing.stages.ingestion.later_surveys import LaterSurveys, read_later_surveys, relabelling_of
from truing.stages.ingestion.points import ExpectedPoints, Geometry, Points
from truing.stages.ingestion.pose_table import PoseTable, check_bodies, read_poses
from truing.stages.ingestion.relabelling import PoseTimes, Relabelling, declared_relabelling, relabelled_table
from truing.stages.ingestion.simulated_deformation import read_simulated_deformation
from truing.stages.ingestion.tables import (
    all_left_out,
    check_any_fitted,
    check_survey_noise,
    exclusions,
    left_out_words,
    legs_of,
    read_configurations,
    read_start,
    read_survey,
)

if TYPE_CHECKING:
    from truing.schemas.campaign import Campaign


@dataclass
class _Parts:
    """Tables of a campaign other than its points; None for an absent table."""

    configurations: SmallTable
    survey: SmallTable | None
    start: str | None
    later: LaterSurveys | None = None
    measured: PoseTable | None = None
    scans: DenseScans | None = None
    deformation: pa.Table | None = None

    def artifacts(self) -> dict[str, object]:
        """The tables by artifact."""
        poses = self.configurations.table.column("pose")
        tables = {
            "survey": None if self.survey is None else self.survey.table,
            "start": self.start,
            "configurations": self.configurations.table,
            "scans": None if self.scans is None else self.scans.table(poses),
            "resurveys": None if self.later is None else self.later.table(),
            "measured_poses": None if self.measured is None else self.measured.table,
            "given_deformation": self.deformation,
        }
        return {name: table for name, table in tables.items() if table is not None}

    def left_out(self, *more: Points) -> Counter[tuple[str, str]]:
        """Return the number of rows left out of these tables, and of ``more``, by (subject, reason)."""
        return all_left_out(*more, self.configurations, self.survey, self.later, self.scans, self.measured)

    def outcome(self, read: str, figure: str, **more: pa.Table) -> Outcome:
        """Outcome of a campaign without points."""
        artifacts = {**self.artifacts(), **more, "exclusions": exclusions(self.left_out())}
        return Outcome(artifacts, read, left_out_words(self.left_out()), figure)


def ingest_points(
    tables: Mapping[str, pa.Table],
    settings: Campaign,
    source: CampaignFiles,
    log: FaultLog,
    progress: Progress,
    links: tuple[str, ...] = (),
) -> Outcome:
    """The tables of a campaign of points; raises CampaignFaults, at the end of the stream of points at the latest.

    ``links``: bodies of an open chain, of which alone there may be points.
    """
    adjusted = _adjusted(tables, settings, source, log)
    source.estimate = estimated = EstimatedCovariance()
    parts = _first_tables(settings, source, adjusted, log)
    if adjusted is None and source.has_photographs:  # a campaign is checked before its photographs are adjusted
        log.raise_faults()
        return parts.outcome(
            count_text(len(parts.configurations.table), "configuration"), "points are not adjusted yet"
        )
    if adjusted is None:
        _check_any_points(source, log)
    order = PoseTimes.of(parts.configurations.table)
    parts.later = read_later_surveys(source, settings, parts.survey, order, log)
    if parts.survey is not None and parts.later is not None:
        parts.survey = replace(parts.survey, table=parts.later.survey(parts.survey.table))
    survey = None if parts.survey is None else parts.survey.table
    renamed = declared_relabelling(settings, order, survey, log), relabelling_of(parts.later, order)
    expected = _expected(settings, parts.configurations.table, survey, renamed, links)
    parts.measured = read_poses(source, settings, expected, log)
    parts.scans = read_scans(source, expected.poses, log, progress)
    if adjusted is None and not source.entries("points"):
        return _without_points(parts, expected, log)
    known = {*(parts.scans.bodies if parts.scans else ()), *(parts.measured.bodies if parts.measured else ())}
    return _with_points(parts, Points(source, log, expected.without(known), progress, adjusted), estimated)


def _first_tables(settings: Campaign, source: CampaignFiles, adjusted: AdjustedPoints | None, log: FaultLog) -> _Parts:
    """Return configurations, survey and model of the earlier campaign."""
    configurations = read_configurations(source, settings, log, None if adjusted is None else adjusted.table)
    survey = read_survey(source, settings, log)
    start = read_start(source, settings, log)
    if survey is not None and (source.has_photographs or source.entries("points")):
        check_survey_noise(survey, log)
    check_any_fitted([configurations.table], configurations.file, "pose", log)
    deformation = read_simulated_deformation(source, len(legs_of(settings)), log)
    return _Parts(configurations, survey, start, deformation=deformation)


def _without_points(parts: _Parts, expected: ExpectedPoints, log: FaultLog) -> Outcome:
    """The outcome of a campaign of measured poses or dense scans alone."""
    if parts.measured is not None:
        check_bodies(parts.measured, expected.without(set() if parts.scans is None else parts.scans.bodies), log)
    log.raise_faults()
    there = [part for part in (parts.scans, parts.measured) if part is not None]
    read, figure = ("; ".join(words) for words in ([part.read for part in there], [part.figure for part in there]))
    return parts.outcome(read, figure, observations=ARTIFACTS["observations"].empty(identifier_of(expected.poses)))


def _with_points(parts: _Parts, points: Points, estimated: EstimatedCovariance) -> Outcome:
    """Outcome with the stream of points; its summary is complete once the stream has been read."""
    observations = points.stream()
    if points.log:
        observations.read_all()  # the rest of the faults, which raise at its end
    by_geometry, renamed = points.unlabelled.left_out, points.expected.relabelled
    artifacts = {**parts.artifacts(), "observations": observations}
    artifacts["exclusions"] = _deferred_table("exclusions", lambda: exclusions(parts.left_out(points), by_geometry))
    if any(part.rules for part in renamed):
        artifacts["relabelled"] = _deferred_table("relabelled", lambda: relabelled_table(*renamed))
    return Outcome(
        artifacts,
        read=_deferred_text(lambda: "; ".join((points.read, *estimated.remarks))),
        left_out=_deferred_text(lambda: left_out_words(parts.left_out(points))),
        figure=_deferred_text(lambda: points.figure),
    )


def _adjusted(
    tables: Mapping[str, pa.Table], settings: Campaign, source: CampaignFiles, log: FaultLog
) -> AdjustedPoints | None:
    """Return object points from photographs; None if points were measured directly."""
    if source.has_photographs and source.entries("points"):
        expected = "either photographs (or rays measured in them) or points, not both"
        log.add(Fault("campaign.toml", expected, column="files.points"))
    if "object_points" not in tables:
        return None
    correlations = tables.get("point_correlations")
    points = in_inner_datum(tables["object_points"], correlations)
    bars = tables.get("scale_bars")
    ends = () if bars is None else (*bars.column("first").to_pylist(), *bars.column("second").to_pylist())
    boards = tuple(board.label for board in settings.photographs.boards)
    return AdjustedPoints(points, frozenset(ends), source.folder, boards, paired_points(points, correlations))


def _check_any_points(source: CampaignFiles, log: FaultLog) -> None:
    """Raise CampaignFaults where there is nothing to read, with the files that are no photographs."""
    if any(source.entries(table) for table in ("points", "poses", "scans", "distances")):
        return
    expected = "this file (or points.parquet, poses.csv), or [files.points] in campaign.toml"
    if source.entries("configurations"):
        expected += '; configurations alone are enough for an axis: [mechanism] type = "axis"'
    if source.entries("positioning"):
        expected += '; positions of an axis alone are read with [campaign] kind = "interferometer"'
    log.add(Fault("points.csv", expected + words_on_unread_files(source.folder, source.names_in_entries)))
    for skipped_file in skipped_files(source.folder, source.folders_of_photographs, ()):
        if skipped_file.is_fault:
            log.add(Fault(skipped_file.name, skipped_file.why))
    log.raise_faults()


class _DeferredText:
    """Text that is evaluated after everything was read."""

    def __init__(self, say: Callable[[], str]) -> None:
        self._say = say

    def __str__(self) -> str:
        return self._say()


def _deferred_text(say: Callable[[], str]) -> str:
    return cast(str, _DeferredText(say))


def _deferred_table(artifact: str, table: Callable[[], pa.Table]) -> pa.RecordBatchReader:
    """Return a table that is evaluated after all points were read."""

    def batches() -> Iterator[pa.RecordBatch]:
        yield from table().to_batches()

    return pa.RecordBatchReader.from_batches(ARTIFACTS[artifact].arrow_schema(), batches())


def _expected(
    settings: Campaign,
    configurations: pa.Table,
    survey: pa.Table | None,
    renamed: tuple[Relabelling, ...],
    links: tuple[str, ...],
) -> ExpectedPoints:
    legs = tuple(f"leg{leg + 1}" for leg in range(len(legs_of(settings))))
    return ExpectedPoints(
        poses=configurations.column("pose").combine_chunks().unique(),
        always=(("platform",) if settings.is_frame_fixed else ("base", "platform")) if legs else (),
        bodies=("base", "platform", *legs) if legs else links,
        reference=settings.bodies.reference if settings.is_frame_fixed else settings.reference_body,
        point_mm=settings.noise.point_mm,
        geometry=_geometry(settings, survey),
        survey=survey,
        relabelled=renamed,
    )


def _geometry(settings: Campaign, survey: pa.Table | None) -> Geometry:
    surveyed: dict[str, TableRow] = {}
    if survey is not None:
        columns = (survey.column(name).to_pylist() for name in ("body", "target", "x_mm", "y_mm", "z_mm"))
        for body, target, *point in zip(*columns, strict=True):
            surveyed.setdefault(body, {})[target] = np.array(point, dtype=float)
    legs = legs_of(settings)
    joints = {"base": np.array([leg.a_mm for leg in legs]), "platform": np.array([leg.b_mm for leg in legs])}
    return Geometry(surveyed, joints if legs else {})
