"""The verdict on a campaign: the leading section, allowed statements, and agreement with page and figures."""

from __future__ import annotations

import json

import numpy as np
import pandas as pd
import pytest
from scipy.special import fdtrc

from tests.report import diagnosis_tables as made
from tests.report.calibration_tables import calibration_tables
from tests.report.campaign_tables import campaign_tables
from tests.report.diagnosis_tables import GAIN_3, diagnosis_tables, rejected, row, rows
from tests.sentences import assert_says
from truing.belonging.relation import RelationState
from truing.inference.noise import NOISE_PRIOR_FREEDOM
from truing.pipeline.campaign_run import verdict_line
from truing.report.page_head import build_head
from truing.report.quality_section import quality_verdict
from truing.report.rendering.render import render_page
from truing.report.section_verdict import SectionVerdict, verdict_rows
from truing.report.sections import build_sections
from truing.report.verdict import gates, leading, section_verdicts, verdict_frame, with_verdict
from truing.report.wordings.catalogue import cause_words
from truing.schemas.verdict import DECLARED_FREEDOM, SECTIONS, ReasonCode, Relation, does_not_fit

FOUND = row("actuator-gain", parameters=GAIN_3, subject="leg3")
GREEN = "pass"


def of(*diagnosis_rows, **more) -> dict[str, pd.DataFrame]:
    """A run in which no check and no requirement fails, with a diagnosis of these rows."""
    tables = diagnosis_tables(rows(*diagnosis_rows)) | more
    return {name: table for name, table in tables.items() if name not in ("qa", "requirements")}


def campaign(tables) -> SectionVerdict:
    return verdict_rows(with_verdict(tables))["campaign"]


def checks(*stated: tuple[str, str]) -> pd.DataFrame:
    made_of = [(name, "base", 0.4, 0.3, "mm", verdict, f"{name} says so.", None) for name, verdict in stated]
    columns = ["check", "subject", "value", "limit", "unit", "verdict", "message", "accepted"]
    return pd.DataFrame(made_of, columns=columns)


def misfit(times: float, freedom: float = 300.0, p: float | None = None) -> dict[str, pd.DataFrame]:
    """Tables of a calibration that misses what it was fitted to by this many times the noise, its requirements met."""
    tables = calibration_tables(models=("6-pus", "beam"))
    choice = tables["model_choice"]
    own = choice["estimator"].eq("errors-in-variables")
    choice = choice[~(own & choice["figure"].isin(["chi_square", "freedom", "misfit_p_value"]))]
    keys = choice.loc[choice["estimator"].eq("errors-in-variables"), ["model", "deformation", "estimator"]]
    figures = {"chi_square": times**2 * freedom, "freedom": freedom}
    figures["misfit_p_value"] = (0.0 if times > 1.2 else 0.4) if p is None else p
    more = [keys.drop_duplicates().assign(figure=name, value=value, unit="1") for name, value in figures.items()]
    required = tables["requirements"]
    met = required.assign(verdict="meets", error=0.1 * required["requirement"])
    return tables | {"model_choice": pd.concat([choice, *more], ignore_index=True), "requirements": met}


def test_pulls_that_fail_are_never_below_a_green_line():
    tables = of(*rejected(), pull_sums=made.pull_sums(900.0).assign(p_value=1e-54))
    assert section_verdicts(tables)["diagnosis"].state == RelationState.OK
    whole = campaign(tables)
    assert (whole.state, whole.reason_code) == (RelationState.FAILS, ReasonCode.BEYOND_TOLERANCE)
    assert build_head("c", tables).verdicts[0] == ("fail", whole.explanation)
    assert "p < 1e-6" in whole.explanation.replace("p = <", "p <")


def test_a_calibration_that_misfits_by_a_factor_is_never_below_a_green_line():
    tables = of(*rejected()) | misfit(5.15)
    verdicts = section_verdicts(tables)
    assert verdicts["diagnosis"].mark == GREEN
    assert verdicts["calibration"].state == RelationState.FAILS
    assert verdicts["calibration"].value == pytest.approx(5.15)
    mark, text = build_head("c", tables).verdicts[0]
    assert mark == "fail"
    assert "5.2 times the noise" in text or "5.15 times the noise" in text


@pytest.mark.parametrize(
    ("times", "p", "state"),
    [
        (1.0, 0.4, RelationState.OK),
        (1.13, 1e-9, RelationState.ATTENTION),
        (1.3, 1e-9, RelationState.ATTENTION),
        (1.5, 1e-9, RelationState.FAILS),
    ],
)
def test_noise_that_declared_noise_may_well_be_wrong_by_needs_attention_and_does_not_fail(times, p, state):
    verdict = section_verdicts(misfit(times, p=p))["calibration"]
    assert (verdict.reason_code == ReasonCode.MISFIT) == (state != RelationState.OK)
    if state != RelationState.OK:
        assert verdict.state == state
        assert_says(verdict.explanation, f"{times:.2f} times")
        assert "[noise]" in verdict.explanation


def test_a_small_misfit_names_the_found_cause_that_the_calibration_leaves_out():
    verdict = section_verdicts(of(FOUND, *rejected()) | misfit(1.2, p=1e-9))["calibration"]
    assert (verdict.state, verdict.reason_code) == (RelationState.ATTENTION, ReasonCode.CAUSE_LEFT_OUT)
    assert_says(verdict.explanation, "1.20 times", "leaves out what the diagnosis found", "larger than declared")


@pytest.mark.parametrize(("times", "state"), [(1.2, RelationState.ATTENTION), (3.0, RelationState.FAILS)])
def test_a_misfit_next_to_suspected_causes_asks_for_no_further_one(times: float, state: RelationState) -> None:
    suspected = row("leg-drift", subject="leg4", verdict="suspected", reason_code="alternative")
    verdicts = section_verdicts(of(FOUND, suspected, *rejected()) | misfit(times, p=1e-9))
    assert verdicts["diagnosis"].reason_code == ReasonCode.SUSPECTED
    assert (verdicts["calibration"].state, verdicts["calibration"].reason_code) == (state, ReasonCode.MISFIT)
    assert_says(verdicts["calibration"].explanation, "leaves out what the diagnosis found or suspects")
    assert "missing" not in verdicts["calibration"].explanation


def test_the_page_and_the_search_know_declared_noise_equally_well():
    assert DECLARED_FREEDOM == NOISE_PRIOR_FREEDOM
    assert does_not_fit(1e-9, 1.43)
    assert not does_not_fit(1e-9, 1.41)
    assert fdtrc(1e9, DECLARED_FREEDOM, 1.42**2) == pytest.approx(1e-3, rel=0.1)


def test_requirements_are_not_met_by_a_model_that_does_not_fit():
    assert section_verdicts(misfit(1.0))["requirements"].reason_code == ReasonCode.MET
    tables = misfit(5.15)
    verdict = section_verdicts(tables)["requirements"]
    assert (verdict.state, verdict.reason_code) == (RelationState.NOT_TESTED, ReasonCode.MODEL_DOES_NOT_FIT)
    assert_says(verdict.explanation, "find", "missing cause")
    assert not [text for mark, text in build_head("c", tables).verdicts if " met" in text]


def test_requirements_are_not_met_where_the_picture_fails_whatever_the_calibration_says():
    tables = misfit(1.0) | of({**FOUND, "rms_after": 60.0}, *rejected())
    verdicts = section_verdicts(tables)
    assert verdicts["adequacy"].state == RelationState.FAILS
    assert verdicts["requirements"].reason_code == ReasonCode.MODEL_DOES_NOT_FIT
    assert verdicts["adequacy"].explanation in verdicts["requirements"].explanation


def test_a_failure_on_held_out_data_precedes_every_other_warning():
    tables = misfit(1.0)
    choice = tables["model_choice"]
    choice = choice[~choice["figure"].isin(["pull_p_value", "p_value", "heldout_ratio"])]
    keys = choice.loc[choice["estimator"].eq("errors-in-variables"), ["model", "deformation", "estimator"]]
    figures = {"pull_p_value": 1e-9, "p_value": 1e-9, "heldout_ratio": 3.0}
    more = [keys.drop_duplicates().assign(figure=name, value=value, unit="1") for name, value in figures.items()]
    tables["model_choice"] = pd.concat([choice, *more], ignore_index=True)
    verdict = section_verdicts(tables)["calibration"]
    assert (verdict.state, verdict.reason_code, verdict.value) == (RelationState.FAILS, ReasonCode.HELD_OUT_MISSED, 3.0)
    assert section_verdicts(tables)["requirements"].reason_code == ReasonCode.MODEL_DOES_NOT_FIT


def test_a_misfit_that_a_found_cause_explains_is_not_a_failure_of_the_campaign():
    tables = of(FOUND, *rejected()) | misfit(3.0)
    verdicts = section_verdicts(tables)
    assert verdicts["calibration"].reason_code == ReasonCode.CAUSE_LEFT_OUT
    assert verdicts["requirements"].reason_code == ReasonCode.MODEL_DOES_NOT_FIT
    assert campaign(tables).reason_code == ReasonCode.FOUND
    beyond = of({**FOUND, "rms_after": 13.0}, *rejected()) | misfit(3.0)
    assert section_verdicts(beyond)["calibration"].reason_code == ReasonCode.MISFIT
    assert campaign(beyond).state == RelationState.FAILS


@pytest.mark.parametrize(
    ("cause", "step", "hidden"), [("measurement-scale", "instrument", True), ("actuator-gain", "drive", False)]
)
def test_held_out_poses_that_share_the_error_of_the_fitted_ones_test_no_requirement(
    cause: str, step: str, hidden: bool
) -> None:
    settings = json.dumps({"step": step})
    tables = of({**FOUND, "cause": cause, "subject": "", "settings": settings}, *rejected()) | misfit(1.0)
    verdicts = section_verdicts(tables)
    assert (verdicts["calibration"].reason_code == ReasonCode.CAUSE_LEFT_OUT) is hidden
    assert (verdicts["requirements"].state == RelationState.NOT_TESTED) is hidden


@pytest.mark.parametrize(("applied", "fits"), [(["actuator-gain"], True), (["measurement-scale"], False)])
def test_a_calibration_with_some_findings_applied_leaves_out_the_others(applied: list[str], fits: bool) -> None:
    choices = pd.DataFrame({"cause": applied, "asked": "apply", "outcome": "applied"})
    tables = of({**FOUND, "cause": "actuator-gain"}, *rejected()) | misfit(1.0) | {"diagnosis_choices": choices}
    main = {"model": "extended", "deformation": "none", "estimator": "points", "figure": "main", "value": 1.0}
    tables["model_choice"] = pd.concat([tables["model_choice"], pd.DataFrame([main])], ignore_index=True)
    verdict = section_verdicts(tables)["calibration"]
    assert verdict.reason_code == (ReasonCode.FITS if fits else ReasonCode.CAUSE_LEFT_OUT)
    assert ("actuator gain" in verdict.explanation) is not fits


def test_a_cause_found_is_a_result_with_a_mark_of_its_own():
    tables = of(FOUND, *rejected())
    whole = campaign(tables)
    assert (whole.state, whole.reason_code, whole.mark) == (RelationState.ATTENTION, ReasonCode.FOUND, "found")
    assert section_verdicts(tables)["diagnosis"].value == 1.0
    sections = build_sections(tables, {})
    assert next(section for section in sections if section.id == "diagnosis").state == "found"
    page = render_page(build_head("c", tables), sections)
    assert '<span class="state found"><span aria-hidden="true">◆</span> found</span>' in page


def test_an_incomplete_picture_leads_before_its_findings():
    tables = of({**FOUND, "rms_after": 13.0}, *rejected())
    whole = campaign(tables)
    assert (whole.state, whole.reason_code) == (RelationState.ATTENTION, ReasonCode.BEYOND_NOISE)
    assert "incomplete" in whole.explanation
    assert [mark for mark, _ in build_head("c", tables).verdicts[:2]] == ["warn", "found"]


def test_suspected_causes_are_reported_as_suspected():
    one = row(
        "leg-drift",
        "suspected",
        reason_code="unnamed",
        subject="leg4",
        parameters={"drift_4": made.size(0.012, 0.001, "mm")},
    )
    verdict = section_verdicts(of(one, *rejected()))["diagnosis"]
    assert (verdict.state, verdict.reason_code, verdict.mark) == (RelationState.ATTENTION, ReasonCode.SUSPECTED, "warn")
    assert verdict.explanation.startswith("Suspected, not confirmed")
    assert "leg 4 grows" in verdict.explanation.lower()


@pytest.mark.parametrize(
    ("relation", "words"),
    [
        (Relation.READINGS_POSES, "Actuator readings and measured poses (through the mechanism) agree"),
        (Relation.BODIES_SURVEY, "The shapes of bodies as measured in all poses agree"),
        (Relation.COMMANDS_ENCODERS, "Commands and encoders of the axis agree"),
        (Relation.LOADS_READINGS, "Loads and readings (through the simulated compliance) agree"),
        (Relation.LOADS_SIGNALS, "Loads and signals (through the equations of the sensor) agree"),
    ],
)
def test_agreement_names_the_relation_that_was_tested(relation, words):
    tables = of(*({**one, "relation": relation.value} for one in rejected()))
    verdict = section_verdicts(tables)["diagnosis"]
    assert verdict.state == RelationState.OK
    assert verdict.explanation.startswith(words)
    assert_says(verdict.explanation, "Smallest sizes", "probability 80 %")


def test_readings_that_no_simulation_relates_to_poses_are_not_tested():
    tables = of(*({**one, "relation": Relation.BODIES_SURVEY.value} for one in rejected()))
    for name in ("pulls", "pull_sums", "calibration", "model_choice"):
        del tables[name]
    whole = campaign(tables)
    assert (whole.state, whole.reason_code) == (RelationState.NOT_TESTED, ReasonCode.NO_MECHANISM)
    assert "rho1_mm" in whole.explanation
    mark, text = build_head("c", tables).verdicts[0]
    assert mark == "none"
    assert "No [mechanism] relates" in text
    assert "simulation" not in text
    tables["configurations"] = tables["configurations"][["pose", "role", "time_s"]]
    assert section_verdicts(tables)["simulation"].reason_code == ReasonCode.NO_READINGS
    assert campaign(tables).mark == GREEN


def test_a_relation_is_tested_of_the_bodies_that_it_was_tested_of():
    named = {"relation": ["points-against-survey"] * 2, "subject": ["tool0", "base"], "accepted": [None] * 2}
    relations = pd.DataFrame(named | {"state": ["not tested", "ok"], "misfit": [np.nan, 0.1]})
    text = section_verdicts(of(FOUND, belonging=relations))["belonging"].explanation
    assert_says(text, "as far as tested", "(base)")
    assert_says(text, "Not tested", "(tool0)")


@pytest.mark.parametrize(("state", "is_partial"), [("not tested", True), ("ok", False)])
def test_the_head_says_which_relation_was_not_tested(state: str, is_partial: bool) -> None:
    named = {"relation": ["copied-poses", "readings-against-poses"], "subject": ["", ""], "accepted": [None] * 2}
    relations = pd.DataFrame(named | {"state": ["ok", state], "misfit": [0.0, np.nan]})
    texts = [text for _, text in build_head("c", of(FOUND, belonging=relations)).verdicts]
    assert any("Not tested: actuator readings" in text for text in texts) is is_partial
    assert any(text.startswith("Other tests") and "belong together" in text for text in texts) is not is_partial


def test_an_arm_whose_tool_has_one_target_loses_no_pose():
    fits = {"pose": [1, 1], "body": ["tool0", "base"], "method": "maximum_likelihood", "default": True}
    fits |= {"n_used": [1, 4], "status": ["too-few-points", "ok"]}
    tables = of(FOUND, poses=pd.DataFrame(fits), joints=pd.DataFrame({"pose": [1]}))
    whole, alone = section_verdicts(tables)["poses"], tables | {"poses": tables["poses"][:1]}
    assert (whole.state, whole.value) == (RelationState.OK, 0.0)
    assert_says(whole.explanation, "tool0 has fewer than three targets", "points are used")
    assert section_verdicts(alone)["poses"].state == RelationState.NOT_TESTED
    assert section_verdicts({name: t for name, t in tables.items() if name != "joints"})["poses"].value == 1.0


def test_an_arm_with_measured_poses_has_poses_and_no_points():
    fits = {"pose": [1, 2], "body": "tool0", "method": "measured", "default": True, "n_used": 0, "status": "ok"}
    tables = of(FOUND, poses=pd.DataFrame(fits), joints=pd.DataFrame({"pose": [1, 2]}))
    verdict = section_verdicts(tables)["poses"]
    assert (verdict.state, verdict.reason_code) == (RelationState.OK, ReasonCode.COMPLETE)
    assert_says(verdict.explanation, "2 poses of 1 body", "taken as given")


def test_effects_that_no_campaign_of_the_kind_can_show_are_no_agreement():
    hidden = [{**one, "verdict": "not testable"} for one in rejected()]
    verdict = section_verdicts(of(*hidden))["diagnosis"]
    assert (verdict.state, verdict.reason_code) == (RelationState.NOT_TESTED, ReasonCode.NOT_TESTABLE)
    assert "agree" not in verdict.explanation
    some = section_verdicts(of(*hidden[:3], *rejected()[3:]))["diagnosis"]
    assert some.state == RelationState.OK
    names = ", ".join(cause_words(one["cause"]) for one in hidden[:3])
    assert_says(some.explanation, "none of 8", "not testable", names)


def test_data_that_do_not_belong_together_lead_everything_and_gate():
    apart = checks(("attachment-labels", "fail"), ("noise", "warn"))
    tables = of(FOUND, pull_sums=made.pull_sums(900.0).assign(p_value=1e-54)) | {"qa": apart}
    assert campaign(tables).reason_code == ReasonCode.DO_NOT_BELONG
    assert gates(verdict_frame(tables).to_dict("records")) == ["belonging", "quality"]
    accepted = apart.assign(accepted=["M. Keller: known", None])
    assert gates(verdict_frame(tables | {"qa": accepted}).to_dict("records")) == []


def test_a_warning_on_consistency_is_reported_once():
    """It belongs to the verdict on consistency; the verdict on quality reports its own warnings."""
    apart, noisy = ("points-against-survey", "warn"), ("noise", "warn")
    for reported, tells in (((apart,), False), ((apart, noisy), True)):
        verdict = quality_verdict({"qa": checks(*reported)}, {})
        assert verdict is not None
        assert verdict.state is RelationState.ATTENTION
        assert ("First: " in verdict.explanation) is tells


@pytest.mark.parametrize(
    ("adequacy", "first"), [(RelationState.ATTENTION, "belonging"), (RelationState.OK, "diagnosis")]
)
def test_tables_that_hardly_match_lead_a_model_that_is_incomplete(adequacy, first):
    codes = {"belonging": ReasonCode.DEPARTS, "adequacy": ReasonCode.LACK_OF_FIT, "diagnosis": ReasonCode.FOUND}
    states = {"adequacy": adequacy}
    reported = {
        name: SectionVerdict(name, states.get(name, RelationState.ATTENTION), code, "") for name, code in codes.items()
    }
    assert leading(reported).section == first


def test_only_a_failure_of_the_data_gates():
    tables = of(*rejected(), pull_sums=made.pull_sums(900.0).assign(p_value=1e-54)) | misfit(5.15)
    assert campaign(tables).state == RelationState.FAILS
    assert gates(verdict_frame(tables).to_dict("records")) == []


def test_page_and_marks_follow_the_table_of_the_verdict_alone():
    tables = with_verdict(of(FOUND, *rejected()))
    table = tables["verdict"]
    text = table.assign(explanation=[f"Row {k}." for k in range(len(table))], state="fails", reason_code="misfit")
    changed = {**tables, "verdict": text}
    assert build_head("c", changed).verdicts[0] == ("fail", "Row 0.")
    marks = {one.id: one.state for one in build_sections(changed, {})}
    assert marks["diagnosis"] == marks["calibration"] == marks["poses"] == "fail"


def test_the_first_row_is_that_of_the_campaign_and_says_who_leads_it():
    frame = verdict_frame(diagnosis_tables())
    assert frame["section"].iloc[0] == "campaign"
    lead = frame["decided_by"].iloc[0]
    own = frame[frame["section"].eq(lead)].iloc[0]
    same = ["state", "reason_code", "explanation"]
    assert own[same].to_list() == frame.iloc[0][same].to_list()
    assert frame["decided_by"].iloc[1:].isna().all()
    assert [name for name in SECTIONS if name in set(frame["section"])] == frame["section"].iloc[1:].to_list()
    assert frame["reason_code"].isin([code.value for code in ReasonCode]).all()


def _green(section: str) -> SectionVerdict:
    return SectionVerdict(section, RelationState.OK, ReasonCode.FITS, section)


@pytest.mark.parametrize("section", SECTIONS)
@pytest.mark.parametrize("state", [RelationState.FAILS, RelationState.ATTENTION])
def test_no_section_but_a_description_hides_behind_a_green_campaign(section, state):
    verdicts = {name: _green(name) for name in SECTIONS}
    verdicts[section] = SectionVerdict(section, state, ReasonCode.MISFIT, "odd")
    lead = leading(verdicts)
    assert lead is not None
    # A body that follows its drives is a result; whether a cause makes it so, the diagnosis says.
    assert (lead.section == section) is not (section == "deformation" and state == RelationState.ATTENTION)


@pytest.mark.parametrize("tables", [{}, campaign_tables(poses=3), calibration_tables()], ids=["none", "points", "fits"])
def test_any_tables_have_a_verdict(tables):
    frame = verdict_frame(tables)
    assert frame["section"].is_unique
    assert frame["explanation"].str.len().gt(10).all()
    assert not [text for text in frame["explanation"] if "nan" in text.split()]
    json.dumps(frame.replace({np.nan: None}).to_dict("records"))
    for name in tables:
        assert len(verdict_frame({other: own for other, own in tables.items() if other != name}))
        assert len(verdict_frame({**tables, name: tables[name].iloc[:0]}))


@pytest.mark.parametrize(
    ("state", "reason", "word"),
    [
        ("attention", "found", "found"),
        ("attention", "suspected", "attention"),
        ("fails", "do-not-belong", "fails"),
        ("ok", "agrees", "ok"),
    ],
)
def test_the_last_line_of_a_run_marks_a_result_as_the_page_does(state: str, reason: str, word: str) -> None:
    verdict = {"state": state, "reason_code": reason, "decided_by": "diagnosis", "explanation": "Because."}
    assert verdict_line(verdict) == f"verdict: {word} (diagnosis). Because."
