"""Poses of one body by every estimator, in blocks of poses, after one estimate of the values that all poses share.

All poses share the agreeing points, the scatter over noise and, without a survey, the shape (`CommonPart`): a few
numbers per point and pose. Everything else, with matrices for each point, is computed for a block of poses at a time.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from truing.arrays import Array, Index, Mask
from truing.estimation.blocks import pose_blocks
from truing.estimation.rigid_poses.body_poses import BodyPoses, PointDecisions, by_every_method, reasons
from truing.estimation.rigid_poses.points import CompactPoints, PosePoints, SurveyPoints
from truing.estimation.rigid_poses.procrustes import ProcrustesFit, common_shape, generalised_procrustes
from truing.estimation.rigid_poses.rigid import FitStatus, RigidFit, join_fits
from truing.estimation.rigid_poses.robust_pose import (
    RobustBody,
    fit_robustly,
    scatter_of_lengths,
    sigma_of_some_poses,
)
from truing.estimation.rigid_poses.shape_poses import JointShape, covariance_on_shape, poses_on_shape
from truing.estimation.rigid_poses.umeyama import umeyama
from truing.threads import in_order

Points = PosePoints | CompactPoints

# Share of the coordinates taken as noise of the points, if none was declared and none shows.
_ROUNDING = 1e-9
# Own movement of a target, in units of the noise, above which it counts as moved instead of flexing.
_LARGEST_MOVEMENT = 30.0
SHAPE_POINTS = 150_000
"""Points from whose poses the shape of a body without a survey is estimated; its other poses are fitted to it."""
_SEEN_OFTEN = 200  # poses that determine the place of a target


@dataclass(frozen=True)
class PointNoise:
    """Covariances of points, with ``fill`` (m^2) as variance of those without."""

    points: Points
    fill: float

    def cov(self, rows: slice | Index) -> Array:
        """Return the covariances (b, T, 3, 3) in some poses."""
        cov = self.points.block(rows).cov
        undeclared = ~(np.trace(cov, axis1=-2, axis2=-1) > 0.0)
        return np.where(undeclared[..., None, None], self.fill * np.eye(3), cov) if undeclared.any() else cov

    @property
    def variance(self) -> Array:
        """Sum (B, T) of the variances of the three coordinates, in m^2."""
        declared = self.points.variance
        return np.where(declared > 0.0, declared, 3.0 * self.fill)


@dataclass(frozen=True)
class CommonPart:
    """Values that all poses of a body share.

    source (T, 3) in m, NaN if unknown, with cov_source (T, 3, 3) of the survey; known (T,): with reference position;
    frame (T,): defines the body frame; agreed (B, T): agreeing points; has_consensus (B,): poses with agreeing points,
    in which other points are gross errors even if there is no pose; fit: default poses, without covariances; joint:
    shape with its covariance, without a survey; is_observed (B, T): points that determine the poses on it;
    shape_poses: number of poses from which it was estimated.
    """

    source: Array
    cov_source: Array
    known: Mask
    frame: Mask
    noise: PointNoise
    fit: RigidFit
    agreed: Mask
    has_consensus: Mask
    noise_ratio: float
    joint: JointShape | None = None
    is_observed: Mask | None = None
    shape_poses: int = 0


@dataclass(frozen=True)
class BodyEstimate:
    """One body over B poses and T targets: its common part, and its poses on request.

    excluded, kept: points that a person excluded, or marked as valid; None for none.
    """

    name: str
    points: Points
    common: CommonPart
    excluded: PointDecisions | None = None
    kept: PointDecisions | None = None

    @property
    def usable(self) -> Mask:
        """Points (B, T) of the body frame that are not excluded."""
        usable = self.points.is_observed & self.common.frame
        return usable if self.excluded is None else usable & ~self.excluded.chosen

    @property
    def rejected(self) -> Mask:
        """Points (B, T) left out: gross errors, and those that a person excluded."""
        gross = self.usable & ~self.common.agreed & self.common.has_consensus[:, None]
        return gross if self.excluded is None else gross | self.points.is_observed & self.excluded.chosen

    def reason(self, pose: int, target: int) -> str:
        """Return the reason for not using a point, in words; empty if used."""
        return str(self.poses(slice(pose, pose + 1), every=False).reason[0, target])

    def poses(self, rows: slice | Index, *, every: bool = True) -> BodyPoses:
        """Return some of the poses with the state of their points; by the default estimator alone unless ``every``,
        without covariances then."""
        common, points = self.common, self.points.block(rows)
        excluded_points, kept_points = (
            _decided(decisions, rows, points.is_observed.shape) for decisions in (self.excluded, self.kept)
        )
        usable = points.is_observed & common.frame & ~excluded_points.chosen
        fits, weights = self._fits(points, usable, rows, every)
        default = next(reversed(fits))
        fit = fits[default]
        used = common.agreed[rows] & fit.ok[:, None]
        rejected = self._rejected(points, usable, excluded_points, rows)
        source = np.nan_to_num(common.source)
        has_reference = (points.is_observed & common.known)[..., None]
        residual = np.where(has_reference, fit.residuals(source, points.points), np.nan)
        reason = reasons(fit, residual, common.known, common.frame, used, rejected)
        mask, is_excluded = used & kept_points.chosen, excluded_points.chosen & points.is_observed
        reason = np.where(mask, kept_points.words, np.where(is_excluded, excluded_points.words, reason))
        rejections = {method: usable.sum(axis=1) - f.n_used + is_excluded.sum(axis=1) for method, f in fits.items()}
        rejections[default] = rejected.sum(axis=1)
        return BodyPoses(
            *(self.name, points, fits, default, residual, used, rejected, rejections, reason, common.noise_ratio),
            *(source, np.nan_to_num(common.cov_source), common.frame, mask, is_excluded),
            weights=weights,
        )

    def _rejected(self, points: PosePoints, usable: Mask, excluded: PointDecisions, rows: slice | Index) -> Mask:
        gross = usable & ~self.common.agreed[rows] & self.common.has_consensus[rows][:, None]
        return np.asarray(gross | points.is_observed & excluded.chosen)

    def _fits(
        self, points: PosePoints, usable: Mask, rows: slice | Index, every: bool
    ) -> tuple[dict[str, RigidFit], Mapping[str, tuple[Array, Array]]]:
        """Return the fits by every method, the default last, and the weights of those with one weight per point."""
        common = self.common
        fit, agreed = common.fit.some(rows), common.agreed[rows]
        if not every:
            return {"maximum_likelihood" if common.joint is None else "procrustes": fit}, {}
        cov = common.noise.cov(rows)
        if common.joint is not None and common.is_observed is not None:
            return {"procrustes": _with_covariance_on_shape(fit, common.joint, cov, common.is_observed[rows])}, {}
        source, cov_source = np.nan_to_num(common.source), np.nan_to_num(common.cov_source)
        return by_every_method(source, points.points, cov_source, cov, usable, (fit, agreed), common.frame)


def _decided(decisions: PointDecisions | None, rows: slice | Index, shape: tuple[int, ...]) -> PointDecisions:
    return (
        PointDecisions.none(shape)
        if decisions is None
        else PointDecisions(decisions.chosen[rows], decisions.words[rows])
    )


def _with_covariance_on_shape(fit: RigidFit, joint: JointShape, cov: Array, observed: Mask) -> RigidFit:
    covariance, ok = np.full((len(fit.R), 6, 6), np.nan), fit.ok
    covariance[ok] = covariance_on_shape(joint, cov[ok], observed[ok], fit.R[ok])
    return replace(fit, covariance=covariance)


def fit_body(
    points: PosePoints,
    body: str,
    survey: SurveyPoints,
    excluded: PointDecisions | None = None,
    kept: PointDecisions | None = None,
    cov_independent: Array | None = None,
) -> BodyPoses:
    """Return the poses of a body at once, see `estimate_body`."""
    return estimate_body(points, body, survey, excluded, kept, cov_independent).poses(slice(None))


def estimate_body(
    points: Points,
    body: str,
    survey: SurveyPoints,
    excluded: PointDecisions | None = None,
    kept: PointDecisions | None = None,
    cov_independent: Array | None = None,
) -> BodyEstimate:
    """Return the poses of a body relative to its survey, or to the shape common to its poses if it has none.

    excluded, kept: points that a person excluded, or marked as valid. cov_independent (B, T, 3, 3): covariances without
    errors common to all poses. They are used to find the common shape, since a common scale error would otherwise make
    it uncertain along the line to each point.
    """
    allowed = points.is_observed if excluded is None else points.is_observed & ~excluded.chosen
    always_used = np.zeros((1, 1), bool) if kept is None else kept.chosen
    if survey.targets:
        return BodyEstimate(body, points, _fit_to_survey(points, survey, allowed, always_used), excluded, kept)
    independent_points: Points = points
    if cov_independent is not None:
        block = points.block(slice(None))
        independent_points = replace(
            block, cov=np.where(block.is_observed[..., None, None], cov_independent, block.cov)
        )
    return BodyEstimate(body, points, _fit_without_survey(independent_points, allowed, always_used), excluded, kept)


def _fit_to_survey(points: Points, survey: SurveyPoints, allowed: Mask, always_used: Mask) -> CommonPart:
    """Return the common part relative to the survey, from the targets of the body frame."""
    source, cov_source = _reference(points, survey)
    known: Mask = np.asarray(np.isfinite(source).all(axis=-1))
    frame = known & _in_frame(points, survey)
    usable = allowed & frame
    reference, cov_reference = np.nan_to_num(source), np.nan_to_num(cov_source)
    noise = _noise(reference, points, usable)
    fit, agreed, ratio = fit_robustly(_robust(reference, cov_reference, points, noise, usable, always_used))
    return CommonPart(source, cov_source, known, frame, noise, _slim(fit), agreed, _has_consensus(fit, agreed), ratio)


def _fit_without_survey(points: Points, allowed: Mask, always_used: Mask) -> CommonPart:
    """Return the common part relative to the shape that the poses share; poses and shape are estimated together."""
    usable = allowed
    reference_pose = int(usable.sum(axis=1).argmax())
    sigma = _typical_sigma(_noise(points.points[reference_pose], points, usable & usable[reference_pose]), usable)
    rows = shape_rows(usable)
    source = common_shape(points.points[rows], usable[rows], sigma)
    known: Mask = np.asarray(np.isfinite(source).all(axis=-1))
    reference, usable = np.nan_to_num(source), usable & known
    noise, cov_reference = _noise(reference, points, usable), np.zeros((len(reference), 3, 3))
    body = _robust(reference, cov_reference, points, noise, usable, always_used)
    fit, agreed, ratio = fit_robustly(body)
    tau = _movement(fit, ratio, body, noise, usable)
    if tau.any():
        fit, agreed, ratio = fit_robustly(_robust(reference, cov_reference, points, noise, usable, always_used, tau))
    inliers = agreed & fit.ok[:, None]
    joint = generalised_procrustes(points.points[rows], noise.cov(rows), inliers[rows], shape=source)
    on_shape, observed = _fit_to_joint_shape(joint, fit, rows, points, noise, inliers)
    shape = _shape_of(joint, known)
    source = np.where(np.isfinite(joint.shape), joint.shape, source)
    consensus = _has_consensus(fit, agreed)
    return CommonPart(
        *(source, cov_reference, known, known, noise, _slim(on_shape), agreed, consensus, ratio, shape, observed),
        shape_poses=len(observed[rows]),
    )


def shape_rows(usable: Mask, max_points: int = SHAPE_POINTS) -> slice | Index:
    """Return the poses from which the shape of a body is estimated: all, or some evenly spaced ones that show every
    target often."""
    poses, targets = usable.shape
    max_poses = max(1, max_points // max(targets, 1))
    if poses <= max_poses:
        return slice(None)
    chosen = np.zeros(poses, bool)
    chosen[np.linspace(0, poses - 1, max_poses).astype(np.int64)] = True
    for k in np.flatnonzero((usable & chosen[:, None]).sum(axis=0) < _SEEN_OFTEN):
        observing_poses = np.flatnonzero(usable[:, k])
        chosen[
            observing_poses[
                np.linspace(0, len(observing_poses) - 1, min(len(observing_poses), _SEEN_OFTEN)).astype(np.int64)
            ]
        ] = True
    return np.flatnonzero(chosen)


def _fit_to_joint_shape(
    joint: ProcrustesFit, robust: RigidFit, rows: slice | Index, points: Points, noise: PointNoise, inliers: Mask
) -> tuple[RigidFit, Mask]:
    """Return all poses on the joint shape, and the points (B, T) that determine them.

    Poses from which the shape was estimated have their joint estimate.
    """
    known = np.isfinite(joint.shape).all(axis=-1)
    if isinstance(rows, slice):
        return joint.poses, inliers & known & joint.poses.ok[:, None]
    shape = _shape_of(joint, known)

    def fitted(block: slice) -> RigidFit:
        observed = inliers[block] & known
        return _fit_on_shape(shape, joint.status, points.points[block], noise.cov(block), observed, robust.some(block))

    fit = join_fits(list(in_order(fitted, pose_blocks(*inliers.shape))))
    return fit, inliers & known & fit.ok[:, None]


def _shape_of(joint: ProcrustesFit, known: Mask) -> JointShape:
    """Return the joint shape, zero where it is unknown."""
    shape, covariance = np.nan_to_num(joint.shape), np.nan_to_num(joint.shape_covariance)
    return JointShape(shape, covariance, np.nan_to_num(joint.deformation), known)


def _fit_on_shape(
    shape: JointShape, status: FitStatus, y: Array, cov: Array, observed: Mask, start: RigidFit
) -> RigidFit:
    closed_form = umeyama(shape.shape, np.where(observed[..., None], y, 0.0), observed)
    fit = replace(closed_form, covariance=np.zeros((len(y), 6, 6)), scale_sigma=np.zeros(len(y)))
    ok = np.flatnonzero(closed_form.ok)
    if not ok.size:
        return fit
    R, t, converged = poses_on_shape(shape, y[ok], cov[ok], observed[ok], start.R[ok], start.t[ok])
    fit.R[ok], fit.t[ok], fit.scale[ok] = R, t, 1.0
    squared_residual = np.sum((y[ok] - shape.shape @ np.swapaxes(R, -1, -2) - t[:, None]) ** 2, axis=-1)
    fit.rms[ok] = np.sqrt(np.sum(squared_residual * observed[ok], axis=1) / observed[ok].sum(axis=1))
    status_of_pose = closed_form.status.astype(object)
    status_of_pose[ok] = np.where(converged, str(status), str(FitStatus.NOT_CONVERGED))
    return replace(fit, status=status_of_pose.astype(str)).masked()


def largest_motion(body: BodyEstimate, other: BodyEstimate, rows: Index) -> Array:
    """Return the largest difference (b,) in m between two fits at the targets seen in some poses; NaN without both."""
    points, observed = body.points.points[rows], body.points.is_observed[rows]
    fits = (estimate.common.fit.some(rows) for estimate in (body, other))
    positions = [np.einsum("bij,bti->btj", fit.R, points - fit.t[:, None]) for fit in fits]
    distance = np.linalg.norm(positions[0] - positions[1], axis=-1)
    return np.where(observed, distance, 0.0).max(axis=1)


def _robust(
    source: Array,
    cov_source: Array,
    points: Points,
    noise: PointNoise,
    usable: Mask,
    always_used: Mask,
    tau: Array | None = None,
) -> RobustBody:
    """Return the input of the robust fits; tau (T,), in m: own movement of each target, as further noise."""
    movement_cov = None if tau is None else (tau**2)[:, None, None] * np.eye(3)

    def noisy_points(rows: slice | NDArray) -> tuple[NDArray, NDArray]:
        cov = noise.cov(rows)
        return points.points[rows], cov if movement_cov is None else cov + movement_cov

    return RobustBody(source, cov_source, usable, np.broadcast_to(always_used, usable.shape), noisy_points)


def _slim(fit: RigidFit) -> RigidFit:
    """Return the fits without their covariances, which are computed again when they are needed."""
    return replace(fit, covariance=np.broadcast_to(np.zeros((1, 1, 1)), (len(fit.R), 6, 6)))


def _has_consensus(fit: RigidFit, agreed: Mask) -> Mask:
    return np.isin(fit.status, [str(FitStatus.OK), str(FitStatus.NO_CONSENSUS)]) & agreed.any(axis=1)


def _movement(fit: RigidFit, ratio: float, body: RobustBody, noise: PointNoise, usable: Mask) -> Array:
    """Return each target's own movement (T,), in m, if it flexes; without a survey this is not known beforehand. Zero
    if the whole body is less rigid than its noise allows, and for a target that moved far: then each pose is assessed
    separately."""
    sigma = _typical_sigma(noise, usable)
    lengths = (
        np.linalg.norm(body.points(rows)[0] - fit.some(rows).apply(body.source), axis=-1) for rows in body.blocks()
    )
    tau = scatter_of_lengths(np.concatenate(list(lengths)), noise.variance / 3, usable & fit.ok[:, None])
    return np.where((ratio == 1.0) & (tau > sigma) & (tau < _LARGEST_MOVEMENT * sigma), tau, 0.0)


def _typical_sigma(noise: PointNoise, mask: Mask) -> float:
    """Return the median standard deviation per coordinate of points, in m; 0 for none."""
    return float(np.sqrt(np.median(noise.variance[mask]) / 3)) if mask.any() else 0.0


def _reference(points: Points, survey: SurveyPoints) -> tuple[Array, Array]:
    """Return the survey (T, 3) with covariance (T, 3, 3) in the order of the observed targets; NaN if not surveyed."""
    survey_row = {target: k for k, target in enumerate(survey.targets)}
    rows = np.array([survey_row.get(target, -1) for target in points.targets], dtype=np.int64)
    known = rows >= 0
    source, cov = np.full((len(rows), 3), np.nan), np.zeros((len(rows), 3, 3))
    source[known], cov[known] = survey.points[rows[known]], survey.cov[rows[known]]
    return source, cov


def _in_frame(points: Points, survey: SurveyPoints) -> Mask:
    """Return the mask (T,) of targets that define the body frame; with a survey those of `SurveyPoints.frame`."""
    frame = dict(zip(survey.targets, survey.frame, strict=True))
    return np.array([frame.get(target, True) for target in points.targets], dtype=bool)


def _noise(source: Array, points: Points, usable: Mask) -> PointNoise:
    """Return the covariances of the points, estimated from distances between them if none was declared."""
    if not (~(points.variance > 0.0) & usable).any():
        return PointNoise(points, 1.0)
    rounding = _ROUNDING * float(np.abs(points.points).max(initial=1e-3))
    zero = np.zeros((1, 1))
    body = RobustBody(source, zero, usable, zero, lambda rows: (points.points[rows], zero))
    sigma = max(sigma_of_some_poses(body), rounding)
    return PointNoise(points, sigma**2)
