"""Notations of numbers: each reads back what it wrote, and refuses other notations."""

from __future__ import annotations

import pyarrow as pa
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.tolerance import assert_close
from truing.formats.numbers import Notation, is_plain_number
from truing.formats.units import UnknownUnit, conversion

NOTATIONS = [(".", None), (",", None), (".", ","), (",", "."), (".", "'"), (",", " "), (".", " ")]
BLANKS = {" ": [" ", "\u00a0", "\u202f"], "'": ["'", "’"]}


def spelt(value: float, decimal: str, mark: str) -> str:
    return f"{value:,.4f}".translate(str.maketrans({",": mark, ".": decimal}))


@given(
    st.sampled_from(NOTATIONS),
    st.lists(st.floats(-1e9, 1e9).map(lambda v: round(v, 4)), min_size=1, max_size=20),
    st.integers(0, 2),
)
def test_a_notation_reads_what_it_writes(notation, values, variant):
    decimal, thousands = notation
    marks = BLANKS.get(thousands, [thousands or ""])
    texts = [spelt(value, decimal, marks[variant % len(marks)]) for value in values]
    read, bad = Notation(decimal, thousands).parse(pa.array(texts))
    assert not bad.any()
    assert_close(read.to_pylist(), values, atol=0.0)


@pytest.mark.parametrize("text", ["1,23", "12,34.5", "1,2345", "1 234", "abc", "1.2.3", "--1", "1e", "0x10", "1_000"])
def test_thousands_separators_off_groups_of_three_make_no_number(text):
    _, bad = Notation(".", ",").parse(pa.array([text]))
    assert bad.all()


@pytest.mark.parametrize(
    ("text", "value"),
    [("+3", 3.0), (" 2.5 ", 2.5), ("1.5D+03", 1500.0), ("−4", -4.0), (".5", 0.5), ("5.", 5.0), ("1E-3", 1e-3)],
)
def test_spellings_of_other_programs(text, value):
    read, bad = Notation().parse(pa.array([text]))
    assert not bad.any()
    assert read.to_pylist() == [value]


@pytest.mark.parametrize(
    ("text", "advice"),
    [
        ("1,5", 'a number; to read this one set decimal = ","'),
        ("1.234,5", 'a number; to read this one set decimal = "," and thousands = "."'),
        ("1,234.5", 'a number; to read this one set thousands = ","'),
        ("1’234.5", 'a number; to read this one set thousands = "\'"'),
        ("out of range", "a number"),
    ],
)
def test_advice_names_the_setting_that_reads_it(text, advice):
    said = Notation().advice(text)
    assert said == advice


def test_a_missing_value_is_neither_number_nor_fault():
    notation = Notation(missing=frozenset({"n/a", "-9999", "0 0 0"}))
    read, bad = notation.parse(pa.array(["n/a", "-9999", "", None, "1"]))
    assert read.to_pylist() == [None, None, None, None, 1.0]
    assert not bad.any()
    assert notation.missing_numbers == (-9999.0,)
    assert notation.missing_triples == ((0.0, 0.0, 0.0),)


def test_infinity_is_read_and_left_to_the_check():
    read, bad = Notation().parse(pa.array(["inf", "-Infinity", "NaN"]))
    assert not bad.any()
    assert read.to_pylist()[0] == float("inf")
    assert not is_plain_number("inf")


@pytest.mark.parametrize(
    ("unit", "wanted", "value", "expected"),
    [
        ("in", "mm", 1.0, 25.4),
        ("m", "mm", 0.5, 500.0),
        ("µm", "mm", 5.0, 0.005),
        ("deg", "rad", 180.0, 3.141592653589793),
        ("arcsec", "deg", 3600.0, 1.0),
        ("kip", "N", 1.0, 4448.2216152605),
        ("kip in", "N m", 1.0, 112.98482902761671),
        ("degF", "degC", 212.0, 100.0),
        ("K", "degC", 293.15, 20.0),
        ("h", "s", 2.0, 7200.0),
    ],
)
def test_units(unit, wanted, value, expected):
    factor, offset = conversion(unit, wanted)
    assert_close(factor * value + offset, expected, atol=1e-12 * max(abs(expected), 300.0))


@given(st.sampled_from(["m", "cm", "mm", "um", "in", "ft", "mil"]), st.sampled_from(["m", "mm", "um", "in"]))
def test_there_and_back_is_nothing(unit, wanted):
    there, back = conversion(unit, wanted), conversion(wanted, unit)
    assert_close(there[0] * back[0], 1.0, atol=1e-12)


def test_an_unknown_unit_is_suggested_and_a_wrong_one_refused():
    with pytest.raises(UnknownUnit, match="did you mean mm"):
        conversion("mmm", "mm")
    with pytest.raises(UnknownUnit, match="a unit of length"):
        conversion("deg", "mm")


def test_a_unit_may_be_so_many_of_another():
    assert_close(conversion("0.618 nm", "um"), (0.618e-3, 0.0), atol=1e-18)
    assert_close(conversion("9.80665 N mm", "N m"), (9.80665e-3, 0.0), atol=1e-15)
    for unit in ("0 nm", "2 degC", "nm 2", "1e999 nm", "-1 nm"):
        with pytest.raises(UnknownUnit):
            conversion(unit, "degC" if "deg" in unit else "um")
