"""COLMAP models, text and binary: rays, cameras and points, and faults of damaged files."""

from __future__ import annotations

import shutil
import struct

import numpy as np
import pytest

from tests.formats.colmap_files import binary
from tests.formats.reading import read, written
from tests.sentences import assert_says
from tests.tolerance import assert_close
from truing.formats.sniff import sniff_file

CAMERAS = """\
# Camera list with one line of data per camera:
1 OPENCV 4000 3000 4010.0 4000.0 2005.0 1497.0 -0.1 0.02 0.0003 -0.0004
7 SIMPLE_RADIAL 640 480 500.0 320.0 240.0 0.05
"""
IMAGES = """\
# Image list with two lines of data per image:
2 1.0 0.0 0.0 0.0 0.1 0.2 3.0 1 left view.jpg
100.5 200.5 11 300.0 400.0 -1
3 1.0 0.0 0.0 0.0 0.1 0.2 3.0 7 right.jpg

5 1.0 0.0 0.0 0.0 0.1 0.2 3.0 7 last.jpg
7.25 8.25 11
"""
POINTS = """\
# 3D point list with one line of data per point:
11 1.5 -2.5 3.5 10 20 30 0.7 2 0 5 0
"""
TEXT = {"cameras": CAMERAS, "images": IMAGES, "points3D": POINTS}
RAYS = {"path": "images.bin", "constants": {"pose": 1}}
MODELS = {"OPENCV": 4, "SIMPLE_RADIAL": 2, "FOV": 7}


@pytest.fixture(params=["bin", "txt"])
def model(request, tmp_path):
    for name in TEXT:
        if request.param == "bin":
            (tmp_path / f"{name}.bin").write_bytes(binary()[name])
        else:
            written(tmp_path, f"{name}.txt", TEXT[name])

    def entry(name, **constants):
        named = {} if request.param == "bin" else {"format": "colmap"}
        return {"path": f"{name}.{request.param}", **named, **({"constants": constants} if constants else {})}

    return tmp_path, entry


def test_rays_have_the_middle_of_the_first_pixel_at_zero(model):
    folder, entry = model
    found = read(folder, "image_points", entry("images", pose=1))
    assert found.faults == ()
    assert found.columns["image"] == ["left view.jpg", "last.jpg"]
    assert found.columns["camera"] == ["1", "7"]
    assert found.columns["point"] == ["11", "11"]
    assert_close(found.columns["x_px"], [100.0, 6.75], atol=0.0)
    assert_close(found.columns["y_px"], [200.0, 7.75], atol=0.0)
    assert sum(found.left_out.values()) == 1  # a feature that is no point in space


def test_a_camera_projects_as_it_did(model):
    folder, entry = model
    row, simple = read(folder, "cameras", entry("cameras")).rows
    assert (simple["width_px"], simple["free"]) == (640, "c x0 y0 A1")
    x, y = 0.21, -0.17
    r2 = x * x + y * y
    radial = 1 - 0.1 * r2 + 0.02 * r2**2
    u = 4010.0 * (x * radial + 2 * 0.0003 * x * y - 0.0004 * (r2 + 2 * x * x)) + 2005.0 - 0.5
    v = 4000.0 * (y * radial + 0.0003 * (r2 + 2 * y * y) - 2 * 0.0004 * x * y) + 1497.0 - 0.5
    xi, eta = row["focal_px"] * x, row["focal_px"] * y
    q2 = xi * xi + eta * eta
    radial = row["A1"] * q2 + row["A2"] * q2**2
    px = 1999.5 + row["x0_px"] + xi * (1 + radial + row["C1"])
    px += row["B1"] * (q2 + 2 * xi * xi) + 2 * row["B2"] * xi * eta
    py = 1499.5 + row["y0_px"] + eta * (1 + radial) + row["B2"] * (q2 + 2 * eta * eta) + 2 * row["B1"] * xi * eta
    assert_close([py], [v], atol=1e-9)
    assert_close([px], [u], atol=0.0025 * 4000.0 * 0.1 * r2 * x * 1.1)  # fx / fy - 1 times the distortion


def test_points_are_in_a_unit_of_their_own(model):
    folder, entry = model
    (row,) = read(folder, "points", {**entry("points3D", pose=1, body="b"), "unit": "2 mm"}).rows
    assert row["target"] == "11"
    assert_close([row["x_mm"], row["y_mm"], row["z_mm"]], [3.0, -5.0, 7.0], atol=0.0)


def test_each_file_is_known_by_its_look(model):
    folder, entry = model
    for name, table in (("images", "image_points"), ("cameras", "cameras"), ("points3D", "points")):
        guess = sniff_file(folder / entry(name)["path"])
        assert guess.table == table
        found = read(folder, table, {"path": entry(name)["path"], **guess.mapping})
        assert (found.faults, bool(found.rows)) == ((), True)


@pytest.mark.parametrize("name", ["cameras", "images", "points3D"])
def test_a_file_cut_anywhere_is_a_fault(tmp_path, name):
    whole = binary()[name]
    table = {"cameras": "cameras", "images": "image_points", "points3D": "points"}[name]
    for length in np.unique(np.linspace(1, len(whole) - 1, 40).astype(int)):
        (tmp_path / f"{name}.bin").write_bytes(whole[:length])
        found = read(tmp_path, table, {"path": f"{name}.bin", "constants": {"pose": 1, "body": "b"}})
        assert len(found.faults) == 1, length
        assert not found.rows


def test_a_count_beyond_the_file_costs_nothing(tmp_path):
    for count in (2**20, 2**40, 2**63):
        (tmp_path / "images.bin").write_bytes(struct.pack("<Q", count) + binary()["images"][8:])
        (fault,) = read(tmp_path, "image_points", RAYS).faults
        assert f"{count} records" in fault.expected
    rays = bytearray(binary()["images"])
    at = rays.index(b"left view.jpg\0") + 14
    rays[at : at + 8] = struct.pack("<Q", 2**60)
    (tmp_path / "images.bin").write_bytes(bytes(rays))
    (fault,) = read(tmp_path, "image_points", RAYS).faults
    assert "rays" in fault.expected


@pytest.mark.parametrize(
    ("name", "old", "new", "row", "expected"),
    [
        ("cameras", "OPENCV", "LENS", 2, "a camera: number, model"),
        ("cameras", " -0.0004\n", "\n", 2, "8 parameters of OPENCV"),
        (
            "cameras",
            "SIMPLE_RADIAL 640 480 500.0 320.0 240.0",
            "FOV 640 480 500.0 500.0 320.0 240.0",
            None,
            "perspective",
        ),
        ("images", "11 300.0 400.0 -1", "11 300.0 400.0", 3, "in threes"),
        ("images", "1.0 0.0 0.0 0.0 0.1 0.2 3.0 1 left", "1.0 x 0.0 0.0 0.1 0.2 3.0 1 left", 2, "an image: number"),
        ("images", "5 1.0 0.0 0.0 0.0 0.1 0.2 3.0 7 last.jpg\n7.25 8.25 11\n", "5 1.0\n", 6, "an image: number"),
        ("points3D", "3.5 10", "nan 10", 2, "all of them finite"),
    ],
)
def test_a_damaged_text_says_where(tmp_path, name, old, new, row, expected):
    assert old in TEXT[name]
    written(tmp_path, f"{name}.txt", TEXT[name].replace(old, new, 1))
    table = {"cameras": "cameras", "images": "image_points", "points3D": "points"}[name]
    entry = {"path": f"{name}.txt", "format": "colmap", "constants": {"pose": 1}}
    (fault,) = read(tmp_path, table, entry).faults
    assert expected in fault.expected
    assert fault.row == row


def test_another_table_is_not_there(tmp_path):
    (tmp_path / "images.bin").write_bytes(binary()["images"])
    shutil.copy(tmp_path / "images.bin", tmp_path / "cameras.bin")
    assert read(tmp_path, "cameras", {"path": "cameras.bin"}).faults
    (fault,) = read(tmp_path, "configurations", RAYS).faults
    assert_says(fault.expected, "image_points", "cameras", "points")


def test_a_row_of_a_text_is_the_line_of_its_file(tmp_path):
    for name, text in TEXT.items():
        written(tmp_path, f"{name}.txt", text)
    found = read(tmp_path, "image_points", {**RAYS, "path": "images.txt", "format": "colmap"})
    assert (found.faults, found.records) == ((), [2, 6])
    assert read(tmp_path, "cameras", {"path": "cameras.txt", "format": "colmap"}).records == [1, 2]
