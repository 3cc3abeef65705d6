"""Numbers are rounded by GUM 7.2.6, and keep the digits that their uncertainty supports."""

from __future__ import annotations

import math
import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from truing.report.numbers import (
    LEAST_PRINTED_P,
    count_text,
    duration,
    in_suitable_unit,
    joined_names,
    p_at_most,
    p_equals,
    p_value,
    plain,
    printed,
    quantity,
    rough_quantity,
    two_decimals,
    with_uncertainty,
)

SIGMAS = st.floats(1e-12, 1e9)
VALUES = st.floats(-1e9, 1e9)
_SAID = re.compile(r"^\(?(-?[\d.]+) ± ([\d.]+)\)?(?:e([+-]\d+))?$")


def _read(said: str) -> tuple[float, float, str]:
    found = _SAID.match(said)
    assert found, said
    power = 10.0 ** int(found[3] or 0)
    return float(found[1]) * power, float(found[2]) * power, found[2]


@given(VALUES, SIGMAS)
def test_rounding_moves_neither_number_by_more_than_the_uncertainty_bears(value, sigma):
    # Places beyond the twelfth are never printed: value and sigma may then be 1e-12 of the larger one off.
    if sigma < 1e-10 * abs(value):
        return
    shown, uncertainty, _ = _read(with_uncertainty(value, sigma))
    rounding = 1e-12 * max(abs(value), sigma)
    assert abs(shown - value) <= 0.0504 * sigma + rounding  # half a digit of 1.0 is the coarsest
    assert abs(uncertainty - sigma) <= 0.0504 * sigma + rounding


@given(VALUES, SIGMAS)
def test_the_uncertainty_has_two_digits(value, sigma):
    if sigma < 1e-10 * max(abs(value), 1.0):
        return
    text = _read(with_uncertainty(value, sigma))[2]
    digits = text.replace(".", "").lstrip("0")
    assert len(digits) == 2 if "." in text else not digits[2:].strip("0")


@given(VALUES, SIGMAS)
def test_value_and_uncertainty_end_at_the_same_place(value, sigma):
    text = _SAID.match(with_uncertainty(value, sigma))
    assert text
    assert len(text[1].partition(".")[2]) == len(text[2].partition(".")[2])


@pytest.mark.parametrize(
    ("value", "sigma", "said"),
    [
        (13.24, 0.41, "13.24 ± 0.41 um"),
        (13.24, 0.14, "13.24 ± 0.14 um"),
        (13.24, 0.296, "13.24 ± 0.30 um"),
        (0.0163, 0.00048, "0.01630 ± 0.00048 um"),
        (13234.0, 437.0, "13230 ± 440 um"),
        (9.96, 0.99, "9.96 ± 0.99 um"),
        (9.96, 0.996, "10.0 ± 1.0 um"),
        (2.31e-6, 1.2e-8, "(2.310 ± 0.012)e-06 um"),
        (5.0, None, "5 um"),
        (5.0, 0.0, "5 um"),
        (5.0, math.nan, "5 um"),
    ],
)
def test_known_numbers(value, sigma, said):
    shown = with_uncertainty(value, sigma, "um")
    assert shown == said


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_three_digits_stay_right(value):
    assert math.isclose(float(plain(value)), value, rel_tol=5.01e-3, abs_tol=0.0)


def test_a_missing_number_is_shown_as_a_dash():
    assert plain(None) == plain(math.nan) == plain(math.inf) == p_value(None) == "–"


@given(st.floats(min_value=0.0, max_value=1.0))
def test_every_form_of_a_probability_has_the_same_least_value(p: float) -> None:
    least = p < LEAST_PRINTED_P
    assert (p_value(p) == p_value(0.0)) == (p_at_most(p) == p_at_most(0.0)) == (p_equals(p) == p_equals(0.0)) == least


@pytest.mark.parametrize(
    ("value", "unit", "said"),
    [
        (0.0034, "mm", "3.40 µm"),
        (-0.0034, "mm", "-3.40 µm"),
        (0.0, "mm", "0 mm"),
        (math.nan, "mm", "–"),
        (3.959, "mm", "3.96 mm"),
        (18632.0, "um", "18.6 mm"),
        (18.0, "1", "18"),
        (58.6, "urad", "58.6 µrad"),
    ],
)
def test_quantities_come_in_a_unit_that_suits_them(value, unit, said):
    assert quantity(value, unit) == said


def test_units_in_sentences_are_printed_and_words_left_alone():
    assert printed("4.77 um rms, 3 urad, vacuum, um.") == "4.77 µm rms, 3 µrad, vacuum, µm."


def test_counts_and_times():
    assert [count_text(1, "pose"), count_text(2, "pose"), count_text(1, "body"), count_text(8, "body")] == [
        "1 pose",
        "2 poses",
        "1 body",
        "8 bodies",
    ]
    assert [duration(30.0), duration(1800.0), duration(11160.0), duration(864000.0)] == [
        "30 s",
        "30.0 min",
        "3.1 h",
        "10.0 days",
    ]


def test_thousands_of_micrometres_are_reported_in_millimetres_with_their_uncertainty():
    assert in_suitable_unit(5331.0, 1602.0, "um") == "5.3 ± 1.6 mm"
    assert in_suitable_unit(-118.0, 250.0, "um") == "-120 ± 250 um"
    assert in_suitable_unit(-14.73, 9.31, "arcsec") == "-14.7 ± 9.3 arcsec"
    assert in_suitable_unit(-11402.0, None, "um") == "-11.4 mm"


def test_an_enumeration_has_one_and_before_its_last_name():
    assert [joined_names(["a", "b", "c"][:n]) for n in range(4)] == ["", "a", "a and b", "a, b and c"]


def test_two_decimals_are_three_digits_where_they_would_show_nothing():
    assert [two_decimals(x) for x in (13.349, 0.0299, 0.0)] == ["13.35", "0.0299", "0"]


@pytest.mark.parametrize(
    ("value", "unit", "text"),
    [
        (87_947.0, "um", "88 mm"),
        (9_870.0, "um", "9,870 µm"),
        (16.04, "um", "16 µm"),
        (12_000.0, "arcsec", "12,000 arcsec"),
    ],
)
def test_a_number_with_too_many_digits_has_a_larger_unit_of_the_same_size(value, unit, text):
    assert rough_quantity(value, unit) == text
