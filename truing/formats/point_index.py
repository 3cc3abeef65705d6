"""Index of a campaign's points: names as numbers, and the file and record of every row."""

from __future__ import annotations

import tempfile
import weakref
from bisect import bisect_right
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Generic, TypeVar

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from truing.arrays import Index, Mask
from truing.formats.dictionaries import codes, strings
from truing.formats.evaluation import TableBatch
from truing.formats.read import FileRows

T = TypeVar("T")

STEP = 1 << 18
"""Rows that are looked at at a time."""

_CELLS = 1 << 27


class NameNumbers(Generic[T]):
    """Names in order of appearance, with their numbers."""

    def __init__(self) -> None:
        self.values: list[T] = []
        self._numbers: dict[T, int] = {}

    def number(self, value: T) -> int:
        """Return the number of a name; a new name gets the next one."""
        number = self._numbers.get(value)
        if number is None:
            number = self._numbers[value] = len(self.values)
            self.values.append(value)
        return number


class PointIndex:
    """Pose, body and target of every point, in the order of input.

    ``poses``: known poses; a pose's number is its index among them, or their count if it is unknown.
    """

    def __init__(self, poses: pa.Array, folder: Path | None = None) -> None:
        self.poses = poses
        self.labels: NameNumbers[tuple[str, str]] = NameNumbers()  # body and target
        plain = np.asarray(poses) if pa.types.is_int64(poses.type) else np.zeros(0, np.int64)
        self._order = np.argsort(plain, kind="stable")
        self._sorted = plain[self._order]
        self._spool = Spool(("pose", "label"), folder)
        self._any_unknown = False
        self._named = 0
        self._codes: NDArray[np.int32] = np.zeros((0, 2), np.int32)
        self._columns: tuple[pa.Array, pa.Array] = (strings([]), strings([]))
        self._starts: list[int] = []
        self._origins: list[tuple[FileRows, Index | int]] = []

    @property
    def rows(self) -> int:
        """Number of points."""
        return self._spool.rows

    def add(self, file: FileRows, batch: TableBatch) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
        """Add a batch of points; return the numbers of their poses and labels."""
        pose = self.pose_numbers(batch.columns["pose"])
        label = self._label_numbers(batch.columns["body"], batch.columns["target"])
        if batch.rows:
            self._any_unknown |= int(pose.max()) == len(self.poses)
            is_run = bool(np.all(np.diff(batch.records) == 1))
            self._starts.append(self.rows)
            self._origins.append((file, int(batch.records[0]) if is_run else batch.records))
            self._spool.append(pose=pose, label=label)
        return pose, label

    def pose_numbers(self, poses: pa.Array) -> NDArray[np.int32]:
        """Return the index of each pose among the known ones, or their count if unknown."""
        if pa.types.is_dictionary(poses.type):
            known = self.poses.cast(pa.string())
            numbers_of_poses = pc.fill_null(pc.index_in(poses.dictionary, value_set=known), len(known))
            return np.asarray(numbers_of_poses)[codes(poses)]
        plain = np.asarray(poses)
        starts = np.flatnonzero(np.concatenate((np.ones(min(len(plain), 1), bool), plain[1:] != plain[:-1])))
        number = self._numbers_of(plain[starts])
        return np.repeat(number, np.diff(np.append(starts, len(plain))))

    def _numbers_of(self, poses: Index) -> NDArray[np.int32]:
        unknown = len(self.poses)
        if not unknown:
            return np.zeros(len(poses), dtype=np.int32)
        index = np.minimum(np.searchsorted(self._sorted, poses), unknown - 1)
        return np.where(self._sorted[index] == poses, self._order[index], unknown).astype(np.int32)

    def _label_numbers(self, body: pa.DictionaryArray, target: pa.DictionaryArray) -> NDArray[np.int32]:
        bodies, targets = body.dictionary.to_pylist(), target.dictionary.to_pylist()
        key = codes(body) * np.int32(len(targets)) + codes(target)
        is_observed = np.zeros(len(bodies) * len(targets), dtype=bool)
        is_observed[key] = True
        numbers = np.empty(len(is_observed), dtype=np.int32)
        for pair in np.flatnonzero(is_observed):
            numbers[pair] = self.labels.number((bodies[pair // len(targets)], targets[pair % len(targets)]))
        return numbers[key]

    def label_columns(self, label: NDArray[np.int32]) -> tuple[pa.DictionaryArray, pa.DictionaryArray]:
        """Return body and target of labels by number."""
        if self._named != len(self.labels.values):
            bodies: NameNumbers[str] = NameNumbers()
            targets: NameNumbers[str] = NameNumbers()
            pairs = [(bodies.number(body), targets.number(target)) for body, target in self.labels.values]
            self._codes = np.array(pairs, dtype=np.int32).reshape(-1, 2)
            self._columns = (strings(bodies.values), strings(targets.values))
            self._named = len(self.labels.values)
        body, target = (
            pa.DictionaryArray.from_arrays(pa.array(self._codes[label, i]), self._columns[i]) for i in range(2)
        )
        return body, target

    def close(self) -> None:
        """Release the disk space."""
        self._spool.close()

    def name_of(self, row: int) -> tuple[object, str, str]:
        """Return pose, body and target of a row."""
        pose = self.poses[int(self._spool.read("pose", row, row + 1)[0])].as_py()
        body, target = self.labels.values[int(self._spool.read("label", row, row + 1)[0])]
        return pose, body, target

    def steps(self) -> Iterator[tuple[int, int]]:
        """Yield ranges of rows that cover the store."""
        for start in range(0, self.rows, STEP):
            yield start, min(start + STEP, self.rows)

    def origin(self, row: int) -> tuple[FileRows, int]:
        """Return the file and record of a row."""
        part = bisect_right(self._starts, row) - 1
        file, records = self._origins[part]
        offset = row - self._starts[part]
        return file, records + offset if isinstance(records, int) else int(records[offset])

    def seen(self) -> Mask:
        """Mask (poses, bodies) of poses with any point of a body; bodies in the order of :meth:`bodies`."""
        body = self.label_bodies()
        is_seen = np.zeros((len(self.poses) + 1, len(self.bodies())), dtype=bool)
        for start, stop in self.steps():
            is_seen[self._spool.read("pose", start, stop), body[self._spool.read("label", start, stop)]] = True
        return is_seen

    def bodies(self) -> tuple[str, ...]:
        """Bodies, in order of appearance."""
        return tuple(dict.fromkeys(body for body, _ in self.labels.values))

    def label_bodies(self) -> NDArray[np.int32]:
        """Return the body number of every label."""
        bodies = {body: number for number, body in enumerate(self.bodies())}
        return np.array([bodies[body] for body, _ in self.labels.values], dtype=np.int32)

    def rows_of(self, body: str) -> tuple[int, int]:
        """Return the first row of a body with points, and its number of rows."""
        is_of_body = np.array([name == body for name, _ in self.labels.values])
        first, count = -1, 0
        for start, stop in self.steps():
            indices = np.flatnonzero(is_of_body[self._spool.read("label", start, stop)])
            first = start + int(indices[0]) if first < 0 and len(indices) else first
            count += len(indices)
        return first, count

    def duplicates(self) -> Iterator[Index]:
        """Yield rows of known poses whose pose, body and target occur in an earlier row; exact, in bounded memory."""
        width = max(len(self.labels.values), 1)
        slab = max(_CELLS // width, 1)
        for first in range(0, len(self.poses), slab):
            yield from self._duplicates_within(first, min(first + slab, len(self.poses)), width)

    def _duplicates_within(self, first: int, last: int, width: int) -> Iterator[Index]:
        cells = np.zeros((last - first) * width, dtype=bool)
        rows = 0
        for _, cell in self._cells(first, last, width):
            cells[cell] = True
            rows += len(cell)
        if int(np.count_nonzero(cells)) == rows:
            return
        cells[:] = False
        for row, cell in self._cells(first, last, width):
            _, position = np.unique(cell, return_index=True)
            again = np.ones(len(cell), dtype=bool)
            again[position] = False
            again |= cells[cell]
            cells[cell] = True
            yield row[again]

    def _cells(self, first: int, last: int, width: int) -> Iterator[tuple[Index, Index]]:
        for start, stop in self.steps():
            pose = self._spool.read("pose", start, stop)
            label = self._spool.read("label", start, stop)
            row = np.arange(start, stop)
            if self._any_unknown or last - first < len(self.poses):
                within = (pose >= first) & (pose < last)
                pose, label, row = pose[within], label[within], row[within]
            yield row, (pose.astype(np.int64) - first) * width + label


class Spool:
    """Columns of int32 in temporary files in ``folder`` (None: the system's default)."""

    def __init__(self, names: tuple[str, ...], folder: Path | None = None) -> None:
        self.rows = 0
        self._files: dict[str, IO[bytes]] = {name: _temporary(name, folder) for name in names}
        self._closed = weakref.finalize(self, _close, tuple(self._files.values()))

    def append(self, **columns: NDArray[np.int32]) -> None:
        """Append rows: all columns, of equal length."""
        for name, values in columns.items():
            self._files[name].write(np.ascontiguousarray(values, dtype=np.int32).data)
        self.rows += len(next(iter(columns.values())))

    def read(self, name: str, start: int, stop: int) -> NDArray[np.int32]:
        """Return one column's rows from ``start`` to before ``stop``."""
        file = self._files[name]
        values = np.empty(max(min(stop, self.rows) - start, 0), dtype=np.int32)
        file.seek(start * values.itemsize)
        file.readinto(values.data.cast("B"))  # type: ignore[attr-defined]
        file.seek(0, 2)
        return values

    def close(self) -> None:
        """Release the disk space."""
        self._closed()


def _temporary(name: str, folder: Path | None) -> IO[bytes]:
    return tempfile.TemporaryFile(prefix=f".{name}-", suffix=".part", dir=folder, buffering=0)


def _close(files: tuple[IO[bytes], ...]) -> None:
    for file in files:
        file.close()
