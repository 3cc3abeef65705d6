"""`truing init` on exports of instruments: its proposal reads the numbers that were written."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import openpyxl
import pytest
from scipy.io import savemat
from typer.testing import CliRunner

from tests.tolerance import assert_close
from truing.formats.faultlog import FaultLog
from truing.formats.raw_tables import CONFIGURATIONS, INTERFEROMETER, POINTS, POSITIONING, SIGNALS, RawTable
from truing.formats.row_collection import CollectedRows, collect_rows
from truing.formats.source import CampaignFiles
from truing.pipeline.command_line import app
from truing.schemas.campaign import read_campaign

RNG = np.random.default_rng(11)
PLACES = RNG.uniform(-2000.0, 2000.0, (2, 4, 3)).round(3)  # poses, targets, mm
NAMES = [("base", "B1"), ("base", "B2"), ("platform", "P1"), ("platform", "P2")]
JOINTS = RNG.uniform(-1.5, 1.5, (5, 3)).round(6)  # rows, rad
URDF = """<robot name="arm"><link name="ground"/><link name="a"/><link name="b"/><link name="hand"/>
<joint name="pan" type="revolute"><parent link="ground"/><child link="a"/><axis xyz="0 0 1"/></joint>
<joint name="lift" type="revolute"><parent link="a"/><child link="b"/><axis xyz="0 1 0"/></joint>
<joint name="twist" type="revolute"><parent link="b"/><child link="hand"/><axis xyz="1 0 0"/></joint></robot>"""


def init(folder: Path) -> tuple[str, dict[str, Any]]:
    done = CliRunner().invoke(app, ["init", str(folder)])
    assert done.exit_code == 0, done.stdout
    return done.stdout, tomllib.loads((folder / "campaign.toml").read_text(encoding="utf-8"))


def table(folder: Path, document: dict[str, Any], shape: RawTable) -> CollectedRows:
    log = FaultLog()
    found = collect_rows(CampaignFiles(folder, read_campaign(document)), shape, log)
    assert not log, list(log.faults())
    assert found is not None
    return found


def numbers(found: CollectedRows, *columns: str) -> np.ndarray:
    return np.column_stack([np.array(found.table.column(name).to_pylist(), float) for name in columns])


def test_names_in_a_comment_and_a_unit_in_words_are_read(tmp_path: Path) -> None:
    for pose, places in enumerate(PLACES, 1):
        lines = ["// Units: Inches", "//Collection, Group, Target, X, Y, Z, Timestamp"]
        for (body, target), place in zip(NAMES, places, strict=True):
            x, y, z = place / 25.4
            lines.append(f"A, {body}, {target}, {x:.7f}, {y:.7f}, {z:.7f}, 3/12/2026 8:00:00 AM")
        (tmp_path / f"Pose {pose}.txt").write_text("\n".join(lines) + "\n")
    _, document = init(tmp_path)
    found = table(tmp_path, document, POINTS)
    assert document["files"]["points"]["unit"] == "in"
    assert found.table.column("body").to_pylist()[:4] == [body for body, _ in NAMES]
    assert_close(numbers(found, "x_mm", "y_mm", "z_mm"), PLACES.reshape(-1, 3), atol=1e-5, what="places")


def test_names_of_targets_in_parts_give_pose_and_body(tmp_path: Path) -> None:
    lines = [
        f"Pose{pose}::{body}::{target} {x} {y} {z}"
        for pose, places in enumerate(PLACES, 1)
        for (body, target), (x, y, z) in zip(NAMES, places, strict=True)
    ]
    (tmp_path / "points.txt").write_text("\n".join(lines) + "\n")
    _, document = init(tmp_path)
    found = table(tmp_path, document, POINTS)
    assert set(found.table.column("pose").to_pylist()) == {"Pose1", "Pose2"}
    assert set(found.table.column("body").to_pylist()) == {"base", "platform"}
    assert set(found.table.column("target").to_pylist()) == {"B1", "B2", "P1", "P2"}


def test_motion_capture_with_three_rows_of_names_gives_bodies_and_targets(tmp_path: Path) -> None:
    marks = [f"{body}:{target}" for body, target in NAMES]
    lines = ["Trajectories", "100", ",," + ",,,".join(marks) + ",,", "Frame,Sub Frame" + ",X,Y,Z" * 4, "," + ",mm" * 12]
    lines += [f"{frame},0," + ",".join(map(str, places.ravel())) for frame, places in enumerate(PLACES, 1)]
    (tmp_path / "Trial.csv").write_text("\n".join(lines) + "\n")
    _, document = init(tmp_path)
    found = table(tmp_path, document, POINTS)
    rows = zip(found.table.column("body").to_pylist(), found.table.column("target").to_pylist(), strict=True)
    assert list(rows)[:4] == NAMES
    assert_close(numbers(found, "x_mm", "y_mm", "z_mm"), PLACES.reshape(-1, 3), atol=0.0, what="places")


@pytest.mark.parametrize("blank", [0, 1, 3])
def test_blank_lines_above_the_header_are_counted(tmp_path: Path, blank: int) -> None:
    preamble = "\n".join(["Report", *[""] * blank, "Operator", *[""] * blank]) + "\n"
    rows = "".join(f"1;base;{name};1,{k};2,{k};3,{k}\n" for k, name in enumerate("ABC", 1))
    (tmp_path / "p.csv").write_text(f"{preamble}Pose;Body;Target;X [mm];Y [mm];Z [mm]\n{rows}")
    _, document = init(tmp_path)
    assert_close(numbers(table(tmp_path, document, POINTS), "x_mm"), [[1.1], [1.2], [1.3]], atol=0.0, what="x")


def test_blank_rows_above_a_sheets_header_are_counted_and_units_below_it_are_read(tmp_path: Path) -> None:
    book = openpyxl.Workbook()
    sheet = book.active
    assert sheet is not None
    for row in (["Bench 5"], [], ["Operator"], [], ["Run", "Step", "Time", "Axis", "Load", "Channel", "Reading"]):
        sheet.append(row)
    sheet.append(["-", "-", "min", None, "kN", None, "nm"])
    for step in range(4):
        sheet.append([1, step, step, "fz", 0.5 * step, "dz", 1000.0 * step])
    book.save(tmp_path / "bench.xlsx")
    _, document = init(tmp_path)
    found = table(tmp_path, document, INTERFEROMETER)
    expected = [[60.0 * step, 1000.0 * step] for step in range(4)]
    assert_close(numbers(found, "time_s", "reading"), expected, atol=1e-9, what="time, reading")
    assert document["files"]["interferometer"]["units"] == {"time_s": "min", "load": "kN", "reading": "nm"}


def test_channels_side_by_side_are_read_though_the_first_row_ends_early(tmp_path: Path) -> None:
    book = openpyxl.Workbook()
    sheet = book.active
    assert sheet is not None
    sheet.append(["Lauf", "Stufe", "Zeit", "Lastachse", "Last", "dx", "rz"])
    sheet.append([None, None, "s", None, "N", "µm", "arcsec"])
    for step in range(3):
        sheet.append([1, step, 10 * step, "fx", 100 * step, 5.0 * step])
    for step in range(3, 6):
        sheet.append([1, step, 10 * step, "mz", 100 * step, None, 2.0 * step])
    book.save(tmp_path / "bench.xlsx")
    _, document = init(tmp_path)
    found = table(tmp_path, document, INTERFEROMETER)
    rows = zip(found.table.column("channel").to_pylist(), found.table.column("reading").to_pylist(), strict=True)
    read = [row for row in rows if row[1] is not None]
    assert read == [*zip(["dx"] * 3, [0.0, 5.0, 10.0], strict=True), *zip(["rz"] * 3, [6.0, 8.0, 10.0], strict=True)]


def robot(folder: Path) -> None:
    (folder / "arm.urdf").write_text(URDF)


@pytest.mark.parametrize(
    ("header", "unit"),
    [
        ("/joint_states/pan/position,/joint_states/lift/position,/joint_states/twist/position", "rad"),
        ("$AXIS_ACT.A1 [°],$AXIS_ACT.A2 [°],$AXIS_ACT.A3 [°]", "deg"),
        ("actual_q_0,actual_q_1,actual_q_2", "rad"),
        ("twist [rad],pan [rad],lift [rad]", "rad"),
    ],
)
def test_joint_readings_have_the_names_and_units_of_the_described_robot(tmp_path: Path, header: str, unit: str) -> None:
    robot(tmp_path)
    order = [2, 0, 1] if header.startswith("twist") else [0, 1, 2]
    written = (JOINTS if unit == "rad" else np.degrees(JOINTS))[:, order]
    rows = "".join(f"{1.7e9 + k},{','.join(f'{v:.9f}' for v in row)},7\n" for k, row in enumerate(written))
    (tmp_path / "log.csv").write_text(f"timestamp,{header},pan_velocity\n{rows}")
    _, document = init(tmp_path)
    assert document["mechanism"] == {
        "type": "chain",
        "urdf": "arm.urdf",
        "tip": "hand",
        "joints": ["pan", "lift", "twist"],
    }
    found = table(tmp_path, document, CONFIGURATIONS)
    read = numbers(found, *(f"{joint}_{unit}" for joint in ("pan", "lift", "twist")))
    assert_close(read if unit == "rad" else np.radians(read), JOINTS, atol=1e-8, what="joints")
    assert not any("velocity" in name for name in found.table.column_names)
    text = (tmp_path / "campaign.toml").read_text(encoding="utf-8")
    assert ("joint readings are assumed to be in" in text) == ("[" not in header)


def test_names_of_joints_in_cells_give_their_order(tmp_path: Path) -> None:
    robot(tmp_path)
    head = (
        "%time," + ",".join(f"field.name{k}" for k in range(3)) + "," + ",".join(f"field.position{k}" for k in range(3))
    )
    rows = [f"{1_700_000_000_000_000_000 + k * 10**9},lift,pan,twist,{b},{a},{c}" for k, (a, b, c) in enumerate(JOINTS)]
    (tmp_path / "joint_states.csv").write_text("\n".join([head, *rows]) + "\n")
    _, document = init(tmp_path)
    found = table(tmp_path, document, CONFIGURATIONS)
    assert_close(numbers(found, "pan_rad", "lift_rad", "twist_rad"), JOINTS, atol=0.0, what="joints")
    assert document["files"]["configurations"]["units"] == {"time_s": "ns"}


FINGERS = """<link name="left"/><link name="right"/>
<joint name="finger" type="prismatic"><parent link="hand"/><child link="left"/><axis xyz="0 1 0"/></joint>
<joint name="other_finger" type="prismatic"><parent link="hand"/><child link="right"/><axis xyz="0 -1 0"/>
<mimic joint="finger"/></joint></robot>"""


def test_a_trackers_named_points_next_to_a_log_of_an_arm_with_a_gripper_are_poses_of_one_reflector(
    tmp_path: Path,
) -> None:
    (tmp_path / "arm.urdf").write_text(URDF.replace("</robot>", FINGERS))
    joints, places = RNG.uniform(-1.5, 1.5, (24, 3)).round(6), RNG.uniform(-900.0, 900.0, (24, 3)).round(3)
    rows = ["time,pan,lift,twist", *(",".join(map(str, (k, *row))) for k, row in enumerate(joints))]
    (tmp_path / "log.csv").write_text("\n".join(rows) + "\n")
    rows = ["Point,X [mm],Y [mm],Z [mm]", *(",".join((f"P{k}", *map(str, row))) for k, row in enumerate(places))]
    (tmp_path / "tracker.csv").write_text("\n".join(rows) + "\n")
    _, document = init(tmp_path)
    assert (document["mechanism"]["tip"], document["mechanism"]["joints"]) == ("hand", ["pan", "lift", "twist"])
    assert document["files"]["points"]["constants"] == {"body": "hand", "target": "reflector"}
    found = table(tmp_path, document, POINTS)
    assert_close(numbers(found, "x_mm", "y_mm", "z_mm"), places, atol=0.0, what="mm")
    assert [str(pose) for pose in found.table.column("pose").to_pylist()] == [str(k) for k in range(1, 25)]


LIFT = """<link name="lift_end"/><link name="stage"/><link name="top"/>
<joint name="height" type="prismatic"><parent link="ground"/><child link="lift_end"/><axis xyz="0 0 1"/></joint>
<joint name="stage_1" type="prismatic"><parent link="ground"/><child link="stage"/><axis xyz="0 0 1"/>
<mimic joint="height" multiplier="0.5"/></joint>
<joint name="stage_2" type="prismatic"><parent link="stage"/><child link="top"/><axis xyz="0 0 1"/>
<mimic joint="height" multiplier="0.5"/></joint></robot>"""


def test_a_joint_that_stages_of_a_column_mimic_is_read_in_its_own_unit(tmp_path: Path) -> None:
    """The joint that moves the column is on another branch, and its readings are lengths."""
    urdf = URDF.replace('parent link="ground"/><child link="a"', 'parent link="top"/><child link="a"')
    (tmp_path / "arm.urdf").write_text(urdf.replace("</robot>", LIFT))
    heights = RNG.uniform(1.5, 3.5, (len(JOINTS), 1)).round(4)
    rows = [",".join(map(str, row)) for row in np.hstack([heights, JOINTS])]
    (tmp_path / "log.csv").write_text("\n".join(["height,pan,lift,twist", *rows]) + "\n")
    _, document = init(tmp_path)
    assert document["mechanism"]["joints"] == ["height", "pan", "lift", "twist"]
    assert document["mechanism"]["tip"] == "hand"
    found = table(tmp_path, document, CONFIGURATIONS)
    assert_close(numbers(found, "height_mm"), 1e3 * heights, atol=1e-9, what="mm")
    assert_close(numbers(found, "pan_rad", "lift_rad", "twist_rad"), JOINTS, atol=1e-12, what="joints")


def test_points_of_one_body_of_a_robot_are_in_the_frame_of_the_instrument(tmp_path: Path) -> None:
    robot(tmp_path)
    rows = [f"{k},{','.join(map(str, row))}" for k, row in enumerate(JOINTS, 1)]
    (tmp_path / "log.csv").write_text("\n".join(["pose,pan [rad],lift [rad],twist [rad]", *rows]) + "\n")
    places = [f"{k},T{n},{100.0 * k},{20.0 * n},5.0" for k in range(1, len(JOINTS) + 1) for n in (1, 2)]
    (tmp_path / "points.csv").write_text("\n".join(["pose,target,x_mm,y_mm,z_mm", *places]) + "\n")
    _, document = init(tmp_path)
    assert document["measurement"]["frame"] == "campaign"
    assert "# check: one body in each pose" in (tmp_path / "campaign.toml").read_text(encoding="utf-8")


def test_positions_of_a_robots_program_are_poses(tmp_path: Path) -> None:
    angles = np.degrees(RNG.uniform(-1.5, 1.5, (4, 6))).round(4)
    lines = [
        f"DECL E6AXIS XP{k}={{" + ",".join(f"A{i} {v}" for i, v in enumerate(row, 1)) + ",E1 0.0}"
        for k, row in enumerate(angles, 1)
    ]
    (tmp_path / "log.dat").write_text("DEFDAT POSES PUBLIC\n" + "\n".join(lines) + "\nENDDAT\n")
    _, document = init(tmp_path)
    found = table(tmp_path, document, CONFIGURATIONS)
    assert found.table.column("pose").to_pylist() == [1, 2, 3, 4]
    assert_close(numbers(found, *(f"joint{k}_deg" for k in range(1, 7))), angles, atol=0.0, what="joints")


def surveyed(folder: Path, factor: float) -> None:
    survey = RNG.uniform(-100.0, 100.0, (4, 3))
    lines = [f"hand,T{k},{x:.4f},{y:.4f},{z:.4f}" for k, (x, y, z) in enumerate(survey)]
    (folder / "nests.csv").write_text("body,target,x_mm,y_mm,z_mm\n" + "\n".join(lines) + "\n")
    moved = [(pose, k, place + np.array([500.0 * pose, 0.0, 0.0])) for pose in (1, 2) for k, place in enumerate(survey)]
    rows = [f"{pose},T{k},{x * factor:.8f},{y * factor:.8f},{z * factor:.8f}" for pose, k, (x, y, z) in moved]
    (folder / "tracker.csv").write_text("pose_id,smr,x,y,z\n" + "\n".join(rows) + "\n")


@pytest.mark.parametrize(("factor", "unit"), [(1.0, "mm"), (1e-3, "m"), (1.0 / 25.4, "in")])
def test_a_survey_gives_the_unit_and_the_body_of_points(tmp_path: Path, factor: float, unit: str) -> None:
    surveyed(tmp_path, factor)
    _, document = init(tmp_path)
    entry = document["files"]["points"]
    assert (entry["unit"], entry["constants"]) == (unit, {"body": "hand"})
    assert "check:" not in (tmp_path / "campaign.toml").read_text(encoding="utf-8")


def test_a_survey_of_other_targets_leaves_the_unit_open(tmp_path: Path) -> None:
    surveyed(tmp_path, 1e-3)
    points = (tmp_path / "tracker.csv").read_text().replace("T", "Q")
    (tmp_path / "tracker.csv").write_text(points)
    _, document = init(tmp_path)
    assert "unit" not in document["files"]["points"]
    assert "no unit is given" in (tmp_path / "campaign.toml").read_text(encoding="utf-8")


def test_rows_of_zeros_are_lost_targets_in_whichever_file_they_stand(tmp_path: Path) -> None:
    places = RNG.uniform(1000.0, 2000.0, (3, 80, 3)).round(3)
    places[2, 70] = 0.0
    for target, rows in enumerate(places, 1):
        (tmp_path / f"smr_{target}.txt").write_text("\n".join(f"{x} {y} {z}" for x, y, z in rows) + "\n")
    _, document = init(tmp_path)
    assert document["files"]["points"]["missing"] == ["0 0 0"]
    assert len(table(tmp_path, document, POINTS).table) == 239


def test_one_uncertainty_of_all_axes_keeps_its_factor_and_unit(tmp_path: Path) -> None:
    rows = "".join(f"1;base;{name};1,{k};2,{k};3,{k};24,0\n" for k, name in enumerate("ABC", 1))
    header = "Messung;Körper;Punktname;X [mm];Y [mm];Z [mm];Unsicherheit U (k=2) [µm]"
    (tmp_path / "p.csv").write_text(f"{header}\n{rows}", encoding="cp1252")
    _, document = init(tmp_path)
    found = table(tmp_path, document, POINTS)
    assert_close(numbers(found, "sigma_x_mm", "sigma_z_mm"), [[0.012, 0.012]] * 3, atol=1e-15, what="sigma")
    assert "coverage = 2, uncertainties are assumed" in (tmp_path / "campaign.toml").read_text(encoding="utf-8")


def test_deviations_of_an_axis_become_positions(tmp_path: Path) -> None:
    rows = [
        f"{cycle};{sign};{target},0;{k + cycle},5"
        for cycle in (1, 2)
        for sign in "+-"
        for k, target in enumerate((0, 50, 100))
    ]
    (tmp_path / "axis.csv").write_text("Lauf;Richtung;Zielposition [mm];Abweichung [µm]\n" + "\n".join(rows) + "\n")
    _, document = init(tmp_path)
    found = table(tmp_path, document, POSITIONING)
    assert set(found.table.column("direction").to_pylist()) == {"forward", "backward"}
    assert numbers(found, "deviation_um").ravel()[:3].tolist() == [1.5, 2.5, 3.5]


def test_an_axis_with_an_autocollimator_has_deviations(tmp_path: Path) -> None:
    rows = [f"{10 * k},{10 * k},{0.5 + 0.1 * k},20.1" for k in range(8)]
    header = "commanded_angle_deg,encoder_deg,autocollimator_arcsec,air_temp_C"
    (tmp_path / "table.csv").write_text(f"{header}\n" + "\n".join(rows) + "\n")
    _, document = init(tmp_path)
    entry = document["files"]["configurations"]
    assert entry["columns"]["deviation_deg"] == "autocollimator_arcsec"
    assert entry["units"] == {"deviation_deg": "arcsec"}
    assert "assumed to be the deviation" in (tmp_path / "campaign.toml").read_text(encoding="utf-8")


def test_loads_and_signals_in_variables_of_matlab_are_read(tmp_path: Path) -> None:
    signals, force, moment = RNG.normal(size=(9, 6)), RNG.normal(size=(9, 3)), RNG.normal(size=(9, 3))
    savemat(tmp_path / "calib.mat", {"data": {"U_mV": signals, "F_kN": force, "M_Nm": moment}, "note": "sensor 7"})
    _, document = init(tmp_path)
    found = table(tmp_path, document, SIGNALS)
    assert_close(numbers(found, "fx_n", "fy_n", "fz_n"), 1e3 * force, atol=1e-9, what="forces")
    assert_close(numbers(found, "mx_nm", "my_nm", "mz_nm"), moment, atol=1e-12, what="moments")
    assert_close(numbers(found, *(f"v{k}_mv" for k in range(1, 7))), signals, atol=1e-12, what="signals")


def test_variables_that_mean_nothing_known_are_listed(tmp_path: Path) -> None:
    savemat(tmp_path / "log.mat", {"alpha": np.ones((9, 4)), "beta": np.ones((5, 2))})
    text, document = init(tmp_path)
    assert "alpha 9x4, beta 5x2" in text
    assert "files" not in document


def test_a_file_that_nothing_reads_is_named_by_check(tmp_path: Path) -> None:
    (tmp_path / "strange.csv").write_text("alpha,beta\n1,2\n3,4\n")
    init(tmp_path)
    done = CliRunner().invoke(app, ["check", str(tmp_path)])
    assert done.exit_code == 2
    assert "no entry reads strange.csv" in done.stdout + done.stderr


@pytest.mark.parametrize(
    "heads", [("command_mm", "motor_mm", "measured_mm"), ("Command [mm]", "Motor [mm]", "Laser [mm]")]
)
def test_a_linear_axis_in_millimetres_is_read_as_one(tmp_path: Path, heads: tuple[str, ...]) -> None:
    rows = [f"{k},{k + 0.001:.3f},{k - 0.002:.3f}" for k in (10, 20, 30, 20, 10)]
    (tmp_path / "axis.csv").write_text("\n".join([",".join(heads), *rows]) + "\n")
    found = table(tmp_path, init(tmp_path)[1], CONFIGURATIONS)
    assert_close(
        numbers(found, "command_mm")[:, 0], np.array([10.0, 20.0, 30.0, 20.0, 10.0]), atol=0.0, what="commands"
    )
    assert_close(numbers(found, "measured_mm")[0], np.array([9.998]), atol=1e-9, what="instrument")


def test_a_pose_has_one_row_of_configurations_where_another_file_has_the_readings(tmp_path: Path) -> None:
    """The tracker's file of poses also holds a temperature; the robot's file counts the same poses."""
    head, turn = "X [mm],Y [mm],Z [mm],Q0,Q1,Q2,Q3,Temperature [C]", "0.8,0.6,0,0"
    places = RNG.uniform(-500.0, 500.0, (5, 3)).round(3)
    rows = [f"{','.join(map(str, place))},{turn},22.{k}" for k, place in enumerate(places)]
    (tmp_path / "leica.csv").write_text("\n".join([head, *rows]) + "\n")
    joints = [",".join(map(str, own)) for own in (57.0 * JOINTS).round(4)]
    (tmp_path / "theta.csv").write_text("\n".join(["j1,j2,j3", *joints]) + "\n")
    found = table(tmp_path, init(tmp_path)[1], CONFIGURATIONS)
    expected = (57.0 * JOINTS).round(4)
    assert_close(numbers(found, "joint1_deg", "joint2_deg", "joint3_deg"), expected, atol=1e-9, what="joints")


def test_positions_below_merged_cells_are_runs_of_both_directions(tmp_path: Path) -> None:
    book = openpyxl.Workbook()
    sheet = book.active
    assert sheet is not None
    for row in (
        ["Y-Achse"],
        [],
        ["Soll", "Ist (hin)", None, "Ist (zurück)"],
        ["mm", "Lauf 1", "Lauf 2", "Lauf 1", "Lauf 2"],
    ):
        sheet.append(row)
    places = np.array([[at, at + 0.001, at + 0.002, at - 0.001, at - 0.002] for at in (0.0, 50.0, 100.0)])
    for place in places.tolist():
        sheet.append(place)
    sheet.merge_cells("B3:C3")
    sheet.merge_cells("D3:E3")
    book.save(tmp_path / "axis.xlsx")
    _, document = init(tmp_path)
    found = table(tmp_path, document, POSITIONING)
    columns = [found.table.column(name).to_pylist() for name in ("target_mm", "direction", "cycle", "position_mm")]
    rows = zip(*columns, strict=True)
    signs = {("forward", 1): 1, ("forward", 2): 2, ("backward", 1): 3, ("backward", 2): 4}
    assert sorted(rows) == sorted(
        (place[0], *side, place[column]) for place in places.tolist() for side, column in signs.items()
    )
