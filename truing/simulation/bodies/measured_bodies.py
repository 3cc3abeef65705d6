"""Measured bodies without a mechanism: their targets, displaced targets, poses, and places where they stand still."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from truing.arrays import Array, Index, Mask
from truing.estimation.labels.point_selection import PointSelection, select_points
from truing.estimation.rigid_poses.points import PointResiduals, PosePoints, with_declared_noise
from truing.estimation.rigid_poses.umeyama import umeyama
from truing.estimation.rotation import exp_so3, log_so3, rigid_motions
from truing.estimation.target_positions import (
    displaced_points,
    isolated_points,
    looseness,
    position_changes,
)
from truing.inference.observations import Epochs, Frames, Observations
from truing.simulation.bodies.causes.terms import place_columns
from truing.simulation.bodies.model import FIRST_BODY, BodyConditions
from truing.simulation.inputs import gravity_column
from truing.simulation.mechanisms.causes.targets import TargetMoved, TargetsSwapped, markers_of, swapped_targets
from truing.simulation.targets import FREE_LENGTH_M, Targets

FEWEST_TARGETS = 3
_FEWEST_POSES = 3
# Prior sigma of the position of an unsurveyed target, relative to the body's size: so wide that even the scale is open.
_FREE_SHAPE = 0.3
_FAR_LESS = 0.4
_ROUNDING_M = 1e-7  # least noise
# Least share of poses in which a body must be determined relative to another one.
_KNOWN_SHARE = 0.9
# Largest median step of a still body, in standard deviations of a point; jitter of an instrument is of that order. If
# every pose has its own frame, the body jumps by metres.
_STEP = 30.0
_FEWEST = 8
# Least number of steps between poses at the same place for an estimate of the jitter.
_ENOUGH_STEPS = 30
# Weight, in steps, of isotropic jitter as a prior: a covariance from few steps would fit these too well, and other
# effects would look significant.
_ALIKE = 100.0
_NORMAL = 1.4826  # standard deviation over median absolute deviation
_TAIL = 3.0  # standardised steps are clipped to this
_LEAST = 0.3  # least jitter, relative to the points' noise


@dataclass(frozen=True)
class BodyTargets:
    """One body over B poses and k targets, lengths in m.

    ``shape`` (k, 3) in the body's frame with covariance; points (B, k, 3) as measured, with covariance; seen (B, k)
    without gross errors; ``R``, ``t`` from the body to the measurement if ``ok`` (B,), else the identity. ``certain``
    holds causes that are evident before any search: exchanged labels, and targets that moved far.
    """

    name: str
    names: tuple[str, ...]
    shape: Array
    shape_cov: Array
    surveyed: bool
    points: Array
    cov: Array
    is_observed: Mask
    R: Array
    t: Array
    ok: Mask
    certain: tuple[TargetsSwapped | TargetMoved, ...] = ()

    @property
    def sigma(self) -> float:
        """Typical standard deviation of a coordinate, m."""
        return float(np.sqrt(np.median(np.trace(self.cov[self.is_observed], axis1=-2, axis2=-1)) / 3))


def measured_body(
    name: str,
    points: PosePoints,
    residuals: PointResiduals,
    shape: Array,
    shape_cov: Array | None,
    order: Array,
    noise: float,
) -> BodyTargets | None:
    """Fit the body's poses to its accepted targets, without gross errors; None if fewer than three poses are
    determined.

    shape (k, 3), m, with its covariance (k, 3, 3) if it was surveyed; order (B,) rank of the poses in time; noise of a
    coordinate, m, if points have none.
    """
    assessed = select_points(residuals, points, shape, order)
    right, trusted = _relabelled(points, residuals, assessed)
    fit = umeyama(shape, right, trusted.astype(float))
    if fit.ok.sum() < _FEWEST_POSES:
        return None
    R = np.where(fit.ok[:, None, None], fit.R, np.eye(3))
    t = np.where(fit.ok[:, None], fit.t, 0.0)
    gaps = (np.einsum("bji,bkj->bki", R, right - t[:, None]) - shape)[trusted & fit.ok[:, None]]
    cov = _found_smaller(with_declared_noise(points.cov, max(noise, _ROUNDING_M)), gaps, len(shape))
    if shape_cov is None:
        radius = float(np.sqrt(np.mean(np.sum((shape - shape.mean(0)) ** 2, -1))))
        sits = np.broadcast_to(np.eye(3) * max(FREE_LENGTH_M, _FREE_SHAPE * radius) ** 2, (len(shape), 3, 3))
    else:
        sits = with_declared_noise(shape_cov, max(noise, _ROUNDING_M))
    known = points.is_observed & fit.ok[:, None]
    positions = np.where(known[..., None], np.einsum("bji,bkj->bki", R, right - t[:, None]), 0.0)
    sigma = float(np.sqrt(np.median(np.trace(cov[known], axis1=-2, axis2=-1)) / 3))
    loose = _position_looseness(name, points.targets, shape, trusted)
    is_observed = assessed.kept & known & (trusted | ~isolated_points(positions, known, order, sigma, loose))
    changes = position_changes(positions, is_observed, order, sigma, loose)
    is_observed &= ~displaced_points(positions, is_observed, order, sigma, changes, loose)
    moved = evident_displacements(name, points, shape, order, changes)
    ok = fit.ok & (is_observed.sum(1) >= FEWEST_TARGETS)
    swapped = tuple(swapped_targets(name, points.targets, points.poses, order, assessed.exchanges))
    certain: tuple[TargetsSwapped | TargetMoved, ...] = (*swapped, *moved)
    is_surveyed = shape_cov is not None
    return BodyTargets(
        name, points.targets, shape, sits, is_surveyed, points.points, cov, is_observed, R, t, ok, certain
    )


def _position_looseness(body: str, targets: Sequence[str], shape: Array, trusted: Mask) -> Array:
    """Return the factor (B, k) of the uncertainty of each target's position relative to the rest of the body.

    It is one except for corners of markers, which move together: only the rest of the body determines their position.
    """
    loose = np.ones(trusted.shape)
    corners = [k for corner in markers_of([body] * len(targets), targets).values() for k in corner]
    loose[:, corners] = looseness(shape, trusted)[:, corners]
    return loose


def evident_displacements(
    body: str, points: PosePoints, shape: Array, order: Array, changes: list[tuple[int, int]]
) -> tuple[TargetMoved, ...]:
    """Return the evident displacements from a pose on: of a marker if all its corners moved, otherwise of single
    targets."""
    at = set(changes)
    markers = markers_of([body] * len(points.targets), points.targets)
    found = []
    for (_, name), corners in markers.items():
        for pose in sorted({b for b, k in changes if k == corners[0]}):
            if all((pose, k) in at for k in corners):
                at -= {(pose, k) for k in corners}
                displaced = TargetMoved(body, name, points.poses[pose], float(order[pose]))
                found.append(displaced.of_corners([points.targets[k] for k in corners], shape[list(corners)]))
    single = [
        TargetMoved(body, points.targets[k], points.poses[b], float(order[b])) for b, k in changes if (b, k) in at
    ]
    return (*found, *single)


def _relabelled(points: PosePoints, residuals: PointResiduals, assessed: PointSelection) -> tuple[Array, Mask]:
    """Return points (B, k, 3) under their true labels, and the mask (B, k) of those that determine the pose."""
    right = points.points.copy()
    trusted = points.is_observed & residuals.fitted
    for exchange in assessed.exchanges:
        right[exchange.pose, [exchange.first, exchange.second]] = points.points[
            exchange.pose, [exchange.second, exchange.first]
        ]
        few = trusted[exchange.pose].sum() < FEWEST_TARGETS
        trusted[exchange.pose] |= points.is_observed[exchange.pose] if few else False
    return right, trusted


def _found_smaller(cov: Array, gaps: Array, targets: int) -> Array:
    """Scale covariances (B, k, 3, 3) to the observed scatter of the points, if that is far smaller than declared.

    A declared limit of rigidity instead of the noise would hide all smaller effects.
    """
    free = 3 * targets / max(3 * targets - 6, 1)
    scatter = float(np.median(np.linalg.norm(gaps, axis=-1))) / 1.538 * np.sqrt(free) if len(gaps) else np.inf
    declared = float(np.sqrt(np.median(np.trace(cov, axis1=-2, axis2=-1)) / 3))
    return cov * (max(scatter, _ROUNDING_M) / declared) ** 2 if scatter < _FAR_LESS * declared else cov


@dataclass(frozen=True)
class BodyPlaces:
    """Places where a body stands still: their number, the place of each pose (B,), and a root of its jitter (6, 6).

    No places for a body that need not stand still. ``R``, ``t`` (B, ..) are start values of its pose, m.
    """

    levels: int
    level: Index
    jitter: Array
    R: Array
    t: Array


@dataclass(frozen=True)
class MeasuredBodies:
    """Bodies with their places, and the index of the body whose frame the model uses.

    The index is -1 if the measurement has one frame for the campaign.
    """

    bodies: list[BodyTargets]
    body_places: list[BodyPlaces]
    lead: int

    @classmethod
    def relative_to_reference(
        cls, bodies: list[BodyTargets], places: list[BodyPlaces], reference: str | None
    ) -> MeasuredBodies:
        """Return bodies led by the reference, otherwise by the body with most determined poses; by none if a body
        stands still."""
        names = [body.name for body in bodies]
        lead = names.index(reference) if reference in names else int(np.argmax([body.ok.sum() for body in bodies]))
        return cls(bodies, places, -1 if any(body_places.levels for body_places in places) else lead)

    @property
    def targets(self) -> Targets:
        """All targets, one body after the other."""
        counts = [len(body.names) for body in self.bodies]
        return Targets(
            np.repeat(np.arange(len(self.bodies)) + FIRST_BODY, counts),
            np.full(sum(counts), -1),
            tuple(name for body in self.bodies for name in body.names),
            tuple(body.name for body in self.bodies for _ in body.names),
        )

    def places(self, order: Array) -> dict[str, Array]:
        """Return the positions (B,) of other bodies relative to the leading one, m, as inputs of deformations.

        Positions are interpolated linearly between determined poses; a body with few such poses is omitted. ``order``
        (B,) is the rank in time.
        """
        columns: dict[str, Array] = {}
        for body in self.bodies if self.lead >= 0 else []:
            lead = self.bodies[self.lead]
            known = body.ok & lead.ok
            if body is lead or known.mean() < _KNOWN_SHARE:
                continue
            centre = body.t + body.R @ body.shape.mean(0) - lead.t
            seen = np.einsum("bji,bj->bi", lead.R, centre)
            rows = np.flatnonzero(known)[np.argsort(order[known], kind="stable")]
            for axis, name in enumerate(place_columns(body.name)):
                columns[name] = np.interp(order, order[rows], seen[rows, axis])
        return columns

    def gravity(self, up: Sequence[float], reference: str | None) -> dict[str, Array]:
        """Return the direction of gravity (B, 3) in each body's frame, by its column.

        ``up`` is given in the frame of the reference, or of the measurement without a reference. Empty if the reference
        was not measured. The mean direction replaces that of poses where a body is not determined.
        """
        names = [body.name for body in self.bodies]
        down = -np.asarray(up, float) / np.linalg.norm(up)
        is_observed = np.ones(len(self.bodies[0].ok), bool)
        if reference is not None:
            if reference not in names:
                return {}
            is_observed = self.bodies[names.index(reference)].ok
            down = self.body_places[names.index(reference)].R @ down
        columns = {}
        for body in self.bodies:
            known = is_observed & body.ok
            direction = np.einsum("bji,bj->bi", body.R, np.broadcast_to(down, (len(is_observed), 3)))
            columns[gravity_column(body.name)] = (
                np.where(known[:, None], direction, direction[known].mean(0)) if known.any() else 0 * direction
            )
        return columns

    def conditions(self, covariates: Mapping[str, Array], poses: tuple[int | str, ...]) -> BodyConditions:
        """Return the pose of each body in the model's frame: that of the leading body, otherwise as measured."""
        R, t = (
            np.stack([body_place.R for body_place in self.body_places], 1),
            np.stack([body_place.t for body_place in self.body_places], 1),
        )
        if self.lead >= 0:
            back = np.swapaxes(R[:, self.lead], 1, 2)[:, None]
            t = (back @ (t - t[:, [self.lead]])[..., None])[..., 0]
            R = back @ R
        time = covariates.get("time_s")
        known = time is not None and bool(np.isfinite(time).all())
        span = (float(np.min(time)), float(np.max(time))) if time is not None and known else None
        level = np.stack([body_place.level for body_place in self.body_places], 1)
        return BodyConditions(np.zeros((len(poses), 0)), dict(covariates), poses, span, R, t, level)

    def epochs(self, conditions: BodyConditions, rows: Mask) -> Epochs:
        """Return the measurements at some poses (mask B)."""
        measured = Observations(
            np.concatenate([body.points[rows] for body in self.bodies], 1),
            np.concatenate([body.cov[rows] for body in self.bodies], 1),
            np.concatenate([body.is_observed[rows] & body.ok[rows, None] for body in self.bodies], 1),
        )
        count = int(rows.sum())
        frames = Frames(np.tile(np.eye(3), (count, 1, 1)), np.zeros((count, 3)), free=False)
        if self.lead >= 0:
            lead = self.bodies[self.lead]
            frames = Frames(lead.R[rows], lead.t[rows])
        return Epochs(measured, conditions.subset(rows), frames)


def frame_is_common(body: BodyTargets, order: Array) -> bool:
    """True if a body hardly moves from one pose to the next, so that the measurement has one frame for the campaign."""
    in_time = np.argsort(order, kind="stable")
    points, is_observed = body.points[in_time], (body.is_observed & body.ok[:, None])[in_time]
    both = is_observed[1:] & is_observed[:-1]
    if both.sum() < _FEWEST:
        return False
    steps = np.linalg.norm(np.diff(points, axis=0), axis=-1)[both]
    return bool(np.median(steps) < _STEP * body.sigma)


def free_body(body: BodyTargets) -> BodyPlaces:
    """Return a body without places: it need not stand still."""
    return BodyPlaces(0, np.zeros(len(body.ok), np.int64), np.eye(6), body.R, body.t)


def fixed_body(body: BodyTargets, level: Index, order: Array) -> BodyPlaces:
    """Return a body with places: at each, it stands at the median of the poses there; level (B,) is the place of
    each pose."""
    R, t, middle = body.R.copy(), body.t.copy(), body.shape.mean(0)
    centre = body.t + body.R @ middle
    for index in range(level.max() + 1):
        at_level = level == index
        known = at_level & body.ok
        if known.any():
            first = body.R[known][0]
            R[at_level] = exp_so3(np.median(log_so3(body.R[known] @ first.T), axis=0)) @ first
            t[at_level] = np.median(centre[known], axis=0) - R[at_level] @ middle
    return BodyPlaces(int(level.max()) + 1, level, _jitter(body, level, order), R, t)


def _jitter(body: BodyTargets, level: Index, order: Array) -> Array:
    """Return a square root (6, 6) of the covariance of a body's pose jitter, without the noise of its targets; robust.

    Shift of the targets' centroid (m), then rotation vector (rad), in the axes of the measurement.
    """
    steps = _steps(body, level, order)
    if len(steps) < _ENOUGH_STEPS:
        return _root(np.zeros((6, 6)), body)
    scale = _NORMAL * np.median(np.abs(steps), axis=0)
    clipped = np.clip(steps / np.maximum(scale, 1e-12), -_TAIL, _TAIL)
    covariance = np.corrcoef(clipped, rowvar=False) * np.outer(scale, scale)
    alike = np.diag(np.repeat([np.mean(scale[:3] ** 2), np.mean(scale[3:] ** 2)], 3))
    share = len(steps) / (len(steps) + _ALIKE)
    return _root(share * covariance + (1.0 - share) * alike - _noise_covariance(body), body)


def _steps(body: BodyTargets, level: Index, order: Array) -> Array:
    """Return the steps (n, 6) between successive poses at the same place, divided by the root of two."""
    centre, found = body.t + body.R @ body.shape.mean(0), []
    in_time = np.argsort(order, kind="stable")
    for index in range(level.max() + 1):
        rows = in_time[(body.ok & (level == index))[in_time]]
        turned = log_so3(body.R[rows][1:] @ np.swapaxes(body.R[rows][:-1], 1, 2))
        found.append(np.concatenate([np.diff(centre[rows], axis=0), turned], 1))
    return np.concatenate(found) / np.sqrt(2.0)


def _noise_covariance(body: BodyTargets) -> Array:
    """Return the covariance (6, 6) of a pose due to the points' noise."""
    arms = (body.shape - body.shape.mean(0)) @ body.R[np.flatnonzero(body.ok)[0]].T
    design = rigid_motions(arms).reshape(-1, 6)
    return np.asarray(np.linalg.pinv(design.T @ design / body.sigma**2))


def _root(covariance: Array, body: BodyTargets) -> Array:
    """Return a square root of the positive part of a covariance, at least a small share of the points' noise.

    It is lower triangular: the first three unknowns are the shift with the correlated rotation, the others the
    remaining rotation.
    """
    radius = max(float(np.sqrt(np.mean(np.sum((body.shape - body.shape.mean(0)) ** 2, -1)))), 1e-6)
    unit = np.array([body.sigma] * 3 + [body.sigma / radius] * 3)
    values, vectors = np.linalg.eigh(covariance / np.outer(unit, unit))
    positive = (vectors * np.maximum(values, _LEAST**2)) @ vectors.T
    return np.asarray(unit[:, None] * np.linalg.cholesky(positive))
