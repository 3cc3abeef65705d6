"""AICON's files: image coordinates in mm become pixels, distortion keeps its effect, scale bars keep their sigma."""

from __future__ import annotations

import gzip

import pytest

from tests.formats.reading import read, written
from tests.sentences import assert_says
from tests.tolerance import assert_close
from truing.formats.sniff import sniff_file

PITCH = 0.005
IOR = """\
       1     -999   -20.00000     0.10000    -0.05000 -1.00000e-004 2.00000e-007     10.000
                                               3.00000e-010
                                               4.00000e-006 -5.00000e-006
                                               -6.00000e-005 -7.00000e-005
                                                  20.00000    15.00000  4000  3000
"""
EOR = "       3      1   1.0  2.0  3.0  0.1 0.2 0.3 0 5 3\n       4      1   1.0  2.0  3.0  0.1 0.2 0.3 0 5 3\n"
PHC = """\
       3        6 1.000 2.000 0.0001 0.0002 0.0 0.0 1 1 1
       4        6 -1.000 0.000 0.0001 0.0002 0.0 0.0 1 1 1

       4        9 -1.000 0.000 0.0001 0.0002 0.0 0.0 1 0 1
"""
SCALE = '         0 "Scalebar"        506        507   1389.6880      0.0100  1\n'


def station(folder, **other):
    for ending, text in {"ior": IOR, "eor": EOR, "phc": PHC, "scale": SCALE, **other}.items():
        written(folder, f"station.{ending}", text)


RAYS = {"path": "station.phc", "constants": {"pose": 1}}


def test_rays_in_pixels(tmp_path):
    station(tmp_path)
    found = read(tmp_path, "image_points", RAYS)
    assert found.faults == ()
    assert found.columns["image"] == ["3", "4"]
    assert found.columns["point"] == ["6", "6"]
    assert found.columns["camera"] == ["1", "1"]
    assert_close(found.columns["x_px"], [1999.5 + 200.0, 1999.5 - 200.0], atol=1e-9)
    assert_close(found.columns["y_px"], [1499.5 - 400.0, 1499.5], atol=1e-9)
    assert sum(found.left_out.values()) == 1


def test_rays_of_a_compressed_file_find_what_lies_next_to_it(tmp_path):
    station(tmp_path)
    (tmp_path / "station.phc.gz").write_bytes(gzip.compress(PHC.encode()))
    assert len(read(tmp_path, "image_points", {**RAYS, "path": "station.phc.gz"}).rows) == 2


def test_a_camera_distorts_in_pixels_as_it_did_in_mm(tmp_path):
    station(tmp_path)
    (row,) = read(tmp_path, "cameras", {"path": "station.ior"}).rows
    x, y = 1.3, -0.8  # ideal image coordinates in mm, y upwards
    r2 = x * x + y * y
    radial = -1e-4 * (r2 - 1e2) + 2e-7 * (r2**2 - 1e4) + 3e-10 * (r2**3 - 1e6)
    dx = x * radial + 4e-6 * (r2 + 2 * x * x) + 2 * -5e-6 * x * y + -6e-5 * x + -7e-5 * y
    dy = y * radial + -5e-6 * (r2 + 2 * y * y) + 2 * 4e-6 * x * y
    xi, eta = x / PITCH, -y / PITCH
    q2, balanced = xi * xi + eta * eta, row["balancing_radius_px"]
    radial = sum(row[f"A{i}"] * (q2**i - balanced ** (2 * i)) for i in (1, 2, 3))
    px = xi * radial + row["B1"] * (q2 + 2 * xi * xi) + 2 * row["B2"] * xi * eta + row["C1"] * xi + row["C2"] * eta
    py = eta * radial + row["B2"] * (q2 + 2 * eta * eta) + 2 * row["B1"] * xi * eta
    assert_close([px, py], [dx / PITCH, -dy / PITCH], atol=1e-12)
    assert_close([row["focal_px"], row["x0_px"], row["y0_px"], row["pixel_um"]], [4000.0, 20.0, 10.0, 5.0], atol=1e-9)


def test_scale_bars(tmp_path):
    station(tmp_path)
    (row,) = read(tmp_path, "scale_bars", {"path": "station.scale"}).rows
    assert (row["bar"], row["first"], row["second"]) == ("Scalebar 0", "506", "507")
    assert (row["length_mm"], row["sigma_mm"]) == (1389.688, 0.01)


@pytest.mark.parametrize(
    ("ending", "old", "new", "expected"),
    [
        ("phc", "1.000 2.000", "1.000 x", "image, point, x y in mm"),
        ("phc", "1.000 2.000", "1.000 nan", "all of them finite"),
        ("phc", "       3        6", "       5        6", "images of station.eor"),
        ("ior", "   20.00000    15.00000  4000  3000\n", "", "five lines of a camera"),
        ("ior", " -999   -20.00000", " -999   20.00000", "Ck below 0"),
        ("ior", "  4000  3000", "  0  3000", "a width and a height above 0"),
        ("eor", "       3      1", "       3      2", "cameras of station.ior"),
        ("eor", "0 5 3\n", "\n", "lines of station.eor"),
    ],
)
def test_what_is_damaged_is_a_fault(tmp_path, ending, old, new, expected):
    good = {"phc": PHC, "ior": IOR, "eor": EOR}[ending]
    assert old in good
    station(tmp_path, **{ending: good.replace(old, new, 1)})
    (fault,) = read(tmp_path, "image_points", RAYS).faults
    assert expected in fault.expected


def test_without_the_size_of_the_pixels_there_are_no_rays(tmp_path):
    written(tmp_path, "station.phc", PHC)
    (fault,) = read(tmp_path, "image_points", RAYS).faults
    assert_says(fault.expected, ".ior file", "same name")


def test_orientations_of_images_are_no_points(tmp_path):
    station(tmp_path)
    guess = sniff_file(tmp_path / "station.eor")
    assert (guess.table, guess.mapping) == (None, {})
    assert "read along with" in guess.notes[0]


@pytest.mark.parametrize("ending", ["phc", "ior", "scale"])
def test_known_by_their_names(tmp_path, ending):
    station(tmp_path)
    guess = sniff_file(tmp_path / f"station.{ending}")
    found = read(tmp_path, guess.table, {"path": f"station.{ending}", **guess.mapping})
    assert found.faults == ()
    assert found.rows


def test_a_row_is_the_line_of_its_file(tmp_path):
    station(tmp_path)
    written(tmp_path, "station.scale", "\n" + SCALE)
    written(tmp_path, "two.ior", IOR + IOR.replace("1", "2", 1))
    assert read(tmp_path, "scale_bars", {"path": "station.scale"}).records == [1]
    assert read(tmp_path, "cameras", {"path": "two.ior"}).records == [0, 5]
