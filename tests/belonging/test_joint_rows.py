"""Slips in some poses of a chain are named with their poses, on an arm with hand-written kinematics."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from truing.belonging.joint_rows import ChainComparison, slips_in_poses
from truing.belonging.relation import RecordSlip, SlipKind

COUNT = 40
PLACES = np.array([[0.08, 0.0, 0.03], [-0.05, 0.06, 0.02], [0.01, -0.07, 0.05]])  # targets in the last link, m
ELBOW, WRIST = np.array([0.4, 0.0, 0.2]), np.array([0.3, 0.0, 0.0])
LATE = np.arange(COUNT) >= 25


def turned(angle: np.ndarray, axis: int) -> np.ndarray:
    """Rotations (B, 3, 3) about a coordinate axis."""
    found, (j, k) = np.tile(np.eye(3), (len(angle), 1, 1)), ((axis + 1) % 3, (axis + 2) % 3)
    found[:, j, j] = found[:, k, k] = np.cos(angle)
    found[:, k, j], found[:, j, k] = np.sin(angle), -np.sin(angle)
    return found


def positions(readings: np.ndarray) -> np.ndarray:
    """Targets (B, 3, 3), m, of an arm that turns about z, y and x."""
    first, second, third = turned(readings[:, 0], 2), turned(readings[:, 1], 1), turned(readings[:, 2], 0)
    tip = np.einsum("bij,kj->bki", third, PLACES) + WRIST
    return np.einsum("bij,bkj->bki", first, np.einsum("bij,bkj->bki", second, tip) + ELBOW)


def compared(
    change: Callable[[np.ndarray, np.ndarray], None] = lambda readings, values: None,
) -> ChainComparison:
    """The arm with errors of a millimetre, and a change of readings (B, 3) and values (B, 3, 3)."""
    rng = np.random.default_rng(3)
    readings = rng.uniform(-1.2, 1.2, (COUNT, 3))
    values = positions(readings) + 1e-3 * rng.normal(size=(COUNT, 3, 3))
    readings, values = readings.copy(), values.copy()
    change(readings, values)

    def errors_at(fitted: np.ndarray) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
        return lambda own, of: of - positions(own)

    return ChainComparison(
        readings,
        values,
        np.ones(3, bool),
        ("turn", "lift", "roll"),
        tuple(("tip", name) for name in ("A", "B", "C")),
        tuple(str(1 + pose) for pose in range(COUNT)),
        0.01,
        errors_at,
    )


def the_slip(change: Callable[[np.ndarray, np.ndarray], None]) -> RecordSlip:
    found = slips_in_poses(compared(change))
    assert found is not None
    assert found.is_explained
    (slip,) = found.slips
    return slip


def test_an_arm_as_it_is_has_no_slip() -> None:
    assert slips_in_poses(compared()) is None


def exchanged_rows(readings: np.ndarray, values: np.ndarray) -> None:
    readings[[4, 30]] = readings[[30, 4]]


def late_degrees(readings: np.ndarray, values: np.ndarray) -> None:
    readings[LATE, 1] *= 180.0 / np.pi


def late_sign(readings: np.ndarray, values: np.ndarray) -> None:
    readings[LATE, 0] *= -1.0


def late_columns(readings: np.ndarray, values: np.ndarray) -> None:
    readings[np.ix_(LATE, [0, 2])] = readings[np.ix_(LATE, [2, 0])]


def lost_row(readings: np.ndarray, values: np.ndarray) -> None:
    readings[25:-1] = readings[26:].copy()


def frozen(readings: np.ndarray, values: np.ndarray) -> None:
    readings[10:20, 1] = readings[10, 1]


def frozen_places(readings: np.ndarray, values: np.ndarray) -> None:
    values[25:] = values[25]


def copied_place(readings: np.ndarray, values: np.ndarray) -> None:
    values[30] = values[4]


def late_inches(readings: np.ndarray, values: np.ndarray) -> None:
    values[LATE] /= 25.4


def late_y(readings: np.ndarray, values: np.ndarray) -> None:
    values[LATE, :, 1] *= -1.0


def late_labels(readings: np.ndarray, values: np.ndarray) -> None:
    values[np.ix_(LATE, [0, 1])] = values[np.ix_(LATE, [1, 0])]


@pytest.mark.parametrize(
    ("change", "kind", "subjects"),
    [
        (exchanged_rows, SlipKind.ROWS_EXCHANGED, ("pose 5", "pose 31")),
        (late_degrees, SlipKind.UNIT, ("lift", "from pose 26 on")),
        (late_sign, SlipKind.SIGN, ("turn", "from pose 26 on")),
        (late_columns, SlipKind.COLUMNS, ("turn", "roll", "from pose 26 on")),
        (frozen, SlipKind.FROZEN, ("lift", "from pose 11 to pose 20")),
        (frozen_places, SlipKind.FROZEN, ("from pose 26 on",)),
        (copied_place, SlipKind.COPIED, ("pose 5", "pose 31")),
        (late_inches, SlipKind.UNIT, ("from pose 26 on",)),
        (late_y, SlipKind.SIGN, ("from pose 26 on",)),
        (late_labels, SlipKind.PARTS_EXCHANGED, ("A", "B", "from pose 26 on")),
    ],
)
def test_a_slip_in_some_poses_is_named_with_them(
    change: Callable[[np.ndarray, np.ndarray], None], kind: SlipKind, subjects: tuple[str, ...]
) -> None:
    slip = the_slip(change)
    assert (slip.kind, slip.subjects) == (kind, subjects)


def test_a_lost_row_shifts_all_later_ones() -> None:
    slip = the_slip(lost_row)
    assert (slip.kind, slip.shift) == (SlipKind.ROWS_SHIFTED, -1)


def test_the_unit_of_positions_and_their_axis_are_reported() -> None:
    assert the_slip(late_inches).factor == 25.4
    assert the_slip(late_y).quantity == "y of measured positions"


def test_poses_that_nothing_explains_are_listed_and_no_more() -> None:
    def change(readings: np.ndarray, values: np.ndarray) -> None:
        readings[[7, 21]] += [[0.5, -0.4, 0.3], [-0.6, 0.2, 0.4]]

    found = slips_in_poses(compared(change))
    assert found is not None
    assert not found.is_explained
    assert found.slips[0].subjects == ("pose 8", "pose 22")


def test_a_single_wrong_target_is_no_slip_of_its_pose() -> None:
    def change(readings: np.ndarray, values: np.ndarray) -> None:
        values[[3, 12, 33], 1] += 0.2

    assert slips_in_poses(compared(change)) is None


def test_the_order_of_columns_and_targets_does_not_matter() -> None:
    own = compared(late_sign)
    order = [2, 1, 0]

    def errors_at(fitted: np.ndarray) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
        return lambda readings, values: values - positions(readings[:, order])[:, order]

    other = replace(
        own,
        readings=own.readings[:, order],
        values=own.values[:, order],
        columns=[own.columns[k] for k in order],
        targets=[own.targets[k] for k in order],
        errors_at=errors_at,
    )
    assert slips_in_poses(other).slips == slips_in_poses(own).slips  # type: ignore[union-attr]


@pytest.mark.parametrize(("wrong", "is_named"), [(4, True), (12, False)])
def test_only_few_poses_are_called_misread(wrong: int, is_named: bool) -> None:
    """If a third of all poses disagree for no known reason, no single pose is called misread."""

    def elsewhere(_: np.ndarray, values: np.ndarray) -> None:
        values[:wrong] += 0.1 * np.random.default_rng(5).normal(size=(wrong, 1, 3))

    found = slips_in_poses(compared(elsewhere))
    assert (found is not None) is is_named
    if found is not None:
        assert [slip.kind for slip in found.slips] == [SlipKind.STRAY]
        assert found.slips[0].subjects == tuple(f"pose {pose}" for pose in range(1, wrong + 1))


def test_joints_moved_one_at_a_time_are_not_called_frozen() -> None:
    """In the poses that disagree a joint stands still, as it does in most of the others."""

    def one_at_a_time(readings: np.ndarray, values: np.ndarray) -> None:
        swing = np.linspace(-1.2, 1.2, 13)
        readings[:] = 0.1
        for k in range(3):
            readings[13 * k : 13 * (k + 1), k] = swing
        values[:] = positions(readings)
        values[13:26] += [0.05, 0.0, 0.0]

    found = slips_in_poses(compared(one_at_a_time))
    assert found is None or all(slip.kind is not SlipKind.FROZEN for slip in found.slips)
