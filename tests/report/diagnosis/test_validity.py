"""The page names the left-out blocks that tested a finding, or measurements that would allow a test."""

from __future__ import annotations

import pytest

from tests.report.diagnosis_parts import part_of
from tests.report.diagnosis_tables import GAIN_3, diagnosis_tables, row, rows
from tests.sentences import assert_says, says
from truing.report.diagnosis.assessed_causes import assessed_causes
from truing.report.diagnosis.prediction_errors import POINTS, READINGS, PartNames
from truing.report.diagnosis.section import diagnosis
from truing.report.diagnosis.validity import held_out_sentences


def said(of: PartNames = POINTS, **left_out: object) -> list[str]:
    table = rows(row("actuator-gain", subject="leg3", parameters=GAIN_3, **left_out))
    return held_out_sentences(assessed_causes({"diagnosis": table}), of)


@pytest.mark.parametrize(
    ("kind", "of", "words"),
    [
        ("day", POINTS, "4 days that are sensitive to it"),
        ("region", POINTS, "4 regions of the workspace"),
        ("region", READINGS, "4 ranges of the loads"),
        ("run", READINGS, "4 runs"),
        ("series", POINTS, "4 series"),
        ("direction", POINTS, "4 directions of approach"),
    ],
)
def test_excluded_observations_are_reported_with_their_number(kind: str, of: PartNames, words: str) -> None:
    (one,) = said(of, left_out_by=kind, left_out_blocks=4, left_out_gain=7.0)
    assert words in one
    assert_says(one, "supports", "actuator gain (leg 3)", "1,100 to 1")


@pytest.mark.parametrize(
    ("gain", "words"),
    [
        (900.0, "supports actuator gain (leg 3) (odds of more than 1,000,000 to 1 for it)"),
        (1.0, "does not decide about actuator gain (leg 3) (odds of 2.72 to 1 for it)"),
        (-1.0, "does not decide about actuator gain (leg 3) (odds of 2.72 to 1 against it)"),
        (-7.0, "contradicts actuator gain (leg 3) (odds of 1,100 to 1 against it)"),
    ],
)
def test_odds_are_reported_except_those_near_one(gain: float, words: str) -> None:
    (one,) = said(left_out_by="day", left_out_blocks=3, left_out_gain=gain)
    assert words in one


def test_without_blocks_the_page_says_what_to_measure() -> None:
    (points,), (readings,) = said(left_out_by="none"), said(READINGS, left_out_by="none")
    for one in (points, readings):
        assert_says(one, "Not cross-validated", "actuator gain (leg 3)")
    assert_says(points, "four poses", "three days", "each quarter")
    assert_says(readings, "three runs", "four ranges")


def test_an_effect_of_one_block_is_reported_as_such() -> None:
    (one,) = said(left_out_by="one-block")
    assert_says(one, "Not cross-validated", "actuator gain (leg 3)")
    assert_says(one, "only one")


def test_the_gain_on_left_out_blocks_is_shown_only_where_a_run_has_it() -> None:
    reported = row("actuator-gain", left_out_by="region", left_out_blocks=4, left_out_gain=30.0)
    assert_says(part_of("gain", diagnosis_tables(rows(reported))).lead, "regions", "sensitive", "left out", "in turn")
    assert not says(part_of("gain", diagnosis_tables(rows(row("actuator-gain")))).lead, "left out", "in turn")
    assert said() == []


def test_a_finding_that_blocks_contradict_is_suspected_for_that() -> None:
    doubted = row("actuator-gain", "suspected", reason_code="elsewhere", left_out_by="day", left_out_gain=-9.0)
    section = diagnosis(diagnosis_tables(rows(doubted)))
    assert section is not None
    assert_says(section.statements[0][1], "left-out parts", "worse")


def test_blocks_favour_a_form_that_was_searched_for_in_them_no_more_than_all_data_do() -> None:
    weak = {"verdict": "suspected", "reason_code": "weak", "log_evidence": 0.5, "probability": 0.46}
    (one,) = said(left_out_by="region", left_out_blocks=4, left_out_gain=20.0, **weak)
    assert_says(one, "does not decide", "1.65 to 1 for it")
    lead = part_of("evidence", diagnosis_tables(rows(row("actuator-gain", **weak)))).lead
    assert_says(lead, "over no effect by only 1.65 to 1")
    assert "less probable" not in lead
