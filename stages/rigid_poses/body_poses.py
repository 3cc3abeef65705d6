"""From points, dense scans and measured poses to where each body is in each pose, and what is said of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from truing.estimation.rigid_poses.body_poses import BodyPoses, fit_body, without_targets
from truing.estimation.rigid_poses.correlated_poses import with_correlations
from truing.estimation.rigid_poses.rigid import FitStatus, RigidFit
from truing.estimation.rotation import exp_so3
from truing.report.numbers import count as counted
from truing.schemas.artifacts import ARTIFACTS
from truing.stages.common.point_arrays import (
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
from truing.stages.declaration import Outcome, Progress
from truing.stages.rigid_poses.exclusions import decided_points, exclusion_rows
from truing.stages.rigid_poses.tables import (
    MEASUREMENT,
    covariances_table,
    poses_table,
    residuals_table,
    sensitivities_table,
)

if TYPE_CHECKING:
    from truing.schemas.campaign import Campaign

SOURCES = {"observations": "point", "scans": "dense scan", "measured_poses": "measured pose"}
SCAN, MEASURED = "scan", "measured"


def body_poses(tables: Mapping[str, pa.Table], settings: Campaign, progress: Progress) -> Outcome:
    """The tables of the pose stage: poses, residuals, and what errors that points have in common do to poses."""
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
    """What the frame of the measurement is called: that of the mechanism's base where the instrument stood still and
    nobody measured the base."""
    reference = settings.reference_body
    is_measured = any(body.name == reference for body in bodies)
    is_base = settings.is_frame_fixed and settings.mechanism.is_legged and not is_measured
    return reference if is_base and reference is not None else MEASUREMENT


def _fitted_by_targets(
    observations: pa.Table,
    survey: pa.Table,
    poses: tuple[int | str, ...],
    own: NDArray[np.float64] | None,
    settings: Campaign,
    progress: Progress,
) -> list[BodyPoses]:
    """Every body by itself; own (N, 3, 3): the covariance of each observation without what is common to all poses."""
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


def _fit_of_rows(rows: pa.Table, place: NDArray[np.int64], count: int) -> RigidFit:
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
    """How many points were kept out, with the first few by name."""
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
