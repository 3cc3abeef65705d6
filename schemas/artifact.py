"""Definition of an artifact: file, columns and key; validation, and reading of a table."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

from truing.schemas.column import Column
from truing.schemas.columns import COLUMNS, find_column
from truing.schemas.faults import Fault, first_line
from truing.schemas.memory import raise_shortage

if TYPE_CHECKING:
    import pyarrow as pa

ROWS_AT_ONCE = 1 << 18


@dataclass(frozen=True)
class Artifact:
    """A file that a stage writes: its columns in order, optional columns, and whether covariates are allowed.

    ``columns`` is empty for files that are no tables (report.html, model.toml). ``covariates`` allows further real
    columns of any name. ``families`` are numbered columns.
    """

    name: str
    file: str
    meaning: str
    columns: tuple[str, ...] = ()
    optional: tuple[str, ...] = ()
    families: tuple[str, ...] = ()
    covariates: bool = False
    key: tuple[str, ...] = ()
    version: int = 1

    @cached_property
    def is_table(self) -> bool:
        """True if the artifact is Parquet."""
        return bool(self.columns)

    def column(self, name: str) -> Column | None:
        """Definition of one of the artifact's columns, or None."""
        if name in self.columns or name in self.optional:
            return COLUMNS[name]
        described = find_column(name)
        if described is not None and described.family and described.name in self.families:
            return described
        if self.covariates:
            return Column(name, "real", "covariate of the campaign", nullable=True)
        return None

    def units(self, names: list[str]) -> dict[str, str]:
        """Units of the named columns, for the file's metadata."""
        return {name: column.unit for name in names if (column := self.column(name)) is not None and column.unit}

    def arrow_schema(self, identifier: str = "int64", present: tuple[str, ...] = ()) -> pa.Schema:
        """Arrow schema with the optional columns and family members in ``present``."""
        import pyarrow as pa

        names = [*self.columns, *(name for name in present if name not in self.columns)]
        fields = []
        for name in names:
            column = self.column(name)
            if column is None:
                raise KeyError(f"{self.file} has no column {name}")
            fields.append(pa.field(name, arrow_type(column, identifier), nullable=column.nullable))
        return pa.schema(fields)

    def empty(self, identifier: str = "int64") -> pa.Table:
        """A table without rows, for a stage that was not evaluated."""
        return self.arrow_schema(identifier).empty_table()

    def faults(self, table: pa.Table | pa.RecordBatch) -> list[Fault]:
        """All departures of a table from this definition: columns, types, nulls, bounds, choices."""
        names = table.schema.names
        missing = [Fault(self.file, f"a column {name}") for name in self.columns if name not in names]
        return missing + [fault for name in names for fault in self.column_faults(name, table.column(name))]

    def column_faults(self, name: str, values: pa.ChunkedArray | pa.Array) -> Iterator[Fault]:
        """Yield all departures of one column from this definition."""
        column = self.column(name)
        if column is None:
            yield Fault(self.file, "no such column", column=name)
        elif not _type_fits(column, values.type):
            yield Fault(self.file, f"values of kind {column.kind}", column=name, value=str(values.type))
        else:
            yield from _value_faults(self.file, column, name, values)


def arrow_type(column: Column, identifier: str = "int64") -> pa.DataType:
    """Arrow type of a column."""
    import pyarrow as pa

    if column.kind == "identifier":
        return pa.int64() if identifier == "int64" else pa.string()
    return {"text": pa.string(), "integer": pa.int64(), "real": pa.float64(), "flag": pa.bool_()}[column.kind]


def _type_fits(column: Column, found: pa.DataType) -> bool:
    import pyarrow as pa

    if pa.types.is_dictionary(found):
        found = found.value_type
    text = pa.types.is_string(found) or pa.types.is_large_string(found)
    return {
        "identifier": text or pa.types.is_int64(found),
        "text": text,
        "integer": pa.types.is_int64(found),
        "real": pa.types.is_float64(found),
        "flag": pa.types.is_boolean(found),
    }[column.kind]


def _value_faults(file: str, column: Column, name: str, values: pa.ChunkedArray | pa.Array) -> Iterator[Fault]:
    import pyarrow.compute as pc

    if values.null_count and not column.nullable:
        yield Fault(file, "a value in every row", column=name, value="empty", more=values.null_count - 1)
    if column.kind in ("real", "integer"):
        yield from _bound_faults(file, column, name, values)
    if column.choices:
        known = pc.fill_null(pc.is_in(values.cast("string"), value_set=_choices(column)), False)
        wrong = pc.filter(values, pc.and_(pc.invert(known), pc.is_valid(values)))
        if len(wrong):
            yield Fault(
                file, f"one of {', '.join(column.choices)}", column=name, value=str(wrong[0]), more=len(wrong) - 1
            )


def _choices(column: Column) -> pa.Array:
    import pyarrow as pa

    return pa.array(column.choices, pa.string())


def _bound_faults(file: str, column: Column, name: str, values: pa.ChunkedArray | pa.Array) -> Iterator[Fault]:
    import pyarrow.compute as pc

    if column.kind == "real" and not pc.all(pc.is_finite(values), min_count=0).as_py():
        infinite = pc.filter(values, pc.invert(pc.fill_null(pc.is_finite(values), True)))
        yield Fault(file, "finite numbers", column=name, value=str(infinite[0]), more=len(infinite) - 1)
    for bound, outside, word in ((column.minimum, pc.less, "at least"), (column.maximum, pc.greater, "at most")):
        if bound is None or _is_within(values, bound, word == "at least"):
            continue
        wrong = pc.filter(values, pc.fill_null(outside(values, bound), False))
        if len(wrong):
            yield Fault(file, f"{word} {bound:g}", column=name, value=str(wrong[0]), more=len(wrong) - 1)


def _is_within(values: pa.ChunkedArray | pa.Array, bound: float, is_minimum: bool) -> bool:
    """True if the extreme of a column without empty cells shows that no value is outside; NumPy finds it much faster
    than Arrow."""
    import numpy as np

    if values.null_count:
        return False
    parts = [np.asarray(part) for part in getattr(values, "chunks", (values,)) if len(part)]
    return all(bool(part.min() >= bound if is_minimum else part.max() <= bound) for part in parts)


def parquet(
    name: str,
    meaning: str,
    columns: str,
    *,
    optional: str = "",
    families: str = "",
    covariates: bool = False,
    version: int = 1,
    file: str = "",
) -> Artifact:
    """Artifact in the Parquet file of its name; columns separated by blanks, key columns marked with ``*``."""
    names_of_columns, further = (
        [column.removesuffix("*") for column in names.split()] for names in (columns, optional)
    )
    key = tuple(column[:-1] for column in f"{columns} {optional}".split() if column.endswith("*"))
    file = file or f"{name}.parquet"
    return Artifact(
        name, file, meaning, tuple(names_of_columns), tuple(further), tuple(families.split()), covariates, key, version
    )


class DamagedTable(ValueError):
    """A Parquet file that departs from its artifact, with every departure."""

    def __init__(self, artifact: Artifact, why: str) -> None:
        self.artifact = artifact
        super().__init__(why)


@dataclass(frozen=True)
class StoredTable:
    """Table of an artifact in its Parquet file, read in batches; raises DamagedTable while it is read."""

    path: Path
    artifact: Artifact

    @cached_property
    def schema(self) -> pa.Schema:
        """Names and types of the columns."""
        import pyarrow.parquet as pq

        with _as_damage(self.artifact):
            return pq.read_schema(self.path)

    @cached_property
    def num_rows(self) -> int:
        """Number of rows."""
        import pyarrow.parquet as pq

        with _as_damage(self.artifact):
            return int(pq.read_metadata(self.path).num_rows)

    def batches(self, columns: Sequence[str] | None = None, rows: int = ROWS_AT_ONCE) -> Iterator[pa.Table]:
        """Yield all rows in order, checked; texts are dictionary-encoded."""
        import pyarrow as pa
        import pyarrow.parquet as pq

        names = [name for name in self.schema.names if columns is None or name in columns]
        texts = [name for name in names if pa.types.is_string(self.schema.field(name).type)]
        with _as_damage(self.artifact), pq.ParquetFile(self.path, read_dictionary=texts) as file:
            for batch in file.iter_batches(batch_size=rows, columns=names):
                if faults := [fault for name in names for fault in self.artifact.column_faults(name, batch[name])]:
                    raise DamagedTable(self.artifact, "\n".join(str(fault) for fault in faults))
                yield pa.Table.from_batches([batch])

    def read(self) -> pa.Table:
        """Return the whole table."""
        return checked_table(self.path, self.artifact)


def table_batches(
    table: pa.Table | StoredTable, columns: Sequence[str] | None = None, rows: int = ROWS_AT_ONCE
) -> Iterator[pa.Table]:
    """Yield the rows of a table in order, in batches of limited size."""
    if isinstance(table, StoredTable):
        yield from table.batches(columns, rows)
        return
    some = table if columns is None else table.select([name for name in table.column_names if name in columns])
    for first in range(0, some.num_rows, rows):
        yield some.slice(first, rows)


def full_table(table: pa.Table | StoredTable) -> pa.Table:
    """Return all rows of a table."""
    return table.read() if isinstance(table, StoredTable) else table


def plain_texts(table: pa.Table) -> pa.Table:
    """Return a table with its texts not dictionary-encoded."""
    import pyarrow as pa

    kinds = [(f.name, f.type.value_type if pa.types.is_dictionary(f.type) else f.type) for f in table.schema]
    return table.cast(pa.schema(kinds))


@contextmanager
def _as_damage(artifact: Artifact) -> Iterator[None]:
    """Raise DamagedTable for errors of a file's content."""
    import pyarrow as pa

    try:
        yield
    except (pa.ArrowException, UnicodeError, OSError) as error:
        if isinstance(error, OSError) and error.errno:  # the file cannot be reached, whatever its content is
            raise
        raise_shortage(error)
        why = f"{artifact.file}: expected a whole Parquet file ({first_line(error)[:200]})"
        raise DamagedTable(artifact, why) from None


def checked_table(path: Path, artifact: Artifact) -> pa.Table:
    """Return the table in a Parquet file; raises DamagedTable with every departure from the artifact."""
    import pyarrow.parquet as pq

    with _as_damage(artifact):
        with pq.ParquetFile(path) as file:  # `read_table` loads the package of data sets first
            table = file.read()
        table.validate(full=True)
        faults = artifact.faults(table)
    if faults:
        raise DamagedTable(artifact, "\n".join(str(fault) for fault in faults))
    return table
