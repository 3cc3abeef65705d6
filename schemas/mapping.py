"""[files.<table>]: how a laboratory's own export becomes one of the contract's tables, untouched."""

from __future__ import annotations

import codecs
import math
import re
import string
import warnings
from datetime import datetime
from importlib.metadata import entry_points
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Discriminator, Field, Tag, model_validator

from truing.schemas.section import Finite, Name, Positive, RawText, Section, Whole, is_path, is_raw_text

LONGEST_PATTERN = 20_000
_FILLED = re.compile(r"(.?[<>^])?\d{0,2}")  # what may follow a name's colon: the column is filled up

FORMATS = (
    *("auto", "delimited", "parquet", "ply", "pcd", "xyz", "c3d", "trc", "rtl"),
    *("vstars", "aicon", "metashape", "colmap", "photomodeler", "tracker", "gsi", "xlsx", "mat"),
)
FORMAT_ENTRY_POINTS = "truing.formats"  # group of installed packages

# What tells the forms of a key apart, where it takes several; no key is called so.
OF_NAME, OF_TABLE = "<name>", "<table>"
Channel = Literal["dx", "dy", "dz", "rx", "ry", "rz"]

_NOT_OF_FILES = ("idna", "punycode", "unicode-escape", "raw-unicode-escape", "undefined")


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


def _is_format(name: str) -> str:
    """Own formats first: asking what is installed takes time."""
    if name not in FORMATS:
        added = sorted(entry_points(group=FORMAT_ENTRY_POINTS).names)
        if name not in added:
            raise ValueError(f"one of {', '.join((*FORMATS, *added))}")
    return name


def _is_raw_column(value: Any) -> Any:
    if isinstance(value, bool) or not isinstance(value, str | int):
        raise ValueError("the raw column's name in quotation marks, or its position from 1")
    return value if isinstance(value, int) else is_raw_text(value)


RawColumn = Annotated[str | int, BeforeValidator(_is_raw_column)]


class RawValue(Section):
    """One raw column and what its numbers stand for: ``value = raw * scale + offset``, then wrapped, then divided by
    ``coverage``; all in ``unit``, from which the value is brought into that of the table's column."""

    name: RawColumn | None = Field(None, description="raw name, or position from 1; absent: the column's own name")
    unit: RawText | None = Field(None, description="unit that the value is in")
    scale: Finite = Field(1.0, description="factor of the raw number; -1 turns the direction round")
    offset: Finite = Field(0.0, description="added to the scaled number, in `unit`")
    modulo: Positive | None = Field(None, description="period that the value is wrapped into, in `unit`")
    lowest: Finite | None = Field(None, description="least value after wrapping, in `unit`; absent: 0")
    coverage: Positive | None = Field(
        None, description="coverage factor k of an expanded uncertainty U = k sigma, which is divided by it"
    )

    @model_validator(mode="after")
    def _makes_sense(self) -> RawValue:
        if self.scale == 0.0:
            raise ValueError("a scale other than 0, which would make all values alike")
        if self.lowest is not None and self.modulo is None:
            raise ValueError("lowest together with modulo, the period")
        return self

    @property
    def is_plain(self) -> bool:
        """Whether numbers are taken as they are, their unit apart."""
        return (self.scale, self.offset, self.modulo, self.coverage) == (1.0, 0.0, None, None)


def _is_encoding(name: str) -> str:
    try:
        known = codecs.lookup(name)
        b"1".decode(name, errors="replace")  # raises LookupError where bytes become bytes, such as zlib
    except (LookupError, ValueError):  # UnicodeError: "undefined"; ValueError: a null character in the name
        known = None
    if known is None or known.name in _NOT_OF_FILES:
        raise ValueError("a known encoding, such as utf-8, utf-16, cp1252 or latin-1")
    return name


def _is_separator(text: str) -> str:
    if text not in ("whitespace", "blank", "tab") and not _is_mark(text):
        raise ValueError('one ASCII character, or "whitespace"')
    return text


def _is_quote(text: str) -> str:
    if text and not _is_mark(text):
        raise ValueError("one ASCII character, or empty where a quotation mark is a mark like any other")
    return text


def _is_mark(text: str) -> bool:
    return len(text) == 1 and text.isascii() and text not in "\r\n\0"


def _is_sheet(value: Any) -> Any:
    if isinstance(value, bool) or not isinstance(value, str | int):
        raise ValueError("the sheet's name in quotation marks, or its number from 1")
    return value if isinstance(value, int) else is_raw_text(value)


def _are_variables(value: Any) -> Any:
    several = value if isinstance(value, tuple) else (value,)
    if not several or not all(isinstance(one, str) and one for one in several):
        raise ValueError("a variable's name in quotation marks, or a list of these")
    for one in several:
        is_raw_text(one)
    return value


def _is_path(value: Any) -> Any:
    several = value if isinstance(value, tuple) else (value,)
    if not several or not all(isinstance(one, str) for one in several):
        raise ValueError("a file or glob in quotation marks, or a list of these")
    for one in several:
        is_path(one)
    return value


def _is_constant(value: Any) -> Any:
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    if not (isinstance(value, str) or (is_number and math.isfinite(value))):
        raise ValueError("text in quotation marks, or a finite number")
    return is_raw_text(value) if isinstance(value, str) else value


def is_uncertainty(name: str) -> bool:
    """Whether a column holds standard deviations."""
    return name == "sigma" or name.startswith("sigma_")


def _kind(source: object) -> str:
    return OF_TABLE if isinstance(source, dict | RawValue) else OF_NAME


Sheet = Annotated[str | int, BeforeValidator(_is_sheet)]
Variables = Annotated[str | tuple[str, ...], BeforeValidator(_are_variables)]
Paths = Annotated[str | tuple[str, ...], BeforeValidator(_is_path)]
Constant = Annotated[str | int | float, BeforeValidator(_is_constant)]
Source = Annotated[Annotated[RawColumn, Tag(OF_NAME)] | Annotated[RawValue, Tag(OF_TABLE)], Discriminator(_kind)]


class FileMapping(Section):
    """One [files.<table>] entry (or one of several): which raw files, in which format, which column is what.

    A column of the table is what ``constants``, ``from_name``, ``split``, ``number_rows`` or ``join`` says it
    is, else the raw column that ``columns`` names, else the raw column of the same name. Then ``rename`` and
    ``offset`` apply.
    """

    path: Paths = Field(description="file or glob, relative to campaign.toml")
    format: Annotated[RawText, AfterValidator(_is_format)] = Field(
        "auto",
        description=f"one of {', '.join(FORMATS)}, or an installed package's own; auto goes by the file's name",
    )
    separator: Annotated[RawText, AfterValidator(_is_separator)] | None = Field(
        None, description='one character, or "whitespace"; absent: found out'
    )
    header: bool | None = Field(None, description="whether the first line names the columns")
    names: tuple[RawText, ...] = Field((), description="names for the columns of a file without header")
    decimal: Literal[".", ","] = Field(".", description="the decimal mark")
    thousands: Literal[",", ".", "'", " "] | None = Field(None, description="a blank: any kind of blank")
    encoding: Annotated[RawText, AfterValidator(_is_encoding)] = Field("utf-8", description="of the files")
    quote: Annotated[RawText, AfterValidator(_is_quote)] = Field(
        '"', description="empty where a quotation mark is a mark like any other"
    )
    comment: RawText | None = Field(None, description="lines that begin with it are passed over")
    skip_lines: int = Field(0, ge=0, description="lines at the top to pass over")
    keep_lines: Pattern | None = Field(None, description="expression of the lines to read")
    columns: dict[Name, Source] = Field(
        default_factory=dict,
        description="column = raw name, or position from 1, or a table with its name and what its numbers stand for",
    )
    units: dict[Name, RawText] = Field(default_factory=dict, description="column = unit it is given in")
    unit: RawText | None = Field(None, description="unit of all coordinates")
    constants: dict[Name, Constant] = Field(default_factory=dict, description="column = its value")
    missing: tuple[RawText, ...] = Field(
        (), description='values that mean missing; "0 0 0" means all three coordinates'
    )
    from_name: GroupPattern | None = Field(
        None,
        description="regular expression on the file's name (on its path, where it holds a slash); "
        "named groups become columns",
    )
    split: dict[Name, GroupPattern] = Field(
        default_factory=dict,
        description="column = regular expression for its whole value; named groups become columns",
    )
    number_rows: dict[Name, Whole] = Field(default_factory=dict, description="column = number of a file's first row")
    join: dict[Name, Template] = Field(default_factory=dict, description='column = template, such as "{set}-{ID}"')
    rename: dict[Name, Renames] = Field(
        default_factory=dict, description="column = expressions for whole values, and what they become"
    )
    offset: dict[Name, Whole] = Field(default_factory=dict, description="column = whole number to add")
    coverage: Positive | None = Field(
        None, description="coverage factor k of all uncertainties: sigma_... columns hold U = k sigma; absent: 1"
    )
    rows_per_pose: int | None = Field(
        None,
        ge=2,
        description="so many rows of the file make a pose: of `points` they share its number; of tables with one row "
        "per pose (poses, configurations) they stand side by side, columns by position from 1 on",
    )
    rows_per_group: dict[Name, Annotated[Whole, Field(ge=1)]] = Field(
        default_factory=dict,
        description="column = so many rows share its number; other columns of number_rows count anew in each group",
    )
    sheet: Sheet | None = Field(
        None, description="xlsx: name of the sheet, or its number from 1; absent: the only visible one"
    )
    variable: Variables | None = Field(
        None, description="mat: variable, or several side by side; fields of structs as a.b"
    )
    transpose: bool = Field(False, description="mat: rows of the file are columns of the table")
    select: dict[Name, Pattern] = Field(
        default_factory=dict, description="column = expression for the whole value of the rows to read"
    )
    ignore: Pattern | None = Field(
        None, description="expression for the whole names of raw columns not to carry along as covariates"
    )
    channels: dict[Channel, RawColumn] = Field(
        default_factory=dict, description="interferometer: channel = raw column of its readings; a row per channel"
    )
    wide: TemplateOfNames | None = Field(
        None, description='template of the raw names of coordinates, "{target}_{axis}": a row per target'
    )
    arrays: dict[RawText, tuple[Name, ...]] = Field(
        default_factory=dict, description="raw column whose cells hold several numbers = names for these"
    )
    time_format: TimeFormat | None = Field(None, description="strptime format of time_s, counted from the earliest")

    @model_validator(mode="after")
    def _wide_names_targets(self) -> FileMapping:
        if self.wide is not None and ("{axis}" not in self.wide or self.wide.count("{") < 2):
            raise ValueError('wide needs {axis} and the name of a column, such as "{target}_{axis}"')
        return self

    @model_validator(mode="after")
    def _said_once(self) -> FileMapping:
        for name, source in self.columns.items():
            if isinstance(source, RawValue) and source.coverage is not None and not is_uncertainty(name):
                raise ValueError(f"coverage for sigma_... columns alone: {name} is no uncertainty")
            if isinstance(source, RawValue) and source.unit is not None and name in self.units:
                raise ValueError(f"the unit of {name} once: in columns, or in units")
        if self.rows_per_pose is not None and "pose" in self.rows_per_group:
            raise ValueError("rows_per_pose, or pose in rows_per_group, not both")
        return self

    @model_validator(mode="after")
    def _marks_differ(self) -> FileMapping:
        if self.separator is not None and self.separator == self.quote:
            raise ValueError("a separator other than quote")
        return self

    def reference(self, name: str) -> str | int:
        """The raw name or position that a column is read from; its own name where nothing else is said."""
        source = self.columns.get(name, name)
        if isinstance(source, RawValue):
            return name if source.name is None else source.name
        return source

    def value(self, name: str) -> RawValue:
        """What the numbers of a column stand for."""
        source = self.columns.get(name)
        given = source if isinstance(source, RawValue) else RawValue()
        if self.coverage is not None and given.coverage is None and is_uncertainty(name):
            return given.model_copy(update={"coverage": self.coverage})
        return given

    @property
    def paths(self) -> tuple[str, ...]:
        """The files or globs as a tuple, also where there is one."""
        return (self.path,) if isinstance(self.path, str) else self.path

    @property
    def by_channel(self) -> tuple[FileMapping, ...]:
        """An entry for each of ``channels``, which reads its column alone; the entry itself where there are none."""
        if not self.channels:
            return (self,)
        others = [re.escape(str(column)) for column in self.channels.values()]
        changes: dict[str, object] = {
            "channels": {},
            "ignore": "|".join([*([self.ignore] if self.ignore else []), *others]),
        }
        return tuple(
            self.model_copy(
                update={
                    **changes,
                    "columns": {**self.columns, "reading": column},
                    "constants": {**self.constants, "channel": channel},
                }
            )
            for channel, column in self.channels.items()
        )
