"""`truing init` on lists of one target, reports with a row per coordinate, sheets, and markers next to bodies."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import openpyxl
import pytest

from tests.pipeline.test_init_exports import NAMES, PLACES, URDF, init, numbers, table
from tests.tolerance import assert_close
from truing.formats.raw_tables import CONFIGURATIONS, POINTS, SIGNALS

RNG = np.random.default_rng(23)
PATH = RNG.uniform(-900.0, 900.0, (24, 3)).round(3)  # places of one target, mm
JOINTS = RNG.uniform(-1.5, 1.5, (24, 3)).round(6)  # rad


def log(folder: Path, first: int | None = None) -> None:
    """A log of joints next to the robot's description; first: number of its first pose, None without numbers."""
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
def test_numbered_places_next_to_a_log_are_poses_of_one_target(
    tmp_path: Path, name: str, separator: str, head: str
) -> None:
    log(tmp_path)
    order = RNG.permutation(len(PATH))
    rows = [separator.join((name.format(k + 1), *map(str, PATH[k]))) for k in order]
    (tmp_path / "places.txt").write_text(head + "\n".join(rows) + "\n")
    reported, document = init(tmp_path)
    assert document["measurement"] == {"frame": "campaign"}
    assert "Body" not in reported
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


def test_a_numbered_list_next_to_points_stays_a_survey(tmp_path: Path) -> None:
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
    reported, document = init(tmp_path)
    assert "Unit of" not in reported
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
    reported, document = init(tmp_path)
    assert "platform  P1" in reported  # the first rows of every body
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


def test_nominal_loads_next_to_channels_are_applied_loads(tmp_path: Path) -> None:
    axes = ("x", "y", "z")
    head = ["Zeit", *(f"K {k}" for k in range(6)), *(f"F{a} soll" for a in axes), *(f"M{a} soll" for a in axes)]
    units = ["s", *["mV/V"] * 6, *["N"] * 3, *["Nm"] * 3]
    values = RNG.normal(size=(8, 13)).round(4)
    rows = ["\t".join(str(v).replace(".", ",") for v in (k, *row[1:])) for k, row in enumerate(values)]
    (tmp_path / "export.asc").write_text(
        "\n".join(["\t".join(head), "\t".join(units), *rows]) + "\n", encoding="utf-16"
    )
    reported, document = init(tmp_path)
    assert "loads=" not in reported
    found = table(tmp_path, document, SIGNALS)
    assert_close(numbers(found, "v1_mv", "fz_n", "mz_nm"), values[:, [1, 9, 12]], atol=1e-9, what="values")


def test_directions_and_distances_are_no_readings(tmp_path: Path) -> None:
    rows = [f"S1;P{k};{10 * k}.5;99.{k};3.{k}\n" for k in range(1, 7)]
    (tmp_path / "observed.csv").write_text("Station;Target;Hz [gon];V [gon];SD [m]\n" + "".join(rows))
    reported, document = init(tmp_path)
    assert "files" not in document
    assert "export the adjusted coordinates" in reported


@pytest.mark.parametrize("moves", [True, False])
def test_targets_that_keep_their_distances_are_bodies_if_others_do_not(tmp_path: Path, moves: bool) -> None:
    for pose in range(1, 6):
        places = motion(pose if moves else 1) + RNG.normal(0.0, 0.01, (6, 3))
        rows = [f"{100 + k}\t{x:.4f}\t{y:.4f}\t{z:.4f}\n" for k, (x, y, z) in enumerate(places)]
        (tmp_path / f"pose{pose}.txt").write_text("Name\tX\tY\tZ\n" + "".join(rows))
    reported, document = init(tmp_path)
    assert ("groups=" in reported) == moves
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


@pytest.mark.parametrize(
    ("head", "scale"),
    [
        ("q1,q2,q3,x,y,z", 1e-3),
        ("Nr;theta1;theta2;theta3;px [mm];py [mm];pz [mm]", 1.0),
        ("pan_rad,lift_rad,twist_rad,x_mm,y_mm,z_mm", 1.0),
        ("cmd_j1\tcmd_j2\tcmd_j3\tj1\tj2\tj3\ttcp_x\ttcp_y\ttcp_z\tLaserX\tLaserY\tLaserZ", 1.0),
    ],
    ids=["bare names", "numbered rows", "names of the contract", "commands beside readings"],
)
def test_joints_and_points_of_one_row_are_a_chain_campaign(tmp_path: Path, head: str, scale: float) -> None:
    (tmp_path / "arm.urdf").write_text(URDF)
    separator = next(mark for mark in ";\t," if mark in head)
    kinds = {"t": JOINTS + 1.0, "J": JOINTS, "T": PATH + 50.0, "P": PATH * scale}
    own = "JP" if len(head.split(separator)) < 8 else "tJTP"
    rows = np.column_stack([kinds[kind] for kind in own])
    first = 101 if head.startswith("Nr") else None
    lines = [separator.join(map(str, row if first is None else (first + k, *row))) for k, row in enumerate(rows)]
    (tmp_path / "arm.csv").write_text("\n".join([head, *lines]) + "\n")
    _, document = init(tmp_path)
    assert document["mechanism"]["joints"] == ["pan", "lift", "twist"]
    assert document["measurement"] == {"frame": "campaign"}
    points, joints = table(tmp_path, document, POINTS), table(tmp_path, document, CONFIGURATIONS)
    assert set(points.table.column("body").to_pylist()) == {"hand"}
    begin = 1 if first is None else first
    for found in (points, joints):
        assert [int(pose) for pose in found.table.column("pose").to_pylist()] == list(range(begin, begin + len(rows)))
    assert_close(numbers(points, "x_mm", "y_mm", "z_mm"), PATH, atol=1e-9, what="places")
    assert_close(numbers(joints, "pan_rad", "lift_rad", "twist_rad"), JOINTS, atol=0.0, what="joints")


def test_several_targets_next_to_joints_are_points_of_each_pose(tmp_path: Path) -> None:
    head = "j1,j2,j3,x1,y1,z1,x2,y2,z2"
    rows = [",".join(map(str, row)) for row in np.column_stack([np.degrees(JOINTS), PATH, PATH + 80.0])]
    (tmp_path / "arm.csv").write_text("\n".join([head, *rows]) + "\n")
    reported, document = init(tmp_path)
    assert "a description of the robot" in reported
    found = table(tmp_path, document, POINTS)
    second = [target == "2" for target in found.table.column("target").to_pylist()]
    assert_close(numbers(found, "x_mm", "y_mm", "z_mm")[second], PATH + 80.0, atol=0.0, what="second target")


def test_coordinates_that_a_controller_computes_are_no_measurement(tmp_path: Path) -> None:
    rows = [",".join(map(str, row)) for row in np.column_stack([JOINTS, PATH])]
    (tmp_path / "log.csv").write_text("\n".join(["Joint 1,Joint 2,Joint 3,TCP X,TCP Y,TCP Z", *rows]) + "\n")
    _, document = init(tmp_path)
    assert list(document["files"]) == ["configurations"]
    assert "# check: " in (text := (tmp_path / "campaign.toml").read_text())
    assert "computed by the controller" in text


def several_poses(head: str, row: str, mark: str = ",") -> str:
    """Three poses of two bodies with four targets each, a row for each target."""
    places = {(body, k): RNG.uniform(-500.0, 500.0, 3).round(3) for body in ("base", "plate") for k in range(1, 5)}
    lines = [
        row.format(pose=pose, body=body, k=k, x=x, y=y, z=z + (pose if body == "plate" else 0.0), mark=mark)
        for pose in (1, 2, 3)
        for (body, k), (x, y, z) in places.items()
    ]
    return "\n".join([head, *lines]) + "\n"


@pytest.mark.parametrize(
    ("head", "row"),
    [
        ("Setup,Group,Point,East,North,Height", "{pose},{body},p{k},{x},{y},{z}"),
        ("Gruppe;Punkt;Stellung;X;Y;Z;", "{body};p{k};{pose};{x};{y};{z};"),
        ("Collection::Gruppe::Punkt;X [mm];Y [mm];Z [mm]", "Pose{pose}::{body}::p{k};{x};{y};{z}"),
        ("Tag Body Marke Rechtswert Hochwert Hoehe", "S{pose} {body} p{k} {x} {y} {z}"),
    ],
    ids=["setup and grid", "German, empty last column", "names in parts", "unnamed pose"],
)
def test_poses_bodies_and_coordinates_are_found_by_names_and_repeats(tmp_path: Path, head: str, row: str) -> None:
    (tmp_path / "all.txt").write_text(several_poses(head, row))
    _, document = init(tmp_path)
    found = table(tmp_path, document, POINTS).table
    assert len(set(found.column("pose").to_pylist())) == 3
    assert set(found.column("body").to_pylist()) == {"base", "plate"}
    assert found.num_rows == 24


def test_a_column_that_differs_in_every_row_gives_no_poses(tmp_path: Path) -> None:
    text = several_poses("Moment,Point,X,Y,Z", "{body}{pose}{k},p{k},{x},{y},{z}")
    (tmp_path / "all.txt").write_text(text)
    _, document = init(tmp_path)
    assert "pose" not in document["files"]["points"]["columns"]


def test_numbered_lengths_are_the_readings_of_legs(tmp_path: Path) -> None:
    head = "Pose No.;" + ";".join(f"L{k} [mm]" for k in range(1, 7)) + ";Temperatur"
    rows = [f"{pose};" + ";".join(f"{700 + pose + k},5" for k in range(6)) + ";20,5" for pose in (7, 8)]
    (tmp_path / "legs.csv").write_text("\n".join([head, *rows]) + "\n")
    (tmp_path / "points.csv").write_text("pose,body,target,x_mm,y_mm,z_mm\n7,base,P1,1,2,3\n8,base,P1,1,2,4\n")
    _, document = init(tmp_path)
    found = table(tmp_path, document, CONFIGURATIONS)
    assert [int(pose) for pose in found.table.column("pose").to_pylist()] == [7, 8]
    assert_close(numbers(found, "rho1_mm", "rho6_mm"), np.array([[707.5, 712.5], [708.5, 713.5]]), atol=0.0)


def test_each_sheet_of_another_table_is_read(tmp_path: Path) -> None:
    book = openpyxl.Workbook()
    book.active.append(["Project", "hexapod"])
    for name, first in (("Measured", ["Pose"]), ("Nominal", [])):
        sheet = book.create_sheet(name)
        sheet.append([*first, "Body", "Point", "X (mm)", "Y (mm)", "Z (mm)"])
        for pose in (1, 2) if first else (1,):
            for k in range(1, 4):
                sheet.append([*([pose] if first else []), "base", f"p{k}", k * 10.0, k * k, 1.0])
    book.save(tmp_path / "all.xlsx")
    _, document = init(tmp_path)
    assert {key: entry["sheet"] for key, entry in document["files"].items()} == {
        "points": "Measured",
        "targets": "Nominal",
    }


@pytest.mark.parametrize(
    ("head", "what", "factor"),
    [
        ("Nominal [deg],Dir,Yaw [arcsec]", "deviation_deg", 1 / 3600.0),
        ("Position command (mm),X1 (nm)", "measured_mm", 1e-6),
    ],
    ids=["autocollimator", "interferometer"],
)
def test_the_only_other_angle_or_length_next_to_commands_is_the_instrument(
    tmp_path: Path, head: str, what: str, factor: float
) -> None:
    commands = [*range(0, 100, 10), *range(100, -1, -10)]
    shown = [0.3 if what.startswith("dev") else 1e6 * c + 30.0 for c in commands]
    rows = [f"{c},{'+,' if 'Dir' in head else ''}{value}" for c, value in zip(commands, shown, strict=True)]
    (tmp_path / "axis.csv").write_text("\n".join([head, *rows]) + "\n")
    _, document = init(tmp_path)
    assert document["mechanism"]["type"] == "axis"
    found = table(tmp_path, document, CONFIGURATIONS)
    assert_close(numbers(found, what)[:, 0], factor * np.array(shown), atol=1e-12, what=what)
