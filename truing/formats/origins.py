"""Where a table's column comes from: a column of the file, a constant, a count of rows, a part or a join of others."""

from __future__ import annotations

import string
from collections.abc import Sequence
from dataclasses import dataclass

from truing.formats.patterns import BoundedPattern
from truing.formats.row_groups import RowNumber


@dataclass(frozen=True)
class Constant:
    """The same value in every row."""

    value: str | int | float


@dataclass(frozen=True)
class RawColumn:
    """A column of the file, by position."""

    position: int


@dataclass(frozen=True)
class Group:
    """A named group of a regular expression that another column's whole value matches."""

    column: str
    pattern: BoundedPattern[str]
    name: str


@dataclass(frozen=True)
class Joined:
    """A template of other columns."""

    template: str
    columns: tuple[str, ...]


@dataclass(frozen=True)
class Spread:
    """A column that turning wide rows long makes: target (and other names of the template), or a coordinate."""

    name: str


Origin = Constant | RawColumn | Group | RowNumber | Joined | Spread


def made_of(origin: Origin | None) -> tuple[str, ...]:
    if isinstance(origin, Group):
        return (origin.column,)
    return origin.columns if isinstance(origin, Joined) else ()


def template_fields(template: str) -> tuple[str, ...]:
    """The names in a template's braces."""
    return tuple(name for _, name, _, _ in string.Formatter().parse(template) if name)


def joined_by(template: str, values: Sequence[str]) -> str:
    """A template with values, in the order of its names: text is put in, and nothing of a name is looked up."""
    left = iter(values)
    parts = string.Formatter().parse(template)
    return "".join(text if name is None else f"{text}{next(left):{form}}" for text, name, form, _ in parts)
