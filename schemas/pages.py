"""Generated reference pages: docs/artifacts.md and docs/reference/campaign-toml.md."""

from __future__ import annotations

import json
import re
import types
import typing
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from datetime import date
from functools import cache
from typing import Any, Literal

from annotated_types import Ge, Gt, Le, Lt
from pydantic import BaseModel
from pydantic.fields import FieldInfo

from truing.schemas.artifact import Artifact
from truing.schemas.artifacts import ARTIFACTS
from truing.schemas.campaign import Campaign
from truing.schemas.chain_mechanism import ChainMechanism
from truing.schemas.column import LARGEST, Column
from truing.schemas.columns import COLUMNS
from truing.schemas.mechanism import AxisMechanism, LeggedMechanism, SensorMechanism
from truing.schemas.section import Finite, NotNegative, Positive, Vector, Whole

_COVARIANCE = ("cov_0_0", "cov_5_5")
_TABLE_HEAD = "| column | kind | unit | allowed | meaning |\n| --- | --- | --- | --- | --- |"
_ARTIFACTS_HEAD = """# Which tables does a run write, and what is in their columns?

This page lists the tables that a run writes, with their columns. Tables are Parquet files. A column name has the same
meaning in every table. The metadata of each file hold schema and version (`truing.schema`, `truing.schema_version`),
units (`truing.units`), stage, digest of the inputs, software version and campaign. Every artifact is checked against
these definitions when it is written or read. Optional columns are present if the campaign has them. Columns marked
(key) identify a row.
`python -m schemas` writes this page.
"""
_OVERVIEW_HEAD = "| artifact | what it holds |\n| --- | --- |"
_COMMON_HEAD = """## Columns of several tables

"""
_COMMON = "[above](#columns-of-several-tables)"
# Number of tables from which on a column is explained once, above all tables.
_SEVERAL = 4

_OF_SENSOR, _OF_CHAIN = " of a force sensor", " of an open chain"
_CAMPAIGN_HEAD = """# What may campaign.toml hold, key by key?

This page lists the keys of `campaign.toml`. An unknown key is a fault; its message names the nearest known key. A key
without a default is optional unless it is `required`. `truing init --all FOLDER` writes all keys as comments.
`python -m schemas` writes this page.

| key | takes | unit | default | meaning |
| --- | --- | --- | --- | --- |
| `format` | `1` |  | `1` | version of this file's format |
"""
_UNITS = {
    "_mm": "mm",
    "_um": "µm",
    "_rad": "rad",
    "_deg": "degrees",
    "_arcsec": "arc seconds",
    "_n": "N",
    "_nm": "N m",
    "_n_per_m": "N/m",
    "_n_m_per_rad": "N m/rad",
    "_mv": "mV",
    "_mv_per_n": "mV/N",
    "_gpa": "GPa",
    "_hpa": "hPa",
    "_pct": "%",
    "_c": "°C",
    "_per_k": "1/K",
}
_NAMED = {"limits": "check", "columns": "column"}
_NANOMETRES = ("wavelength_nm",)
_NUMBERS = {
    Positive: "number above 0",
    NotNegative: "number from 0",
    Finite: "number",
    Vector: "three numbers",
    Whole: "whole number",
}
_WORDS = {str: "text", int: "whole number", float: "number", bool: "`true` or `false`", date: "date"}
_SIGNS = {Gt: ("gt", "above"), Ge: ("ge", "from"), Lt: ("lt", "below"), Le: ("le", "to")}


def artifacts_page() -> str:
    """The page of artifacts as Markdown."""
    overview = [_OVERVIEW_HEAD, *(_overview_row(artifact) for artifact in ARTIFACTS.values()), ""]
    common = [_TABLE_HEAD, *(_column_row(COLUMNS[name]) for name in _listed(_common_columns())), ""]
    tables = (_artifact(artifact) for artifact in ARTIFACTS.values() if artifact.is_table)
    return "\n".join([_ARTIFACTS_HEAD, *overview, _COMMON_HEAD + "\n".join(common), *tables])


@cache
def _common_columns() -> tuple[str, ...]:
    """Columns of several tables, in the order of their definition."""
    tables = Counter(
        name for artifact in ARTIFACTS.values() for name in (*artifact.columns, *artifact.optional, *artifact.families)
    )
    return tuple(name for name in COLUMNS if tables[name] >= _SEVERAL)


def _listed(names: Iterable[str]) -> list[str]:
    """Columns that have a row: the first entry of a covariance stands for all."""
    return [name for name in names if name == _COVARIANCE[0] or not re.match(r"cov_\d", name)]


def _overview_row(artifact: Artifact) -> str:
    """Row of an artifact: its file, with a link to the columns of a table, and what it holds."""
    anchor = re.sub(r"[^a-z0-9_ -]", "", f"{artifact.file}{_of(artifact)}".lower()).replace(" ", "-")
    file = f"[`{artifact.file}`](#{anchor})" if artifact.is_table else f"`{artifact.file}`"
    return f"| {file}{_of(artifact)} | {artifact.meaning} |"


def _of(artifact: Artifact) -> str:
    return "" if artifact.file.startswith(f"{artifact.name}.") else f" ({artifact.name})"


def _artifact(artifact: Artifact) -> str:
    return "\n".join([f"## `{artifact.file}`{_of(artifact)}", "", *_columns(artifact)])


def _columns(artifact: Artifact) -> Iterator[str]:
    yield _TABLE_HEAD
    kinds = ((artifact.columns, ""), (artifact.optional, "; optional"), (artifact.families, "; numbered"))
    for names, remark in kinds:
        shared = [_shown(COLUMNS[name], artifact.key) for name in _listed(names) if name in _common_columns()]
        if shared:
            yield f"| {', '.join(shared)} |  |  |  | {_COMMON}{remark} |"
    for names, remark in kinds:
        columns = (COLUMNS[name] for name in _listed(names) if name not in _common_columns())
        yield from (_column_row(column, remark, artifact.key) for column in columns)
    if artifact.covariates:
        yield "| any other | real |  |  | a covariate of the campaign |"
    yield ""


def _shown(column: Column, key: tuple[str, ...] = ()) -> str:
    """Name of a column, of a numbered family, or of all entries of a covariance; columns of the key are marked."""
    first, last = _COVARIANCE
    if column.name == first:
        return f"`{first}` .. `{last}`"
    return f"`{column.family or column.name}`{' (key)' if column.name in key else ''}"


def _column_row(column: Column, remark: str = "", key: tuple[str, ...] = ()) -> str:
    return f"| {_shown(column, key)} | {column.kind} | {column.unit} | {_allowed(column)} | {column.meaning}{remark} |"


def _allowed(column: Column) -> str:
    parts = []
    if column.choices:
        parts.append(" ".join(column.choices))
    if column.minimum is not None:
        parts.append(f"from {column.minimum:g}")
    if column.maximum is not None:
        parts.append(f"to {column.maximum:g}")
    if column.nullable:
        parts.append("may be empty")
    return ", ".join(parts)


@dataclass(frozen=True)
class Table:
    """A table of campaign.toml, or several with the same keys: their places, and the model that checks them."""

    places: tuple[str, ...]
    model: type[BaseModel]
    remark: str = ""


def campaign_page() -> str:
    """The page of campaign.toml as Markdown."""
    return "\n".join([_CAMPAIGN_HEAD, *(line for table in _top() for line in _written(table))]).rstrip() + "\n"


def _top() -> Iterator[Table]:
    """Tables of campaign.toml in the order of the model; [mechanism] once per family of types."""
    for table in _tables_of_model(Campaign, ""):
        if table.places == ("[mechanism]",):
            yield Table(table.places, LeggedMechanism, " of legs and actuators")
            yield Table(table.places, SensorMechanism, _OF_SENSOR)
            yield Table(table.places, ChainMechanism, _OF_CHAIN)
            yield Table(table.places, AxisMechanism, " of one axis")
        else:
            yield table


def _tables_of_model(model: type[BaseModel], heading: str, remark: str = "") -> Iterator[Table]:
    """Tables within a model, those with equal keys together."""
    tables_by_model: dict[type[BaseModel], list[str]] = {}
    for key, field in model.model_fields.items():
        if inner := _model(field.annotation):
            tables_by_model.setdefault(inner, []).append(_bracketed(f"{heading}{key}", field.annotation))
    return (Table(tuple(headings), inner, remark) for inner, headings in tables_by_model.items())


def _bracketed(heading: str, annotation: object) -> str:
    if typing.get_origin(annotation) is dict:
        return f"[{heading}.<{_NAMED.get(heading.rsplit('.', 1)[-1], 'table')}>]"
    return f"[[{heading}]]" if typing.get_origin(annotation) is tuple else f"[{heading}]"


def _written(table: Table, depth: int = 2) -> Iterator[str]:
    """Heading, description and keys of a table, then the tables within it."""
    yield f"{'#' * depth} {', '.join(f'`{title}`' for title in table.places)}{table.remark}\n"
    yield f"{_sentences(table.model)}\n"
    yield "| key | takes | unit | default | meaning |\n| --- | --- | --- | --- | --- |"
    yield from (_row(key, field) for key, field in table.model.model_fields.items())
    yield ""
    title = f"{table.places[0].strip('[]')}."
    for inner in _tables_of_model(table.model, title, table.remark if table.remark in (_OF_SENSOR, _OF_CHAIN) else ""):
        yield from _written(inner, depth + 1)


def _sentences(model: type[BaseModel]) -> str:
    """First paragraph of a docstring and the rest, without the table's name before the colon."""
    text = " ".join((model.__doc__ or "").split())
    text = re.sub(r"^(One )?\[[^:]*: ", "", text).replace("``", "`")
    return f"{text[0].upper()}{text[1:]}"


def _row(key: str, field: FieldInfo) -> str:
    takes = _allowed_values(field.annotation, field.metadata)
    return f"| `{key}` | {takes} | {_unit(key)} | {_default(field)} | {field.description or ''} |"


def _unit(key: str) -> str:
    if key in _NANOMETRES:
        return "nm"
    marks = [mark for mark in _UNITS if key.endswith(mark)]
    return _UNITS[max(marks, key=len)] if marks else ""


def _default(field: FieldInfo) -> str:
    if field.is_required():
        return "required"
    value = field.get_default(call_default_factory=True)
    if value is None or value in ((), {}) or isinstance(value, BaseModel):
        return ""
    return f"`{json.dumps(value, ensure_ascii=False)}`"


def _allowed_values(annotation: Any, metadata: list[Any]) -> str:
    """Allowed values of a key, in words."""
    if known := next((words for kind, words in _NUMBERS.items() if annotation == kind), ""):
        return known
    origin, arguments = typing.get_origin(annotation), typing.get_args(annotation)
    if origin is typing.Annotated:
        return _allowed_values(arguments[0], list(arguments[1:]))
    if origin in (typing.Union, types.UnionType):
        return " or ".join(_allowed_values(argument, []) for argument in arguments if argument is not type(None))
    if origin is Literal:
        return " ".join(f"`{json.dumps(choice)}`" for choice in arguments)
    if origin is tuple:
        return f"list of {_plural(_allowed_values(arguments[0], []))}"
    if origin is dict:
        return f"table of {_plural(_allowed_values(arguments[1], []))}"
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return "table"
    return f"{_WORDS[annotation]}{_bounds(metadata)}"


def _plural(words: str) -> str:
    return re.sub(r"\b(text|number|table|list)\b", r"\1s", words)


def _bounds(metadata: list[object]) -> str:
    """Limits of a field, except those against implausible sizes."""
    flat = [rule for entry in metadata for rule in (entry.metadata if isinstance(entry, FieldInfo) else [entry])]
    known = [(rule, *sign) for rule in flat for kind, sign in _SIGNS.items() if isinstance(rule, kind)]
    bounds = [(word, getattr(rule, name)) for rule, name, word in known]
    return "".join(f" {word} {limit:g}" for word, limit in bounds if abs(limit) != LARGEST)


def _model(annotation: object) -> type[BaseModel] | None:
    """Model within an annotation."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    return next((model for argument in typing.get_args(annotation) if (model := _model(argument))), None)
