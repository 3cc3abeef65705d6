"""Slips as phrases: runs that are concerned as a whole, and single columns of them."""

from __future__ import annotations

import pytest

from truing.belonging.relation import RecordSlip, RelationState, RelationTest, SlipKind
from truing.report.belonging import message, slip_words
from truing.report.numbers import quantity


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


def test_a_misfit_has_the_unit_of_the_columns_next_to_its_sentence() -> None:
    tested = RelationTest("points-against-survey", RelationState.OK, "agrees", misfit=0.00992, limit=0.141, unit="mm")
    assert f"(rms misfit {quantity(0.00992, 'mm')}, limit {quantity(0.141, 'mm')})" in message(tested)
