"""[files.<table>]: mapping of a laboratory's own export to one of the tables, without changes to the file."""

from __future__ import annotations

import codecs
import math
import re
import string
import warnings
from datetime import datetime
from typing import Annotated, Literal

from pydantic import AfterValidator, BeforeValidator, Discriminator, Field, Tag, model_validator

from truing.schemas.installed import entry_points
from truing.schemas.near_names import did_you_mean
from truing.schemas.section import Finite, Name, Positive, RawText, Section, Whole, check_path, check_raw_text

LONGEST_PATTERN = 20_000
_FILLED = re.compile(r"(.?[<>^])?\d{0,2}")  # allowed format after a name's colon: padding

FORMATS = (
    *("auto", "delimited", "parquet", "ply", "pcd", "xyz", "c3d", "trc", "rtl"),
    *("vstars", "aicon", "metashape", "colmap", "photomodeler", "tracker", "gsi", "inspection", "fanuc", "xlsx", "mat"),
)
FORMAT_ENTRY_POINTS = "truing.formats"  # group of installed packages

# Tags of the forms of a key that takes several forms; no key has such a name.
OF_NAME, OF_TABLE = "<name>", "<table>"
Channel = Literal["dx", "dy", "dz", "rx", "ry", "rz"]

_NOT_OF_FILES = ("idna", "punycode", "unicode-escape", "raw-unicode-escape", "undefined")


def _compiles(pattern: str) -> str:
    if len(pattern) > LONGEST_PATTERN:
        raise ValueError(f"a regular expression of at most {LONGEST_PATTERN} characters")
    import regex  # imported here, because it slows every command down

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # warnings about syntax of later Python versions
            re.compile(pattern)
            re.compile(pattern.encode())
            regex.compile(pattern)
    except (re.error, regex.error, OverflowError) as error:
        raise ValueError(f"not a regular expression: {error}") from None
    except RecursionError:
        raise ValueError("a regular expression with fewer brackets within brackets") from None
    return pattern


def _check_groups(pattern: str) -> str:
    if not re.compile(_compiles(pattern)).groupindex:
        raise ValueError("a regular expression with named groups, such as (?P<target>\\d+)")
    return pattern


def _check_template(template: str) -> str:
    parts = [part for part in string.Formatter().parse(template) if part[1] is not None]
    if not parts or any(name == "" for _, name, _, _ in parts):
        raise ValueError('a template with the names of columns in braces, such as "{set}-{ID}"')
    if any(conversion is not None or not _FILLED.fullmatch(form or "") for _, _, form, conversion in parts):
        raise ValueError("a template with padding as its only format, to at most 99 characters, such as {ID:0>3}")
    return template


def _check_template_of_names(template: str) -> str:
    parts = [part for part in string.Formatter().parse(_check_template(template)) if part[1] is not None]
    names = [name or "" for _, name, _, _ in parts]
    if len(set(names)) < len(names) or not all(name.isidentifier() for name in names):
        raise ValueError('a template with each name once, as a word: "{target}_{axis}"')
    if any(form for _, _, form, _ in parts):
        raise ValueError("a template of names without a colon")
    return template


def _check_time_format(form: str) -> str:
    try:
        datetime.strptime("", form)
    except ValueError as error:
        if "does not match" not in str(error):
            raise ValueError(f"a format of strptime, such as %Y-%m-%d %H:%M:%S: {error}") from None
    except (re.error, IndexError, OverflowError, RecursionError):
        raise ValueError("a format of strptime with each directive once") from None
    return form


def _refer_to_groups(names: dict[str, str]) -> dict[str, str]:
    for pattern, name in names.items():
        try:
            re.compile(pattern).sub(name, "")
        except (re.error, IndexError) as error:
            raise ValueError(f"a new name that refers only to groups of its own expression: {error}") from None
    return names


Pattern = Annotated[RawText, AfterValidator(_compiles)]
GroupPattern = Annotated[RawText, AfterValidator(_check_groups)]
Template = Annotated[RawText, AfterValidator(_check_template)]
TemplateOfNames = Annotated[RawText, AfterValidator(_check_template_of_names)]
TimeFormat = Annotated[RawText, AfterValidator(_check_time_format)]
Renames = Annotated[dict[Pattern, RawText], AfterValidator(_refer_to_groups)]


def _check_format(name: str) -> str:
    """Accept own formats first, because the query of installed packages is slow."""
    if name not in FORMATS:
        added = sorted(entry_points(group=FORMAT_ENTRY_POINTS).names)
        if name not in added:
            known = (*FORMATS, *added)
            raise ValueError(f"one of {', '.join(known)}{did_you_mean(name, known)}")
    return name


def _check_raw_column(value: object) -> object:
    if isinstance(value, bool) or not isinstance(value, str | int):
        raise ValueError("the raw column's name in quotation marks, or its position from 1")
    return value if isinstance(value, int) else check_raw_text(value)


RawColumn = Annotated[str | int, BeforeValidator(_check_raw_column)]


class RawValue(Section):
    """One raw column and the meaning of its numbers: ``value = (raw + plus - minus) * scale + offset``, wrapped and
    divided by ``coverage``, in ``unit``. The value is then converted to the unit of the table's column."""

    name: RawColumn | None = Field(None, description="raw name, or position from 1; absent: the column's own name")
    plus: RawColumn | None = Field(
        None, description="raw column whose number is added, as for a joint that counts from a fixed direction"
    )
    minus: RawColumn | None = Field(None, description="raw column whose number is subtracted")
    unit: RawText | None = Field(None, description="unit of the value")
    scale: Finite = Field(1.0, description="factor of the raw number; -1 inverts the direction")
    offset: Finite = Field(0.0, description="added to the scaled number, in `unit`")
    modulo: Positive | None = Field(None, description="period for wrapping the value, in `unit`")
    lowest: Finite | None = Field(None, description="lower end of the wrapped range, in `unit`; absent: 0")
    coverage: Positive | None = Field(
        None, description="coverage factor k of an expanded uncertainty U = k sigma; the value is divided by it"
    )

    @model_validator(mode="after")
    def _check_modulo(self) -> RawValue:
        if self.scale == 0.0:
            raise ValueError("a scale other than 0, because 0 makes all values equal")
        if self.lowest is not None and self.modulo is None:
            raise ValueError("lowest together with modulo, the period")
        return self

    @property
    def is_plain(self) -> bool:
        """True if numbers are used unchanged except for their unit."""
        return (self.scale, self.offset, self.modulo, self.coverage, self.others) == (1.0, 0.0, None, None, ())

    @property
    def others(self) -> tuple[tuple[RawColumn, float], ...]:
        """Raw columns whose numbers are added, with their signs."""
        signed = ((self.plus, 1.0), (self.minus, -1.0))
        return tuple((column, sign) for column, sign in signed if column is not None)


def _check_encoding(name: str) -> str:
    try:
        known = codecs.lookup(name)
        b"1".decode(name, errors="replace")  # raises LookupError where bytes become bytes, such as zlib
    except (LookupError, ValueError):  # UnicodeError: "undefined"; ValueError: a null character in the name
        known = None
    if known is None or known.name in _NOT_OF_FILES:
        raise ValueError("a known encoding, such as utf-8, utf-16, cp1252 or latin-1")
    return name


def _check_separator(text: str) -> str:
    if text not in ("whitespace", "blank", "tab") and not _is_mark(text):
        raise ValueError('one ASCII character, or "whitespace"')
    return text


def _check_quote(text: str) -> str:
    if text and not _is_mark(text):
        raise ValueError("one ASCII character, or empty if the file has no quoting")
    return text


def _is_mark(text: str) -> bool:
    return len(text) == 1 and text.isascii() and text not in "\r\n\0"


def _check_sheet(value: object) -> object:
    if isinstance(value, bool) or not isinstance(value, str | int):
        raise ValueError("the sheet's name in quotation marks, or its number from 1")
    return value if isinstance(value, int) else check_raw_text(value)


def _are_variables(value: object) -> object:
    several = value if isinstance(value, tuple) else (value,)
    if not several or not all(isinstance(one, str) and one for one in several):
        raise ValueError("a variable's name in quotation marks, or a list of these")
    for item in several:
        check_raw_text(item)
    return value


def _check_paths(value: object) -> object:
    several = value if isinstance(value, tuple) else (value,)
    if not several or not all(isinstance(one, str) for one in several):
        raise ValueError("a file or glob in quotation marks, or a list of these")
    for item in several:
        check_path(item)
    return value


def _check_constant(value: object) -> object:
    if isinstance(value, str):
        return check_raw_text(value)
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise ValueError("text in quotation marks, or a finite number")
    return value


def is_uncertainty(name: str) -> bool:
    """True if a column holds standard deviations."""
    return name == "sigma" or name.startswith("sigma_")


def _kind(source: object) -> str:
    return OF_TABLE if isinstance(source, dict | RawValue) else OF_NAME


Sheet = Annotated[str | int, BeforeValidator(_check_sheet)]
Variables = Annotated[str | tuple[str, ...], BeforeValidator(_are_variables)]
Paths = Annotated[str | tuple[str, ...], BeforeValidator(_check_paths)]
Constant = Annotated[str | int | float, BeforeValidator(_check_constant)]
Source = Annotated[Annotated[RawColumn, Tag(OF_NAME)] | Annotated[RawValue, Tag(OF_TABLE)], Discriminator(_kind)]


class FileMapping(Section):
    """One [files.<table>] entry (or one of several): raw files, format and columns.

    A column of the table comes from ``constants``, ``from_name``, ``split``, ``number_rows`` or ``join``. Else it comes
    from the raw column in ``columns``, else from the raw column of the same name. Then ``rename`` and ``offset`` apply.
    """

    path: Paths = Field(description="file or glob, relative to campaign.toml")
    format: Annotated[RawText, AfterValidator(_check_format)] = Field(
        "auto",
        description=f"one of {', '.join(FORMATS)}, or an installed package's own; auto goes by the file's name",
    )
    separator: Annotated[RawText, AfterValidator(_check_separator)] | None = Field(
        None, description='one character, or "whitespace"; absent: detected'
    )
    header: bool | None = Field(None, description="whether the first line holds the column names")
    names: tuple[RawText, ...] = Field((), description="names for the columns of a file without header")
    decimal: Literal[".", ","] = Field(".", description="decimal mark")
    thousands: Literal[",", ".", "'", " "] | None = Field(
        None, description="thousands separator; a blank: any kind of blank"
    )
    encoding: Annotated[RawText, AfterValidator(_check_encoding)] = Field("utf-8", description="encoding of the files")
    quote: Annotated[RawText, AfterValidator(_check_quote)] = Field(
        '"', description="quotation mark; empty if the file has no quoting"
    )
    comment: RawText | None = Field(None, description="lines that begin with this text are skipped")
    skip_lines: int = Field(0, ge=0, description="number of lines to skip at the top")
    keep_lines: Pattern | None = Field(None, description="regular expression for the lines to read")
    heads: GroupPattern | None = Field(
        None,
        description="regular expression for lines above blocks of rows, such as `EPOCH 3`: its named groups are "
        "columns of the rows below",
    )
    columns: dict[Name, Source] = Field(
        default_factory=dict,
        description="column = raw name, or position from 1, or a table with the name and the meaning of its numbers",
    )
    units: dict[Name, RawText] = Field(
        default_factory=dict, description="column = its unit in the file; dms: angles in degrees, minutes and seconds"
    )
    unit: RawText | None = Field(None, description="unit of all coordinates")
    constants: dict[Name, Constant] = Field(default_factory=dict, description="column = its value")
    missing: tuple[RawText, ...] = Field(
        (), description='values that mean missing; "0 0 0" means all three coordinates'
    )
    from_name: GroupPattern | None = Field(
        None,
        description="regular expression on the file's name (on its path, if the expression contains a slash); named "
        "groups become columns",
    )
    split: dict[Name, GroupPattern] = Field(
        default_factory=dict,
        description="column = regular expression for its whole value; named groups become columns",
    )
    number_rows: dict[Name, Whole] = Field(
        default_factory=dict, description="column = number of the first row of a file"
    )
    join: dict[Name, Template] = Field(default_factory=dict, description='column = template, such as "{set}-{ID}"')
    rename: dict[Name, Renames] = Field(
        default_factory=dict, description="column = regular expressions for whole values, and their replacements"
    )
    offset: dict[Name, Whole] = Field(default_factory=dict, description="column = whole number to add")
    coverage: Positive | None = Field(
        None, description="coverage factor k of all uncertainties: sigma_... columns hold U = k sigma; absent: 1"
    )
    rows_per_pose: int | None = Field(
        None,
        ge=2,
        description="number of rows of the file per pose: in `points`, they share a pose number; in tables with one "
        "row per pose (poses, configurations), they are joined side by side, with columns by position "
        "from 1",
    )
    rows_per_group: dict[Name, Annotated[Whole, Field(ge=1)]] = Field(
        default_factory=dict,
        description="column = number of rows that share its number; other columns of number_rows restart in each group",
    )
    sheet: Sheet | None = Field(
        None,
        description="xlsx: name of the sheet, its number from 1, or a glob of several, such as 'Pose *' (from_name "
        "then sees `book.xlsx, sheet Pose 1`); absent: the only visible one",
    )
    variable: Variables | None = Field(
        None, description="mat: name of the variable, or of several side by side; fields of structs as a.b"
    )
    transpose: bool = Field(False, description="mat: rows of the file are columns of the table")
    select: dict[Name, Pattern] = Field(
        default_factory=dict, description="column = regular expression for the whole value, for rows to read"
    )
    ignore: Pattern | None = Field(
        None, description="regular expression for whole names of raw columns that are not read as covariates"
    )
    channels: dict[Channel, RawColumn] = Field(
        default_factory=dict,
        description="interferometer: channel = raw column of its readings; gives one row per channel",
    )
    joined_by: Literal["rows", "step", "pose", "time"] | None = Field(
        None,
        description="loads, measured: how rows belong to those of signals or configurations: in the same order, by the "
        "same run and step, by the same pose, or by the nearest time of clocks that agree",
    )
    wide: TemplateOfNames | None = Field(
        None,
        description='template of the raw names of coordinates, "{target}_{axis}"; gives one row per target. With '
        'wide_values: of the names of other columns, such as "Run {cycle} {direction}"; gives one row per column',
    )
    wide_values: Name | None = Field(
        None,
        description="column of the table for the numbers of the columns that wide names, such as deviation_um",
    )
    arrays: dict[RawText, tuple[Name, ...]] = Field(
        default_factory=dict, description="raw column with several numbers per cell = names for these numbers"
    )
    time_format: TimeFormat | None = Field(None, description="strptime format of time_s; times count from the earliest")

    @model_validator(mode="after")
    def _wide_names_targets(self) -> FileMapping:
        if self.wide_values is not None:
            if self.wide is None or "{" not in self.wide or "{axis}" in self.wide:
                raise ValueError('wide_values needs wide without {axis}, such as wide = "Run {cycle} {direction}"')
        elif self.wide is not None and ("{axis}" not in self.wide or self.wide.count("{") < 2):
            raise ValueError('wide needs {axis} and the name of a column, such as "{target}_{axis}"')
        return self

    @model_validator(mode="after")
    def _check_single_entries(self) -> FileMapping:
        for name, source in self.columns.items():
            if isinstance(source, RawValue) and source.coverage is not None and not is_uncertainty(name):
                raise ValueError(f"coverage only for sigma_... columns; {name} is not an uncertainty")
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
        """Raw name or position of a column; its own name by default."""
        source = self.columns.get(name, name)
        if isinstance(source, RawValue):
            return name if source.name is None else source.name
        return source

    def value(self, name: str) -> RawValue:
        """Meaning of the numbers of a column."""
        source = self.columns.get(name)
        raw_value = source if isinstance(source, RawValue) else RawValue()
        if self.coverage is not None and raw_value.coverage is None and is_uncertainty(name):
            return raw_value.model_copy(update={"coverage": self.coverage})
        return raw_value

    @property
    def paths(self) -> tuple[str, ...]:
        """Files or globs as a tuple."""
        return (self.path,) if isinstance(self.path, str) else self.path

    @property
    def by_channel(self) -> tuple[FileMapping, ...]:
        """One entry for each of ``channels``, which reads only that column; the entry itself without channels."""
        if not self.channels:
            return (self,)
        patterns = [re.escape(str(column)) for column in self.channels.values()]
        changes: dict[str, object] = {
            "channels": {},
            "ignore": "|".join([*([self.ignore] if self.ignore else []), *patterns]),
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
