"""Body poses from points, dense scans and measured poses, as tables and in words."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from truing.arrays import Array, Index
from truing.estimation.blocks import pose_blocks
from truing.estimation.rigid_poses.body_estimate import BodyEstimate, estimate_body
from truing.estimation.rigid_poses.body_poses import BodyPoses, without_targets
from truing.estimation.rigid_poses.correlated_poses import with_correlations
from truing.estimation.rigid_poses.points import PointErrors
from truing.estimation.rigid_poses.rigid import FitStatus, RigidFit
from truing.estimation.rotation import exp_so3
from truing.report.numbers import count_text
from truing.schemas.artifact import StoredTable, full_table, plain_texts
from truing.schemas.artifacts import ARTIFACTS
from truing.stages.common.compact_points import ObservedNames, compact_points, observed_names
from truing.stages.common.point_arrays import (
    number_column,
    observation_rows,
    pose_covariances,
    pose_ids,
    pose_vectors,
    positions,
    survey_points,
    text_column,
)
from truing.stages.common.point_errors import common_correlation, point_errors
from truing.stages.declaration import Outcome, Progress
from truing.stages.rigid_poses.point_decisions import decided_points, exclusion_rows
from truing.stages.rigid_poses.pose_tables import (
    MEASUREMENT,
    covariances_table,
    poses_table,
    residuals_table,
    sensitivities_table,
    table_schema,
)
from truing.threads import in_order

if TYPE_CHECKING:
    from truing.schemas.campaign import Campaign

SOURCES = {"observations": "point", "scans": "dense scan", "measured_poses": "measured pose"}
SCAN, MEASURED = "scan", "measured"


def body_poses(tables: Mapping[str, Any], settings: Campaign, progress: Progress) -> Outcome:
    """Return the tables of the pose stage: poses, residuals, and effects of common errors of the points on poses.

    Many poses and residuals are streams, computed block by block while they are written. ``observations`` may be a
    StoredTable.
    """
    names = observed_names(tables["observations"])
    ids_elsewhere = chain(*(pose_ids(tables[name]) for name in SOURCES if name != "observations"))
    names = replace(names, poses=tuple(dict.fromkeys((*names.poses, *ids_elsewhere))))
    errors, common_sensitivity = _common_errors(tables)
    survey = tables.get("survey", ARTIFACTS["survey"].empty())
    estimates = _estimates(tables["observations"], names, survey, common_sensitivity, settings, progress)
    correlated = None if errors is None else _correlated(estimates, full_table(tables["observations"]), errors)
    stream = _PoseStream(estimates, correlated, (tables["scans"], tables["measured_poses"]), names.poses, settings)
    artifacts = {"poses": stream.poses(), "residuals": stream.residuals()}
    if settings.exclude:
        effects = exclusion_rows([(body, survey_points(survey, body.name)) for body in estimates], settings)
        artifacts |= {"exclusion_effects": effects.table()} if effects.count else {}
    if correlated is not None and errors is not None:
        artifacts |= _tables_of_errors(correlated, errors, settings, stream.identifier)
    counts = [count_text(tables[name].num_rows, what) for name, what in SOURCES.items() if tables[name].num_rows]
    read = f"{' and '.join(counts)} of {count_text(len(stream.fits), 'body')} in {count_text(len(names.poses), 'pose')}"
    unmeasured = f"; the instrument's frame is taken for that of {stream.frame}, which was not measured"
    figure = _figure(stream.fits) + _shapes(estimates) + (unmeasured if stream.frame != MEASUREMENT else "")
    return Outcome(
        artifacts, read=read, left_out=_left_out(estimates if correlated is None else correlated), figure=figure
    )


def _common_errors(tables: Mapping[str, object]) -> tuple[PointErrors | None, Array | None]:
    """Return errors that points have in common, and the covariance (N, 3, 3) of each observation without those common
    to all poses; None without any."""
    if tables.get("point_correlations") is None:
        return None, None
    network = (tables.get(name) for name in ("point_correlations", "point_sensitivities", "object_points"))
    errors = point_errors(full_table(tables["observations"]), *network)
    if errors is None or not errors.parameters:
        return errors, None
    return errors, errors.of_each(common_correlation(tables.get("camera_correlations"), errors.parameters))


def _estimates(
    observations: pa.Table | StoredTable,
    names: ObservedNames,
    survey: pa.Table,
    unshared: Array | None,
    settings: Campaign,
    progress: Progress,
) -> list[BodyEstimate]:
    """Return each body fitted alone.

    unshared (N, 3, 3): covariance of each observation without the errors common to all poses.
    """
    bodies = []
    for index, (name, points) in enumerate(compact_points(observations, names).items()):
        progress(index, len(names.targets), name)
        excluded = decided_points(points, name, settings.exclude, "excluded")
        kept = decided_points(points, name, settings.keep, "kept")
        cov_independent = None
        if unshared is not None:
            cov_independent = unshared[observation_rows(full_table(observations), name, names.poses, points.targets)]
        bodies.append(estimate_body(points, name, survey_points(survey, name), excluded, kept, cov_independent))
    return bodies


def _correlated(estimates: Sequence[BodyEstimate], observations: pa.Table, errors: PointErrors) -> list[BodyPoses]:
    """Return all poses of the bodies, fitted together with the common errors of their points."""
    rows = [
        observation_rows(observations, estimate.name, estimate.points.poses, estimate.points.targets)
        for estimate in estimates
    ]
    return with_correlations([estimate.poses(slice(None)) for estimate in estimates], rows, errors)


def _tables_of_errors(
    bodies: Sequence[BodyPoses], errors: PointErrors, settings: Campaign, identifier: str
) -> dict[str, pa.Table]:
    reference = settings.reference_body
    between = covariances_table(bodies, reference, identifier)
    tables = {"pose_covariances": between} if between.num_rows else {}
    if errors.parameters:
        tables["pose_sensitivities"] = sensitivities_table(bodies, reference, errors.parameters, identifier)
    return tables


@dataclass(frozen=True)
class _PoseStream:
    """The bodies of a campaign as streams of tables; whole: all poses at once, if they have errors in common; others:
    poses from scans, and measured ones."""

    estimates: Sequence[BodyEstimate]
    whole: Sequence[BodyPoses] | None
    others: tuple[pa.Table, pa.Table]
    ids: tuple[int | str, ...]
    settings: Campaign

    @property
    def identifier(self) -> str:
        """Type of the column of poses."""
        return "int64" if isinstance(self.ids[0], int) else "string"

    @cached_property
    def fits(self) -> dict[str, RigidFit]:
        """Default fit of each body over all poses."""
        fits_by_name = {estimate.name: estimate.common.fit for estimate in self.estimates}
        fits_by_name |= {} if self.whole is None else {body.name: body.fit for body in self.whole}
        others = {body.name: body.fit for body in self._with_others([], self.ids)}
        return fits_by_name | {name: fit for name, fit in others.items() if name not in fits_by_name}

    @property
    def frame(self) -> str:
        """Name of the measurement frame: the mechanism's base if the instrument stood still and the base was not
        measured."""
        reference = self.settings.reference_body
        is_base = self.settings.is_frame_fixed and self.settings.mechanism.is_legged and reference not in self.fits
        return reference if is_base and reference is not None else MEASUREMENT

    def poses(self) -> pa.Table | pa.RecordBatchReader:
        """Poses, computed while they are read if they are many."""
        reference, frame = self.settings.reference_body, self.frame
        return self._stream("poses", lambda bodies: poses_table(bodies, reference, self.identifier, frame))

    def residuals(self) -> pa.Table | pa.RecordBatchReader:
        """Residuals, computed while they are read if they are many."""
        return self._stream("residuals", lambda bodies: residuals_table(bodies, self.identifier), every=False)

    def _stream(
        self, name: str, table: Callable[[Sequence[BodyPoses]], pa.Table], *, every: bool = True
    ) -> pa.Table | pa.RecordBatchReader:
        """Return a table of all blocks of poses; ``every``: by every method, not only by the default one."""
        targets = sum(len(estimate.points.targets) for estimate in self.estimates)
        blocks = [slice(0, len(self.ids))] if self.whole is not None else pose_blocks(len(self.ids), targets)
        tables = in_order(lambda rows: table(self._bodies(rows, every)), blocks)
        if len(blocks) == 1:
            return plain_texts(next(tables))
        schema = table_schema(name, self.identifier)
        return pa.RecordBatchReader.from_batches(
            schema, (batch for batches in tables for batch in batches.to_batches())
        )

    def _bodies(self, rows: slice, every: bool) -> list[BodyPoses]:
        bodies = (
            self.whole if self.whole is not None else [estimate.poses(rows, every=every) for estimate in self.estimates]
        )
        return self._with_others(bodies, self.ids[rows])

    def _with_others(self, bodies: Sequence[BodyPoses], poses: tuple[int | str, ...]) -> list[BodyPoses]:
        scans, measured = self.others
        return _with_poses(_with_poses(bodies, scans, SCAN, poses), measured, MEASURED, poses)


def _with_poses(
    bodies: Sequence[BodyPoses], table: pa.Table, method: str, poses: tuple[int | str, ...]
) -> list[BodyPoses]:
    """The bodies with the poses of a table, of scans or measured directly, as a further method; and bodies of which
    nothing else is known."""
    by_name = {body.name: body for body in bodies}
    for name in dict.fromkeys(table.column("body").to_pylist()):
        rows = table.filter(pc.equal(table.column("body"), name))
        pose_index, rejected = positions(rows.column("pose"), poses), np.zeros(len(poses), np.int64)
        rows, pose_index = rows.filter(pa.array(pose_index >= 0)), pose_index[pose_index >= 0]
        if method == SCAN:
            rejected[pose_index] = number_column(rows, "n_rejected").astype(np.int64)
        body = by_name.get(name) or without_targets(name, poses, method)
        fits = {**body.fits, method: _fit_of_rows(rows, pose_index, len(poses))}
        by_name[name] = replace(body, fits=fits, rejections={**body.rejections, method: rejected})
    return list(by_name.values())


def _fit_of_rows(rows: pa.Table, pose_index: Index, count: int) -> RigidFit:
    """The poses of one body as a batch over all poses; a pose that is not in the table has too few points.

    Scans have an rms, a number of points and a status; poses that were measured directly have none of them.
    """
    R, t, covariance = np.full((count, 3, 3), np.nan), np.full((count, 3), np.nan), np.full((count, 6, 6), np.nan)
    rms, n_used = np.full(count, np.nan), np.zeros(count, np.int64)
    status = np.full(count, str(FitStatus.TOO_FEW_POINTS), dtype=object)
    vector, covariance[pose_index] = pose_vectors(rows), pose_covariances(rows)
    known = np.isfinite(vector[:, 3:]).all(axis=1)
    t[pose_index], R[pose_index[known]] = vector[:, :3], exp_so3(vector[known, 3:])
    status[pose_index] = str(FitStatus.OK)
    if "status" in rows.column_names:
        status[pose_index], rms[pose_index] = text_column(rows, "status"), 1e-3 * number_column(rows, "rms_mm")
        n_used[pose_index] = number_column(rows, "n_used").astype(np.int64)
    ok = status == FitStatus.OK
    ones = np.where(ok, 1.0, np.nan)
    rms = np.where(ok, rms, np.nan)
    return RigidFit(R, t, ones, covariance, 0.0 * ones, rms, n_used, status.astype(str), np.zeros(count, np.int64))


def _left_out(bodies: Sequence[BodyEstimate | BodyPoses]) -> str:
    """Return the number of rejected points in words, with the first three names."""
    rejected_points = [np.argwhere(body.rejected) for body in bodies]
    total = sum(map(len, rejected_points))
    if not total:
        return "no point"
    first = [
        (body, *point_index)
        for body, place_of_point in zip(bodies, rejected_points, strict=True)
        for point_index in place_of_point[:3]
    ][:3]
    remainder = f" and {total - 3} more" if total > 3 else ""
    return f"{count_text(total, 'point')}: {'; '.join(_named(*point_index) for point_index in first)}{remainder}"


def _named(body: BodyEstimate | BodyPoses, pose: int, target: int) -> str:
    points = body.points
    why = body.reason[pose, target] if isinstance(body, BodyPoses) else body.reason(pose, target)
    return f"{body.name} {points.targets[target]} in pose {points.poses[pose]} ({why})"


def _figure(fits: Mapping[str, RigidFit]) -> str:
    """Poses found and their root mean square residual, body by body."""
    words = []
    for name, fit in fits.items():
        known = fit.ok & np.isfinite(fit.rms)
        rms = f", rms {1e3 * np.sqrt(np.mean(fit.rms[known] ** 2)):.4f} mm" if known.any() else ""
        words.append(f"{name} {fit.ok.sum()} of {count_text(len(fit.ok), 'pose')}{rms}")
    return "; ".join(words)


def _shapes(estimates: Sequence[BodyEstimate]) -> str:
    """Bodies whose shape was estimated from some of their poses, in words; empty for none."""
    some = [estimate for estimate in estimates if 0 < estimate.common.shape_poses < len(estimate.points.poses)]
    words = (f"{estimate.name} from {count_text(estimate.common.shape_poses, 'pose')}" for estimate in some)
    return f"; shape without a survey: {', '.join(words)}" if some else ""
