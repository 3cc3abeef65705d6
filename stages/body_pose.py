"""One body's poses in the frame of the measurement, by every estimator that its targets allow."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from stages.point_arrays import PosePoints, SurveyPoints
from truing.estimation.covariance import survey_frame_covariance
from truing.estimation.haralick import haralick
from truing.estimation.procrustes import common_shape, generalised_procrustes
from truing.estimation.rigid import FitStatus, RigidFit, mask_entries, umeyama
from truing.estimation.robust_pose import robust_poses, sigma_from_distances, target_scatter

if TYPE_CHECKING:
    from schemas.campaign import Overrule

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

NOT_A_REFERENCE = "attachment: not part of the frame"
NOT_SURVEYED = "not in the survey"
# Share of the coordinates below which points are not told apart, where no noise was declared and none shows.
_ROUNDING = 1e-9


@dataclass(frozen=True)
class BodyPoses:
    """One body over B poses and T targets: fits in the measurement's frame by method, and what became of its points.

    residual (B, T, 3) in m, body frame, NaN where there is none; used, rejected and seen (B, T); reason (B, T) of str,
    empty where a point was used; rejections (B,) by method; noise_ratio: scatter over declared noise.
    """

    name: str
    points: PosePoints
    fits: dict[str, RigidFit]
    default: str
    residual: Array
    used: Mask
    rejected: Mask
    rejections: dict[str, NDArray[np.int64]]
    reason: NDArray[np.object_]
    noise_ratio: float

    @property
    def fit(self) -> RigidFit:
        """The default fit."""
        return self.fits[self.default]


def fit_body(
    points: PosePoints, body: str, survey: SurveyPoints, exclude: Iterable[Overrule], keep: Iterable[Overrule]
) -> BodyPoses:
    """Poses of a body, relative to its survey, or to the shape that its poses share where it has none."""
    excluded, excluded_why = _overruled(points, body, exclude, "excluded")
    kept, kept_why = _overruled(points, body, keep, "kept")
    surveyed = len(survey.targets) > 0
    source, cov_source = _reference(points, survey)
    if not surveyed:
        source, _ = common_shape(points.points, points.seen & ~excluded)
    known: Mask = np.asarray(np.isfinite(source).all(axis=-1))
    frame = known & _in_frame(points, survey)
    usable = points.seen & frame & ~excluded
    source = np.nan_to_num(source)
    cov_source, cov_target = _noise(source, np.nan_to_num(cov_source), points, usable)
    judged = cov_target if surveyed else _with_deformation(source, points.points, cov_source, cov_target, usable)
    fit, inlier, ratio = robust_poses(source, points.points, cov_source, judged, usable, keep=kept)
    if surveyed:
        fits = _with_survey(source, points.points, cov_source, cov_target, usable, (fit, inlier), frame)
    else:
        joint = generalised_procrustes(points.points, cov_target, inlier & fit.ok[:, None])
        fits, source = {"procrustes": joint.poses}, np.nan_to_num(joint.shape)
    default = next(reversed(fits))
    used = inlier & fits[default].ok[:, None]
    rejected = usable & ~inlier & _judged(fit, inlier)[:, None] | points.seen & excluded
    residual = np.where((points.seen & known)[..., None], fits[default].residuals(source, points.points), np.nan)
    why = _reasons(points, fits[default], residual, known, frame, used, rejected)
    why = np.where(used & kept, kept_why, np.where(excluded & points.seen, excluded_why, why))
    left = {
        method: (usable.sum(axis=1) - f.n_used + (points.seen & excluded).sum(axis=1)) for method, f in fits.items()
    }
    left[default] = rejected.sum(axis=1)
    return BodyPoses(body, points, fits, default, residual, used, rejected, left, why, ratio)


def _with_survey(
    source: Array,
    target: Array,
    cov_source: Array,
    cov_target: Array,
    usable: Mask,
    default: tuple[RigidFit, Mask],
    frame: Mask,
) -> dict[str, RigidFit]:
    """The plain, the reweighted and the default fit, each with its covariance in the survey's frame; default last."""
    spread = [np.sqrt(np.trace(C, axis1=-2, axis2=-1) / 3) for C in (cov_source, cov_target)]
    sigma = np.where(usable, np.hypot(spread[0], spread[1]), 1.0)
    reweighted, weight = haralick(
        source, target, np.where(usable, spread[0], 0.0), np.where(usable, spread[1], 1.0), usable
    )
    plain = umeyama(source, target, usable / sigma**2, sigma=sigma)
    trusted = umeyama(source, target, (weight > 0) / sigma**2, sigma=sigma)
    loss = reweighted.covariance[:, 0, 0] / trusted.covariance[:, 0, 0]
    fit, inlier = default

    def in_frame(fit: RigidFit, W: Array, factor: Array | float = 1.0) -> RigidFit:
        covariance = survey_frame_covariance(fit.R, source, W, cov_source, cov_target, frame, fit.ok)
        covariance = covariance * np.broadcast_to(factor, len(covariance))[:, None, None]
        return replace(fit, covariance=mask_entries(covariance, fit.ok))

    isotropic = (1 / sigma**2)[..., None, None] * np.eye(3)
    return {
        "umeyama": in_frame(plain, usable[..., None, None] * isotropic),
        "haralick": in_frame(reweighted, (weight > 0)[..., None, None] * isotropic, loss),
        "maximum_likelihood": in_frame(fit, _inverse_noise(fit, cov_source, cov_target, inlier)),
    }


def _inverse_noise(fit: RigidFit, cov_source: Array, cov_target: Array, inlier: Mask) -> Array:
    """Weights (B, T, 3, 3) of the maximum-likelihood fit: inverse noise of both clouds, in the measurement's axes."""
    used = (inlier & fit.ok[:, None])[..., None, None]
    R = np.where(fit.ok[:, None, None], fit.R, np.eye(3))[:, None]
    noise = np.where(used, cov_target + R @ cov_source @ np.swapaxes(R, -1, -2), np.eye(3))
    return used * np.linalg.inv(noise)


def _with_deformation(source: Array, target: Array, cov_source: Array, cov_target: Array, usable: Mask) -> Array:
    """Covariances (B, T, 3, 3) with each target's own movement added: without a survey, no one says which ones move."""
    fit, _, _ = robust_poses(source, target, cov_source, cov_target, usable)
    tau = target_scatter(fit, source, target, cov_target, usable)
    return cov_target + (tau**2)[:, None, None] * np.eye(3)


def _reference(points: PosePoints, survey: SurveyPoints) -> tuple[Array, Array]:
    """The survey (T, 3) with its covariance (T, 3, 3), in the order of the observed targets; NaN where not surveyed."""
    place = {target: k for k, target in enumerate(survey.targets)}
    rows = np.array([place.get(target, -1) for target in points.targets], dtype=np.int64)
    known = rows >= 0
    source, cov = np.full((len(rows), 3), np.nan), np.zeros((len(rows), 3, 3))
    source[known], cov[known] = survey.points[rows[known]], survey.cov[rows[known]]
    return source, cov


def _in_frame(points: PosePoints, survey: SurveyPoints) -> Mask:
    """(T,) which targets make the body's frame: those away from the legs, or all where these are too few."""
    at_leg = {target for target, leg in zip(survey.targets, survey.leg, strict=True) if leg > 0}
    away = np.array([target not in at_leg for target in points.targets], dtype=bool)
    return away if len(survey.targets) - len(at_leg) >= 3 or not at_leg else np.ones_like(away)


def _noise(source: Array, cov_source: Array, points: PosePoints, usable: Mask) -> tuple[Array, Array]:
    """Covariances (T, 3, 3) and (B, T, 3, 3), with what the distances between points tell where none was declared."""
    undeclared = ~(np.trace(points.cov, axis1=-2, axis2=-1) > 0.0)
    if not (undeclared & usable).any():
        return cov_source, np.where(undeclared[..., None, None], np.eye(3), points.cov)
    rounding = _ROUNDING * float(np.abs(points.points).max(initial=1e-3))
    sigma = max(sigma_from_distances(source, points.points, usable), rounding)
    return cov_source, np.where(undeclared[..., None, None], sigma**2 * np.eye(3), points.cov)


def _judged(fit: RigidFit, inlier: Mask) -> Mask:
    """(B,) poses in which some points agree, so that the others stand out, whether or not a pose came of it."""
    return np.isin(fit.status, [str(FitStatus.OK), str(FitStatus.NO_CONSENSUS)]) & inlier.any(axis=1)


def _reasons(
    points: PosePoints, fit: RigidFit, residual: Array, known: Mask, frame: Mask, used: Mask, rejected: Mask
) -> NDArray[np.object_]:
    """(B, T) why a point was not used, in words; empty where it was."""
    off_mm = 1e3 * np.linalg.norm(np.nan_to_num(residual), axis=-1)
    gross = _each(lambda mm: f"gross error: {mm:.3f} mm off" if mm else "gross error", off_mm, rejected)
    no_pose = np.broadcast_to(np.array([f"no pose: {s}" for s in fit.status], dtype=object)[:, None], used.shape)
    conditions = [used, rejected, np.broadcast_to(~known, used.shape), np.broadcast_to(~frame, used.shape)]
    return np.select(conditions, ["", gross, NOT_SURVEYED, NOT_A_REFERENCE], no_pose)


def _each(word: Callable[[float], str], values: Array, where: Mask) -> NDArray[np.object_]:
    out = np.full(values.shape, "", dtype=object)
    out[where] = [word(v) for v in values[where]]
    return out


def _overruled(points: PosePoints, body: str, rules: Iterable[Overrule], verb: str) -> tuple[Mask, NDArray[np.object_]]:
    """(B, T) which points a person decided on, and in which words."""
    chosen = np.zeros(points.seen.shape, bool)
    words = np.full(points.seen.shape, "", dtype=object)
    for rule in rules:
        if rule.body not in (None, body):
            continue
        at_pose = np.array([rule.pose is None or str(rule.pose) == str(pose) for pose in points.poses], dtype=bool)
        at_target = np.array([rule.target in (None, target) for target in points.targets], dtype=bool)
        here = at_pose[:, None] & at_target & points.seen
        chosen |= here
        words[here] = f"{verb} by {rule.by}: {rule.reason}"
    return chosen, words
