"""Artifacts: the schema is enforced on writing and reading, other tools read them, streams need little memory."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import duckdb
import pandas as pd
import polars as pl
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from truing.pipeline.artifacts import (
    ROWS_PER_GROUP,
    SchemaBreach,
    Stamp,
    Unreadable,
    read_artifact,
    read_provenance,
    write_artifacts,
)
from truing.schemas.artifacts import ARTIFACTS

STAMP = Stamp("ingest", "d" * 64, "bench -- 1", "0.1", ("observations",), ("size",))


def observations(rows: int, **changed: pa.Array) -> pa.Table:
    columns = {
        "target": pa.array([f"P{k % 7}" for k in range(rows)]).dictionary_encode(),
        "pose": pa.array(range(rows), pa.int64()),
        "body": pa.array(["base"] * rows).dictionary_encode(),
        **{f"{a}_mm": pa.array([0.1 * k for k in range(rows)]) for a in "xyz"},
        **{f"sigma_{a}_mm": pa.nulls(rows, pa.float64()) for a in "xyz"},
    }
    return pa.table(columns | changed)


def test_the_metadata_of_the_contract_and_the_columns_in_order(tmp_path: Path) -> None:
    write_artifacts(tmp_path, {"observations": observations(3)}, STAMP, [])
    read = read_artifact(tmp_path, ARTIFACTS["observations"])
    assert tuple(read.schema.names) == ARTIFACTS["observations"].columns
    carried = {key.decode(): value.decode() for key, value in read.schema.metadata.items()}
    assert carried["truing.schema"] == "observations"
    assert carried["truing.schema_version"] == "1"
    assert json.loads(carried["truing.units"])["x_mm"] == "mm"
    assert carried["truing.stage"] == "ingest"
    assert carried["truing.digest"] == STAMP.digest
    assert carried["truing.software_version"] == "0.1"
    assert carried["truing.campaign"] == "bench -- 1"


def test_pandas_duckdb_and_polars_read_them_as_they_are(tmp_path: Path) -> None:
    write_artifacts(tmp_path, {"observations": observations(9)}, STAMP, [])
    path = str(tmp_path / "observations.parquet")
    expected = [f"P{k % 7}" for k in range(9)]
    assert pd.read_parquet(path)["target"].tolist() == expected
    assert pl.read_parquet(path)["target"].to_list() == expected
    assert [row[0] for row in duckdb.sql(f"select target from '{path}' order by pose").fetchall()] == expected
    measured = observations(9)["x_mm"].to_pylist()
    assert "BYTE_STREAM_SPLIT" in pq.read_metadata(path).row_group(0).column(3).encodings
    assert pd.read_parquet(path)["x_mm"].tolist() == measured
    assert pl.read_parquet(path)["x_mm"].to_list() == measured
    assert [row[0] for row in duckdb.sql(f"select x_mm from '{path}' order by pose").fetchall()] == measured


def test_a_stream_becomes_full_row_groups_and_the_same_bytes_as_the_table(tmp_path: Path) -> None:
    table = observations(ROWS_PER_GROUP + 1000)
    digests = []
    for size in (777, ROWS_PER_GROUP, 1_000_000):
        stream = pa.RecordBatchReader.from_batches(table.schema, table.to_batches(max_chunksize=size))
        digests.append(write_artifacts(tmp_path, {"observations": stream}, STAMP, [])["observations"])
    metadata = pq.read_metadata(tmp_path / "observations.parquet")
    assert [metadata.row_group(k).num_rows for k in range(metadata.num_row_groups)] == [ROWS_PER_GROUP, 1000]
    assert len(set(digests)) == 1


@pytest.mark.parametrize(
    ("table", "words"),
    [
        (observations(2).drop_columns(["x_mm"]), "columns x_mm are missing"),
        (observations(2, colour=pa.array([1.0, 2.0])), "a column colour is unknown"),
        (observations(2, x_mm=pa.array(["a", "b"])), "column x_mm"),
        (observations(2, x_mm=pa.array([1.0, None])), "expected a value in every row"),
        (observations(2, x_mm=pa.array([1.0, float("nan")])), "expected finite numbers"),
        (observations(2, sigma_x_mm=pa.array([1.0, -1.0])), "expected at least 0"),
    ],
)
def test_a_table_against_its_schema_is_not_written(tmp_path: Path, table: pa.Table, words: str) -> None:
    with pytest.raises(SchemaBreach, match=words):
        write_artifacts(tmp_path, {"observations": table}, STAMP, [])
    assert list(tmp_path.iterdir()) == []


def test_a_table_against_its_schema_is_not_read(tmp_path: Path) -> None:
    pq.write_table(observations(2, sigma_x_mm=pa.array([1.0, -1.0])), tmp_path / "observations.parquet")
    with pytest.raises(Unreadable, match="expected at least 0"):
        read_artifact(tmp_path, ARTIFACTS["observations"])


def test_an_interrupted_stream_keeps_the_previous_file(tmp_path: Path) -> None:
    write_artifacts(tmp_path, {"observations": observations(2)}, STAMP, [])
    before = (tmp_path / "observations.parquet").read_bytes()

    def broken() -> Iterator[pa.RecordBatch]:
        yield observations(5).to_batches()[0]
        raise RuntimeError("the reader fell over")

    stream = pa.RecordBatchReader.from_batches(observations(1).schema, broken())
    with pytest.raises(RuntimeError, match="fell over"):
        write_artifacts(tmp_path, {"observations": stream}, STAMP, [])
    assert [path.name for path in tmp_path.iterdir()] == ["observations.parquet"]
    assert (tmp_path / "observations.parquet").read_bytes() == before


def test_text_artifacts_carry_their_provenance_too(tmp_path: Path) -> None:
    contents = {"model": "a = 1\n", "report": "<!doctype html><p>x</p>"}
    write_artifacts(tmp_path, contents, STAMP, [])
    for name in contents:
        carried = read_provenance(tmp_path, ARTIFACTS[name])
        assert carried is not None
        assert (carried["schema"], carried["digest"]) == (name, STAMP.digest)
        assert json.loads(carried["failed_checks"]) == ["size"]
    assert "--" not in (tmp_path / "report.html").read_text().split("<!-- ")[1].removesuffix(" -->\n")


@pytest.mark.parametrize("name", ["observations", "model", "report"])
def test_a_broken_file_has_no_provenance(tmp_path: Path, name: str) -> None:
    assert read_provenance(tmp_path, ARTIFACTS[name]) is None
    (tmp_path / ARTIFACTS[name].file).write_text("[half")
    assert read_provenance(tmp_path, ARTIFACTS[name]) is None
