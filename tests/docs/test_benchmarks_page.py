"""docs/benchmarks.md shows the rows that were kept, and names the benchmarks without any."""

from __future__ import annotations

from benchmarks.collection import BENCHMARKS
from benchmarks.page import PAGE, kept, whole
from tests.docs.shown import shown


def test_the_page_shows_the_rows_that_were_kept() -> None:
    assert shown(PAGE.read_text(encoding="utf-8"), "benchmarks") == whole(kept())


def test_rows_are_of_benchmarks_that_exist_and_the_others_are_named() -> None:
    measured = {record.benchmark for record in kept()}
    assert measured
    assert measured <= set(BENCHMARKS)
    text = PAGE.read_text(encoding="utf-8")
    assert all((f"{name}" in text.partition("Not measured")[2]) for name in set(BENCHMARKS) - measured)
