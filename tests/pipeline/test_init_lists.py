"""`truing init` on lists of one target, reports with a row for each coordinate, sheets, and markers beside bodies."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import openpyxl
import pytest

from tests.pipeline.test_init_exports import NAMES, PLACES, URDF, init, numbers, table
from tests.tolerance import assert_close
from truing.formats.shapes import CONFIGURATIONS, POINTS, SIGNALS

RNG = np.random.default_rng(23)
PATH = RNG.uniform(-900.0, 900.0, (24, 3)).round(3)  # places of one target, mm
JOINTS = RNG.uniform(-1.5, 1.5, (24, 3)).round(6)  # rad


def log(folder: Path, first: int | None = None) -> None:
    """A log of joints beside the robot's description; first: number of its first pose, None without numbers."""
    (folder / "arm.urdf").write_text(URDF)
    head = "pan,lift,twist" if first is None else "pose,pan,lift,twist"
    rows = [",".join(map(str, row if first is None else (first + k, *row))) for k, row in enumerate(JOINTS)]
    (folder / "log.csv").write_text("\n".join([head, *rows]) + "\n")


@pytest.mark.parametrize(
    ("name", "separator", "head"),
    [
        ("TCP{:03d}", " ", ""),
        ("P{:03d}", ";", "Name;X;Y;Z\n"),
        ("Point {}", "\t", ""),
        ("Messpunkt_{}", ",", "Punkt,X [mm],Y [mm],Z [mm]\n"),
    ],
)
def test_numbered_places_beside_a_log_are_poses_of_one_target(
    tmp_path: Path, name: str, separator: str, head: str
) -> None:
    log(tmp_path)
    order = RNG.permutation(len(PATH))
    rows = [separator.join((name.format(k + 1), *map(str, PATH[k]))) for k in order]
    (tmp_path / "places.txt").write_text(head + "\n".join(rows) + "\n")
    told, document = init(tmp_path)
    assert document["measurement"] == {"frame": "campaign"}
    assert "Body" not in told
    found = table(tmp_path, document, POINTS)
    assert set(found.table.column("body").to_pylist()) == {"hand"}
    poses = np.array(found.table.column("pose").to_pylist(), int)
    assert_close(numbers(found, "x_mm", "y_mm", "z_mm"), PATH[poses - 1], atol=0.0, what="places")
    assert sorted(poses) == list(range(1, len(PATH) + 1))


@pytest.mark.parametrize("first", [None, 0, 101])
def test_numbers_of_places_are_those_of_the_log(tmp_path: Path, first: int | None) -> None:
    log(tmp_path, first)
    begin = 0 if first is None else first
    rows = [f"T{begin + k} {x} {y} {z}" for k, (x, y, z) in enumerate(PATH) if k != 5]  # one was lost
    (tmp_path / "places.txt").write_text("\n".join(rows) + "\n")
    _, document = init(tmp_path)
    found, joints = table(tmp_path, document, POINTS), table(tmp_path, document, CONFIGURATIONS)
    poses = dict(zip(joints.table.column("pose").to_pylist(), numbers(joints, "pan_rad")[:, 0], strict=True))
    read = [poses[pose] for pose in found.table.column("pose").to_pylist()]
    assert_close(np.array(read), np.delete(JOINTS[:, 0], 5), atol=1e-12, what="joint of each place")


def test_a_numbered_list_beside_points_stays_a_survey(tmp_path: Path) -> None:
    log(tmp_path)
    (tmp_path / "survey.txt").write_text("".join(f"P{k} {x} {y} {z}\n" for k, (x, y, z) in enumerate(PATH, 1)))
    (tmp_path / "points.csv").write_text("pose,body,target,x_mm,y_mm,z_mm\n1,hand,P1,1,2,3\n2,hand,P1,1,2,4\n")
    _, document = init(tmp_path)
    assert document["files"]["targets"]["path"] == "survey.txt"


def reports(kind: str) -> list[bytes]:
    """One report for each pose, as an inspection program writes it."""
    made = []
    for pose, places in enumerate(PLACES, 1):
        named = list(zip(NAMES, places, strict=True))
        if kind == "polyworks":
            lines = ["Units:\tMillimeters", "", "Name\tControl\tNom\tMeas\tTol\tDev\tTest"]
            for (body, target), place in named:
                cells = [
                    f"{axis}\t0.000\t{value:.3f}\t±0.5\t0.1\tPass" for axis, value in zip("XYZ", place, strict=True)
                ]
                lines += [f"{body} {target}\t{cells[0]}", *(f"\t{cell}" for cell in cells[1:])]
            made.append("\r\n".join([*lines, "bore 1\tDiameter\t12.0\t12.01\t±0.1\t0.01\tPass"]).encode("utf-16"))
        elif kind == "calypso":
            lines = ["planid\tpartnb\tid\ttype\tactual\tnominal\tdeviation\tfeatureid\tunit"]
            for (body, target), place in named:
                for axis, value in zip("xyz", place, strict=True):
                    actual = f"{value:.3f}".replace(".", ",")
                    start = f"Prüfplan\t{pose}\t{axis.upper()}-Wert_{target}\t{axis}Value"
                    lines.append(f"{start}\t{actual}\t0,000\t0,1\t{body} {target}\tmm")
            made.append("\r\n".join([*lines, "END"]).encode("latin-1"))
        else:
            lines = [f"   SER NUMBER : {pose}"]
            for number, ((body, target), place) in enumerate(named):
                lines += [f"DIM LOC{number}= LOCATION OF POINT {body}_{target}  UNITS=MM ,$"]
                lines += ["AX      NOMINAL       MEAS       +TOL       -TOL        DEV     OUTTOL"]
                lines += [f"{a}  0.0  {v:.3f}  0.5  0.5  0.1  0.0" for a, v in zip("XYZ", place, strict=True)]
            made.append("\n".join(lines).encode())
    return made


@pytest.mark.parametrize("kind", ["polyworks", "calypso", "pc-dmis"])
def test_reports_with_a_row_for_each_coordinate_give_measured_points(tmp_path: Path, kind: str) -> None:
    for pose, content in enumerate(reports(kind), 1):
        (tmp_path / f"piece {pose}.txt").write_bytes(content)
    told, document = init(tmp_path)
    assert "Unit of" not in told
    found = table(tmp_path, document, POINTS)
    assert_close(numbers(found, "x_mm", "y_mm", "z_mm"), PLACES.reshape(-1, 3), atol=1e-9, what="places")
    assert [str(pose) for pose in found.table.column("pose").to_pylist()] == ["1"] * 4 + ["2"] * 4


def motion(pose: int) -> np.ndarray:
    """Places of three targets of two bodies, mm; the second moves along z."""
    base = np.array([[1.0, 2.0, 3.0], [300.0, 10.0, 0.0], [20.0, 250.0, 5.0]])
    return np.concatenate([base, base[:, [1, 0, 2]] + [50.0, 60.0, 100.0 + 20.0 * pose]])


TARGETS = [f"{body} {letter}{k}" for body, letter in (("base", "B"), ("platform", "P")) for k in (1, 2, 3)]


def test_sheets_that_differ_in_their_number_are_poses(tmp_path: Path) -> None:
    book = openpyxl.Workbook()
    for pose in range(1, 12):
        sheet = book.create_sheet(f"Pose {pose}")
        for row in (["Report"], [], ["Punkt", "X", "Y", "Z"], [None, "mm", "mm", "mm"]):
            sheet.append(row)
        for target, place in zip(TARGETS, motion(pose), strict=True):
            sheet.append([target, *map(float, place)])
    del book["Sheet"]
    book.save(tmp_path / "book.xlsx")
    told, document = init(tmp_path)
    assert "platform  P1" in told  # the first rows of every body
    found = table(tmp_path, document, POINTS)
    assert [int(pose) for pose in found.table.column("pose").to_pylist()] == [k for k in range(1, 12) for _ in TARGETS]
    assert set(found.table.column("body").to_pylist()) == {"base", "platform"}
    expected = np.concatenate([motion(pose) for pose in range(1, 12)])
    assert_close(numbers(found, "x_mm", "y_mm", "z_mm"), expected, atol=1e-9, what="places")


def test_poses_of_rigid_bodies_are_no_markers(tmp_path: Path) -> None:
    marks = [target.replace(" ", ":") for target in TARGETS]
    bodies = ["Rigid Body"] * 7
    rows = [["Format Version", "1.23", "Length Units", "Millimeters"], []]
    rows += [["", "", *bodies, *(["Marker"] * 18)], ["", "", *(["platform"] * 7), *(m for m in marks for _ in "xyz")]]
    rows += [
        ["", "", *(["A0"] * 7), *(["B0"] * 18)],
        ["", "", *(["Rotation"] * 4 + ["Position"] * 3 + ["Position"] * 18)],
    ]
    rows += [["Frame", "Time (Seconds)", *"XYZWXYZ", *("XYZ" * 6)]]
    for pose in range(3):
        rows.append(
            [str(pose), str(pose / 120), *(["0", "0", "0", "1", "5", "6", "7"]), *map(str, motion(pose).ravel())]
        )
    (tmp_path / "Take.csv").write_text("\n".join(",".join(row) for row in rows) + "\n")
    _, document = init(tmp_path)
    found = table(tmp_path, document, POINTS)
    assert set(found.table.column("target").to_pylist()) == {target.partition(" ")[2] for target in TARGETS}
    assert_close(numbers(found, "x_mm", "y_mm", "z_mm")[:6], motion(0), atol=1e-9, what="places")


def test_nominal_loads_beside_channels_are_applied_loads(tmp_path: Path) -> None:
    axes = ("x", "y", "z")
    head = ["Zeit", *(f"K {k}" for k in range(6)), *(f"F{a} soll" for a in axes), *(f"M{a} soll" for a in axes)]
    units = ["s", *["mV/V"] * 6, *["N"] * 3, *["Nm"] * 3]
    values = RNG.normal(size=(8, 13)).round(4)
    rows = ["\t".join(str(v).replace(".", ",") for v in (k, *row[1:])) for k, row in enumerate(values)]
    (tmp_path / "export.asc").write_text(
        "\n".join(["\t".join(head), "\t".join(units), *rows]) + "\n", encoding="utf-16"
    )
    told, document = init(tmp_path)
    assert "loads=" not in told
    found = table(tmp_path, document, SIGNALS)
    assert_close(numbers(found, "v1_mv", "fz_n", "mz_nm"), values[:, [1, 9, 12]], atol=1e-9, what="values")


def test_directions_and_distances_are_no_readings(tmp_path: Path) -> None:
    rows = [f"S1;P{k};{10 * k}.5;99.{k};3.{k}\n" for k in range(1, 7)]
    (tmp_path / "observed.csv").write_text("Station;Target;Hz [gon];V [gon];SD [m]\n" + "".join(rows))
    told, document = init(tmp_path)
    assert "files" not in document
    assert "export the adjusted coordinates" in told


@pytest.mark.parametrize("moves", [True, False])
def test_targets_that_keep_their_distances_are_bodies_if_others_do_not(tmp_path: Path, moves: bool) -> None:
    for pose in range(1, 6):
        places = motion(pose if moves else 1) + RNG.normal(0.0, 0.01, (6, 3))
        rows = [f"{100 + k}\t{x:.4f}\t{y:.4f}\t{z:.4f}\n" for k, (x, y, z) in enumerate(places)]
        (tmp_path / f"pose{pose}.txt").write_text("Name\tX\tY\tZ\n" + "".join(rows))
    told, document = init(tmp_path)
    assert ("groups=" in told) == moves
    if moves:
        renamed = document["files"]["points"]["rename"]["body"]
        assert renamed == {str(100 + k): f"body{1 + k // 3}" for k in range(6)}


@pytest.mark.parametrize("is_numbered_anew", [True, False])
def test_uncoded_targets_are_read_if_they_keep_their_names(tmp_path: Path, is_numbered_anew: bool) -> None:
    for pose in range(1, 5):
        places = motion(pose) + RNG.normal(0.0, 0.01, (6, 3))
        uncoded = np.roll([3, 4, 5], pose) if is_numbered_anew else [3, 4, 5]
        names = ["CODE1", "CODE2", "CODE3", *(f"TARGET{k}" for k in uncoded)]
        rows = [f"{n},{x:.4f},{y:.4f},{z:.4f},0.01,0.01,0.01,0\n" for n, (x, y, z) in zip(names, places, strict=True)]
        (tmp_path / f"set_{pose}.csv").write_text("".join(rows))
    _, document = init(tmp_path)
    found = table(tmp_path, document, POINTS)
    targets = {"CODE1", "CODE2", "CODE3"} | (set() if is_numbered_anew else {"TARGET3", "TARGET4", "TARGET5"})
    assert set(found.table.column("target").to_pylist()) == targets
    assert len(set(found.table.column("body").to_pylist())) == len(targets) // 3
