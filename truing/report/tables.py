"""What the sections read: tables by artifact name, and how single cells are put."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import pandas as pd

Tables = Mapping[str, "pd.DataFrame"]


def filled(tables: Tables, name: str) -> pd.DataFrame | None:
    """The table, or None where the run has none or an empty one."""
    table = tables.get(name)
    return table if table is not None and len(table) else None


def cell(value: object) -> str:
    """A cell's text; nothing for what is missing."""
    return "" if value is None or value != value else str(value)
