"""Shifts of attachments whose points have errors in common: what every point of a pose does to each of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from stages.point_arrays import (
    SurveyPoints,
    default_motions,
    observation_rows,
    pose_points,
    survey_points,
    used_targets,
)
from stages.rigid_poses.point_errors import PointErrors, common_correlation, point_errors
from truing.estimation.covariance import apply_rotation
from truing.estimation.rigid_poses.correlated import PointsOfBodies, joint_motions
from truing.estimation.rotation import skew

if TYPE_CHECKING:
    import pyarrow as pa

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]

_PLATFORM = "platform"
_FEWEST = 3


@dataclass(frozen=True)
class CorrelatedShifts:
    """Covariances of shifts in m^2: noise (B, L, L) of what differs from pose to pose, frame included; shared (L, L) of
    what all poses share, the survey and the mean effect of cameras and bars; there (B,), where bodies had a joint fit.
    """

    noise: Array
    shared: Array
    there: Mask


@dataclass(frozen=True)
class _Body:
    """One surveyed body over all poses: motion R (B, 3, 3), t (B, 3), points (B, T, 3) as measured, used (B, T) for its
    frame, row (B, T) of the observations, -1 where not seen."""

    name: str
    survey: SurveyPoints
    R: Array
    t: Array
    points: Array
    used: Mask
    row: Index


def correlated_shifts(
    tables: Mapping[str, pa.Table], poses: tuple[int | str, ...], per_leg: Array
) -> CorrelatedShifts | None:
    """The covariances of the shifts along z that per_leg (B, L, T) averages; None where points are independent.

    A shift is linear in the errors of all points of its pose: its own, and through the frame those of every point that
    the joint fit of the bodies weighed, each with all others of the pose.
    """
    network = (tables.get(name) for name in ("point_correlations", "point_sensitivities", "object_points"))
    errors = point_errors(tables["observations"], *network)
    if errors is None:
        return None
    names = tuple(dict.fromkeys(tables["survey"].column("body").to_pylist()))
    bodies = [_body(tables, name, poses) for name in names]
    legs, first = per_leg.shape[1], np.cumsum([0, *(len(body.survey.targets) for body in bodies)])
    noise, there = np.zeros((len(poses), legs, legs)), np.zeros(len(poses), bool)
    by_survey = np.zeros((len(poses), legs, first[-1], 3))
    by_common = np.zeros((len(poses), legs, len(errors.parameters)))
    for p in range(len(poses)):
        found = _gain(p, bodies, errors, per_leg[p])
        if found is None:
            continue
        body, target, gain = found
        rows = np.array([bodies[b].row[p, t] for b, t in zip(body, target, strict=True)])
        noise[p] = gain @ errors.covariance(rows) @ gain.T
        by_common[p] = gain @ errors.effects(rows)
        turn = np.array([own.R[p] for own in bodies])[body]
        by_survey[p][:, first[body] + target] = np.einsum("lni,nij->lnj", gain.reshape(legs, -1, 3), turn)
        there[p] = True
    if not there.any():
        return None
    cov = np.concatenate([own.survey.cov for own in bodies])
    usual = by_survey[there].mean(axis=0)
    of_survey = np.einsum("lni,nij,mnj->lm", usual, cov, usual)
    correlation = common_correlation(tables.get("camera_correlations"), errors.parameters)
    alike = by_common[there].mean(axis=0)
    varied = by_common[there] - alike
    noise[there] += _sandwich(varied, correlation) - _sandwich(by_common[there], correlation)
    return CorrelatedShifts(noise, of_survey + _sandwich(alike, correlation), there)


def _sandwich(J: Array, C: Array) -> Array:
    return J @ C @ np.swapaxes(J, -1, -2)


def _body(tables: Mapping[str, pa.Table], name: str, poses: tuple[int | str, ...]) -> _Body:
    survey = survey_points(tables["survey"], name)
    observed = pose_points(tables["observations"], name, poses, survey.targets)
    R, t = default_motions(tables["poses"], name, poses)
    used = used_targets(tables["residuals"], name, poses, survey.targets) & observed.seen
    row = observation_rows(tables["observations"], name, poses, survey.targets)
    return _Body(name, survey, R, t, observed.points, used, row)


def _gain(p: int, bodies: list[_Body], errors: PointErrors, per_leg: Array) -> tuple[Index, Index, Array] | None:
    """Body and target (N,) by number of the points that move the shifts of a pose, and by how much (L, 3N); None where
    the platform had no joint fit."""
    fitted = [b for b, own in enumerate(bodies) if np.isfinite(own.t[p]).all() and own.used[p].sum() >= _FEWEST]
    base = next((b for b in fitted if bodies[b].name == _PLATFORM), None)
    if base is None:
        return None
    platform = bodies[base]
    judged = np.flatnonzero(per_leg.any(axis=0) & ~platform.used[p])
    targets = [np.flatnonzero(bodies[b].used[p]) for b in fitted]
    place = np.repeat(np.arange(len(fitted)), [len(own) for own in targets])
    body, target = np.array(fitted)[place], np.concatenate(targets)
    points = PointsOfBodies(
        np.concatenate([bodies[b].survey.points[own] for b, own in zip(fitted, targets, strict=True)]),
        np.concatenate([bodies[b].points[p, own] for b, own in zip(fitted, targets, strict=True)]),
        place,
        np.concatenate([bodies[b].survey.cov[own] for b, own in zip(fitted, targets, strict=True)]),
        errors.covariance(np.concatenate([bodies[b].row[p, own] for b, own in zip(fitted, targets, strict=True)])),
    )
    R, t = (np.array([getattr(bodies[b], name)[p] for b in fitted]) for name in "Rt")
    motions = joint_motions(points, R, t)
    if not motions.converged:
        return None
    body = np.concatenate([body, np.full(len(judged), base)])
    target = np.concatenate([target, judged])
    along = per_leg[:, :, None] * platform.R[p][:, 2]  # z of the platform in the axes of the measurement
    arm = apply_rotation(platform.R[p], platform.survey.points)
    own = 6 * fitted.index(base)
    lever = np.concatenate([np.broadcast_to(np.eye(3), (len(arm), 3, 3)), -skew(arm)], axis=2)
    frame = np.einsum("lti,tij->lj", along, lever) @ motions.gain[own : own + 6]
    gain = np.zeros((len(per_leg), len(body), 3))
    gain[:, : len(place)] = -frame.reshape(len(per_leg), -1, 3)
    mine = np.flatnonzero(body == base)
    gain[:, mine] += along[:, target[mine]]
    return body, target, gain.reshape(len(per_leg), -1)
