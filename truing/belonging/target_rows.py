"""Slips in the rows of one target of a body, and targets with each other's names in some poses."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from truing.arrays import Array, Mask
from truing.belonging.axes_changes import AXES_CHANGES
from truing.belonging.body_points import BodyPoints
from truing.belonging.relation import LENGTH_FACTORS, RecordSlip, SlipKind, both_ways
from truing.belonging.slips_in_rows import row_places
from truing.estimation.rigid_poses.rigid import RigidFit
from truing.estimation.rigid_poses.umeyama import umeyama, umeyama_misfit

MOST_TARGETS = 40
"""Largest number of targets whose rows and names are tested."""
_FEWEST_OTHERS = 3  # targets that give the pose without the one that is tested
_FEWEST_POSES, _LEAST_SHARE = 3, 0.2  # of poses that a slip concerns; gross errors and exchanges of labels are fewer
_MOST_LEFT = 0.2  # largest share of the misfit that may remain after a slip is undone
_OTHERS_AGREE = 0.9  # share of the poses in which all other targets agree
_SHIFTS = (1, -1, 2, -2)
_FEWEST_EQUAL = 3  # successive poses with equal numbers of a target
_MOVED = 30.0  # sigmas by which the other targets tell that the body moved meanwhile


@dataclass(frozen=True)
class TargetRows:
    """Measured points (B, 3), m, of one target, and the body's motions from its other targets.

    ``place`` (3,), m, in the body frame, where it is expected; ``is_surveyed``: from a survey, not from the points
    themselves. ``known`` (B,): poses with point and motion; ``limit``: largest distance, m, from the expected place.
    ``poses`` and ``groups`` name the poses.
    """

    name: str
    measured: Array
    motions: RigidFit
    place: Array
    known: Mask
    limit: float
    poses: Sequence[str]
    groups: Sequence[tuple[str, Sequence[str]]]
    is_surveyed: bool = True

    @property
    def expected(self) -> Array:
        """Expected places (B, 3), m, in the measurement frame; zero without a motion."""
        return self.at(self.place)

    def at(self, point: Array) -> Array:
        """Return a point (3,) of the body frame in the measurement frame, (B, 3), in all poses."""
        return np.nan_to_num(self.motions.R @ point + self.motions.t)

    def median_point(self, measured: Array) -> Array:
        """Return the median point (3,) in the body frame of points (B, 3)."""
        back = np.einsum("bji,bj->bi", self.motions.R[self.known], (measured - self.motions.t)[self.known])
        return np.asarray(np.median(back, axis=0))

    @property
    def apart(self) -> Mask:
        """True for poses (B,) in which the point is not at its expected place."""
        return np.asarray(self.known & (_distance(self.measured, self.expected) > self.limit))


def rows_of_wrong_target(body: BodyPoints, limit: float, *, is_surveyed: bool) -> TargetRows | None:
    """Return the rows of the target that does not fit a body in many poses in which all others do; None if there is
    none.

    limit: largest rms misfit, m, of points that fit.
    """
    if not _FEWEST_OTHERS < len(body.targets) <= MOST_TARGETS:
        return None
    candidates: list[tuple[float, TargetRows]] = []
    for target, name in enumerate(body.targets):
        others = body.is_observed.astype(float)
        others[:, target] = 0.0
        fit = umeyama(body.survey, body.points, others, calls=len(body.targets))
        tested = body.is_observed[:, target] & (others.sum(axis=1) >= _FEWEST_OTHERS)
        agree = tested & fit.ok & (np.nan_to_num(fit.rms, nan=np.inf) <= limit)
        measured, place = body.points[:, target], body.survey[target]
        rows = TargetRows(name, measured, fit, place, agree, 3.0 * limit, body.poses, body.groups, is_surveyed)
        many = max(_FEWEST_POSES, _LEAST_SHARE * tested.sum())
        if agree.sum() >= _OTHERS_AGREE * tested.sum() and rows.apart.sum() >= many:
            candidates.append((float(np.median(fit.rms[agree])), rows))
    return min(candidates, key=lambda candidate: candidate[0])[1] if candidates else None


def slip_of_target(rows: TargetRows) -> RecordSlip | None:
    """Return the slip that explains why a target is not at its expected place; None if none does."""
    slips = (*_scaled(rows), *_with_other_axes(rows), *_shifted(rows))
    explaining = [(after, slip) for found in slips if found is not None for after, slip in (found,)]
    return min(explaining, key=lambda candidate: candidate[0])[1] if explaining else None


Explained = tuple[float, RecordSlip]


def _scaled(rows: TargetRows) -> Iterator[Explained | None]:
    for factor in both_ways(LENGTH_FACTORS):
        slip = RecordSlip(SlipKind.UNIT, f"points of target {rows.name}", (), factor)
        yield _explained(rows, factor * rows.measured, slip, max(factor, 1.0))


def _with_other_axes(rows: TargetRows) -> Iterator[Explained | None]:
    for change in AXES_CHANGES:
        quantity = f"{change.slip.quantity.removesuffix(' of points')} of target {rows.name}"
        slip = RecordSlip(change.slip.kind, quantity)
        yield _explained(rows, rows.measured @ change.matrix, slip, 1.0)


def _shifted(rows: TargetRows) -> Iterator[Explained | None]:
    for shift in _SHIFTS:
        inside = np.zeros(len(rows.known), bool)
        inside[: -shift if shift > 0 else None] = True
        inside[: -shift if shift < 0 else 0] = False
        moved = np.roll(rows.measured, -shift, axis=0)
        measured = np.roll(rows.known, -shift) & inside
        slip = RecordSlip(SlipKind.ROWS_SHIFTED, f"points of target {rows.name}", (), shift=shift)
        yield _explained(rows, moved, slip, 1.0, measured)


def frozen_targets(
    names: Sequence[str], points: Array, is_observed: Mask, sigma: float, poses: Sequence[str]
) -> Iterator[RecordSlip]:
    """Yield targets whose numbers stay equal over successive poses while the other targets of the body move.

    points (B, T, 3) in m with noise sigma, m; is_observed (B, T).
    """
    for target, name in enumerate(names):
        rows = np.flatnonzero(is_observed[:, target])
        points_of_target = points[rows, target]
        ends = (
            np.flatnonzero(np.append(np.any(points_of_target[1:] != points_of_target[:-1], axis=1), True)).tolist()
            if len(rows)
            else []
        )
        frozen, first = np.zeros(len(is_observed), bool), 0
        for end in ends:
            stretch = rows[first : end + 1]
            if len(stretch) >= _FEWEST_EQUAL and _others_move(points[stretch], is_observed[stretch], target, sigma):
                frozen[stretch] = True
            first = end + 1
        if frozen.any():
            is_used = is_observed[:, target] & ~frozen
            yield RecordSlip(SlipKind.FROZEN, f"points of target {name}", tuple(row_places(frozen, is_used, poses, ())))


def _others_move(points: Array, is_observed: Mask, target: int, sigma: float) -> bool:
    others: Mask = np.asarray(is_observed.all(axis=0))
    others[target] = False
    moved = np.ptp(points[:, others], axis=0).max(axis=1)
    return bool(others.any() and moved.min() > _MOVED * sigma)


def _explained(
    rows: TargetRows, undone: Array, slip: RecordSlip, noise: float, usable: Mask | None = None
) -> Explained | None:
    """Return the misfit, m, after a slip is undone, with the slip and its poses; None where it does not explain nearly
    all poses in which the target is not at its place.

    ``undone`` (B, 3): the points without the slip, whose noise is ``noise`` times as large; ``usable`` (B,): poses in
    which it can be undone.
    """
    known = rows.known if usable is None else rows.known & usable
    concerned = rows.apart & known
    if concerned.sum() < _FEWEST_POSES:
        return None
    before = _distance(rows.measured, rows.expected)
    shapes = [(rows.expected, concerned, before)]
    if not rows.is_surveyed:  # the points that a slip concerns tell the place only after it is undone
        # Points that are merely shrunk scatter less about any place: they have to follow the body as it moves.
        still = _distance(undone, np.median(undone[known], axis=0))
        shapes.append((rows.at(rows.median_point(undone)), known, np.minimum(before, still)))
    for expected, tested, reference in shapes:
        after = _distance(undone, expected)[tested]
        right = np.mean(after <= noise * rows.limit)
        if right >= _OTHERS_AGREE and np.median(after) <= _MOST_LEFT * np.median(reference[tested]):
            return float(np.median(after)), _placed(slip, rows, tested)
    return None


def _placed(slip: RecordSlip, rows: TargetRows, concerned: Mask) -> RecordSlip:
    is_used = rows.known & ~concerned
    where = row_places(concerned, is_used, rows.poses, rows.groups) if is_used.any() else ()
    return replace(slip, subjects=tuple(where))


def exchanged_names(
    names: Sequence[str],
    source: Array,
    points: Array,
    is_observed: Mask,
    misfit: Array,
    limit: float,
) -> Iterator[tuple[str, Array]]:
    """Yield pairs of targets that have each other's names in poses that do not fit.

    Each comes with the misfit (B,), m, after the exchange is undone, infinite in other poses.

    source (T, 3) and points (B, T, 3) in m, is_observed (B, T); misfit (B,), m, as recorded, and the limit of what
    fits. Few poses are left to the test of single labels.
    """
    bad = np.flatnonzero(misfit > limit)
    if not _FEWEST_OTHERS <= len(names) <= MOST_TARGETS or len(bad) < max(
        _FEWEST_POSES, _LEAST_SHARE * len(is_observed)
    ):
        return
    pairs = list(combinations(range(len(names)), 2))
    after = np.full((len(pairs), len(bad)), np.inf)
    for at, (first, other) in enumerate(pairs):
        order = np.arange(len(names))
        order[[first, other]] = other, first
        fitted, _ = umeyama_misfit(source[order], points[bad], is_observed[bad].astype(float), calls=len(pairs))
        after[at] = np.where(np.isfinite(fitted) & is_observed[bad][:, [first, other]].all(axis=1), fitted, np.inf)
    best = after.argmin(axis=0)
    for at in np.unique(best):
        left = np.full(len(misfit), np.inf)
        left[bad[best == at]] = after[at][best == at]
        first, other = (names[target] for target in pairs[at])
        yield f"names of targets {first} and {other}", left


def _distance(first: Array, other: Array) -> Array:
    return np.asarray(np.linalg.norm(first - other, axis=-1))
