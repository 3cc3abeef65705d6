"""What the sections read: tables by artifact name, and how single cells are put."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import pandas as pd

WHY_NOT = "why_not"  # attribute of a table: why its stage evaluated nothing; empty where it did
Tables = Mapping[str, "pd.DataFrame"]


def filled(tables: Tables, name: str) -> pd.DataFrame | None:
    """The table, or None where the run has none or an empty one."""
    table = tables.get(name)
    return table if table is not None and len(table) else None


def reason(tables: Tables, name: str) -> str:
    """Why the stage that left a table did not evaluate it, as it said itself; empty where it said no such thing."""
    why = str(tables[name].attrs.get(WHY_NOT, "")) if name in tables else ""
    return f"{why[:1].upper()}{why[1:]}{'' if why[-1] == '?' else '.'}" if why else ""


def cell(value: object) -> str:
    """A cell's text; nothing for what is missing."""
    return "" if value is None or value != value else str(value)
