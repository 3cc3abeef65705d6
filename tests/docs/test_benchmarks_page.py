"""docs/benchmarks.md shows the rows that were kept, and every benchmark of the table is on it."""

from __future__ import annotations

from benchmarks.collection import BENCHMARKS
from benchmarks.page import PAGE, kept, table
from tests.docs.shown import shown


def test_the_page_shows_the_rows_that_were_kept() -> None:
    assert shown(PAGE.read_text(encoding="utf-8"), "benchmarks") == table(kept())


def test_every_benchmark_has_a_row() -> None:
    assert {record.benchmark for record in kept()} == set(BENCHMARKS)
