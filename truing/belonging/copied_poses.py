"""Test of copied measurements: poses, or targets of a body, whose points agree in every digit."""

from __future__ import annotations

import numpy as np

from truing.arrays import Array, Mask
from truing.belonging.relation import RecordSlip, RelationState, RelationTest, SlipKind

COPIES = "copied-poses"
_FEWEST_POSES = 2
_CHANCE = 1e-6  # probability that two measurements of one campaign agree in every digit


def relate_copies(
    points: Array, is_observed: Mask, sigma: float, poses: tuple[str, ...], targets: tuple[tuple[str, str], ...] = ()
) -> RelationTest:
    """Return the test of copied poses and targets: no two agree in every digit of points (B, T, 3), m.

    ``targets`` (T): body and name of each target; two targets of one body must differ in some pose. Not tested with a
    single pose; poses also with a file so coarse, relative to the noise sigma, that equal points occur by chance.
    """
    groups: dict[bytes, list[int]] = {}
    measured = np.flatnonzero(is_observed.any(axis=1))
    if len(measured) < _FEWEST_POSES:
        return RelationTest(COPIES, RelationState.NOT_TESTED, "one-pose")
    if copied_targets := _copied_targets(points, is_observed, targets):
        copied = tuple(RecordSlip(SlipKind.COPIED, "points of targets", names) for names in copied_targets)
        return _failed(copied, sum(map(len, copied_targets)))
    for pose in measured:
        key = points[pose][is_observed[pose]].round(12).tobytes() + is_observed[pose].tobytes()
        groups.setdefault(key, []).append(int(pose))
    copied_groups = [group for group in groups.values() if len(group) > 1]
    if not copied_groups:
        return RelationTest(COPIES, RelationState.OK, "distinct", misfit=0.0, limit=0.0, unit="1")
    coordinates = 3 * int(min(is_observed[group[0]].sum() for group in copied_groups))
    chance = min(_resolution(points[is_observed]) / (2.0 * np.sqrt(np.pi) * max(sigma, 1e-300)), 1.0) ** coordinates
    if chance * len(points) ** 2 > _CHANCE:
        return RelationTest(COPIES, RelationState.NOT_TESTED, "coarse")
    slips = tuple(
        RecordSlip(SlipKind.COPIED, "points of poses", tuple(poses[pose] for pose in group)) for group in copied_groups
    )
    return _failed(slips, sum(map(len, copied_groups)))


def _failed(slips: tuple[RecordSlip, ...], copies: int) -> RelationTest:
    """Return the failed test; its misfit is the number of equal poses or targets."""
    return RelationTest(COPIES, RelationState.FAILS, "slip", misfit=float(copies), limit=0.0, unit="1", slips=slips)


def _copied_targets(points: Array, is_observed: Mask, targets: tuple[tuple[str, str], ...]) -> list[tuple[str, ...]]:
    """Return groups of one body's targets whose points (B, T, 3) are equal in every digit, and in the same poses."""
    groups: dict[tuple[str, bytes], list[str]] = {}
    for k, (body, target) in enumerate(targets):
        if is_observed[:, k].sum() >= _FEWEST_POSES:
            key = body, points[is_observed[:, k], k].round(12).tobytes() + is_observed[:, k].tobytes()
            groups.setdefault(key, []).append(target)
    return [tuple(group) for group in groups.values() if len(group) > 1]


def _resolution(values: Array) -> float:
    """Return the smallest step, m, between different numbers of a file."""
    steps = np.diff(np.unique(values.round(12)))
    return float(steps.min()) if len(steps) else float("inf")
