"""Tables of a run that are read in batches have the same rows, and are checked while they are read."""

from __future__ import annotations

from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from truing.schemas.artifact import DamagedTable, StoredTable, full_table, plain_texts, table_batches
from truing.schemas.artifacts import ARTIFACTS

OBSERVATIONS = ARTIFACTS["observations"]


def points(rows: int, sigma: float = 0.005) -> pa.Table:
    numbers = list(range(rows))
    columns = {"pose": numbers, "body": ["plate"] * rows, "target": [f"t{n % 3}" for n in numbers]}
    columns |= {f"{axis}_mm": [float(n) for n in numbers] for axis in "xyz"}
    columns |= {f"sigma_{axis}_mm": [sigma] * rows for axis in "xyz"}
    return pa.table(columns, schema=OBSERVATIONS.arrow_schema())


def stored(folder: Path, table: pa.Table) -> StoredTable:
    pq.write_table(table, folder / "observations.parquet", row_group_size=10)
    return StoredTable(folder / "observations.parquet", OBSERVATIONS)


def test_batches_hold_all_rows_in_order(tmp_path: Path) -> None:
    table = points(47)
    for source in (table, stored(tmp_path, table)):
        batches = list(table_batches(source, rows=20))
        assert max(batch.num_rows for batch in batches) <= 20
        whole = plain_texts(pa.concat_tables(batches).unify_dictionaries())
        assert whole.cast(table.schema).equals(table)
        assert full_table(source).equals(table)
        some = pa.concat_tables(list(table_batches(source, ("target", "pose", "no_such_column"))))
        assert some.column_names == ["pose", "target"]
        assert some.num_rows == source.num_rows == 47


def test_a_value_outside_its_bounds_is_found_where_it_is_read(tmp_path: Path) -> None:
    table = stored(tmp_path, pa.concat_tables([points(30), points(5, sigma=-1.0)]))
    assert next(table.batches(rows=10)).num_rows == 10
    with pytest.raises(DamagedTable, match="at least") as found:
        list(table.batches(rows=10))
    assert found.value.artifact is OBSERVATIONS
    assert sum(batch.num_rows for batch in table.batches(("pose", "x_mm"))) == 35


def test_a_file_cut_short_is_damaged(tmp_path: Path) -> None:
    table = stored(tmp_path, points(30))
    table.path.write_bytes(table.path.read_bytes()[:-40])
    with pytest.raises(DamagedTable, match=r"observations\.parquet"):
        list(StoredTable(table.path, OBSERVATIONS).batches())
    with pytest.raises(DamagedTable):
        _ = StoredTable(table.path, OBSERVATIONS).num_rows
