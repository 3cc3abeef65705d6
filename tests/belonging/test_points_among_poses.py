"""A body without a survey: slips in some poses or of one target are named; deformation and displaced bodies are not."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from truing.belonging.body_point_tests import relate_poses
from truing.belonging.body_points import BodyPoints
from truing.belonging.relation import RelationState, SlipKind
from truing.estimation.rigid_poses.points import PosePoints
from truing.quality.bodies import shape_of_poses

SIGMA = 1e-5
NAMES = ("A", "B", "C", "D", "E")
POSES = 16
Change = Callable[[np.ndarray], None]


def _points(seed: int = 0, targets: int = 5) -> np.ndarray:
    rng = np.random.default_rng(seed)
    place = rng.uniform(-0.5, 0.5, (targets, 3))
    turned = Rotation.from_rotvec(0.4 * rng.normal(size=(POSES, 3))).as_matrix()
    moved = np.array([1.0, 3.0, -2.0]) + 0.3 * rng.normal(size=(POSES, 3))
    return np.einsum("bij,tj->bti", turned, place) + moved[:, None] + SIGMA * rng.normal(size=(POSES, targets, 3))


def _body(points: np.ndarray) -> BodyPoints:
    poses, targets = points.shape[:2]
    is_observed = np.ones((poses, targets), bool)
    cov = np.broadcast_to(SIGMA**2 * np.eye(3), (poses, targets, 3, 3)).copy()
    shape = shape_of_poses(PosePoints(tuple(range(poses)), NAMES[:targets], points, cov, is_observed))
    names = tuple(f"P{pose}" for pose in range(poses))
    return BodyPoints("frame", shape.points, points, is_observed, SIGMA, names, targets=shape.targets)


def _scaled(points: np.ndarray) -> None:
    points[9:] /= 25.4


def _exchanged_axes(points: np.ndarray) -> None:
    points[9:] = points[9:, :, [1, 0, 2]]


def _exchanged_names(points: np.ndarray) -> None:
    points[9:, [1, 3]] = points[9:, [3, 1]]


def _target_in_m(points: np.ndarray) -> None:
    points[:, 2] /= 1e3


def _target_frozen(points: np.ndarray) -> None:
    points[9:, 2] = points[9, 2]


def _target_late(points: np.ndarray) -> None:
    points[:, 2] = np.roll(points[:, 2], 1, axis=0)


def _target_turned(points: np.ndarray) -> None:
    points[:, 2, 1] *= -1.0


@pytest.mark.parametrize(
    ("change", "kind", "quantity"),
    [
        (_scaled, SlipKind.UNIT, "points"),
        (_exchanged_axes, SlipKind.COLUMNS, "x_mm and y_mm of points"),
        (_exchanged_names, SlipKind.PARTS_EXCHANGED, "names of targets B and D"),
        (_target_in_m, SlipKind.UNIT, "points of target C"),
        (_target_frozen, SlipKind.FROZEN, "points of target C"),
        (_target_late, SlipKind.ROWS_SHIFTED, "points of target C"),
        (_target_turned, SlipKind.SIGN, "y_mm of target C"),
    ],
)
def test_a_slip_in_some_poses_or_of_one_target_is_named(change: Change, kind: SlipKind, quantity: str) -> None:
    points = _points()
    change(points)
    found = relate_poses(_body(points))
    assert found.state is RelationState.FAILS
    assert [(slip.kind, slip.quantity) for slip in found.slips] == [(kind, quantity)]


@pytest.mark.parametrize("first", [6, 9])
def test_without_a_majority_the_other_poses_are_equally_likely(first: int) -> None:
    points = _points()
    points[first:] /= 25.4
    found = relate_poses(_body(points))
    assert [(slip.factor, slip.subjects[0]) for slip in found.slips] == [(25.4, f"from pose P{first} on")]
    assert [slip.subjects[0] for slip in found.rivals] == [f"up to pose P{first - 1}"]


def test_three_targets_show_a_unit_and_no_mirror_image() -> None:
    points = _points(targets=3)
    _exchanged_axes(points)
    assert relate_poses(_body(points)).state is RelationState.OK
    _scaled(points)
    assert [slip.factor for slip in relate_poses(_body(points)).slips] == [25.4]


@pytest.mark.parametrize("size", [0.0, 5 * SIGMA, 1e-3])
def test_a_body_that_bends_and_a_target_that_moved_hold_no_slip(size: float) -> None:
    points = _points(seed=1) + size * np.random.default_rng(2).normal(size=(POSES, 5, 3))
    points[9:, 2] += 0.01
    found = relate_poses(_body(points))
    assert (found.state is RelationState.FAILS, found.slips) == (False, ())


@pytest.mark.parametrize("first", [9, 12])
def test_a_target_that_moved_on_a_body_at_rest_is_in_no_other_unit(first: int) -> None:
    part = _points()[0] - _points()[0].mean(axis=0)  # coordinates of the part, as of a coordinate measuring machine
    points = part + SIGMA * np.random.default_rng(3).normal(size=(POSES, 5, 3))
    points[first:, 2] += [2e-3, -1e-3, 0.0]
    assert relate_poses(_body(points)).slips == ()


def test_a_gross_error_in_the_first_pose_leaves_the_shape_as_it_is() -> None:
    points = _points()
    right = shape_of_poses(_pose_points(points)).points
    points[0, 2, 1] += 0.1
    shape = shape_of_poses(_pose_points(points)).points
    assert np.abs(_distances(shape) - _distances(right)).max() < 3 * SIGMA


def _pose_points(points: np.ndarray) -> PosePoints:
    cov = np.broadcast_to(SIGMA**2 * np.eye(3), (*points.shape[:2], 3, 3)).copy()
    return PosePoints(tuple(range(len(points))), NAMES[: points.shape[1]], points, cov, np.ones(points.shape[:2], bool))


def _distances(shape: np.ndarray) -> np.ndarray:
    return np.linalg.norm(shape[:, None] - shape, axis=-1)


def test_two_poses_do_not_show_which_one_is_right() -> None:
    body = _body(_points())
    assert relate_poses(body.subset(np.arange(2))).state is RelationState.NOT_TESTED
