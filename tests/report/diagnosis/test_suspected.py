"""A suspected cause never reads as found, and an inadequate model never as agreement."""

from __future__ import annotations

import json
import math

import pandas as pd
import pytest

from tests.report.diagnosis_parts import part_of, state_of
from tests.report.diagnosis_tables import GAIN_3, diagnosis_tables, matrix, rejected, row, rows
from tests.sentences import assert_says, says
from truing.belonging.relation import RelationState
from truing.report.diagnosis.adequacy import adequacy as adequacy_section
from truing.report.diagnosis.adequacy import adequacy_verdict, shortcoming
from truing.report.diagnosis.assessed_causes import PARTLY_BY_FINDINGS, WITHOUT_FINDINGS, assessed_causes
from truing.report.diagnosis.evidence import evidence
from truing.report.diagnosis.findings import DECLARED_NOISE, DOUBTS, SCATTER_OF_REPEATS, scatter_explanation
from truing.report.diagnosis.headline import clause
from truing.report.diagnosis.section import diagnosis
from truing.report.diagnosis.verdict_sentences import diagnosis_verdict
from truing.report.numbers import printed
from truing.report.page_head import build_head
from truing.report.section_verdict import verdict_rows
from truing.report.verdict import with_verdict
from truing.report.wordings.nonparametric_wordings import remainder_advice, remainder_explanation
from truing.schemas.verdict import ReasonCode, Relation

GAIN = row("actuator-gain", subject="leg3", parameters=GAIN_3)
DOUBTED = GAIN | {"verdict": "suspected", "reason_code": "unnamed"}
DRIFT = row("leg-drift", subject="leg4", parameters={"drift_4": {"value": -0.012, "sigma": 0.001, "unit": "mm"}})


def adequacy(*tests: tuple[str, str, float | None, float | None, str]) -> pd.DataFrame:
    names = ["test", "along", "value", "p_value", "state"]
    return pd.DataFrame(tests, columns=names).assign(subject="point", limit=0.02)


HOLDS = adequacy(("observation-noise", "", 1.01, 0.6, "ok"), ("input-noise", "", None, None, "not tested"))
ENDED = pd.concat(
    [adequacy(("causes-left", "", 3.0, 1e-9, "fails")).assign(
        search_end="unnamed-effects", left_cause="actuator-gain", left_subject="leg3"
    ), HOLDS]
)  # fmt: skip
FAILS = adequacy(
    ("observation-noise", "", 1.1, 0.019, "fails"),
    ("like-neighbours", "temperature_c", 0.31, 1e-5, "fails"),
    ("input-noise", "", 1.0, 0.8, "ok"),
)


def of(diagnosis_rows: pd.DataFrame, tests: pd.DataFrame) -> dict[str, pd.DataFrame]:
    tables = {**diagnosis_tables(diagnosis_rows), "adequacy": tests}
    return {name: own for name, own in tables.items() if name not in ("qa", "requirements")}


def head(diagnosis_rows: pd.DataFrame, tests: pd.DataFrame) -> tuple[str, str]:
    return build_head("c", of(diagnosis_rows, tests)).verdicts[0]


def reason(diagnosis_rows: pd.DataFrame, tests: pd.DataFrame) -> ReasonCode:
    return verdict_rows(with_verdict(of(diagnosis_rows, tests)))["campaign"].reason_code


@pytest.mark.parametrize(
    ("end", "left", "sentences"),
    [
        (
            "most-causes",
            "actuator-gain",
            (("9 accepted causes", "another effect remains", "leg 3"), ("search ended", "held-out")),
        ),
        (
            "time",
            "actuator-gain",
            (("9 accepted causes", "another effect remains", "leg 3"), ("search ended", "too long")),
        ),
        ("most-causes", None, (("accepted 9 causes", "piece by piece"),)),
    ],
)
def test_the_reason_for_the_end_of_a_search_is_reported(
    end: str, left: str | None, sentences: tuple[tuple[str, ...], ...]
) -> None:
    subject = "leg3" if left else None
    ended = ENDED.assign(value=9.0, search_end=end, left_cause=left, left_subject=subject)
    text = shortcoming({"adequacy": ended})
    for words in sentences:
        assert_says(text, *words)
    assert ("remains" in text) == (left is not None)


def test_single_large_errors_of_a_joint_are_no_ratio_of_noise() -> None:
    ratio = {"largest_ratio": {"value": 10.94, "sigma": None, "unit": "1"}}
    large = row("unexplained", subject="joint j6", parameters=ratio, reason_code="noise", settings='{"large": 5}')
    (own,) = assessed_causes(of(rows(large), HOLDS))
    assert_says(clause(own, {}), "errors of joint j6", "large in 5 poses", "times a typical one")
    assert not says(clause(own, {}), "declared")


def test_a_suspected_cause_leads_as_suspected() -> None:
    mark, text = head(rows(DOUBTED, *rejected()), HOLDS)
    assert mark == "warn"
    assert_says(text, "Suspected, not confirmed", "actuator 3", "farther")


def test_found_causes_come_before_suspected_ones() -> None:
    mark, text = head(rows(DRIFT, DOUBTED, *rejected()), HOLDS)
    assert mark == "warn"
    assert text.index("Leg 4") < text.index("Suspected") < text.index("actuator 3")
    assert "effects found" not in text


def test_larger_noise_is_no_further_effect() -> None:
    noise = row("unexplained", parameters={"noise_ratio": {"value": 2.0, "sigma": 0.1, "unit": "1"}})
    _, text = head(rows(DRIFT, noise, *rejected()), HOLDS)
    assert "effects found" not in text
    assert text.index("Leg 4") < text.index("Also, the residuals")


@pytest.mark.parametrize("found", [[], [DOUBTED | {"reason_code": "inadequate"}]])
def test_a_rejected_model_is_reported_in_the_first_line_with_its_test(found: list[dict[str, object]]) -> None:
    assert reason(rows(*found, *rejected()), FAILS) == ReasonCode.LACK_OF_FIT
    mark, text = head(rows(*found, *rejected()), FAILS)
    assert mark == "warn"
    assert_says(text, "model", "incomplete")
    assert_says(text, "temperature", "correlated", "correlation 0.31")
    assert "agrees" not in text


def test_the_section_is_no_pass_and_gives_the_reason() -> None:
    tables = {**diagnosis_tables(rows(DOUBTED, *rejected())), "adequacy": HOLDS}
    section = diagnosis(tables)
    assert section is not None
    assert state_of("diagnosis", tables) == "attention"
    (mark, text), *_ = section.statements
    assert mark == "warn"
    assert DOUBTS["unnamed"] in text
    assert ": 1 suspected and added" in section.lead


def test_every_test_of_the_model_is_listed_also_untested_ones() -> None:
    held = part_of("adequacy", diagnosis_tables() | {"adequacy": HOLDS})
    assert state_of("adequacy", diagnosis_tables() | {"adequacy": HOLDS}) == "ok"
    assert held.listings[0].marks == ("pass", "none")
    assert_says(held.lead, "Not tested", "too few", "noise of the inputs")
    failed = part_of("adequacy", diagnosis_tables() | {"adequacy": FAILS})
    assert state_of("adequacy", diagnosis_tables() | {"adequacy": FAILS}) == "attention"
    assert "neighbouring residuals" in failed.lead


@pytest.mark.parametrize(
    ("relation", "noise"),
    [(Relation.READINGS_POSES, DECLARED_NOISE), (Relation.TARGETS_POSITIONS, SCATTER_OF_REPEATS)],
)
def test_a_ratio_of_noise_names_the_noise_that_it_was_compared_with(relation: Relation, noise: str) -> None:
    tables = diagnosis_tables(rows(*rejected()).assign(relation=relation.value)) | {"adequacy": HOLDS}
    section = adequacy_section(tables)
    assert section is not None
    assert section.listings[0].rows[0][2] == f"1.0 times {noise}"


def test_quantities_without_repeats_are_reported_as_not_repeated() -> None:
    tests = adequacy(
        ("like-neighbours", "time_s", 0.01, 0.6, "ok"),
        ("pure-error", "", None, None, "not tested"),
        ("input-noise", "", None, None, "not tested"),
    ).assign(why_untested=[None, "no-repeats", "too-few"])
    lead = part_of("adequacy", diagnosis_tables() | {"adequacy": tests}).lead
    assert_says(lead, "Not tested", "no command", "lack of fit")
    assert lead.index("the inputs") < lead.index("no command")


def test_a_search_that_ended_early_is_reported_as_not_tested_to_the_end() -> None:
    tests = adequacy(("like-neighbours", "time_s", 0.3, 1e-6, "fails"), ("parts", "", None, None, "not tested"))
    tests = tests.assign(why_untested=[None, "too-large"])
    lead = part_of("adequacy", diagnosis_tables() | {"adequacy": tests}).lead
    assert_says(lead, "Not tested", "not to the end", "single parts' errors")


@pytest.mark.parametrize(
    ("test", "along", "said"),
    [
        ("pure-error", "", "errors of repeated measurements exceed what their scatter explains (F = 3.2)"),
        ("by-region", "rho1_mm", "mean residuals differ between regions of"),
    ],
)
def test_a_lack_of_fit_against_pure_error_makes_the_picture_incomplete(test: str, along: str, said: str) -> None:
    tests = adequacy((test, along, 3.2, 1e-6, "fails"))
    assert reason(rows(*rejected()), tests) == ReasonCode.LACK_OF_FIT
    mark, first = head(rows(*rejected()), tests)
    assert mark == "warn"
    assert said in first


def test_a_search_that_was_ended_is_reported_first_with_what_is_left() -> None:
    inadequate = rows(DOUBTED | {"reason_code": "inadequate"}, *rejected())
    assert reason(inadequate, ENDED) == ReasonCode.LACK_OF_FIT
    mark, text = head(inadequate, ENDED)
    assert mark == "warn"
    assert_says(text, "3 accepted causes", "best candidate", "actuator gain", "leg 3")
    assert_says(text, "search ended")
    part = part_of("adequacy", diagnosis_tables() | {"adequacy": ENDED})
    assert part.listings[0].marks == ("fail", "pass", "none")
    assert "actuator gain" in part.lead
    assert "leg 3" in part.lead


@pytest.mark.parametrize("doubt", ["inadequate", "unnamed", "not-random"])
def test_a_scatter_that_is_suspected_is_reported_with_its_reason(doubt: str) -> None:
    size = {"scatter": {"value": 0.02, "sigma": 0.002, "unit": "mm"}}
    doubted = row("approach-scatter", "suspected", subject="leg3", parameters=size, reason_code=doubt)
    section = diagnosis({**diagnosis_tables(rows(doubted, *rejected())), "adequacy": HOLDS})
    assert section is not None
    assert DOUBTS[doubt] in section.statements[0][1]
    assert DOUBTS[doubt] in scatter_explanation("actuator 3 lands elsewhere", 1e-4, doubt)
    assert "No pose was repeated" not in scatter_explanation("actuator 3 lands elsewhere", 1e-4, doubt)
    assert "No pose was repeated" in scatter_explanation("actuator 3 lands elsewhere", 1e-4, doubt, is_repeated=False)


REMAINDER = row("unexplained", subject="", parameters={}) | {
    "reason_code": "remainder",
    "follows": "temperature_c rho3_mm",
    "share_predicted": 0.41,
}


def test_columns_that_predict_the_misfit_are_reported_with_their_share() -> None:
    one, *_ = assessed_causes({"diagnosis": rows(REMAINDER, *rejected())})
    assert one.is_remainder
    assert one.is_noise  # no effect in the model
    left = "the residual variance of the model without causes"
    assert_says(clause(one, {}), "The residuals", "actuator 3", "the temperature", "41 %", left)
    assert "noise" not in one.name


@pytest.mark.parametrize(
    ("subject", "place"), [("joint axis_2", "direction of joint axis_2"), ("leg4", "direction of leg 4")]
)
def test_columns_that_the_error_of_a_part_depends_on_are_reported_with_the_part(subject: str, place: str) -> None:
    one, *_ = assessed_causes({"diagnosis": rows(REMAINDER | {"subject": subject}, *rejected())})
    assert_says(clause(one, {}), place, "actuator 3", "the temperature", "41 %")
    assert "up to" not in clause(one, {})


def test_columns_that_predict_the_misfit_never_read_as_agreement() -> None:
    tables = {**diagnosis_tables(rows(REMAINDER, *rejected())), "adequacy": FAILS}
    assert state_of("diagnosis", tables) == "attention"
    mark, text = head(rows(REMAINDER, *rejected()), FAILS)
    assert mark != "pass"
    assert "agrees" not in text
    section = diagnosis(tables)
    assert section is not None
    assert not says(section.lead, "exceed", "declared noise")


def test_suspected_causes_report_the_effects_that_explain_as_much() -> None:
    conditional = REMAINDER | {"settings": json.dumps({WITHOUT_FINDINGS: True})}
    both = rows(DOUBTED, conditional, *rejected())
    _, one, *_ = assessed_causes({"diagnosis": both})
    assert one.is_conditional
    assert_says(clause(one, {}), "Without the other findings, the residuals depend on")
    text = head(both, HOLDS)[1]
    assert_says(text, "Without the other findings", "41 %")
    assert "Also, " not in text
    assert "Also, " in head(rows(DOUBTED, REMAINDER, *rejected()), HOLDS)[1]


def test_a_dependence_explained_in_part_is_not_reported_as_missing_from_the_model() -> None:
    partial = REMAINDER | {"settings": json.dumps({PARTLY_BY_FINDINGS: True})}
    _, one, *_ = assessed_causes({"diagnosis": rows(DOUBTED, partial, *rejected())})
    assert not one.is_conditional
    assert_says(clause(one, {}), "the other findings", "part")
    text = remainder_explanation("The residuals depend on time", 1e-4, is_of_all=False, remains=True, is_partial=True)
    assert_says(text, "still significant", "does not hold all of it")
    assert "no cause is named" not in text


DRIFTS = [
    row("unexplained", subject="axis", parameters={f"degree{k}": {"value": 9.0 / k, "sigma": 0.1, "unit": "mm"}})
    | {
        "follows": "time_s",
        "largest_motion": 24.0 / k,
        "settings": json.dumps({"columns": [column], "form": "polynomial", "first": k, "half_ranges": [5.0]}),
    }
    for column in ("time_s", "order")
    for k in (1, 2)
]


@pytest.mark.parametrize("drift", [DRIFTS[:2], DRIFTS[2:]])
def test_terms_of_higher_order_of_a_drift_are_the_same_effect(drift: list[dict[str, object]]) -> None:
    base, higher, *_ = assessed_causes({"diagnosis": rows(*drift)})
    assert base.has_terms(higher)
    assert not higher.has_terms(base)
    tables = {**diagnosis_tables(rows(*drift)), "adequacy": HOLDS}
    verdict = diagnosis_verdict(tables, {})
    assert verdict is not None
    assert verdict.value == 1.0
    text = head(rows(*drift), HOLDS)[1]
    assert "effects found" not in text
    assert "Modelling it" in text or "Modelling" not in text
    assert_says(text, "24", "terms of higher order", "12")


def test_two_drifts_of_different_parts_are_two_effects() -> None:
    of_motor = DRIFTS[1] | {"subject": "encoder motor"}
    base, other, *_ = assessed_causes({"diagnosis": rows(DRIFTS[0], of_motor)})
    assert not base.has_terms(other)


@pytest.mark.parametrize(("column", "name"), [("time_s", "time"), ("order", "the order of measurement")])
def test_a_campaign_without_times_has_no_effect_of_time(column: str, name: str) -> None:
    one, *_ = assessed_causes({"diagnosis": rows(*[own for own in DRIFTS if f'"{column}"' in str(own["settings"])])})
    assert name in one.name
    stretch = json.dumps({"columns": [column], "form": "stretch", "half_ranges": [16.0], "element": "axis"})
    text = clause(assessed_causes({"diagnosis": rows(DRIFTS[0] | {"settings": stretch})})[0], {})
    assert ("32 s" in text) == (column == "time_s")


def test_odds_against_a_suspected_effect_are_reported_as_such() -> None:
    weak = DOUBTED | {"log_evidence": math.log(0.4)}
    (section,) = [evidence(assessed_causes({"diagnosis": rows(weak, *rejected())}))]
    assert section is not None
    assert_says(section.lead, "No effect is 2.50 times as probable as")
    assert "favour" not in section.lead


def test_candidates_are_counted_alike_over_the_page() -> None:
    idle = row("harmonic", verdict="not testable", p_value=None, probability=None)
    noise = row("unexplained", parameters={"noise_ratio": {"value": 4.0, "sigma": 0.1, "unit": "1"}})
    text = adequacy_verdict({**diagnosis_tables(rows(noise, *rejected(), idle)), "adequacy": FAILS}, {})
    assert text is not None
    tested = sum(own["verdict"] == "rejected" for own in rejected())
    assert_says(text.explanation, f"none of {tested} candidates")


@pytest.mark.parametrize(
    ("fitted", "held_out", "words"),
    [(111.4, 61.6, "rms error on calibration poses is 111 µm"), (61.6, 111.4, "rms error on held-out poses is 111 µm")],
)
def test_the_rms_error_of_an_incomplete_model_names_its_data(fitted: float, held_out: float, words: str) -> None:
    """The first screen gives the error on held-out poses, which may be another number."""
    found = row("platform-deformation-matrix", parameters=matrix(), rms_after=fitted, heldout_rms_after=held_out)
    tables = diagnosis_tables(rows(found, *rejected()))
    verdict = adequacy_verdict({**tables, "adequacy": FAILS}, {})
    assert verdict is not None
    assert_says(printed(verdict.explanation), words)


def test_advice_on_what_follows_time_alone_is_another_order() -> None:
    assert "another order" in remainder_advice(("time_s",))
    assert_says(remainder_advice(("time_s", "temperature_c")), "Repeat", "temperature changed")


@pytest.mark.parametrize(("follows", "raises"), [("", False), ("temperature_c", True)])
def test_noise_that_is_larger_everywhere_raises_no_floor(follows, raises):
    """The floor is that of the declared noise: only weights of single poses, and scatter of inputs, enter it."""
    ratio = {"noise_ratio": {"value": 30.0, "sigma": 0.3, "unit": "1"}}
    larger = row("unexplained", parameters=ratio, reason_code="noise", follows=follows)
    scatter = row("approach-scatter", subject="joint j2", parameters={})
    found = assessed_causes(diagnosis_tables(rows(larger, scatter)))
    assert [one.raises_floor for one in found] == [raises, True]


def test_of_dependences_that_the_findings_explain_two_are_stated_and_the_others_counted() -> None:
    conditional = [
        REMAINDER | {"subject": f"signal v{k}", "settings": json.dumps({WITHOUT_FINDINGS: True})} for k in range(1, 6)
    ]
    section = diagnosis(diagnosis_tables(rows(DOUBTED, *conditional, *rejected())))
    assert section is not None
    assert len(section.statements) == 1 + 2 + 1
    assert says([text for _, text in section.statements], "3 more dependences")
    assert len(section.listings[0].rows) == 1 + 5


def test_residuals_beyond_the_declared_noise_are_not_said_to_be_noise() -> None:
    tests = adequacy(("observation-noise", "", 2.5, 1e-9, "fails"))
    lead = part_of("adequacy", diagnosis_tables() | {"adequacy": tests}).lead
    assert_says(
        lead, "residuals of the measurements are 2.5 times the declared noise", "larger noise, or a missing effect"
    )


@pytest.mark.parametrize(("times", "state"), [(1.5, RelationState.ATTENTION), (2.5, RelationState.FAILS)])
def test_residuals_too_large_without_a_pattern_may_be_larger_noise(times: float, state: RelationState) -> None:
    ratio = {"noise_ratio": {"value": times, "sigma": 0.1, "unit": "1"}}
    errors = dict.fromkeys(("rms_before", "rms_after", "heldout_rms_before", "heldout_rms_after"), 5.0 * times)
    noise = row("unexplained", parameters=ratio, noise_floor=5.0, **errors)
    larger = ("observation-noise", "", times, 1e-9, "fails")
    tables = diagnosis_tables(rows(noise, *rejected()))
    even_tests = adequacy(larger, ("pure-error", "", 1.1, 0.8, "ok"))
    even = adequacy_verdict({**tables, "adequacy": even_tests}, {})
    assert even is not None
    assert (even.state, even.reason_code) == (state, ReasonCode.BEYOND_NOISE)
    assert even.explanation.startswith("The noise is larger than declared, or the model is incomplete")
    assert_says(printed(even.explanation), "declared noise gives 5.0 µm")
    assert_says(even.explanation, "No test finds a pattern", "repetitions")
    assert "noise alone gives" not in even.explanation
    scatter = row("approach-scatter", subject="leg3", parameters={}, noise_floor=5.0, **errors)
    scattered = adequacy_verdict({**diagnosis_tables(rows(scatter, noise)), "adequacy": even_tests}, {})
    assert scattered is not None
    assert_says(printed(scattered.explanation), "the declared noise and the scatter found here give 5.0 µm")
    drift = adequacy(larger, ("like-neighbours", "time_s", 0.4, 1e-6, "fails"))
    untested = adequacy(larger, ("pure-error", "", None, None, "not tested"))
    for tests in (drift, untested):
        verdict = adequacy_verdict({**tables, "adequacy": tests}, {})
        assert verdict is not None
        assert verdict.explanation.startswith("The model is incomplete")
