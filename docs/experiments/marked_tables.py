"""Generated tables of a page: each stands between marks, and is replaced in place."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

_END = "\n<!-- end -->"


def renewed(page: str, tables: Mapping[str, Callable[[], str]]) -> str:
    """Return a page with the text between the marks of each table made anew.

    Raises ValueError where the page has no place for one of them.
    """
    for name, make in tables.items():
        before, mark, rest = page.partition(f"<!-- table {name} -->\n")
        if not mark:
            raise ValueError(f"found no place for table {name!r} on the page")
        page = before + mark + make() + _END + rest.partition(_END)[2]
    return page


def renew(page: Path, tables: Mapping[str, Callable[[], str]]) -> None:
    """Renew the tables of a page's file."""
    page.write_text(renewed(page.read_text(encoding="utf-8"), tables), encoding="utf-8")


def table(heads: list[str], rows: list[list[str]]) -> str:
    """Return a table in Markdown; raises ValueError where a row has not a cell for each head."""
    for row in rows:
        if len(row) != len(heads):
            raise ValueError(f"table: found {len(row)} cells under {len(heads)} heads: {row}")
    lines = [heads, ["---"] * len(heads), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)
