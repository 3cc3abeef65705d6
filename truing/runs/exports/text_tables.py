"""Every table of a run as CSV: comma, dot, UTF-8, column names with their units, empty where there is no value."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from truing.runs.recorded_run import Run


def text_tables(run: Run) -> Iterator[tuple[str, bytes]]:
    """Yield a file per table, named as the Parquet that it comes from."""
    import pyarrow as pa
    import pyarrow.csv

    for name, path in run.files.items():
        sink = pa.BufferOutputStream()
        pa.csv.write_csv(run.table(name), sink, pa.csv.WriteOptions(quoting_style="needed"))
        yield f"{path.stem}.csv", bytes(sink.getvalue())
