"""Types of campaign.toml: closed tables, bounded numbers, names and sentences.

A value keeps its TOML type: ``true`` is not 1, and ``"0.005"`` is not a number.
"""

from __future__ import annotations

import math
import unicodedata
from datetime import date, datetime
from typing import Annotated

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, model_validator

from truing.schemas.column import LARGEST, SMALLEST


def _check_size(value: float) -> float:
    if 0.0 < abs(value) < SMALLEST:
        raise ValueError(f"at least {SMALLEST:g}; smaller quantities are not plausible")
    return value


Positive = Annotated[float, Field(gt=0.0, le=LARGEST, allow_inf_nan=False), AfterValidator(_check_size)]
NotNegative = Annotated[float, Field(ge=0.0, le=LARGEST, allow_inf_nan=False), AfterValidator(_check_size)]
# A relative standard deviation, or an angle in rad: 0, or large enough to weight numbers by.
Share = Annotated[float, Field(ge=0.0, lt=1.0, allow_inf_nan=False), AfterValidator(_check_size)]
Finite = Annotated[float, Field(ge=-LARGEST, le=LARGEST, allow_inf_nan=False)]
# From absolute zero to the melting point of tungsten.
Temperature = Annotated[float, Field(ge=-273.15, le=3500.0, allow_inf_nan=False)]
Vector = tuple[Finite, Finite, Finite]
# Relative rounding of numbers that a person types.
TYPED = 1e-3
LONGEST_NAME = 200  # characters; it becomes part of file names, tables and pages
LONGEST_TEXT = 2000

# Characters that change the writing direction of a line.
_REVERSING = {*"\u202a\u202b\u202c\u202d\u202e\u2066\u2067\u2068\u2069"}
_OF_LINES = "\t\n\r"


def _check_characters(text: str, allowed: str = "") -> str:
    for mark in text:
        if mark not in allowed and (unicodedata.category(mark) in ("Cc", "Zl", "Zp") or mark in _REVERSING):
            raise ValueError(f"text without control characters; it contains U+{ord(mark):04X}")
    return text


def _check_not_blank(text: str) -> str:
    if not text.strip():
        raise ValueError("text that is not blank")
    return text


def check_raw_text(text: str) -> str:
    """Return text that may contain line ends and tabs; raises ValueError for other control characters, or if it is
    too long."""
    return _check_characters(_check_length(text, LONGEST_TEXT), _OF_LINES)


def _check_length(text: str, longest: int) -> str:
    if len(text) > longest:
        raise ValueError(f"at most {longest} characters, not {len(text)}")
    return text


def check_path(text: str) -> str:
    """Return a path or glob; raises ValueError if it is empty or has control characters."""
    return _check_characters(_check_not_blank(text))


def _one_or_several(value: object) -> object:
    of_numbers = all(_is_number(item) for item in (value if isinstance(value, tuple) else (value,)))
    if value == () or not of_numbers:
        raise ValueError("one number above 0, or a list of such numbers")
    return value


def _is_number(value: object) -> bool:
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    return math.isfinite(value) and 0.0 < value <= LARGEST


def _check_identifier(value: object) -> object:
    """Accept an integer or a name with one message, where pydantic would report both members of the union."""
    if isinstance(value, bool) or not isinstance(value, int | str):
        raise ValueError("a whole number, or a name in quotation marks")
    if isinstance(value, int) and abs(value) >= 1 << 63:
        raise ValueError("a whole number below 2^63, or a name in quotation marks")
    return value if isinstance(value, int) else _check_name(value)


def _check_name(text: str) -> str:
    return _check_characters(_check_not_blank(_check_length(text, LONGEST_NAME)))


def _check_date(value: object) -> object:
    if isinstance(value, str):
        try:
            return date.fromisoformat(value)
        except ValueError:
            value = None
    if isinstance(value, datetime) or not isinstance(value, date):
        raise ValueError("a date, such as 2026-11-22")
    return value


Name = Annotated[str, AfterValidator(_check_name)]
# Text on one line; a pattern may restrict it further.
Shown = Annotated[str, AfterValidator(_check_characters)]
Identifier = Annotated[int | str, BeforeValidator(_check_identifier)]
# One or more sentences.
Words = Annotated[str, AfterValidator(_check_not_blank), AfterValidator(check_raw_text)]
# Text of raw files, where also a column name may contain a line end.
RawText = Annotated[str, AfterValidator(check_raw_text)]
Path = Annotated[str, AfterValidator(check_path)]
Whole = Annotated[int, Field(gt=-(2**53), lt=2**53)]
OneOrSeveral = Annotated[Positive | tuple[Positive, ...], BeforeValidator(_one_or_several)]
Day = Annotated[date, BeforeValidator(_check_date)]


class Section(BaseModel):
    """A table of campaign.toml: immutable, without unknown keys, with strict types."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)

    @model_validator(mode="before")
    @classmethod
    def _lists_are_tuples(cls, given: object) -> object:
        return {key: _frozen(value) for key, value in given.items()} if isinstance(given, dict) else given


def _frozen(value: object) -> object:
    """Convert lists to tuples, recursively, for a strict model."""
    if isinstance(value, list | tuple):
        return tuple(_frozen(item) for item in value)
    return {key: _frozen(item) for key, item in value.items()} if isinstance(value, dict) else value
