"""Whether quality checks found readings that are not what they are said to be: no cause is told from those."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import pyarrow as pa

# Checks of what a table says its numbers are. What they find would be named as causes as large as it is.
_CHECKS = ("units", "signs", "channels-exchanged")


def mistaken(tables: Mapping[str, pa.Table]) -> str:
    """The first such verdict that nobody accepted, and how many more there are; empty where there is none."""
    rows = tables["qa"].to_pylist() if "qa" in tables else []
    failed = [row for row in rows if row["check"] in _CHECKS and row["verdict"] == "fail" and not row["accepted"]]
    if not failed:
        return ""
    more = f"; {len(failed) - 1} more under Quality" if len(failed) > 1 else ""
    return f"needs numbers that are what their table says: {failed[0]['message']} (check {failed[0]['check']}{more})"
