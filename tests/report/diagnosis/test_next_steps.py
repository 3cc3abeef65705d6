"""Next measurements on the page: most urgent first, with totals, and only from tables."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from tests.report.diagnosis.test_suspected import adequacy
from tests.report.diagnosis_parts import part_of, text_of
from tests.report.diagnosis_tables import NOISE, diagnosis_tables, rejected, row, rows
from tests.sentences import assert_says, says
from truing.report.diagnosis.adequacy import adequacy as adequacy_section
from truing.report.diagnosis.assessed_causes import assessed_causes
from truing.report.diagnosis.next_steps import NextStep, next_measurements_frame, next_steps
from truing.report.page_head import build_head
from truing.report.stopping_section import stop
from truing.schemas.needs import Need

Frames = dict[str, pd.DataFrame]
PLAN = "platform-deformation-matrix: K22"
SHARPEN = {
    "next_measurement": "To know K22 better, do this (rho 1 mm).",
    "next_in_short": "To know K22 better, do this.",
}
SHARPEN |= {"advice_kind": "sharpen", "next_purpose": PLAN}
HOLDS = adequacy(("observation-noise", "", 1.01, 0.6, "ok"))


def _tables(*found: dict, tests: pd.DataFrame = HOLDS) -> Frames:
    """A run without failed checks whose requirement z is undecided."""
    tables = diagnosis_tables(rows(*found, *rejected())) | {"adequacy": tests}
    own = tables["requirements"]
    open_ = own["verdict"] == "undecided"
    facts = {"measurements": 14.0, "poses_judged": 6.0, "lower_expected": 0.09, "upper_expected": 0.0999}
    return tables | {"requirements": own.assign(**{name: np.where(open_, v, np.nan) for name, v in facts.items()})}


def _steps(tables: Frames) -> list[NextStep]:
    return next_steps(assessed_causes(tables), tables)


def _planned(tables: Frames) -> Frames:
    own = tables["next_poses"].assign(purpose=PLAN, need="precision", measurements=91, duration_s=3600.0, times=13)
    falls = np.linspace(0.45, 0.25, len(own))
    return tables | {"next_poses": own.assign(sigma_now=0.5, sigma_expected=falls, unit="mm")}


def test_needs_are_in_their_order_whatever_the_order_of_findings() -> None:
    sharp = row("platform-deformation-linear", **SHARPEN)
    rival = row("leg-drift", next_measurement="To tell it from leg-thermal, wait.", advice_kind="separate")
    idle = row("body-drift", "not testable", next_measurement="Measure at two temperatures.")
    steps = _steps(_planned(_tables(sharp, rival, idle)))
    needs = [step.need for step in steps]
    assert needs == sorted(needs, key=lambda need: need.rank)
    assert list(dict.fromkeys(needs)) == list(Need)
    assert [step.purpose for step in steps if step.need == Need.RIVAL] == ["leg drift"]
    frame = next_measurements_frame(steps)
    assert frame["rank"].tolist() == [*range(1, len(steps) + 1)]
    own = frame[frame["need"] == "precision"].iloc[0]
    figures = own[["measurements", "duration_s", "sigma_now", "sigma_expected"]].tolist()
    assert figures == [91.0, 3600.0, 0.5, 0.25]
    assert own["unit"] == "mm"


def test_an_undecided_requirement_leads_with_the_poses_that_decide_it() -> None:
    tables = _tables(row("platform-deformation-linear", **SHARPEN))
    first = _steps(tables)[0]
    assert first.need == Need.REQUIREMENT
    assert first.figures["measurements"] == 14.0
    assert_says(first.words, "14 further poses", "workspace", "role verification")
    assert_says(first.words, "as large", "6 poses")
    text = next(words for mark, words in build_head("c", tables).verdicts if mark == "next")
    assert_says(text, "14 further measurements", "about 47 min", first.purpose)


def test_the_words_of_a_planned_measurement_appear_once_on_the_page() -> None:
    tables = _planned(_tables(row("platform-deformation-linear", **SHARPEN)))
    steps = [step for step in _steps(tables) if step.figures]
    assert {step.need for step in steps} == {Need.REQUIREMENT, Need.PRECISION}
    stopping = stop(tables)
    assert stopping is not None
    sentences = [*build_head("c", tables).verdicts, *stopping.statements, *part_of("next", tables).statements]
    text = " ".join([stopping.lead, *(words.lower() for _, words in sentences)])
    assert [text.count(step.short_text.lower()) for step in steps] == [1] * len(steps)
    assert says([words for _, words in stopping.statements], steps[0].purpose)


def test_a_requirement_at_its_limit_asks_for_no_poses() -> None:
    tables = _tables(row("platform-deformation-linear"))
    tables["requirements"] = tables["requirements"].assign(measurements=np.nan)
    first = _steps(tables)[0]
    assert first.need == Need.REQUIREMENT
    assert not first.figures
    assert_says(first.words, "too close", "limit")


@pytest.mark.parametrize("verdict", ["meets", "fails", "not evaluated"])
def test_a_requirement_that_is_decided_asks_for_nothing(verdict: str) -> None:
    tables = _tables(row("platform-deformation-linear"))
    tables["requirements"] = tables["requirements"].assign(verdict=verdict)
    assert all(step.need != Need.REQUIREMENT for step in _steps(tables))


def test_without_requirements_and_findings_nothing_is_invented() -> None:
    tables = _tables()
    del tables["requirements"]
    assert not _steps(tables)
    assert not part_of("next", tables | {"next_poses": tables["next_poses"].iloc[:0]}).statements
    assert len(next_measurements_frame([])) == 0


def test_a_suspected_finding_comes_after_what_shows_whether_the_model_holds() -> None:
    doubted = row("leg-drift", "suspected", reason_code="inadequate", next_measurement="Return to one pose.")
    steps = _steps(_tables(doubted, tests=adequacy(("observation-noise", "", 3.0, 1e-9, "fails"))))
    rivals = [step for step in steps if step.need == Need.RIVAL]
    assert [says(step.words, "one pose", "ten times") for step in rivals] == [True, False]
    assert rivals[1].words == "Return to one pose."


STATED = {
    ("observation-noise", ""): "Measure one pose ten times without moving anything.",
    ("input-noise", ""): "Move ten times to one pose, each time from the same side.",
    ("like-neighbours", "time_s"): "Repeat five of the first poses at the end",
    ("like-neighbours", "order"): "Repeat five of the first poses at the end",
    ("like-neighbours", "temperature_c"): "Repeat five poses at two stable temperatures",
    ("like-neighbours", "direction of approach"): "twice from each side",
    ("like-neighbours", "rho3_mm"): "Measure at five values of actuator 3",
    ("like-neighbours", "rho1_mm rho2_mm"): "Repeat the five poses with the largest errors on another day.",
    ("by-region", "rho1_mm rho2_mm"): "Repeat the five poses with the largest errors on another day.",
    ("pure-error", ""): "Measure more poses near those that were repeated",
}


@pytest.mark.parametrize("test", STATED, ids="-".join)
def test_each_failed_test_asks_for_the_measurement_that_shows_why(test: tuple[str, str]) -> None:
    (reported,) = [
        step for step in _steps(_tables(tests=adequacy((*test, 2.0, 1e-9, "fails")))) if step.need == Need.RIVAL
    ]
    assert STATED[test] in reported.words


def test_questions_of_init_use_the_terms_of_the_instrument() -> None:
    fails = adequacy(("observation-noise", "", 3.0, 1e-9, "fails"))
    for relation, words in (("loads-readings", "Hold one load"), ("commands-encoders", "Read every encoder ten times")):
        steps = _steps(_tables(row("creep", relation=relation), tests=fails))
        assert any(step.words.startswith(words) for step in steps)


def test_a_search_that_was_ended_asks_for_what_shows_the_cause_that_was_next() -> None:
    ended = adequacy(("causes-left", "", 3.0, 1e-9, "fails"))
    ended = ended.assign(search_end="most-causes", left_cause="actuator-backlash", left_subject="leg2")
    (reported,) = [step for step in _steps(_tables(tests=ended)) if step.need == Need.RIVAL]
    assert_says(reported.words, "same poses", "from below", "from above")


@pytest.mark.parametrize("cause", ["target-moved", "unexplained", "of-a-lab"])
def test_for_causes_with_inputs_the_next_step_changes_one_input_at_a_time(cause: str) -> None:
    ended = adequacy(("causes-left", "", 3.0, 1e-9, "fails"))
    ended = ended.assign(search_end="most-causes", left_cause=cause, left_subject="target B1")
    (reported,) = [step for step in _steps(_tables(tests=ended)) if step.need == Need.RIVAL]
    assert_says(reported.words, "one input", "at a time")
    assert "None" not in reported.words


def test_errors_beyond_noise_that_no_test_explains_ask_for_repeats() -> None:
    tables = _tables(row("platform-deformation-linear", rms_after=30.0, heldout_rms_after=30.0))
    reported = [step for step in _steps(tables) if step.purpose.startswith("the errors of predictions exceed")]
    assert [says(step.words, "one pose", "ten times") for step in reported] == [True]


def test_errors_beyond_noise_are_next_to_tests_that_all_passed() -> None:
    passed = adequacy(("observation-noise", "", 1.0, 0.5, "ok"))
    far = _tables(row("platform-deformation-linear", rms_after=30.0, heldout_rms_after=30.0), tests=passed)
    near = _tables(row("platform-deformation-linear"), tests=passed)
    text, unsaid = adequacy_section(far), adequacy_section(near)
    assert text is not None
    assert unsaid is not None
    assert_says(text.lead, "none finds more than noise", "rms error", "held-out poses", "times")
    assert "rms error" not in unsaid.lead


def test_noise_that_was_found_asks_for_repeats_once() -> None:
    noise = row("unexplained", reason_code="noise", next_measurement="Measure one pose ten times.", **NOISE)
    steps = _steps(_tables(noise, tests=adequacy(("observation-noise", "", 3.0, 1e-9, "fails"))))
    (rival,) = [step for step in steps if step.need == Need.RIVAL]
    assert_says(rival.words, "one pose", "ten times")


def test_one_measurement_for_several_findings_is_listed_once() -> None:
    same = [row("body-deformation", subject=f"body{k}", next_measurement="Move a drive.") for k in range(2)]
    assert [step.words for step in _steps(_tables(*same)) if step.need == Need.PRECISION] == ["Move a drive."]


def test_a_nonparametric_effect_needs_a_decision_between_explanations() -> None:
    unnamed = row("unexplained", follows="time_s", next_measurement="Repeat some poses in another order.")
    (reported,) = [step for step in _steps(_tables(unnamed)) if step.need == Need.RIVAL]
    assert_says(reported.words, "Repeat", "poses", "another order")


@pytest.mark.parametrize("asks", [True, False])
def test_of_an_arm_that_needs_no_computed_poses_an_open_question_is_evaluated(asks: bool) -> None:
    words = {"next_measurement": "Repeat some poses in another order."} if asks else {}
    tables = diagnosis_tables(rows(row("unexplained", follows="time_s", **words)) if asks else rows(*rejected()))
    tables |= {"joints": pd.DataFrame(), "next_poses": tables["next_poses"].iloc[:0]}
    without = {name: own for name, own in tables.items() if name not in ("pulls", "requirements", "detectable")}
    part = part_of("next", without)
    assert bool(part.statements) == asks
    assert part.state == ("" if asks else "not evaluated")
    assert says(part.lead, "no finding") == (not asks)


def test_a_kind_of_cause_is_untested_only_where_no_subject_of_it_was_tested() -> None:
    idle = {"next_measurement": "Approach from both sides."}
    both = [row("actuator-backlash", "not testable", subject="leg1", **idle), row("actuator-backlash", "rejected")]
    alone = [row("base-deformation", "not testable", subject=f"{k}", **idle) for k in range(3)]
    tables = diagnosis_tables(rows(*both, *alone))
    untested = [step for step in _steps(tables) if step.need == Need.TESTABLE]
    assert [step.purpose for step in untested] == ["base deformation"]
    assert_says(text_of(part_of("next", tables)), "Approach", "both sides")
    assert all(mark != "next" for mark, _ in build_head("c", tables).verdicts if len(_steps(tables)) == len(untested))


def test_totals_are_above_each_table() -> None:
    (listing,) = part_of("next", _planned(_tables(row("platform-deformation-linear", **SHARPEN)))).listings
    assert_says(listing.caption, PLAN, "5 configurations", "91 measurements in all")
    assert listing.heads[:2] == ("pose", "times")
    assert listing.rows[0][1] == "13"
