"""Square markers: codes, corners without bias and with the stated scatter, and refusal of other shapes."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2

from tests.estimation.image_targets.planes import exposed, homography, marker_pattern, plane_picture, through
from tests.tolerance import assert_between, assert_close
from truing.estimation.image_targets import square_markers
from truing.estimation.image_targets.image_noise import ImageNoise
from truing.estimation.image_targets.marker_codes import FAMILIES, codes_of
from truing.estimation.image_targets.square_markers import measure_markers

FAMILY = ("aruco4x4_50", "apriltag36h11")
CELL, ACROSS, DRAWS = 100, 2, 12
NOISE = ImageNoise(2.0**2 + 1 / 12, 0.0)
SQUARE = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]])


def seen(rng, edge, at):
    """Four corners of a marker, turned, tilted, anywhere within a pixel."""
    a = rng.uniform(0.0, 2.0 * np.pi)
    turn = np.array([[np.cos(a), -np.sin(a)], [np.sin(a), np.cos(a)]])
    tilted = (SQUARE * [1.0, rng.uniform(0.75, 1.0)]) @ turn.T * (1.0 + 0.08 * rng.uniform(-1, 1, (4, 1)))
    return edge * tilted + at + rng.uniform(-0.5, 0.5, 2)


@pytest.fixture(scope="module")
def sheet():
    """The light of a sheet of markers, and where the corners are: (family, code) to (4, 2)."""
    rng = np.random.default_rng(1)
    light, truth = np.ones((ACROSS * CELL, 2 * ACROSS * CELL)), {}
    for k in range(2 * ACROSS**2):
        family, code = k % 2, 3 * k
        y, x = CELL * np.array(divmod(k, 2 * ACROSS))
        corners = seen(rng, 56.0 + 6 * family, CELL / 2)
        H = homography(corners)
        light[y : y + CELL, x : x + CELL] = plane_picture(marker_pattern(FAMILY[family], code), H, CELL, 0.5 + 0.1 * k)
        truth[family, code] = corners + np.array([x, y])
    return light, truth


def keys(found):
    return list(zip(found.family.tolist(), found.code.tolist(), strict=True))


def test_codes_are_read_and_corners_are_where_they_are_with_the_scatter_that_they_state(sheet):
    light, truth = sheet
    rng = np.random.default_rng(2)
    errors, expected = [], []
    for _ in range(DRAWS):
        found = measure_markers(exposed(light, rng), FAMILY, NOISE)
        assert set(keys(found)) == set(truth)
        assert not found.rejected
        order = np.lexsort([found.corner, found.code, found.family])
        where = np.array([truth[key][k] for key, k in zip(keys(found), found.corner.tolist(), strict=True)])
        errors.append((found.xy_px - where)[order])
        expected.append(found.cov_px2[order])
    mean, cov = np.mean(errors, axis=0), np.mean(expected, axis=0)
    sigma = np.sqrt(np.einsum("nii->ni", cov))
    # Over draws what is left of noise is a twelfth of its variance; beyond that no corner is off by a fiftieth pixel.
    assert_close(mean, np.zeros_like(mean), atol=0.02 + 4.0 * float(np.max(sigma)) / np.sqrt(DRAWS))
    systematic = np.mean(mean**2) - np.mean(sigma**2) / DRAWS
    assert_between(float(systematic), -1.0, 0.01**2, what="mean square of what noise does not explain")
    # Two corners share each edge: half of the coordinates are taken to be independent.
    z2 = np.einsum("dni,nij,dnj->dn", errors - mean, np.linalg.inv(cov), errors - mean).sum()
    freedom = (DRAWS - 1) * mean.size / 2
    low, high = chi2.ppf([1e-4, 1 - 1e-4], freedom) / freedom
    assert_between(float(z2 / (2 * freedom)), low, high, what="scatter over the stated one")


def test_sixteen_bits_say_the_same(sheet):
    grey = exposed(sheet[0], np.random.default_rng(3))
    grey[0, :2] = 0, 255
    plain = measure_markers(grey, FAMILY, NOISE)
    deep = measure_markers(grey.astype(np.uint16) * 257, FAMILY, ImageNoise(NOISE.read_var * 257.0**2, 0.0))
    assert keys(deep) == keys(plain)
    assert_close(deep.xy_px, plain.xy_px, atol=1e-6)
    assert_close(deep.cov_px2, plain.cov_px2, atol=1e-8)


def test_a_large_marker_is_fitted_at_its_ends():
    rng = np.random.default_rng(4)
    corners = seen(rng, 150.0, 120.0)
    light = plane_picture(marker_pattern("aruco4x4_50", 7), homography(corners), 240, 0.8)
    found = measure_markers(exposed(light, rng), ("aruco4x4_50",), NOISE)
    assert_close(found.xy_px, corners, atol=0.01 + 4.0 * float(np.sqrt(found.cov_px2.max())))
    assert found.corner.tolist() == [0, 1, 2, 3]


def test_a_code_seen_twice_in_an_image_is_not_used(sheet):
    light, _ = sheet
    grey = exposed(np.concatenate([light, light[:CELL]]), np.random.default_rng(5))
    found = measure_markers(grey, FAMILY, NOISE)
    assert len(keys(found)) == 4 * 2 * ACROSS * (ACROSS - 1)
    assert {reason for _, reason in found.rejected} == {"code seen twice in one image"}
    assert sum(found.rejected.values()) == 4 * ACROSS


def test_a_code_of_two_families_is_of_the_first_and_the_other_is_counted(sheet):
    grey = exposed(sheet[0], np.random.default_rng(8))
    found = measure_markers(grey, ("aruco4x4_100", "aruco4x4_50"), NOISE)
    assert set(keys(found)) == {(0, code) for family, code in sheet[1] if family == 0}
    assert found.rejected == {(1, "read as a code of another family, too"): ACROSS**2}


def test_blurred_or_small_markers_are_refused_with_the_reason():
    rng = np.random.default_rng(6)
    corners = seen(rng, 40.0, 40.0)
    light = plane_picture(marker_pattern("apriltag36h11", 7), homography(corners), 80, 1.4)
    found = measure_markers(exposed(light, rng), FAMILY, NOISE)
    assert len(found.code) == 0
    reasons = {reason for _, reason in found.rejected}
    assert reasons <= {"cells too small for the blur", "no straight edges from dark to light"}
    assert len(reasons) == 1


@pytest.mark.parametrize("grey", [np.zeros((16, 16), np.uint8), np.full((40, 60), 65535, np.uint16)])
def test_an_empty_image_has_no_markers(grey):
    found = measure_markers(grey, FAMILY, NOISE)
    assert found.xy_px.shape == (0, 2)
    assert not found.rejected


def test_families_have_the_stated_number_of_codes():
    assert [codes_of(name) for name in ("aruco4x4_50", "aruco7x7_1000", "apriltag36h11", "apriltag16h5")] == [
        *(50, 1000, 587, 30)
    ]
    assert len(FAMILIES) == 22
    assert through(homography(SQUARE), np.array([[0.5, 0.5]])).tolist() == [[0.0, 0.0]]


def test_a_large_image_is_searched_at_half_its_size_and_measured_at_the_whole(sheet, monkeypatch):
    grey = exposed(sheet[0], np.random.default_rng(7))
    whole = measure_markers(grey, FAMILY, NOISE)
    monkeypatch.setattr(square_markers, "_LARGE", grey.size // 2)
    half = measure_markers(grey, FAMILY, NOISE)
    assert keys(half) == keys(whole)
    # Which pixels at the rim of an edge's band count depends on the start: a part of a standard deviation.
    assert_close(half.xy_px, whole.xy_px, atol=0.5 * float(np.sqrt(whole.cov_px2.max())))
