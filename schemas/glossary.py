"""Glossary: every term of the project with symbol, unit, meaning and place of definition.

`glossary.csv` holds these sentences; docs/glossary.md is written from it.
"""

from __future__ import annotations

import csv
from dataclasses import dataclass
from functools import cache
from pathlib import Path

_FILE = Path(__file__).with_name("glossary.csv")
_HEAD = """# Glossary

This page defines the terms of the project, with symbol and unit. The last column names the page that
explains a term, and the module that defines or computes it. Frames, signs and orders: [conventions](conventions.md).
Written by `python -m schemas` from `schemas/glossary.csv`.

| term | symbol | unit | meaning | where |
| --- | --- | --- | --- | --- |
"""


@dataclass(frozen=True)
class Term:
    """A term and its meaning in one sentence; symbol and unit may be empty.

    ``module``: dotted name of the code; ``page``: path below docs/. At least one of the two is given.
    """

    term: str
    symbol: str
    unit: str
    meaning: str
    module: str
    page: str


@cache
def glossary() -> tuple[Term, ...]:
    """All terms in alphabetical order."""
    with _FILE.open(encoding="utf-8", newline="") as stream:
        return tuple(Term(**row) for row in csv.DictReader(stream))


def glossary_page() -> str:
    """The glossary page as Markdown."""
    return _HEAD + "".join(f"{_row(entry)}\n" for entry in glossary())


def _row(entry: Term) -> str:
    page = f"[{entry.page.removesuffix('.md')}]({entry.page})" if entry.page else ""
    module = f"`{entry.module}`" if entry.module else ""
    where = ", ".join(part for part in (page, module) if part)
    cells = (entry.term, entry.symbol, entry.unit, entry.meaning.replace("[[accept]]", "`[[accept]]`"), where)
    return f"| {' | '.join(cells)} |"
