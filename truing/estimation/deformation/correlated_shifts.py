"""Shifts whose points have errors in common: what every point of a pose does to each of them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truing.estimation.measured_numbers import pose_numbers
from truing.estimation.rigid_poses.joint_frames import (
    FramedPoints,
    by_shapes,
    follows_frame,
    joint_frame,
    relative_gain,
    residual_gain,
    survey_gain,
)

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
_PLATFORM = "platform"
_NOTHING = 1e-8  # share of the largest variance of a combination


@dataclass(frozen=True)
class CorrelatedShifts:
    """Covariances of shifts in m^2: noise (B, L, L) of what differs from pose to pose, frame included; shared (L, L) of
    what all poses share, the survey and the mean effect of cameras and bars; there (B,), where bodies had a joint fit.

    whole (B, L, L): all that points bring to the shifts of a pose; with_poses (B, L, Q) its covariance with the numbers
    of the poses of bodies; effects (B, L, K), m, of one standard deviation of each parameter common to all poses;
    of_frames (Q + L, Q + L): what the survey brings to these numbers and, through the frame alone, to the shifts.
    """

    noise: Array
    shared: Array
    there: Mask
    whole: Array
    numbers: tuple[str, ...]
    with_poses: Array
    parameters: tuple[str, ...]
    effects: Array
    of_frames: Array


def correlated_shifts(framed: FramedPoints, per_leg: Array) -> CorrelatedShifts | None:
    """Return the covariances of the shifts along z that per_leg (B, L, T) averages; None where no platform was fitted.

    A shift is linear in the errors of all points of its pose: its own, and through the frame those of every point that
    the joint fit of the bodies weighed, each with all others of the pose.
    """
    errors, bodies, poses = framed.errors, framed.bodies, range(len(per_leg))
    platform = next((b for b, body in enumerate(bodies) if body.name == _PLATFORM), None)
    if platform is None:
        return None
    names = [body.name for body in bodies if body.name not in {other.parent for other in bodies}]
    legs, first = per_leg.shape[1], np.cumsum([0, *(len(body.targets) for body in bodies)])
    whole, there = np.zeros((len(poses), legs, legs)), np.zeros(len(poses), bool)
    with_poses = np.full((len(poses), legs, len(names), 6), np.nan)
    by_survey = np.zeros((len(poses), legs, first[-1], 3))
    of_frames = np.full((len(poses), len(names), 6, 3 * first[-1]), np.nan)
    of_shifts = np.full((len(poses), legs, 3 * first[-1]), np.nan)
    effects = np.zeros((len(poses), legs, len(errors.parameters)))
    for p in poses:
        frame = joint_frame(p, bodies, errors)
        if frame is None or platform not in frame.bodies:
            continue
        turns = np.array([body.R[p] for body in bodies])
        along = per_leg[p][:, :, None] * turns[platform][:, 2]
        found = residual_gain(p, bodies, frame, platform, along)
        rows = found.rows(p, bodies)
        by_points = found.gain @ errors.covariance(rows)
        whole[p], effects[p] = by_points @ found.gain.T, found.gain @ errors.effects(rows)
        seen, by_frame = relative_gain(p, bodies, frame, frame.gain)
        at = [names.index(name) for name in seen]
        with_poses[p][:, at] = (by_points[:, : by_frame.shape[1]] @ by_frame.T).reshape(legs, -1, 6)
        moved = survey_gain(p, bodies, frame).reshape(len(frame.gain), -1)
        of_frames[p, at] = relative_gain(p, bodies, frame, moved)[1].reshape(len(at), 6, -1)
        of_shifts[p] = -follows_frame(p, bodies[platform], along) @ moved[6 * frame.bodies.index(platform) :][:6]
        turned = np.einsum("lni,nij->lnj", found.gain.reshape(legs, -1, 3), turns[found.body])
        by_survey[p][:, first[found.body] + found.target] = turned
        there[p] = True
    if not there.any():
        return None
    usual, cov = by_survey[there].mean(axis=0), np.concatenate([body.cov_source for body in bodies])
    of_survey = np.einsum("lni,nij,mnj->lm", usual, cov, usual)
    own, alike = apart(whole, effects, there, framed.correlation)
    varied = by_survey[there] - usual
    own[there] += np.einsum("blni,nij,bmnj->blm", varied, cov, varied, optimize=True)
    numbers = tuple(str(number) for name in names for number in pose_numbers(name))
    told = with_poses.reshape(len(poses), legs, -1)
    frames = _mean([of_frames.reshape(len(poses), len(numbers), -1), of_shifts], cov)
    return CorrelatedShifts(own, of_survey + alike, there, whole, numbers, told, errors.parameters, effects, frames)


def correlated_residuals(framed: FramedPoints) -> Callable[[str, tuple[str, ...]], tuple[Array, Mask]]:
    """Return what tells the covariance (B, 3T, 3T) of the residuals of a body's targets, in its own axes, as far as it
    differs from pose to pose, and where (B,) bodies had a joint fit.

    What a frame leaves of its own targets is little, and there it counts that an error of the shape turns the frames of
    poses that weigh targets differently by different amounts.
    """
    errors, bodies, correlation = framed.errors, framed.bodies, framed.correlation
    poses = range(len(bodies[0].t))
    frames = [joint_frame(p, bodies, errors) for p in poses]

    def found(body: str, targets: tuple[str, ...]) -> tuple[Array, Mask]:
        number = next((n for n, one in enumerate(bodies) if one.name == body), -1)
        known = {target: n for n, target in enumerate(bodies[number].targets)}
        at = np.array([known.get(target, -1) for target in targets])
        whole, there = np.zeros((len(poses), 3 * len(at), 3 * len(at))), np.zeros(len(poses), bool)
        effects = np.zeros((len(poses), 3 * len(at), len(errors.parameters)))
        by_shape = np.zeros((len(poses), 3 * len(at), 3 * sum(len(one.targets) for one in bodies)))
        for p, frame in enumerate(frames):
            if frame is None or number not in frame.bodies:
                continue
            each = np.zeros((len(at), 3, len(bodies[number].targets), 3))
            seen = (at >= 0) & (bodies[number].row[p, at] >= 0)
            each[np.flatnonzero(seen), :, at[seen]] = bodies[number].R[p].T
            weight = each.reshape(3 * len(at), -1, 3)
            followed = residual_gain(p, bodies, frame, number, weight)
            rows = followed.rows(p, bodies)
            whole[p] = followed.gain @ errors.covariance(rows) @ followed.gain.T
            effects[p] = followed.gain @ errors.effects(rows)
            by_shape[p] = by_shapes(p, bodies, frame, number, weight).reshape(len(weight), -1)
            there[p] = True
        if not there.any():
            return whole, there
        own, _ = apart(whole, effects, there, correlation)
        varied = by_shape[there] - by_shape[there].mean(axis=0)
        own[there] += varied @ np.swapaxes(varied, 1, 2)
        return _without_rounding(own), there

    return found


def _without_rounding(covariance: Array) -> Array:
    """Covariances (B, n, n) without what the fit of the frame to the same points leaves nothing of but rounding."""
    values, vectors = np.linalg.eigh(covariance)
    kept = np.where(values > _NOTHING * values[:, -1:], values, 0.0)
    return np.asarray((vectors * kept[:, None]) @ np.swapaxes(vectors, 1, 2))


def _mean(by_survey: Sequence[Array], cov: Array) -> Array:
    """The covariance of what follows the survey's errors by (B, Q, 3T), NaN where a pose has none, in the mean of the
    poses; cov (T, 3, 3)."""
    found = np.concatenate(by_survey, axis=1)
    there = np.isfinite(found)
    mean = np.where(there, found, 0.0).sum(axis=0) / np.maximum(there.sum(axis=0), 1)
    mean = mean.reshape(len(mean), -1, 3)
    return np.asarray(np.einsum("pni,nij,qnj->pq", mean, cov, mean, optimize=True))


def apart(whole: Array, effects: Array, there: Mask, correlation: Array) -> tuple[Array, Array]:
    """What of the covariances (B, L, L) differs from pose to pose, and (L, L) what all poses share, of errors that are
    common to all poses and do effects (B, L, K): the part of these that is the same everywhere."""
    alike = effects[there].mean(axis=0)
    own = whole.copy()
    own[there] += _sandwich(effects[there] - alike, correlation) - _sandwich(effects[there], correlation)
    return own, _sandwich(alike, correlation)


def _sandwich(J: Array, C: Array) -> Array:
    return J @ C @ np.swapaxes(J, -1, -2)
