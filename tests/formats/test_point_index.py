"""Duplicate points and unknown poses are found, and every row is traced to its file and record."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given
from hypothesis import strategies as st

from truing.formats import point_index
from truing.formats.evaluation import TableBatch
from truing.formats.point_index import PointIndex
from truing.formats.read import FileRows
from truing.formats.source import RawFile
from truing.schemas.mapping import FileMapping


def file(name: str) -> FileRows:
    return FileRows(RawFile(name, Path(name)), FileMapping(path=name), "delimited")


def batch(rows, first, as_text):
    poses = [str(pose) if as_text else pose for pose, _, _ in rows]
    column = pa.array(poses, pa.string() if as_text else pa.int64())
    columns = {
        "pose": column.dictionary_encode() if as_text else column,
        "body": pa.array([body for _, body, _ in rows], pa.string()).dictionary_encode(),
        "target": pa.array([target for _, _, target in rows], pa.string()).dictionary_encode(),
    }
    return TableBatch(columns, np.arange(first, first + len(rows)))


ROW = st.tuples(st.integers(-2, 6), st.sampled_from(["a", "b"]), st.sampled_from(["1", "2", "3"]))


@given(
    st.lists(st.lists(ROW, max_size=30), min_size=1, max_size=6), st.booleans(), st.integers(1, 40), st.integers(1, 9)
)
def test_duplicates_unknown_poses_and_origins(parts, as_text, cells, step):
    known = [5, 0, 3, 1, -1]
    poses = pa.array([str(pose) for pose in known]) if as_text else pa.array(known)
    before = point_index._CELLS, point_index.STEP
    point_index._CELLS, point_index.STEP = cells, step  # many slabs and many steps
    ledger = PointIndex(poses)
    try:
        numbers = [ledger.add(file(f"f{i}"), batch(rows, 7 * i, as_text))[0] for i, rows in enumerate(parts)]
        found = np.concatenate([*ledger.duplicates(), np.zeros(0, int)])
        is_observed = ledger.seen()
    finally:
        point_index._CELLS, point_index.STEP = before
    rows = [row for part in parts for row in part]
    expected_numbers = [known.index(pose) if pose in known else len(known) for pose, _, _ in rows]
    assert np.concatenate(numbers).tolist() == expected_numbers
    keys = [(number, body, target) for number, (_, body, target) in zip(expected_numbers, rows, strict=True)]
    counted = Counter(key for key in keys if key[0] < len(known))
    assert len(found) == sum(count - 1 for count in counted.values())
    firsts = {keys.index(key) for key in counted} | {i for i, key in enumerate(keys) if key[0] == len(known)}
    assert firsts.isdisjoint(found.tolist())
    stood = [(f"f{i}", 7 * i + k) for i, part in enumerate(parts) for k in range(len(part))]
    traced = [ledger.origin(row) for row in range(len(rows))]
    assert [(origin.raw.name, record) for origin, record in traced] == stood
    bodies = ledger.bodies()
    own = {body: [row for row, (_, name, _) in enumerate(rows) if name == body] for body in bodies}
    assert {body: ledger.rows_of(body) for body in bodies} == {body: (own[body][0], len(own[body])) for body in bodies}
    assert {(n, bodies[b]) for n, b in zip(*np.nonzero(is_observed), strict=True)} == {(n, body) for n, body, _ in keys}
    ledger.close()


def test_texts_in_a_campaign_of_integers_are_unknown_unless_they_are_integers():
    ledger = PointIndex(pa.array([7, 8]))
    numbers, _ = ledger.add(file("f"), batch([("7", "a", "1"), ("x", "a", "1"), ("9", "a", "1")], 0, True))
    assert numbers.tolist() == [0, 2, 2]
    ledger.close()


def test_without_known_poses_all_poses_are_unknown():
    ledger = PointIndex(pa.array([], pa.int64()))
    numbers, _ = ledger.add(file("f"), batch([(0, "a", "1"), (0, "a", "1")], 0, False))
    assert numbers.tolist() == [0, 0]
    assert list(ledger.duplicates()) == []
    ledger.close()


def test_label_columns_give_the_names_back():
    ledger = PointIndex(pa.array([1]))
    rows = [(1, "a", "1"), (1, "b", "1"), (1, "a", "2")]
    _, labels = ledger.add(file("f"), batch(rows, 0, False))
    body, target = ledger.label_columns(labels)
    assert list(zip(body.to_pylist(), target.to_pylist(), strict=True)) == [row[1:] for row in rows]
    ledger.close()


@pytest.mark.parametrize("records", [[0, 1, 2], [4, 4, 9], [3, 1, 2]])
def test_origins_of_records_in_any_order(records):
    ledger = PointIndex(pa.array([1]))
    rows = batch([(1, "a", str(i)) for i in range(3)], 0, False)
    ledger.add(file("f"), TableBatch(rows.columns, np.array(records)))
    assert [ledger.origin(row)[1] for row in range(3)] == records
    ledger.close()
