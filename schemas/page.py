"""docs/artifacts.md: what every artifact holds, written from the definitions that enforce it."""

from __future__ import annotations

import re
from collections.abc import Iterator

from truing.schemas.artifact import Artifact
from truing.schemas.artifacts import ARTIFACTS
from truing.schemas.column import Column
from truing.schemas.columns import COLUMNS

_COVARIANCE = ("cov_0_0", "cov_5_5")
_HEAD = """# What does a run leave, column by column?

Written by `python -m schemas` from the definitions in `schemas/`, which are enforced whenever an artifact is
written or read. Tables are Parquet; the metadata of each file names its schema and version (`truing.schema`,
`truing.schema_version`), the units (`truing.units`), the stage that made it, the digest of all it was made from,
the software's version and the campaign. A name means the same in every table.
"""


def artifacts_page() -> str:
    """The whole page as Markdown."""
    return "\n".join([_HEAD, *(_artifact(artifact) for artifact in ARTIFACTS.values())])


def _artifact(artifact: Artifact) -> str:
    of = "" if artifact.file.startswith(f"{artifact.name}.") else f" ({artifact.name})"
    key = f" Key: {_names(artifact.key)}." if artifact.key else ""
    lines = [f"## `{artifact.file}`{of}", "", f"{artifact.meaning[0].upper()}{artifact.meaning[1:]}.{key}", ""]
    if artifact.is_table:
        lines += list(_columns(artifact))
    return "\n".join(lines)


def _columns(artifact: Artifact) -> Iterator[str]:
    yield "| column | kind | unit | allowed | meaning |\n| --- | --- | --- | --- | --- |"
    for name in artifact.columns:
        if name == _COVARIANCE[0] or not re.match(r"cov_\d", name):
            yield _row(COLUMNS[name])
    yield from (_row(COLUMNS[name], "; where the campaign has it") for name in artifact.optional)
    yield from (_row(COLUMNS[name], "; numbered") for name in artifact.families)
    if artifact.covariates:
        yield "| any other | real |  |  | carried along as a covariate |"
    yield ""


def _row(column: Column, remark: str = "") -> str:
    """One line of a table; the entries of a covariance are one line together."""
    first, last = _COVARIANCE
    shown = f"`{first}` .. `{last}`" if column.name == first else f"`{column.family or column.name}`"
    return f"| {shown} | {column.kind} | {column.unit} | {_bounds(column)} | {column.meaning}{remark} |"


def _names(names: tuple[str, ...]) -> str:
    return ", ".join(f"`{name}`" for name in names)


def _bounds(column: Column) -> str:
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
