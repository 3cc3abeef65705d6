"""Pose: where each body is in each pose, by every estimator, and what its targets say against it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from truing.report.numbers import count as counted
from truing.schemas.artifacts import ARTIFACTS
from truing.stages.common.why_not import NO_BODIES
from truing.stages.declaration import Outcome, Progress, Stage

if TYPE_CHECKING:
    import pyarrow as pa
    from numpy.typing import NDArray

    from truing.estimation.rigid_poses.body_poses import BodyPoses
    from truing.schemas.campaign import Campaign
    from truing.simulation.bench.optics import BeamGeometry

DECLARATION = Stage(
    name="pose",
    reads=(
        *("observations?", "survey?", "scans?", "measured_poses?", "readings?", "given_compliance?"),
        *("object_points?", "point_correlations?", "point_sensitivities?", "camera_correlations?"),
        "qa?",
    ),
    leaves=(
        *("poses?", "residuals?", "pose_sensitivities?", "pose_covariances?"),
        *("displacement?", "reading_residuals?", "run_terms?", "exclusion_effects?"),
    ),
    settings=(
        *("campaign.kind", "bodies", "measurement.frame", "mechanism.type", "exclude", "keep", "interferometer.beams"),
        *("mechanism.legs", "mechanism.height_mm", "mechanism.elements", "mechanism.tolerance"),
    ),
    summary="rigid-body poses or displacements under load, with covariance, and the residuals of every reading",
)


def run(tables: Mapping[str, pa.Table], settings: Campaign, progress: Progress) -> Outcome:
    """Fit every body in every pose, relative to its survey where there is one, and see it from the reference body.

    Points that came out of a network of rays are fitted with what their errors have in common, all bodies of a pose
    together. Of a loaded platform: join its readings to displacements.
    """
    if settings.campaign.kind == "interferometer":
        return _of_loads(tables, settings)
    from truing.stages.common.belonging import withheld

    without = NO_BODIES.get(settings.mechanism.type, "no object points")
    names = ("observations", "scans", "measured_poses")
    observations, scans, measured = (tables.get(name, ARTIFACTS[name].empty()) for name in names)
    why = "" if observations.num_rows or scans.num_rows or measured.num_rows else without
    if why := why or withheld(tables, of_poses=True):
        empty = {name: ARTIFACTS[name].empty() for name in ("poses", "residuals")}
        return Outcome.not_evaluated(empty, why)
    from truing.estimation.rigid_poses.correlated_bodies import with_correlations
    from truing.stages.common.point_arrays import observation_rows, pose_ids
    from truing.stages.common.point_errors import common_correlation, point_errors
    from truing.stages.rigid_poses.tables import covariances_table, poses_table, residuals_table, sensitivities_table
    from truing.stages.rigid_poses.untargeted_poses import with_measured, with_scans

    poses = tuple(dict.fromkeys([*pose_ids(observations), *pose_ids(scans), *pose_ids(measured)]))
    network = (tables.get(name) for name in ("point_correlations", "point_sensitivities", "object_points"))
    errors = point_errors(observations, *network)
    own = None
    if errors is not None and errors.parameters:
        own = errors.of_each(common_correlation(tables.get("camera_correlations"), errors.parameters))
    fitted = alone = _bodies(observations, tables.get("survey"), poses, own, settings, progress)
    if errors is not None:
        rows = [observation_rows(observations, body.name, poses, body.points.targets) for body in fitted]
        fitted = with_correlations(fitted, rows, errors)
    bodies = with_measured(with_scans(fitted, scans, poses), measured, poses)
    frame = _frame(bodies, settings)
    identifier = "int64" if isinstance(poses[0], int) else "string"
    artifacts = {
        "poses": poses_table(bodies, settings.reference_body, identifier, frame),
        "residuals": residuals_table(bodies, identifier),
        **_exclusion_effects(alone, tables.get("survey"), settings),
    }
    if errors is not None:
        between = covariances_table(fitted, settings.reference_body, identifier)
        artifacts |= {"pose_covariances": between} if between.num_rows else {}
    if errors is not None and errors.parameters:
        of_common = (settings.reference_body, errors.parameters, identifier)
        artifacts["pose_sensitivities"] = sensitivities_table(fitted, *of_common)
    counts = ((observations, "point"), (scans, "dense scan"), (measured, "measured pose"))
    sources = " and ".join(counted(table.num_rows, what) for table, what in counts if table.num_rows)
    read = f"{sources} of {counted(len(bodies), 'body')} in {counted(len(poses), 'pose')}"
    return Outcome(artifacts, read=read, left_out=_left_out(bodies), figure=_figure(bodies) + _frame_words(frame))


def _frame(bodies: Sequence[BodyPoses], settings: Campaign) -> str:
    """What the frame of the measurement is called: that of the mechanism's base where the instrument stood still and
    nobody measured the base."""
    from truing.stages.rigid_poses.tables import MEASUREMENT

    reference = settings.reference_body
    is_measured = any(body.name == reference for body in bodies)
    is_base = settings.is_frame_fixed and settings.mechanism.is_legged and not is_measured
    return reference if is_base and reference is not None else MEASUREMENT


def _frame_words(frame: str) -> str:
    from truing.stages.rigid_poses.tables import MEASUREMENT

    return (
        "" if frame == MEASUREMENT else f"; the instrument's frame is taken for that of {frame}, which was not measured"
    )


def _of_loads(tables: Mapping[str, pa.Table], settings: Campaign) -> Outcome:
    if "readings" not in tables or not tables["readings"].num_rows:
        empty = {name: ARTIFACTS[name].empty() for name in ("displacement", "reading_residuals", "run_terms")}
        return Outcome.not_evaluated(empty, "no readings of displacement")
    from truing.stages.sensor.platform_poses import platform_poses

    return platform_poses(tables["readings"], _geometry(tables, settings), settings)


def _geometry(tables: Mapping[str, pa.Table], settings: Campaign) -> BeamGeometry | None:
    """How beams are declared to see the platform; None where they see it along their axes."""
    beams = settings.interferometer.beams
    if beams.are_plain:
        return None
    from truing.simulation.bench.optics import BeamGeometry
    from truing.stages.common.declared_optics import beam_optics
    from truing.stages.common.nominal_sensor import simulated_compliance

    return BeamGeometry(beam_optics(beams), simulated_compliance(settings, tables.get("given_compliance")))


def _bodies(
    observations: pa.Table,
    survey: pa.Table | None,
    poses: tuple[int | str, ...],
    own: NDArray[np.float64] | None,
    settings: Campaign,
    progress: Progress,
) -> list[BodyPoses]:
    """Every body by itself; own (N, 3, 3): the covariance of each observation without what is common to all poses."""
    from truing.estimation.rigid_poses.body_poses import fit_body
    from truing.stages.common.point_arrays import observation_rows, pose_points, survey_points
    from truing.stages.rigid_poses.exclusions import decided_points

    survey = ARTIFACTS["survey"].empty() if survey is None else survey
    names = tuple(dict.fromkeys(observations.column("body").to_pylist()))
    bodies = []
    for done, name in enumerate(names):
        progress(done, len(names), name)
        points = pose_points(observations, name, poses)
        each = None if own is None else own[observation_rows(observations, name, poses, points.targets)]
        out, keep = (
            decided_points(points, name, rules, verb)
            for rules, verb in ((settings.exclude, "excluded"), (settings.keep, "kept"))
        )
        bodies.append(fit_body(points, name, survey_points(survey, name), out, keep, each))
    return bodies


def _exclusion_effects(bodies: Sequence[BodyPoses], survey: pa.Table | None, settings: Campaign) -> dict[str, pa.Table]:
    if not settings.exclude:
        return {}
    from truing.stages.common.point_arrays import survey_points
    from truing.stages.rigid_poses.exclusions import exclusion_rows

    known = ARTIFACTS["survey"].empty() if survey is None else survey
    rows = exclusion_rows([(body, survey_points(known, body.name)) for body in bodies], settings)
    return {"exclusion_effects": rows.table()} if rows.count else {}


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
