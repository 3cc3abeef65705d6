"""Poses of observations read in batches and written in blocks equal those of the whole table."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from tests.stages.test_pose import campaign, settings  # noqa: F401 -- a fixture
from tests.tolerance import assert_close
from truing.estimation.blocks import pose_blocks
from truing.schemas.artifact import StoredTable, plain_texts
from truing.schemas.artifacts import ARTIFACTS
from truing.stages import pose
from truing.stages.rigid_poses import body_poses

KEYS = {
    "poses": [("pose", "ascending"), ("body", "ascending"), ("method", "ascending")],
    "residuals": [("pose", "ascending"), ("body", "ascending"), ("target", "ascending")],
}


@pytest.fixture
def streamed(campaign, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):  # noqa: F811
    """The same tables with observations in a file, and blocks of a few poses."""

    def run(by: str, surveyed: bool, **sections):
        table = campaign["observations"].sort_by([(by, "ascending")])
        path = tmp_path / f"{by}.parquet"
        pq.write_table(table, path, row_group_size=37)
        tables = {"observations": StoredTable(path, ARTIFACTS["observations"])}
        if surveyed:
            tables["survey"] = campaign["survey"]
        with monkeypatch.context() as patch:
            patch.setattr(body_poses, "pose_blocks", partial(pose_blocks, points=70))
            outcome = pose.run(tables, settings(bodies={"reference": "base"}, **sections), lambda *_: None)
            assert isinstance(outcome.artifacts["poses"], pa.RecordBatchReader)
            return {name: plain_texts(_as_table(found)) for name, found in outcome.artifacts.items()}, outcome

    return run


def _as_table(found: pa.Table | pa.RecordBatchReader) -> pa.Table:
    return found.read_all() if isinstance(found, pa.RecordBatchReader) else found


@pytest.mark.parametrize("by", ["pose", "target"])
@pytest.mark.parametrize("surveyed", [True, False])
def test_streams_are_the_tables_of_all_poses_at_once(campaign, streamed, by: str, surveyed: bool) -> None:  # noqa: F811
    given = {"observations": campaign["observations"].sort_by([(by, "ascending")])}
    given |= {"survey": campaign["survey"]} if surveyed else {}
    whole = pose.run(given, settings(bodies={"reference": "base"}), lambda *_: None)
    found, outcome = streamed(by, surveyed)
    for name, key in KEYS.items():
        assert isinstance(whole.artifacts[name], pa.Table)
        _same(found[name].sort_by(key), whole.artifacts[name].sort_by(key))
        assert not ARTIFACTS[name].faults(found[name])
    assert (outcome.read, outcome.left_out, outcome.figure) == (whole.read, whole.left_out, whole.figure)


def test_names_of_poses_may_be_texts(campaign, tmp_path: Path) -> None:  # noqa: F811
    table = campaign["observations"]
    texts = table.set_column(table.schema.get_field_index("pose"), "pose", table.column("pose").cast(pa.string()))
    path = tmp_path / "texts.parquet"
    pq.write_table(texts, path)
    stored = StoredTable(path, ARTIFACTS["observations"])
    found = pose.run({"observations": stored}, settings(bodies={"reference": "base"}), lambda *_: None)
    numbered = pose.run({"observations": table}, settings(bodies={"reference": "base"}), lambda *_: None)
    rows = plain_texts(_as_table(found.artifacts["poses"])).to_pylist()
    as_texts = [row | {"pose": str(row["pose"])} for row in numbered.artifacts["poses"].to_pylist()]
    order = ("pose", "body", "method")
    rows, as_texts = (sorted(own, key=lambda row: [row[name] for name in order]) for own in (rows, as_texts))
    assert [[row[name] for name in order] for row in rows] == [[row[name] for name in order] for row in as_texts]
    assert_close([row["px_mm"] for row in rows], [row["px_mm"] for row in as_texts], atol=1e-9)


def test_exclusions_hold_in_a_stream(campaign, streamed) -> None:  # noqa: F811
    rule = {"body": "platform", "target": "P0", "pose": 3, "by": "Ann", "reason": "knocked"}
    whole = pose.run(
        {name: campaign[name] for name in ("observations", "survey")},
        settings(bodies={"reference": "base"}, exclude=[rule]),
        lambda *_: None,
    )
    found, _ = streamed("pose", True, exclude=[rule])
    assert found["exclusion_effects"].num_rows == 1
    _same(found["exclusion_effects"], plain_texts(whole.artifacts["exclusion_effects"]))
    excluded = [row for row in found["residuals"].to_pylist() if row["decision"] == "excluded"]
    assert [(row["pose"], row["target"]) for row in excluded] == [(3, "P0")]


def _same(found: pa.Table, expected: pa.Table) -> None:
    assert found.column_names == expected.column_names
    assert found.num_rows == expected.num_rows
    for name in found.column_names:
        a, b = found.column(name), expected.column(name)
        if pa.types.is_floating(a.type):
            assert a.is_null().equals(b.is_null())
            x, y = (np.nan_to_num(np.asarray(c.to_numpy(zero_copy_only=False), float)) for c in (a, b))
            assert_close(x, y, atol=1e-10 * float(np.abs(y).max(initial=1e-30)), what=name)
        else:
            assert a.to_pylist() == b.to_pylist(), name
