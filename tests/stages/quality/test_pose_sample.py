"""Poses that the checks examine: all of few, runs of many, with a message."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from tests.stages.test_pose import points_table
from truing.pipeline.campaign_folder import SettingsView
from truing.schemas.artifact import StoredTable
from truing.schemas.artifacts import ARTIFACTS
from truing.schemas.campaign import read_campaign
from truing.stages import qa
from truing.stages.quality import pose_sample as sample

POSES, NAMES = 300, [f"t{k}" for k in range(6)]


def observed(rng: np.random.Generator) -> pa.Table:
    shape = rng.uniform(-0.2, 0.2, (6, 3))
    table = points_table({"plate": shape + 5e-6 * rng.normal(size=(POSES, 6, 3))}, {"plate": NAMES}, list(range(POSES)))
    return table.select(ARTIFACTS["observations"].columns).cast(ARTIFACTS["observations"].arrow_schema())


@pytest.mark.parametrize(("total", "some"), [(10, 10), (10, 3), (1000, 100), (1000, 999), (100_000, 6400), (64, 1)])
def test_runs_are_spread_over_all_and_hold_about_as_many_as_asked(total: int, some: int) -> None:
    rows = sample.spread_runs(total, some)
    assert len(np.unique(rows)) == len(rows)
    assert rows.min() >= 0
    assert rows.max() < total
    assert (min(some, total) <= len(rows) + sample.RUNS and len(rows) <= some + sample.RUNS) or len(rows) == total
    if some > 1:
        assert rows[0] == 0
        assert rows[-1] == total - 1


def test_few_points_are_all_examined() -> None:
    table = observed(np.random.default_rng(1))
    found = sample.pose_sample(table, None)
    assert found.is_whole
    assert found.points is table
    assert found.note == ""


def test_runs_of_poses_follow_the_time_and_are_read_from_the_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Poses are numbered against the time: the first run is the earliest ones."""
    _limit(monkeypatch)
    table = observed(np.random.default_rng(2))
    pq.write_table(table, tmp_path / "observations.parquet", row_group_size=100)
    stored = StoredTable(tmp_path / "observations.parquet", ARTIFACTS["observations"])
    configurations = pa.table({"pose": range(POSES), "time_s": [float(-pose) for pose in range(POSES)]})
    found = sample.pose_sample(stored, configurations)
    assert found.poses == tuple(range(POSES))
    assert found.examined[:5] == (299, 298, 297, 296, 295)
    assert found.points.num_rows == 6 * len(found.examined) < table.num_rows / 2
    assert set(found.points.column("pose").to_pylist()) == set(found.examined)
    assert found.points.schema.field("target").type == pa.string()


def _limit(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in (("MOST_POINTS", 1000), ("SOME_POINTS", 600), ("RUNS", 10)):
        monkeypatch.setattr(sample, name, value)


def test_every_check_of_points_says_which_poses_it_examined(monkeypatch: pytest.MonkeyPatch) -> None:
    table = observed(np.random.default_rng(3))
    configurations = pa.table(
        {"pose": range(POSES + 1), "role": ["calibration"] * (POSES + 1), "time_s": np.arange(POSES + 1.0) * 10.0}
    )
    rule = {"target": "t0", "pose": 7, "by": "Ann", "reason": "knocked"}
    campaign = read_campaign({"campaign": {"name": "c", "kind": "photogrammetry"}, "exclude": [rule]})
    given = {"observations": table, "configurations": configurations}

    def run() -> tuple[list[dict], str]:
        outcome = qa.run(given, SettingsView(campaign, qa.DECLARATION.settings), lambda *_: None)
        return outcome.artifacts["qa"].to_pylist(), outcome.read

    rows, read = run()
    assert not any("Examined" in row["message"] for row in rows)
    assert read == "1,800 points of 1 body in 300 poses"
    _limit(monkeypatch)
    some, read = run()
    assert read == "1,800 points of 1 body in 300 poses, examined those of 100 poses"
    subjects = [[(row["check"], row["subject"].split(" pose ")[0]) for row in reported] for reported in (rows, some)]
    assert subjects[0] == subjects[1]
    noted = {row["check"] for row in some if "Examined: 100 poses of 300" in row["message"]}
    assert {"completeness", "gross-errors", "exchanged-labels", "moved-targets", "noise", "names-known"} <= noted
    of_all = {row["check"]: row for row in some if "Examined" not in row["message"]}
    assert {"unobserved-poses", "time-gaps", "overruled"} <= set(of_all)
    # what concerns all poses is not decided by a few of them
    assert "pose 300" in of_all["unobserved-poses"]["message"]
    assert of_all["overruled"]["value"] == 1.0
