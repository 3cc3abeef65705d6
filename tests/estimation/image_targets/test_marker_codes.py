"""Codes of markers: all codes of all families agree with OpenCV in all rotations; other patterns are refused."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from tests.estimation.image_targets.planes import homography, marker_pattern, plane_picture
from tests.tolerance import assert_close
from truing.estimation.image_targets.marker_codes import FAMILIES, cells_across, codes_of, dictionary, read_codes
from truing.estimation.image_targets.square_markers import find_quadrangles, where_edges_meet

USUAL = ("aruco4x4_50", "aruco5x5_100", "aruco6x6_250", "apriltag36h11")


def sheet(family, codes):
    """Markers in a row, and their corners (N, 4, 2)."""
    edge = 4 * cells_across(family)
    grey = np.full((edge + 16, (edge + 16) * len(codes)), 220, np.uint8)
    corners = np.empty((len(codes), 4, 2))
    for k, code in enumerate(codes):
        x = k * (edge + 16) + 8
        grey[8 : 8 + edge, x : x + edge] = 30 + 0.7 * dictionary(family).generateImageMarker(code, edge)
        corners[k] = np.array([[0, 0], [edge, 0], [edge, edge], [0, edge]]) + np.array([x - 0.5, 7.5])
    return grey, corners


@pytest.mark.parametrize("family", FAMILIES)
def test_codes_of_every_family_are_read_from_whichever_corner_comes_first(family):
    codes = np.linspace(0, codes_of(family) - 2, 9).astype(int)  # the last one of aruco_original is symmetric
    grey, corners = sheet(family, codes.tolist())
    for turn in range(4):
        read = read_codes(grey, np.roll(corners, turn, axis=1), (family,))
        assert read.quad.tolist() == list(range(len(codes)))
        assert read.code.tolist() == codes.tolist()
        assert read.first.tolist() == [turn] * len(codes)
        assert not read.errors.any()
        assert float(read.unclear.max()) < 0.05


@pytest.mark.parametrize("turn", range(4))
@pytest.mark.parametrize("family", USUAL)
def test_markers_are_read_with_the_corners_that_opencv_gives_them(family, turn):
    tilted = np.array([[14.0, 20.0], [95.0, 9.0], [104.0, 98.0], [7.0, 88.0]])
    light = plane_picture(marker_pattern(family, 23), homography(np.roll(tilted, turn, axis=0)), 112, 0.6, fine=4)
    grey = np.rint(40 + 160 * light).astype(np.uint8)
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_CONTOUR
    expected, ids, _ = cv2.aruco.ArucoDetector(dictionary(family), parameters).detectMarkers(grey)
    quads = find_quadrangles(grey, 80)
    read = read_codes(grey, quads.corners, USUAL)
    assert ids.ravel().tolist() == [23]
    assert set(read.code.tolist()) == {23}
    assert {USUAL[number] for number in read.family.tolist()} == {family}
    fitted = where_edges_meet(quads.corners[read.quad], [quads.outlines[k] for k in read.quad])
    fitted = np.array([np.roll(corners, -first, axis=0) for corners, first in zip(fitted, read.first, strict=True)])
    # The outlines of one marker are several; that which OpenCV takes is one of them.
    apart = np.abs(fitted - expected[0].reshape(4, 2)).max((1, 2))
    assert_close(float(apart.min()), 0.0, atol=1e-3)
    assert float(apart.max()) < 2.0


def test_wrong_bits_are_corrected_to_a_third_of_what_the_family_allows():
    grey, corners = sheet("aruco6x6_250", [7] * 3)
    for k in range(3):
        for cell in range(k):
            x, y = (corners[k, 0] + 4.0 * np.array([2 + 2 * cell, 3]) + 0.5).astype(int)
            grey[y : y + 4, x : x + 4] = 250 - grey[y, x]
    read = read_codes(grey, corners, USUAL)
    assert dictionary("aruco6x6_250").maxCorrectionBits == 5
    assert read.quad.tolist() == [0, 1]
    assert read.code.tolist() == [7, 7]
    assert read.errors.tolist() == [0, 1]


def test_cells_of_another_size_than_the_markers_give_no_code():
    codes = list(range(60))
    grey, corners = sheet("aruco6x6_250", codes)
    smaller = tuple(name for name in FAMILIES if cells_across(name) < 8)
    assert read_codes(grey, corners, smaller).quad.tolist() == []
    assert read_codes(grey, corners, ("aruco6x6_250",)).code.tolist() == codes


def test_images_without_dark_border_or_contrast_give_no_code():
    grey, corners = sheet("aruco4x4_50", [1, 2])
    assert read_codes(255 - grey, corners, USUAL).quad.tolist() == []
    assert read_codes(np.full_like(grey, 100), corners, FAMILIES).quad.tolist() == []
    assert read_codes(grey, np.empty((0, 4, 2)), FAMILIES).quad.tolist() == []


def test_corners_of_outlines_are_where_lines_through_their_pixels_meet():
    grey = np.full((60, 80), 200, np.uint8)
    grey[10:31, 20:51] = 20
    grey[10, 20:24] = 200  # a bite at a corner
    quads = find_quadrangles(grey, 80)
    best = int(np.argmax([len(outline) for outline in quads.outlines]))
    fitted = where_edges_meet(quads.corners[[best]], [quads.outlines[best]])[0]
    expected = np.array([[20.0, 10.0], [50.0, 10.0], [50.0, 30.0], [20.0, 30.0]])
    assert_close(fitted[np.lexsort(fitted.round().T)], expected[np.lexsort(expected.T)], atol=0.5)
    assert where_edges_meet(np.empty((0, 4, 2)), []).shape == (0, 4, 2)


def test_lines_that_do_not_meet_leave_corners_where_they_are():
    flat = np.array([[0, 0], [1, 0], [2, 0], [3, 0], [4, 0], [5, 0], [6, 0], [7, 0]], np.int32)
    corners = flat[::2].astype(float)[None]
    assert_close(where_edges_meet(corners, [flat]), corners, atol=0.0)
