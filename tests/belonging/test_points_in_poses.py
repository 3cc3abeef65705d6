"""Slips in the points of some poses are named, with their axes if determined; deformation and gross errors are not."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from truing.belonging.body_point_tests import poses_with_slips, relate_survey, shifted_survey
from truing.belonging.body_points import AsOtherBody, BodyPoints
from truing.belonging.relation import RelationState, SlipKind

SIGMA = 1e-5
AWAY = np.array([0.4, -0.9, 1.6])  # of the body from the instrument, m


def _body(seed: int = 0, targets: int = 9, poses: int = 20, travel: float = 0.02) -> BodyPoints:
    rng = np.random.default_rng(seed)
    survey = rng.uniform(-0.2, 0.2, (targets, 3))
    turned = Rotation.from_rotvec(0.1 * rng.normal(size=(poses, 3))).as_matrix()
    moved = AWAY + travel * rng.normal(size=(poses, 3))
    points = np.einsum("bij,tj->bti", turned, survey) + moved[:, None] + SIGMA * rng.normal(size=(poses, targets, 3))
    names = tuple(f"P{pose}" for pose in range(poses))
    return BodyPoints("platform", survey, points, np.ones((poses, targets), bool), SIGMA, names)


def _changed(body: BodyPoints, rows: slice, change: Callable[[np.ndarray], np.ndarray]) -> BodyPoints:
    points = body.points.copy()
    points[rows] = change(points[rows])
    return replace(body, points=points)


@pytest.mark.parametrize(
    ("change", "kind", "quantity"),
    [
        pytest.param(lambda p: p * [1.0, -1.0, 1.0], SlipKind.SIGN, "y_mm of points", id="one sign"),
        pytest.param(lambda p: -p, SlipKind.SIGN, "x_mm and y_mm and z_mm of points", id="all signs"),
        pytest.param(lambda p: p[..., [2, 1, 0]], SlipKind.COLUMNS, "x_mm and z_mm of points", id="two axes"),
        pytest.param(lambda p: p[..., [1, 0, 2]] + [5.0, 3.0, 1.0], SlipKind.MIRRORED, "points", id="stood elsewhere"),
    ],
)
@pytest.mark.parametrize("rows", [slice(3, 8), slice(1, None, 2), slice(6, None)], ids=["few", "half", "most"])
def test_a_mirror_image_in_some_poses_is_reported_by_its_axes(
    change: Callable[[np.ndarray], np.ndarray], kind: SlipKind, quantity: str, rows: slice
) -> None:
    found = relate_survey(body := _changed(_body(), rows, change))
    assert found.state is RelationState.FAILS
    assert [(slip.kind, slip.quantity) for slip in found.slips] == [(kind, quantity)]
    assert np.flatnonzero(poses_with_slips(body)).tolist() == list(range(20))[rows]


def test_poses_that_travel_far_have_the_same_changed_axes_as_the_others() -> None:
    """If the travel is as large as the distance to the instrument, another change also explains single poses
    approximately."""
    for seed in range(5):
        body = _changed(_body(seed, travel=0.25), slice(8, None), lambda p: p * [1.0, 1.0, -1.0])
        (slip,) = relate_survey(body).slips
        assert (slip.kind, slip.quantity, slip.subjects) == (
            SlipKind.SIGN,
            "z_mm of points",
            ("from pose P8 on", "platform"),
        )


def _two_bodies(shift: int) -> tuple[np.ndarray, list[tuple[str, str]], list[BodyPoints]]:
    """A survey of two bodies with its rows moved down, its names, and the bodies read with it."""
    bodies = [replace(_body(seed), name=name, targets=tuple("ABCDEFGHI")) for seed, name in enumerate(("base", "tool"))]
    survey = np.roll(np.concatenate([body.survey for body in bodies]), shift, axis=0)
    names = [(body.name, target) for body in bodies for target in body.targets]
    own = [replace(body, survey=survey[9 * at : 9 * at + 9]) for at, body in enumerate(bodies)]
    return survey, names, own


@pytest.mark.parametrize("shift", [1, -2])
def test_a_survey_whose_rows_are_shifted_is_reported_once_for_all_bodies(shift: int) -> None:
    survey, names, bodies = _two_bodies(shift)
    tested = shifted_survey(survey, names, bodies)
    assert tested is not None
    assert [(slip.kind, slip.shift) for slip in tested.slips] == [(SlipKind.ROWS_SHIFTED, shift)]
    assert (tested.misfit_explained or np.inf) < 0.05 < (tested.misfit or 0.0)


def test_a_survey_in_another_order_is_no_shift() -> None:
    survey, names, bodies = _two_bodies(5)
    assert shifted_survey(survey, names, bodies) is None


def _bent(points: np.ndarray) -> np.ndarray:
    return points + 2e-3 * np.random.default_rng(3).normal(size=points.shape)


def _gross(points: np.ndarray) -> np.ndarray:
    points = points.copy()
    points[:, 2] += np.random.default_rng(4).uniform(-0.3, 0.3, (len(points), 3))
    return points


@pytest.mark.parametrize(
    ("rows", "change"),
    [
        pytest.param(slice(None), _bent, id="a body that is not rigid"),
        pytest.param(slice(4, 12), _bent, id="a body that bends in some poses"),
        pytest.param(slice(4, 12), _gross, id="a target that moved"),
        pytest.param(slice(None), lambda p: p * (1.0 + 5e-5), id="a scale that is 50 ppm off"),
        pytest.param(
            slice(4, 12), lambda p: p @ Rotation.from_rotvec([0, 0, np.pi]).as_matrix(), id="turned half round"
        ),
    ],
)
@pytest.mark.parametrize("targets", [4, 9])
def test_deformations_moved_targets_and_small_errors_of_scale_are_no_slip(
    rows: slice, change: Callable[[np.ndarray], np.ndarray], targets: int
) -> None:
    for seed in range(10):
        body = _changed(_body(seed, targets), rows, change)
        other = AsOtherBody(
            "base", np.random.default_rng([seed, 1]).uniform(-0.2, 0.2, (targets, 3)), body.points, body.is_observed
        )
        found = relate_survey(replace(body, others=(other,)))
        assert found.state is not RelationState.FAILS
        assert not found.slips


def test_two_labels_exchanged_on_a_symmetric_body_are_no_mirror_image() -> None:
    body = _body()
    survey = np.array([[0.2, 0.0, 0.0], [-0.2, 0.0, 0.0], [0.0, 0.1, 0.0], [0.0, -0.1, 0.15], [0.0, 0.15, 0.1]])
    points = survey + AWAY + SIGMA * np.random.default_rng(1).normal(size=(20, 5, 3))
    points[5:9] = points[5:9][:, [1, 0, 2, 3, 4]]
    found = relate_survey(replace(body, survey=survey, points=points, is_observed=np.ones((20, 5), bool)))
    assert not found.slips


def test_a_gross_error_within_a_stretch_does_not_split_it() -> None:
    body = _changed(_body(), slice(3, 12), lambda points: points * [-1.0, 1.0, 1.0])
    body = _changed(body, slice(6, 7), lambda points: points + np.eye(9, 3)[:, ::-1] * [0.0, 0.0, 0.03])
    (slip,) = relate_survey(body).slips
    assert slip.subjects == ("from pose P3 to pose P11", "platform")
    assert poses_with_slips(body)[6]


@pytest.mark.parametrize("step", [1e-3, 5e-4, 1e-4])
def test_a_survey_on_a_grid_is_not_taken_for_rounded_points(step: float) -> None:
    """Targets lie on the grid of the drawing, up to a tenth of a step, or at random within it."""
    for made in (0.1, 0.5):
        for seed in range(4):
            body = _body(seed)
            off = made * step * np.random.default_rng([seed, 2]).uniform(-1.0, 1.0, body.survey.shape)
            written = ((body.survey - off) / step).round() * step
            found = relate_survey(replace(body, survey=written))
            assert (found.state is RelationState.FAILS, found.reason == "rounded", found.slips) == (False, False, ())


@pytest.mark.parametrize("scale", [0.995, 0.9997, 1.0003, 1.001, 1.01])
def test_another_scale_is_reported_with_its_factor_and_is_neither_a_unit_nor_a_mirror_image(scale: float) -> None:
    body = _body(0)
    found = relate_survey(replace(body, survey=body.survey / scale))
    assert (found.state, found.reason) == (RelationState.ATTENTION, "scale")
    (slip,) = found.slips
    assert slip.kind is SlipKind.SCALE
    assert slip.factor == pytest.approx(1.0 / scale, abs=5e-5)
    assert found.misfit_explained < 0.5 * found.misfit
