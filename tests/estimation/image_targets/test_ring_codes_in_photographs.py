"""Ring-coded targets in rendered and real photographs: decoded numbers, and accuracy of the centres."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from tests.estimation.image_targets.pictures import ellipse_picture, photograph, ring_target_picture
from tests.estimation.image_targets.scenes import errors, rings
from truing.estimation.image_targets.circles import CirclePlan, measure_circles
from truing.estimation.image_targets.ring_codes import any_word, ring_code, smallest_turn


@pytest.mark.parametrize(
    ("bits", "axes", "blur", "dark"),
    [(8, (3, 3), 0.7, False), (12, (8, 4), 1.0, True), (12, (5, 5), 1.5, False), (14, (10, 7), 1.0, False)],
)
def test_codes_are_read_and_centres_are_not_pulled_by_their_rings(bits, axes, blur, dark):
    rng = np.random.default_rng(bits)
    code = ring_code(bits)
    words = rng.choice(code.words, 12)
    scene = rings(rng, axes, blur, 1.0, bits, words, invert=dark)
    found = measure_circles(scene.grey, CirclePlan(codes=(code,)))
    match, error, covariance = errors(found, scene.centre)
    assert sorted(match) == list(range(12))
    assert [code.words[number - 1] for number in found.code] == scene.word[match].tolist()
    assert found.names[0] == f"ring{bits}-{found.code[0]}"
    assert (found.white != dark).all()
    sigma = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    assert 0.4 < np.sqrt(np.mean((error / sigma) ** 2)) < 1.5
    assert np.abs(error).max() < 0.04


@pytest.mark.parametrize(("times", "dark"), [(1.5, False), (3.0, False), (2.0, True)])
def test_codes_in_light_beyond_the_range_are_read_and_centres_stay_as_sure_as_stated(times, dark):
    rng = np.random.default_rng(7)
    scene = rings(rng, (9, 6), 0.8, 0.7, 12, rng.choice(ring_code(12).words, 16), invert=dark)
    over = np.clip(np.rint((scene.grey.astype(float) - 30) * times * 255 / 180 + 30), 0, 255).astype(np.uint8)
    assert (over == 255).mean() > 0.05
    found = measure_circles(over, CirclePlan(codes=(ring_code(12),)))
    match, error, covariance = errors(found, scene.centre)
    assert sorted(match) == list(range(16))
    assert [ring_code(12).words[number - 1] for number in found.code] == scene.word[match].tolist()
    sigma = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    assert 0.4 < np.sqrt(np.mean((error / sigma) ** 2)) < 1.5
    assert np.abs(error.mean(0)).max() < 0.005


def test_a_sticker_is_not_taken_for_the_target_on_it():
    # a black dot on a round white label whose edge is as clear as its own, on a grey wall
    label = ellipse_picture(110, (54.3, 54.8), (25, 22), 0.3, 0.8)
    dot = ellipse_picture(110, (54.3, 54.8), (7, 6), 0.3, 0.8)
    grey = photograph(np.random.default_rng(4), 0.3 + 0.7 * label - 0.95 * dot, 20, 200, 1.0)
    found = measure_circles(grey, CirclePlan())
    np.testing.assert_allclose(found.semi_axes_px, [(7, 6)], atol=0.05)
    assert found.rejected["ground of another"] == 1


def test_a_ring_that_two_wanted_families_could_say_is_counted_as_such():
    scene = rings(np.random.default_rng(1), (8, 7), 0.8, 1.0, 8, [0b00110011, 0b00111111])
    both = measure_circles(scene.grey, CirclePlan(codes=(ring_code(8), ring_code(12))))
    assert both.names == ["ring8-9"]
    assert both.rejected["code of two families"] == 1
    alone = measure_circles(scene.grey, CirclePlan(codes=(ring_code(8),)))
    assert sorted(alone.names) == ["ring8-7", "ring8-9"]


def test_a_ring_half_hidden_by_what_is_nearly_its_ground_says_nothing():
    # what hides its lower side leaves another word of the family: opposite segments, and no others
    rng = np.random.default_rng(5)
    shown, left = 0b100100100001, 0b100000100000
    assert {smallest_turn(shown, 12), smallest_turn(left, 12)} <= set(ring_code(12).words)
    light = ring_target_picture(90, (44.5, 44.5), (8, 7), 0.0, 12, left, 0.0, 0.8)
    plan = CirclePlan(codes=(ring_code(12),))
    open_ring = photograph(rng, light, 30, 150, 1.0)
    assert measure_circles(open_ring, plan).count == 1
    light[55:] = np.maximum(light[55:], 0.16)
    found = measure_circles(photograph(rng, light, 30, 150, 1.0), plan)
    assert found.count == 0
    assert found.rejected["unreadable code"] == 1


def test_a_ring_hidden_by_its_grounds_own_colour_is_given_away_by_what_is_left_of_segments():
    shown, left = 0b100100100001, 0b100000100000
    whole, rest = (ring_target_picture(90, (44.5, 44.5), (8, 7), 0.0, 12, word, 1.0, 0.8) for word in (shown, left))
    y, x = np.mgrid[:90, :90] - 44.5
    rims = np.abs(np.hypot(x / 8, y / 7) - 2.5) > 0.3
    plan = CirclePlan(codes=(ring_code(12),))
    for hidden, count in ((rest, 1), (np.where(rims, whole, rest), 0)):
        found = measure_circles(photograph(np.random.default_rng(5), hidden, 30, 150, 1.0), plan)
        assert (found.code >= 0).sum() == count
    assert found.rejected["unreadable code"] == 1


def test_codes_of_another_family_are_counted_and_not_called_circles():
    rng = np.random.default_rng(1)
    scene = rings(rng, (8, 7), 0.8, 1.0, 12, ring_code(12).words[20:24])
    found = measure_circles(scene.grey, CirclePlan(codes=(ring_code(8),)))
    assert found.count == 0
    assert found.rejected["unreadable code"] == 4


def test_coded_targets_of_real_photographs_have_the_numbers_printed_next_to_them(real_data):
    folder = real_data / "target-images"
    plan = CirclePlan(codes=(any_word(8),), uncoded=False)
    first, second = (
        measure_circles(cv2.imread(str(folder / name), cv2.IMREAD_GRAYSCALE), plan)
        for name in ("cct_bit8_white.jpg", "cct_bit8_white2.jpg")
    )
    # all twelve that lie in the first picture whole, read off the paper
    assert sorted(first.code) == [7, 19, 19, 21, 21, 23, 23, 37, 39, 43, 43, 95]
    assert first.names[0].startswith("ring8_any-")
    assert set(first.kinds) == {"ring8"}
    # of the second, seen at up to 75 degrees, what is large enough
    assert sorted(second.code) == [13, 25, 27, 47, 47, 61, 63, 85, 255]
    # a telephone that sharpens: its edges are off their ellipses by a tenth of a pixel, and so the covariance says
    sigma = np.sqrt(np.diagonal(first.cov_px2, axis1=1, axis2=2))
    assert ((sigma > 0.01) & (sigma < 0.06)).all()
