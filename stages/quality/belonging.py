"""Relations between tables of a campaign, tested as quality checks."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol, cast

import numpy as np
import pyarrow as pa

from truing.arrays import Array, Index, Mask
from truing.belonging.axes_changes import AXES_CHANGES
from truing.belonging.body_point_tests import (
    is_flat,
    joined_results,
    poses_with_slips,
    relate_poses,
    relate_survey,
    shifted_survey,
)
from truing.belonging.body_points import AsOtherBody, BodyPoints
from truing.belonging.copied_poses import relate_copies
from truing.belonging.drive_tests import DrivenBody, relate_drive
from truing.belonging.reading_hypotheses import MeasuredMotion
from truing.belonging.reading_row_slips import ReadingNames
from truing.belonging.reading_tests import READINGS, relate_readings
from truing.belonging.relation import (
    RecordSlip,
    RelationState,
    RelationTest,
)
from truing.belonging.target_names import NamedTargets
from truing.estimation.covariance import relative
from truing.estimation.rigid_poses.umeyama import umeyama
from truing.quality.bodies import BodyView, PoseSurroundings
from truing.report.belonging import message
from truing.schemas.columns import COLUMNS
from truing.simulation.targets import FREE_DIRECTION, FREE_LENGTH_M
from truing.stages.common.point_arrays import number_column, pose_points, positions
from truing.stages.quality.check import FAIL, NOT_EVALUATED, PASS, WARN, Check, not_evaluated

if TYPE_CHECKING:
    from truing.schemas.campaign import Campaign
    from truing.schemas.mechanism import LeggedMechanism
    from truing.simulation.mechanisms.legs.closures import Legs

Groups = tuple[tuple[str, tuple[str, ...]], ...]

_ROWS_OF_A_GROUP = 3  # at least, on average: numbers that vary from row to row make no groups
_VERDICTS = {
    RelationState.OK: PASS,
    RelationState.ATTENTION: WARN,
    RelationState.FAILS: FAIL,
    RelationState.NOT_TESTED: NOT_EVALUATED,
}
_DEGREES = "_deg"  # end of the names of columns with angles


def belonging_checks(tested: Iterable[RelationTest]) -> Iterator[Check]:
    """Yield one check per tested relation."""
    for test in tested:
        verdict = _VERDICTS[test.state]
        value, limit = (None, None) if verdict == NOT_EVALUATED else (test.misfit, test.limit)
        yield Check(test.relation, test.subject, value, limit, test.unit, verdict, message(test))


def without_contradiction(checks: Iterable[Check], tested: Iterable[RelationTest]) -> Iterator[Check]:
    """Yield the checks; where signals contradict loads, the check for exchanged rows is not evaluated."""
    is_contradictory = any(
        test.relation == "signals-against-loads" and test.state == RelationState.FAILS for test in tested
    )
    deferred = False
    for check in checks:
        if not is_contradictory or check.check != "exchanged-rows":
            yield check
        elif not deferred:
            deferred = True
            yield not_evaluated(
                "belonging", "exchanged-rows", "", "signals do not belong to loads (signals-against-loads)"
            )


def relations_of_points(
    bodies: Sequence[BodyView], around: PoseSurroundings, tables: Mapping[str, pa.Table], settings: Campaign
) -> tuple[RelationTest, ...]:
    """Return the tested relations of a campaign of object points."""
    surveyed = set(tables["survey"].column("body").to_pylist()) if "survey" in tables else set()
    configurations = tables.get("configurations")
    order = _file_order(configurations, around)
    groups = (
        ()
        if configurations is None
        else _groups(configurations, np.flatnonzero(positions(configurations.column("pose"), around.poses) >= 0))
    )
    known = [body for body in bodies if body.name in surveyed]
    unsurveyed = [body for body in bodies if body.name not in surveyed]
    points = {
        body.name: _points(
            body, _points_as_other_bodies(body, known, tables["observations"], around, order), around, order, groups
        )
        for body in known
    }
    odd = np.zeros(len(around.poses), bool)
    for name in {"base", "platform"} & points.keys():
        odd[order] |= poses_with_slips(points[name])
    return (
        _copies(bodies, around),
        *_surveys(tables.get("survey"), list(points.values())),
        *joined_results(tuple(relate_poses(_points(body, (), around, order, groups)) for body in unsurveyed)),
        *_readings(bodies, around, configurations, surveyed, settings, odd),
        *_drives(bodies, around, configurations, settings),
    )


def _surveys(survey: pa.Table | None, bodies: Sequence[BodyPoints]) -> Iterator[RelationTest]:
    """Yield the tests of bodies against their survey; one for all of them if rows of the whole survey are shifted."""
    tested = tuple(map(relate_survey, bodies))
    if survey is not None and tested and all(test.reason == "no-fit" for test in tested):
        points = 1e-3 * np.column_stack([number_column(survey, f"{axis}_mm") for axis in "xyz"])
        names = list(zip(survey.column("body").to_pylist(), survey.column("target").to_pylist(), strict=True))
        if (shifted := shifted_survey(points, names, bodies)) is not None:
            tested = (shifted,)
    yield from joined_results(tested)


def _file_order(configurations: pa.Table | None, around: PoseSurroundings) -> Index:
    """Return the indices of the poses in the order of the configurations, or of the observations without
    configurations."""
    if configurations is None:
        return np.arange(len(around.poses))
    pose = positions(configurations.column("pose"), around.poses)
    return np.asarray(pose[pose >= 0])


def _points(
    body: BodyView, others: tuple[AsOtherBody, ...], around: PoseSurroundings, order: Index, groups: Groups
) -> BodyPoints:
    """Return the points of the targets that define the body's frame, with poses in the order of the file."""
    frame = body.frame
    is_observed = body.points.is_observed[:, frame]
    sigma = body.sigma[:, frame][is_observed]
    return BodyPoints(
        body.name,
        body.survey.points[frame] / body.survey_scale,
        body.points.points[:, frame][order],
        is_observed[order],
        float(np.median(sigma)) if sigma.size else 0.0,
        tuple(str(around.poses[pose]) for pose in order),
        groups,
        others,
        body.noise_factor,
        tuple(np.array(body.survey.targets, dtype=object)[frame].tolist()),
        NamedTargets(
            tuple(body.survey.targets),
            body.survey.points / body.survey_scale,
            body.points.points[order],
            body.points.is_observed[order],
        ),
    )


def _points_as_other_bodies(
    body: BodyView, bodies: Sequence[BodyView], observed: pa.Table, around: PoseSurroundings, order: Index
) -> tuple[AsOtherBody, ...]:
    """Return a body's points read as points of each other body: matched by target name, and by position in the list."""
    other_bodies = []
    for other in bodies:
        if other is not body:
            named = pose_points(observed, body.name, around.poses, other.survey.targets)
            other_bodies.append(
                AsOtherBody(other.name, other.survey.points, named.points[order], named.is_observed[order])
            )
            count = min(len(body.survey.targets), len(other.survey.targets))
            points, is_observed = body.points.points[order, :count], body.points.is_observed[order, :count]
            other_bodies.append(AsOtherBody(other.name, other.survey.points[:count], points, is_observed))
    return tuple(other_bodies)


def _copies(bodies: Sequence[BodyView], around: PoseSurroundings) -> RelationTest:
    points = np.concatenate([body.points.points for body in bodies], axis=1)
    is_observed = np.concatenate([body.points.is_observed for body in bodies], axis=1)
    sigma = np.concatenate([body.measured_sigma.mean(axis=2) for body in bodies], axis=1)
    least = float(sigma[is_observed].min()) if is_observed.any() else 0.0
    targets = tuple((body.name, str(target)) for body in bodies for target in body.survey.targets)
    return relate_copies(points, is_observed, least, tuple(map(str, around.poses)), targets)


def _readings(
    bodies: Sequence[BodyView],
    around: PoseSurroundings,
    configurations: pa.Table | None,
    surveyed: set[str],
    settings: Campaign,
    odd: Mask,
) -> tuple[RelationTest, ...]:
    """Return the test of actuator readings against platform poses, without poses (B,) whose points contain a slip."""
    if not settings.mechanism.is_legged:
        return (RelationTest(READINGS, RelationState.NOT_TESTED, "no-mechanism"),)
    if not {"base", "platform"} <= surveyed:
        return (RelationTest(READINGS, RelationState.NOT_TESTED, "no-survey"),)
    by_name = {body.name: body for body in bodies}
    section = cast("LeggedMechanism", settings.mechanism)
    columns = tuple(f"rho{leg + 1}_mm" for leg in range(len(section.legs)))
    missing = configurations is None or not {"base", "platform"} <= by_name.keys()
    if configurations is None or missing or not set(columns) <= set(configurations.column_names):
        return (RelationTest(READINGS, RelationState.NOT_TESTED, "no-readings"),)
    return related_readings(by_name["base"].fit, by_name["platform"].fit, around, configurations, settings, ~odd)


class PosesOfBody(Protocol):
    """Poses of a body: rotations R (B, 3, 3), places t (B, 3), m, covariance (B, 6, 6) in m and rad, and those known,
    ok (B,)."""

    @property
    def R(self) -> Array: ...
    @property
    def t(self) -> Array: ...
    @property
    def covariance(self) -> Array: ...
    @property
    def ok(self) -> Mask: ...


def related_readings(
    base: PosesOfBody,
    platform: PosesOfBody,
    around: PoseSurroundings,
    configurations: pa.Table,
    settings: Campaign,
    right: Mask,
    *,
    are_given: bool = False,
) -> tuple[RelationTest, ...]:
    """Return the test of actuator readings against the poses of a platform on its base, both seen from the instrument.

    Poses that are not ``right`` (B,) are left out. ``are_given``: the poses are numbers of a table, not fits to points.
    """
    section = cast("LeggedMechanism", settings.mechanism)
    columns = tuple(f"rho{leg + 1}_mm" for leg in range(len(section.legs)))
    found = _rows_in_order(configurations, columns, around)
    R, p, covariance = relative(base.R, base.t, base.covariance, platform.R, platform.t, platform.covariance)
    usable = (base.ok & platform.ok & right)[found.pose] & np.isfinite(found.readings).all(axis=1)
    at = found.pose[usable]
    spread = np.trace(covariance[at][:, :3, :3], axis1=1, axis2=2)
    noise = float(np.sqrt(np.median(spread))) if len(at) else 0.0
    motion = MeasuredMotion(
        _legs(section, p[at]),
        _tolerances(section),
        p[at],
        R[at],
        found.readings[usable],
        float(np.hypot(noise, 1e-3 * settings.noise.actuator_mm)),
        _drivers(around, at),
        "measured poses" if are_given else "points and survey",
        (base.t[at], base.R[at]),
        are_given,
        settings.poses.euler,
        None if around.is_counted else around.time[at],
    )
    poses = tuple(str(around.poses[pose]) for pose in at)
    return relate_readings(motion, ReadingNames(columns, poses, _groups(configurations, found.row[usable])))


def _drives(
    bodies: Sequence[BodyView], around: PoseSurroundings, configurations: pa.Table | None, settings: Campaign
) -> Iterator[RelationTest]:
    """Yield the test of a single rotary drive's readings against the rotations of the bodies, relative to the
    reference body if any."""
    columns = [name for name in settings.campaign.drives if name.endswith(_DEGREES)]
    if configurations is None or len(columns) != 1 or columns[0] not in configurations.column_names:
        return
    pose = positions(configurations.column("pose"), around.poses)
    rows = np.flatnonzero(pose >= 0)
    readings, pose = number_column(configurations, columns[0])[rows], pose[rows]
    reference = next((body for body in bodies if body.name == settings.bodies.reference), None)
    driven = []
    for body in bodies:
        if body is reference:
            continue
        ok = body.fit.ok if reference is None else body.fit.ok & reference.fit.ok
        indices = np.flatnonzero(ok[pose] & np.isfinite(readings))
        at = pose[indices]
        R, mirrored = (
            body.fit.R[at],
            [(slip, fit[at]) for slip, fit in _mirrored(body)] if reference is None else [],
        )
        if reference is not None:
            R = np.swapaxes(reference.fit.R[at], 1, 2) @ R
        names, groups = tuple(str(around.poses[one]) for one in at), _groups(configurations, rows[indices])
        driven.append(DrivenBody(body.name, columns[0], R, readings[indices], names, groups, mirrored))
    yield relate_drive(driven)


def _mirrored(body: BodyView) -> Iterator[tuple[RecordSlip, Array]]:
    """Yield changes of axes that mirror, with the rotations (B, 3, 3) of a flat body after each."""
    source = body.survey.points[body.frame]
    if not is_flat(source):
        return
    seen = body.good[:, body.frame].astype(float)
    for change in AXES_CHANGES:
        points = body.points.points[:, body.frame] @ change.matrix
        yield change.slip, umeyama(source, points, seen).R


@dataclass(frozen=True)
class _ConfigurationRows:
    """Rows of the configurations with a measured pose, in file order: readings (N, L) in m, pose (N,), table
    row (N,)."""

    readings: Array
    pose: Index
    row: Index


def _rows_in_order(configurations: pa.Table, columns: tuple[str, ...], around: PoseSurroundings) -> _ConfigurationRows:
    pose = positions(configurations.column("pose"), around.poses)
    readings = 1e-3 * np.column_stack([number_column(configurations, name) for name in columns])
    return _ConfigurationRows(readings[pose >= 0], pose[pose >= 0], np.flatnonzero(pose >= 0))


def _groups(configurations: pa.Table, rows: Index) -> Groups:
    """Return the columns that divide the rows (N,) into few groups, such as role, day or run, with their values."""
    groups = []
    for name in configurations.column_names:
        if name not in ("pose", "time_s") and not COLUMNS["rho"].matches(name):
            column = configurations.column(name).to_pylist()
            values = tuple(f"{column[row]:g}" if isinstance(column[row], float) else str(column[row]) for row in rows)
            if 1 < len(set(values)) <= len(rows) // _ROWS_OF_A_GROUP:
                groups.append((name, values))
    return tuple(groups)


def _legs(section: LeggedMechanism, p: Array) -> Legs:
    """Return the nominal legs; a leg without a direction points towards the mean measured platform."""
    from truing.stages.common.nominal_mechanism import nominal_legs

    legs = nominal_legs(section)
    if "u" in legs.closure.geometry or not len(p):
        return legs
    away = np.mean(p + legs.b.mean(axis=0) - legs.a.mean(axis=0), axis=0)
    return legs.replace(u=np.broadcast_to(away / max(float(np.linalg.norm(away)), 1e-12), legs.a.shape))


def _tolerances(section: LeggedMechanism) -> dict[str, float]:
    """Return the standard deviation of each geometry parameter, m and 1; a wide one where none is declared."""
    given = section.tolerance
    lengths = {"a": given.a_mm, "b": given.b_mm, "l": given.length_mm}
    found = {name: FREE_LENGTH_M if value is None else 1e-3 * value for name, value in lengths.items()}
    return {**found, "u": FREE_DIRECTION if given.u is None else given.u}


def _drivers(around: PoseSurroundings, at: Index) -> Array:
    """Return time and temperature (N, C), centred and scaled to unit variance, if they vary."""
    columns = [around.time[at], *(() if around.temperature is None else (around.temperature[at],))]
    varying = [values for values in columns if len(values) and np.isfinite(values).all() and np.ptp(values) > 0.0]
    scaled = [(values - values.mean()) / values.std() for values in varying]
    return np.column_stack(scaled) if scaled else np.zeros((len(at), 0))
