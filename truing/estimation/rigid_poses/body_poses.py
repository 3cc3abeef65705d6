"""Poses of one body in the measurement frame, by every estimator that its targets allow, with their uncertainty
budget."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from truing.arrays import Array, Index, Mask
from truing.estimation.covariance import relative, relative_of_pair, survey_frame_covariance
from truing.estimation.rigid_poses.haralick import reweighted_fit
from truing.estimation.rigid_poses.points import FittedPoints, PosePoints, SurveyPoints
from truing.estimation.rigid_poses.rigid import FitStatus, RigidFit
from truing.estimation.rigid_poses.umeyama import umeyama
from truing.estimation.uncertainty_budget import Source

NOT_A_REFERENCE = "attachment: not part of the frame"
NOT_SURVEYED = "not in the survey"
_BY_CHANCE = 0.01  # p-value of a scatter below which it counts as larger than the declared noise


@dataclass(frozen=True)
class BodyPoses:
    """One body over B poses and T targets: fits in the measurement frame by method, and the state of its points.

    residual (B, T, 3) in m, body frame, NaN if missing; used, rejected and is_observed (B, T); reason (B, T) of str,
    empty if used; rejections (B,) by method; noise_ratio: scatter over declared noise. source (T, 3) in m, zero if
    unknown, with cov_source (T, 3, 3): reference of the fits; frame (T,): targets that define the body frame; kept
    and excluded (B, T): by a person. For correlated point errors: cross (B, 6, 6) by method and other body,
    covariance with that body's pose by the same method (or by its default); effects (B, 6, K): of one standard
    deviation of each parameter common to all poses on the default pose; weights as in `BodyFit`.
    """

    name: str
    points: PosePoints
    fits: dict[str, RigidFit]
    default: str
    residual: Array
    used: Mask
    rejected: Mask
    rejections: dict[str, Index]
    reason: NDArray[np.object_]
    noise_ratio: float
    source: Array
    cov_source: Array
    frame: Mask
    kept: Mask
    excluded: Mask
    cross: Mapping[tuple[str, str], Array] = field(default_factory=dict)
    effects: Array | None = None
    weights: Mapping[str, tuple[Array, Array]] = field(default_factory=dict)

    @property
    def fit(self) -> RigidFit:
        """The default fit."""
        return self.fits[self.default]


@dataclass(frozen=True)
class PointDecisions:
    """Points (B, T) with a decision by a person, and the reason given (B, T)."""

    chosen: Mask
    words: NDArray[np.object_]

    @classmethod
    def none(cls, shape: tuple[int, ...]) -> PointDecisions:
        """Return no decision on any point."""
        return cls(np.zeros(shape, bool), np.full(shape, "", dtype=object))


def reasons(
    fit: RigidFit, residual: Array, known: Mask, frame: Mask, used: Mask, rejected: Mask
) -> NDArray[np.object_]:
    """Return the reason (B, T) for not using a point, in words; empty if used.

    known, frame (T,): targets with a reference position, and those that define the body frame.
    """
    off_mm = 1e3 * np.linalg.norm(np.nan_to_num(residual), axis=-1)
    gross = _filled_words(lambda mm: f"gross error: {mm:.3f} mm off" if mm else "gross error", off_mm, rejected)
    no_pose = np.broadcast_to(np.array([f"no pose: {s}" for s in fit.status], dtype=object)[:, None], used.shape)
    conditions = [
        used,
        rejected,
        np.broadcast_to(~known, used.shape),
        np.broadcast_to(~frame, used.shape),
    ]
    return np.select(conditions, ["", gross, NOT_SURVEYED, NOT_A_REFERENCE], no_pose)


def _filled_words(wording: Callable[[float], str], values: Array, mask: Mask) -> NDArray[np.object_]:
    texts = np.full(values.shape, "", dtype=object)
    texts[mask] = [wording(v) for v in values[mask]]
    return texts


def by_every_method(
    source: Array,
    target: Array,
    cov_source: Array,
    cov_target: Array,
    usable: Mask,
    default: tuple[RigidFit, Mask],
    frame: Mask,
) -> tuple[dict[str, RigidFit], dict[str, tuple[Array, Array]]]:
    """Return the plain, the reweighted and the default fit (last), with covariances in the survey's frame, and the
    weights of the first two."""
    sigmas = [np.sqrt(np.trace(C, axis1=-2, axis2=-1) / 3) for C in (cov_source, cov_target)]
    sigma = np.where(usable, np.hypot(sigmas[0], sigmas[1]), 1.0)
    reweighted, weight, loss = reweighted_fit(source, target, sigma, usable)
    plain = umeyama(source, target, usable / sigma**2, sigma=sigma)
    fit, inlier = default

    def in_frame(fit: RigidFit, W: Array, factor: Array | float = 1.0) -> RigidFit:
        covariance = survey_frame_covariance(fit.R, source, W, cov_source, cov_target, frame, fit.ok)
        covariance = covariance * np.broadcast_to(factor, len(covariance))[:, None, None]
        return replace(fit, covariance=covariance).masked()

    weights = {
        "umeyama": (usable / sigma**2, np.ones(len(usable))),
        "haralick": ((weight > 0) / sigma**2, loss),
    }
    isotropic = {method: w[..., None, None] * np.eye(3) for method, (w, _) in weights.items()}
    fits = {
        "umeyama": in_frame(plain, isotropic["umeyama"]),
        "haralick": in_frame(reweighted, isotropic["haralick"], loss),
        "maximum_likelihood": in_frame(fit, _inverse_noise(fit, cov_source, cov_target, inlier)),
    }
    return fits, weights


def _inverse_noise(fit: RigidFit, cov_source: Array, cov_target: Array, inlier: Mask) -> Array:
    """Return the weights (B, T, 3, 3) of the maximum-likelihood fit: inverse noise of both clouds, in measurement
    axes."""
    used = (inlier & fit.ok[:, None])[..., None, None]
    R = np.where(fit.ok[:, None, None], fit.R, np.eye(3))[:, None]
    noise = np.where(used, cov_target + R @ cov_source @ np.swapaxes(R, -1, -2), np.eye(3))
    return used * np.linalg.inv(noise)


def seen_from(
    base: BodyPoses, fit: RigidFit, method: str, cross: Array | None = None
) -> tuple[Array, Array, Array, NDArray[np.object_]]:
    """Return R (B, 3, 3), p (B, 3), covariance (B, 6, 6) of a body relative to the base; and the status (B,) of the
    pair.

    cross (B, 6, 6): covariance between the motions of body and base, if their errors are correlated.
    """
    base_fit = base.fits.get(method, base.fit)
    if cross is None:
        R, p, covariance = relative(base_fit.R, base_fit.t, base_fit.covariance, fit.R, fit.t, fit.covariance)
    else:
        cross_cov = np.where(np.isfinite(cross), cross, 0.0)
        first_rows = np.concatenate([base_fit.covariance, np.swapaxes(cross_cov, 1, 2)], axis=2)
        joint_cov = np.concatenate([first_rows, np.concatenate([cross_cov, fit.covariance], axis=2)], axis=1)
        R, p, covariance = relative_of_pair(base_fit.R, base_fit.t, fit.R, fit.t, joint_cov)
    base_status = np.array([f"{base.name}: {s}" for s in base_fit.status], dtype=object)
    return R, p, covariance, np.where(~fit.ok, fit.status, np.where(base_fit.ok, str(FitStatus.OK), base_status))


def without_targets(name: str, poses: tuple[int | str, ...], default: str) -> BodyPoses:
    """Return a body without any observed target; ``default``: the method of its poses."""
    count = len(poses)
    no_targets = np.zeros((count, 0), bool)
    points = PosePoints(poses, (), np.zeros((count, 0, 3)), np.zeros((count, 0, 3, 3)), no_targets)
    residual, reason = np.zeros((count, 0, 3)), np.zeros((count, 0), dtype=object)
    no_positions = np.zeros((no_targets.shape[1], 3))
    known = (
        no_positions,
        np.zeros((no_targets.shape[1], 3, 3)),
        np.zeros(no_targets.shape[1], bool),
        no_targets,
        no_targets,
    )
    return BodyPoses(name, points, {}, default, residual, no_targets, no_targets, {}, reason, 1.0, *known)


def _scatter(residual: Array, used: Mask, R: Array, points: PosePoints) -> tuple[float, float]:
    """Return the scatter of residuals about their targets' means over the declared noise, with its freedom; 1 if not
    larger than by chance. Errors of the survey are the same in all poses, and are removed with the means."""
    from scipy.special import chdtrc

    mask = used & np.isfinite(residual).all(-1)
    count = mask.sum(0)
    mean = np.where(mask[..., None], residual, 0.0).sum(0) / np.maximum(count, 1)[:, None]
    deviation = np.einsum("bij,bnj->bni", R, np.where(mask[..., None], residual - mean, 0.0))
    cov = np.where(mask[..., None, None], points.cov, np.eye(3))
    squares = float(np.einsum("bni,bni->", deviation, np.linalg.solve(cov, deviation[..., None])[..., 0]))
    poses = int(mask.any(1).sum())
    dof = float(3 * mask.sum() - 6 * poses - max(3 * int((count > 0).sum()) - 6, 0))
    if dof <= 0 or chdtrc(dof, squares) > _BY_CHANCE:
        return 1.0, max(dof, 0.0)
    return float(np.sqrt(squares / dof)), dof


def body_parts(name: str, survey: SurveyPoints, fitted_points: FittedPoints) -> dict[Source, Array] | None:
    """Return covariances (B, 6, 6) of a body's poses due to its points, its survey, and excess scatter.

    Only surveyed targets count. None if no point was used, or if the noise of one is not declared.
    """
    points, ok = fitted_points.points, np.asarray(np.isfinite(fitted_points.R).all((1, 2)))
    used = fitted_points.used & ok[:, None]
    declared = np.trace(points.cov, axis1=-2, axis2=-1) > 0.0
    if not used.any() or not declared[used].all() or not np.isfinite(points.cov[used]).all():
        return None
    rotation, source_cov = fitted_points.rotation, np.nan_to_num(survey.cov)
    target_cov = np.where(used[..., None, None], points.cov, np.eye(3))
    rotated_survey_cov = rotation[:, None] @ source_cov @ np.swapaxes(rotation, 1, 2)[:, None]
    noise = target_cov + np.where(used[..., None, None], rotated_survey_cov, 0.0)
    W = used[..., None, None] * np.linalg.inv(noise)
    zero_cov = np.zeros_like(source_cov), np.zeros_like(target_cov)
    by_points = survey_frame_covariance(rotation, survey.points, W, zero_cov[0], target_cov, survey.frame, ok)
    by_survey = survey_frame_covariance(rotation, survey.points, W, source_cov, zero_cov[1], survey.frame, ok)
    parts = {
        Source(f"points of {name}, as declared", "B"): by_points,
        Source(f"survey of {name}, as declared", "B"): by_survey,
    }
    ratio, dof = _scatter(fitted_points.residual, used, rotation, points)
    if ratio > 1.0:
        parts[Source(f"scatter of the points of {name} beyond that", "A", dof)] = (ratio**2 - 1.0) * by_points
    return parts
