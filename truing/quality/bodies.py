"""Bodies for the quality checks: points over time, a first robust fit, and its residuals."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from truing.arrays import Array, Mask
from truing.estimation.quality import Scatter
from truing.estimation.response import consistent_responses
from truing.estimation.rigid_poses.points import PosePoints, SurveyPoints
from truing.estimation.rigid_poses.procrustes import common_shape
from truing.estimation.rigid_poses.rigid import RigidFit
from truing.estimation.rigid_poses.robust import consensus
from truing.estimation.rigid_poses.umeyama import umeyama

_LEAST_TARGETS = 3
_POSES_TO_COMPARE = 2
_ODD_POSE = 1e-6
# Shares of a body's points.
MOST_GROSS = 0.5
_FEW_GROSS = 0.1
_LEAST_GROSS = 0.02  # from here a scale is tried: fewer gross errors need no other explanation
_HALF = 0.5
_FEWEST_SCALES = 3  # poses whose agreement determines a scale
_CLEARLY = 6.0  # standard deviations
_SIGMA_OF_MAD = 1.4826  # standard deviation over the median absolute deviation, for noise
_LEAST_FACTOR = 10.0  # of noise: effects that nobody modelled scatter points by less
_MOST_SCALE = 0.02  # of one: a larger factor is another unit or another body
_OWN_SCATTER = 0.5  # least share of the residuals that scatters from pose to pose, if noise explains them
_OF_MEDIAN = np.pi / 2.0  # variance of a median, over that of a mean
_LONG_TAILS = 4.0  # mean over median of squared distances, 1.27 for noise
_MEDIAN_OF_THREE = 2.366  # median of chi-square with three degrees of freedom


@dataclass(frozen=True)
class PoseSurroundings:
    """Poses in the order of time, with quantities that may drive the bodies.

    poses (B ids); time (B,) in s; settings (B, D) actuator or drive readings in the units of the table, without
    constant columns; temperature (B,) in degrees C or None; names of the settings. unobserved: poses of the
    configurations without any point; shared: points come from networks of rays and have common errors; is_counted:
    times merely number the poses.
    """

    poses: tuple[int | str, ...]
    time: Array
    settings: Array
    names: tuple[str, ...]
    temperature: Array | None
    unobserved: tuple[int | str, ...] = ()
    shared: bool = False
    is_counted: bool = False

    @property
    def covariates(self) -> Array:
        """Settings, temperature and time (B, C), each scaled to unit spread; at most a third as many as poses."""
        columns = [*self.settings.T, *(() if self.temperature is None else (self.temperature,)), self.time]
        spread = [(c - np.nanmean(c)) / np.nanstd(c) for c in columns if np.nanstd(c) > 0.0]
        kept = spread[: max(0, len(self.poses) // 3)]
        return np.nan_to_num(np.column_stack(kept)) if kept else np.zeros((len(self.poses), 0))


@dataclass(frozen=True)
class BodyView:
    """One body: its survey (or first shape), its points, the robust fit of its frame, and the residuals in that frame.

    residuals (B, T, 3) in m, zero where not seen; sigma (B, T, 3) declared, of measurement and survey together; frame
    (T,) marks the targets of the frame; gross (B, T) seen, but far from its place. is_surveyed: places come from a
    survey, not from one of the poses. By the declared noise and the survey alone most points may be gross errors; then
    the checks take the noise times noise_factor, or the survey times survey_scale.
    """

    name: str
    survey: SurveyPoints
    points: PosePoints
    fit: RigidFit
    residuals: Array
    sigma: Array
    frame: Mask
    gross: Mask
    is_surveyed: bool = True
    noise_factor: float = 1.0
    survey_scale: float = 1.0

    @property
    def measured_sigma(self) -> Array:
        """Standard deviation (B, T, 3) of the measurement alone, in m: the declared one times the noise factor."""
        return np.sqrt(np.einsum("btii->bti", self.points.cov))

    @property
    def gross_share(self) -> float:
        """Share of gross errors among the points of the poses with enough targets."""
        return float(self.gross[self.framed].sum()) / max(int(self.points.is_observed[self.framed].sum()), 1)

    @property
    def framed(self) -> Mask:
        """True for poses (B,) in which enough targets of the frame were seen to determine the body's pose."""
        return np.asarray((self.points.is_observed & self.frame).sum(axis=1) >= _LEAST_TARGETS)

    @property
    def why_no_positions(self) -> str:
        """Reason why the places of targets cannot be tested; empty where they can."""
        if not self.framed.any():
            return f"{self.name}: no pose shows three targets, and fewer give no frame"
        if not self.is_surveyed and self.framed.sum() < _POSES_TO_COMPARE:
            return f"{self.name}: one pose without a survey has nothing to be compared with"
        return ""

    @property
    def good(self) -> Mask:
        """True for points (B, T) that were seen, are in their place, and belong to a pose with a valid fit."""
        return self.points.is_observed & ~self.gross & self.fit.ok[:, None]


def shape_of_poses(points: PosePoints) -> SurveyPoints:
    """Return the shape that most poses agree on, as a substitute for a survey, with its covariance.

    Where no poses agree it is the pose that shows most targets: then it is unknown which pose is right.
    """
    variance = np.einsum("btii->bt", points.cov) / 3.0
    sigma = float(np.sqrt(np.median(variance[points.is_observed]))) if points.is_observed.any() else 0.0
    shape = common_shape(points.points, points.is_observed, sigma)
    known = np.isfinite(shape).all(axis=-1)
    if known.sum() < _LEAST_TARGETS:
        richest = int(points.is_observed.sum(axis=1).argmax())
        known, shape = points.is_observed[richest], points.points[richest]
        cov = points.cov[richest]
    else:
        often = points.is_observed.sum(axis=0)
        mean = np.where(points.is_observed, variance, 0.0).sum(axis=0) / np.maximum(often, 1)
        cov = (mean * np.minimum(_OF_MEDIAN / np.maximum(often, 1), 1.0))[:, None, None] * np.eye(3)
    names = tuple(name for name, seen in zip(points.targets, known, strict=True) if seen)
    return SurveyPoints(names, shape[known], cov[known], np.zeros(len(names), np.int64))


def _gross_attachments(residuals: Array, sigma: Array, is_observed: Mask, covariates: Array) -> Mask:
    """Return gross errors of attachments, which may follow the actuators: points far from their own regression on
    these."""
    gross = np.zeros(is_observed.shape, bool)
    for target in np.nonzero(is_observed.any(axis=0))[0]:
        rows = is_observed[:, target]
        if rows.sum() < covariates.shape[1] + 4:
            continue
        cov = sigma[rows, target][:, :, None] ** 2 * np.eye(3)
        kept = consistent_responses(covariates[rows], residuals[rows, target], 9.0 * cov)
        gross[rows, target] = ~kept.all(axis=1)
    return gross


def body_view(
    body: str, survey: SurveyPoints, points: PosePoints, around: PoseSurroundings, *, is_surveyed: bool
) -> BodyView:
    """Return a body fitted robustly pose by pose to its survey, or to its first shape."""
    frame = survey.leg == 0
    if frame.sum() < 3:
        frame = np.ones_like(frame)
    sigma = np.sqrt(np.einsum("btii->bti", points.cov) + np.einsum("tii->ti", survey.cov)[None])
    usable = points.is_observed & frame
    mean_sigma = np.where(points.is_observed, np.sqrt((sigma**2).mean(axis=2)), 1.0)
    source = np.broadcast_to(survey.points, points.points.shape)
    inlier, _ = consensus(source, points.points, usable, mean_sigma)
    fit = umeyama(source, points.points, (usable & inlier) / mean_sigma**2, sigma=mean_sigma)
    residuals = np.where((points.is_observed & fit.ok[:, None])[..., None], fit.residuals(source, points.points), 0.0)
    gross = usable & ~inlier
    gross |= _gross_attachments(residuals, sigma, points.is_observed & ~frame & fit.ok[:, None], around.covariates)
    return BodyView(body, survey, points, fit, np.nan_to_num(residuals), sigma, frame, gross, is_surveyed)


def with_most_points(body: BodyView, around: PoseSurroundings) -> BodyView:
    """Return the body with its survey in another scale, or else with more noise, if that makes most points fit.

    Most points have to be gross errors without the change, and hardly any with it; else the body stays as it is. A
    scale that all poses agree on needs fewer of them: it must leave less than half.
    """
    if body.is_surveyed and body.gross_share > _LEAST_GROSS:
        scaled = _with_fitting_scale(body, around)
        if scaled is not body and scaled.gross_share < _HALF * body.gross_share and _agree_on_scale(body):
            return scaled
    if body.gross_share <= MOST_GROSS:
        return body
    for change in (_with_fitting_scale, _with_fitting_noise):
        changed = change(body, around)
        is_noise = changed.noise_factor == 1.0 or (changed.noise_factor >= _LEAST_FACTOR and _scatters_alike(changed))
        if changed.gross_share <= _FEW_GROSS and is_noise:
            return changed
    return body


def _scales_of_poses(body: BodyView) -> Array:
    """Return the scale of the measured points over the survey in each pose that shows it."""
    is_observed = body.points.is_observed & body.frame & body.framed[:, None]
    source = np.broadcast_to(body.survey.points, body.points.points.shape)
    fitted = umeyama(source, body.points.points, is_observed.astype(float), with_scale=True).scale
    return np.asarray(fitted[np.isfinite(fitted)])


def _agree_on_scale(body: BodyView) -> bool:
    """Return True if the scales of the poses differ from one by more than their median can by chance."""
    scales = _scales_of_poses(body)
    if len(scales) < _FEWEST_SCALES:
        return False
    middle = float(np.median(scales))
    spread = _SIGMA_OF_MAD * float(np.median(np.abs(scales - middle)))
    return abs(middle - 1.0) > _CLEARLY * spread * np.sqrt(_OF_MEDIAN / len(scales))


def _with_fitting_scale(body: BodyView, around: PoseSurroundings) -> BodyView:
    """Return the body with its survey in the scale of the measured points; units are no scale of this kind."""
    known = _scales_of_poses(body)
    scale = float(np.median(known)) if len(known) else np.inf
    if not abs(scale - 1.0) <= _MOST_SCALE:
        return body
    survey = replace(body.survey, points=scale * body.survey.points)
    view = body_view(body.name, survey, body.points, around, is_surveyed=body.is_surveyed)
    return replace(view, survey_scale=scale)


def _with_fitting_noise(body: BodyView, around: PoseSurroundings) -> BodyView:
    """Return the body fitted with a multiple of the declared noise.

    Only scatter from pose to pose counts: a wrong survey shifts a target equally in all poses. The first factor still
    contains gross errors; the second comes from the points that agree.
    """
    first = _fitted_with(body, _scatter_over_declared(body), around)
    return _fitted_with(first, first.noise_factor * _scatter_of_good(first), around)


def _fitted_with(body: BodyView, factor: float, around: PoseSurroundings) -> BodyView:
    """Return the body fitted with a multiple of the declared noise; as it is for factors up to one."""
    if not factor > 1.0:
        return body
    scale = (factor / body.noise_factor) ** 2
    points, known = (
        replace(body.points, cov=scale * body.points.cov),
        replace(body.survey, cov=scale * body.survey.cov),
    )
    view = body_view(body.name, known, points, around, is_surveyed=body.is_surveyed)
    return replace(view, noise_factor=factor)


def _scatter_of_good(body: BodyView) -> float:
    """Return the scatter of the good points of the frame over the noise of the fit; 0 if nothing is left over."""
    is_used = body.good & body.frame
    freedom = 3 * int(is_used.sum()) - 6 * int(is_used.any(axis=1).sum())
    square = float(np.sum((body.residuals[is_used] / body.sigma[is_used]) ** 2))
    return float(np.sqrt(square / freedom)) if freedom > 0 else 0.0


def _scatters_alike(body: BodyView) -> bool:
    """Return True if the good points scatter like noise of one size: targets that moved have far longer tails."""
    is_used = body.good & body.frame
    square = np.sum((body.residuals[is_used] / body.sigma[is_used]) ** 2, axis=1)
    return bool(square.size) and float(np.mean(square)) <= _LONG_TAILS * float(np.median(square))


def _scatter_over_declared(body: BodyView) -> float:
    """Return the scatter of all points about the mean of each target, over the declared noise.

    It is 0 if the means differ from the places by more than that scatter, or if there is nothing to average.
    """
    is_observed, source = body.points.is_observed & body.frame & body.framed[:, None], body.survey.points
    mean_sigma = np.where(is_observed, np.sqrt((body.sigma**2).mean(axis=2)), 1.0)
    fit = umeyama(np.broadcast_to(source, body.points.points.shape), body.points.points, is_observed / mean_sigma**2)
    used = is_observed & fit.ok[:, None]
    often = used.sum(axis=0)
    used &= often >= _LEAST_TARGETS
    if not used.any():
        return 0.0
    residuals = np.where(used[..., None], fit.residuals(source, body.points.points), 0.0)
    mean = residuals.sum(axis=0) / np.maximum(often, 1)[:, None]
    freedom = 1.0 - 1.0 / often[np.nonzero(used)[1]]
    about = (((residuals - mean)[used] / body.measured_sigma[used]) ** 2).sum(axis=1) / freedom
    sum_of_squares = ((residuals[used] / body.sigma[used]) ** 2).sum(axis=1)
    scatter, size = (float(np.sqrt(np.median(square) / _MEDIAN_OF_THREE)) for square in (about, sum_of_squares))
    return scatter if scatter > _OWN_SCATTER * size else 0.0


@dataclass(frozen=True)
class RepeatedPositions:
    """Positions measured repeatedly: name, positions (B, 3) with covariances (B, 3, 3) in m, and known (B,)."""

    name: str
    position: Array
    cov: Array
    known: Mask


def repeated_positions(bodies: Sequence[BodyView], *, is_instrument_fixed: bool) -> Iterator[RepeatedPositions]:
    """Return bodies relative to the first one, and each target of bodies with too few targets for a pose.

    Where no body has a pose, or the instrument did not move, positions are relative to the instrument: single
    reflectors have no meaning in a frame that changes from pose to pose.
    """
    reference = bodies[0] if len(bodies[0].survey.targets) >= _LEAST_TARGETS and not is_instrument_fixed else None
    for body in bodies:
        if body is reference or body.name.startswith("leg"):
            continue
        if len(body.survey.targets) < _LEAST_TARGETS:
            yield from _reflectors(reference, body)
        elif reference is not None:
            position, cov = _points_in_frame(reference, body.fit.t, _measured_cov(body)[:, :3, :3])
            yield RepeatedPositions(body.name, position, cov, reference.fit.ok & body.fit.ok)
        elif is_instrument_fixed:
            cov = np.nan_to_num(_measured_cov(body)[:, :3, :3])
            yield RepeatedPositions(body.name, np.nan_to_num(body.fit.t), cov, body.fit.ok)


def _reflectors(reference: BodyView | None, body: BodyView) -> Iterator[RepeatedPositions]:
    for k, target in enumerate(body.survey.targets):
        points, cov, known = body.points.points[:, k], body.points.cov[:, k], body.points.is_observed[:, k]
        if reference is not None:
            points, cov = _points_in_frame(reference, points, cov)
            known = known & reference.fit.ok
        yield RepeatedPositions(f"{body.name} {target}", points, cov, known)


def _measured_cov(body: BodyView) -> Array:
    """Return the covariances (B, 6, 6) of a body's poses by the measurement alone: errors of the survey do
    not change."""
    used = body.good & body.frame
    measured, both = (
        np.where(used[..., None], sigma**2, 0.0).sum(axis=(1, 2)) for sigma in (body.measured_sigma, body.sigma)
    )
    share = np.divide(measured, both, out=np.ones_like(both), where=both > 0.0)
    return np.asarray(body.fit.covariance * share[:, None, None])


def _points_in_frame(reference: BodyView, points: Array, cov: Array) -> tuple[Array, Array]:
    """Return points (B, 3) with covariances (B, 3, 3) in the frame of a body, with its own covariance to
    first order."""
    turn = np.swapaxes(np.nan_to_num(reference.fit.R), 1, 2)
    offset = np.nan_to_num(points - reference.fit.t)
    arm = np.cross(np.eye(3)[None], offset[:, None])
    jacobian = np.concatenate([-np.broadcast_to(np.eye(3), arm.shape), arm], axis=2)
    cov = np.nan_to_num(cov)
    cov = cov + np.einsum("bij,bjk,blk->bil", jacobian, np.nan_to_num(_measured_cov(reference)), jacobian)
    return np.einsum("bij,bj->bi", turn, offset), np.einsum("bij,bjk,blk->bil", turn, cov, turn)


def chi_square_about_mean(values: Array, cov: Array) -> float:
    """Return the chi-square of a group's values (G, 3) about their weighted mean."""
    weight = np.linalg.inv(cov)
    mean = np.linalg.solve(weight.sum(axis=0), np.einsum("gij,gj->i", weight, values))
    return float(np.einsum("gi,gij,gj->", values - mean, weight, values - mean))


def scatter_by_pose(body: BodyView) -> Scatter:
    """Return the median chi-square of each pose's residuals, in units of the body's ordinary scatter."""
    is_used = body.good & body.frame
    dof = np.maximum(3.0 * is_used.sum(axis=1) - 6.0, 0.0)
    square = np.where(is_used[..., None], (body.residuals / body.sigma) ** 2, 0.0).sum(axis=(1, 2))
    assessed = dof > 0.0
    level = max(1.0, float(np.median(square[assessed] / dof[assessed]))) if assessed.any() else 1.0
    return Scatter(np.where(assessed, square / level, 0.0), dof)


def odd_poses(scatter: Scatter) -> Mask:
    """Return poses as noisy as chance makes one in a million; mostly a gross error that few neighbours could reveal."""
    return (scatter.p_above(1.0) < _ODD_POSE) & (np.nan_to_num(scatter.ratio) > 1.5)


def is_trend(values: Array, sigma: Array, kept: Mask, time: Array, onset: int) -> bool:
    """Return True if a straight line in time explains the values (B, 3) better than a step at ``onset``."""
    left = []
    for shape in ((np.arange(len(time)) >= onset).astype(float), time):
        design = np.column_stack([np.ones(int(kept.sum())), shape[kept]])
        fitted = design @ np.linalg.lstsq(design, values[kept], rcond=None)[0]
        left.append((((values[kept] - fitted) / sigma[kept]) ** 2).sum())
    return bool(left[1] < left[0])


def nearest_neighbour(points: Array) -> Array:
    """Return the distance of each of points (N, 3) to the nearest other one (N,)."""
    distance = np.linalg.norm(points[:, None] - points[None], axis=2)
    np.fill_diagonal(distance, np.inf)
    return distance.min(axis=1)
