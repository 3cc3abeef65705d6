"""Regular expressions, templates and formats of times in campaign.toml: what can be carried out, and ends."""

from __future__ import annotations

import re
import string
import warnings
from datetime import datetime
from typing import Annotated

from pydantic import AfterValidator

from truing.schemas.section import RawText

LONGEST_PATTERN = 20_000
_FILLED = re.compile(r"(.?[<>^])?\d{0,2}")  # what may follow a name's colon: the column is filled up


def _compiles(pattern: str) -> str:
    if len(pattern) > LONGEST_PATTERN:
        raise ValueError(f"a regular expression of at most {LONGEST_PATTERN} characters")
    import regex  # not where every command would wait for it

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of what later versions of Python may read in another way
            re.compile(pattern)
            re.compile(pattern.encode())
            regex.compile(pattern)
    except (re.error, regex.error, OverflowError) as error:
        raise ValueError(f"not a regular expression: {error}") from None
    except RecursionError:
        raise ValueError("a regular expression with fewer brackets within brackets") from None
    return pattern


def _has_groups(pattern: str) -> str:
    if not re.compile(_compiles(pattern)).groupindex:
        raise ValueError("a regular expression with named groups, such as (?P<target>\\d+)")
    return pattern


def _is_template(template: str) -> str:
    parts = [part for part in string.Formatter().parse(template) if part[1] is not None]
    if not parts or any(name == "" for _, name, _, _ in parts):
        raise ValueError('a template with the names of columns in braces, such as "{set}-{ID}"')
    if any(conversion is not None or not _FILLED.fullmatch(form or "") for _, _, form, conversion in parts):
        raise ValueError("a template that fills a column up at most, to no more than 99 characters, as {ID:0>3} does")
    return template


def _is_template_of_names(template: str) -> str:
    parts = [part for part in string.Formatter().parse(_is_template(template)) if part[1] is not None]
    names = [name or "" for _, name, _, _ in parts]
    if len(set(names)) < len(names) or not all(name.isidentifier() for name in names):
        raise ValueError('a template in which every name stands once and is a word: "{target}_{axis}"')
    if any(form for _, _, form, _ in parts):
        raise ValueError("a template of names without a colon")
    return template


def _is_time_format(form: str) -> str:
    try:
        datetime.strptime("", form)
    except ValueError as error:
        if "does not match" not in str(error):
            raise ValueError(f"a format of strptime, such as %Y-%m-%d %H:%M:%S: {error}") from None
    except (re.error, IndexError, OverflowError, RecursionError):
        raise ValueError("a format of strptime that holds each of its directives once") from None
    return form


def _refer_to_groups(names: dict[str, str]) -> dict[str, str]:
    for pattern, name in names.items():
        try:
            re.compile(pattern).sub(name, "")
        except (re.error, IndexError) as error:
            raise ValueError(f"a new name that refers to groups of its own expression alone: {error}") from None
    return names


Pattern = Annotated[RawText, AfterValidator(_compiles)]
GroupPattern = Annotated[RawText, AfterValidator(_has_groups)]
Template = Annotated[RawText, AfterValidator(_is_template)]
TemplateOfNames = Annotated[RawText, AfterValidator(_is_template_of_names)]
TimeFormat = Annotated[RawText, AfterValidator(_is_time_format)]
Renames = Annotated[dict[Pattern, RawText], AfterValidator(_refer_to_groups)]
