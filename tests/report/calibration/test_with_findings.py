"""The page lists calibrations with and without applied findings, and the decisions on causes."""

from __future__ import annotations

import pandas as pd
import pytest

from tests.sentences import assert_says
from truing.report.calibration.calibrations import main_calibration
from truing.report.calibration.with_findings import choice_verdicts, compared_calibrations, data_words
from truing.report.page_head import build_head
from truing.report.transfer_section import transfer

FINDING = "load-eccentricity of load fz"


def _compared(main: str, unchanged: float | None = None) -> pd.DataFrame:
    rows = []
    for data, size in (("as recorded", 4.0), ("with findings", 2.0)):
        for quantity, unit in (("fz", "N"), ("my", "N m")):
            row = {"data": data, "is_main": data == main, "findings": FINDING if data != "as recorded" else None}
            row |= {"model": "weighted", "quantity": quantity, "unit": unit, "tested_on": "held-out load cases"}
            rows.append(row | {"rms_error": size, "largest_error": 3.0 * size, "rms_unchanged": unchanged, "count": 40})
    return pd.DataFrame(rows).astype({"rms_unchanged": float})


@pytest.mark.parametrize(
    ("main", "first", "said"),
    [
        (
            "as recorded",
            ("as recorded, main", "none"),
            f"as recorded. For comparison, the page also gives a calibration with {FINDING}",
        ),
        ("with findings", ("with findings, main", FINDING), f"includes {FINDING}, as [diagnosis] apply asks"),
    ],
)
def test_the_main_calibration_comes_first_with_the_errors_of_both(main: str, first: tuple[str, str], said: str) -> None:
    tables = {"calibrations_compared": _compared(main)}
    (listing,) = compared_calibrations(tables)
    assert listing.heads[-2:] == ("fz (N)", "my (N·m)")
    assert listing.rows[0][:2] == first
    assert sorted(row[-1] for row in listing.rows) == ["2 / 6", "4 / 12"]
    assert said in data_words(tables)


def test_load_steps_that_no_finding_changes_have_rows_of_their_own() -> None:
    (listing,) = compared_calibrations({"calibrations_compared": _compared("as recorded", 1.0)})
    assert [row[3] for row in listing.rows] == [
        "held-out load cases",
        "held-out load cases that no finding changes",
    ] * 2
    assert [row[-1] for row in listing.rows] == ["4 / 12", "1", "2 / 6", "1"]


def test_without_a_finding_nothing_is_compared() -> None:
    assert compared_calibrations({}) == []
    assert data_words({}) == ""
    assert choice_verdicts({}) == []


def test_the_head_reports_what_became_of_causes_that_were_asked_for() -> None:
    rows = [
        ("creep", "apply", "no effect"),
        ("hysteresis", "apply", "not found"),
        ("load-imbalance", "apply", "applied"),
    ]
    choices = pd.DataFrame([*rows, ("dead-path", "ignore", "ignored")], columns=["cause", "asked", "outcome"])
    found = pd.DataFrame({"cause": ["load-imbalance"], "verdict": ["suspected"]})
    reported = choice_verdicts({"diagnosis_choices": choices, "diagnosis": found})
    assert {mark for mark, _ in reported} == {"warn"}
    sentences = " ".join(sentence for _, sentence in reported)
    assert_says(sentences, "diagnosis", "not find", "hysteresis")
    assert_says(sentences, "not applied")
    assert_says(sentences, "creep", "found", "no calibration")
    assert_says(sentences, "load-imbalance", "only suspected", "load-imbalance")
    assert "ignore asks: dead-path." in sentences
    head = build_head("c", {"diagnosis_choices": choices})
    assert [verdict for verdict in head.verdicts if verdict in choice_verdicts({"diagnosis_choices": choices})]


def test_an_applied_extended_model_is_the_main_calibration() -> None:
    def choice(*more: tuple[object, ...]) -> pd.DataFrame:
        rows = [
            ("6-pus", "none", "errors-in-variables", "chosen", 1.0),
            ("extended", "none", "points", "parameters", 9.0),
        ]
        return pd.DataFrame([*rows, *more], columns=["model", "deformation", "estimator", "figure", "value"])

    assert main_calibration({"model_choice": choice()}) == ("6-pus", "none")
    applied = choice(("extended", "none", "points", "main", 1.0))
    assert main_calibration({"model_choice": applied}) == ("extended", "none")


def test_errors_of_a_second_campaign_are_next_to_the_noise() -> None:
    sizes = (
        ("nominal", "6-pus", 4000.0),
        ("calibrated", "6-pus matrix", 20.0),
        ("extended", "with actuator-gain", 9.0),
    )
    common = {"campaign": "second", "quantity": "position", "noise_rms": 10.0, "count": 29, "unit": "um"}
    rows = [{"prediction_by": by, "model": m, "rms_error": e, "largest_error": 2 * e} | common for by, m, e in sizes]
    section = transfer({"second_campaign_errors": pd.DataFrame(rows)})
    assert section is not None
    assert "predict second" in section.lead
    assert_says(section.lead, "nominal 4 mm", "calibrated 20 µm", "extended 9 µm", "noise", "10 µm")
    assert [row[0] for row in section.listings[0].rows] == ["nominal", "calibrated", "extended", "noise alone"]
    assert section.listings[0].rows[1][2] == "20 / 40"
    assert transfer({}) is None
    empty = pd.DataFrame(rows).iloc[:0]
    empty.attrs["why_not"] = "the diagnosis was not evaluated, and left no model"
    section = transfer({"second_campaign_errors": empty})
    assert section is not None
    assert section.state == "not evaluated"
    assert "left no model" in section.lead
