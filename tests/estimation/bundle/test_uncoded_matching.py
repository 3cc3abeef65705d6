"""Circles without a code are matched along epipolar lines, and ambiguous ones are left out."""

from dataclasses import replace

import numpy as np
import pytest

from truing.estimation.bundle import uncoded_matching
from truing.estimation.bundle.uncoded_matching import Circles, OrientedImages, match_uncoded

from .photographed import HEIGHT, WIDTH, simulate

BOX = np.array([[-0.7] * 3, [0.7] * 3])


def oriented(made, covariance=0.0):
    network, truth = made.network, made.truth
    cov = np.broadcast_to(covariance * np.eye(6), (len(truth.R), 6, 6))
    return OrientedImages(network.cameras, truth.interior, network.image_camera, truth.R, truth.centre, cov, BOX)


def circles_of(made, strays, rng):
    """All rays without their names, and strays that belong to nothing."""
    rays = made.network.rays
    image = np.concatenate([rays.image, rng.integers(0, len(made.truth.R), strays)])
    xy = np.concatenate([rays.xy_px, rng.uniform(0, [WIDTH - 1, HEIGHT - 1], (strays, 2))])
    cov = np.broadcast_to(rays.cov_px2[0], (len(image), 2, 2))
    return Circles(image, xy, cov), np.concatenate([rays.point, np.full(strays, -1)])


def test_circles_are_matched_and_strays_are_not():
    rng = np.random.default_rng(0)
    made = simulate(seed=1, images=10, points=120)
    circles, truth = circles_of(made, 150, rng)
    found = match_uncoded(circles, oriented(made))
    assert (found.point[truth >= 0] >= 0).mean() > 0.995
    assert (found.point[truth < 0] >= 0).sum() <= 2
    first = np.array([truth[found.point == k][0] for k in range(len(found.xyz_m))])
    matched = found.point >= 0
    assert (truth[matched] == first[found.point[matched]]).mean() > 0.998
    off = found.xyz_m - made.truth.points[first]
    chi2 = np.einsum("ki,kij,kj->k", off, np.linalg.inv(found.cov_m2), off)
    assert chi2.mean() / 3 == pytest.approx(1.0, abs=0.3)
    assert len(found.reason) == len(truth)
    assert found.reason.count("") == matched.sum()


def test_an_orientation_in_doubt_widens_the_search():
    rng = np.random.default_rng(1)
    made = simulate(seed=2, images=8, points=40)
    circles, _ = circles_of(made, 0, rng)
    sigma = 1e-3  # m and rad: a few pixels
    moved = made.truth.centre + rng.normal(0, sigma, made.truth.centre.shape)
    loose = replace(oriented(made, sigma**2), centre=moved)
    tight = replace(loose, covariance=np.zeros_like(loose.covariance))
    assert (match_uncoded(circles, loose).point >= 0).mean() > 0.95
    assert (match_uncoded(circles, tight).point >= 0).mean() < 0.5


def test_circles_that_lie_on_each_others_lines_are_left_alone():
    made = simulate(seed=3, images=3, points=2, missed=0.0)
    circles, _ = circles_of(made, 0, np.random.default_rng(0))
    cov = np.broadcast_to(np.eye(2) * 1e6, circles.cov_px2.shape)  # any circle fits any other
    found = match_uncoded(replace(circles, cov_px2=cov), oriented(made))
    assert len(found.xyz_m) <= 1
    assert (found.point >= 0).sum() <= 3


def test_images_without_orientation_and_lone_circles_are_reported():
    made = simulate(seed=4, images=6, points=30)
    circles, truth = circles_of(made, 1, np.random.default_rng(2))
    images = oriented(made)
    centre = images.centre.copy()
    centre[2] = np.nan
    found = match_uncoded(circles, replace(images, centre=centre))
    reasons = np.array(found.reason)
    assert (reasons[circles.image == 2] == uncoded_matching.NOT_ORIENTED).all()
    assert reasons[truth < 0][0] in (uncoded_matching.NO_PARTNER, uncoded_matching.TOO_FEW)
