"""Shifts of attachments and targets: estimates with correlated errors, and models by actuators and drives."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from truing.arrays import Array, Mask
from truing.estimation.covariance import propagated
from truing.estimation.measured_numbers import pose_numbers
from truing.estimation.response import ResponseFit, consistent_responses, fit_models, fit_response, gain_p_value
from truing.estimation.rigid_poses.body_frames import residual_covariance
from truing.estimation.rigid_poses.joint_frames import (
    FramedPoints,
    by_shapes,
    joint_frame,
    relative_gain,
    residual_gain,
    sums_by_motion,
    survey_gain,
)
from truing.estimation.rigid_poses.points import FittedPoints, SurveyPoints

_PLATFORM = "platform"
_Z, _IN_PLANE = (2,), (0, 1)
_ROUNDING = 1e-8  # share of the largest variance of a combination, below which it is rounding


@dataclass(frozen=True)
class CorrelatedShifts:
    """Covariances of shifts in m^2, with errors that points have in common.

    noise (B, L, L): part that differs between poses, frame included; shared (L, L): part common to all poses, from the
    survey and the mean effect of cameras and bars; there (B,): poses with a joint fit of the bodies. whole (B, L, L):
    all contributions of points to the shifts of a pose; with_poses (B, L, Q): its covariance with the pose numbers of
    the bodies; effects (B, L, K), m: of one standard deviation of each parameter common to all poses; of_frames (Q + L,
    Q + L): contribution of the survey to these numbers and, through the frame alone, to the shifts.
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


def correlated_shifts(framed: FramedPoints, per_leg: Array, axes: Sequence[int] = _Z) -> CorrelatedShifts | None:
    """Return the covariances of the shifts that per_leg (B, L, T) averages along some axes of the platform; None if no
    platform was fitted.

    A shift is linear in the errors of all points of its pose: directly in its own, and through the frame in those of
    every point of the joint fit, which may be correlated within the pose.
    """
    errors, bodies, poses = framed.errors, framed.bodies, range(len(per_leg))
    platform = next((b for b, body in enumerate(bodies) if body.name == _PLATFORM), None)
    if platform is None:
        return None
    names = [body.name for body in bodies if body.name not in {child.parent for child in bodies}]
    per_leg, towards = np.repeat(per_leg, len(axes), axis=1), np.tile(axes, per_leg.shape[1])
    legs, first = per_leg.shape[1], np.cumsum([0, *(len(body.targets) for body in bodies)])
    covariance, there = np.zeros((len(poses), legs, legs)), np.zeros(len(poses), bool)
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
        along = per_leg[p][:, :, None] * turns[platform][:, towards].T[:, None]
        point_gain = residual_gain(p, bodies, frame, platform, along)
        rows = point_gain.rows(p, bodies)
        by_points = point_gain.gain @ errors.covariance(rows)
        covariance[p], effects[p] = by_points @ point_gain.gain.T, point_gain.gain @ errors.effects(rows)
        seen, by_frame = relative_gain(p, bodies, frame, frame.gain)
        at = [names.index(name) for name in seen]
        with_poses[p][:, at] = (by_points[:, : by_frame.shape[1]] @ by_frame.T).reshape(legs, -1, 6)
        moved = survey_gain(p, bodies, frame).reshape(len(frame.gain), -1)
        of_frames[p, at] = relative_gain(p, bodies, frame, moved)[1].reshape(len(at), 6, -1)
        of_shifts[p] = -sums_by_motion(p, bodies[platform], along) @ moved[6 * frame.bodies.index(platform) :][:6]
        turned = np.einsum("lni,nij->lnj", point_gain.gain.reshape(legs, -1, 3), turns[point_gain.body])
        by_survey[p][:, first[point_gain.body] + point_gain.target] = turned
        there[p] = True
    if not there.any():
        return None
    usual, cov = by_survey[there].mean(axis=0), np.concatenate([body.cov_source for body in bodies])
    of_survey = np.einsum("lni,nij,mnj->lm", usual, cov, usual)
    unshared, alike = pose_and_common_parts(covariance, effects, there, framed.correlation)
    varied = by_survey[there] - usual
    unshared[there] += np.einsum("blni,nij,bmnj->blm", varied, cov, varied, optimize=True)
    numbers = tuple(str(number) for name in names for number in pose_numbers(name))
    poses_by_leg = with_poses.reshape(len(poses), legs, -1)
    frames = _mean([of_frames.reshape(len(poses), len(numbers), -1), of_shifts], cov)
    return CorrelatedShifts(
        unshared, of_survey + alike, there, covariance, numbers, poses_by_leg, errors.parameters, effects, frames
    )


def correlated_residuals(framed: FramedPoints) -> Callable[[str, tuple[str, ...]], tuple[Array, Mask]]:
    """Return a function from body and targets to the residuals' covariance (B, 3T, 3T) in body axes and the poses (B,)
    with a joint fit.

    Only the part that differs between poses is included. It matters where poses weight targets differently, so that an
    error of the shape rotates their frames differently.
    """
    errors, bodies, correlation = framed.errors, framed.bodies, framed.correlation
    poses = range(len(bodies[0].t))
    frames = [joint_frame(p, bodies, errors) for p in poses]

    def found(body: str, targets: tuple[str, ...]) -> tuple[Array, Mask]:
        number = next((n for n, body_place in enumerate(bodies) if body_place.name == body), -1)
        known = {target: n for n, target in enumerate(bodies[number].targets)}
        at = np.array([known.get(target, -1) for target in targets])
        total_covariance, there = np.zeros((len(poses), 3 * len(at), 3 * len(at))), np.zeros(len(poses), bool)
        effects = np.zeros((len(poses), 3 * len(at), len(errors.parameters)))
        by_shape = np.zeros((len(poses), 3 * len(at), 3 * sum(len(body_place.targets) for body_place in bodies)))
        for p, frame in enumerate(frames):
            if frame is None or number not in frame.bodies:
                continue
            each = np.zeros((len(at), 3, len(bodies[number].targets), 3))
            is_observed = (at >= 0) & (bodies[number].row[p, at] >= 0)
            each[np.flatnonzero(is_observed), :, at[is_observed]] = bodies[number].R[p].T
            weight = each.reshape(3 * len(at), -1, 3)
            followed = residual_gain(p, bodies, frame, number, weight)
            rows = followed.rows(p, bodies)
            total_covariance[p] = followed.gain @ errors.covariance(rows) @ followed.gain.T
            effects[p] = followed.gain @ errors.effects(rows)
            by_shape[p] = by_shapes(p, bodies, frame, number, weight).reshape(len(weight), -1)
            there[p] = True
        if not there.any():
            return total_covariance, there
        unshared, _ = pose_and_common_parts(total_covariance, effects, there, correlation)
        varied = by_shape[there] - by_shape[there].mean(axis=0)
        unshared[there] += varied @ np.swapaxes(varied, 1, 2)
        return _without_rounding(unshared), there

    return found


def _without_rounding(covariance: Array) -> Array:
    """Return covariances (B, n, n) without directions that the frame's fit to the same points reduces to rounding."""
    values, vectors = np.linalg.eigh(covariance)
    significant = np.where(values > _ROUNDING * values[:, -1:], values, 0.0)
    return np.asarray((vectors * significant[:, None]) @ np.swapaxes(vectors, 1, 2))


def _mean(by_survey: Sequence[Array], cov: Array) -> Array:
    """Return the covariance of the pose mean of quantities with survey derivatives (B, Q, 3T), NaN for poses without.
    cov (T, 3, 3): covariance of the survey."""
    derivative = np.concatenate(by_survey, axis=1)
    there = np.isfinite(derivative)
    mean = np.where(there, derivative, 0.0).sum(axis=0) / np.maximum(there.sum(axis=0), 1)
    mean = mean.reshape(len(mean), -1, 3)
    return np.asarray(np.einsum("pni,nij,qnj->pq", mean, cov, mean, optimize=True))


def pose_and_common_parts(covariance: Array, effects: Array, there: Mask, correlation: Array) -> tuple[Array, Array]:
    """Split covariances (B, L, L) into a part that differs between poses and a part (L, L) common to all poses.

    effects (B, L, K): effects of errors common to all poses; their mean over poses is the common part.
    """
    alike = effects[there].mean(axis=0)
    changed_covariance = covariance.copy()
    changed_covariance[there] += propagated(effects[there] - alike, correlation) - propagated(
        effects[there], correlation
    )
    return changed_covariance, propagated(alike, correlation)


@dataclass(frozen=True)
class LegShifts:
    """Shift of each leg's attachment along z of the platform, with covariances.

    shift (B, L) in m, NaN if not seen; across (B, L, 2): along x and y; noise (B, L, L): of the measurement; own (B,
    L): variance from the attachment's own targets; survey (L, L): of the survey, cameras and bars, common to all poses;
    noise_across (B, 2L, 2L) and survey_across (2L, 2L): of x and y, leg by leg; attachments (L, 3). modulo_plane: the
    frame was fitted to the attachments themselves. together: poses with correlated point errors.
    """

    shift: Array
    across: Array
    noise: Array
    noise_across: Array
    survey_across: Array
    own: Array
    survey: Array
    attachments: Array
    modulo_plane: bool
    together: CorrelatedShifts | None


@dataclass(frozen=True)
class AttachmentModels:
    """Fits of the shifts by model: none, linear, matrix, where determined.

    in_plane: none and matrix of the shifts along x and y, leg by leg, if all legs are determined. determined (L,) by
    model: legs with determined coefficients; gains: p-value of each model against the next smaller one; held (V, L) by
    model: residuals at held-out poses; rejected (B, L): gross errors; kept (B, L): shifts in m without these, NaN
    elsewhere; fitted (B,): poses of the fits.
    """

    fits: Mapping[str, ResponseFit]
    determined: Mapping[str, Mask]
    gains: Mapping[str, float]
    held: Mapping[str, Array]
    rejected: Mask
    kept: Array
    fitted: Mask
    in_plane: Mapping[str, ResponseFit]


def attachment_models(drive: Array, shifts: LegShifts, heldout: Mask) -> AttachmentModels:
    """Return the models of the shifts by drives (B, L), m (telescope report, eq. 1-4), tested on poses heldout (B,)."""
    fitted = ~heldout
    prior = {"offset_cov": shifts.survey}
    good = np.isfinite(shifts.shift) & _consistent_attachments(drive, shifts, fitted)
    shifts_kept = np.where(good, shifts.shift, np.nan)
    fits = fit_models(drive[fitted], shifts_kept[fitted], shifts.noise[fitted], ("none", "linear", "matrix"), **prior)
    # An F test needs the same weights for all three models.
    gains = {
        "linear": gain_p_value(fits["none"], fits["linear"]),
        "matrix": gain_p_value(fits["linear"], fits["matrix"]),
    }
    fits["linear"] = _leg_by_leg(drive[fitted], shifts_kept[fitted], shifts.noise[fitted])
    known_well = _determined(drive[fitted], shifts_kept[fitted])
    fits = {name: fit for name, fit in fits.items() if known_well[name].any()}
    predicted_errors = {
        name: shifts_kept[heldout] - fit.offset.mean(0) - fit.predict(drive[heldout]) for name, fit in fits.items()
    }
    rejected = np.isfinite(shifts.shift) & ~good
    in_plane = _in_plane_models(drive[fitted], shifts, good, fitted) if known_well["matrix"].all() else {}
    return AttachmentModels(fits, known_well, gains, predicted_errors, rejected, shifts_kept, fitted, in_plane)


def _in_plane_models(drive: Array, shifts: LegShifts, good: Mask, fitted: Mask) -> dict[str, ResponseFit]:
    """Return the models of the shifts along x and y by drives (B, L), m, over the poses fitted."""
    across = np.where(good[..., None], shifts.across, np.nan)[fitted]
    y = across.reshape(len(across), -1)
    return fit_models(drive, y, shifts.noise_across[fitted], ("none", "matrix"), offset_cov=shifts.survey_across)


def _determined(drive: Array, shift: Array) -> dict[str, Mask]:
    """Return the legs (L,) whose coefficients the shifts (B, L) at drives (B, L) determine, by model. Others would get
    the shortest of many solutions, with a meaningless standard deviation."""
    seen = [drive[rows] for rows in np.isfinite(shift).T]
    moved = [len(u) > 1 and bool(np.ptp(u[:, leg]) > 0.0) for leg, u in enumerate(seen)]
    spanned = [len(u) >= u.shape[1] and np.linalg.matrix_rank(u) == u.shape[1] for u in seen]
    return {"none": np.ones(len(seen), bool), "linear": np.array(moved), "matrix": np.array(spanned)}


def _leg_by_leg(drive: Array, shift: Array, noise: Array) -> ResponseFit:
    """Return the linear model of eq. 1: each leg regressed separately with its own offset. If other actuators move an
    attachment too, this model is wrong; weights that couple legs, or an offset tied to the survey, would then change
    the coefficient's meaning."""
    alone = noise * np.eye(noise.shape[1])
    return fit_response(drive, shift, alone, form="linear")


def attachment_shifts(
    survey: SurveyPoints, platform: FittedPoints, framed: FramedPoints | None, n_legs: int
) -> LegShifts:
    """Return the shifts of the attachments from residuals of the platform's targets, in the axes of its survey.

    framed: common errors of points, None if they are independent.
    """
    residual, used, noise = platform.residual, platform.used, platform.noise
    is_observed = np.isfinite(residual[:, :, 2])
    per_leg = _leg_average(survey, is_observed, noise, n_legs)
    measured, surveyed = residual_covariance(survey.points, noise, used, is_observed), _survey_covariance(survey, used)
    shift = np.einsum("blt,bta->bla", per_leg, np.nan_to_num(residual))
    shift[~per_leg.any(axis=2)] = np.nan
    typical = _typical_average(survey, n_legs)
    together = {axes: None if framed is None else correlated_shifts(framed, per_leg, axes) for axes in (_Z, _IN_PLANE)}
    of_points, shared = _averaged(per_leg, measured, typical, surveyed, _Z, together[_Z])
    of_plane, shared_plane = _averaged(per_leg, measured, typical, surveyed, _IN_PLANE, together[_IN_PLANE])
    return LegShifts(
        shift[:, :, 2],
        shift[:, :, :2],
        of_points,
        of_plane,
        shared_plane,
        np.einsum("blt,bt->bl", per_leg**2, noise[:, :, 2, 2]),
        shared,
        typical @ survey.points,
        bool((used & (survey.leg > 0)).any()),
        together[_Z],
    )


def _averaged(
    per_leg: Array,
    measured: Array,
    typical: Array,
    surveyed: Array,
    axes: Sequence[int],
    together: CorrelatedShifts | None,
) -> tuple[Array, Array]:
    """Return covariances of the attachments' shifts along some axes: of the measurement (B, n, n) and of the survey (n,
    n)."""
    of_points = _covariance_of_legs(per_leg, measured, axes)
    if together is None:
        return of_points, _covariance_of_legs(typical[None], surveyed[None], axes)[0]
    # A pose without a joint fit keeps the covariance of independent points.
    return np.where(together.there[:, None, None], together.noise, of_points), together.shared


def _covariance_of_legs(per_leg: Array, covariance: Array, axes: Sequence[int]) -> Array:
    """Return covariances (B, n, n) of averages (B, L, T) of targets along some axes, from those (B, 3T, 3T) of
    targets."""
    count, (batch, legs, targets) = len(axes), per_leg.shape
    covariance_of_targets = covariance.reshape(-1, targets, 3, targets, 3)[:, :, axes][..., axes]
    covariance_of_legs = np.einsum("blt,btasc,bms->blamc", per_leg, covariance_of_targets, per_leg, optimize=True)
    return np.asarray(covariance_of_legs.reshape(batch, legs * count, legs * count))


def _consistent_attachments(drive: Array, shifts: LegShifts, fitted: Mask) -> Mask:
    """Return the attachments (B, L) whose shifts along z and across it agree with a matrix model of each direction. The
    noise along z is used across, too: a gross error is many times either."""
    directions = (shifts.shift, shifts.across[:, :, 0], shifts.across[:, :, 1])
    consistent = [
        consistent_responses(drive, y, shifts.noise, offset_cov=shifts.survey, fitted=fitted) for y in directions
    ]
    return np.logical_and.reduce(consistent)


def _survey_covariance(survey: SurveyPoints, used: Mask) -> Array:
    """Return the covariance (3T, 3T) that the survey's noise causes equally in the residuals of every pose."""
    usual = used.mean(axis=0) > 0.5
    everywhere = np.ones((1, len(survey.targets)), bool)
    return residual_covariance(survey.points, survey.cov[None], usual[None], everywhere)[0]


def _leg_average(survey: SurveyPoints, is_observed: Mask, noise: Array, n_legs: int) -> Array:
    """Return weights (B, L, T) that average the targets of each attachment by their noise along z; zero rows if none
    was seen."""
    member = survey.leg[None, :] == np.arange(1, n_legs + 1)[:, None]
    variance = np.where(noise[:, :, 2, 2] > 0.0, noise[:, :, 2, 2], np.inf)
    weight = member[None] * np.where(is_observed, 1.0 / variance, 0.0)[:, None, :]
    total = weight.sum(axis=2, keepdims=True)
    return np.divide(weight, total, out=np.zeros_like(weight), where=total > 0.0)


def _typical_average(survey: SurveyPoints, n_legs: int) -> Array:
    member = (survey.leg[None, :] == np.arange(1, n_legs + 1)[:, None]).astype(float)
    return member / np.maximum(member.sum(axis=1, keepdims=True), 1.0)


@dataclass(frozen=True)
class BodyShifts:
    """One body: poses, targets, residuals (B, T, 3) in m in its own frame, NaN if not seen, and their covariance."""

    body: str
    poses: tuple[int | str, ...]
    targets: tuple[str, ...]
    shift: Array
    noise: Array

    @property
    def flat(self) -> Array:
        """Shifts (B, 3T), target by target, x y z."""
        return self.shift.reshape(len(self.shift), -1)


def body_shifts(body: str, fitted_points: FittedPoints) -> BodyShifts:
    """Return the shifts of a body's targets with the covariance of independent points and of the frame."""
    points, shift = fitted_points.points, fitted_points.residual
    is_observed = np.isfinite(shift[:, :, 2])
    mean_shape = _mean_shape(points.points, points.is_observed & is_observed, fitted_points.rotation, shift)
    covariance = residual_covariance(mean_shape, fitted_points.noise, fitted_points.used & is_observed, is_observed)
    return BodyShifts(body, points.poses, points.targets, shift, covariance)


def with_common_errors(shifts: BodyShifts, every: tuple[int | str, ...], noise: Array, there: Mask) -> BodyShifts:
    """Return the shifts with the covariance of correlated points, in poses with a joint fit of the bodies."""
    rows = np.array([every.index(pose) for pose in shifts.poses])
    return replace(shifts, noise=np.where(there[rows, None, None], noise[rows], shifts.noise))


def _mean_shape(points: Array, is_observed: Mask, rotation: Array, shift: Array) -> Array:
    """Return targets (T, 3) in the body's axes up to a common shift, enough for the effect of a frame's error on
    them."""
    weight = is_observed.astype(float)
    local = np.einsum("bji,btj->bti", rotation, points) - np.nan_to_num(shift)
    centre = (local * weight[..., None]).sum(axis=1) / np.maximum(weight.sum(axis=1), 1.0)[:, None]
    centred = (local - centre[:, None]) * weight[..., None]
    mask = weight.min(axis=1) > 0.0
    chosen = mask if mask.any() else np.ones(len(mask), bool)
    return centred[chosen].sum(axis=0) / np.maximum(weight[chosen].sum(axis=0), 1.0)[:, None]


def target_models(shifts: BodyShifts, u: Array, fitted: Mask) -> dict[str, ResponseFit]:
    """Return the models of a body's shifts by drives u (B, D), none and matrix, over the poses fitted (B,)."""
    y, cov = shifts.flat[fitted], shifts.noise[fitted]
    responses = consistent_responses(u[fitted], y, cov)
    return fit_models(u[fitted], np.where(responses, y, np.nan), cov, ("none", "matrix"))
