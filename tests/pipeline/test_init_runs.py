"""Files of runs that each count their poses from 1 get an offset, which is said; other repeats of poses stay."""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np
from typer.testing import CliRunner

from truing.pipeline.command_line import app

COUNT = 12


def table(poses: range, numbers: np.ndarray, heads: str, name: str = "") -> str:
    """Text of a file with a row of numbers for each pose; ``name``: of the target."""
    rows = [
        ",".join([str(pose), *([name] if name else []), *(f"{number:.4f}" for number in row)])
        for pose, row in zip(poses, numbers, strict=True)
    ]
    return "\n".join([heads, *rows]) + "\n"


def points(poses: range, seed: int, target: str = "SMR1") -> str:
    numbers = np.random.default_rng(seed).normal(0.0, 900.0, (len(poses), 3))
    return table(poses, numbers, "pose,target,x [mm],y [mm],z [mm]", target)


def joints(poses: range, seed: int) -> str:
    numbers = np.random.default_rng(seed).normal(0.0, 60.0, (len(poses), 3))
    return table(poses, numbers, "pose,J1 [deg],J2 [deg],J3 [deg]")


def started(folder: Path, files: dict[str, str]) -> tuple[dict[str, dict[str, int]], str]:
    """Offset of the poses of each file in the campaign.toml of a folder, by table, and what the command printed."""
    folder.mkdir()
    for name, text in files.items():
        (folder / name).write_text(text, encoding="utf-8")
    result = CliRunner().invoke(app, ["init", str(folder)])
    assert result.exit_code == 0
    tables = tomllib.loads((folder / "campaign.toml").read_text(encoding="utf-8"))["files"]
    found: dict[str, dict[str, int]] = {}
    for name, entries in tables.items():
        for entry in entries if isinstance(entries, list) else [entries]:
            found.setdefault(name, {})[entry["path"]] = entry.get("offset", {}).get("pose", 0)
    return found, " ".join(result.output.split())


FIRST, ALL = range(1, COUNT + 1), range(1, 2 * COUNT + 1)


def test_logs_and_points_of_each_run_get_the_same_offset(tmp_path: Path) -> None:
    files = {f"joints_run{k}.csv": joints(FIRST, k) for k in (1, 2, 10)}
    files |= {f"tracker_run{k}.csv": points(FIRST, 20 + k) for k in (1, 2, 10)}
    found, text = started(tmp_path / "runs", files)
    for table, stem in (("configurations", "joints"), ("points", "tracker")):
        assert found[table] == {f"{stem}_run{k}.csv": offset for k, offset in ((1, 0), (2, COUNT), (10, 2 * COUNT))}
    assert f"+{COUNT}, +{2 * COUNT}" in text


def test_a_log_of_all_poses_decides_that_files_are_runs(tmp_path: Path) -> None:
    files = {"joints.csv": joints(ALL, 1), "tracker_1.csv": points(FIRST, 2), "tracker_2.csv": points(FIRST, 3)}
    found, _ = started(tmp_path / "runs", files)
    assert found["points"] == {"tracker_1.csv": 0, "tracker_2.csv": COUNT}


def test_repeats_of_the_poses_of_a_log_are_not_moved(tmp_path: Path) -> None:
    files = {"joints.csv": joints(FIRST, 1), "tracker_1.csv": points(FIRST, 2), "tracker_2.csv": points(FIRST, 3)}
    found, text = started(tmp_path / "repeats", files)
    assert set(found["points"].values()) == {0}
    assert "repeated measurements, or runs" in text


def test_files_of_other_targets_in_the_same_poses_are_not_moved(tmp_path: Path) -> None:
    files = {"joints.csv": joints(FIRST, 1)}
    files |= {f"tracker_{k}.csv": points(FIRST, k, f"SMR{k}") for k in (1, 2)}
    found, text = started(tmp_path / "targets", files)
    assert set(found["points"].values()) == {0}
    assert "runs" not in text


def test_numbers_that_go_on_are_not_moved(tmp_path: Path) -> None:
    later = range(COUNT + 1, 2 * COUNT + 1)
    files = {"joints.csv": joints(ALL, 1), "tracker_1.csv": points(FIRST, 2), "tracker_2.csv": points(later, 3)}
    found, _ = started(tmp_path / "parts", files)
    assert set(found["points"].values()) == {0}
