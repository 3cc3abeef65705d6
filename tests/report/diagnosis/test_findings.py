"""Sentences of the diagnosis: cause, subject, size and certainty, in units of a laboratory."""

from __future__ import annotations

from dataclasses import replace

import pytest

from tests.sentences import assert_says, says
from truing.report.diagnosis.effect_units import plain_size, size_text, stem
from truing.report.diagnosis.findings import (
    ESTIMATED_NOISE,
    Facts,
    NoiseFacts,
    detectable_words,
    explanation,
    noise_explanation,
    subject_words,
)

FACTS = Facts(
    verdict="found",
    clause="the actuator moves further than it reads",
    parameters={"gain_3": {"value": 0.00213, "sigma": 0.0001, "unit": "1"}},
    p_value=0.0005,
    candidates=1377,
    rms_before=12.41,
    rms_after=4.77,
    held_out=(7.8, 4.65),
    floor=4.78,
    reason_code="",
    rival="",
    detectable="",
    unnamed=False,
    remark="",
    subject="leg3",
    largest=61.2,
)


def test_other_inputs_that_the_data_leave_open_are_reported_with_their_odds():
    text = explanation(replace(FACTS, inputs=(("time", 3.14), ("the temperature", 0.9))))
    assert text.startswith(explanation(FACTS))
    assert "time (3.1 to 1), the temperature (1.0 to 1)" in text


def test_other_subjects_that_the_data_leave_open_are_reported_with_their_odds():
    text = explanation(replace(FACTS, subjects=(("", 1.24), ("leg2 leg5", 6.0), ("target P07", 0.9))))
    assert text.startswith(explanation(FACTS).replace("The data show that", "Most probably,"))
    assert explanation(replace(FACTS, subjects=(("", 12.0),))).startswith(explanation(FACTS))
    assert_says(text, "odds", "all legs (1.2 to 1)", "legs 2 and 5 (6.0 to 1)", "target P07 (1.0 to 1)")
    whole = explanation(replace(FACTS, subject="body frame", subjects=(("", 2.0),)))
    assert_says(whole, "odds", "the whole machine (2.0 to 1)")


def test_a_finding_says_what_where_how_large_and_how_sure():
    assert explanation(FACTS) == (
        "The data show that the actuator moves further than it reads: gain_3 = 0.213 ± 0.010 %. "
        "It changes measured values by up to 61.2 um. "
        "The rms error of predictions from the readings is 4.77 um with it and 12.41 um without "
        "(held-out poses: 4.65 and 7.80 um); noise alone gives 4.78 um. "
        "Probability by chance: at most 0.0005, corrected for 1377 tests."
    )


def test_a_name_doubted_by_another_course_says_which_and_where():
    doubted = replace(FACTS, verdict="suspected", reason_code="course", share=0.72)
    beside = explanation(replace(doubted, course=("rho3_mm",), is_course_beside=True))
    assert_says(beside, "suspected", "depends on rho3_mm", "acts next to it")
    assert_says(beside, "72 %")
    in_place = explanation(replace(doubted, course=()))
    assert_says(in_place, "suspected", "wanders or jumps in time", "about as probable in its place")


@pytest.mark.parametrize(
    ("subject", "words"),
    [
        ("", ""),
        ("leg3", "leg 3"),
        ("leg1 leg4", "legs 1 and 4"),
        ("leg1 leg4 leg10", "legs 1, 4 and 10"),
        ("target P07", "target P07"),
        ("targets P04 P07", "targets P04 and P07"),
        ("legend", "legend"),
    ],
)
def test_subjects_are_reported_in_words(subject, words):
    assert subject_words(subject) == words


def test_a_rival_says_against_what_and_with_which_odds():
    rival = replace(FACTS, verdict="indistinguishable", rival="platform-deformation-linear", odds=3.2)
    text = explanation(rival)
    assert_says(text, "nearly as well as platform-deformation-linear", "odds", "3.2 to 1")
    assert_says(explanation(replace(rival, odds=0.9)), "the data as well as platform-deformation-linear")
    assert_says(text, "may be", "actuator moves further", "gain_3 = 0.213 ± 0.010 %")
    assert_says(text, "cannot distinguish")


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"reason_code": "held-out"}, "this fits the calibration poses, but predicts held-out poses worse"),
        ({"reason_code": "contained"}, "explains less; alone: gain_3 = 0.213 ± 0.010 %."),
        ({"reason_code": "contained", "parameters": {}}, "This is part of an accepted cause and explains less."),
        (
            {"detectable": detectable_words("alpha", 1.2e-6, "1/K")},
            "alpha of 1.2 ppm/K would have been found with a probability of 80 %",
        ),
        ({"verdict": "not testable"}, "they would not show it at any plausible size."),
    ],
)
def test_rejected_observations_have_a_reason(given, words):
    assert words in explanation(replace(FACTS, **{"verdict": "rejected", **given}))


def test_a_doubt_by_held_out_data_counts_all_of_them_whatever_their_unit():
    doubtful = replace(FACTS, verdict="suspected", reason_code="held-out", held_out=(7.8, 7.1), held_out_growth=2.23)
    text = explanation(doubtful)
    assert_says(text, "predicts held-out data worse", "in units of its noise", "by a factor of 2.2")
    assert "factor" not in explanation(replace(doubtful, reason_code="weak"))
    assert "by 2.7 %" in explanation(replace(doubtful, held_out_growth=1.027))


def test_many_parameters_are_reported_by_the_most_certain():
    many = {f"K1{k}": {"value": 0.001 * k, "sigma": 0.0005, "unit": "1"} for k in range(1, 10)}
    text = explanation(replace(FACTS, parameters=many))
    assert "K19 = 9.00 ± 0.50 um/mm" in text
    assert "and 3 smaller" in text
    assert "K11 =" not in text
    onset = {"from_pose": {"value": 17, "sigma": None, "unit": ""}}
    shifts = {f"shift_{k}": {"value": 0.1 * k, "sigma": 0.01, "unit": "mm"} for k in range(1, 7)}
    assert "smaller" not in explanation(replace(FACTS, parameters={**shifts, **onset}))


def test_quantities_not_evaluated_are_left_out():
    bare = replace(FACTS, rms_before=None, rms_after=None, largest=None, held_out=(None, None), parameters={})
    assert_says(explanation(bare), "actuator moves further")
    assert_says(explanation(bare), "chance", "0.0005", "1377 tests")
    assert not says(explanation(bare), "gain_3")
    assert not says(explanation(bare), "um")
    assert "held-out" not in explanation(replace(FACTS, held_out=(None, 3.0)))
    assert explanation(replace(FACTS, remark="Provisional.")).endswith("tests. Provisional.")


def test_noise_says_where_it_is_larger_where_that_is_known():
    uniform = noise_explanation(NoiseFacts(1.41, 0.05, 7.3, 5.1))
    assert_says(uniform, "residuals", "1.410 ± 0.050", "declared noise")
    assert_says(uniform, "rms error", "7.30 um", "the declared noise gives 5.10 um")  # the floor is not the noise found
    scattered = noise_explanation(NoiseFacts(1.41, 0.05, 7.3, 6.2, floor_has_scatter=True))
    assert_says(scattered, "the declared noise and the scatter found here give 6.20 um")
    of_signals = noise_explanation(NoiseFacts(1.41, 0.05, None, None, expected=ESTIMATED_NOISE))
    assert_says(of_signals, "1.410 ± 0.050", "estimated", "none is declared")
    assert_says(of_signals, "that estimate is too small")
    assert "than declared" not in of_signals
    varying = noise_explanation(NoiseFacts(1.4, 0.1, None, 5.0, inputs=("temperature_c", "time_s")))
    assert_says(varying, "depends", "temperature_c", "time_s")
    assert_says(varying, "1.40 ± 0.10 times as large as where it is smallest")
    assert not says(varying, "declared noise")  # the ratio compares places, not the declaration
    alone = noise_explanation(NoiseFacts(1.4, 0.1, 7.3, 5.1, inputs=("target B1",), channel="target B1"))
    assert_says(alone, "target B1", "1.40 ± 0.10 times that of the others")
    assert_says(alone, "noise as estimated here gives 5.10 um")


@pytest.mark.parametrize(
    ("expected", "words"),
    [
        (("kappa_1", 0.0123, 0.0004, "1"), "12.30 ± 0.40 um/mm"),
        (("K1_10", -0.0123, 0.0004, "1"), "-12.30 ± 0.40 um/mm"),
        (("quadratic_2", 0.0012, 0.0001, "1/mm"), "1.20 ± 0.10 um/mm2"),
        (("cubic_2", 0.0012, 0.0001, "1/mm2"), "1.20 ± 0.10 um/mm3"),
        (("scale", -3.5e-5, 2e-6, "1"), "-35.0 ± 2.0 ppm"),
        (("scale", -0.02, 2e-4, "1"), "-2.000 ± 0.020 %"),
        (("scale_per_k", 1.2e-5, 1e-6, "1/K"), "12.0 ± 1.0 ppm/K"),
        (("drift_4", 0.0123, 0.0004, "mm"), "12.30 ± 0.40 um"),
        (("dx", 1.5, 0.003, "mm"), "1.5000 ± 0.0030 mm"),
        (("pitch", 0.5, 0.002, "mm"), "0.5000 ± 0.0020 mm"),
        (("tau", 4000.0, 300.0, "s"), "66.7 ± 5.0 min"),
        (("tau", 40.0, 3.0, "s"), "40.0 ± 3.0 s"),
        (("phase", 3.141592653589793, 0.1, "rad"), "180.0 ± 5.7 deg"),
        (("saddle_x", 0.003, 2e-4, "mm/K"), "3.00 ± 0.20 um/K"),
        (("noise_ratio", 1.41, 0.05, "1"), "1.410 ± 0.050"),
        (("poses", "3 4", None, ""), "3 4"),
        (("from_pose", 23, None, "1"), "23"),
        (("driver", None, None, ""), ""),
        (("kappa_1", 0.0123, float("nan"), "1"), "12.3 um/mm"),
    ],
)
def test_sizes_are_reported_in_units_of_a_laboratory(expected, words):
    assert size_text(*expected) == words


def test_detectable_sizes_have_two_digits():
    assert plain_size("backlash_3", 0.0012345, "mm") == "1.2 um"
    many = " ".join(f"T{target}_{axis}" for target in range(9) for axis in "xyz")
    assert detectable_words(many, 2e-3, "mm") == "T0_x T0_y T0_z T1_x T1_y T1_z and 21 more of 2.0 um"
    assert detectable_words("gain_3", None, "1") == detectable_words("gain_3", float("nan"), "1") == ""


def test_the_leg_of_a_parameter_is_no_part_of_its_kind():
    assert [stem(name) for name in ("K16", "K1_10", "kappa_12", "dx", "alpha_base", "leg3_degree2")] == [
        "K",
        "K",
        "kappa",
        "dx",
        "alpha_base",
        "leg3_degree2",
    ]


def test_a_floor_that_holds_scatter_found_here_is_not_called_noise_alone():
    text = explanation(replace(FACTS, floor_has_scatter=True))
    assert "noise and the scatter found here give 4.78 um" in text
    assert "noise alone" not in text
