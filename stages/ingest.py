"""Raw files become the campaign's tables: mapped, in the contract's units, checked against each other."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Container, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from truing.formats.source import TABLES, CampaignFiles
from truing.report.numbers import count as counted
from truing.schemas.artifacts import ARTIFACTS
from truing.schemas.axis_mechanism import COLUMNS_OF_AXES, NOISE_OF_ENCODERS
from truing.schemas.faults import Fault
from truing.schemas.near_names import meant
from truing.stages.common.registered import registered
from truing.stages.declaration import Outcome, Progress, Stage

if TYPE_CHECKING:
    import pyarrow as pa

    from truing.formats.faultlog import FaultLog
    from truing.stages.common.gathered import SmallTable
    from truing.stages.ingestion.adjusted_points import AdjustedPoints
    from truing.stages.ingestion.dense_scans import DenseScans
    from truing.stages.ingestion.later_surveys import LaterSurveys
    from truing.stages.ingestion.points import Expected, Geometry, Points
    from truing.stages.ingestion.pose_table import MeasuredPoses

    _Small = SmallTable | LaterSurveys | DenseScans | MeasuredPoses

DECLARATION = Stage(
    name="ingest",
    reads=("object_points?", "point_correlations?", "scale_bars?"),
    leaves=(
        *("survey?", "configurations?", "scans?", "measured_poses?", "observations?", "start?"),
        *(
            "readings?",
            "signals?",
            "quadrature?",
            "reading_corrections?",
            "positions?",
            "given_compliance?",
            "relabelled?",
            "resurveys?",
            "exclusions",
        ),
    ),
    settings=(
        "campaign.kind",
        "campaign.drives",
        "mechanism.type",
        "mechanism.legs",
        "mechanism.model",
        "mechanism.height_mm",
        "mechanism.elements",
        *COLUMNS_OF_AXES,
        *NOISE_OF_ENCODERS,
        "loading",
        "interferometer",
        "signals.sensitivity_mv_per_n",
        "noise.point_mm",
        "noise.linear_um",
        "noise.angular_arcsec",
        "noise.displacement_mm",
        "noise.rotation_rad",
        "measurement.frame",
        "poses.euler",
        "bodies.reference",
        "photographs.boards",
        "renamed",
        "resurvey",
        "files",
    ),
    summary="reads the raw files, brings them into the contract's units and names, and refuses what cannot be",
)
# What reads the files of a mechanism that is neither of legs nor a sensor on its bench, by its type.
OF_TYPES = {"axis": "truing.stages.ingestion.axis_rows"}


class _Late:
    """Words that are known only once everything has been read."""

    def __init__(self, say: Callable[[], str]) -> None:
        self._say = say

    def __str__(self) -> str:
        return self._say()


def run(tables: Mapping[str, pa.Table], settings: Any, progress: Progress, source: CampaignFiles) -> Outcome:
    """The campaign's tables from its raw files; raises CampaignFaults with everything that is wrong at once.

    Observations are a stream, read and checked while it is drained: the faults may come at its end.
    """
    from truing.formats.faultlog import FaultLog

    log = FaultLog()
    _check_tables(settings, log)
    if (own := registered(OF_TYPES, settings)) is not None:
        outcome: Outcome = own.ingest(settings, source, log)
        return outcome
    if settings.campaign.kind == "interferometer":
        return _interferometer(settings, source, log)
    return _photogrammetry(settings, progress, source, _adjusted(tables, settings, source, log), log)


def _adjusted(
    tables: Mapping[str, pa.Table], settings: Any, source: CampaignFiles, log: FaultLog
) -> AdjustedPoints | None:
    """The object points that photographs gave; None where they were measured as points."""
    if source.has_photographs and source.entries("points"):
        expected = "either photographs (or rays measured in them) or points, not both"
        log.add(Fault("campaign.toml", expected, column="files.points"))
    if "object_points" not in tables:
        return None
    from truing.stages.ingestion.adjusted_points import AdjustedPoints, in_inner_datum

    points = in_inner_datum(tables["object_points"], tables.get("point_correlations"))
    bars = tables.get("scale_bars")
    ends = () if bars is None else (*bars.column("first").to_pylist(), *bars.column("second").to_pylist())
    boards = tuple(board.label for board in settings.photographs.boards)
    return AdjustedPoints(points, frozenset(ends), source.folder, boards)


def _check_tables(settings: Any, log: FaultLog) -> None:
    for table in settings.files:
        if table not in TABLES:
            hint = meant(table, TABLES) or f"; one of {', '.join(TABLES)}"
            log.add(Fault("campaign.toml", f"a known table{hint}", column=f"files.{table}"))


def _photogrammetry(
    settings: Any, progress: Progress, source: CampaignFiles, adjusted: AdjustedPoints | None, log: FaultLog
) -> Outcome:
    from truing.formats.source import passed_over
    from truing.stages.ingestion.adjusted_points import EstimatedCovariance
    from truing.stages.ingestion.dense_scans import identifier_of, read_scans
    from truing.stages.ingestion.later_surveys import read_later_surveys, relabelling_of
    from truing.stages.ingestion.points import Points
    from truing.stages.ingestion.pose_table import read_poses
    from truing.stages.ingestion.relabelling import PoseOrder, declared, relabelled_table
    from truing.stages.ingestion.tables import (
        check_any_fitted,
        check_survey_noise,
        read_configurations,
        read_start,
        read_survey,
    )

    estimated = EstimatedCovariance()
    source.estimate = estimated
    configurations = read_configurations(source, settings, log, None if adjusted is None else adjusted.table)
    survey = read_survey(source, settings, log)
    start = read_start(source, settings, log)
    if survey is not None and (source.has_photographs or source.entries("points")):
        check_survey_noise(survey, log)
    check_any_fitted([configurations.table], configurations.file, "pose", log)
    if adjusted is None and source.has_photographs:
        return _without_points(configurations, survey, start, log)
    if adjusted is None and not any(source.entries(table) for table in ("points", "poses", "scans")):
        log.add(Fault("points.csv", "this file (or points.parquet, poses.csv), or [files.points] in campaign.toml"))
        for one in passed_over(source.folder, source.folders_of_photographs, ()):
            if one.is_fault:
                log.add(Fault(one.name, one.why))
        log.throw()
    order = PoseOrder.of(configurations.table)
    later = read_later_surveys(source, settings, survey, order, log)
    if survey is not None and later is not None:
        survey = replace(survey, table=later.survey(survey.table))
    renamed = declared(settings, order, None if survey is None else survey.table, log)
    others = (renamed, relabelling_of(later, order))
    expected = replace(_expected(settings, configurations, survey), relabelled=others)
    measured = read_poses(source, settings, expected, log)
    scans = read_scans(source, expected.poses, log, progress)
    artifacts: dict[str, Any] = {} if survey is None else {"survey": survey.table}
    artifacts |= {} if start is None else {"start": start}
    artifacts |= {} if configurations is None else {"configurations": configurations.table}
    artifacts |= {} if scans is None else {"scans": scans.table(expected.poses)}
    artifacts |= {} if later is None else {"resurveys": later.table()}
    artifacts |= {} if measured is None else {"measured_poses": measured.table}
    small = [table for table in (configurations, survey, later, scans, measured) if table is not None]
    if adjusted is None and not source.entries("points"):
        _check_without_points(measured, scans, expected, log)
        artifacts["observations"] = ARTIFACTS["observations"].empty(identifier_of(expected.poses))
        return _without_any_points(scans, measured, artifacts, small)
    known = {*(scans.bodies if scans else ()), *(measured.bodies if measured else ())}
    points = Points(source, log, expected.without(known), progress, adjusted)
    observations = points.stream()
    if log:
        observations.read_all()  # the rest of the faults, which raise at its end
    artifacts |= {"observations": observations, "exclusions": _exclusions_of(points, small)}
    if any(part.rules for part in others):
        artifacts["relabelled"] = _at_last("relabelled", lambda: relabelled_table(*others))
    return Outcome(
        artifacts,
        read=_late(lambda: "; ".join((_read_words(points), *estimated.said))),
        left_out=_late(lambda: _left_out_words(_all_left_out(points, small))),
        figure=_late(lambda: _figure_words(points)),
    )


def _without_points(
    configurations: SmallTable, survey: SmallTable | None, start: pa.Table | None, log: FaultLog
) -> Outcome:
    """What can be read before the photographs have been adjusted: a campaign is checked without that."""
    log.throw()
    left_out: Counter[tuple[str, str]] = Counter(configurations.left_out)
    artifacts: dict[str, Any] = {"configurations": configurations.table}
    artifacts |= {} if survey is None else {"survey": survey.table}
    artifacts |= {} if start is None else {"start": start}
    if survey is not None:
        left_out.update(survey.left_out)
    return Outcome(
        artifacts | {"exclusions": _exclusions(left_out)},
        read=counted(len(configurations.table), "configuration"),
        left_out=_left_out_words(left_out),
        figure="points are not adjusted yet",
    )


def _check_without_points(
    measured: MeasuredPoses | None, scans: DenseScans | None, expected: Expected, log: FaultLog
) -> None:
    from truing.stages.ingestion.pose_table import check_bodies

    if measured is not None:
        check_bodies(measured, expected.without(set() if scans is None else scans.bodies), log)
    log.throw()


def _without_any_points(
    scans: DenseScans | None, measured: MeasuredPoses | None, artifacts: dict[str, Any], small: Sequence[_Small]
) -> Outcome:
    left_out: Counter[tuple[str, str]] = Counter()
    for table in small:
        left_out.update(table.left_out)
    return Outcome(
        artifacts | {"exclusions": _exclusions(left_out)},
        read="; ".join(
            [
                *(
                    [f"{counted(scans.points, 'point')} of {counted(len(scans.rows), 'dense scan')}"]
                    if scans is not None
                    else []
                ),
                *([measured.read] if measured is not None else []),
            ]
        ),
        left_out=_left_out_words(left_out),
        figure="; ".join(
            [
                *([scans.figure] if scans is not None else []),
                *([f"poses of {', '.join(measured.bodies[:12])}, no points"] if measured is not None else []),
            ]
        ),
    )


def _late(say: Callable[[], str]) -> str:
    return cast(str, _Late(say))


def _expected(settings: Any, configurations: SmallTable, survey: SmallTable | None) -> Expected:
    from truing.stages.ingestion.points import Expected
    from truing.stages.ingestion.tables import legs_of

    legs = tuple(f"leg{leg + 1}" for leg in range(len(legs_of(settings))))
    return Expected(
        poses=configurations.table.column("pose").combine_chunks().unique(),
        always=(("platform",) if settings.is_frame_fixed else ("base", "platform")) if legs else (),
        bodies=("base", "platform", *legs) if legs else (),
        reference=settings.bodies.reference if settings.is_frame_fixed else settings.reference_body,
        point_mm=settings.noise.point_mm,
        geometry=_geometry(settings, survey),
        survey=None if survey is None else survey.table,
    )


def _geometry(settings: Any, survey: SmallTable | None) -> Geometry:
    from truing.stages.ingestion.points import Geometry
    from truing.stages.ingestion.tables import legs_of

    surveyed: dict[str, dict[str, Any]] = {}
    if survey is not None:
        columns = (survey.table.column(name).to_pylist() for name in ("body", "target", "x_mm", "y_mm", "z_mm"))
        for body, target, *point in zip(*columns, strict=True):
            surveyed.setdefault(body, {})[target] = np.array(point, dtype=float)
    legs = legs_of(settings)
    joints = {"base": np.array([leg.a_mm for leg in legs]), "platform": np.array([leg.b_mm for leg in legs])}
    return Geometry(surveyed, joints if legs else {})


def _all_left_out(points: Points, small: Sequence[_Small]) -> Counter[tuple[str, str]]:
    total = Counter(points.left_out)
    for table in small:
        total.update(table.left_out)
    return total


def _exclusions_of(points: Points, small: Sequence[_Small]) -> pa.RecordBatchReader:
    return _at_last("exclusions", lambda: _exclusions(_all_left_out(points, small), points.unlabelled.left_out))


def _at_last(artifact: str, table: Callable[[], pa.Table]) -> pa.RecordBatchReader:
    """A table that is known only once the points have been read."""
    import pyarrow as pa

    def batches() -> Iterator[pa.RecordBatch]:
        yield from table().to_batches()

    return pa.RecordBatchReader.from_batches(ARTIFACTS[artifact].arrow_schema(), batches())


def _exclusions(left_out: Mapping[tuple[str, str], int], by_geometry: Container[tuple[str, str]] = ()) -> pa.Table:
    import pyarrow as pa

    by = ("[files] of campaign.toml", "the geometry of the survey")
    rows = [
        {"stage": "ingest", "subject": key[0], "reason": key[1], "rows": count, "by": by[key in by_geometry]}
        for key, count in left_out.items()
    ]
    return pa.Table.from_pylist(rows, schema=ARTIFACTS["exclusions"].arrow_schema())


def _read_words(points: Points) -> str:
    files = f"{len(points.files)} files" if len(points.files) != 1 else next(iter(points.files))
    return f"{counted(points.rows, 'point')} of {counted(points.poses, 'pose')} from {files}"


def _left_out_words(left_out: Mapping[tuple[str, str], int]) -> str:
    by_reason: Counter[str] = Counter()
    for (_, reason), count in left_out.items():
        by_reason[reason] += count
    return "; ".join(f"{counted(count, 'row')}: {reason}" for reason, count in by_reason.most_common()) or "nothing"


def _figure_words(points: Points) -> str:
    bodies = counted(len(points.bodies), "body")
    return f"{counted(points.labels, 'target')} of {bodies} ({', '.join(points.bodies[:12])})"


def _interferometer(settings: Any, source: CampaignFiles, log: FaultLog) -> Outcome:
    from truing.stages.ingestion.loading_tables import read_loading_tables
    from truing.stages.ingestion.tables import read_start

    found, start = read_loading_tables(source, settings, log), read_start(source, settings, log)
    log.throw()
    given = {} if start is None else {"start": start}
    return Outcome(
        {**found.artifacts, **given, "exclusions": _exclusions(found.left_out)},
        read=found.read,
        left_out=_left_out_words(found.left_out),
        figure=found.figure,
    )
