"""The pages on the quality of the diagnosis agree with their recorded results."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from benchmarks import blind_page
from benchmarks.blind import CYCLE, drawn
from benchmarks.blind_figures import theory
from benchmarks.blind_instruments import INSTRUMENTS
from tests.blind import rates
from tests.blind.judging import Assessed
from tests.docs.shown import shown
from tests.tolerance import assert_between, assert_close

CAMPAIGNS = {name: blind_page.kept_campaigns(own.results) for name, own in INSTRUMENTS.items()}


@pytest.mark.parametrize("name", ["goals", "causes", "layouts", "unknown", "wrong"])
@pytest.mark.parametrize("instrument", INSTRUMENTS)
def test_each_table_is_that_of_the_results_that_are_kept(instrument: str, name: str) -> None:
    # Not to the last digit: libraries differ in that of a quantile.
    own = INSTRUMENTS[instrument]
    tables = blind_page.tables(CAMPAIGNS[instrument], own)
    made, there = tables[name](), shown(own.page.read_text(encoding="utf-8"), name)
    assert _without_numbers(made) == _without_numbers(there)
    assert_close(_numbers(made), _numbers(there), atol=0.11)


def test_effects_that_nobody_had_thought_of_are_reported_as_counted() -> None:
    own = INSTRUMENTS["sensor"]
    made = blind_page.unforeseen(blind_page.kept_campaigns(own.unforeseen_results))
    there = shown(own.page.read_text(encoding="utf-8"), "unforeseen")
    assert _without_numbers(made) == _without_numbers(there)
    assert_close(_numbers(made), _numbers(there), atol=0.11)


@pytest.mark.parametrize("instrument", [name for name, own in INSTRUMENTS.items() if own.added])
def test_causes_that_joined_since_are_reported_as_counted(instrument: str) -> None:
    own = INSTRUMENTS[instrument]
    campaigns = blind_page.kept_campaigns(own.added_results)
    made, there = blind_page.causes(campaigns, own), shown(own.page.read_text(encoding="utf-8"), "added")
    assert _without_numbers(made) == _without_numbers(there)
    assert_close(_numbers(made), _numbers(there), atol=0.11)
    assert {effect.cause for campaign in campaigns for effect in campaign.hidden} == set(own.added)


def _without_numbers(text: str) -> str:
    return re.sub(r"-?\d+(\.\d+)?", "number", text)


def _numbers(text: str) -> list[float]:
    return [float(found) for found in re.findall(r"-?\d+(?:\.\d+)?", text)]


@pytest.mark.parametrize("instrument", INSTRUMENTS)
def test_every_kept_campaign_is_there_once_and_drawn_as_reported(instrument: str) -> None:
    campaigns = CAMPAIGNS[instrument]
    numbers = [campaign.record["number"] for campaign in campaigns]
    assert sorted(numbers) == sorted(set(numbers))
    for one in campaigns[:: max(len(campaigns) // 20, 1)]:
        reported = drawn(one.record["number"], INSTRUMENTS[instrument].seed, instrument)
        assert one.name == f"{reported.group}-{reported.number}"
        assert one.record["truth"]["layout"] == reported.layout
        if reported.group in ("one", "two"):
            assert {effect.cause for effect in one.hidden} == set(reported.names)


@pytest.mark.parametrize("instrument", INSTRUMENTS)
def test_groups_take_turns_and_clear_effects_are_clear(instrument: str) -> None:
    cases = [drawn(number, 3, instrument) for number in range(200)]
    assert sorted(case.group for case in cases) == sorted(CYCLE * 10)
    own = INSTRUMENTS[instrument]
    assert {name for case in cases for name in case.names} <= {*own.catalogue, *own.uncatalogued}
    two = [case.strength for case in cases if case.group == "two"]
    assert_between(min(two), 8.0, 12.0, what="weakest of two")


def test_bounds_are_clopper_and_pearson_s() -> None:
    """None of 96: 1 - 0.025^(1/96)."""
    assert_close(rates.interval(0, 96), [0.0, 1 - 0.025 ** (1 / 96)], atol=1e-12)
    assert_close(rates.interval(5, 5), [0.025 ** (1 / 5), 1.0], atol=1e-12)


def test_theory_is_that_of_the_design() -> None:
    """Near 95 % against 2000 candidates: at 6 for one parameter, near 8.7 for 36."""
    assert_between(float(theory(np.array(6.0), 1, 2000)), 0.94, 0.97, what="power of one parameter")
    assert_between(float(theory(np.array(8.7), 36, 2000)), 0.93, 0.98, what="power of 36")


def judged_campaign(
    hidden: list[dict[str, Any]], findings: list[tuple[str, str, str, str]], strength: float = 7.0
) -> Assessed:
    """A campaign with effects (as the truth has them) and rows (cause, verdict, subject, follows)."""
    figures = dict.fromkeys(
        ("rms_before", "rms_after", "heldout_rms_before", "heldout_rms_after", "noise_floor", "log_evidence")
    )
    rows = [
        {"cause": cause, "verdict": verdict, "subject": subject, "follows": follows, "parameters": "{}", **figures}
        for cause, verdict, subject, follows in findings
    ]
    truth = {"effects": hidden, "strengths": [strength] * len(hidden), "legs": 6, "layout": "few"}
    return Assessed({"name": "made", "truth": truth, "findings": rows, "pull_sums": [], "seconds": 1.0})


GAIN = {"cause": "actuator-gain", "subject": "leg2", "parameters": {"gain_2": {"value": 0.01, "unit": "1"}}}
HUMID = {"cause": "unexplained", "subject": "", "parameters": {}, "kind": "Humid", "follows": "humidity_pct"}


def test_a_cause_named_as_indistinguishable_counts_as_named_and_not_as_wrong() -> None:
    rows = [("leg-thermal", "found", "", ""), ("actuator-gain", "indistinguishable", "leg2", "")]
    alike = judged_campaign([GAIN], rows)
    assert not alike.missed
    assert not alike.invented
    assert not alike.misplaced(alike.hidden[0])
    assert judged_campaign([GAIN], rows[:1]).missed == {"actuator-gain"}
    assert judged_campaign([GAIN], [("actuator-gain", "found", "leg2", ""), rows[0]]).invented == ["leg-thermal"]


def test_legs_are_compared_as_sets_and_all_of_them_are_the_whole() -> None:
    assert judged_campaign([GAIN], [("actuator-gain", "found", "leg3", "")]).misplaced(
        judged_campaign([GAIN], []).hidden[0]
    )
    whole = GAIN | {"subject": ""}
    every = judged_campaign([whole], [("actuator-gain", "found", " ".join(f"leg{leg}" for leg in range(1, 7)), "")])
    assert not every.misplaced(every.hidden[0])


def test_an_effect_outside_the_catalogue_must_be_reported_with_all_inputs() -> None:
    right = judged_campaign([HUMID], [("unexplained", "found", "", "humidity_pct time_s")])
    other = judged_campaign([HUMID], [("unexplained", "found", "", "time_s"), ("leg-drift", "found", "", "")])
    assert right.follows_right(right.hidden[0])
    assert not right.misnamed
    assert not other.follows_right(other.hidden[0])
    assert other.misnamed == ["leg-drift"]


def test_an_input_may_be_missed_whose_own_part_is_below_what_is_asked() -> None:
    one = judged_campaign([HUMID | {"follows": "humidity_pct time_s"}], [("unexplained", "found", "", "time_s")], 20.0)
    (effect,) = one.hidden
    parts = replace(effect, of_drivers={"humidity_pct": 9.0, "time_s": 18.0})
    assert parts.clear_drivers(10.0) == {"time_s"}
    assert effect.clear_drivers(10.0) == {"humidity_pct", "time_s"}, "unmeasured parts count as the whole"
    assert one.follows_right(parts, 10.0)
    assert not one.follows_right(parts)


def test_an_effect_is_clear_from_a_signal_strength_of_six_on() -> None:
    assert rates.is_clear(judged_campaign([GAIN], [], 6.0))
    assert not rates.is_clear(judged_campaign([GAIN], [], 5.0))
    assert not rates.is_clear(judged_campaign([GAIN, GAIN], [], 7.0))
    assert not rates.is_clear(judged_campaign([GAIN | {"cause": "platform-deformation-matrix"}], [], 8.0))
