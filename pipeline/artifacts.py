"""Artifacts on disk: schema enforced on write and read, provenance in the metadata, all files of a stage revealed
together.

Parquet is written with Snappy, in row groups of 2**18 rows, measured columns with BYTE_STREAM_SPLIT. It holds no
private schema of pyarrow, so that pandas, DuckDB and polars read the columns unchanged. Files contain no time and no
path: equal inputs give equal bytes.
"""

from __future__ import annotations

import json
import tomllib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO

from truing.pipeline.atomic_file import discard_parts, publish_file, sync_folder, write_part
from truing.schemas.artifact import Artifact, StoredTable, checked_table
from truing.schemas.artifacts import ARTIFACTS
from truing.schemas.faults import first_line
from truing.schemas.settings_text import regular_size

if TYPE_CHECKING:
    import pyarrow as pa

    from truing.schemas.column import Column

ROWS_PER_GROUP = 1 << 18
_KEY = "truing."
_COMMENT = "<!-- provenance: "


class SchemaBreach(Exception):
    """An artifact that contradicts its schema."""


class Unreadable(Exception):
    """A file of a run that changed after its stage wrote it."""


@dataclass(frozen=True)
class Stamp:
    """Origin of an artifact.

    ``artifacts``: names of all artifacts of the same run of its stage; ``closing_figure``: main figure of that stage's
    closing line.
    """

    stage: str
    digest: str
    campaign: str
    software_version: str
    artifacts: tuple[str, ...]
    failed_checks: tuple[str, ...] = ()
    closing_figure: str = ""
    why_not: str = ""

    def metadata(self, artifact: Artifact, columns: list[str]) -> dict[str, str]:
        """File metadata: keys without their ``truing.`` prefix, values as text."""
        return {
            "schema": artifact.name,
            "schema_version": str(artifact.version),
            "units": json.dumps(artifact.units(columns)),
            "stage": self.stage,
            "digest": self.digest,
            "software_version": self.software_version,
            "campaign": self.campaign,
            "left": json.dumps(self.artifacts),
            "failed_checks": json.dumps(self.failed_checks),
            "said": self.closing_figure,
            "why_not": self.why_not,
        }


def write_artifacts(
    folder: Path,
    contents: Mapping[str, pa.Table | pa.RecordBatchReader | str],
    stamp: Stamp,
    obsolete: Sequence[str],
    check: Callable[[], None] = lambda: None,
) -> dict[str, str]:
    """Write all artifacts of a stage in the mapping's order, then reveal them; returns the SHA-256 of each file.

    ``obsolete``: files of an earlier run to remove first. ``check`` is called after writing and before revealing.
    Raises SchemaBreach, and errors of a stream or of ``check``; nothing is left behind then.
    """
    paths = {name: folder / ARTIFACTS[name].file for name in contents}
    try:
        digests = {name: _write(paths[name], ARTIFACTS[name], content, stamp) for name, content in contents.items()}
        check()
        for file in obsolete:
            (folder / file).unlink(missing_ok=True)
        for path in paths.values():
            publish_file(path)
        sync_folder(folder)
        return digests
    finally:
        discard_parts(paths.values())


def write_table(path: Path, artifact: Artifact, table: pa.Table, stamp: Stamp) -> None:
    """Write one table of an artifact's schema to any path, atomically."""
    try:
        _write(path, artifact, table, stamp)
        publish_file(path)
        sync_folder(path.parent)
    finally:
        discard_parts([path])


def drain(contents: Mapping[str, pa.Table | pa.RecordBatchReader | str]) -> None:
    """Check all artifacts of a stage against their schemas without writing."""
    for name, content in contents.items():
        if not isinstance(content, str):
            _, batches = _uniform(ARTIFACTS[name], content)
            for _ in batches:
                pass


def _write(path: Path, artifact: Artifact, content: pa.Table | pa.RecordBatchReader | str, stamp: Stamp) -> str:
    if isinstance(content, str) == artifact.is_table:
        raise SchemaBreach(f"{artifact.file}: {type(content).__name__} is the wrong type for this artifact")
    if isinstance(content, str):
        text = _with_provenance(path.suffix, content, stamp.metadata(artifact, [])).encode()
        return write_part(path, lambda file: _write_bytes(file, text))
    return write_part(path, lambda file: _write_parquet(file, artifact, content, stamp))


def _write_bytes(file: BinaryIO, content: bytes) -> None:
    file.write(content)


def _write_parquet(file: BinaryIO, artifact: Artifact, content: pa.Table | pa.RecordBatchReader, stamp: Stamp) -> None:
    import pyarrow.parquet as pq

    schema, tables = _uniform(artifact, content)
    metadata = {_KEY + key: value for key, value in stamp.metadata(artifact, schema.names).items()}
    options: dict[str, object] = {"compression": "snappy", "store_schema": False}
    repeating = [name for name in schema.names if _repeats(_column(artifact, name))]
    options["use_dictionary"] = repeating
    # Ranges of keys find rows; those of measured numbers would take a third of the writer's time.
    options["write_statistics"] = [name for name in schema.names if _column(artifact, name).kind != "real"]
    # Bytes of equal rank lie side by side: Snappy then takes a third of the time for measured numbers.
    options["column_encoding"] = {name: "BYTE_STREAM_SPLIT" for name in schema.names if name not in repeating}
    with pq.ParquetWriter(file, schema, **options) as writer:
        for table in tables:
            writer.write_table(table, row_group_size=ROWS_PER_GROUP)
        writer.add_key_value_metadata(metadata)  # next to the schema, which store_schema=False keeps out


def _repeats(column: Column) -> bool:
    """True if a dictionary encoding pays; for measured numbers it does not."""
    return column.kind != "real" or column.name.startswith("sigma")


def _uniform(artifact: Artifact, content: pa.Table | pa.RecordBatchReader) -> tuple[pa.Schema, Iterator[pa.Table]]:
    """Schema to write, and the content checked and cast to it, in tables of at most one row group if streamed."""
    import pyarrow as pa

    schema = _schema(artifact, content.schema)
    tables = iter([content]) if isinstance(content, pa.Table) else _rebatched(content)
    return schema, (_checked(artifact, table, schema) for table in tables)


def _schema(artifact: Artifact, schema: pa.Schema) -> pa.Schema:
    """Columns of the artifact in order, then covariates as found; nullable only as in the definition."""
    import pyarrow as pa

    missing = [name for name in artifact.columns if name not in schema.names]
    if missing:
        raise SchemaBreach(f"{artifact.file}: columns {', '.join(missing)} are missing")
    known = [*artifact.columns, *(name for name in artifact.optional if name in schema.names)]
    names = [*known, *(name for name in schema.names if name not in known)]
    return pa.schema([pa.field(name, schema.field(name).type, _column(artifact, name).nullable) for name in names])


def _column(artifact: Artifact, name: str) -> Column:
    column = artifact.column(name)
    if column is None:
        raise SchemaBreach(f"{artifact.file}: a column {name} is unknown")
    return column


def _checked(artifact: Artifact, table: pa.Table, schema: pa.Schema) -> pa.Table:
    faults = artifact.faults(table)
    if faults:
        raise SchemaBreach("\n".join(str(fault) for fault in faults))
    # One chunk per row group, so that the bytes do not depend on the reader's batch sizes.
    return table.select(schema.names).cast(schema).unify_dictionaries().combine_chunks()


def _rebatched(batches: Iterable[pa.RecordBatch]) -> Iterator[pa.Table]:
    """Batches of any size as tables of exactly one row group each, the last one shorter."""
    import pyarrow as pa

    waiting: list[pa.RecordBatch] = []
    rows = 0
    for batch in batches:
        while rows + len(batch) >= ROWS_PER_GROUP:
            head = batch.slice(0, ROWS_PER_GROUP - rows)
            yield pa.Table.from_batches([*waiting, head])
            waiting, rows, batch = [], 0, batch.slice(len(head))
        waiting.append(batch)
        rows += len(batch)
    if rows:
        yield pa.Table.from_batches(waiting)


def read_artifact(folder: Path, artifact: Artifact) -> pa.Table | str:
    """Table (or text) of an artifact; raises Unreadable if it is missing or contradicts its schema."""
    path = folder / artifact.file
    with _as_unreadable():
        regular_size(path)
        return checked_table(path, artifact) if artifact.is_table else path.read_text(encoding="utf-8")


def opened_artifact(folder: Path, artifact: Artifact) -> StoredTable:
    """Table of an artifact to be read in batches; raises Unreadable if it is missing or no Parquet file."""
    table = StoredTable(folder / artifact.file, artifact)
    with _as_unreadable():
        regular_size(table.path)
        _ = table.schema, table.num_rows
    return table


@contextmanager
def _as_unreadable() -> Iterator[None]:
    """Raise Unreadable for a file that is missing or contradicts its schema."""
    try:
        yield
    except FileNotFoundError as error:
        raise Unreadable(error.strerror) from None
    except ValueError as error:
        raise Unreadable(first_line(error)) from None


def table_of(folder: Path, name: str) -> pa.Table | None:
    """Table of an artifact by name; None if the folder has no readable one."""
    try:
        found = read_artifact(folder, ARTIFACTS[name])
    except Unreadable:
        return None
    return None if isinstance(found, str) else found


def read_provenance(folder: Path, artifact: Artifact) -> dict[str, str] | None:
    """Metadata of an artifact; None if the file is absent, broken, or not of this project."""
    path = folder / artifact.file
    if not path.is_file():
        return None
    try:
        return _provenance(path)
    except (OSError, ValueError, KeyError, TypeError, RecursionError):  # pyarrow's errors are among these
        return None


def _provenance(path: Path) -> dict[str, str]:
    if path.suffix == ".toml":
        return dict(tomllib.loads(path.read_text(encoding="utf-8"))["provenance"])
    if path.suffix == ".html":
        text = path.read_text(encoding="utf-8")
        return dict(json.loads(text[text.rindex(_COMMENT) + len(_COMMENT) :].removesuffix(" -->\n")))
    import pyarrow.parquet as pq

    metadata = pq.read_schema(path).metadata or {}
    return {key.decode().removeprefix(_KEY): value.decode() for key, value in metadata.items()}


def _with_provenance(suffix: str, content: str, metadata: dict[str, str]) -> str:
    if suffix == ".toml":
        lines = (f"{key} = {json.dumps(value, ensure_ascii=False)}" for key, value in metadata.items())
        return "\n".join(chain([content.rstrip("\n"), "", "[provenance]"], lines, [""]))
    # A comment may not hold two hyphens in a row.
    note = json.dumps(metadata).replace("-", "\\u002d")
    return f"{content.rstrip()}\n{_COMMENT}{note} -->\n"
