"""Shapes that are no targets are rejected, and counted by reason."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from tests.estimation.image_targets.pictures import ellipse_picture, photograph, pixel_weights
from truing.estimation.image_targets.circles import CirclePlan, measure_circles

SIZE = 160


def seen(*light, noise=1.5, seed=0, contrast=180):
    """A photograph of lights that add up, none of them above one."""
    rng = np.random.default_rng(seed)
    return photograph(rng, np.clip(sum(light), 0, 1), 30, contrast, noise)


def dot(x=80.0, y=80.0, axes=(10, 10), angle=0.0):
    return ellipse_picture(SIZE, (x, y), axes, angle, 0.8, step=0.1)


def shape(inside, blur=0.8, fine=8):
    """The light of whatever `inside` (a function of x and y) says, blurred and exposed."""
    at = (np.arange(SIZE * fine) + 0.5) / fine - 0.5
    weights = pixel_weights(SIZE, at, blur)
    return weights @ inside(at[None, :], at[:, None]).astype(float) @ weights.T


def only(found, reason):
    return found.count == 0 and found.rejected[reason] >= 1


def test_a_dot_alone_is_found_and_nothing_else():
    found = measure_circles(seen(dot()), CirclePlan())
    assert found.count == 1
    np.testing.assert_allclose(found.centre_px[0], 80, atol=0.03)


def test_dots_that_touch_are_not_measured():
    assert measure_circles(seen(dot(70), dot(89)), CirclePlan()).count == 0
    near = measure_circles(seen(dot(68), dot(92)), CirclePlan())  # a gap of four pixels: not free, but not wrong either
    for x, y in near.centre_px:
        assert min(abs(x - 68), abs(x - 92)) < 0.05
        assert abs(y - 80) < 0.05


@pytest.mark.parametrize("edge", [73, 78, 82, 85, 87])
def test_a_dot_partly_hidden_is_not_measured(edge):
    hidden = shape(lambda x, y: (np.hypot(x - 80, y - 80) < 10) & (x < edge))
    assert measure_circles(seen(hidden), CirclePlan()).count == 0


def test_a_scratch_over_the_edge_is_left_out_or_the_dot_with_it():
    scratch = shape(lambda x, y: (np.abs(y - 80 - 0.3 * (x - 80)) < 0.6) & (x > 85) & (x < 100))
    found = measure_circles(seen(dot(), scratch), CirclePlan())
    assert np.abs(found.centre_px - 80).max(initial=0) < 0.15


@pytest.mark.parametrize(
    ("name", "inside"),
    [
        ("square", lambda x, y: (np.abs(x - 80) < 9) & (np.abs(y - 80) < 9)),
        ("triangle", lambda x, y: (y > 68) & (y < 90 - 1.6 * np.abs(x - 80))),
        ("half", lambda x, y: (np.hypot(x - 80, y - 80) < 10) & (x < 80)),
        ("letter", lambda x, y: np.abs(np.hypot((x - 80) / 9, (y - 80) / 12) - 0.85) < 0.15),
        ("corner", lambda x, y: (x > 80) & (y > 80)),
        ("screw", lambda x, y: (np.hypot(x - 80, y - 80) < 10) & (np.abs(x - y) > 3)),
        ("wedge", lambda x, y: (np.hypot(x - 80, y - 80) < 10) & (np.abs(y - 80) > 0.5 * (x - 80))),
        ("bar", lambda x, y: (np.abs(x - 80) < 30) & (np.abs(y - 80) < 3)),
    ],
)  # fmt: skip
def test_a_shape_other_than_a_circle_is_no_target(name, inside):
    for polarity in (seen(shape(inside)), 240 - seen(shape(inside))):
        assert measure_circles(polarity, CirclePlan()).count == 0, name


def test_reasons_are_reported():
    assert only(measure_circles(seen(dot(4.0)), CirclePlan()), "at border")
    assert only(measure_circles(seen(dot(axes=(2.0, 2.0))), CirclePlan()), "too small")
    assert only(measure_circles(seen(dot(axes=(30, 30))), CirclePlan(largest_px=20.0)), "too large")
    assert only(measure_circles(seen(dot(axes=(24, 4))), CirclePlan()), "too oblique")
    assert only(measure_circles(seen(dot()), CirclePlan(uncoded=False)), "no code")


def test_light_close_next_to_a_dot_does_not_pull_its_centre():
    for edge in (91.5, 92.5, 94.0, 97.0):
        beside = shape(lambda x, y, edge=edge: x + 0 * y > edge)
        found = measure_circles(seen(dot(), beside), CirclePlan(polarity="white"))
        reasons = found.rejected["merged"] + found.rejected["no clear ground"] + found.rejected["not elliptical"]
        assert found.count == 1 or reasons
        assert np.abs(found.centre_px - 80).max(initial=0) < 0.02


def test_a_dot_much_fainter_than_the_others_is_counted_as_such():
    found = measure_circles(seen(dot(45), 0.07 * dot(115)), CirclePlan())
    assert found.count == 1
    assert found.rejected["weak contrast"] >= 1


def test_pictures_of_nothing_hold_nothing():
    rng = np.random.default_rng(0)
    for grey in (
        np.zeros((60, 80), np.uint8),
        np.full((5, 5), 200, np.uint8),
        rng.integers(0, 256, (300, 400)).astype(np.uint8),
        rng.normal(120, 8, (300, 400)).astype(np.uint16),
        np.add.outer(np.arange(200), np.arange(200)).astype(np.uint16),
    ):
        assert measure_circles(grey, CirclePlan()).count == 0


@pytest.mark.parametrize("grey", [np.zeros((4, 4, 3), np.uint8), np.zeros((9, 9)), np.zeros(9, np.uint8)])
def test_an_image_other_than_grey_is_refused(grey):
    with pytest.raises(ValueError, match="expected 2 of uint8"):
        measure_circles(grey, CirclePlan())


def test_small_dots_in_a_picture_made_of_a_mosaic_of_colours_are_not_called_hidden():
    rng = np.random.default_rng(3)
    tiles = np.array(
        [
            1 - 0.93 * ellipse_picture(36, rng.uniform(17.5, 18.5, 2), (4.3 + row * 0.15, 4.2), angle, 0.3)
            for row in range(8)
            for angle in range(8)
        ]
    )
    light = tiles.reshape(8, 8, 36, 36).swapaxes(1, 2).reshape(288, 288)
    mosaic = np.clip(8 * rng.poisson(6000 * light), 0, 65535).astype(np.uint16)
    coloured = (cv2.cvtColor(mosaic, cv2.COLOR_BayerRG2RGB) / 65535) ** (1 / 2.2)
    grey = cv2.cvtColor(np.rint(255 * coloured).astype(np.uint8), cv2.COLOR_RGB2GRAY)
    found = measure_circles(grey, CirclePlan())
    assert found.count == 64
    assert found.rejected["partly hidden"] == 0
