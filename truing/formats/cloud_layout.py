"""The layout that the head of a point cloud announces: which values each point has, how many points, and where."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from truing.formats.raw import Unusable

LONGEST_HEAD = 1 << 16
_MOST_DIGITS = 18  # a number of more is larger than any file


@dataclass(frozen=True)
class ListProperty:
    """A property of a PLY element that is several numbers: the type of their count, and their own."""

    name: str
    count: np.dtype
    item: np.dtype


@dataclass(frozen=True)
class Element:
    """One kind of thing that a PLY file holds, such as vertices or faces; scalar properties by name and type."""

    name: str
    count: int
    properties: tuple[tuple[str, np.dtype] | ListProperty, ...]

    def fits(self, words: list[bytes], vertices: int) -> bool:
        """Whether the words of a line of text can be one of them; faces have corners among the vertices."""
        at = 0
        for part in self.properties:
            is_list = isinstance(part, ListProperty)
            count = _counted(words[at : at + 1]) if is_list else 1
            at += is_list
            if count is None or at + count > len(words):
                return False
            if is_list and self.names_corners(part) and not _are_corners(words[at : at + count], vertices):
                return False
            at += count
        return at == len(words)

    def names_corners(self, part: object) -> bool:
        """Whether a property is the vertices of a face."""
        return (
            self.name == "face" and isinstance(part, ListProperty) and part.name in ("vertex_indices", "vertex_index")
        )

    @property
    def record(self) -> np.dtype | None:
        """The type of one of them in a binary file; None where lists make them differ in size."""
        scalars = [part for part in self.properties if not isinstance(part, ListProperty)]
        return np.dtype(scalars) if len(scalars) == len(self.properties) else None


def _counted(words: list[bytes]) -> int | None:
    return int(words[0]) if words and words[0].isdigit() and len(words[0]) <= _MOST_DIGITS else None


def _are_corners(words: list[bytes], vertices: int) -> bool:
    numbers = [_counted([word]) for word in words]
    return bool(numbers) and all(number is not None and number < vertices for number in numbers)


@dataclass(frozen=True)
class CloudLayout:
    """What a head announces. ``form``: ascii, binary or binary_compressed; ``record``: the type of one point; ``begin``
    and ``lines``: bytes and lines of the head; ``before`` and ``after``: what else a PLY file holds around the points.
    """

    kind: str
    form: str
    record: np.dtype
    points: int
    begin: int
    lines: int
    before: tuple[Element, ...] = ()
    after: tuple[Element, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        """A name for every single number of a point; those of a field of several carry its place from 0."""
        found: list[str] = []
        for name in self.record.names or ():
            width = int(np.prod(self.record[name].shape, dtype=int))
            found += [name] if not self.record[name].shape else [f"{name}[{i}]" for i in range(width)]
        return tuple(found)

    def columns(self, records: NDArray[np.void]) -> list[NDArray]:
        """The points' numbers, an array for each of ``names``: whole ones as int64, others as float64."""
        singles: list[NDArray] = []
        for name in self.record.names or ():
            values = records[name].reshape(len(records), -1)
            singles += [_plain(values[:, i]) for i in range(values.shape[1])]
        return singles


def _plain(values: NDArray) -> NDArray:
    whole = values.dtype.kind in "iu" and values.dtype.str[1:] != "u8"  # uint64 reaches beyond int64
    return np.ascontiguousarray(values, dtype=np.int64 if whole else np.float64)


def head_lines(path: Path) -> list[tuple[list[str], int]]:
    """The words of a file's first lines, each with the byte at which the next line begins.

    Lines end as the first one does, for in binary data any byte may follow the head.
    """
    with path.open("rb") as file:
        head = file.read(LONGEST_HEAD)
    first = min((at for at in (head.find(b"\n"), head.find(b"\r")) if at >= 0), default=len(head))
    end = b"\r\n" if head[first : first + 2] == b"\r\n" else head[first : first + 1] or b"\n"
    found, at = [], 0
    while (stop := head.find(end, at)) >= 0:
        found.append((head[at:stop].decode("latin-1").split(), stop + len(end)))
        at = stop + len(end)
    return found


def announced(words: list[str], kind: str, line: int) -> int:
    """The only number of a line of a head; raises Unusable where there is none."""
    if len(words) != 1 or not words[0].isascii() or not words[0].isdigit():
        raise Unusable(f"a whole {kind} file, which announces a number here", row=line, value=" ".join(words)[:40])
    return int(words[0][:_MOST_DIGITS])


def record_of(fields: list[tuple[str, np.dtype, int]], kind: str) -> np.dtype:
    """The type of one point from names, types and counts; raises Unusable where a name stands twice."""
    names = [name for name, _, _ in fields]
    twice = {name for name in names if names.count(name) > 1} - {"_"}  # which PCD calls bytes that mean nothing
    if twice:
        raise Unusable(f"a whole {kind} file, in which every field has a name of its own", value=sorted(twice)[0])
    titled = [(f"_{i}" if name == "_" else name, *rest) for i, (name, *rest) in enumerate(fields)]
    return np.dtype([(name, one) if count == 1 else (name, one, (count,)) for name, one, count in titled])
