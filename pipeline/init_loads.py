"""Files with the same loads, for `truing init`: each load step is read once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from truing.arrays import Array
from truing.formats.raw_tables import WRENCH
from truing.pipeline.init_preview import batches
from truing.schemas.faults import CampaignFaults

if TYPE_CHECKING:
    import pyarrow as pa

    from truing.formats.guess import Guess
    from truing.pipeline.init_entries import RawGroup

_File = tuple["RawGroup", "Guess"]
_ROUNDING = 1e-6  # of the largest load: digits that a second program writes
_BETWEEN = 0.2137  # loads are round numbers: without it, many lie where a number is rounded up or down
_ALIKE = 1e3  # times the rounding: loads that differ by less are ordered by the other components


def with_loads_once(folder: Path, files: Sequence[_File]) -> list[_File]:
    """Leave out a file of loads without signals, if another file holds the same loads; copies of it as well."""
    loads = [_loads(folder, group, guess) for group, guess in files]
    result: list[_File] = []
    for place, (group, guess) in enumerate(files):
        without_loads = [
            other
            for other in range(len(files))
            if other != place and _are_equal(loads[place], loads[other]) and not _has_signals(guess)
        ]
        first = next(
            (o for o in without_loads if _has_signals(files[o][1])), next((o for o in without_loads if o < place), None)
        )
        if first is not None:
            what = "with signals" if _has_signals(files[first][1]) else "as well"
            note = f"not read, because {files[first][0].glob} holds the same {len(loads[place])} loads {what}"
            guess = replace(guess, table=None, notes=(note,), known=True)
        result.append((group, guess))
    return result


def _has_signals(guess: Guess) -> bool:
    named = {*guess.mapping.get("columns", {}), *guess.columns}
    return any(name.startswith(("v1_mv", "shown_")) for name in named)


def _loads(folder: Path, group: RawGroup, guess: Guess) -> Array:
    """Loads (N, 6) of a file in N and N m; none (0, 6) of a file that holds no loads."""
    rows = np.zeros((0, len(WRENCH)))
    if guess.table != "signals" or guess.known or group.count > 1:
        return rows
    try:
        read = [
            np.column_stack([_numbers(batch.columns.get(name), batch.rows) for name in WRENCH])
            for batch in batches(folder, group.example, "signals", "interferometer", guess.mapping)
        ]
    except CampaignFaults:
        return rows
    return np.vstack([rows, *read])


def _numbers(column: pa.Array | None, count: int) -> Array:
    return np.zeros(count) if column is None else np.array(column.to_pylist(), dtype=np.float64)


def _are_equal(first: Array, second: Array) -> bool:
    """True if two files hold the same loads, in any order."""
    if first.shape != second.shape or not first.any():
        return False
    unit = _ROUNDING * np.abs(first).max()
    return bool((np.abs(_sorted(first / unit) - _sorted(second / unit)) <= 1.0).all())


def _sorted(loads: Array) -> Array:
    """Loads (N, 6), over the rounding, in an order of their own that a rounding does not change."""
    return np.asarray(loads[np.lexsort(np.round(loads / _ALIKE + _BETWEEN).T[::-1])])
