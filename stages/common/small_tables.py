"""Small tables of the campaign as read: rows, file and what was left out."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from truing.formats.faultlog import FaultLog
from truing.formats.gather import Gathered

if TYPE_CHECKING:
    import pyarrow as pa


@dataclass
class SmallTable:
    """A table of the run, and how many raw rows were left out of it, by (file, reason)."""

    table: pa.Table
    left_out: dict[tuple[str, str], int] = field(default_factory=dict)
    file: str = field(default="", kw_only=True)


def once(found: Gathered, log: FaultLog, key: tuple[str, ...]) -> None:
    """A fault at every row whose key stood in a row before."""
    import pyarrow as pa

    if any(name not in found.table.column_names for name in key):
        return
    rows = found.table.select(key).append_column("row", pa.array(np.arange(len(found.table))))
    first = rows.group_by(list(key)).aggregate([("row", "min")]).column("row_min")
    again = np.ones(len(rows), dtype=bool)
    again[np.asarray(first)] = False
    found.fault(log, again, key[-1], f"every {', '.join(key)} once")
