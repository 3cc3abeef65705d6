"""Frames of bodies with correlated point errors: derivatives of residuals and poses by these errors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from truing.arrays import Array, Index, Mask
from truing.estimation.covariance import apply_rotation, relative_slope
from truing.estimation.rigid_poses.correlated_poses import PointsOfBodies, by_survey, joint_motions
from truing.estimation.rigid_poses.points import PointErrors, PosePoints
from truing.estimation.rotation import rigid_motions

_FEWEST = 3


@dataclass(frozen=True)
class FramedBody:
    """One body over all poses, with its parent.

    targets (T names); source (T, 3) with cov_source (T, 3, 3): reference of its poses; frame (T,): targets that define
    the frame; cov_shape (T, 3, 3): uncertainty of that reference, if the poses of a body without a survey define it;
    motion R (B, 3, 3), t (B, 3); points (B, T, 3) as measured; used (B, T): for its frame; row (B, T): of the
    observations, -1 if not seen. In m, NaN without a pose.
    """

    name: str
    parent: str
    targets: tuple[str, ...]
    source: Array
    cov_source: Array
    cov_shape: Array
    frame: Mask
    R: Array
    t: Array
    points: Array
    used: Mask
    row: Index


@dataclass(frozen=True)
class FramedPoints:
    """Bodies over all poses, the errors common to their points, and the correlations (K, K) of parameters common to all
    poses."""

    bodies: Sequence[FramedBody]
    errors: PointErrors
    correlation: Array


@dataclass(frozen=True)
class JointFrame:
    """Bodies of a pose in its joint fit, by number, and the points (N,) of the fit, by body and target: gain (6b, 3N)
    of their errors on the motions (t, theta), body by body."""

    bodies: tuple[int, ...]
    body: Index
    target: Index
    gain: Array


@dataclass(frozen=True)
class PointGain:
    """Derivative (Q, 3n) of numbers (Q) of a pose by the errors of points (n,), by body and target."""

    body: Index
    target: Index
    gain: Array

    def rows(self, p: int, bodies: Sequence[FramedBody]) -> Index:
        """Return the rows (n,) of the observations of a pose."""
        return np.array([bodies[b].row[p, t] for b, t in zip(self.body, self.target, strict=True)], np.int64)


def joint_frame(p: int, bodies: Sequence[FramedBody], errors: PointErrors) -> JointFrame | None:
    """Return the joint fit of the bodies of a pose again; None if there was none."""
    fitted = [b for b, body in enumerate(bodies) if np.isfinite(body.t[p]).all() and body.used[p].sum() >= _FEWEST]
    if not fitted:
        return None
    body_targets = [(bodies[b], np.flatnonzero(bodies[b].used[p])) for b in fitted]
    body_index = np.repeat(np.arange(len(fitted)), [len(targets) for _, targets in body_targets])
    points = PointsOfBodies(
        np.concatenate([body.source[targets] for body, targets in body_targets]),
        np.concatenate([body.points[p, targets] for body, targets in body_targets]),
        body_index,
        np.concatenate([body.cov_source[targets] for body, targets in body_targets]),
        errors.covariance(np.concatenate([body.row[p, targets] for body, targets in body_targets])),
    )
    R, t = (np.array([getattr(body, name)[p] for body, _ in body_targets]) for name in "Rt")
    motions = joint_motions(points, R, t)
    if not motions.converged:
        return None
    return JointFrame(
        tuple(fitted),
        np.array(fitted)[body_index],
        np.concatenate([targets for _, targets in body_targets]),
        motions.gain,
    )


def residual_gain(p: int, bodies: Sequence[FramedBody], frame: JointFrame, body: int, weight: Array) -> PointGain:
    """Return the derivative of sums of a body's residuals, with weight (Q, T, 3) in measurement axes, by the errors of
    points.

    A residual depends on the error of its own point, and on those of all points that define its frame.
    """
    body_gain = bodies[body]
    assessed = np.flatnonzero(weight.any(axis=(0, 2)) & ~body_gain.used[p])
    by_frame = sums_by_motion(p, body_gain, weight) @ _rows(frame.gain, frame, body)
    frame_points = len(frame.body)
    gain = np.zeros((len(weight), frame_points + len(assessed), 3))
    gain[:, :frame_points] = -by_frame.reshape(len(weight), -1, 3)
    at_body = np.concatenate([frame.body, np.full(len(assessed), body)])
    target = np.concatenate([frame.target, assessed])
    own_points = np.flatnonzero(at_body == body)
    gain[:, own_points] += weight[:, target[own_points]]
    return PointGain(at_body, target, gain.reshape(len(weight), -1))


def sums_by_motion(p: int, body: FramedBody, weight: Array) -> Array:
    """Return the derivative (Q, 6) of weighted sums over a body's targets, weight (Q, T, 3), by its motion (t,
    theta)."""
    return np.einsum("qti,tij->qj", weight, rigid_motions(apply_rotation(body.R[p], body.source)))


def by_shapes(p: int, bodies: Sequence[FramedBody], frame: JointFrame, body: int, weight: Array) -> Array:
    """Return the effect (Q, T, 3) on such sums, through the frame, of one standard deviation of each coordinate of all
    bodies' shapes."""
    offset = np.cumsum([0, *(len(body_poses.targets) for body_poses in bodies)])
    by_frame = (sums_by_motion(p, bodies[body], weight) @ _rows(frame.gain, frame, body)).reshape(len(weight), -1, 3)
    rotated = by_frame[:, :, None] @ np.array([body_poses.R[p] for body_poses in bodies])[frame.body]
    by_shape = np.zeros((len(weight), offset[-1], 3))
    by_shape[:, offset[frame.body] + frame.target] = rotated[:, :, 0]
    return np.asarray(
        (by_shape[:, :, None] @ np.concatenate([_shape_roots(body_poses) for body_poses in bodies]))[:, :, 0]
    )


def _shape_roots(body: FramedBody) -> Array:
    """Return roots (T, 3, 3) of the covariances of a body's shape."""
    values, vectors = np.linalg.eigh(body.cov_shape)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0))[:, None])


def survey_gain(p: int, bodies: Sequence[FramedBody], frame: JointFrame) -> Array:
    """Return the derivative (6b, T, 3) of the motions (t, theta) of a pose's bodies by the survey errors of all their
    targets."""
    offset = np.cumsum([0, *(len(body.targets) for body in bodies)])
    gain = np.zeros((len(frame.gain), offset[-1], 3))
    gain[:, offset[frame.body] + frame.target] = frame.gain.reshape(len(gain), -1, 3)
    by_survey_errors = np.zeros_like(gain)
    rows_of_bodies = [(k, offset[b] + np.arange(len(bodies[b].targets))) for k, b in enumerate(frame.bodies)]
    rows = np.concatenate([targets for _, targets in rows_of_bodies])
    body = np.concatenate([np.full(len(targets), k) for k, targets in rows_of_bodies])
    source, in_frame = (
        np.concatenate([getattr(bodies[b], name) for b in frame.bodies]) for name in ("source", "frame")
    )
    R = np.array([bodies[b].R[p] for b in frame.bodies])
    by_survey_errors[:, rows] = by_survey(source, body, in_frame, gain[:, rows].reshape(len(gain), -1), R)
    return by_survey_errors


def relative_gain(
    p: int, bodies: Sequence[FramedBody], frame: JointFrame, gain: Array
) -> tuple[tuple[str, ...], Array]:
    """Return the bodies of a pose that have a parent; and the derivative (6c, n) of their poses relative to it, from
    the gain (6b, n) of the motions."""
    number_of_body = {bodies[b].name: b for b in frame.bodies}
    parents = {bodies[b].parent for b in frame.bodies}
    names, rows = [], []
    for name, b in number_of_body.items():
        parent = number_of_body.get(bodies[b].parent)
        if name in parents or (parent is None and bodies[b].parent in [body.name for body in bodies]):
            continue
        gain_of_body = _rows(gain, frame, b)
        if parent is not None:
            slope = relative_slope(bodies[parent].R[p], bodies[parent].t[p], bodies[b].t[p])
            gain_of_body = slope @ np.concatenate([_rows(gain, frame, parent), gain_of_body])
        names.append(name)
        rows.append(gain_of_body)
    return tuple(names), np.concatenate(rows) if rows else np.zeros((0, gain.shape[1]))


def _rows(gain: Array, frame: JointFrame, body: int) -> Array:
    first = 6 * frame.bodies.index(body)
    return gain[first : first + 6]


def mean_shape(R: Array, t: Array, used: Mask, points: PosePoints, residual: Array) -> tuple[Array, Array]:
    """Return the positions (T, 3) of targets in their body, zero if never used: as measured, minus the residual (B, T,
    3).

    Also returns the covariances (T, 3, 3) of the means over the poses that used them (B, T).
    """
    local = np.einsum("bji,btj->bti", R, points.points - t[:, None]) - residual
    reported = used & np.isfinite(local).all(axis=-1)
    count = np.maximum(reported.sum(axis=0), 1)
    mean = np.where(reported[..., None], np.nan_to_num(local), 0.0).sum(axis=0) / count[:, None]
    rotated_cov = np.einsum("bji,btjk,bkl->btil", np.nan_to_num(R), points.cov, np.nan_to_num(R))
    return mean, np.where(reported[..., None, None], rotated_cov, 0.0).sum(axis=0) / count[:, None, None] ** 2
