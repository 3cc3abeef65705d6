"""Slips as phrases: runs that are concerned as a whole, and single columns of them."""

from __future__ import annotations

import pytest

from truing.belonging.relation import RecordSlip, SlipKind
from truing.report.belonging import slip_words


@pytest.mark.parametrize(
    ("subjects", "words"),
    [
        (("run 2", "run 3"), "reading of run 2, run 3 in another unit"),
        (("all runs",), "reading of all runs in another unit"),
        (("dz", "run 2"), "reading dz, run 2 in another unit"),
        ((), "reading in another unit"),
    ],
)
def test_a_slip_of_whole_runs_is_one_of_their_readings(subjects: tuple[str, ...], words: str) -> None:
    assert slip_words(RecordSlip(SlipKind.UNIT, "reading", subjects)) == words
