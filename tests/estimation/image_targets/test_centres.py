"""Centres of circles in rendered photographs: no bias, and scatter as the covariance states."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2

from tests.estimation.image_targets.pictures import ellipse_picture, photograph
from tests.estimation.image_targets.scenes import dots, errors
from truing.estimation.image_targets.circles import CirclePlan, measure_circles

# semi-minor axis in px, tilt in degrees, blur in px, noise in grey levels
CASES = [
    (3, 0, 0.5, 1),
    (3, 0, 1.5, 1),
    (3, 60, 1.0, 2),
    (3, 60, 1.5, 1),
    (5, 30, 1.5, 5),
    (8, 0, 0.5, 5),
    (8, 60, 1.0, 1),
    (15, 60, 1.5, 2),
    (30, 0, 1.0, 3),
]


@pytest.mark.parametrize(("semi_minor", "tilt", "blur", "noise"), CASES)
def test_bias_is_under_a_fiftieth_of_a_pixel_and_scatter_as_stated(semi_minor, tilt, blur, noise):
    rng = np.random.default_rng(int(100 * semi_minor + tilt + 10 * blur + noise))
    axes = semi_minor / np.cos(np.radians(tilt)), semi_minor
    shapes = 9 if semi_minor < 10 else 3
    scene = dots(rng, axes, blur, noise, shapes, copies=36 // shapes)
    found = measure_circles(scene.grey, CirclePlan())
    match, error, covariance = errors(found, scene.centre)
    assert (match >= 0).all(), "something was found that is no target"
    assert len(set(match)) == len(match) >= 35
    sigma = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    assert (np.abs(error.mean(0)) < 0.02 + 3 * sigma.mean(0) / np.sqrt(len(error))).all()
    squares = np.einsum("ni,nij,nj->n", error, np.linalg.inv(covariance), error)
    low, high = chi2.ppf([1e-4, 1 - 1e-4], 2 * len(error)) / (2 * len(error))
    # what is known of the light's slope only on average, and noise of a picture full of targets, cost a fifth of sigma
    assert 0.5 * low < squares.sum() / (2 * len(error)) < 1.25 * high


@pytest.mark.parametrize(("semi_minor", "tilt", "blur"), [(3, 0, 1.5), (4, 60, 1.0), (8, 45, 0.6), (12, 30, 1.0)])
def test_without_noise_what_is_left_of_a_centre_is_rounding(semi_minor, tilt, blur):
    rng = np.random.default_rng(semi_minor)
    scene = dots(rng, (semi_minor / np.cos(np.radians(tilt)), semi_minor), blur, 0.0, 16, slope=0.0)
    match, error, _ = errors(measure_circles(scene.grey, CirclePlan()), scene.centre)
    assert sorted(match) == list(range(16))
    assert np.abs(error).max() < 0.012  # grey levels are whole numbers


def test_axes_and_angle_are_those_of_the_ellipse():
    rng = np.random.default_rng(4)
    for angle in (-1.2, 0.3, 1.5):
        grey = photograph(rng, ellipse_picture(120, (60.3, 58.8), (18, 11), angle, 0.8), 30, 180, 1.0)
        found = measure_circles(grey, CirclePlan())
        assert found.count == 1
        np.testing.assert_allclose(found.semi_axes_px[0], (18, 11), atol=0.03)
        np.testing.assert_allclose(found.axis_angle_rad[0], angle, atol=0.01)
        np.testing.assert_allclose(found.contrast, 180, rtol=0.01)
        assert found.white.all()
        assert found.names == [""]
        assert found.kinds == ["circle"]


def test_a_dot_brighter_than_the_range_keeps_its_centre():
    rng = np.random.default_rng(9)
    scene = dots(rng, (9, 6), 1.0, 2.0, 16, slope=0.0)
    bright = np.clip((scene.grey.astype(float) - 30) * 2.5 + 30, 0, 255).astype(np.uint8)
    assert (bright == 255).mean() > 0.03
    match, error, covariance = errors(measure_circles(bright, CirclePlan()), scene.centre)
    assert sorted(match) == list(range(16))
    assert np.abs(error.mean(0)).max() < 0.02
    sigma = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    assert 0.6 < np.sqrt(np.mean((error / sigma) ** 2)) < 1.5


def test_a_strong_slope_of_the_light_shifts_large_dots_by_less_than_a_fiftieth():
    rng = np.random.default_rng(10)
    scene = dots(rng, (15, 10), 1.0, 1.0, 16, slope=0.006)
    match, error, _ = errors(measure_circles(scene.grey, CirclePlan()), scene.centre)
    assert sorted(match) == list(range(16))
    assert np.sqrt(np.mean(error**2)) < 0.02


def test_sixteen_bits_give_what_eight_give():
    scene = dots(np.random.default_rng(2), (8, 6), 0.8, 2.0, 9)
    eight = measure_circles(scene.grey, CirclePlan())
    wide = measure_circles(scene.grey.astype(np.uint16) * 16, CirclePlan())
    assert eight.count == wide.count == 9
    near = np.linalg.norm(eight.centre_px[:, None] - wide.centre_px, axis=-1).argmin(1)
    np.testing.assert_allclose(wide.centre_px[near], eight.centre_px, atol=2e-3)
    np.testing.assert_allclose(wide.cov_px2[near], eight.cov_px2, rtol=0.15, atol=1e-6)


def test_a_dark_dot_is_as_good_as_a_light_one():
    scene = dots(np.random.default_rng(3), (8, 6), 0.8, 2.0, 16, slope=0.0)
    dark = measure_circles(255 - scene.grey, CirclePlan())
    match, error, _ = errors(dark, scene.centre)
    assert sorted(match) == list(range(16))
    assert not dark.white.any()
    assert np.sqrt(np.mean(error**2)) < 0.012
    assert measure_circles(255 - scene.grey, CirclePlan(polarity="white")).count == 0
