"""Poses measured by an instrument: all notations give the same pose, and invalid ones are refused."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.sentences import assert_says
from tests.stages.line import run_line
from tests.tolerance import assert_close
from truing.report.measured_section import measured
from truing.report.poses_section import poses as poses_section
from truing.schemas.faults import CampaignFaults

RNG = np.random.default_rng(3)
COUNT = 6
PLACES = RNG.uniform(-900.0, 900.0, (COUNT, 3))  # mm
TURNS = Rotation.from_rotvec(RNG.uniform(-1.5, 1.5, (COUNT, 3)))
XYZ = [f"{a}_mm" for a in "xyz"]
HEAD = '[campaign]\nname = "c"\nkind = "photogrammetry"\n[noise]\ndisplacement_mm = 0.02\nrotation_rad = 2e-5\n'
MATRIX = [f"m{i}{j}" for i in range(4) for j in range(4)]


def matrices():
    whole = np.tile(np.eye(4), (COUNT, 1, 1))
    whole[:, :3, :3], whole[:, :3, 3] = TURNS.as_matrix(), PLACES
    return whole


WAYS = {
    "quaternion": (["qw", "qx", "qy", "qz"], TURNS.as_quat(scalar_first=True), ""),
    "rotation vector": (["rx_rad", "ry_rad", "rz_rad"], TURNS.as_rotvec(), ""),
    **{
        f"euler {order}": (
            ["euler_a_deg", "euler_b_deg", "euler_c_deg"],
            TURNS.as_euler(order, degrees=True),
            f'[poses]\neuler = "{order}"\n',
        )
        for order in ("XYZ", "xyz", "ZYX", "ZXZ")
    },
}


def table(folder: Path, columns, values, head=HEAD, body="tool"):
    with (folder / "poses.csv").open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["pose", "body", *columns])
        writer.writerows([number + 1, body, *map(repr, row)] for number, row in enumerate(np.asarray(values).tolist()))
    (folder / "campaign.toml").write_text(head)
    return folder


def written(folder, way, **more):
    columns, values, toml = WAYS[way]
    return table(folder, [*XYZ, *columns], np.hstack([PLACES, values]), HEAD + toml, **more)


def faults(folder):
    with pytest.raises(CampaignFaults) as caught:
        run_line(folder, "ingest")
    return caught.value.faults


def vectors(found):
    return np.column_stack([found.column(f"r{a}_rad").to_numpy() for a in "xyz"])


def covariances(found):
    whole = np.zeros((found.num_rows, 6, 6))
    for i in range(6):
        for j in range(i, 6):
            whole[:, i, j] = whole[:, j, i] = found.column(f"cov_{i}_{j}").to_numpy()
    return whole


@pytest.mark.parametrize("way", WAYS)
def test_every_way_of_writing_a_pose_is_that_pose(tmp_path, way):
    tables, said = run_line(written(tmp_path, way), "ingest", "pose", "deformation", "diagnose", "calibrate")
    found = tables["poses"]
    assert_close(vectors(found), TURNS.as_rotvec(), atol=1e-12)
    assert_close([found.column(f"p{a}_mm").to_numpy() for a in "xyz"], PLACES.T, atol=1e-9)
    assert_close(covariances(found), np.diag([2e-5**2] * 6)[None].repeat(COUNT, 0), atol=1e-22)
    assert {tuple(row[name] for name in ("parent", "method", "default", "status")) for row in found.to_pylist()} == {
        ("measurement", "measured", True, "ok")
    }
    assert "no points" in said["diagnose"].figure


def test_a_matrix_per_row(tmp_path):
    tables, _ = run_line(table(tmp_path, MATRIX, matrices().reshape(COUNT, 16)), "ingest", "pose")
    assert_close(vectors(tables["poses"]), TURNS.as_rotvec(), atol=1e-12)
    assert_close([tables["poses"].column(f"p{a}_mm").to_numpy() for a in "xyz"], PLACES.T, atol=1e-9)


def test_matrices_one_below_the_other_in_metres(tmp_path):
    whole = matrices()
    whole[:, :3, 3] *= 1e-3
    np.savetxt(tmp_path / "T.txt", whole.reshape(-1, 4))
    entry = (
        '[files.poses]\npath = "T.txt"\nheader = false\nrows_per_pose = 4\nunit = "m"\nconstants = { body = "tool" }\n'
    )
    (tmp_path / "campaign.toml").write_text(HEAD + entry)
    tables, _ = run_line(tmp_path, "ingest", "pose")
    assert tables["poses"].column("pose").to_pylist() == list(range(1, COUNT + 1))
    assert_close(vectors(tables["poses"]), TURNS.as_rotvec(), atol=1e-12)
    assert_close([tables["poses"].column(f"p{a}_mm").to_numpy() for a in "xyz"], PLACES.T, atol=1e-9)


def test_sigmas_of_euler_angles_turn_about_their_own_axes(tmp_path):
    columns, angles, toml = WAYS["euler ZYX"]
    sigma = np.array([0.01, 0.02, 0.03])
    values = np.hstack([PLACES, angles, np.tile(sigma, (COUNT, 1))])
    folder = table(tmp_path, [*XYZ, *columns, *(f"sigma_{name}" for name in columns)], values, HEAD + toml)
    tables, _ = run_line(folder, "ingest")
    step = 1e-6
    slopes = np.stack(
        [
            (Rotation.from_euler("ZYX", angles + step * unit, degrees=True) * TURNS.inv()).as_rotvec() / step
            for unit in np.eye(3)
        ],
        axis=-1,
    )  # rad per degree, by differences
    wanted = slopes @ np.diag(sigma**2) @ np.swapaxes(slopes, 1, 2)
    assert_close(covariances(tables["measured_poses"])[:, 3:, 3:] / wanted.max(), wanted / wanted.max(), atol=1e-5)


def test_a_declared_covariance_is_carried_along(tmp_path):
    root = RNG.normal(size=(6, 6)) * 1e-5
    covariance = root @ root.T
    names = [f"cov_{i}_{j}" for i in range(6) for j in range(i, 6)]
    upper = np.tile(covariance[np.triu_indices(6)], (COUNT, 1))
    columns, values, _ = WAYS["quaternion"]
    folder = table(tmp_path, [*XYZ, *columns, *names], np.hstack([PLACES, values, upper]))
    tables, _ = run_line(folder, "ingest", "pose")
    assert_close(
        covariances(tables["poses"]) / covariance.max(),
        covariance[None].repeat(COUNT, 0) / covariance.max(),
        atol=1e-12,
    )
    wrong = upper.copy()
    wrong[2, 1] = 10.0 * np.sqrt(covariance[0, 0] * covariance[1, 1])
    table(tmp_path, [*XYZ, *columns, *names], np.hstack([PLACES, values, wrong]))
    (fault,) = faults(tmp_path)
    assert (fault.row, fault.column) == (4, "cov_0_0")


def broken(way, row, change):
    columns, values, toml = WAYS[way]
    values = values.copy()
    values[row] = change(values[row])
    return [*XYZ, *columns], np.hstack([PLACES, values]), HEAD + toml


@pytest.mark.parametrize(("way", "unit"), [("euler ZXZ", np.pi / 180.0), ("rotation vector", 1.0)])
def test_angles_are_kept_as_recorded(tmp_path, way, unit):
    found = run_line(written(tmp_path, way), "ingest")[0]["measured_poses"]
    kept = np.column_stack([found.column(f"recorded_{a}_rad").to_numpy() for a in "abc"])
    assert_close(kept, unit * np.asarray(WAYS[way][1]), atol=1e-12)


def test_quaternions_have_no_recorded_angles(tmp_path):
    found = run_line(written(tmp_path, "quaternion"), "ingest")[0]["measured_poses"]
    assert "recorded_a_rad" not in found.column_names


@pytest.mark.parametrize(("largest", "unit"), [(390.0, "gon"), (2e4, "deg")])
def test_angles_beyond_a_turn_are_asked_for_their_unit(tmp_path, largest, unit):
    columns, _, toml = WAYS["euler XYZ"]
    angles = np.linspace(0.9 * largest, largest, 3 * COUNT).reshape(COUNT, 3)
    table(tmp_path, [*XYZ, *columns], np.hstack([PLACES, angles]), HEAD + toml)
    assert_says(faults(tmp_path)[0].expected, "did you mean", f'"{unit}"')


def test_a_quaternion_has_the_norm_one(tmp_path):
    table(tmp_path, *broken("quaternion", 1, lambda q: 1.1 * q))
    (fault,) = faults(tmp_path)
    assert (fault.file, fault.row, fault.column) == ("poses.csv", 3, "qw")
    table(tmp_path, *broken("quaternion", 1, lambda q: np.round(q, 4)))  # as controllers print it
    run_line(tmp_path, "ingest")


def test_degrees_are_no_radians(tmp_path):
    columns, values, _ = WAYS["rotation vector"]
    table(tmp_path, [*XYZ, *columns], np.hstack([PLACES, np.degrees(values)]))
    found = faults(tmp_path)
    assert {fault.column for fault in found} <= {"rx_rad", "ry_rad", "rz_rad"}
    assert_says(found[0].expected, "did you mean", "degrees")
    (tmp_path / "campaign.toml").write_text(
        HEAD + '[files.poses]\npath = "poses.csv"\nunits = { rx_rad = "deg", ry_rad = "deg", rz_rad = "deg" }\n'
    )
    tables, _ = run_line(tmp_path, "ingest")
    assert_close(vectors(tables["measured_poses"]), TURNS.as_rotvec(), atol=1e-12)


@pytest.mark.parametrize(
    ("change", "column", "said"),
    [
        (lambda T: T @ np.diag([1.0, 1.0, -1.0, 1.0]), "m00", "mirrors"),
        (lambda T: T @ np.diag([1.0, 1.02, 1.0, 1.0]), "m00", "right angles"),
        (lambda T: T.T, "m30", "written by columns"),
    ],
)
def test_a_matrix_is_a_rotation(tmp_path, change, column, said):
    whole = matrices()
    whole[2] = change(whole[2])
    table(tmp_path, MATRIX, whole.reshape(COUNT, 16))
    found = {fault.column: fault for fault in faults(tmp_path)}
    assert found[column].row == 4
    assert said in found[column].expected


@pytest.mark.parametrize(
    ("columns", "column"),
    [
        ([*XYZ], "poses"),  # a place alone is a point
        ([*XYZ, "qw", "qx", "qy"], "qz"),
        ([*XYZ, "qw", "qx", "qy", "qz", "rx_rad", "ry_rad", "rz_rad"], "poses"),
        ([*XYZ[:2], "qw", "qx", "qy", "qz"], "z_mm"),
        ([*XYZ, "euler_a_deg", "euler_b_deg", "euler_c_deg"], "poses.euler"),
    ],
)
def test_half_a_pose_is_a_fault(tmp_path, columns, column):
    values = np.zeros((COUNT, len(columns)))
    if "qw" in columns:
        values[:, columns.index("qw")] = 1.0
    table(tmp_path, columns, values)
    assert column in {fault.column for fault in faults(tmp_path)}


def test_poses_need_a_standard_deviation(tmp_path):
    columns, values, _ = WAYS["quaternion"]
    bare = HEAD.partition("[noise]")[0]
    table(tmp_path, [*XYZ, *columns], np.hstack([PLACES, values]), bare)
    assert {fault.column for fault in faults(tmp_path)} == {"noise.displacement_mm", "noise.rotation_rad"}


def test_a_pose_of_a_body_comes_once(tmp_path):
    folder = written(tmp_path, "quaternion")
    text = (folder / "poses.csv").read_text()
    (folder / "poses.csv").write_text(text + text.splitlines()[-1] + "\n")
    (fault,) = faults(folder)
    assert fault.row == COUNT + 2


def test_rows_without_numbers_are_left_out_where_that_is_declared(tmp_path):
    folder = written(tmp_path, "quaternion")
    lines = (folder / "poses.csv").read_text().splitlines()
    lines[3] = ",".join([*lines[3].split(",")[:2], *["nan"] * 7])
    (folder / "poses.csv").write_text("\n".join(lines) + "\n")
    assert faults(folder)
    (folder / "campaign.toml").write_text(HEAD + '[files.poses]\npath = "poses.csv"\nmissing = ["nan"]\n')
    tables, _ = run_line(folder, "ingest", "pose")
    assert tables["poses"].column("pose").to_pylist() == [1, 2, 4, 5, 6]


def test_bodies_are_seen_from_the_reference(tmp_path):
    folder = written(tmp_path, "quaternion", body="base")
    rows = (folder / "poses.csv").read_text().splitlines()
    tool = Rotation.from_rotvec([0.1, -0.2, 0.3])
    place = np.array([10.0, 20.0, 30.0])
    at, turned = PLACES + TURNS.apply(place), (TURNS * tool).as_quat(scalar_first=True)
    for number in range(COUNT):
        rows.append(",".join([str(number + 1), "tool", *map(repr, [*at[number].tolist(), *turned[number].tolist()])]))
    (folder / "poses.csv").write_text("\n".join(rows) + "\n")
    (folder / "campaign.toml").write_text(HEAD + '[bodies]\nreference = "base"\n')
    tables, _ = run_line(folder, "ingest", "pose")
    own = [row for row in tables["poses"].to_pylist() if row["body"] == "tool"]
    assert {row["parent"] for row in own} == {"base"}
    assert_close([[row[f"p{a}_mm"] for a in "xyz"] for row in own], np.tile(place, (COUNT, 1)), atol=1e-9)
    assert_close([[row[f"r{a}_rad"] for a in "xyz"] for row in own], np.tile(tool.as_rotvec(), (COUNT, 1)), atol=1e-9)


def test_a_file_called_poses_stays_what_campaign_toml_says_it_is(tmp_path):
    (tmp_path / "poses.csv").write_text("pose,time_s\n1,0\n2,1\n")
    (tmp_path / "points.csv").write_text("pose,body,target,x_mm,y_mm,z_mm\n1,b,A,0,0,0\n2,b,A,0,0,1\n")
    (tmp_path / "campaign.toml").write_text(
        HEAD.replace("displacement_mm = 0.02", "point_mm = 0.02") + '[files.configurations]\npath = "poses.csv"\n'
    )
    tables, _ = run_line(tmp_path, "ingest")
    assert "measured_poses" not in tables
    assert tables["configurations"].num_rows == 2


def test_euler_angles_of_unknown_order_are_one_fault_with_their_sigmas_or_without(tmp_path):
    columns, angles, _ = WAYS["euler ZYX"]
    values = np.hstack([PLACES, angles, np.full((COUNT, 3), 0.01)])
    (fault,) = faults(table(tmp_path, [*XYZ, *columns, *(f"sigma_{name}" for name in columns)], values))
    assert fault.column == "poses.euler"


def test_the_page_says_that_measured_poses_were_taken_as_given(tmp_path):
    tables, _ = run_line(written(tmp_path, "quaternion"), "ingest", "pose")
    frames = {name: table.to_pandas() for name, table in tables.items() if name in ("configurations", "poses")}
    seen, poses = measured(frames), poses_section(frames)
    assert seen.state != "empty"
    assert f"{COUNT} poses were measured directly" in seen.lead
    assert "taken as given: nothing was fitted" in poses.lead
    assert len(poses.figures) == 1
