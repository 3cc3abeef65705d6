"""PhotoModeler's text, Metashape's XML and Leica's GSI: rays, cameras and points in the conventions of each program."""

from __future__ import annotations

import numpy as np
import pytest

from tests.formats.reading import read, written
from tests.tolerance import assert_close
from truing.formats.sniff import sniff_file

PHOTOMODELER = """\
Bundle Soln of a title of its own
 0.000500 20 2000 1500
 1.00000  0.10000 10.00000 100.00000 100.00000 100.00000 20.00000 20.00000 20.00000
 7.4000  4.1000  2.9000 8.00000 6.00000 4.976e-3 -1.030e-4 0 -6.800e-5 -3.200e-5
 0.00000  0.00725  0.00544 0.500000 0.500000 0.001000 0.000100 0.000100 0.001000 0.001000
   0 e:\\photos\\of one P1.JPG
   0    0.312   -0.448    1.193   22.657   13.568   35.000
   0   0.0003   0.0002   0.0002   0.0040   0.0040   0.0060

   0   7.400   4.100   2.900 8.00000 6.00000 0.00498 -0.00010 0.00000 -0.00007 -0.00003
   0  0.00000  0.00725  0.00544 0.500000 0.500000 0.001000 0.000100 0.000100 0.001000 0.001000
   4 e:\\photos\\P2.JPG
   4   -0.426    0.187    1.261   -6.201  -18.565  -50.000
   4   0.0003   0.0002   0.0002   0.0041   0.0043   0.0062

   4   7.400   4.100   2.900 8.00000 6.00000 0.00498 -0.00010 0.00000 -0.00007 -0.00003
   4  0.00000  0.00725  0.00544 0.500000 0.500000 0.001000 0.000100 0.000100 0.001000 0.001000

    1001   -0.50000    0.50000    0.00000  -1.778088  -1.778088  -1.778088

       2    0.11750    0.28200    0.00400   0.000051   0.000048   0.000082
    1001   -0.50000    0.50000    0.00000  -1.778088  -1.778088  -1.778088

   0        2 1519.3456  577.6241  0.10000  0.20000
   4        2  964.3987  333.6040  0.10000  0.10000

   1 2 3
"""
XML = """\
<?xml version="1.0" encoding="UTF-8"?>
<document version="1.5.0">
  <chunk label="Chunk 1" enabled="true">
    <sensors next_id="1">
      <sensor id="0" label="a camera" type="frame">
        <resolution width="4000" height="3000"/>
        <property name="pixel_width" value="0.005"/>
        <calibration type="frame" class="adjusted">
          <resolution width="4000" height="3000"/>
          <f>4000</f><cx>3</cx><cy>-4</cy><k1>-0.08</k1><k2>0.01</k2><k3>-0.001</k3><p1>0.0002</p1><p2>-0.0003</p2>
          <b1>0</b1><b2>0</b2>
        </calibration>
      </sensor>
    </sensors>
    <cameras><camera id="0" sensor_id="0" label="IMG_1"/><camera id="3" sensor_id="0" label="IMG_2"
    enabled="false"/></cameras> <markers><marker id="0" label="target 1"><reference x="0" y="0"
    z="0"/></marker><marker id="5" label="bar"/></markers> <frames><frame id="0"><markers>
      <marker marker_id="0">
        <location camera_id="0" pinned="true" x="2000.5" y="1500.5"/>
        <location camera_id="3" pinned="true" x="1.5" y="2.5"/>
      </marker>
      <marker marker_id="5"><location camera_id="0" pinned="false" x="10.25" y="20.5"/></marker>
    </markers></frame></frames>
  </chunk>
</document>
"""
GSI8 = """\
410001+00000012 42....+00001810
110002+0000A110 81..00+00005387 82..00-00000992 83..06+00012345
110003+00000111 81..08+12345678 82..00-00000992 51....+0000+000
110004+00000112 81..01+00001000 82..07+00010000 83..00+00000000
"""
GSI16 = """\
*110001+000000000PNC0055 81..06+0000000013384650 82..06-0000000000000001 83..06+0000000000000000
"""
POSE = {"constants": {"pose": 1}}


def test_photomodelers_marks(tmp_path):
    written(tmp_path, "export.txt", PHOTOMODELER)
    entry = {"path": "export.txt", "format": "photomodeler", **POSE}
    found = read(tmp_path, "image_points", entry)
    assert found.faults == ()
    assert found.columns["image"] == ["of one P1.JPG", "P2.JPG"]
    assert (found.columns["point"], found.columns["camera"]) == (["2", "2"], ["camera", "camera"])
    assert_close(found.columns["x_px"], [1518.8456, 963.8987], atol=1e-9)
    assert_close(found.columns["sigma_y_px"], [0.2, 0.1], atol=0.0)
    points = read(tmp_path, "points", {**entry, "constants": {"pose": 1, "body": "b"}})
    assert points.columns["target"] == ["2", "1001"]
    assert_close(points.columns["x_mm"], [117.5, -500.0], atol=1e-9)
    assert points.columns["sigma_z_mm"] == [pytest.approx(0.082), None]


def test_photomodelers_camera_corrects_what_ours_distorts(tmp_path):
    written(tmp_path, "export.txt", PHOTOMODELER)
    (row,) = read(tmp_path, "cameras", {"path": "export.txt", "format": "photomodeler"}).rows
    px, pitch = np.stack(np.meshgrid(np.linspace(0, 1999, 9), np.linspace(0, 1499, 7)), -1).reshape(-1, 2), 0.004
    mm = (px + 0.5) * pitch - [4.1, 2.9]
    x, y = mm.T
    r2 = x * x + y * y
    radial = 0.00498 * r2 - 0.0001 * r2**2
    ideal = mm * (1 + radial[:, None]) + np.stack(
        [-7e-5 * (r2 + 2 * x * x) - 6e-5 * x * y, -3e-5 * (r2 + 2 * y * y) - 14e-5 * x * y], -1
    )
    xi, eta = (ideal / pitch).T
    q2 = xi * xi + eta * eta
    radial = row["A1"] * q2 + row["A2"] * q2**2 + row["A3"] * q2**3
    u = 999.5 + row["x0_px"] + xi * (1 + radial) + row["B1"] * (q2 + 2 * xi * xi) + 2 * row["B2"] * xi * eta
    v = 749.5 + row["y0_px"] + eta * (1 + radial) + row["B2"] * (q2 + 2 * eta * eta) + 2 * row["B1"] * xi * eta
    distortion = np.abs(ideal - mm).max() / pitch
    assert_close(np.stack([u, v], -1), px, atol=0.02 * distortion)  # a camera to start from
    assert_close([row["focal_px"], row["x0_px"], row["y0_px"]], [1850.0, 25.0, -25.0], atol=1e-9)


def test_metashapes_projections(tmp_path):
    written(tmp_path, "markers.xml", XML)
    entry = {"path": "markers.xml", **POSE}
    found = read(tmp_path, "image_points", entry)
    assert found.faults == ()
    assert (found.columns["image"], found.columns["point"]) == (["IMG_1", "IMG_1"], ["target 1", "bar"])
    assert_close(found.columns["x_px"], [2000.0, 9.75], atol=0.0)
    assert sum(found.left_out.values()) == 1
    pinned = read(tmp_path, "image_points", {**entry, "select": {"used": "1", "pinned": "true"}})
    assert pinned.columns["point"] == ["target 1"]
    (row,) = read(tmp_path, "cameras", {"path": "markers.xml"}).rows
    assert (row["camera"], row["focal_px"], row["pixel_um"]) == (found.columns["camera"][0], 4000.0, 5.0)
    expected = [3.0, -4.0, -0.08 / 4e3**2, 0.01 / 4e3**4, -0.001 / 4e3**6, 0.0002 / 4e3, -0.0003 / 4e3]
    values = [row[name] for name in ("x0_px", "y0_px", "A1", "A2", "A3", "B1", "B2")]
    assert_close(np.divide(values, expected), np.ones(7), atol=1e-12)


def test_metashapes_xml_is_not_nested_without_end(tmp_path):
    written(tmp_path, "markers.xml", "<document>\n" + "<a>" * 100_000 + "</a>" * 100_000 + "\n</document>")
    (fault,) = read(tmp_path, "image_points", {"path": "markers.xml", **POSE}).faults
    assert fault.row == 2
    assert "nested" in fault.expected


def test_coordinates_that_somebody_gave_are_not_measured_points(tmp_path):
    written(tmp_path, "markers.xml", XML)
    (fault,) = read(tmp_path, "points", {"path": "markers.xml", **POSE}).faults
    assert "image_points or cameras" in fault.expected


def test_gsi_in_the_unit_of_each_word(tmp_path):
    written(tmp_path, "p.gsi", GSI8)
    found = read(tmp_path, "points", {"path": "p.gsi", "constants": {"pose": 1, "body": "b"}})
    assert found.faults == ()
    assert found.columns["target"] == ["A110", "112"]
    assert_close(found.columns["x_mm"], [5387.0, 304.8], atol=1e-9)
    assert_close(found.columns["y_mm"], [-992.0, 304.8], atol=1e-9)
    assert_close(found.columns["z_mm"], [1234.5, 0.0], atol=1e-9)
    assert sum(found.left_out.values()) == 1  # a point without height
    written(tmp_path, "q.txt", GSI16)
    guess = sniff_file(tmp_path / "q.txt")
    (row,) = read(tmp_path, "points", {"path": "q.txt", **guess.mapping, "constants": {"pose": 1, "body": "b"}}).rows
    assert (row["target"], row["x_mm"], row["y_mm"]) == ("PNC0055", pytest.approx(1338465.0), pytest.approx(-0.1))


@pytest.mark.parametrize(
    ("name", "text", "old", "new", "expected", "row"),
    [
        ("p.txt", PHOTOMODELER, "20 2000 1500", "20", "width and height of the photos", 2),
        ("p.txt", PHOTOMODELER, "   4   7.400", "   5   7.400", "a photo in six lines", 12),
        ("p.txt", PHOTOMODELER, "964.3987", "oops", "a mark: photo, point", 25),
        ("p.txt", PHOTOMODELER, "   4        2  964", "   9        2  964", "marks on photos of the file", 25),
        ("p.xml", XML, "</chunk>", "", "an undamaged XML file", 25),
        ("p.xml", XML, 'camera_id="3"', 'camera_id="8"', "markers and cameras that the file lists", 20),
        ("p.xml", XML, 'x="10.25"', 'x="inf"', "a number", 22),
        ("p.xml", XML, "<document", "<!DOCTYPE d [<!ENTITY a 'a'>]><document", "without declarations", None),
    ],
)
def test_what_is_damaged_is_a_fault(tmp_path, name, text, old, new, expected, row):
    assert old in text
    written(tmp_path, name, text.replace(old, new, 1))
    entry = {"path": name, **({"format": "photomodeler"} if name == "p.txt" else {}), **POSE}
    found = read(tmp_path, "image_points", entry)
    (fault,) = found.faults
    assert expected in fault.expected
    assert fault.row == row


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("81..00", "81..02", "digits, and a unit of"),
        ("+00005387", "+000053870", "words of GSI-8"),
        ("+000053", "+0000x3", "digits"),
    ],
)
def test_a_damaged_gsi_says_where(tmp_path, old, new, expected):
    assert old in GSI8
    written(tmp_path, "p.gsi", GSI8.replace(old, new, 1))
    (fault,) = read(tmp_path, "points", {"path": "p.gsi", "constants": {"pose": 1, "body": "b"}}).faults
    assert (expected in fault.expected, fault.row) == (True, 2)


@pytest.mark.parametrize(("name", "text"), [("a.txt", PHOTOMODELER), ("a.xml", XML)])
def test_known_by_their_look(tmp_path, name, text):
    written(tmp_path, name, text)
    guess = sniff_file(tmp_path / name)
    assert guess.table == "image_points"
    assert len(read(tmp_path, "image_points", {"path": name, **guess.mapping}).rows) == 2


MARKS = """
   0        2 1519.3456  577.6241  0.10000  0.20000
   0        2  300.5000  400.5000  0.00000  0.00000
   0        3  310.5000  410.5000  0.00000  0.00000
   4        2  964.3987  333.6040  0.10000  0.10000
   4        2  320.5000  420.5000  0.00000  0.00000
   4        3  330.5000  430.5000  0.00000  0.00000
"""


def test_photomodelers_marks_without_a_sigma_state_none_and_may_bear_the_number_of_another_point(tmp_path):
    """Matched points have marks of sigma 0 and numbers of their own, on the photos and among the object points."""
    before, _, after = PHOTOMODELER.partition("\n   0        2 1519")
    matched = "       2    0.11428    0.24304   -0.00199   0.000144   0.000143   0.000175\n"
    written(tmp_path, "export.txt", f"{before}{matched}{MARKS}{after.partition('0.10000  0.10000')[2]}")
    entry = {"path": "export.txt", "format": "photomodeler", **POSE}
    found = read(tmp_path, "image_points", entry)
    assert found.faults == ()
    assert found.columns["point"] == ["2", "smart 2", "3", "2", "smart 2", "3"]
    assert found.columns["sigma_x_px"] == [0.1, None, None, 0.1, None, None]
    points = read(tmp_path, "points", {**entry, "constants": {"pose": 1, "body": "b"}})
    assert points.columns["target"] == ["2", "1001", "smart 2"]


def test_a_number_that_no_photo_shows_twice_is_one_point_with_and_without_a_sigma(tmp_path):
    text = PHOTOMODELER.replace("964.3987  333.6040  0.10000  0.10000", "964.3987  333.6040  0.00000  0.00000")
    written(tmp_path, "export.txt", text)
    found = read(tmp_path, "image_points", {"path": "export.txt", "format": "photomodeler", **POSE})
    assert found.columns["point"] == ["2", "2"]
    assert found.columns["sigma_x_px"] == [0.1, None]


@pytest.mark.parametrize(
    ("name", "text", "table", "column", "begins"),
    [
        ("p.txt", PHOTOMODELER, "image_points", "x_px", ["   0        2 1519", "   4        2  964"]),
        ("p.txt", PHOTOMODELER, "points", "target", ["       2    0.11", "    1001   -0.50"]),
        ("p.txt", PHOTOMODELER, "cameras", "camera", ["   0 e:"]),
        ("p.xml", XML, "image_points", "x_px", ['        <location camera_id="0"', '      <marker marker_id="5"']),
    ],
)
def test_a_row_of_an_export_is_the_line_of_its_file(tmp_path, name, text, table, column, begins):
    written(tmp_path, name, text)
    constants = {} if table == "cameras" else {"pose": 1, **({"body": "b"} if table == "points" else {})}
    entry = {"path": name, **({"format": "photomodeler"} if name == "p.txt" else {}), "constants": constants}
    found = read(tmp_path, table, entry)
    lines = text.splitlines()
    assert [lines[record][: len(start)] for record, start in zip(found.records, begins, strict=False)] == begins
    assert len(found.records) == len(found.columns[column])
