"""Rows of the benchmark table: choice of the best peer, and whether the limit holds."""

from __future__ import annotations

import json
from dataclasses import asdict, replace

import numpy as np
import pytest

from benchmarks.collection import Collected, Record
from benchmarks.page import renewed, table
from benchmarks.rows import Holds, Peer, PeerState, Row, record_row, timed_row

SECONDS = {"ours": np.array([1.0, 1.0, 2.0]), "fast": np.array([3.0, 3.0, 9.0]), "slow": np.array([8.0, 8.0, 8.0])}


def test_ratios_are_taken_repeat_by_repeat_and_the_best_peer_has_the_smallest() -> None:
    row = timed_row("a fit", SECONDS, "ours", unit="s", least_ratio=3.0)
    assert (row.value, row.best) == (1.0, Peer("fast", 3.0, 3.0, PeerState.MEASURED))
    assert row.holds is Holds.YES


def test_an_unmeasured_peer_is_never_beaten() -> None:
    row = timed_row("a fit", SECONDS, "ours", unmeasured=["absent"], least_ratio=3.0)
    assert row.holds is Holds.OPEN
    assert row.unmeasured == ("absent",)
    assert timed_row("a fit", {"ours": SECONDS["ours"]}, "ours", least_ratio=3.0).holds is Holds.OPEN


def test_a_measured_peer_that_is_too_near_decides_though_another_is_unmeasured() -> None:
    assert timed_row("a fit", SECONDS, "ours", unmeasured=["absent"], least_ratio=3.5).holds is Holds.NO


def test_a_peer_that_misses_the_solution_has_no_ratio() -> None:
    row = timed_row("a fit", SECONDS, "ours", missed=["fast"], least_ratio=3.5)
    assert row.best is not None
    assert (row.best.name, row.holds) == ("slow", Holds.YES)


def test_ours_that_misses_the_solution_leaves_no_row() -> None:
    with pytest.raises(ValueError, match="a fit: ours missed the solution"):
        timed_row("a fit", SECONDS, "ours", missed=["ours"])


@pytest.mark.parametrize(
    ("row", "holds"),
    [
        (Row("time", 1.0, "s", limit=1.2), Holds.YES),
        (Row("time", 1.3, "s", limit=1.2), Holds.NO),
        (Row("rate", 1.3, "1/s", limit=1.2, more_is_better=True), Holds.YES),
        (Row("rate", 1.1, "1/s", limit=1.2, more_is_better=True), Holds.NO),
        (Row("time", 1.0, "s"), Holds.NO_LIMIT),
    ],
)
def test_a_limit_of_the_value_itself(row: Row, holds: Holds) -> None:
    assert row.holds is holds


def test_rows_are_left_in_the_named_file_alone(tmp_path, monkeypatch) -> None:  # type: ignore[no-untyped-def]
    row = timed_row("a fit", SECONDS, "ours", unmeasured=["absent"], least_ratio=3.0)
    record_row(row)
    monkeypatch.setenv("TRUING_BENCHMARK_ROWS", str(tmp_path / "rows"))
    record_row(row)
    (line,) = (tmp_path / "rows").read_text().splitlines()
    assert Row.read(json.loads(line)) == row
    assert json.loads(line) == json.loads(json.dumps(asdict(row)))


def _record(benchmark: str, what: str) -> Record:
    return Record(benchmark, "2026-01-02", "2 × a processor", 0.5, "wall", Row(what, 2000.0, "ms", limit=3000.0))


def test_the_table_shows_value_limit_date_and_machine() -> None:
    *_, shown, _, _, _, machine = table([_record("pose", "a fit")]).splitlines()
    assert shown == "| a fit | 2,000 ms | – | – | ≤ 3,000 ms | yes | – | wall | 2026-01-02 | 1, load 0.5 |"
    assert machine == "1. 2 × a processor"


def test_new_rows_replace_those_of_the_same_benchmark_alone() -> None:
    before = [_record("pose", "old"), _record("bundle", "kept")]
    found = Collected("pose", 0, (replace(before[0], row=replace(before[0].row, what="new")),))
    assert [(one.benchmark, one.row.what) for one in renewed(before, [found])] == [("bundle", "kept"), ("pose", "new")]
