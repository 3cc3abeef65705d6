"""Parquet, point clouds, C3D and TRC: written by their own libraries, read to the same table."""

from __future__ import annotations

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from tests.formats.reading import read, written
from tests.sentences import assert_says
from tests.tolerance import assert_close
from truing.open3d_library import load_open3d

RNG = np.random.default_rng(5)
POINTS = RNG.uniform(-100.0, 100.0, (6, 3))


def parquet(folder, **columns):
    pq.write_table(pa.table(columns), folder / "points.parquet")


def good_columns():
    return {
        "pose": [1, 1, 1, 2, 2, 2],
        "body": ["b"] * 6,
        "target": ["T1", "T2", "T3"] * 2,
        **{f"{axis}_mm": POINTS[:, i] for i, axis in enumerate("xyz")},
    }


@pytest.mark.parametrize(
    "change",
    [
        {},
        {"pose": pa.array([1.0, 1.0, 1.0, 2.0, 2.0, 2.0])},
        {"pose": pa.array(["1", "1", "1", "2", "2", "2"])},
        {"pose": pa.array([1, 1, 1, 2, 2, 2], pa.int16())},
        {"target": pa.array(["T1", "T2", "T3"] * 2).dictionary_encode()},
        {"target": pa.array(["T1", "T2", "T3"] * 2, pa.large_string())},
        {"x_mm": pa.array([f"{x!r}" for x in POINTS[:, 0].tolist()])},
        {"extra": pa.array([None] * 6, pa.string())},
    ],
)
def test_parquet_of_whatever_types(tmp_path, change):
    parquet(tmp_path, **{**good_columns(), **change})
    found = read(tmp_path)
    assert found.faults == ()
    assert found.columns["pose"] == [1, 1, 1, 2, 2, 2]
    assert found.columns["target"] == ["T1", "T2", "T3"] * 2
    assert_close([found.columns[f"{a}_mm"] for a in "xyz"], POINTS.T, atol=0.0)


@pytest.mark.parametrize("unit", ["s", "ms", "us", "ns"])
@pytest.mark.parametrize("kind", [pa.timestamp, pa.duration])
def test_moments_of_parquet_are_seconds(tmp_path, kind, unit):
    ticks = [seconds * {"s": 1, "ms": 10**3, "us": 10**6, "ns": 10**9}[unit] for seconds in (0, 10, 25)]
    table = pa.table({"pose": [1, 2, 3], "time_s": pa.array(ticks, kind(unit))})
    pq.write_table(table, tmp_path / "configurations.parquet")
    found = read(tmp_path, "configurations")
    assert found.faults == ()
    assert found.columns["time_s"] == [0.0, 10.0, 25.0]


@pytest.mark.parametrize("kind", [pa.timestamp("ns"), pa.timestamp("us", "UTC"), pa.duration("ms")], ids=str)
def test_a_moment_is_no_length(tmp_path, kind):
    parquet(tmp_path, **{**good_columns(), "x_mm": pa.array(range(6), kind)})
    found = read(tmp_path)
    assert {(fault.row, fault.column) for fault in found.faults} >= {(1, "x_mm")}
    assert {fault.column for fault in found.faults} == {"x_mm"}


def test_parquet_faults_count_rows_from_one(tmp_path):
    columns = good_columns()
    columns["y_mm"] = [1.0, float("nan"), 3.0, None, 5.0, float("inf")]
    parquet(tmp_path, **columns)
    faults = {(fault.row, fault.value) for fault in read(tmp_path).faults}
    assert faults == {(2, "nan"), (4, ""), (6, "inf")}
    found = read(tmp_path, entries={"path": "points.parquet", "missing": ["", "nan"]})
    assert {fault.value for fault in found.faults} == {"inf"}
    assert sum(found.left_out.values()) == 2


@pytest.mark.parametrize("cut", [40, 400])
def test_a_truncated_parquet_file_is_a_fault(tmp_path, cut):
    parquet(tmp_path, **good_columns())
    content = (tmp_path / "points.parquet").read_bytes()
    (tmp_path / "points.parquet").write_bytes(content[:cut])
    (fault,) = read(tmp_path).faults
    assert fault.file == "points.parquet"
    assert_says(fault.expected, "undamaged Parquet file")


def test_an_empty_parquet_table_is_a_fault(tmp_path):
    parquet(tmp_path, **{name: pa.array(values)[:0] for name, values in good_columns().items()})
    (fault,) = read(tmp_path).faults
    assert_says(fault.expected, "at least", "one row")


def test_both_points_csv_and_points_parquet_are_one_too_many(tmp_path):
    parquet(tmp_path, **good_columns())
    written(tmp_path, "points.csv", "pose,body,target,x_mm,y_mm,z_mm\n1,b,T,1,2,3\n")
    assert any("not both" in fault.expected for fault in read(tmp_path).faults)


CLOUD = {"from_name": r"pose(?P<pose>\d+)_(?P<body>\w+)\.", "unit": "m"}


@pytest.mark.parametrize("suffix", ["ply", "pcd", "xyz"])
@pytest.mark.parametrize("binary", [True, False])
def test_point_clouds_per_pose(tmp_path, suffix, binary):
    open3d = load_open3d()
    for pose in (2, 10):
        cloud = open3d.t.geometry.PointCloud(open3d.core.Tensor(POINTS * 1e-3 + pose))
        path = tmp_path / f"pose{pose}_plate.{suffix}"
        if suffix == "xyz":
            np.savetxt(path, POINTS * 1e-3 + pose, fmt="%.17g")
        else:
            open3d.t.io.write_point_cloud(str(path), cloud, write_ascii=not binary)
    found = read(tmp_path, entries={"path": f"*.{suffix}", **CLOUD})
    assert found.faults == ()
    assert found.columns["pose"] == [2] * 6 + [10] * 6
    assert set(found.columns["body"]) == {"plate"}
    expected = np.concatenate([POINTS + 2000.0, POINTS + 10000.0])
    tolerance = 1e-9 if suffix == "xyz" or binary else 0.05  # Open3D writes six digits: half of 0.0001 m at 10 m
    assert_close(np.column_stack([found.columns[f"{a}_mm"] for a in "xyz"]), expected, atol=tolerance)


@pytest.mark.parametrize("content", [b"ply\nformat ascii 1.0\nelement vertex 5\n", b"no cloud at all", b""])
@pytest.mark.parametrize("suffix", ["ply", "pcd"])
def test_clouds_that_are_none(tmp_path, capfd, suffix, content):
    (tmp_path / f"pose1_plate.{suffix}").write_bytes(content)
    (fault,) = read(tmp_path, entries={"path": f"*.{suffix}", **CLOUD}).faults
    assert fault.file == f"pose1_plate.{suffix}"
    assert capfd.readouterr().err == ""  # what the library has to say is the fault's


def write_c3d(path, unit="m"):
    """Four frames of three markers, the last of which is not seen in frame 1 (negative residual)."""
    import ezc3d

    frames = RNG.uniform(-1.0, 1.0, (3, 3, 4))
    file = ezc3d.c3d()
    file["parameters"]["POINT"]["RATE"]["value"] = [100]
    file["parameters"]["POINT"]["UNITS"]["value"] = [unit]
    file["parameters"]["POINT"]["LABELS"]["value"] = ["ArmL1", "ArmL2", "Head1"]
    points = np.ones((4, 3, 4))
    points[:3] = frames
    points[:3, 2, 1] = np.nan
    file["data"]["points"] = points
    file.write(str(path))
    return frames


def test_c3d_markers_over_frames(tmp_path):
    frames = write_c3d(tmp_path / "take.c3d")
    entry = {"path": "take.c3d", "split": {"label": r"(?P<body>[A-Za-z]+)(?P<target>\d)"}}
    found = read(tmp_path, entries=entry)
    assert found.faults == ()
    first = found.columns["pose"][0]
    rows = {(r["pose"] - first, r["body"], r["target"]): (r["x_mm"], r["y_mm"], r["z_mm"]) for r in found.rows}
    assert len(rows) == 4 * 3 - 1
    assert (1, "Head", "1") not in rows
    assert_close(rows[(2, "ArmL", "2")], 1000.0 * frames[:, 1, 2], atol=1e-4)  # C3D holds single precision
    assert sum(found.left_out.values()) == 1


def test_a_stated_unit_of_c3d_gives_way_to_the_mapping(tmp_path):
    frames = write_c3d(tmp_path / "take.c3d", unit="mm")
    entry = {"path": "take.c3d", "constants": {"body": "b"}, "unit": "m", "select": {"label": "ArmL1"}}
    found = read(tmp_path, entries=entry)
    assert_close(found.columns["x_mm"], 1000.0 * frames[0, 0], atol=1e-4)


def test_c3d_that_is_none(tmp_path):
    (tmp_path / "take.c3d").write_bytes(b"not a C3D file" * 100)
    (fault,) = read(tmp_path, entries={"path": "take.c3d", "constants": {"body": "b"}}).faults
    assert fault.file == "take.c3d"
    assert "undamaged C3D file" in fault.expected


TRC = (
    "PathFileType\t4\t(X/Y/Z)\twalk.trc\n"
    "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames\n"
    "100\t100\t3\t2\tm\t100\t1\t3\n"
    "Frame#\tTime\tLeft.Heel\t\t\tToe_R\t\t\n"
    "\t\tX1\tY1\tZ1\tX2\tY2\tZ2\n"
    "\n"
    "1\t0.00\t0.1\t0.2\t0.3\t0.4\t0.5\t0.6\n"
    "2\t0.01\t\t\t\t0.5\t0.5\t0.6\n"
    "3\t0.02\t0.3\t0.2\t0.3\t0.6\t0.5\t0.6\n"
)


def test_trc_markers_over_frames(tmp_path):
    written(tmp_path, "walk.trc", TRC)
    found = read(tmp_path, entries={"path": "walk.trc", "constants": {"body": "foot"}})
    assert found.faults == ()
    assert [(r["pose"], r["target"]) for r in found.rows] == [
        (1, "Left.Heel"), (1, "Toe_R"), (2, "Toe_R"), (3, "Left.Heel"), (3, "Toe_R"),
    ]  # fmt: skip
    assert_close(found.columns["x_mm"], [100.0, 400.0, 500.0, 300.0, 600.0], atol=1e-12)


def test_faults_in_trc_have_their_line(tmp_path):
    written(tmp_path, "walk.trc", TRC.replace("0.3\t0.2\t0.3\t0.6", "0.3\tx\t0.3\t0.6"))
    (fault,) = read(tmp_path, entries={"path": "walk.trc", "constants": {"body": "foot"}}).faults
    assert (fault.row, fault.value) == (9, "x")
    head, _, _ = TRC.partition("0.3\t0.2")
    written(tmp_path, "walk.trc", head)  # cut within a row
    assert read(tmp_path, entries={"path": "walk.trc", "constants": {"body": "foot"}}).faults
    written(tmp_path, "walk.trc", "something else\n")
    (fault,) = read(tmp_path, entries={"path": "walk.trc", "constants": {"body": "foot"}}).faults
    assert_says(fault.expected, "header lines", "TRC")


VSTARS = ["CODE1{0}-1353.223{0}2028.707{0}488.368{0}0.043{0}0.025{0}0.021{0}0.000", "T30{0}1{0}2{0}3{0}4{0}5{0}6{0}0"]


@pytest.mark.parametrize("separator", [",", " ", "\t", ";", ", ", "   "])
def test_vstars_exports_whatever_separates(tmp_path, separator):
    written(tmp_path, "Set_09.csv", "\r\n".join(line.format(separator) for line in VSTARS) + "\r\n")
    entry = {"path": "Set*.csv", "format": "vstars", "from_name": r"Set_(?P<pose>\d+)", "constants": {"body": "dish"}}
    found = read(tmp_path, entries=entry)
    assert found.faults == ()
    assert found.rows[0] == {
        "pose": 9, "body": "dish", "target": "CODE1", "x_mm": -1353.223, "y_mm": 2028.707, "z_mm": 488.368,
        "sigma_x_mm": 0.043, "sigma_y_mm": 0.025, "sigma_z_mm": 0.021,
    }  # fmt: skip


def test_vstars_exports_without_sigmas(tmp_path):
    written(tmp_path, "s.txt", "P1 1 2 3\nP2 4 5 6\n")
    found = read(tmp_path, entries={"path": "s.txt", "format": "vstars", "constants": {"body": "b", "pose": 1}})
    assert found.faults == ()
    assert "sigma_x_mm" not in found.columns


def test_tracker_exports_with_padding_and_thousands_commas(tmp_path):
    header = "Enabled\tFeature    \tID\tx          \ty  \tz         \ti\r\n"
    text = header + "Checked\tL_1_step   \t1 \t-856.1608  \t6,997.3007\t-5,601.2985 \t \r\n"
    written(tmp_path, "L_1.txt", text)
    entry = {"path": "L_1.txt", "format": "tracker", "from_name": r"(?P<body>L)_(?P<target>\d)"}
    found = read(tmp_path, entries=entry)
    assert found.faults == ()
    assert found.rows[0] == {
        "pose": 1, "body": "L", "target": "1", "x_mm": -856.1608, "y_mm": 6997.3007, "z_mm": -5601.2985,
    }  # fmt: skip
