"""Data of the diagnosis without a mechanism: measured points of all bodies."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from truing.estimation.rigid_poses.points import PosePoints
from truing.estimation.target_positions import median_places
from truing.report.numbers import count_text
from truing.schemas.covariates import column_alias
from truing.schemas.verdict import Relation
from truing.simulation.bodies.causes.terms import CAME_FROM, place_columns
from truing.simulation.bodies.measured_bodies import (
    FEWEST_TARGETS,
    BodyPlaces,
    BodyTargets,
    MeasuredBodies,
    fixed_body,
    frame_is_common,
    free_body,
    measured_body,
)
from truing.simulation.bodies.model import BodyModel, KnownBodies
from truing.simulation.inputs import TIME, approach, numbers_rows, order_in_time
from truing.simulation.targets import shape_unknowns
from truing.stages.common.blocks import groupings_of, labels_of, readings_of, repeats_of, selected_groupings
from truing.stages.common.missing_data import (
    HELD_OUT,
    NO_BODY_TO_DIAGNOSE,
    why_reference_unseen,
    why_too_few_determined,
)
from truing.stages.common.point_arrays import (
    default_motions,
    number_column,
    point_residuals,
    pose_ids,
    pose_points,
    positions,
    roles_of,
    survey_points,
)
from truing.stages.diagnosis.diagnosis_data import DiagnosisData, InstrumentResults
from truing.stages.diagnosis.residual_tables import prediction_table

if TYPE_CHECKING:
    from truing.inference.selection import CauseDiagnosis
    from truing.schemas.campaign import Campaign
    from truing.simulation.effects_model import EffectsModel

Array = NDArray[np.float64]

# Number of poses that always fit into memory.
_ALWAYS = 60
# Smallest movement of a drive that counts, as a share of its range.
_MOVED = 1e-3
# Largest size of all candidates of a search; above it, poses are left out evenly. A body's targets have about so
# many candidate courses, each with a pattern of its own.
_MOST_NUMBERS, _COURSES = 6_000_000, 16


def assemble_bodies(tables: Mapping[str, pa.Table], settings: Campaign) -> DiagnosisData[BodyModel]:
    """Data of the diagnosis; raises ValueError with the reason if the campaign lacks them."""
    if any(name not in tables or not tables[name].num_rows for name in ("observations", "poses", "residuals")):
        raise ValueError("needs measured points of bodies")
    poses = pose_ids(tables["observations"])
    covariates, role = known_of_poses(tables.get("configurations"), poses, settings.campaign.drives)
    measured_bodies, words = _targets(tables, poses, covariates["order"], settings.noise.point_mm)
    if not measured_bodies:
        raise ValueError(_why_none(tables, settings.reference_body))
    body_places = [_body_places(body, settings, covariates) for body in measured_bodies]
    bodies = MeasuredBodies.relative_to_reference(measured_bodies, body_places, settings.reference_body)
    covariates |= bodies.places(covariates["order"]) if not settings.campaign.drives else {}
    if settings.measurement.up is not None:
        covariates |= bodies.gravity(settings.measurement.up, settings.reference_body)
    model = _model(bodies, covariates, poses, settings)
    usable = np.any([body.ok for body in measured_bodies], 0)
    fitted, held_out = usable & (role != HELD_OUT), usable & (role == HELD_OUT)
    if why := why_too_few_determined(int(fitted.sum())):
        raise ValueError(why)
    fitted, thinned = _thinned(fitted, model)
    words += (
        [f"{count_text(int((~usable).sum()), 'pose')} without a body that is determined"] if not usable.all() else []
    )
    table = tables.get("configurations")
    repeats = repeats_of(table, poses, settings.campaign.drives, settings.noise.actuator_mm)
    came = [covariates[name][fitted] for name in covariates if name.startswith(CAME_FROM)]
    asked = readings_of(table, poses, settings.campaign.drives)[fitted]
    time, known = covariates.get("time_s"), selected_groupings(labels_of(table, poses), fitted)
    approach = np.column_stack(came) if came else None
    groupings = groupings_of(asked, None if time is None else time[fitted], approach, known)
    return DiagnosisData(
        model.at(model.conditions.subset(fitted)),
        replace(
            bodies.epochs(model.conditions, fitted),
            repeats=None if repeats is None else repeats[fitted],
            groupings=groupings,
        ),
        bodies.epochs(model.conditions, held_out) if held_out.any() else None,
        "; ".join([*words, *thinned]),
        _results,
        tuple(cause for body in measured_bodies for cause in body.certain),
        relation=Relation.BODIES_SURVEY,
    )


def _targets(
    tables: Mapping[str, pa.Table], poses: tuple[int | str, ...], order: Array, noise_mm: float | None
) -> tuple[list[BodyTargets], list[str]]:
    """Every body with three targets seen together in three poses, and omissions in words."""
    measured_bodies, words = [], []
    for name in dict.fromkeys(tables["observations"].column("body").to_pylist()):
        body = _body(tables, name, poses, order, (noise_mm or 0.0) * 1e-3)
        if body is None:
            words.append(f"body {name} (no three targets seen together in three poses)")
            continue
        lost_poses = int((~body.ok & body.is_observed.any(1)).sum())
        words += (
            [f"{count_text(lost_poses, 'pose')} of body {name}, not determined by its targets"] if lost_poses else []
        )
        measured_bodies.append(body)
    return measured_bodies, words


def _body(
    tables: Mapping[str, pa.Table], name: str, poses: tuple[int | str, ...], order: Array, noise: float
) -> BodyTargets | None:
    points = pose_points(tables["observations"], name, poses)
    survey = survey_points(tables["survey"], name) if "survey" in tables else None
    cov = None
    if survey is not None and survey.targets:
        points = pose_points(tables["observations"], name, poses, survey.targets)
        shape, cov = survey.points, survey.cov
    else:
        shape = _measured_shape(tables, name, points)
    enough = np.asarray(np.isfinite(shape).all(1) & points.is_observed.any(0))
    if enough.sum() < FEWEST_TARGETS:
        return None
    points = PosePoints(
        poses,
        tuple(t for t, has_enough in zip(points.targets, enough, strict=True) if has_enough),
        points.points[:, enough],
        points.cov[:, enough],
        points.is_observed[:, enough],
    )
    residuals = point_residuals(tables["residuals"], name, poses, points.targets)
    return measured_body(name, points, residuals, shape[enough], None if cov is None else cov[enough], order, noise)


def _measured_shape(tables: Mapping[str, pa.Table], name: str, points: PosePoints) -> Array:
    """Positions of targets (k, 3) on an unsurveyed body: their median over the poses."""
    R, t = default_motions(tables["poses"], name, points.poses)
    ok = np.isfinite(t[:, 0]) & np.isfinite(R[:, 0, 0])
    positions = np.einsum("bji,bkj->bki", np.nan_to_num(R), points.points - np.nan_to_num(t)[:, None])
    known = points.is_observed & ok[:, None]
    trusted = known & point_residuals(tables["residuals"], name, points.poses, points.targets).fitted
    return median_places(positions, np.where(trusted.any(0), trusted, known))


def _body_places(body: BodyTargets, settings: Campaign, covariates: Mapping[str, Array]) -> BodyPlaces:
    """Constraint on a body's position: fixed if it is the reference and hardly moves, or is declared stationary.

    A body declared stationary keeps one position for every combination of the drives.
    """
    order = covariates["order"]
    named = body.name in settings.bodies.still
    if (named or body.name == settings.reference_body) and frame_is_common(body, order):
        return fixed_body(body, np.zeros(len(order), np.int64), order)
    drives = [covariates[d] for d in map(column_alias, settings.campaign.drives) if d in covariates]
    if named and drives:
        level = np.unique(np.column_stack(drives), axis=0, return_inverse=True)[1].ravel()
        if 2 * (level.max() + 1) <= len(level) + 1:  # most positions must be seen twice for a comparison
            return fixed_body(body, level, order)
    return free_body(body)


def _why_none(tables: Mapping[str, pa.Table], reference: str | None) -> str:
    """Reason why no body can be diagnosed."""
    bodies, poses = (tables["observations"].column(name).to_pylist() for name in ("body", "pose"))
    seen = Counter(pose for body, pose in zip(bodies, poses, strict=True) if body == reference)
    is_seen_from = reference in tables["poses"].column("parent").to_pylist()
    why = why_reference_unseen(str(reference), max(seen.values())) if seen and is_seen_from else ""
    return why or NO_BODY_TO_DIAGNOSE


def known_of_poses(
    table: pa.Table | None, poses: tuple[int | str, ...], drives: tuple[str, ...]
) -> tuple[dict[str, Array], NDArray]:
    """Covariates (B,) by column, with the order in time and the direction of each drive's last movement; roles (B,)."""
    role = np.full(len(poses), "", object) if table is None else roles_of(table, poses)
    covariates: dict[str, Array] = {}
    if table is not None:
        index = positions(table.column("pose"), poses)
        for field in table.schema:
            if field.name not in ("pose", "role") and str(field.type) in ("double", "int64"):
                values = np.full(len(poses), np.nan)
                values[index[index >= 0]] = number_column(table, field.name)[index >= 0]
                if field.name == TIME or field.name in drives or not numbers_rows(field.name, values):
                    covariates[column_alias(field.name)] = values
    time = covariates.get("time_s")
    if time is not None and np.array_equal(np.diff(np.sort(time)), np.ones(len(time) - 1)):
        del covariates["time_s"]  # numbers of rows, and no seconds
    covariates["order"] = order_in_time(time, len(poses))
    for drive in map(column_alias, drives):
        if drive in covariates and np.ptp(covariates[drive]) > 0:
            least = _MOVED * float(np.ptp(covariates[drive]))
            covariates[CAME_FROM + drive] = approach(covariates[drive][:, None], covariates["order"], least)[:, 0]
    return covariates, role


def _model(
    bodies: MeasuredBodies, covariates: Mapping[str, Array], poses: tuple[int | str, ...], settings: Campaign
) -> BodyModel:
    all_bodies, targets = bodies.bodies, bodies.targets
    shape = np.concatenate([body.shape for body in all_bodies])
    known = KnownBodies(
        shape,
        shape_unknowns(targets, shape, np.concatenate([body.shape_cov for body in all_bodies])),
        np.repeat([body.surveyed for body in all_bodies], [3 * len(body.names) - 6 for body in all_bodies]),
        np.array([body_place.levels for body_place in bodies.body_places]),
        np.stack([place.jitter for place in bodies.body_places]),
        bodies.lead,
        tuple(map(column_alias, settings.campaign.drives)),
        tuple(body.name for body in all_bodies if place_columns(body.name)[0] in covariates),
        settings.mechanism.reference_temperature_c,
    )
    return BodyModel(targets, bodies.conditions(covariates, poses), known)


def _thinned(rows: NDArray[np.bool_], model: BodyModel) -> tuple[NDArray[np.bool_], list[str]]:
    """Poses that fit into memory together, evenly over the campaign, and the omission in words."""
    count, coordinates = int(rows.sum()), 3 * len(model.targets.body)
    columns = model.shared_size + model.local_size + _COURSES * (coordinates + 6 * int(model.known.is_stationary.sum()))
    most = max(_MOST_NUMBERS // (coordinates * columns), _ALWAYS)
    if count <= most:
        return rows, []
    seen_rows = np.zeros_like(rows)
    seen_rows[np.flatnonzero(rows)[np.linspace(0, count - 1, most).round().astype(int)]] = True
    return seen_rows, [
        f"{count - most} of {count_text(count, 'pose')}, evenly over the campaign: all together would not fit into "
        "memory"
    ]


def _results(diagnosis: CauseDiagnosis, data: DiagnosisData[EffectsModel], settings: Campaign) -> InstrumentResults:
    """Errors of each pose."""
    return InstrumentResults({"prediction": prediction_table(diagnosis, data)})
