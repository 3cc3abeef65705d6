"""A raw file that is read at once: its columns by name, as the one batch that they are."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from truing.formats.raw import RawBatch, Unusable, Wanted, consecutive

_LARGEST = 2.0**53


def one_batch(
    columns: Mapping[str, Sequence[Any] | Any],
    wanted: Wanted,
    unit: str | None = None,
    lines: Sequence[int] | None = None,
) -> Iterator[RawBatch]:
    """The columns that are wanted of a file, all of them equally long; ``unit`` is that of its coordinates, ``lines``
    where each row stands in a text, from 1.

    Raises Unusable where there is no row.
    """
    import pyarrow as pa

    rows = len(next(iter(columns.values())))
    if not rows:
        raise Unusable("at least one row of this table; the file holds none")
    kinds = wanted(tuple(columns), unit)
    if kinds is None:
        return
    records = consecutive(0, rows) if lines is None else np.asarray(lines, dtype=np.int64) - 1
    values = list(columns.values())
    yield RawBatch({position: pa.array(values[position]) for position in kinds}, records)


def whole_numbers(values: NDArray[np.float64], what: str, rows: Sequence[int] | None = None) -> NDArray[np.int64]:
    """Numbers of points, images and cameras, and of pixels, as they are; ``rows`` where each stands in a text, from 1.

    Raises Unusable at the first that is none.
    """
    strange = np.flatnonzero(~((values == np.floor(values)) & (np.abs(values) < _LARGEST)))
    if len(strange):
        row = None if rows is None else int(rows[strange[0]])
        raise Unusable(f"whole numbers of {what}", row=row, value=f"{values[strange[0]]:g}")
    return values.astype(np.int64)
