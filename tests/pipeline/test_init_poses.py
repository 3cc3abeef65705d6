"""`truing init` on poses of a rigid body next to a log of joints, and on a log of joints alone."""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from tests.pipeline.skeletons import activated
from tests.pipeline.test_init_exports import JOINTS, URDF, init, numbers, table
from tests.tolerance import assert_close
from truing.formats.raw_tables import POSES
from truing.pipeline.command_line import app

RNG = np.random.default_rng(31)
AT = RNG.uniform(-2.0, 2.0, (len(JOINTS), 3)).round(6)  # m
TURNED = RNG.normal(size=(len(JOINTS), 4))
TURNED /= np.linalg.norm(TURNED, axis=1)[:, None]  # quaternions, real part last
START_NS = 1_700_000_000_000_000_000


def joint_log(folder: Path) -> None:
    """A log of joints next to the robot's description."""
    (folder / "arm.urdf").write_text(URDF)
    rows = [f"{START_NS + k * 10**9},{','.join(map(str, row))}" for k, row in enumerate(JOINTS)]
    (folder / "log.csv").write_text("\n".join(["time,pan,lift,twist", *rows]) + "\n")


@pytest.mark.parametrize(
    "head",
    [
        "pos_x_m,pos_y_m,pos_z_m,quat_x,quat_y,quat_z,quat_w",
        "position_x_m,position_y_m,position_z_m,orientation_x,orientation_y,orientation_z,orientation_w",
        "tx [m],ty [m],tz [m],q_x,q_y,q_z,q_w",
        "pose.position.x [m],pose.position.y [m],pose.position.z [m],"
        "pose.orientation.x,pose.orientation.y,pose.orientation.z,pose.orientation.w",
    ],
)
def test_poses_of_a_rigid_body_next_to_a_log_are_those_of_the_last_link(tmp_path: Path, head: str) -> None:
    joint_log(tmp_path)
    rows = [
        ",".join(map(str, (START_NS + k * 10**9, 300 + 7 * k, "Flange", *place, *turned, 1)))
        for k, (place, turned) in enumerate(zip(AT, TURNED, strict=True))
    ]
    (tmp_path / "mocap.csv").write_text("\n".join([f"time_ns,frame,rigid_body,{head},tracked", *rows]) + "\n")
    _, document = init(tmp_path)
    found = table(tmp_path, document, POSES)
    assert set(found.table.column("body").to_pylist()) == {"hand"}
    assert list(map(int, found.table.column("pose").to_pylist())) == list(range(1, len(AT) + 1))
    assert_close(numbers(found, "x_mm", "y_mm", "z_mm"), 1e3 * AT, atol=1e-9, what="positions")
    assert_close(numbers(found, "qx", "qy", "qz", "qw"), TURNED, atol=1e-12, what="quaternions")
    assert document["measurement"] == {"frame": "campaign"}
    text = activated((tmp_path / "campaign.toml").read_text())
    assert "\ndisplacement_mm = " in text
    assert "\nrotation_rad = " in text


def test_the_column_of_the_rigid_body_names_the_only_body(tmp_path: Path) -> None:
    rows = [",".join(map(str, (k, "Platte", *p, *q))) for k, (p, q) in enumerate(zip(AT, TURNED, strict=True))]
    head = "Frame,Rigid Body,pos_x_m,pos_y_m,pos_z_m,quat_x,quat_y,quat_z,quat_w"
    (tmp_path / "mocap.csv").write_text("\n".join([head, *rows]) + "\n")
    _, document = init(tmp_path)
    assert set(table(tmp_path, document, POSES).table.column("body").to_pylist()) == {"Platte"}


def test_noise_of_a_chain_whose_measurement_is_missing_is_under_its_head(tmp_path: Path) -> None:
    joint_log(tmp_path)
    _, document = init(tmp_path)
    assert "poses" not in document["files"]
    lines = activated((tmp_path / "campaign.toml").read_text()).splitlines()
    assert {line.split(" =")[0] for line in lines[lines.index("[noise]") + 1 :]} >= {
        *("joint_deg", "point_mm", "displacement_mm", "rotation_rad"),
    }


def test_poses_as_commanded_are_not_read_as_measured_ones(tmp_path: Path) -> None:
    poses = [f"{k};{100 + k}.5;{k * k};3{k};{k};2;{k + 1}" for k in range(1, 13)]
    (tmp_path / "KRC_soll.csv").write_text("\n".join(["Nr;X;Y;Z;A;B;C", *poses]) + "\n")
    measured = [f"{k},{100 + k}.51,{k * k},3{k},1,0,0,0" for k in range(1, 13)]
    (tmp_path / "TMAC_ist.csv").write_text("\n".join(["id,x,y,z,q0,q1,q2,q3", *measured]) + "\n")
    done = CliRunner().invoke(app, ["init", str(tmp_path)])
    assert done.exit_code == 0, done.stderr
    document = tomllib.loads((tmp_path / "campaign.toml").read_text(encoding="utf-8"))
    assert document["files"]["poses"]["path"] == "TMAC_ist.csv"
    assert "KRC_soll.csv: poses as commanded (soll)" in done.stdout
    assert "export the joints of each pose" in done.stdout


def test_standard_deviations_next_to_poses_are_no_poses_and_readings_in_their_rows_are_joints(tmp_path: Path) -> None:
    """A robot's table with commanded poses, joints in rad without a unit, and measured poses with deviations."""
    axes = ("x", "y", "z", "rx", "ry", "rz")
    joints = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
    names = [f"Goal {axis}" for axis in ("x", "y", "z", "roll", "pitch", "yaw")]
    names += [f"{joint}_joint" for joint in joints]
    names += [*(f"measurement_{axis}" for axis in axes), *(f"measurement_std_{axis}" for axis in axes)]
    values = np.hstack(
        [
            RNG.uniform(-1.0, 1.0, (9, 6)),
            RNG.uniform(-3.0, 3.0, (9, 6)),
            RNG.uniform(-900.0, 900.0, (9, 3)),
            RNG.uniform(-170.0, 170.0, (9, 3)),
            RNG.uniform(0.001, 0.009, (9, 6)),
        ]
    ).round(6)
    text = "\n".join([";".join(names), *(";".join(map(str, row)) for row in values)]).replace(".", ",")
    (tmp_path / "poses.csv").write_text(text + "\n")
    printed, document = init(tmp_path)
    assert isinstance(document["files"]["poses"], dict)  # one entry: deviations are no second body
    columns = document["files"]["poses"]["columns"]
    assert [columns[f"sigma_{axis}_mm"] for axis in "xyz"] == [f"measurement_std_{axis}" for axis in "xyz"]
    logged = document["files"]["configurations"]["columns"]
    assert [logged[f"{joint}_joint_rad"] for joint in joints] == [f"{joint}_joint" for joint in joints]
    assert document["measurement"] == {"frame": "campaign"}
    assert "needed: a description of the robot" in printed
    assert 'joints = ["shoulder_pan_joint", ' in (tmp_path / "campaign.toml").read_text()
