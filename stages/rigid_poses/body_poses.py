"""Body poses from points, dense scans and measured poses, as tables and in words."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, cast

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from truing.arrays import Array, Index, Mask
from truing.estimation.covariance import relative_slope
from truing.estimation.measured_numbers import pose_numbers
from truing.estimation.rigid_poses.body_poses import (
    BodyPoses,
    PointDecisions,
    fit_body,
    largest_motion,
    seen_from,
    without_targets,
)
from truing.estimation.rigid_poses.correlated_poses import with_correlations
from truing.estimation.rigid_poses.rigid import FitStatus, RigidFit
from truing.estimation.rotation import exp_so3, log_so3
from truing.report.numbers import count as counted
from truing.schemas.artifacts import ARTIFACTS
from truing.stages.common.overruled import chosen_by, exclusion_row
from truing.stages.common.point_arrays import (
    decisions,
    number_column,
    observation_rows,
    pose_covariances,
    pose_ids,
    pose_points,
    pose_vectors,
    positions,
    survey_points,
    text_column,
)
from truing.stages.common.point_errors import common_correlation, point_errors
from truing.stages.common.rows import Rows
from truing.stages.declaration import Outcome, Progress

if TYPE_CHECKING:
    from truing.estimation.rigid_poses.points import PosePoints, SurveyPoints
    from truing.schemas.campaign import Campaign
    from truing.schemas.sections import Overrule


MEASUREMENT = "measurement"
_COVARIANCE = [(i, j) for i in range(6) for j in range(i, 6)]
SOURCES = {"observations": "point", "scans": "dense scan", "measured_poses": "measured pose"}
SCAN, MEASURED = "scan", "measured"


def body_poses(tables: Mapping[str, pa.Table], settings: Campaign, progress: Progress) -> Outcome:
    """Return the tables of the pose stage: poses, residuals, and effects of common errors of the points on poses."""
    observations, survey = tables["observations"], tables.get("survey", ARTIFACTS["survey"].empty())
    poses = tuple(dict.fromkeys(pose for name in SOURCES for pose in pose_ids(tables[name])))
    network = (tables.get(name) for name in ("point_correlations", "point_sensitivities", "object_points"))
    errors, own = point_errors(observations, *network), None
    if errors is not None and errors.parameters:
        own = errors.of_each(common_correlation(tables.get("camera_correlations"), errors.parameters))
    fitted = alone = _fitted_by_targets(observations, survey, poses, own, settings, progress)
    if errors is not None:
        rows = [observation_rows(observations, body.name, poses, body.points.targets) for body in fitted]
        fitted = with_correlations(fitted, rows, errors)
    bodies = _with_poses(_with_poses(fitted, tables["scans"], SCAN, poses), tables["measured_poses"], MEASURED, poses)
    frame, reference = _frame(bodies, settings), settings.reference_body
    identifier = "int64" if isinstance(poses[0], int) else "string"
    artifacts = {
        "poses": poses_table(bodies, reference, identifier, frame),
        "residuals": residuals_table(bodies, identifier),
    }
    if settings.exclude:
        effects = exclusion_rows([(body, survey_points(survey, body.name)) for body in alone], settings)
        artifacts |= {"exclusion_effects": effects.table()} if effects.count else {}
    if errors is not None:
        between = covariances_table(fitted, reference, identifier)
        artifacts |= {"pose_covariances": between} if between.num_rows else {}
    if errors is not None and errors.parameters:
        artifacts["pose_sensitivities"] = sensitivities_table(fitted, reference, errors.parameters, identifier)
    counts = [counted(tables[name].num_rows, what) for name, what in SOURCES.items() if tables[name].num_rows]
    read = f"{' and '.join(counts)} of {counted(len(bodies), 'body')} in {counted(len(poses), 'pose')}"
    unmeasured = f"; the instrument's frame is taken for that of {frame}, which was not measured"
    figure = _figure(bodies) + (unmeasured if frame != MEASUREMENT else "")
    return Outcome(artifacts, read=read, left_out=_left_out(bodies), figure=figure)


def _frame(bodies: Sequence[BodyPoses], settings: Campaign) -> str:
    """Return the name of the measurement frame: the mechanism's base if the instrument stood still and the base was not
    measured."""
    reference = settings.reference_body
    is_measured = any(body.name == reference for body in bodies)
    is_base = settings.is_frame_fixed and settings.mechanism.is_legged and not is_measured
    return reference if is_base and reference is not None else MEASUREMENT


def _fitted_by_targets(
    observations: pa.Table,
    survey: pa.Table,
    poses: tuple[int | str, ...],
    own: Array | None,
    settings: Campaign,
    progress: Progress,
) -> list[BodyPoses]:
    """Return each body fitted alone; ``own`` (N, 3, 3): covariance of each observation without the errors common to all
    poses."""
    names = tuple(dict.fromkeys(observations.column("body").to_pylist()))
    bodies = []
    for done, name in enumerate(names):
        progress(done, len(names), name)
        points = pose_points(observations, name, poses)
        each = None if own is None else own[observation_rows(observations, name, poses, points.targets)]
        out = decided_points(points, name, settings.exclude, "excluded")
        keep = decided_points(points, name, settings.keep, "kept")
        bodies.append(fit_body(points, name, survey_points(survey, name), out, keep, each))
    return bodies


def _with_poses(
    bodies: Sequence[BodyPoses], table: pa.Table, method: str, poses: tuple[int | str, ...]
) -> list[BodyPoses]:
    """The bodies with the poses of a table, of scans or measured as such, as a further method; and bodies of which
    nothing else is known."""
    found = {body.name: body for body in bodies}
    for name in dict.fromkeys(table.column("body").to_pylist()):
        rows = table.filter(pc.equal(table.column("body"), name))
        place, rejected = positions(rows.column("pose"), poses), np.zeros(len(poses), np.int64)
        if method == SCAN:
            rejected[place] = number_column(rows, "n_rejected").astype(np.int64)
        body = found.get(name) or without_targets(name, poses, method)
        fits = {**body.fits, method: _fit_of_rows(rows, place, len(poses))}
        found[name] = replace(body, fits=fits, rejections={**body.rejections, method: rejected})
    return list(found.values())


def _fit_of_rows(rows: pa.Table, place: Index, count: int) -> RigidFit:
    """The poses of one body as a batch over all poses; a pose that is not in the table has too few points.

    Scans have an rms, a number of points and a status; poses that were measured as such have none of them.
    """
    R, t, covariance = np.full((count, 3, 3), np.nan), np.full((count, 3), np.nan), np.full((count, 6, 6), np.nan)
    rms, n_used = np.full(count, np.nan), np.zeros(count, np.int64)
    status = np.full(count, str(FitStatus.TOO_FEW_POINTS), dtype=object)
    vector, covariance[place] = pose_vectors(rows), pose_covariances(rows)
    known = np.isfinite(vector[:, 3:]).all(axis=1)
    t[place], R[place[known]] = vector[:, :3], exp_so3(vector[known, 3:])
    status[place] = str(FitStatus.OK)
    if "status" in rows.column_names:
        status[place], rms[place] = text_column(rows, "status"), 1e-3 * number_column(rows, "rms_mm")
        n_used[place] = number_column(rows, "n_used").astype(np.int64)
    ok = status == FitStatus.OK
    one = np.where(ok, 1.0, np.nan)
    rms = np.where(ok, rms, np.nan)
    return RigidFit(R, t, one, covariance, 0.0 * one, rms, n_used, status.astype(str), np.zeros(count, np.int64))


def _left_out(bodies: Sequence[BodyPoses]) -> str:
    """Return the number of rejected points in words, with the first three names."""
    rejected = [(b, *place) for b in bodies for place in np.argwhere(b.rejected)]
    if not rejected:
        return "no point"
    named = [
        f"{b.name} {b.points.targets[t]} in pose {b.points.poses[p]} ({b.reason[p, t]})" for b, p, t in rejected[:3]
    ]
    more = f" and {len(rejected) - 3} more" if len(rejected) > 3 else ""
    return f"{counted(len(rejected), 'point')}: {'; '.join(named)}{more}"


def _figure(bodies: Sequence[BodyPoses]) -> str:
    """Poses found and their root mean square residual, body by body."""
    words = []
    for body in bodies:
        ok = body.fit.ok
        known = ok & np.isfinite(body.fit.rms)
        rms = f", rms {1e3 * np.sqrt(np.mean(body.fit.rms[known] ** 2)):.4f} mm" if known.any() else ""
        words.append(f"{body.name} {ok.sum()} of {counted(len(ok), 'pose')}{rms}")
    return "; ".join(words)


def poses_table(
    bodies: Sequence[BodyPoses], reference: str | None, identifier: str, frame: str = MEASUREMENT
) -> pa.Table:
    """One row per pose, body and method; bodies other than the reference are seen from it, those of a campaign without
    it from ``frame``: what the frame of the measurement is called."""
    base = next((body for body in bodies if body.name == reference), None)
    parts = [
        _pose_columns(body, method, None if body is base else base, frame) for body in bodies for method in body.fits
    ]
    return _table("poses", parts, identifier)


def residuals_table(bodies: Sequence[BodyPoses], identifier: str) -> pa.Table:
    """One row per observed point: measured minus fitted by the default method, and whether it was used."""
    return _table("residuals", [_residual_columns(body) for body in bodies], identifier)


def _pose_columns(body: BodyPoses, method: str, base: BodyPoses | None, frame: str) -> dict[str, Any]:
    fit = body.fits[method]
    if base is None:
        R, p, covariance, status = fit.R, fit.t, fit.covariance, fit.status.astype(object)
    else:
        R, p, covariance, status = seen_from(base, fit, method, body.cross.get((method, base.name)))
    count = len(R)
    vector = np.full((count, 3), np.nan)
    ok = np.isfinite(R).all(axis=(1, 2))
    vector[ok] = log_so3(R[ok])
    return {
        "pose": np.array(body.points.poses, dtype=object),
        "body": np.full(count, body.name, dtype=object),
        "parent": np.full(count, frame if base is None else base.name, dtype=object),
        "method": np.full(count, method, dtype=object),
        "default": np.full(count, method == body.default),
        **{f"p{a}_mm": 1e3 * p[:, k] for k, a in enumerate("xyz")},
        **{f"r{a}_rad": vector[:, k] for k, a in enumerate("xyz")},
        **{f"cov_{i}_{j}": covariance[:, i, j] for i, j in _COVARIANCE},
        "rms_mm": 1e3 * fit.rms,
        "n_used": fit.n_used,
        "n_rejected": body.rejections[method],
        "status": status,
    }


def sensitivities_table(
    bodies: Sequence[BodyPoses], reference: str | None, parameters: Sequence[str], identifier: str
) -> pa.Table:
    """Return the change of each default pose by one standard deviation of each common parameter."""
    base = next((body for body in bodies if body.name == reference), None)
    reported = [body for body in bodies if body.effects is not None]
    parts = [_effect_columns(body, None if body is base else base, parameters) for body in reported]
    return _table("pose_sensitivities", parts, identifier)


def _effect_columns(body: BodyPoses, base: BodyPoses | None, parameters: Sequence[str]) -> dict[str, Any]:
    effects = cast("Array", body.effects)
    if base is not None and base.effects is not None:
        slope = relative_slope(base.fit.R, base.fit.t, body.fit.t)
        effects = slope @ np.concatenate([base.effects, effects], axis=1)
    at_pose, at_parameter = np.nonzero(np.isfinite(effects).all(axis=1))
    values = effects[at_pose, :, at_parameter]
    count = len(at_pose)
    return {
        "pose": np.array(body.points.poses, dtype=object)[at_pose],
        "body": np.full(count, body.name, dtype=object),
        "parent": np.full(count, MEASUREMENT if base is None else base.name, dtype=object),
        "parameter": np.array(parameters, dtype=object)[at_parameter],
        **{f"effect_{a}_mm": 1e3 * values[:, k] for k, a in enumerate("xyz")},
        **{f"effect_r{a}_rad": values[:, 3 + k] for k, a in enumerate("xyz")},
    }


def covariances_table(bodies: Sequence[BodyPoses], reference: str | None, identifier: str) -> pa.Table:
    """Covariances between the default poses of different bodies, as the reference sees them, where points have errors
    in common."""
    base = next((body for body in bodies if body.name == reference), None)
    others = [body for body in bodies if body is not base]
    parts = [_relative_pose_rows(body, other, base) for n, body in enumerate(others) for other in others[n + 1 :]]
    return _table("pose_covariances", [part for part in parts if part], identifier)


def _relative_pose_rows(body: BodyPoses, other: BodyPoses, base: BodyPoses | None) -> dict[str, Any]:
    """Rows for one pair of bodies, of the poses in which they, and the reference, were fitted together."""
    known = body.cross.get((body.default, other.name))
    if known is None:
        return {}
    covariance = known
    if base is not None:
        by_base, by_other = (one.cross.get((one.default, two.name)) for one, two in ((body, base), (base, other)))
        if by_base is None or by_other is None:
            return {}
        own, far = (relative_slope(base.fit.R, base.fit.t, one.fit.t) for one in (body, other))
        whole = np.block([[base.fit.covariance, by_other], [by_base, known]])
        covariance = own @ whole @ np.swapaxes(far, 1, 2)
    reported = np.flatnonzero(np.isfinite(covariance).all(axis=(1, 2)))
    pose, i, j = (grid.ravel() for grid in np.meshgrid(reported, np.arange(6), np.arange(6), indexing="ij"))
    return {
        "pose": np.array(body.points.poses, dtype=object)[pose],
        "measured_number": pose_numbers(body.name)[i],
        "other_number": pose_numbers(other.name)[j],
        "joint_covariance": covariance[pose, i, j],
    }


def _residual_columns(body: BodyPoses) -> dict[str, Any]:
    at_pose, at_target = np.nonzero(body.points.seen)
    residual = 1e3 * body.residual[at_pose, at_target]
    return {
        "pose": np.array(body.points.poses, dtype=object)[at_pose],
        "body": np.full(len(at_pose), body.name, dtype=object),
        "target": np.array(body.points.targets, dtype=object)[at_target],
        **{f"d{a}_mm": residual[:, k] for k, a in enumerate("xyz")},
        "weight": body.used[at_pose, at_target].astype(np.float64),
        "rejected": body.rejected[at_pose, at_target],
        "reason": np.array([r or None for r in body.reason[at_pose, at_target]], dtype=object),
        "decision": decisions(body.excluded, body.kept)[at_pose, at_target],
    }


def _table(name: str, parts: list[dict[str, Any]], identifier: str) -> pa.Table:
    """Return the parts as one table, with NaN as empty cells."""
    schema = ARTIFACTS[name].arrow_schema(identifier, ARTIFACTS[name].optional)
    if not parts:
        return schema.empty_table()
    columns = {key: np.concatenate([part[key] for part in parts]) for key in schema.names}
    return pa.table(
        [pa.array(columns[key], schema.field(key).type, from_pandas=True) for key in schema.names], schema=schema
    )


def exclusion_rows(bodies: Sequence[tuple[BodyPoses, SurveyPoints]], settings: Campaign) -> Rows:
    """A row per [[exclude]] and body that it concerns; all exclusions of a body are taken back together."""
    found = []
    for body, survey in bodies:
        points, name = body.points, body.name
        named = [(n, rule, chosen_points(points, name, rule)) for n, rule in enumerate(settings.exclude, 1)]
        named = [one for one in named if one[2].any()]
        if named:
            with_all = fit_body(points, name, survey, None, decided_points(points, name, settings.keep, "kept"))
            found += [(number, _exclusion(number, rule, chosen, body, with_all)) for number, rule, chosen in named]
    rows = Rows("exclusion_effects")
    for _, row in sorted(found, key=lambda one: one[0]):
        rows.add(**row)
    return rows


def _exclusion(number: int, rule: Overrule, chosen: Mask, body: BodyPoses, with_all: BodyPoses) -> dict[str, object]:
    off = largest_motion(body, with_all)[chosen.any(axis=1)]  # NaN: a pose that is lost without these points
    sigma = float(np.sqrt(np.median(np.einsum("nii->n", body.points.cov[body.points.seen])) / 3.0))
    return {
        **exclusion_row(number, rule, body.name, 1e3 * off, off / sigma),
        "rows": int(chosen.sum()),
        "gross_anyway": int((with_all.rejected & chosen).sum()),
        "unit": "mm",
    }


def decided_points(points: PosePoints, body: str, rules: Iterable[Overrule], verb: str) -> PointDecisions:
    """The points of a body that rules name; verb: excluded, or kept."""
    return PointDecisions(*chosen_by(points.seen.shape, rules, verb, lambda rule: chosen_points(points, body, rule)))


def chosen_points(points: PosePoints, body: str, rule: Overrule) -> Mask:
    """Return the mask (B, T) of points of a body that a rule matches; an absent key matches all, and a run matches
    none."""
    if rule.body not in (None, body):
        return np.zeros(points.seen.shape, bool)
    at_pose = np.array([rule.pose is None or str(rule.pose) == str(pose) for pose in points.poses], dtype=bool)
    at_target = np.array([rule.target in (None, target) for target in points.targets], dtype=bool)
    return np.asarray(at_pose[:, None] & at_target & points.seen)
