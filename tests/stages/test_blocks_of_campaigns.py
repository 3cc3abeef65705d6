"""Blocks of a campaign from its tables: repeats, series, runs, days, directions and regions."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa

import truing
from truing.inference.blocks import BlockKind
from truing.report.page import all_of
from truing.stages.common.blocks import groupings_of, labels_of, repeats_of, selected_groupings

POSES = ("a", "b", "c", "d", "e")
TABLE = pa.table(
    {
        "pose": ["e", "d", "c", "b", "a"],
        "rho1_mm": [1.0, 1.001, 2.0, 2.001, 3.0],
        "rho2_mm": [5.0, 5.0, 6.0, 7.0, 8.0],
        "series": ["x", "y", "y", None, "x"],
    }
)


def test_repeats_are_numbered_in_the_order_of_the_poses() -> None:
    numbers = repeats_of(TABLE, POSES, (), 1e-3)
    assert numbers is not None
    assert numbers[POSES.index("e")] == numbers[POSES.index("d")] >= 0
    assert (numbers[[POSES.index(name) for name in "abc"]] == -1).all()
    once = repeats_of(TABLE, POSES, (), 0.0)
    assert once is not None
    assert (once == -1).all()


def test_without_a_command_nothing_is_known_of_repeats() -> None:
    assert repeats_of(None, POSES, (), 0.0) is None
    assert repeats_of(TABLE.select(["pose", "series"]), POSES, (), 0.0) is None
    declared = TABLE.select(["pose"]).append_column("repeat_of", pa.array(["d", None, None, None, "e"]))
    numbers = repeats_of(declared, POSES, (), 0.0)
    assert numbers is not None
    assert [POSES[row] for row in np.flatnonzero(numbers >= 0)] == ["a", "d", "e"]


def test_series_are_what_the_table_names_and_unnamed_rows_belong_to_none() -> None:
    found = labels_of(TABLE, POSES)
    assert set(found) == {BlockKind.SERIES}
    series = found[BlockKind.SERIES]
    assert series[POSES.index("a")] == series[POSES.index("e")] != series[POSES.index("c")]
    assert series[POSES.index("b")] == -1
    assert labels_of(None, POSES) == {}


def test_only_what_is_known_groups_epochs() -> None:
    inputs = np.array([[0.0, 1.0], [0.0, 2.0], [0.0, 3.0], [0.0, 4.0]])
    found = groupings_of(inputs, None, None)
    assert set(found) == {BlockKind.REGION}
    assert len(np.unique(found[BlockKind.REGION])) == 4
    assert groupings_of(np.zeros((4, 0)), None, None) == {}
    full = groupings_of(inputs, np.array([0.0, 1.0, 9e4, 9e4]), np.array([[1.0], [1.0], [-1.0], [1.0]]))
    assert full[BlockKind.DAY].tolist() == [0, 0, 1, 1]
    assert full[BlockKind.DIRECTION].tolist() == [1, 1, 0, 1]
    assert selected_groupings(full, np.array([False, True, True, False]))[BlockKind.DAY].tolist() == [0, 1]


def test_the_sample_shows_where_its_finding_pays(sample_run: Path) -> None:
    rows = truing.load(sample_run)["diagnosis"]
    found = rows[rows["verdict"] == "found"]
    assert len(found)
    assert (found["left_out_by"] == "region").all()
    assert (found["left_out_gain"] > np.log(20.0)).all()
    assert found["left_out_blocks"].between(2, 4).all()
    assert rows.loc[rows["verdict"] == "rejected", "left_out_by"].isna().all()


def test_a_few_poses_cannot_show_whether_a_finding_holds_elsewhere(workplace: Path) -> None:
    run = truing.load(workplace / "runs" / "telescope")
    rows = run["diagnosis"]
    assert rows.loc[rows["verdict"] == "found", "left_out_by"].unique().tolist() == ["none"]
    tests = run["adequacy"].set_index("test")
    assert tests.loc["pure-error", "state"] == "not tested"
    assert tests.loc["pure-error", "why_untested"] in ("no-repeats", "too-few")
    (gain,) = (section for section in all_of(run.sections) if section.id == "gain")
    assert "holds elsewhere. To test it, measure at least four poses on each of three days" in gain.lead
