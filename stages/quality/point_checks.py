"""The checks of a campaign of object points: its bodies, and their shares of the budget of chance.

A failing check gates the exit code, so together they may trip on one good campaign in a hundred at most: that budget
(``[qa] false_alarm``) is shared out among the checks that rest on chance, and within a check among its
subjects. Checks that only warn are held at ten times their share.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import chain
from typing import TYPE_CHECKING, cast

import numpy as np
import pyarrow as pa

from truing.arrays import Array, Index
from truing.belonging.counted_times import merely_counts
from truing.quality.bodies import BodyView, PoseSurroundings, body_view, shape_of_poses, with_most_points
from truing.report.numbers import count_text
from truing.schemas.columns import COLUMNS
from truing.stages.common.point_arrays import number_column, pose_points, survey_points
from truing.stages.common.repeats import repeated_poses
from truing.stages.quality.belonging import belonging_checks, relations_of_points
from truing.stages.quality.check import CampaignLimits, Check, CheckResults
from truing.stages.quality.given_poses import readings_of_given_poses
from truing.stages.quality.manual_exclusions import point_decision_checks
from truing.stages.quality.names_and_surveys import (
    between_appearances,
    declared_names,
    expected_visible,
    later_surveys,
    likely_names,
    likely_table,
    names_known,
)
from truing.stages.quality.photograph_checks import photograph_checks
from truing.stages.quality.pose_sample import PoseSample, pose_sample
from truing.stages.quality.scale_checks import figures_of, scale_contradiction, without_consequences
from truing.stages.quality.target_checks import (
    attachment_labels,
    completeness,
    coordinates_vary,
    exchanged_labels,
    geometry,
    gross_errors,
    moved_targets,
    noise,
    noise_by_pose,
    noise_size,
    repeatability,
    unobserved_poses,
)
from truing.stages.quality.time_and_temperature import (
    base_drift,
    temperature_columns,
    temperature_span,
    temperature_units,
    time_gaps,
    time_unit,
)

if TYPE_CHECKING:
    from truing.schemas.campaign import Campaign
    from truing.schemas.mechanism import LeggedMechanism

_CHANCE_CHECKS = 3  # noise per body, noise per pose, repeatability: the failing checks that chance can trip


def checks(tables: Mapping[str, pa.Table], settings: Campaign, sample: PoseSample | None = None) -> CheckResults:
    """Every check of object points, of the network that gave them, and of the relations between tables.

    sample: the points in ``tables`` are those of some poses.
    """
    observations = tables["observations"]
    if not observations.num_rows:
        return _check_given_poses(tables, settings)
    sample = pose_sample(observations, tables.get("configurations")) if sample is None else sample
    shared = "point" in observations.column_names
    surroundings = _surroundings(sample.poses, shared, tables.get("configurations"), settings.campaign.drives)
    around = sample.around(surroundings)
    bodies, reference = _reference_first(_body_views(tables, around), settings)
    limits = CampaignLimits(settings.campaign.kind, settings.qa.limits)
    declared = declared_names(tables.get("relabelled"))
    relations = relations_of_points(bodies, around, tables, settings)
    likely = likely_names(observations, bodies, around, declared)
    checks_made: Iterable[Check] = chain(
        sample.noted(belonging_checks(relations)),
        [unobserved_poses(surroundings, limits), coordinates_vary(bodies), noise_size(bodies, relations)],
        sample.noted(_checks_of_points(bodies, reference, around, settings, limits, tables)),
        _checks_of_times(surroundings, settings, limits, tables.get("configurations")),
        sample.noted(names_known(observations, bodies, likely, declared)),
        later_surveys(tables.get("resurveys"), settings.exclude, limits),
        point_decision_checks(sample.whole, settings),
        photograph_checks(tables, limits),
    )
    statistics = tables.get("bundle_statistics")
    if statistics is not None and scale_contradiction(figures_of(statistics)) is not None:
        checks_made = without_consequences(checks_made)
    poses = count_text(len(surroundings.poses), "pose")
    read = f"{count_text(sample.whole.num_rows, 'point')} of {count_text(len(bodies), 'body')} in {poses}"
    read += "" if sample.is_whole else f", examined those of {count_text(len(around.poses), 'pose')}"
    return CheckResults(checks_made, read, relations, {"likely_names": likely_table(likely)} if likely else {})


def _check_given_poses(tables: Mapping[str, pa.Table], settings: Campaign) -> CheckResults:
    """The test of actuator readings against poses that were measured directly; they have no points to check."""
    poses = tables.get("measured_poses")
    if poses is None or not poses.num_rows or not settings.mechanism.is_legged:
        return CheckResults((), "", why_not="no object points")
    names = tuple(poses.column("pose").unique().to_pylist())
    around = _surroundings(names, False, tables.get("configurations"), settings.campaign.drives)
    relations = readings_of_given_poses(poses, around, tables.get("configurations"), settings)
    read = f"{count_text(len(names), 'pose')} as measured"
    return CheckResults(chain(belonging_checks(relations), checks_of_times(tables, settings)), read, relations)


def checks_of_times(tables: Mapping[str, pa.Table], settings: Campaign) -> Iterator[Check]:
    """Check the times and temperatures of poses that have no points; nothing without configurations."""
    table = tables.get("configurations")
    if table is not None:
        around = _surroundings(tuple(table.column("pose").to_pylist()), False, table, settings.campaign.drives)
        limits = CampaignLimits(settings.campaign.kind, settings.qa.limits)
        yield from _checks_of_times(around, settings, limits, table)


def _reference_first(bodies: list[BodyView], settings: Campaign) -> tuple[list[BodyView], BodyView | None]:
    """The bodies, the one that the others are seen from first, and that one where the campaign has it."""
    reference = settings.bodies.reference or ("base" if settings.mechanism.is_legged else None)
    ordered = sorted(bodies, key=lambda body: body.name != reference)
    return ordered, ordered[0] if ordered and ordered[0].name == reference else None


def _attachments(settings: Campaign) -> Array:
    """(L, 3) nominal attachments in m; None without a mechanism."""
    if not settings.mechanism.is_legged:
        return np.zeros((0, 3))
    return np.array([leg.b_mm for leg in cast("LeggedMechanism", settings.mechanism).legs]) * 1e-3


def _surroundings(
    observed: tuple[int | str, ...], shared: bool, configurations: pa.Table | None, drives: tuple[str, ...]
) -> PoseSurroundings:
    """The observed poses, ordered by time if it was recorded, else in the order of the file."""
    if configurations is None:
        none = np.zeros((len(observed), 0))
        return PoseSurroundings(
            observed, np.arange(float(len(observed))), none, (), None, shared=shared, is_counted=True
        )
    time = number_column(configurations, "time_s")
    order = np.argsort(time, kind="stable")
    ids = configurations.column("pose").to_pylist()
    seen = set(observed)
    rows = np.array([i for i in order if ids[i] in seen], dtype=np.int64)
    names = [n for n in configurations.schema.names if COLUMNS["rho"].matches(n) or n in drives]
    values = {n: number_column(configurations, n)[rows] for n in names}
    varying = tuple(n for n in names if np.nanstd(values[n]) > 0.0)
    has_temperature = "temperature_c" in configurations.schema.names
    return PoseSurroundings(
        tuple(ids[i] for i in rows),
        time[rows],
        np.column_stack([values[n] for n in varying]) if varying else np.zeros((len(rows), 0)),
        varying,
        number_column(configurations, "temperature_c")[rows] if has_temperature else None,
        tuple(pose for pose in ids if pose not in seen),
        shared,
        merely_counts(time[order], np.arange(len(order)), np.zeros(len(order), dtype=np.int64)),
    )


def _body_views(tables: Mapping[str, pa.Table], around: PoseSurroundings) -> list[BodyView]:
    """Every body of the observations, fitted robustly pose by pose."""
    observations, survey = tables["observations"], tables.get("survey")
    bodies = dict.fromkeys(observations.column("body").to_pylist())
    return [viewed(observations, survey, body, around) for body in bodies]


def viewed(observations: pa.Table, survey: pa.Table | None, body: str, around: PoseSurroundings) -> BodyView:
    """Return one body of the observations, fitted robustly to its survey, or to the shape of most poses."""
    position = survey_points(survey, body) if survey is not None else None
    is_surveyed = position is not None and bool(position.targets)
    if position is None or not is_surveyed:
        position = shape_of_poses(pose_points(observations, body, around.poses))
    points = pose_points(observations, body, around.poses, position.targets)
    return with_most_points(body_view(body, position, points, around, is_surveyed=is_surveyed), around)


def _checks_of_points(
    bodies: Sequence[BodyView],
    reference: BodyView | None,
    around: PoseSurroundings,
    settings: Campaign,
    limits: CampaignLimits,
    tables: Mapping[str, pa.Table],
) -> Iterator[Check]:
    """Every check of points: body by body, then over time."""
    resurveys, table = tables.get("resurveys"), tables.get("configurations")
    share = settings.qa.false_alarm / _CHANCE_CHECKS
    yield from attachment_labels(bodies, _attachments(settings))
    for body in bodies:
        due = expected_visible(resurveys, body, around)
        if settings.mechanism.type == "chain" and not body.is_surveyed:
            due &= between_appearances(body.points.is_observed)
        yield from completeness(body, due, limits)
        yield from geometry(body, limits)
        yield from gross_errors(body, limits)
        yield from exchanged_labels(body, around)
        yield from moved_targets(body, around, 10.0 * share / len(bodies))
        yield from noise(body, around, share / len(bodies))
        yield from noise_by_pose(body, around, share / len(bodies))
    yield from base_drift(reference, 10.0 * share, frame_stays=settings.is_frame_fixed)
    is_fixed = settings.is_frame_fixed and reference is None
    yield from repeatability(bodies, around, *_repeats(table, around, settings), share, is_instrument_fixed=is_fixed)


def _checks_of_times(
    around: PoseSurroundings, settings: Campaign, limits: CampaignLimits, table: pa.Table | None
) -> Iterator[Check]:
    """Every check of the times and temperatures of all poses."""
    yield time_gaps(around, limits)
    time = around.time if table is None else number_column(table, "time_s")
    yield time_unit(time, None, "configurations", "pose", is_counted=around.is_counted)
    yield temperature_span(around, limits)
    yield from _temperature_units(table, settings.mechanism.reference_temperature_c)


def _temperature_units(configurations: pa.Table | None, reference_c: float) -> Iterator[Check]:
    if configurations is None:
        yield from temperature_units({}, reference_c)
        return
    recorded = {name: number_column(configurations, name) for name in temperature_columns(configurations.column_names)}
    order = np.argsort(number_column(configurations, "time_s"), kind="stable")
    rows = [f"pose {pose}" for pose in configurations.column("pose").to_pylist()]
    yield from temperature_units(recorded, reference_c, rows, order)


def _repeats(configurations: pa.Table | None, around: PoseSurroundings, settings: Campaign) -> tuple[list[Index], str]:
    """Poses that repeat one another, as numbers of those that were seen, and the source of this knowledge."""
    if configurations is None:
        return [], ""
    groups, how = repeated_poses(configurations, settings.campaign.drives, settings.noise.actuator_mm)
    poses = configurations.column("pose").to_pylist()
    index_of = {pose: at for at, pose in enumerate(around.poses)}
    seen = ([index_of[poses[row]] for row in group if poses[row] in index_of] for group in groups)
    return [np.array(group) for group in seen if len(group) > 1], how
