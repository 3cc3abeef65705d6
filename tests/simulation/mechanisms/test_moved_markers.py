"""A displaced square marker moves as a whole, not corner by corner."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.simulation.bodies.body_campaign import body_model
from tests.tolerance import assert_close
from truing.simulation.bodies.model import BodyModel
from truing.simulation.mechanisms.causes.targets import TargetMoved, markers_of, rigid_patterns
from truing.simulation.mechanisms.point_causes import Photographed

NAMES = ("M.0", "M.1", "M.2", "M.3", "N.1", "N.2", "N.3", "17", "P.0", "P.1", "N.4")


def test_three_corners_make_a_marker_unless_they_are_all_of_the_body() -> None:
    bodies = ("plate",) * len(NAMES)
    assert markers_of(bodies, NAMES) == {("plate", "M"): (0, 1, 2, 3), ("plate", "N"): (4, 5, 6)}
    assert markers_of(("plate",) * 4, NAMES[:4]) == {}
    assert markers_of(("one",) * 2 + ("two",) * 9, NAMES) == {("two", "N"): (4, 5, 6)}


def test_turns_move_corners_as_far_as_shifts_do() -> None:
    places = np.array(
        [[0.0, 0, 0], [0.02, 0, 0], [0.02, 0.02, 0], [0, 0.02, 0], [0.1, 0, 0], [0.1, 0.05, 0], [0, 0, 0.1]]
    )
    corners, patterns = rigid_patterns([(0, 1, 2, 3), (4, 5, 6)], places)
    assert corners.tolist() == [[0, 1, 2, 3], [4, 5, 6, 4]]
    assert not patterns[1, 3].any()
    squares = np.sum(patterns**2, axis=(1, 2))
    assert_close(squares[:, 3:].sum(1), 2 * np.array([4.0, 3.0]), atol=1e-12, what="turns about three axes")


@pytest.fixture(scope="module")
def model() -> BodyModel:
    found = body_model(np.random.default_rng(3), 9)
    names = ("M.0", "M.1", "M.2", "T4", *found.targets.names[4:])
    return replace(found, targets=replace(found.targets, names=names))


def test_markers_are_tried_in_place_of_their_corners_where_photographs_name_them(model: BodyModel) -> None:
    (alone,) = TargetMoved().channel_candidates(model.scene)
    assert len(alone.channels) == 7
    single, markers = TargetMoved().channel_candidates(replace(model.scene, photographed=Photographed()))
    assert single.channels.tolist() == [3, 4, 5, 6]
    assert single.member(0, 0).subject == "target T4"
    found = markers.member(0, 2)
    assert (found.subject, found.settings()["corners"]) == ("marker M", ("M.0", "M.1", "M.2"))
    assert [p.name for p in found.parameters(0)] == ["dx", "dy", "dz", "turn_x", "turn_y", "turn_z"]
    assert TargetMoved().with_settings(**found.settings()) == found


def test_the_pattern_of_a_moved_marker_is_its_derivative_and_turns_are_exact(model: BodyModel) -> None:
    _, markers = TargetMoved().channel_candidates(replace(model.scene, photographed=Photographed()))
    found, shape = markers.member(0, 2), model.scene.shape
    state = model._recording(np.zeros(model.shared_size), np.zeros((9, model.local_size))).forward_pass.state
    scale = np.array([p.scale for p in found.parameters(0)])
    slope = found.change(state, np.zeros(6)).fields["moved"][-1, markers.channels[0, :3]] * scale
    assert_close(slope, markers.patterns[0, :3] * markers.scale, atol=1e-18, what="m per plausible size")
    turned = found.shift(state, np.array([0.01, 0.0, 0.0, 0.0, 0.0, np.pi]))["moved"]
    middle = shape[:3].mean(0)
    half_turned = middle + (shape[:3] - middle) * [-1, -1, 1] + [0.01, 0, 0]
    assert_close(shape[:3] + turned[-1, :3], half_turned, atol=1e-15, what="corners, m")
    assert not turned[:, 3:].any()
    assert not turned[0].any()
