"""Test of copied measurements: poses, or targets of a body, whose points agree in every digit."""

from __future__ import annotations

import numpy as np

from truing.arrays import Array, Mask
from truing.belonging.chance_equality import resolution
from truing.belonging.relation import RecordSlip, RelationState, RelationTest, SlipKind

COPIES = "copied-poses"
_FEWEST_POSES = 2
_CHANCE = 1e-6  # probability that as many measurements of one campaign agree in every digit
_UNITS = (1e-3, 0.0254)  # m: units in which files have decimal digits
_MOST_VALUES = 5000  # numbers among which the step of a file is sought
_OFF_GRID = 0.01  # largest deviation from a grid, in steps; less is rounding


def relate_copies(
    points: Array, is_observed: Mask, sigma: float, poses: tuple[str, ...], targets: tuple[tuple[str, str], ...] = ()
) -> RelationTest:
    """Return the test of copied poses and targets: no two agree in every digit of points (B, T, 3), m.

    ``targets`` (T): body and name of each target; two targets of one body must differ in some pose. Not tested with a
    single pose; poses also with a file so coarse, relative to the noise sigma, that equal points occur by chance.
    """
    if is_observed.any(axis=1).sum() < _FEWEST_POSES:
        return RelationTest(COPIES, RelationState.NOT_TESTED, "one-pose")
    if copied_targets := _copied_targets(points, is_observed, targets):
        copied = tuple(RecordSlip(SlipKind.COPIED, "points of targets", names) for names in copied_targets)
        return _failed(copied, sum(map(len, copied_targets)))
    numbers = points.reshape(len(points), -1)
    return relate_copied_numbers(numbers, np.repeat(is_observed, points.shape[2], axis=1), sigma, poses, "points")


def relate_copied_numbers(
    numbers: Array, is_observed: Mask, sigma: float, poses: tuple[str, ...], quantity: str, also: Array | None = None
) -> RelationTest:
    """Return the test that no two poses have the same lengths (B, N), m, of noise sigma, in every digit.

    Rows ``also`` (B, M) must be equal too; the resolution of the file is that of the lengths. ``quantity``: name of
    what was measured.
    """
    groups: dict[bytes, list[int]] = {}
    for pose in np.flatnonzero(is_observed.any(axis=1)):
        key = numbers[pose][is_observed[pose]].round(12).tobytes() + is_observed[pose].tobytes()
        key += b"" if also is None else also[pose].round(12).tobytes()
        groups.setdefault(key, []).append(int(pose))
    copied_groups = [group for group in groups.values() if len(group) > 1]
    if not copied_groups:
        return RelationTest(COPIES, RelationState.OK, "distinct", misfit=0.0, limit=0.0, unit="1")
    count = int(min(is_observed[group[0]].sum() for group in copied_groups))
    step = _resolution(numbers[is_observed])
    chance = min(step / (2.0 * np.sqrt(np.pi) * max(sigma, 1e-300)), 1.0) ** count
    copies = sum(len(group) - 1 for group in copied_groups)
    if min(chance * len(numbers) ** 2, 1.0) ** copies > _CHANCE:
        return RelationTest(COPIES, RelationState.NOT_TESTED, "coarse")
    slips = tuple(
        RecordSlip(SlipKind.COPIED, f"{quantity} of poses", tuple(poses[pose] for pose in group))
        for group in copied_groups
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
    """Return the step, m, of the decimal grid on which the numbers of a file lie; 0 where they lie on none.

    The smallest difference of two numbers is larger than that step where few numbers are far apart.
    """
    some = values[:: max(len(values) // _MOST_VALUES, 1)]
    steps = [unit * resolution(some / unit) for unit in _UNITS]
    return min((step for step in steps if _lie_on(some, step)), default=0.0)


def _lie_on(values: Array, step: float) -> bool:
    """Return True if all differences of values (N,) are multiples of a step."""
    if step <= 0.0:
        return False
    parts = (values - values[0]) / step
    return bool(np.abs(parts - np.round(parts)).max() < _OFF_GRID)
