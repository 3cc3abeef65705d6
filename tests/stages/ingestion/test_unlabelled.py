"""Campaigns without names: unlabelled points and dense scans, from files to poses."""

from __future__ import annotations

import csv
import shutil
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from typer.testing import CliRunner

from tests.blind.generator.disguise import write_ply
from tests.stages.line import run_line
from tests.tolerance import assert_close
from truing.estimation.rotation import exp_so3, log_so3
from truing.pipeline.campaign_run import PROJECT
from truing.pipeline.command_line import app

SAMPLE = PROJECT / "sample_data" / "telescope"
# Every third pose, so that ingest takes a second.
POSES = {str(pose) for pose in range(0, 47, 3)}
# 99.99 % of a chi-square of six degrees of freedom.
SURE = 27.86


def without(columns: set[str], folder: Path) -> Path:
    """The sample campaign, its points shuffled and without some of their columns."""
    folder.mkdir()
    for name in ("campaign.toml", "targets.csv"):
        shutil.copy(SAMPLE / name, folder / name)
    for name, dropped in (("configurations.csv", set()), ("points.csv", columns)):
        with (SAMPLE / name).open(encoding="utf-8", newline="") as file:
            rows = [row for row in csv.DictReader(file) if row["pose"] in POSES]
        if dropped:
            rows = [rows[i] for i in np.random.default_rng(0).permutation(len(rows))]
        with (folder / name).open("w", encoding="utf-8", newline="") as file:
            writer = csv.DictWriter(file, [key for key in rows[0] if key not in dropped], extrasaction="ignore")
            writer.writeheader()
            writer.writerows(rows)
    return folder


@pytest.fixture(scope="module")
def labelled(tmp_path_factory):
    """The tables of the sample campaign as it stands."""
    return run_line(without(set(), tmp_path_factory.mktemp("labelled") / "campaign"), "ingest", "pose")[0]


def named(observations):
    keys = zip(*(observations.column(name).to_pylist() for name in ("pose", "x_mm", "y_mm", "z_mm")), strict=True)
    labels = zip(*(observations.column(name).to_pylist() for name in ("body", "target")), strict=True)
    return dict(zip(keys, labels, strict=True))


def default_poses(poses):
    rows = [row for row in poses.to_pylist() if row["default"]]
    return {(row["pose"], row["body"]): row for row in rows}


def covariance(row):
    return np.array([[row[f"cov_{min(i, j)}_{max(i, j)}"] for j in range(6)] for i in range(6)])


@pytest.mark.parametrize("columns", [{"target"}, {"body", "target"}])
def test_points_without_names_give_the_poses_of_those_with_names(columns, labelled, tmp_path):
    folder = without(columns, tmp_path / "campaign")
    result = CliRunner().invoke(app, ["run", str(folder), "--out", str(tmp_path / "out"), "--only", "pose"])
    assert result.exit_code == 0, result.output
    found, truth = (
        named(table) for table in (pq.read_table(tmp_path / "out" / "observations.parquet"), labelled["observations"])
    )
    assert all(truth[point] == label for point, label in found.items())
    # Gross errors, of which the sample has one in two hundred, fit no target and stay nameless.
    left_out = pq.read_table(tmp_path / "out" / "exclusions.parquet")
    assert sum(left_out.column("rows").to_pylist()) == len(truth) - len(found)
    assert len(found) >= 0.99 * len(truth)
    poses, expected = (
        default_poses(table) for table in (pq.read_table(tmp_path / "out" / "poses.parquet"), labelled["poses"])
    )
    assert poses.keys() == expected.keys()
    for key, row in poses.items():
        sigma = np.sqrt(np.diag(covariance(expected[key])))
        for i, name in enumerate(("px_mm", "py_mm", "pz_mm", "rx_rad", "ry_rad", "rz_rad")):
            unit = 1e3 if name.endswith("_mm") else 1.0
            assert_close(row[name], expected[key][name], atol=0.1 * unit * sigma[i], what=f"{name} of {key}")


def test_a_body_that_only_its_symmetry_describes_is_a_fault_with_its_rivals(tmp_path):
    angle = np.arange(6) * np.pi / 3
    ring = 100.0 * np.c_[np.cos(angle), np.sin(angle), np.zeros(6)]
    folder = tmp_path / "campaign"
    folder.mkdir()
    (folder / "campaign.toml").write_text(
        '[campaign]\nname = "ring"\nkind = "photogrammetry"\n[noise]\npoint_mm = 0.005\n', encoding="utf-8"
    )
    targets = [f"ring,P{k + 1},{x},{y},{z}" for k, (x, y, z) in enumerate(ring)]
    points = [f"{pose},ring,{x},{y},{z}" for pose in (1, 2) for x, y, z in ring + 10.0 * pose]
    (folder / "targets.csv").write_text("\n".join(["body,target,x_mm,y_mm,z_mm", *targets]), encoding="utf-8")
    (folder / "points.csv").write_text("\n".join(["pose,body,x_mm,y_mm,z_mm", *points]), encoding="utf-8")
    result = CliRunner().invoke(app, ["run", str(folder), "--out", str(tmp_path / "out")])
    assert result.exit_code == 2, result.output
    assert " as P" in result.output
    assert "symmetry" in result.output


def surface(rng, n, size):
    """A body of some 100 mm without any symmetry: mm."""
    d = rng.normal(size=(n, 3))
    x, y, z = (d / np.linalg.norm(d, axis=1)[:, None]).T
    radius = size * (1 + 0.15 * x * y + 0.2 * z**2 - 0.1 * x**3 + 0.1 * np.sin(3 * y) + 0.08 * x * z)
    return np.c_[1.2 * x, y, 0.7 * z] * radius[:, None]


SCANS = """[campaign]
name = "scanned"
kind = "photogrammetry"
[bodies]
reference = "frame"
[files.scans]
path = "scans/*.ply"
from_name = 'pose(?P<pose>\\d+)_(?P<body>[a-z]+)'
unit = "mm"
[files.surfaces]
path = "surfaces/*.ply"
from_name = '(?P<body>[a-z]+)'
unit = "mm"
"""


def scanned_campaign(folder: Path, sizes: dict[str, float], noise_mm: float) -> Path:
    """One PLY per pose and body: in pose k the mirror has turned by k x 0.02 rad about z, 300 mm up."""
    rng = np.random.default_rng(0)
    folder.mkdir()
    (folder / "campaign.toml").write_text(SCANS, encoding="utf-8")
    for body, size in sizes.items():
        reference = surface(rng, 4000, size)
        write_ply(folder / "surfaces" / f"{body}.ply", reference + rng.normal(scale=noise_mm, size=reference.shape))
        for pose in (1, 2):
            turn, up = (exp_so3(np.array([0, 0, 0.02 * pose])), 300.0) if body == "mirror" else (np.eye(3), 0.0)
            scan = surface(rng, 3000, size) @ turn.T + [0.0, 0.0, up + 0.5 * pose]
            write_ply(folder / "scans" / f"pose{pose}_{body}.ply", scan + rng.normal(scale=noise_mm, size=scan.shape))
    return folder


def test_a_scan_per_pose_and_body_gives_the_pose_between_the_bodies(tmp_path):
    folder = scanned_campaign(tmp_path / "campaign", {"frame": 100.0, "mirror": 60.0}, 0.02)
    result = CliRunner().invoke(app, ["run", str(folder), "--out", str(tmp_path / "out")])
    assert result.exit_code == 0, result.output
    assert (tmp_path / "out" / "report.html").exists()
    poses = default_poses(pq.read_table(tmp_path / "out" / "poses.parquet"))
    assert set(poses) == {(pose, body) for pose in (1, 2) for body in ("frame", "mirror")}
    for (pose, body), row in poses.items():
        assert (row["method"], row["status"]) == ("scan", "ok")
        assert row["parent"] == ("frame" if body == "mirror" else "measurement")
        turned, up = (0.02 * pose, 300.0) if body == "mirror" else (0.0, 0.5 * pose)
        shift = 1e-3 * np.array([row["px_mm"], row["py_mm"], row["pz_mm"] - up])
        turn = exp_so3(np.array([row["rx_rad"], row["ry_rad"], row["rz_rad"]]))
        error = np.r_[shift, log_so3(turn @ exp_so3(np.array([0, 0, -turned])))]
        assert error @ np.linalg.solve(covariance(row), error) < SURE


def test_scans_that_belong_nowhere_are_faults_all_at_once(tmp_path):
    folder = scanned_campaign(tmp_path / "campaign", {"frame": 100.0}, 0.02)
    (folder / "configurations.csv").write_text("pose\n1\n", encoding="utf-8")
    (folder / "surfaces" / "frame.ply").rename(folder / "surfaces" / "fram.ply")
    result = CliRunner().invoke(app, ["run", str(folder), "--out", str(tmp_path / "out")])
    assert result.exit_code == 2, result.output
    assert "a body with a reference surface in [files.surfaces]; there are fram" in result.output
    assert "a pose of configurations" in result.output
    assert not (tmp_path / "out" / "scans.parquet").exists()
