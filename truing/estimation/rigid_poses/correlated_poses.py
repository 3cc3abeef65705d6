"""Joint fit of several bodies to points with correlated errors, within a body and between bodies.

Generalised least squares with ``S = cov_target + R cov_source R'`` of all points together. If the points have a frame
of their own (a free network), cov_target is singular along common motions of all points. It depends on the choice of
that frame by terms ``J A + A' J'`` with J the motions of the bodies. Neither affects relative motions: ``J K J'``
added
to S changes no estimate (Rao and Mitra, Generalized Inverse of Matrices, 1971).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import LinAlgError, cho_factor, cho_solve
from scipy.special import chdtri

from truing.arrays import Array, Index, Mask
from truing.estimation.covariance import apply_rotation, fit_gain, survey_frame_covariance, symmetric
from truing.estimation.rigid_poses.body_poses import BodyPoses
from truing.estimation.rigid_poses.points import PointErrors
from truing.estimation.rigid_poses.rigid import FitStatus
from truing.estimation.rigid_poses.robust_pose import FALSE_ALARM
from truing.estimation.rotation import exp_so3, skew

_MOST_STEPS = 30
# Squared length of the last step in units of its own covariance.
_SETTLED = 1e-12
# Least share of a point's weight that other points must control for a test.
_CONTROLLED = 1e-6
# Share of the mean variance below which there is no information.
_EXACT = 1e-10
_MEDIAN_TEST = float(chdtri(3, 0.5))
_WORTH_A_RATIO = 1.2
_FEWEST = 3


@dataclass(frozen=True)
class PointsOfBodies:
    """All used points of a pose: source and target (N, 3) in m, body (N,) by number, cov_source (N, 3, 3) in the
    bodies' frames, joint cov_target (3N, 3N), in m^2."""

    source: NDArray
    target: NDArray
    body: NDArray
    cov_source: NDArray
    cov_target: NDArray

    def without(self, row: int) -> PointsOfBodies:
        """Return a copy without one of the points."""
        is_kept = np.arange(len(self.source)) != row
        coordinates = np.repeat(is_kept, 3)
        cov_target = self.cov_target[np.ix_(coordinates, coordinates)]
        return PointsOfBodies(
            self.source[is_kept], self.target[is_kept], self.body[is_kept], self.cov_source[is_kept], cov_target
        )


@dataclass(frozen=True)
class JointMotions:
    """Motions R (B, 3, 3) and t (B, 3) of B bodies.

    gain (6B, 3N): derivative of (t, theta) of each body by the error of each point, R <- exp(theta) R; tests (N,): test
    of a gross error in each point, chi-square with 3 degrees of freedom, NaN if the others do not control it;
    converged.
    """

    R: NDArray
    t: NDArray
    gain: NDArray
    tests: NDArray
    converged: bool

    def covariance(self, cov_target: NDArray) -> NDArray:
        """Return the joint covariance (6B, 6B) of the motions for point errors with covariance (3N, 3N).

        Zero if the motions are relative to the points' own frame; rounding then causes no negative variance.
        """
        covariance = symmetric(self.gain @ cov_target @ self.gain.T)
        values, vectors = np.linalg.eigh(covariance)
        return covariance if values[0] >= 0.0 else symmetric((vectors * np.maximum(values, 0.0)) @ vectors.T)


def joint_motions(points: PointsOfBodies, R: NDArray, t: NDArray) -> JointMotions:
    """Return the motions of the bodies of a pose from starts R (B, 3, 3), t (B, 3); three points or more of each.

    Returns the starts, not converged, if the points leave more than motions free: a common scale.
    """
    R, t = R.copy(), t.copy()
    body_of_point = points.body
    converged = False
    start = JointMotions(
        R.copy(), t.copy(), np.zeros((6 * len(R), points.target.size)), np.full(len(body_of_point), np.nan), False
    )
    for _ in range(_MOST_STEPS):
        rotated_cov = R[body_of_point] @ points.cov_source @ np.swapaxes(R[body_of_point], -1, -2)
        arm = apply_rotation(R[body_of_point], points.source)
        r = points.target - arm - t[body_of_point]
        J = _slopes(arm, body_of_point, len(R))
        try:
            factor = _factor(points.cov_target, rotated_cov, J)
        except LinAlgError:
            return start
        weighted_residual = cho_solve(factor, r.ravel()).reshape(-1, 3)
        J = _slopes(arm + apply_rotation(rotated_cov, weighted_residual), body_of_point, len(R))
        weighted = cho_solve(factor, J)
        normal = symmetric(J.T @ weighted)
        step = np.linalg.solve(normal, J.T @ weighted_residual.ravel())
        t += step.reshape(-1, 6)[:, :3]
        R = exp_so3(step.reshape(-1, 6)[:, 3:]) @ R
        converged = bool(step @ normal @ step < _SETTLED)
        if converged:
            break
    gain = np.linalg.solve(normal, weighted.T)
    return JointMotions(R, t, gain, _tests(factor, weighted, gain, r), converged)


def _slopes(arm: NDArray, body: NDArray, bodies: int) -> NDArray:
    """Return the derivative (3N, 6B) of points by the motions of their bodies."""
    J = np.zeros((len(arm), 3, bodies, 6))
    rows = np.arange(len(arm))
    J[rows, :, body, :3] = np.eye(3)
    J[rows, :, body, 3:] = -skew(arm)
    return J.reshape(3 * len(arm), 6 * bodies)


def _factor(cov_target: NDArray, rotated_cov: NDArray, J: NDArray) -> tuple[NDArray, bool]:
    """Return the Cholesky factor of S + J K J', with K scaled so that both terms have the same size."""
    count = len(rotated_cov)
    S = symmetric(cov_target)
    rows = np.arange(count)
    blocks = S.reshape(count, 3, count, 3)
    blocks[rows, :, rows, :] += rotated_cov
    column_norm = np.einsum("ij,ij->j", J, J) / count
    variance = np.trace(S) / (3 * count)
    # Other exact combinations, such as the size of points without scale, must not make the matrix singular.
    S[np.diag_indices(3 * count)] += _EXACT * variance
    return cho_factor(S + (J * (variance / column_norm)) @ J.T, lower=True)


def _tests(factor: tuple[NDArray, bool], weighted: NDArray, gain: NDArray, r: NDArray) -> NDArray:
    """Return Baarda's test (N,) of a gross error in each point, three coordinates at once."""
    count = len(r)
    W = cho_solve(factor, np.eye(3 * count))
    Q = symmetric(W - weighted @ gain).reshape(count, 3, count, 3)
    rows = np.arange(count)
    redundancy, weight = Q[rows, :, rows, :], W.reshape(count, 3, count, 3)[rows, :, rows, :]
    weighted_residual = np.einsum("nikj,kj->ni", Q, r)
    is_controlled = np.linalg.eigvalsh(redundancy)[:, 0] > _CONTROLLED * np.linalg.eigvalsh(weight)[:, 0]
    invertible = np.where(is_controlled[:, None, None], redundancy, np.eye(3))
    statistic = np.einsum(
        "ni,ni->n", weighted_residual, np.linalg.solve(invertible, weighted_residual[..., None])[..., 0]
    )
    return np.where(is_controlled, statistic, np.nan)


def survey_part(
    source: NDArray, cov_source: NDArray, body: NDArray, frame: NDArray, gain: NDArray, R: NDArray
) -> NDArray:
    """Return the covariance (6B, 6B) of the motions due to the survey; cov_source (N, 3, 3), other arguments as
    `by_survey`."""
    derivative = by_survey(source, body, frame, gain, R)
    return symmetric(np.einsum("pni,nij,qnj->pq", derivative, cov_source, derivative, optimize=True))


def by_survey(source: NDArray, body: NDArray, frame: NDArray, gain: NDArray, R: NDArray) -> NDArray:
    """Return the derivative (6B, N, 3) of the motions by the survey's errors, in frames defined by the survey.

    As `survey_frame_covariance`: source (N, 3) of all surveyed points of all bodies, body (N,) by number, frame (N,):
    points that define the frames; gain (6B, 3N), zero for unused points.
    """
    derivative = np.zeros((len(R), 6, len(source), 3))
    for number, rotation in enumerate(R):
        rows = np.flatnonzero(body == number)
        weights = frame[rows, None, None] * np.eye(3)
        frame_gain = fit_gain(source[rows][None], weights[None], np.ones(1, bool))[0]
        rotation_6x6 = np.zeros((6, 6))
        rotation_6x6[:3, :3] = rotation_6x6[3:, 3:] = rotation
        derivative[number][:, rows] = np.swapaxes(rotation_6x6 @ frame_gain, 0, 1)
    gain_by_point = gain.reshape(6 * len(R), len(source), 3)
    return np.asarray(
        derivative.reshape(6 * len(R), len(source), 3) - np.einsum("pni,nij->pnj", gain_by_point, R[body])
    )


@dataclass(frozen=True)
class _Pose:
    """Bodies of a pose in the joint fit, by number; and per point (N,) the index of its body among them, its target,
    and its row of the observations."""

    number: int
    bodies: tuple[int, ...]
    body: Index
    target: Index
    row: Index

    def without(self, point: int) -> _Pose:
        is_kept = np.arange(len(self.body)) != point
        return replace(self, body=self.body[is_kept], target=self.target[is_kept], row=self.row[is_kept])


def with_correlations(bodies: Sequence[BodyPoses], rows: Sequence[Index], errors: PointErrors) -> list[BodyPoses]:
    """Return the bodies with default fits by generalised least squares; rows: per body (B, T) the rows of observations.

    Points kept by the robust fit are fitted; those with gross errors by the correlated test are rejected too. The
    estimates of other methods stay, with covariances from the correlations.
    """
    poses = [linked for p in range(len(bodies[0].fit.ok)) if (linked := _pose(p, bodies, rows)) is not None]
    initial_motions = [_motions(pose, bodies, errors) for pose in poses]
    limit = _limits(poses, initial_motions, bodies)
    screened_poses = [
        _cleaned(pose, motions, bodies, errors, limit) for pose, motions in zip(poses, initial_motions, strict=True)
    ]
    joint = {
        pose.number: JointFit(pose.bodies, pose.row, final_motions)
        for pose, final_motions in screened_poses
        if final_motions.converged
    }
    return with_other_methods(_replaced(bodies, screened_poses, errors), rows, errors, joint)


def _pose(p: int, bodies: Sequence[BodyPoses], rows: Sequence[Index]) -> _Pose | None:
    fitted_bodies = tuple(b for b, body in enumerate(bodies) if body.fit.ok[p] and body.used[p].sum() >= _FEWEST)
    if not fitted_bodies:
        return None
    targets = [np.flatnonzero(bodies[b].used[p]) for b in fitted_bodies]
    body_index = np.repeat(np.arange(len(fitted_bodies)), [len(target) for target in targets])
    row = np.concatenate([rows[b][p][target] for b, target in zip(fitted_bodies, targets, strict=True)])
    return _Pose(p, fitted_bodies, body_index, np.concatenate(targets), row)


def _motions(pose: _Pose, bodies: Sequence[BodyPoses], errors: PointErrors) -> JointMotions:
    p, pose_bodies = pose.number, [bodies[b] for b in pose.bodies]
    source = np.array([pose_bodies[k].source[t] for k, t in zip(pose.body, pose.target, strict=True)])
    target = np.array([pose_bodies[k].points.points[p, t] for k, t in zip(pose.body, pose.target, strict=True)])
    cov_source = np.array([pose_bodies[k].cov_source[t] for k, t in zip(pose.body, pose.target, strict=True)])
    points = PointsOfBodies(source, target, pose.body, cov_source, errors.covariance(pose.row))
    return joint_motions(
        points, np.array([body.fit.R[p] for body in pose_bodies]), np.array([body.fit.t[p] for body in pose_bodies])
    )


def _limits(poses: Sequence[_Pose], motions_of_poses: Sequence[JointMotions], bodies: Sequence[BodyPoses]) -> Array:
    """Return the limit (B,) of each body's tests that noise explains, including the body's excess scatter over all
    poses."""
    ratio = np.ones(len(bodies))
    for b in range(len(bodies)):
        tests = [
            motions.tests[pose.body == pose.bodies.index(b)]
            for pose, motions in zip(poses, motions_of_poses, strict=True)
            if b in pose.bodies
        ]
        finite = np.concatenate([t[np.isfinite(t)] for t in tests]) if tests else np.zeros(0)
        if len(finite):
            ratio[b] = np.median(finite) / _MEDIAN_TEST
    ratio = np.where(ratio > _WORTH_A_RATIO**2, ratio, 1.0)
    counts = np.array([max(int(body.used.sum(axis=1).max(initial=1)), 1) for body in bodies])
    return np.asarray(ratio * chdtri(3, FALSE_ALARM / counts))


def _cleaned(
    pose: _Pose, motions: JointMotions, bodies: Sequence[BodyPoses], errors: PointErrors, limit: Array
) -> tuple[_Pose, JointMotions]:
    """Return a pose without points that fail the correlated test, the worst first, and without bodies that keep too few
    points."""
    while True:
        relative_test = np.nan_to_num(motions.tests) / limit[np.array(pose.bodies)[pose.body]]
        is_removable = np.bincount(pose.body)[pose.body] > _FEWEST
        is_kept_by_person = np.array(
            [bodies[pose.bodies[k]].kept[pose.number, t] for k, t in zip(pose.body, pose.target, strict=True)]
        )
        relative_test = np.where(is_removable & ~is_kept_by_person, relative_test, 0.0)
        if relative_test.max(initial=0.0) <= 1.0:
            return pose, motions
        pose = pose.without(int(relative_test.argmax()))
        motions = _motions(pose, bodies, errors)


def _replaced(
    bodies: Sequence[BodyPoses],
    screened_poses: Sequence[tuple[_Pose, JointMotions]],
    errors: PointErrors,
) -> list[BodyPoses]:
    filled_bodies = [_Filled.of(body, len(errors.parameters)) for body in bodies]
    for pose, motions in screened_poses:
        if not motions.converged:
            continue
        joint_cov = _covariance(pose, motions, bodies, errors)
        effects = (motions.gain @ errors.effects(pose.row)).reshape(len(pose.bodies), 6, -1)
        for k, b in enumerate(pose.bodies):
            unknowns = slice(6 * k, 6 * k + 6)
            filled_bodies[b].take(pose, k, motions, joint_cov[unknowns, unknowns], effects[k])
            for j, other in enumerate(pose.bodies):
                filled_bodies[b].with_other(bodies[other].name)[pose.number] = joint_cov[unknowns, 6 * j : 6 * j + 6]
    return [filled.body_poses(body) for filled, body in zip(filled_bodies, bodies, strict=True)]


def _covariance(pose: _Pose, motions: JointMotions, bodies: Sequence[BodyPoses], errors: PointErrors) -> Array:
    """Return the joint covariance (6B, 6B) of the motions, due to errors of points and survey."""
    measured = motions.covariance(errors.covariance(pose.row))
    pose_bodies = [bodies[b] for b in pose.bodies]
    frame_targets = [np.flatnonzero(body.frame) for body in pose_bodies]
    column = {
        (k, t): i
        for i, (k, t) in enumerate((k, t) for k, targets in enumerate(frame_targets) for t in targets.tolist())
    }
    gain = np.zeros((6 * len(pose_bodies), len(column), 3))
    columns = [column[key] for key in zip(pose.body.tolist(), pose.target.tolist(), strict=True)]
    gain[:, columns] = motions.gain.reshape(6 * len(pose_bodies), -1, 3)
    source = np.concatenate([body.source[targets] for body, targets in zip(pose_bodies, frame_targets, strict=True)])
    cov = np.concatenate([body.cov_source[targets] for body, targets in zip(pose_bodies, frame_targets, strict=True)])
    body = np.array([k for k, _ in column])
    frame = np.ones(len(column), bool)
    return measured + survey_part(source, cov, body, frame, gain.reshape(6 * len(pose_bodies), -1), motions.R)


@dataclass
class _Filled:
    """Arrays of one body over all poses, filled in pose by pose."""

    R: Array
    t: Array
    covariance: Array
    n_used: Index
    used: Mask
    dropped: Mask
    cross: dict[str, Array]
    effects: Array

    @classmethod
    def of(cls, body: BodyPoses, parameters: int) -> _Filled:
        fit, count = body.fit, len(body.fit.ok)
        return cls(
            fit.R.copy(),
            fit.t.copy(),
            fit.covariance.copy(),
            fit.n_used.copy(),
            body.used.copy(),
            np.zeros_like(body.used),
            {},
            np.full((count, 6, parameters), np.nan),
        )

    def with_other(self, body: str) -> Array:
        """Return the covariances (B, 6, 6) with the poses of another body, to be filled in."""
        return self.cross.setdefault(body, np.full((len(self.t), 6, 6), np.nan))

    def take(self, pose: _Pose, k: int, motions: JointMotions, covariance: Array, effects: Array) -> None:
        """Store the result of the joint fit for this body, the k-th of a pose."""
        p = pose.number
        self.R[p], self.t[p], self.covariance[p], self.effects[p] = motions.R[k], motions.t[k], covariance, effects
        is_used = np.zeros(self.used.shape[1], bool)
        is_used[pose.target[pose.body == k]] = True
        self.dropped[p], self.used[p], self.n_used[p] = self.used[p] & ~is_used, is_used, is_used.sum()

    def body_poses(self, body: BodyPoses) -> BodyPoses:
        """Return the body with the stored results, and the residuals and reasons that follow."""
        fit = replace(body.fit, R=self.R, t=self.t, covariance=self.covariance, n_used=self.n_used)
        has_residual: Mask = np.asarray(np.isfinite(body.residual).all(axis=-1))
        residual = np.where(has_residual[..., None], fit.residuals(body.source, body.points.points), np.nan)
        sum_of_squares = np.where(self.used, np.sum(np.nan_to_num(residual) ** 2, axis=-1), 0.0).sum(axis=1)
        rms = np.where(fit.status == FitStatus.OK, np.sqrt(sum_of_squares / np.maximum(self.n_used, 1)), fit.rms)
        reason = body.reason.copy()
        residual_mm = 1e3 * np.linalg.norm(np.nan_to_num(residual[self.dropped]), axis=-1)
        reason[self.dropped] = [f"gross error: {mm:.3f} mm off" for mm in residual_mm]
        rejections = body.rejections | {body.default: body.rejections[body.default] + self.dropped.sum(axis=1)}
        return replace(
            body,
            fits=body.fits | {body.default: replace(fit, rms=rms)},
            residual=residual,
            used=self.used,
            rejected=body.rejected | self.dropped,
            rejections=rejections,
            reason=reason,
            cross={(body.default, other): cross for other, cross in self.cross.items()},
            effects=self.effects,
        )


@dataclass(frozen=True)
class JointFit:
    """Joint fit of the bodies of a pose, by number, to the points in rows (N,) of the observations."""

    bodies: tuple[int, ...]
    row: Index
    motions: JointMotions


def with_other_methods(
    bodies: Sequence[BodyPoses], rows: Sequence[Index], errors: PointErrors, joint: Mapping[int, JointFit]
) -> list[BodyPoses]:
    """Return the bodies with covariances of the other methods for correlated point errors.

    A pose is linear in the points' errors with its given weights, for any correlation. rows: per body (B, T) the rows
    of observations; joint: by pose.
    """
    filled = list(bodies)
    for method in dict.fromkeys(method for body in bodies for method in body.weights):
        gains = [_gain(body, method) for body in bodies]
        cov = [np.full((len(body.fit.t), 6, 6), np.nan) for body in bodies]
        cross = [{body.name: np.full_like(cov[0], np.nan) for body in bodies} for _ in bodies]
        for p in range(len(bodies[0].fit.t)):
            fitted_bodies, row, gain = _stacked(p, method, bodies, rows, gains, joint.get(p))
            if not fitted_bodies:
                continue
            joint_cov = gain @ errors.covariance(row) @ gain.T
            for i, b in enumerate(fitted_bodies):
                cov[b][p] = joint_cov[6 * i : 6 * i + 6, 6 * i : 6 * i + 6]
                for k, other in enumerate(fitted_bodies):
                    cross[b][bodies[other].name][p] = joint_cov[6 * i : 6 * i + 6, 6 * k : 6 * k + 6]
        filled = [_with_measured_covariance(*arguments, method) for arguments in zip(filled, cov, cross, strict=True)]
    return filled


def _gain(body: BodyPoses, method: str) -> Array | None:
    """Return the derivative (B, T, 6, 3) of the pose by each point's error, scaled by the excess scatter of a robust
    fit; None if the body has no such fit."""
    if method not in body.weights:
        return None
    weight, factor = body.weights[method]
    fit = body.fits[method]
    rotation = np.where(fit.ok[:, None, None], fit.R, np.eye(3))
    gain = fit_gain(body.source @ np.swapaxes(rotation, -1, -2), weight[..., None, None] * np.eye(3), fit.ok)
    return np.asarray(gain * np.sqrt(np.where(fit.ok, factor, 1.0))[:, None, None, None])


def _stacked(
    p: int,
    method: str,
    bodies: Sequence[BodyPoses],
    rows: Sequence[Index],
    gains: Sequence[Array | None],
    joint: JointFit | None,
) -> tuple[list[int], Index, Array]:
    """Return the bodies of a pose with a method, or their default if they lack it; the rows (n,) of their points, and
    the gain (6b, 3n) of the motions."""
    row = np.concatenate([body_rows[p][body_rows[p] >= 0] for body_rows in rows])
    column = {r: n for n, r in enumerate(row.tolist())}
    fitted_bodies, gains_of_bodies = [], []
    for b, body in enumerate(bodies):
        gain_of_body, padded_gain = gains[b], np.zeros((6, len(row), 3))
        if gain_of_body is not None and body.fits[method].ok[p]:
            observed = np.flatnonzero(rows[b][p] >= 0)
            padded_gain[:, [column[r] for r in rows[b][p, observed].tolist()]] = np.swapaxes(
                gain_of_body[p, observed], 0, 1
            )
        elif gain_of_body is None and joint is not None and b in joint.bodies:
            first = 6 * joint.bodies.index(b)
            by_joint = joint.motions.gain[first : first + 6].reshape(6, -1, 3)
            padded_gain[:, [column[r] for r in joint.row.tolist()]] = by_joint
        else:
            continue
        fitted_bodies.append(b)
        gains_of_bodies.append(padded_gain.reshape(6, -1))
    return fitted_bodies, row, np.concatenate(gains_of_bodies) if gains_of_bodies else np.zeros((0, 3 * len(row)))


def _with_measured_covariance(body: BodyPoses, measured: Array, cross: Mapping[str, Array], method: str) -> BodyPoses:
    updated = {(method, other): covariance_with_other for other, covariance_with_other in cross.items()}
    if method not in body.weights:
        return replace(body, cross={**body.cross, **updated})
    weight, factor = body.weights[method]
    fit, zero_cov = body.fits[method], np.zeros((*weight.shape, 3, 3))
    W = weight[..., None, None] * np.eye(3)
    by_survey = survey_frame_covariance(fit.R, body.source, W, body.cov_source, zero_cov, body.frame, fit.ok)
    covariance = symmetric(measured + by_survey * factor[:, None, None])
    covariance = np.where(np.isfinite(covariance), covariance, fit.covariance)
    return replace(
        body, fits=body.fits | {method: replace(fit, covariance=covariance)}, cross={**body.cross, **updated}
    )
