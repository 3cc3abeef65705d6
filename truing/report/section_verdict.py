"""Verdict on one section of the page, and its mark of colour."""

from __future__ import annotations

from dataclasses import dataclass

import pandas as pd

from truing.belonging.relation import RelationState
from truing.report.tables import Tables, table_or_none
from truing.schemas.verdict import ReasonCode

_MARKS = {
    RelationState.OK: "pass",
    RelationState.ATTENTION: "warn",
    RelationState.FAILS: "fail",
    RelationState.NOT_TESTED: "none",
}


@dataclass(frozen=True)
class SectionVerdict:
    """State of a section, code and sentence of its reason, and the figure behind the state."""

    section: str
    state: RelationState
    reason_code: ReasonCode
    explanation: str
    value: float | None = None
    unit: str | None = None
    limit: float | None = None

    @property
    def mark(self) -> str:
        """Mark of colour: pass, warn, fail, none, or that of a result: found, measured."""
        return self.reason_code.result or _MARKS[self.state]

    @property
    def word(self) -> str:
        """Word of the section: its kind of result, found or measured, or else its state."""
        return self.reason_code.result or str(self.state)


def verdict_rows(tables: Tables) -> dict[str, SectionVerdict]:
    """Return the rows of verdict.parquet by section, campaign first; none where the run has no such table."""
    table = table_or_none(tables, "verdict")
    return {} if table is None else {str(row["section"]): _row(row) for row in table.to_dict("records")}


def _row(row: dict[str, object]) -> SectionVerdict:
    value, limit = (None if pd.isna(row[name]) else float(str(row[name])) for name in ("value", "limit"))
    unit = row["unit"]
    return SectionVerdict(
        str(row["section"]),
        RelationState(str(row["state"])),
        ReasonCode(str(row["reason_code"])),
        str(row["explanation"]),
        value,
        unit if isinstance(unit, str) else None,
        limit,
    )
