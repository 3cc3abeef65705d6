"""`truing init` on headings other than a single row of names: keys and values, comments, rows of units."""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

from tests.pipeline.test_init_exports import JOINTS, init, numbers, table
from tests.tolerance import assert_close
from truing.formats.raw_tables import CONFIGURATIONS, POINTS, POSES, POSITIONING, SIGNALS
from truing.pipeline.command_line import app
from truing.pipeline.problems import ExitCode

RNG = np.random.default_rng(12)
FORCES, SIGNALS_MV = RNG.normal(size=(6, 3)).round(4), RNG.normal(size=(6, 4)).round(6)


def labview(decimal: str) -> str:
    """A LabVIEW measurement file with three forces and four bridges; its names end in an empty column of comments."""
    names = ["X_Value", "Fx", "Fy", "Fz", *(f"Bridge_{k}" for k in range(4)), "Comment"]
    units = ["Y_Unit_Label", "N", "N", "N", *["mV/V"] * 4]
    heads = [
        ["LabVIEW Measurement", ""], ["Separator", "Tab"], ["Decimal_Separator", decimal], ["X_Columns", "One"],
        ["***End_of_Header***", ""], ["Channels", "7", ""], ["Samples", *["6"] * 7], units,
        ["X_Dimension", *["Time"] * 7], ["Delta_X", *["0.5"] * 7], ["***End_of_Header***", *[""] * 7], names,
    ]  # fmt: skip
    rows = [
        [f"{0.5 * k:.6f}", *(f"{value:.6f}" for value in (*force, *signals))]
        for k, (force, signals) in enumerate(zip(FORCES, SIGNALS_MV, strict=True))
    ]
    rows = [[cell.replace(".", decimal) for cell in row] for row in rows]
    return "\n".join("\t".join(row) for row in [*heads, *rows]) + "\n"


@pytest.mark.parametrize("decimal", [".", ","])
def test_a_labview_measurement_file_has_names_and_units_of_its_channels(tmp_path: Path, decimal: str) -> None:
    (tmp_path / "bridge.lvm").write_text(labview(decimal))
    found = table(tmp_path, init(tmp_path)[1], SIGNALS)
    assert_close(numbers(found, "fx_n", "fy_n", "fz_n"), FORCES, atol=1e-9, what="forces")
    assert_close(numbers(found, *(f"v{k}_mv" for k in range(1, 5))), SIGNALS_MV, atol=1e-9, what="signals")
    assert_close(numbers(found, "time_s")[:, 0], 0.5 * np.arange(6), atol=1e-12, what="time")


@pytest.mark.parametrize(("last_line", "separator"), [("EOF\n", "\t"), ("", ";")])
def test_channels_of_twincat_scope_are_pairs_of_time_and_value(tmp_path: Path, last_line: str, separator: str) -> None:
    names = ["Axis1_ActPos", "Axis1_SetPos", "Laser_Pos"]
    keys = {"Name": names, "SampleTime[ms]": ["2"] * 3, "Data-Type": ["REAL64"] * 3}
    heads = [
        ["Name", "Scope01"],
        ["File", "axis.svdx"],
        [],
        *([key for v in row for key in (name, v)] for name, row in keys.items()),
    ]
    places = [(k + 0.0005, float(k), k - 0.0025) for k in (0, 10, 20, 10, 0, 30)]
    rows = [[cell for value in row for cell in (str(2 * k), f"{value:.4f}")] for k, row in enumerate(places)]
    text = "\n".join(separator.join(row) for row in [*heads, *rows]) + f"\n{last_line}"
    (tmp_path / "scope.csv").write_text(text)
    document = init(tmp_path)[1]
    unit = "deg" if "command_deg" in document["files"]["configurations"]["columns"] else "mm"
    found = table(tmp_path, document, CONFIGURATIONS)
    columns = numbers(found, f"motor_{unit}", f"command_{unit}", f"measured_{unit}")
    assert_close(columns, places, atol=1e-9, what="positions")
    assert_close(numbers(found, "time_s")[:, 0], 0.002 * np.arange(6), atol=1e-12, what="time")
    assert not any(name.startswith("time 2") for name in found.table.column_names)


@pytest.mark.parametrize("name", ["joint_states.csv", "log.csv"])
def test_the_name_of_a_file_does_not_hide_the_names_of_its_joints(tmp_path: Path, name: str) -> None:
    rows = [f"{100.0 + k},{','.join(map(str, row))}" for k, row in enumerate(JOINTS)]
    (tmp_path / name).write_text("\n".join(["timestamp,actual_q_0,actual_q_1,actual_q_2", *rows]) + "\n")
    found = table(tmp_path, init(tmp_path)[1], CONFIGURATIONS)
    assert_close(numbers(found, *(f"joint{k}_rad" for k in (1, 2, 3))), JOINTS, atol=0.0, what="joints")


def test_numbers_of_pose_and_target_in_names_and_a_column_of_units(tmp_path: Path) -> None:
    body, rows = RNG.uniform(-50.0, 50.0, (3, 3)), ["Feature,Type,Actual X,Actual Y,Actual Z,Unit"]
    turns = Rotation.random(8, rng=RNG).as_matrix()
    places = np.einsum("pij,kj->pki", turns, body) + RNG.uniform(-900.0, 900.0, (8, 1, 3))
    for pose, points in enumerate(places, 1):
        rows += [f"PT{pose:03d}_{k},Point,{x:.4f},{y:.4f},{z:.4f},in" for k, (x, y, z) in enumerate(points / 25.4, 1)]
    (tmp_path / "report.csv").write_text("\n".join(rows) + "\n")
    document = init(tmp_path)[1]
    document["files"]["points"]["constants"] = {"body": "tool"}
    found = table(tmp_path, document, POINTS)
    assert document["files"]["points"]["unit"] == "in"
    assert [int(pose) for pose in found.table.column("pose").to_pylist()[::3]] == list(range(1, 9))
    assert_close(numbers(found, "x_mm", "y_mm", "z_mm"), places.reshape(-1, 3), atol=2e-3, what="points")


@pytest.mark.parametrize("mark", ["# ", ""])
def test_names_with_units_above_columns_that_blanks_part(tmp_path: Path, mark: str) -> None:
    rows = [f"{10.0 * k:8.3f}  {'CW' if k < 4 else 'CCW'}  {0.5 + 0.1 * k:8.3f}" for k in range(8)]
    (tmp_path / "table.txt").write_text("\n".join([f"{mark}Target [deg]  Direction  Error [arcsec]", *rows]) + "\n")
    reported, document = init(tmp_path)
    entry = document["files"]["configurations"]
    columns = {"command_deg": "Target [deg]", "deviation_deg": "Error [arcsec]", "approach": "Direction"}
    assert entry["columns"] == columns
    assert "--answer approach=" in reported, "all rows move to larger commands, so they do not tell the words"
    assert entry["units"] == {"deviation_deg": "arcsec"}


DEVIATIONS_UM = np.array([[-0.5, 3.1], [0.2, 3.6], [0.4, 4.2]])


def axis_runs(factor: float, words: str) -> str:
    rows = [f"{50 * k},{','.join(f'{factor * v:.6f}' for v in row)}" for k, row in enumerate(DEVIATIONS_UM)]
    return "\n".join([*filter(None, [words]), "Target,Run1 Fwd,Run1 Rev", *rows]) + "\n"


@pytest.mark.parametrize(
    ("factor", "words"), [(1e-3, "Units:,mm"), (1e-3, ""), (1.0, ""), (1.0, "Unit: um"), (1e-3, "All units are in mm")]
)
def test_deviations_have_the_unit_of_the_words_or_of_their_size(tmp_path: Path, factor: float, words: str) -> None:
    (tmp_path / "axis.csv").write_text(axis_runs(factor, words))
    text, document = init(tmp_path)
    found = table(tmp_path, document, POSITIONING)
    assert_close(numbers(found, "deviation_um")[:, 0], DEVIATIONS_UM.ravel(), atol=1e-9, what="deviations")
    assert ("Unit of the deviations" in text) == (words == "")


@pytest.mark.parametrize("first", [1000, 1])
def test_frames_of_an_instrument_next_to_a_log_without_numbers_are_poses_in_its_order(
    tmp_path: Path, first: int
) -> None:
    turns = Rotation.random(len(JOINTS), rng=RNG).as_quat()[:, [3, 0, 1, 2]]
    places = RNG.uniform(-900.0, 900.0, (len(JOINTS), 3)).round(3)
    rows = [
        f"{first + 60 * k},OK,{','.join(f'{v:.6f}' for v in (*turn, *place))}"
        for k, (turn, place) in enumerate(zip(turns, places, strict=True))
    ]
    (tmp_path / "tool_tracking.csv").write_text("\n".join(["Frame,State,Q0,Qx,Qy,Qz,Tx,Ty,Tz", *rows]) + "\n")
    joints = [",".join(map(str, row)) for row in JOINTS]
    (tmp_path / "joints.csv").write_text("\n".join(["actual_q_0,actual_q_1,actual_q_2", *joints]) + "\n")
    document = init(tmp_path)[1]
    found = table(tmp_path, document, POSES)
    assert [int(pose) for pose in found.table.column("pose").to_pylist()] == [1, 2, 3, 4, 5]
    assert set(found.table.column("body").to_pylist()) == {"tip"}
    assert_close(numbers(found, "x_mm", "y_mm", "z_mm"), places, atol=1e-9, what="places")


def test_numbered_spheres_without_a_log_may_be_one_target_in_as_many_poses(tmp_path: Path) -> None:
    places = RNG.uniform(-40.0, 40.0, (9, 3)).round(5)
    rows = [f"SPHERE{k:03d},Sphere,{x},{y},{z},0.0005" for k, (x, y, z) in enumerate(places, 1)]
    head = ["FARO CAM2 Measure 10", "Device: FaroArm", "Units: Inches", "", "Feature,Type,X,Y,Z,Form Error"]
    (tmp_path / "spheres.csv").write_text("\n".join([*head, *rows]) + "\n")
    text, document = init(tmp_path)
    assert "targets" in document["files"]
    assert "or one target in as many poses" in text
    (tmp_path / "campaign.toml").unlink()
    answers = ["--answer", "table=poses", "--answer", "body=tip"]
    assert CliRunner().invoke(app, ["init", str(tmp_path), *answers]).exit_code == ExitCode.DONE
    document = tomllib.loads((tmp_path / "campaign.toml").read_text(encoding="utf-8"))
    found = table(tmp_path, document, POINTS)
    assert [int(pose) for pose in found.table.column("pose").to_pylist()] == list(range(1, 10))
    assert set(found.table.column("target").to_pylist()) == {"reflector"}
    assert_close(numbers(found, "x_mm", "y_mm", "z_mm"), 25.4 * places, atol=1e-9, what="points")


def test_a_logger_of_both_encoders_of_a_linear_axis_below_words_of_its_own(tmp_path: Path) -> None:
    places = [(0.02 * k, 0.02 * k + 0.003 * np.sin(0.4 * k), 0.02 * k + 1e-4) for k in range(60)]
    rows = [f"{0.01 * k:.2f};{c:.4f};{m:.5f};{v:.5f};{0.4 + 0.001 * k:.3f}" for k, (c, m, v) in enumerate(places)]
    head = ["Logger: DL850 export", "Sampling: 100 Hz", "Date: 2024/06/03 15:21:07"]
    names = "Time [s];SetPos [mm];EncMotor [mm];EncLoad [mm];Current [A]"
    (tmp_path / "axis_run.csv").write_text("\n".join([*head, names, *rows]) + "\n")
    found = table(tmp_path, init(tmp_path)[1], CONFIGURATIONS)
    columns = numbers(found, "command_mm", "motor_mm", "load_mm")
    assert_close(columns, places, atol=1e-5, what="positions")
    assert_close(numbers(found, "time_s")[:, 0], 0.01 * np.arange(60), atol=1e-12, what="time")


def test_a_name_that_is_the_mark_of_a_comment_counts_rows(tmp_path: Path) -> None:
    places = (RNG.uniform(-500.0, 500.0, (4, 3)) + np.arange(5.0)[:, None, None]).round(4)
    lines = ["#API Radian", "#Units,mm", "#,Name,Group,X,Y,Z,RMS"]
    for pose, targets in enumerate(places):
        lines += [f"{k},T{k},plate_pos{pose},{x},{y},{z},0.004" for k, (x, y, z) in enumerate(targets)]
    (tmp_path / "radian.csv").write_text("\n".join(lines) + "\n")
    _, document = init(tmp_path)
    assert document["files"]["points"]["names"][0] == "#"
    found = table(tmp_path, document, POINTS)
    assert_close(numbers(found, "x_mm", "y_mm", "z_mm"), places.reshape(-1, 3), atol=1e-9, what="points")


@pytest.mark.parametrize("head", ["Pos No.", "Target number", "#", "Point"])
def test_numbers_of_targets_next_to_runs_are_no_run(tmp_path: Path, head: str) -> None:
    runs = RNG.normal(0.0, 1.0, (6, 4)).round(2)
    lines = [f"{head},Target(mm),Run1 Fwd(um),Run1 Rev(um),Run2 Fwd(um),Run2 Rev(um)"]
    lines += [",".join(map(str, [k + 1, 50 * k, *row])) for k, row in enumerate(runs)]
    (tmp_path / "x_axis.csv").write_text("\n".join(["Linear measurement", "Unit,mm/um", *lines]) + "\n")
    _, document = init(tmp_path)
    found = table(tmp_path, document, POSITIONING)
    assert_close(numbers(found, "deviation_um")[:, 0], runs.ravel(), atol=1e-9, what="deviations")


def test_names_that_are_paths_in_a_model_are_known_by_the_parts_that_differ(tmp_path: Path) -> None:
    heads = [f"Model Root/F{axis}_ref/Out1 [N]" for axis in "xyz"]
    heads += [f"Model Root/Bridge{k}/Out1 [mV/V]" for k in range(4)]
    rows = [";".join(map(str, [k, *f, *s])) for k, (f, s) in enumerate(zip(FORCES, SIGNALS_MV, strict=True))]
    lines = ["descriptions;load test", "version;2", ";".join(["t", *heads]), *rows]
    (tmp_path / "rec1.csv").write_text("\n".join(lines) + "\n")
    _, document = init(tmp_path)
    found = table(tmp_path, document, SIGNALS)
    assert_close(numbers(found, "fx_n", "fy_n", "fz_n"), FORCES, atol=1e-9, what="forces")
    assert_close(numbers(found, *(f"v{k}_mv" for k in range(1, 5))), SIGNALS_MV, atol=1e-9, what="signals")
