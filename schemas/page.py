"""docs/artifacts.md: what every artifact holds, written from the definitions that enforce it."""

from __future__ import annotations

from collections.abc import Iterator

from schemas.artifact import Artifact
from schemas.artifacts import ARTIFACTS
from schemas.columns import COLUMNS, Column

_HEAD = """# What does a run leave, column by column?

Written by `python -m schemas` from the definitions in `schemas/`, which are enforced whenever an artifact is
written or read. Tables are Parquet; the metadata of each file names its schema and version (`truing.schema`,
`truing.schema_version`), the units (`truing.units`), the stage that made it, the digest of all it was made from,
the software's version and the campaign.
"""


def artifacts_page() -> str:
    """The whole page as Markdown."""
    parts = [_HEAD, *(_artifact(artifact) for artifact in ARTIFACTS.values()), _meanings()]
    return "\n".join(parts)


def _artifact(artifact: Artifact) -> str:
    of = "" if artifact.file.startswith(f"{artifact.name}.") else f" ({artifact.name})"
    lines = [f"## `{artifact.file}`{of}", "", f"{artifact.meaning[0].upper()}{artifact.meaning[1:]}.", ""]
    if artifact.is_table:
        lines += list(_facts(artifact))
    return "\n".join(lines) + "\n"


def _facts(artifact: Artifact) -> Iterator[str]:
    yield f"- columns: {_names(artifact.columns)}"
    if artifact.optional:
        yield f"- where the campaign has them: {_names(artifact.optional)}"
    if artifact.families:
        yield f"- numbered columns: {', '.join(f'`{COLUMNS[name].family}`' for name in artifact.families)}"
    if artifact.covariates:
        yield "- any further column of numbers, carried along as a covariate"
    if artifact.key:
        yield f"- one row per {_names(artifact.key)}"


def _names(names: tuple[str, ...]) -> str:
    return ", ".join(f"`{name}`" for name in names)


def _meanings() -> str:
    rows = [f"| `{c.family or c.name}` | {c.kind} | {c.unit} | {_bounds(c)} | {c.meaning} |" for c in COLUMNS.values()]
    return "\n".join(
        [
            "## The columns",
            "",
            "| column | kind | unit | allowed | meaning |",
            "| --- | --- | --- | --- | --- |",
            *rows,
            "",
        ]
    )


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
