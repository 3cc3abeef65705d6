"""The first lines of the page: the main error, its size, the gain by modelling it, and the next step."""

from __future__ import annotations

import json

import numpy as np
import pandas as pd
import pytest

from tests.report import diagnosis_tables as made
from tests.report.diagnosis_parts import part_of
from tests.report.diagnosis_tables import GAIN_3, MOVED, NOISE, diagnosis_tables, per_leg, rejected, row, rows, size
from tests.sentences import assert_says, says
from truing.report.diagnosis.assessed_causes import assessed_causes
from truing.report.diagnosis.section import diagnosis
from truing.report.diagnosis.verdict_sentences import counted
from truing.report.page_head import build_head


def lines(diagnosis_rows: pd.DataFrame, **more) -> tuple[tuple[str, str], ...]:
    """The head of a page where neither a check nor a requirement fails."""
    tables = {**diagnosis_tables(diagnosis_rows), **more}
    return build_head("c", {name: own for name, own in tables.items() if name not in ("qa", "requirements")}).verdicts


def first_line(diagnosis_rows: pd.DataFrame, **more) -> tuple[str, str]:
    return lines(diagnosis_rows, **more)[0]


def test_the_first_line_says_what_where_how_large_and_what_it_brings():
    mark, text = first_line(rows(row("platform-deformation-matrix", parameters=made.matrix()), *rejected()))
    assert mark == "found"
    shifts = diagnosis_tables()["deformation"].pivot(index="pose", columns="leg", values="delta_rho_mm").to_numpy()
    k = np.array([one["value"] for one in made.matrix().values()]).reshape(6, 6)
    spread = np.ptp(shifts @ k.T, axis=1)
    sigma = np.array([one["sigma"] for one in made.matrix().values()]).reshape(6, 6)[[0, 5]]
    noise = 1e3 * np.sqrt(np.sum((sigma * shifts[spread.argmax()]) ** 2))
    largest = f"{1e3 * spread.max():.1f} ± {noise:.1f}"
    assert_says(text, "platform deforms", "legs 1 and 6", f"{largest} µm")
    assert_says(text, "lowers", "held-out poses", "34 µm", "7.9 µm", "consistent", "noise", "7.2 µm")


@pytest.mark.parametrize(
    ("cause", "subject", "parameters", "words"),
    [
        ("actuator-gain", "leg3", GAIN_3, "Actuator 3 moves farther than it reads, by 0.210 ± 0.010 %"),
        (
            "actuator-gain",
            "leg3",
            {"gain_3": size(-0.002, 0.0001)},
            "Actuator 3 moves less than it reads, by 0.200",
        ),
        ("actuator-gain", "", per_leg("gain"), "The actuators have gain errors, most leg 6 (1.200"),
        ("actuator-backlash", "leg1 leg4", per_leg("backlash", 4, "mm"), "Actuators 1 and 4 have backlash, most leg 4"),
        (
            "actuator-backlash",
            "leg2",
            {"backlash_2": size(-0.0012, 1e-4, "mm")},
            "Actuator 2 leads its reading after each reversal, by 1.20 ± 0.10 µm to either side, as if backlash",
        ),
        ("actuator-periodic-error", "leg2", per_leg("amplitude", 2, "mm"), "Actuator 2 has a periodic error"),
        ("leg-drift", "leg4", {"drift_4": size(-0.012, 0.001, "mm")}, "Leg 4 shrinks by 12.0 ± 1.0 µm over the"),
        ("leg-thermal", "", {"alpha": size(1.2e-5, 1e-6, "1/K")}, "but the bodies do not, by 12.0 ± 1.0 ppm/K"),
        (
            "leg-thermal",
            "leg3",
            {"alpha_3": size(6e-5, 2e-6, "1/K")},
            "Leg 3 grows with temperature, but the bodies do not, by 60.0 ± 2.0 ppm/K",
        ),
        (
            "leg-thermal",
            "leg3",
            {"alpha_3": size(-2.8e-5, 6.6e-6, "1/K")},
            "Leg 3 shrinks with temperature, but the bodies do not, by 28.0 ± 6.6 ppm/K",
        ),
        (
            "approach-scatter",
            "",
            {"scatter": size(0.012, 0.001, "mm")},
            "The position of the actuators scatters from pose to pose, by 12.0 ± 1.0 µm (standard deviation)",
        ),
        ("thermal-expansion", "", {"alpha": size(1.2e-5, 1e-6, "1/K")}, "legs grow with temperature, by 12.0 ± 1.0"),
        ("measurement-scale", "", {"scale": size(-3e-5, 2e-6)}, "Measured lengths are too small, by 30.0 ± 2.0 ppm"),
        (
            "target-moved",
            "target P07",
            {**MOVED, "from_pose": size(23)},
            "Target P07 is displaced by 50.0 ± 3.0 µm from pose",
        ),
        (
            "targets-swapped",
            "targets P04 P07",
            {"poses": size("3 4")},
            "Targets P04 and P07 have exchanged labels in",
        ),
        (
            "base-deformation",
            "",
            {"driver": size("rho3"), "bowl": size(1e-3, 1e-4, "mm/mm")},
            "The base deforms with actuator 3",
        ),
        ("flexure-shift", "", {"flexure_length": size(10.2, 0.3, "mm")}, "Bending of the flexures shifts the joints"),
        (
            "platform-deformation-linear",
            "leg2",
            {"kappa_2": size(0.012, 1e-3)},
            "The platform deforms at leg 2 with its",
        ),
        ("my-lab's-cause", "x", {"foo": size(1.0, 0.1, "mm")}, "My lab's cause: foo 1.00 ± 0.10 mm"),
    ],
)
def test_every_cause_has_its_sentence(cause, subject, parameters, words):
    mark, text = first_line(rows(row(cause, subject=subject, parameters=parameters)))
    assert mark == "found"
    assert words in text
    assert_says(text, "lowers", "held-out poses", "34 µm", "7.9 µm", "consistent", "noise", "7.2 µm")
    assert len(text) < 320


def test_several_findings_are_numbered_and_their_gain_is_that_of_all():
    second = row("target-moved", subject="target P07", parameters=MOVED, heldout_rms_before=7.9, heldout_rms_after=5.5)
    _, text = first_line(rows(row("actuator-gain", subject="leg3", parameters=GAIN_3), second, *rejected()))
    assert_says(text, "Two effects", "(1)", "actuator 3", "farther", "(2)", "P07", "displaced")
    assert_says(text, "both", "lowers", "held-out poses", "34 µm", "5.5 µm")


def test_the_gain_is_that_of_the_extended_model() -> None:
    weak = row("target-moved", subject="target P07", parameters=MOVED, verdict="suspected", reason_code="weak")
    found = row("actuator-gain", subject="leg3", parameters=GAIN_3)
    _, text = first_line(rows(found, weak | {"in_model": False}, *rejected()))
    assert_says(text, "Suspected", "target P07")
    assert_says(text, "Modelling what was found lowers", "34 µm", "7.9 µm")
    counts = counted(assessed_causes({"diagnosis": rows(found, weak | {"in_model": False})}), {})
    assert_says(counts, "1 found", "1 suspected but not", "hardly more probable than no effect")


def test_the_gain_of_all_findings_starts_without_any_of_them():
    """The first finding was compared next to the second: its error without it holds the second already."""
    beside = {"rms_without_any": 33.1, "heldout_rms_without_any": 34.2}
    first = row(
        "actuator-gain", subject="leg3", parameters=GAIN_3, heldout_rms_before=5.9, heldout_rms_after=5.5, **beside
    )
    second = row("target-moved", subject="target P07", parameters=MOVED, heldout_rms_after=5.5, **beside)
    _, text = first_line(rows(first, second, *rejected()))
    assert_says(text, "both", "lowers", "held-out poses", "34 µm", "5.5 µm")


@pytest.mark.parametrize(
    ("after", "words"), [(34.3, "leaves the rms error on held-out poses at 34 µm"), (41.0, "raises the rms error")]
)
def test_a_cause_without_gain_is_not_reported_to_lower_errors(after, words):
    (incomplete, how), (mark, text), *_ = lines(rows(row("actuator-gain", parameters=GAIN_3, heldout_rms_after=after)))
    assert (incomplete, mark) == ("fail", "found")
    assert_says(how, "model", "incomplete")
    assert f"Modelling it {words}" in text


def test_more_findings_than_a_line_holds_are_counted():
    several = [
        row("leg-drift", subject=f"leg{k}", parameters={f"drift_{k}": size(0.01, 0.001, "mm")}) for k in range(1, 6)
    ]
    _, text = first_line(rows(*several))
    assert_says(text, "5 effects", "(1)", "leg 1", "grows", "2 further findings")


def test_nothing_found_reports_the_smallest_size_that_would_have_been():
    mark, text = first_line(rows(*rejected()))
    assert mark == "pass"
    assert_says(text, "Actuator readings", "measured poses", "mechanism", "agree", "noise", "none of 11")
    # The largest over the subjects, so that it holds wherever the effect is.
    assert_says(text, "platform deformation linear", "1.7 µm/mm", "actuator backlash", "1.8 µm")
    assert len(text) < 320


def test_nothing_found_is_no_pass_where_predictions_miss_by_more_than_noise():
    beyond = [{**one, "noise_floor": 5.2} for one in rejected()]
    mark, text = first_line(rows(*beyond))
    assert mark == "warn"
    assert_says(text, "rms error", "calibration poses", "7.4 µm", "noise", "5.2 µm")
    assert "agree" not in text
    assert "agree" not in diagnosis(diagnosis_tables(rows(*beyond))).lead


def test_nothing_found_without_a_table_of_sizes_claims_no_size():
    _, text = first_line(rows(*rejected()), detectable=made.detectable().iloc[:0])
    assert_says(text, "none of 11", "found")
    assert not says(text, "µm")


def test_noise_alone_is_a_warning_and_no_effect():
    mark, text = first_line(rows(row("unexplained", **NOISE), *rejected()))
    assert mark == "warn"
    assert_says(text, "residuals", "1.410 ± 0.050", "declared noise", "none of 11")  # an unknown effect raises them too
    tables = diagnosis_tables(rows(row("unexplained", **NOISE), *rejected()))
    assert_says(diagnosis(tables).lead, "none of 11", "found")
    assert_says(diagnosis(tables).lead, "residuals", "exceed", "declared noise")
    assert part_of("evidence", tables).title == "Evidence for each cause"


def test_noise_that_nobody_declared_is_not_called_declared():
    found = {**row("unexplained", **NOISE), "relation": "loads-signals", "noise_floor": None}
    tables = diagnosis_tables(rows(found, *rejected()))
    for text in (first_line(rows(found, *rejected()))[1], diagnosis(tables).lead):
        assert "declared noise" not in text
        assert_says(text, "residuals", "noise as estimated from the signals")


def test_an_unexplained_effect_names_its_inputs():
    found = row("unexplained", follows="temperature_c", parameters=per_leg("leg1_degree", 2, "mm"))
    found["largest_motion"] = 12.3
    mark, text = first_line(rows(found, *rejected()))
    assert mark == "found"
    assert_says(text, "depends", "temperature", "12 µm", "no cause", "explains")


def test_inputs_that_explain_nearly_as_well_are_named_in_the_first_line():
    settings = json.dumps({"instead": [["time_s"], ["rho2_mm", "temperature_c"]]})
    found = row("unexplained", follows="temperature_c", parameters=per_leg("leg1_degree", 2, "mm"), settings=settings)
    _, text = first_line(rows(found, *rejected()))
    assert_says(text, "depends on the temperature, or instead on time, or instead on actuator 2 and the temperature")


def test_quantities_of_a_leg_that_explain_nearly_as_well_are_named_in_the_first_line():
    settings = json.dumps({"quantity": "attachments", "quantities_instead": ["readings"]})
    found = row("unexplained", "found", subject="leg3", follows="time_s", parameters={}, settings=settings)
    _, text = first_line(rows(found, *rejected()))
    assert_says(text, "attachments of leg 3", "or instead the effective readings of leg 3", "depend on")


@pytest.mark.parametrize(
    ("legs", "words"), [([5], "the last movement of its actuator"), ([], "the last movement of each actuator")]
)
def test_a_single_leg_depends_on_the_movements_of_its_own_actuator(legs: list[int], words: str) -> None:
    own = {"quantity": "readings", "legs": legs, "columns": ["last step"], "half_ranges": [1e-3], "form": "polynomial"}
    subject, settings = "".join(f"leg{leg}" for leg in legs), json.dumps(own)
    found = row("unexplained", "found", subject=subject, follows="last step", parameters={}, settings=settings)
    _, text = first_line(rows(found, *rejected()))
    assert_says(text, "depend on", words)


def test_rivals_that_cannot_be_distinguished_are_named_at_the_head():
    gain = row("actuator-gain", subject="leg3", parameters=GAIN_3, log_evidence=45.0)
    rival = row("platform-deformation-linear", "indistinguishable", subject="leg3", parameters={"kappa_3": size(0.002)})
    assert_says(first_line(rows(gain, rival, *rejected()))[1], "cannot rule out", "platform deforms", "leg 3")
    own = row("own", "indistinguishable", parameters={"k": size(0.2)}, clause="a body bends")
    text = first_line(rows(gain, own, *rejected()))[1]
    assert_says(text, "cannot rule out", "a body bends", "k")
    part = part_of("evidence", diagnosis_tables(rows(gain, rival, *rejected())))
    assert_says(part.lead, "1 alternative", "factor of 20", "probability")
    names = {trace.name: trace for trace in part.figures[0][0].data}
    assert list(names["not distinguishable"].y) == ["platform deformation linear, leg 3 "]


def test_a_finding_without_a_name_has_no_cause_only_where_none_explains_it_equally_well():
    unnamed = row("unexplained", follows="time_s")
    alone = first_line(rows(unnamed, *rejected()))[1]
    beside = first_line(rows(unnamed, row("leg-drift", "indistinguishable"), *rejected()[1:]))[1]
    assert "no cause of the catalogue" in alone
    assert "no cause of the catalogue" not in beside
