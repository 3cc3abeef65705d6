"""Parquet tables, row group by row group."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from truing.formats.compression import FREE, LARGEST_RATIO
from truing.formats.dictionaries import as_dictionary
from truing.formats.raw import Kind, RawBatch, Unusable, Wanted, consecutive
from truing.schemas.faults import first_line
from truing.schemas.memory import raise_shortage

_ROWS = 1 << 17


def read_parquet(path: Path, wanted: Wanted) -> Iterator[RawBatch]:
    """Yield the rows of a Parquet file; raises Unusable if it is damaged or empty."""
    try:
        with pq.ParquetFile(path, memory_map=False) as file:
            yield from _batches(file, path.stat().st_size, wanted)
    except pa.ArrowException as error:
        raise_shortage(error)
        raise Unusable("an undamaged Parquet file", value=first_line(error)[:80]) from None


def _batches(file: pq.ParquetFile, size: int, wanted: Wanted) -> Iterator[RawBatch]:
    names = tuple(file.schema_arrow.names)
    if not file.metadata.num_rows:
        raise Unusable("at least one row; the table is empty")
    _check_proportion(file.metadata, size)
    kinds = wanted(names, None)
    if kinds is None:
        return
    done = 0
    some = [names[position] for position in kinds]
    by_name = len(set(names)) == len(names)
    for batch in file.iter_batches(batch_size=_ROWS, columns=some if by_name else None):
        columns = {i: _column(batch.column(names[i] if by_name else i), kind, names[i]) for i, kind in kinds.items()}
        yield RawBatch(columns, consecutive(done, batch.num_rows))
        done += batch.num_rows


def _check_proportion(metadata: pq.FileMetaData, size: int) -> None:
    """Refuse a table beyond the allowed ratio to the file size: a few bytes may encode any number of equal rows."""
    size_bound = 8 * metadata.num_rows * metadata.num_columns
    if size_bound > max(FREE, LARGEST_RATIO * size):
        raise Unusable(f"a table of at most {LARGEST_RATIO} times the file's size", value=f"{metadata.num_rows} rows")


def _column(values: pa.Array, kind: Kind, name: str) -> pa.Array:
    try:
        return _cast_to_kind(values, kind)
    except (pa.ArrowException, UnicodeError) as error:
        raise_shortage(error)
        raise Unusable("a column of numbers or of text", column=name, value=str(values.type)[:80]) from None


def _cast_to_kind(values: pa.Array, kind: Kind) -> pa.Array:
    is_moment = pa.types.is_timestamp(values.type) or pa.types.is_duration(values.type)
    if is_moment and kind in ("number", "seconds"):
        return _seconds(values) if kind == "seconds" else _written(values)
    kind = "number" if kind == "seconds" else kind
    if pa.types.is_dictionary(values.type):
        values = values.dictionary_decode() if kind == "number" else values
    if kind == "number" and _is_number(values.type):
        return values.cast(pa.float64())
    if _is_number(values.type) and not values.null_count:
        as_integers = _cast_to_integers(values)
        if as_integers is not None:
            return as_integers if kind == "identifier" else as_dictionary(as_integers)
    if pa.types.is_timestamp(values.type):
        return values.cast(pa.timestamp("us")).cast(pa.int64()).cast(pa.string())
    return as_dictionary(values) if kind != "number" else values.cast(pa.string())


def _seconds(values: pa.Array) -> pa.Array:
    """Return times as seconds since 1970, durations as seconds, from any unit."""
    ticks = {"s": 1.0, "ms": 1e3, "us": 1e6, "ns": 1e9}[values.type.unit]
    return pc.divide(values.cast(pa.int64()).cast(pa.float64(), safe=False), ticks)


def _written(values: pa.Array) -> pa.Array:
    """Return times and durations as non-numeric text, since they are numbers only in columns of seconds."""
    unit = values.type.unit
    if pa.types.is_timestamp(values.type):
        return values.cast(pa.timestamp(unit)).cast(pa.string())
    return pc.binary_join_element_wise(values.cast(pa.int64()).cast(pa.string()), unit, " ")


def _is_number(kind: pa.DataType) -> bool:
    return bool(pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_decimal(kind))


def _cast_to_integers(values: pa.Array) -> pa.Array | None:
    """Return the values as int64 if all are integers (pandas may store them as floats); else None."""
    plain = np.asarray(values.cast(pa.float64()))
    if not np.all(np.isfinite(plain)) or np.any(plain != np.round(plain)) or np.any(np.abs(plain) > 2**53):
        return None
    return pa.array(plain.astype(np.int64))
