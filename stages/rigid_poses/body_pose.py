"""One body's poses in the frame of the measurement, by every estimator that its targets allow."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from stages.point_arrays import PosePoints, SurveyPoints
from stages.rigid_poses.body_fit import BodyFit, fit_by_itself, fit_to_survey
from truing.estimation.rigid_poses.rigid import RigidFit

if TYPE_CHECKING:
    from schemas.sections import Overrule

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

NOT_A_REFERENCE = "attachment: not part of the frame"
NOT_SURVEYED = "not in the survey"


@dataclass(frozen=True)
class BodyPoses:
    """One body over B poses and T targets: fits in the measurement's frame by method, and what became of its points.

    residual (B, T, 3) in m, body frame, NaN where there is none; used, rejected and seen (B, T); reason (B, T) of str,
    empty where a point was used; rejections (B,) by method; noise_ratio: scatter over declared noise. source (T, 3) in
    m, zero where not known, and cov_source (T, 3, 3): what the fits are relative to; frame (T,): makes the body's
    frame; kept and excluded (B, T): by a person. Where points have errors in common: cross (B, 6, 6) by method and
    other body, covariance with that body's pose by the same method (by its default, where it lacks this one); effects
    (B, 6, K) of one standard deviation of each parameter common to all poses on the default pose; weights as those of
    `BodyFit`.
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


def fit_body(
    points: PosePoints,
    body: str,
    survey: SurveyPoints,
    exclude: Iterable[Overrule],
    keep: Iterable[Overrule],
    own: Array | None = None,
) -> BodyPoses:
    """Poses of a body, relative to its survey, or to the shape that its poses share where it has none.

    own (B, T, 3, 3): covariances without what is common to all poses. That shape is found with them: an error of scale,
    alike in all poses, would else leave it open along the line to each point.
    """
    excluded, excluded_why = _overruled(points, body, exclude, "excluded")
    kept, kept_why = _overruled(points, body, keep, "kept")
    if survey.targets:
        fitted = fit_to_survey(points, survey, ~excluded, kept)
    else:
        each = points if own is None else replace(points, cov=np.where(points.seen[..., None, None], own, points.cov))
        fitted = fit_by_itself(each, ~excluded, kept)
    fit, usable = fitted.fits[fitted.default], points.seen & fitted.frame & ~excluded
    used = fitted.agreed & fit.ok[:, None]
    rejected = usable & ~fitted.agreed & fitted.judged[:, None] | points.seen & excluded
    there = (points.seen & fitted.known)[..., None]
    residual = np.where(there, fit.residuals(np.nan_to_num(fitted.source), points.points), np.nan)
    why = _reasons(points, fit, residual, fitted, used, rejected)
    kept, excluded = used & kept, excluded & points.seen
    why = np.where(kept, kept_why, np.where(excluded, excluded_why, why))
    by_person = excluded.sum(axis=1)
    left = {method: usable.sum(axis=1) - f.n_used + by_person for method, f in fitted.fits.items()}
    left[fitted.default] = rejected.sum(axis=1)
    return BodyPoses(
        *(body, points, fitted.fits, fitted.default, residual, used, rejected, left, why, fitted.noise_ratio),
        *(np.nan_to_num(fitted.source), fitted.cov_source, fitted.frame, kept, excluded),
        weights=fitted.weights,
    )


def _reasons(
    points: PosePoints, fit: RigidFit, residual: Array, fitted: BodyFit, used: Mask, rejected: Mask
) -> NDArray[np.object_]:
    """(B, T) why a point was not used, in words; empty where it was."""
    off_mm = 1e3 * np.linalg.norm(np.nan_to_num(residual), axis=-1)
    gross = _each(lambda mm: f"gross error: {mm:.3f} mm off" if mm else "gross error", off_mm, rejected)
    no_pose = np.broadcast_to(np.array([f"no pose: {s}" for s in fit.status], dtype=object)[:, None], used.shape)
    conditions = [
        used,
        rejected,
        np.broadcast_to(~fitted.known, used.shape),
        np.broadcast_to(~fitted.frame, used.shape),
    ]
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
        here = chosen_points(points, body, rule)
        chosen |= here
        words[here] = f"{verb} by {rule.signed}: {rule.reason}"
    return chosen, words


def chosen_points(points: PosePoints, body: str, rule: Overrule) -> Mask:
    """(B, T) which points of a body a rule names; an absent key stands for all, and runs have none."""
    if rule.body not in (None, body):
        return np.zeros(points.seen.shape, bool)
    at_pose = np.array([rule.pose is None or str(rule.pose) == str(pose) for pose in points.poses], dtype=bool)
    at_target = np.array([rule.target in (None, target) for target in points.targets], dtype=bool)
    return np.asarray(at_pose[:, None] & at_target & points.seen)
