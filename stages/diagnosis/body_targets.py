"""The targets of one body without a mechanism: where they sit on it, where they were measured, which were moved."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from truing.estimation.rigid_poses.points import PosePoints
from truing.estimation.rigid_poses.umeyama import umeyama
from truing.estimation.target_positions import (
    changes_of_place,
    lonely_places,
    looseness,
    median_places,
    stray_places,
)
from truing.report.numbers import count as counted
from truing.simulation.mechanisms.causes.targets import TargetMoved, TargetsSwapped, markers_of
from truing.simulation.mechanisms.recording import FREE_LENGTH_M
from truing.stages.common.point_arrays import default_motions, pose_points, residual_points, survey_points
from truing.stages.diagnosis.judged_points import Judged, judged_points, swapped_targets

if TYPE_CHECKING:
    import pyarrow as pa

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_FEWEST_TARGETS = 3
_FEWEST_POSES = 3
# Where a target sits that was not surveyed is open by this share of the body's size: so wide that not even the body's
# scale is taken to be known.
_FREE_SHAPE = 0.3
_FAR_LESS = 0.4
_ROUNDING_M = 1e-7  # no noise is smaller


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


def targets_of(
    tables: Mapping[str, pa.Table], poses: tuple[int | str, ...], order: Array, noise_mm: float | None
) -> tuple[list[BodyTargets], list[str]]:
    """Every body with three targets seen together in three poses, and what was left out, in words."""
    found, words = [], []
    for name in dict.fromkeys(tables["observations"].column("body").to_pylist()):
        body = _body(tables, name, poses, order, (noise_mm or 0.0) * 1e-3)
        if body is None:
            words.append(f"body {name} (no three targets seen together in three poses)")
            continue
        gone = int((~body.ok & body.seen.any(1)).sum())
        words += [f"{counted(gone, 'pose')} of body {name}, not determined by its targets"] if gone else []
        found.append(body)
    return found, words


def _body(
    tables: Mapping[str, pa.Table], name: str, poses: tuple[int | str, ...], order: Array, noise: float
) -> BodyTargets | None:
    points = pose_points(tables["observations"], name, poses)
    survey = survey_points(tables["survey"], name) if "survey" in tables else None
    if survey is not None and survey.targets:
        points = pose_points(tables["observations"], name, poses, survey.targets)
        shape, cov = survey.points, survey.cov
    else:
        survey = None
        shape, cov = _measured_shape(tables, name, points), np.zeros((len(points.targets), 3, 3))
    enough = np.asarray(np.isfinite(shape).all(1) & points.seen.any(0))
    if enough.sum() < _FEWEST_TARGETS:
        return None
    points = PosePoints(
        poses,
        tuple(t for t, kept in zip(points.targets, enough, strict=True) if kept),
        points.points[:, enough],
        points.cov[:, enough],
        points.seen[:, enough],
    )
    return _fitted(tables, name, points, shape[enough], cov[enough], survey is not None, order, noise)


def _measured_shape(tables: Mapping[str, pa.Table], name: str, points: PosePoints) -> Array:
    """Where targets (k, 3) sit on a body that was not surveyed: at their median over the poses."""
    R, t = default_motions(tables["poses"], name, points.poses)
    ok = np.isfinite(t[:, 0]) & np.isfinite(R[:, 0, 0])
    places = np.einsum("bji,bkj->bki", np.nan_to_num(R), points.points - np.nan_to_num(t)[:, None])
    known = points.seen & ok[:, None]
    residual = residual_points(tables["residuals"], name, points.poses, points.targets)
    trusted = np.asarray(known & np.isfinite(residual).all(-1))
    return median_places(places, np.where(trusted.any(0), trusted, known))


def _fitted(
    tables: Mapping[str, pa.Table],
    name: str,
    points: PosePoints,
    shape: Array,
    shape_cov: Array,
    surveyed: bool,
    order: Array,
    noise: float,
) -> BodyTargets | None:
    """The body where its targets that were not rejected put it, gross errors apart; None where that is in no poses."""
    judged = judged_points(tables["residuals"], name, points, shape, order)
    right, trusted = _put_right(tables, name, points, judged)
    fit = umeyama(shape, right, trusted.astype(float))
    if fit.ok.sum() < _FEWEST_POSES:
        return None
    R = np.where(fit.ok[:, None, None], fit.R, np.eye(3))
    t = np.where(fit.ok[:, None], fit.t, 0.0)
    gaps = (np.einsum("bji,bkj->bki", R, right - t[:, None]) - shape)[trusted & fit.ok[:, None]]
    cov = _found_smaller(_declared(points.cov, noise), gaps, len(shape))
    if not surveyed:
        radius = float(np.sqrt(np.mean(np.sum((shape - shape.mean(0)) ** 2, -1))))
        shape_cov = np.broadcast_to(np.eye(3) * max(FREE_LENGTH_M, _FREE_SHAPE * radius) ** 2, shape_cov.shape)
    else:
        shape_cov = _declared(shape_cov, noise)
    known = points.seen & fit.ok[:, None]
    places = np.where(known[..., None], np.einsum("bji,bkj->bki", R, right - t[:, None]), 0.0)
    sigma = float(np.sqrt(np.median(np.trace(cov[known], axis1=-2, axis2=-1)) / 3))
    loose = _loose_corners(name, points.targets, shape, trusted)
    seen = judged.kept & known & (trusted | ~lonely_places(places, known, order, sigma, loose))
    changes = changes_of_place(places, seen, order, sigma, loose)
    seen &= ~stray_places(places, seen, order, sigma, changes, loose)
    moved = moved_for_certain(name, points, shape, order, changes)
    ok = fit.ok & (seen.sum(1) >= _FEWEST_TARGETS)
    swapped = tuple(swapped_targets(name, points.targets, points.poses, order, judged.exchanges))
    return BodyTargets(
        name, points.targets, shape, shape_cov, surveyed, points.points, cov, seen, R, t, ok, (*swapped, *moved)
    )


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


def _put_right(tables: Mapping[str, pa.Table], name: str, points: PosePoints, judged: Judged) -> tuple[Array, Mask]:
    """Points (B, k, 3) under their right labels, and which of them (B, k) tell where the body is."""
    right = points.points.copy()
    trusted = points.seen & np.isfinite(residual_points(tables["residuals"], name, points.poses, points.targets)).all(
        -1
    )
    for one in judged.exchanges:
        right[one.pose, [one.first, one.second]] = points.points[one.pose, [one.second, one.first]]
        few = trusted[one.pose].sum() < _FEWEST_TARGETS
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


def _declared(cov: Array, noise: float) -> Array:
    """Covariances, with the declared noise where a point carries none."""
    known = np.trace(np.nan_to_num(cov), axis1=-2, axis2=-1) > 0
    return np.where(known[..., None, None], np.nan_to_num(cov), np.eye(3) * max(noise, _ROUNDING_M) ** 2)
