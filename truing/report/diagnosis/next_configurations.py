"""What to measure next: configurations ready for the machine, or loads ready for the bench."""

from __future__ import annotations

import csv
import io
import re
from typing import TYPE_CHECKING

from truing.report.diagnosis.compared import POINTS, READINGS, compared
from truing.report.diagnosis.judged import Judged
from truing.report.diagnosis.next_loads import lead_of_loads, listings_of_loads
from truing.report.numbers import count, printed
from truing.report.page import MOST_ROWS, Listing, Section
from truing.report.tables import Tables, cell, filled

if TYPE_CHECKING:
    import pandas as pd

_TITLE = "What to measure next"
_WITHOUT_MECHANISM = "No configurations were computed: without a mechanism nothing says which there are."
_TOLD = ("purpose", "pose", "times", "expected")
# Actuators stand on values of a tenth of a micrometre at best.
_PLACES = 4


def following(rows: list[Judged], tables: Tables) -> Section:
    """A table of configurations per purpose; where none was computed, what each finding asks for in words."""
    asked = tuple(
        ("next", f"{row.name}: {printed(row.in_short or row.then)}")
        for row in rows
        if row.then and row.verdict != "rejected"
    )
    loads = filled(tables, "next_loads")
    if loads is not None:
        return Section("next", _TITLE, lead_of_loads(loads), listings=listings_of_loads(loads), said=asked)
    table = filled(tables, "next_poses")
    if table is None:
        state = "" if asked and compared(tables) is READINGS else "not evaluated"
        legless = compared(tables) is POINTS and "pulls" not in tables
        why = _WITHOUT_MECHANISM if legless else compared(tables).not_planned
        return Section("next", _TITLE, why, said=asked, state=state)
    parts = [(str(purpose), own) for purpose, own in table.groupby("purpose", sort=False)]
    lead = (
        f"{count(len(table), 'configuration')} for {count(len(parts), 'purpose')}, readings as the machine takes them."
    )
    return Section("next", _TITLE, lead, listings=tuple(_listing(*part) for part in parts), said=asked)


def _listing(purpose: str, own: pd.DataFrame) -> Listing:
    columns = _columns(own)
    rows = tuple(
        (str(r["pose"]), *(_cell(r[c]) for c in columns), printed(cell(r["expected"]))) for r in own.to_dict("records")
    )
    heads = ("pose", *columns, "what it is expected to give")
    caption = f"{purpose}: {count(len(own), 'configuration')}"
    return Listing(heads, rows, caption=caption, held_by="next_poses.parquet", csv=_csv(own, columns))


def _columns(own: pd.DataFrame) -> list[str]:
    """Columns of settings, readings first and in the order of the legs, without those that nobody has to set."""
    names = [str(c) for c in own.columns if c not in _TOLD and own[c].notna().any()]
    readings = sorted((c for c in names if re.fullmatch(r"rho\d+_mm", c)), key=lambda c: int(c[3:-3]))
    return [*readings, *(c for c in names if c not in readings)]


def _cell(value: object) -> str:
    """A setting as the machine takes it, without an exponent."""
    if isinstance(value, float):
        return f"{value:.{_PLACES}f}" if value == value else "–"
    return cell(value)


def _csv(own: pd.DataFrame, columns: list[str]) -> str:
    """The same as a table of configurations, for a spreadsheet or the machine."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(("pose", *columns))
    for row in own.head(MOST_ROWS).to_dict("records"):
        writer.writerow((row["pose"], *("" if (c := _cell(row[name])) == "–" else c for name in columns)))
    return text.getvalue()
