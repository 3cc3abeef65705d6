"""Bodies without a mechanism as they were measured: where their targets sit, which were moved, how they stand."""

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
    changes_of_place,
    lonely_places,
    looseness,
    stray_places,
)
from truing.inference.observations import Epochs, Frames, Observations
from truing.simulation.bodies.causes.terms import place_columns
from truing.simulation.bodies.model import FIRST_BODY, BodyConditions
from truing.simulation.inputs import gravity_column
from truing.simulation.mechanisms.causes.targets import TargetMoved, TargetsSwapped, markers_of, swapped_targets
from truing.simulation.targets import FREE_LENGTH_M, Targets

FEWEST_TARGETS = 3
_FEWEST_POSES = 3
# Where a target sits that was not surveyed is open by this share of the body's size: so wide that not even the body's
# scale is taken to be known.
_FREE_SHAPE = 0.3
_FAR_LESS = 0.4
_ROUNDING_M = 1e-7  # no noise is smaller
# Where a body is seen from another one, most poses have to tell it.
_KNOWN_SHARE = 0.9
# From one pose to the next, half of the time, a body that stands still moves by less than so many standard deviations
# of a point: an instrument's own jitter is of that order. A frame of its own in every pose makes it jump by metres.
_STEP = 30.0
_FEWEST = 8
# So many steps between poses at the same place tell how much a body jitters, whatever else happens to it.
_ENOUGH_STEPS = 30
# Jitter is taken to be alike in all directions as surely as so many steps would show it: a covariance from few steps
# fits them too well, and everything else looks significant.
_ALIKE = 100.0
_NORMAL = 1.4826  # standard deviation over median absolute deviation
_TAIL = 3.0  # standardised steps count no more than this
_LEAST = 0.3  # of the points' noise: a smaller jitter is of no account


@dataclass(frozen=True)
class BodyTargets:
    """One body over B poses and k targets, lengths in m.

    ``shape`` (k, 3) in the body's frame with covariance; points (B, k, 3) as measured, with covariance, seen (B, k),
    gross errors apart; ``R``, ``t`` from the body to the measurement where ``ok`` (B,), else the identity. ``certain``
    is what leaves no doubt before any search: labels that were exchanged, targets that were moved far.
    """

    name: str
    names: tuple[str, ...]
    shape: Array
    shape_cov: Array
    surveyed: bool
    points: Array
    cov: Array
    seen: Mask
    R: Array
    t: Array
    ok: Mask
    certain: tuple[TargetsSwapped | TargetMoved, ...] = ()

    @property
    def sigma(self) -> float:
        """Return the typical standard deviation of a coordinate, m."""
        return float(np.sqrt(np.median(np.trace(self.cov[self.seen], axis1=-2, axis2=-1)) / 3))


def measured_body(
    name: str,
    points: PosePoints,
    residuals: PointResiduals,
    shape: Array,
    shape_cov: Array | None,
    order: Array,
    noise: float,
) -> BodyTargets | None:
    """The body where its targets that were not rejected put it, gross errors apart; None where that is in no poses.

    shape (k, 3), m, with its covariance (k, 3, 3) where it was surveyed; order (B,) rank of the poses in time; noise of
    a coordinate, m, where points carry none.
    """
    assessed = select_points(residuals, points, shape, order)
    right, trusted = _put_right(points, residuals, assessed)
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
    known = points.seen & fit.ok[:, None]
    places = np.where(known[..., None], np.einsum("bji,bkj->bki", R, right - t[:, None]), 0.0)
    sigma = float(np.sqrt(np.median(np.trace(cov[known], axis1=-2, axis2=-1)) / 3))
    loose = _loose_corners(name, points.targets, shape, trusted)
    seen = assessed.kept & known & (trusted | ~lonely_places(places, known, order, sigma, loose))
    changes = changes_of_place(places, seen, order, sigma, loose)
    seen &= ~stray_places(places, seen, order, sigma, changes, loose)
    moved = moved_for_certain(name, points, shape, order, changes)
    ok = fit.ok & (seen.sum(1) >= FEWEST_TARGETS)
    swapped = tuple(swapped_targets(name, points.targets, points.poses, order, assessed.exchanges))
    certain: tuple[TargetsSwapped | TargetMoved, ...] = (*swapped, *moved)
    is_surveyed = shape_cov is not None
    return BodyTargets(name, points.targets, shape, sits, is_surveyed, points.points, cov, seen, R, t, ok, certain)


def _loose_corners(body: str, targets: Sequence[str], shape: Array, trusted: Mask) -> Array:
    """Return how many times less surely places (B, k) are known: of a marker's corners, which leave a body together,
    what the rest of it tells; targets by themselves leave the rest as sure as it was."""
    loose = np.ones(trusted.shape)
    corners = [k for own in markers_of([body] * len(targets), targets).values() for k in own]
    loose[:, corners] = looseness(shape, trusted)[:, corners]
    return loose


def moved_for_certain(
    body: str, points: PosePoints, shape: Array, order: Array, changes: list[tuple[int, int]]
) -> tuple[TargetMoved, ...]:
    """Return what certainly sits elsewhere from a pose on: a marker where all its corners do, else single targets."""
    at = set(changes)
    markers = markers_of([body] * len(points.targets), points.targets)
    found = []
    for (_, name), corners in markers.items():
        for pose in sorted({b for b, k in changes if k == corners[0]}):
            if all((pose, k) in at for k in corners):
                at -= {(pose, k) for k in corners}
                one = TargetMoved(body, name, points.poses[pose], float(order[pose]))
                found.append(one.of_corners([points.targets[k] for k in corners], shape[list(corners)]))
    single = [
        TargetMoved(body, points.targets[k], points.poses[b], float(order[b])) for b, k in changes if (b, k) in at
    ]
    return (*found, *single)


def _put_right(points: PosePoints, residuals: PointResiduals, assessed: PointSelection) -> tuple[Array, Mask]:
    """Points (B, k, 3) under their right labels, and which of them (B, k) tell where the body is."""
    right = points.points.copy()
    trusted = points.seen & residuals.fitted
    for one in assessed.exchanges:
        right[one.pose, [one.first, one.second]] = points.points[one.pose, [one.second, one.first]]
        few = trusted[one.pose].sum() < FEWEST_TARGETS
        trusted[one.pose] |= points.seen[one.pose] if few else False
    return right, trusted


def _found_smaller(cov: Array, gaps: Array, targets: int) -> Array:
    """Covariances (B, k, 3, 3), brought to how far points miss their places by where that is far less than declared.

    Who declares what "rigid" is to mean, and not the noise, would hide what goes on below it.
    """
    free = 3 * targets / max(3 * targets - 6, 1)
    scatter = float(np.median(np.linalg.norm(gaps, axis=-1))) / 1.538 * np.sqrt(free) if len(gaps) else np.inf
    declared = float(np.sqrt(np.median(np.trace(cov, axis1=-2, axis2=-1)) / 3))
    return cov * (max(scatter, _ROUNDING_M) / declared) ** 2 if scatter < _FAR_LESS * declared else cov


@dataclass(frozen=True)
class BodyPlaces:
    """How a body stands: the number of its places, which of them each pose has (B,), a root of its jitter (6, 6).

    No place where it need not stand still. ``R``, ``t`` (B, ..) are where it stands, as a start, m.
    """

    levels: int
    level: Index
    jitter: Array
    R: Array
    t: Array


@dataclass(frozen=True)
class MeasuredBodies:
    """Bodies with how they stand, and the one in whose frame the others are modelled; -1 where the measurement has one
    frame for the campaign."""

    bodies: list[BodyTargets]
    body_places: list[BodyPlaces]
    lead: int

    @classmethod
    def led(cls, bodies: list[BodyTargets], places: list[BodyPlaces], reference: str | None) -> MeasuredBodies:
        """Return bodies led by the reference, else by the one determined most often; by none where one stands still."""
        names = [body.name for body in bodies]
        lead = names.index(reference) if reference in names else int(np.argmax([body.ok.sum() for body in bodies]))
        return cls(bodies, places, -1 if any(one.levels for one in places) else lead)

    @property
    def targets(self) -> Targets:
        """Return all targets, one body after the other."""
        counts = [len(body.names) for body in self.bodies]
        return Targets(
            np.repeat(np.arange(len(self.bodies)) + FIRST_BODY, counts),
            np.full(sum(counts), -1),
            tuple(name for body in self.bodies for name in body.names),
            tuple(body.name for body in self.bodies for _ in body.names),
        )

    def places(self, order: Array) -> dict[str, Array]:
        """Return where other bodies are, seen from the leading one (B,), m: without drives, they deform with these.

        Between poses that do not tell, a body is taken to go straight; one that most poses do not tell is left out.
        ``order`` (B,) is the rank in time.
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

        ``up`` is told in the frame of the reference, or of the measurement where nothing is the reference. None where
        the reference was not measured. Where a body is not determined, gravity is what it is on average.
        """
        names = [body.name for body in self.bodies]
        down = -np.asarray(up, float) / np.linalg.norm(up)
        seen = np.ones(len(self.bodies[0].ok), bool)
        if reference is not None:
            if reference not in names:
                return {}
            seen = self.bodies[names.index(reference)].ok
            down = self.body_places[names.index(reference)].R @ down
        found = {}
        for body in self.bodies:
            known = seen & body.ok
            own = np.einsum("bji,bj->bi", body.R, np.broadcast_to(down, (len(seen), 3)))
            found[gravity_column(body.name)] = (
                np.where(known[:, None], own, own[known].mean(0)) if known.any() else 0 * own
            )
        return found

    def conditions(self, covariates: Mapping[str, Array], poses: tuple[int | str, ...]) -> BodyConditions:
        """Return where each body was found in the model's frame: that of the leading body, else as measured."""
        R, t = np.stack([one.R for one in self.body_places], 1), np.stack([one.t for one in self.body_places], 1)
        if self.lead >= 0:
            back = np.swapaxes(R[:, self.lead], 1, 2)[:, None]
            t = (back @ (t - t[:, [self.lead]])[..., None])[..., 0]
            R = back @ R
        time = covariates.get("time_s")
        known = time is not None and bool(np.isfinite(time).all())
        span = (float(np.min(time)), float(np.max(time))) if time is not None and known else None
        level = np.stack([one.level for one in self.body_places], 1)
        return BodyConditions(np.zeros((len(poses), 0)), dict(covariates), poses, span, R, t, level)

    def epochs(self, conditions: BodyConditions, rows: Mask) -> Epochs:
        """Return what was measured at some poses (mask B)."""
        measured = Observations(
            np.concatenate([body.points[rows] for body in self.bodies], 1),
            np.concatenate([body.cov[rows] for body in self.bodies], 1),
            np.concatenate([body.seen[rows] & body.ok[rows, None] for body in self.bodies], 1),
        )
        count = int(rows.sum())
        frames = Frames(np.tile(np.eye(3), (count, 1, 1)), np.zeros((count, 3)), free=False)
        if self.lead >= 0:
            lead = self.bodies[self.lead]
            frames = Frames(lead.R[rows], lead.t[rows])
        return Epochs(measured, conditions.chosen(rows), frames)


def frame_is_common(body: BodyTargets, order: Array) -> bool:
    """Whether a body hardly moves from one pose to the next: the measurement then has one frame for the campaign."""
    in_time = np.argsort(order, kind="stable")
    points, seen = body.points[in_time], (body.seen & body.ok[:, None])[in_time]
    both = seen[1:] & seen[:-1]
    if both.sum() < _FEWEST:
        return False
    steps = np.linalg.norm(np.diff(points, axis=0), axis=-1)[both]
    return bool(np.median(steps) < _STEP * body.sigma)


def free_body(body: BodyTargets) -> BodyPlaces:
    """Stand a body nowhere: it need not stand still."""
    return BodyPlaces(0, np.zeros(len(body.ok), np.int64), np.eye(6), body.R, body.t)


def fixed_body(body: BodyTargets, level: Index, order: Array) -> BodyPlaces:
    """Stand a body at the middle of what was found at each of its places, of which each pose has one (B,)."""
    R, t, middle = body.R.copy(), body.t.copy(), body.shape.mean(0)
    centre = body.t + body.R @ middle
    for place in range(level.max() + 1):
        own = level == place
        known = own & body.ok
        if known.any():
            first = body.R[known][0]
            R[own] = exp_so3(np.median(log_so3(body.R[known] @ first.T), axis=0)) @ first
            t[own] = np.median(centre[known], axis=0) - R[own] @ middle
    return BodyPlaces(int(level.max()) + 1, level, _jitter(body, level, order), R, t)


def _jitter(body: BodyTargets, level: Index, order: Array) -> Array:
    """A square root (6, 6) of the covariance of a body's pose from one pose to the next, beyond its targets' noise.

    Shift of the targets' middle (m), then rotation vector (rad), in the axes of the measurement. Robust.
    """
    steps = _steps(body, level, order)
    if len(steps) < _ENOUGH_STEPS:
        return _root(np.zeros((6, 6)), body)
    scale = _NORMAL * np.median(np.abs(steps), axis=0)
    clipped = np.clip(steps / np.maximum(scale, 1e-12), -_TAIL, _TAIL)
    own = np.corrcoef(clipped, rowvar=False) * np.outer(scale, scale)
    alike = np.diag(np.repeat([np.mean(scale[:3] ** 2), np.mean(scale[3:] ** 2)], 3))
    share = len(steps) / (len(steps) + _ALIKE)
    return _root(share * own + (1.0 - share) * alike - _of_noise(body), body)


def _steps(body: BodyTargets, level: Index, order: Array) -> Array:
    """Steps (n, 6) of the pose between poses at the same place, one after the other in time, over the root of two."""
    centre, found = body.t + body.R @ body.shape.mean(0), []
    in_time = np.argsort(order, kind="stable")
    for place in range(level.max() + 1):
        rows = in_time[(body.ok & (level == place))[in_time]]
        turned = log_so3(body.R[rows][1:] @ np.swapaxes(body.R[rows][:-1], 1, 2))
        found.append(np.concatenate([np.diff(centre[rows], axis=0), turned], 1))
    return np.concatenate(found) / np.sqrt(2.0)


def _of_noise(body: BodyTargets) -> Array:
    """The covariance (6, 6) that the points' noise gives a pose."""
    arms = (body.shape - body.shape.mean(0)) @ body.R[np.flatnonzero(body.ok)[0]].T
    design = rigid_motions(arms).reshape(-1, 6)
    return np.asarray(np.linalg.pinv(design.T @ design / body.sigma**2))


def _root(covariance: Array, body: BodyTargets) -> Array:
    """A square root of what is positive of a covariance; at least a small share of the points' noise everywhere.

    Lower triangular: the first three unknowns are the shift, with the rotation that comes along, the others what it
    turns beside.
    """
    radius = max(float(np.sqrt(np.mean(np.sum((body.shape - body.shape.mean(0)) ** 2, -1)))), 1e-6)
    unit = np.array([body.sigma] * 3 + [body.sigma / radius] * 3)
    values, vectors = np.linalg.eigh(covariance / np.outer(unit, unit))
    positive = (vectors * np.maximum(values, _LEAST**2)) @ vectors.T
    return np.asarray(unit[:, None] * np.linalg.cholesky(positive))
