"""Exports that `truing init` recognises are read as it proposes: without a fault, with the right targets and
numbers."""

from __future__ import annotations

import pytest

from tests.formats.reading import read, written
from tests.sentences import assert_says
from tests.tolerance import assert_close
from truing.formats.sniff import sniff_file

XYZ = [(573.0039, -49.4291, -121.6922), (-111.4364, 2.5658, 460.6194), (488.6692, -13.4938, 57.2803)]
COORDINATES = ("x_mm", "y_mm", "z_mm")


def proposed(folder, name, text):
    """Contents of a file, read by its proposed entry; only the words for pose and body come from the user."""
    guess = sniff_file(written(folder, name, text))
    assert guess.table in ("points", "targets")  # a single list may be the survey
    reported = {"body": "b"} if "number_rows" in guess.mapping or "pose" in guess.columns else {"body": "b", "pose": 1}
    mapping = {**guess.mapping, "constants": reported}
    found = read(folder, entries={"path": name, **mapping})
    assert found.faults == ()
    return guess.mapping, found


def aicon(end=" 66  1  1  0"):
    points = zip((6, 8, 10), XYZ, strict=True)
    return "".join(
        f"{k:10d}{x:12.4f}{y:12.4f}{z:12.4f}{0.0026:12.4f}{0.0029:12.4f}{0.0035:12.4f}{end}\n"
        for k, (x, y, z) in points
    )


@pytest.mark.parametrize("name", ["pose1.obc", "points.txt"])
def test_aicon_with_the_points_left_out_that_were_not_used(tmp_path, name):
    unused = (
        aicon().splitlines()[0].replace("573.0039", "999.0000").replace("  6 ", "  7 ").replace(" 1  1  0", " 0  1  0")
    )
    mapping, found = proposed(tmp_path, name, f"{aicon()}{unused}\n")
    assert mapping["format"] == "aicon"
    assert found.columns["target"] == ["6", "8", "10"]
    assert_close(list(zip(*(found.columns[c] for c in COORDINATES), strict=True)), XYZ, atol=0.0)
    assert found.columns["sigma_z_mm"] == [0.0035] * 3
    assert sum(found.left_out.values()) == 1


def test_numbers_of_points_are_no_coordinates(tmp_path):
    mapping, found = proposed(tmp_path, "p.txt", aicon(end=""))
    assert mapping["format"] == "vstars"
    assert found.columns["target"] == ["6", "8", "10"]
    bare = "\n".join(f"{k} {x} {y} {z}" for k, (x, y, z) in zip((6, 8, 10), XYZ, strict=True))
    mapping, found = proposed(tmp_path, "q.txt", bare)
    assert found.columns["target"] == ["6", "8", "10"]
    assert_close(list(zip(*(found.columns[c] for c in COORDINATES), strict=True)), XYZ, atol=0.0)


METASHAPE = """\
# CoordinateSystem: LOCAL_CS["Local Coordinates (m)",LOCAL_DATUM["Local Datum",0],UNIT["metre",1]]
#Label,X/East,Y/North,Z/Altitude,Error_(m),X_error,Y_error,Z_error,X_est,Y_est,Z_est
target 1,,,,,,,,0.512031,0.001204,0.250310
target 2,0.5,0.0,0.0,0.000021,0.000012,-0.000009,0.000014,0.500012,-0.000009,0.000014
target 3,,,,,,,,,,
# Total Error
#,,,,0.000021,0.000012,0.000009,0.000014
"""


@pytest.mark.parametrize("separator", [",", "\t", ";"])
def test_metashape_estimated_and_not_given_coordinates(tmp_path, separator):
    head, _, rest = METASHAPE.partition("\n")
    mapping, found = proposed(tmp_path, "markers.txt", f"{head}\n{rest.replace(',', separator)}")
    assert mapping["format"] == "metashape"
    assert found.columns["target"] == ["target 1", "target 2"]
    assert_close([found.columns[c][1] for c in COORDINATES], [500.012, -0.009, 0.014], atol=1e-9)
    assert sum(found.left_out.values()) == 1


@pytest.mark.parametrize(
    ("header", "template"),
    [
        ("P1_x,P1_y,P1_z,P2_x,P2_y,P2_z", "{target}_{axis}"),
        ("pose,arm.1.X,arm.1.Y,arm.1.Z,arm.2.X,arm.2.Y,arm.2.Z", "{target}.{axis}"),
        ("x_P1,y_P1,z_P1,x_P2,y_P2,z_P2", "{axis}_{target}"),
        ("nr,P1 X [mm],P1 Y [mm],P1 Z [mm],P2 X [mm],P2 Y [mm],P2 Z [mm]", "{target} {axis} [mm]"),
        ("P1X,P1Y,P1Z,P2X,P2Y,P2Z", "{target}{axis}"),
    ],
)
def test_targets_side_by_side(tmp_path, header, template):
    width = header.count(",") + 1
    first = width - 6
    rows = [",".join([str(pose)] * first + [f"{100 * pose + k}.5" for k in range(6)]) for pose in (1, 2)]
    mapping, found = proposed(tmp_path, "wide.csv", "\n".join([header, *rows]))
    assert mapping["wide"] == template
    assert found.columns["pose"] == [1, 1, 2, 2]
    assert found.columns["x_mm"] == [100.5, 103.5, 200.5, 203.5]
    assert found.columns["z_mm"] == [102.5, 105.5, 202.5, 205.5]


def test_metres_behind_the_names_of_targets_side_by_side(tmp_path):
    mapping, found = proposed(tmp_path, "w.csv", "A_x_m,A_y_m,A_z_m,B_x_m,B_y_m,B_z_m\n1,2,3,4,5,6\n7,8,9,1,2,3\n")
    assert (mapping["wide"], mapping["unit"]) == ("{target}_{axis}_m", "m")
    assert found.columns["x_mm"] == [1000.0, 4000.0, 7000.0, 1000.0]


def test_positioning_runs_and_quadrature_signals_are_recognised(tmp_path):
    assert sniff_file(written(tmp_path, "x.rtl", "HEADER::\n")).table == "positioning"
    guess = sniff_file(written(tmp_path, "s.csv", "time,cos,sin\n0.0,1.0,0.0\n0.1,0.9,0.1\n"))
    assert guess.table == "quadrature"
    assert guess.mapping["columns"] == {"time_s": "time", "signal_x": "cos", "signal_y": "sin"}


def test_phase_and_radius_are_quadrature_signals(tmp_path):
    guess = sniff_file(written(tmp_path, "q.csv", "Phase (deg), Radius, Roundness deviation\n 0.1, 501.0, 1.6\n"))
    assert guess.table == "quadrature"
    assert guess.mapping["columns"] == {"phase_deg": "Phase (deg)", "radius": "Radius"}


def test_an_old_workbook_is_to_be_saved_as_xlsx(tmp_path):
    (tmp_path / "a.xls").write_bytes(b"\xd0\xcf\x11\xe0" + bytes(200))
    (fault,) = read(tmp_path, entries={"path": "a.xls"}).faults
    assert fault.value == "a workbook"
    assert_says(fault.expected, "text", "workbook", ".xlsx")
