"""What to measure next: configurations ready for the machine, or loads ready for the bench."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterable, Iterator, Sequence

import pandas as pd

from truing.report.diagnosis.judged import NOT_TESTABLE, REJECTED, Judged
from truing.report.diagnosis.misses import POINTS, READINGS, compared
from truing.report.numbers import count, printed
from truing.report.page import MOST_ROWS, Listing, Section
from truing.report.tables import LOAD_UNITS, LOADS, Tables, cell, filled

_TITLE = "What to measure next"
_WITHOUT_MECHANISM = "No configurations were computed: without a mechanism nothing says which there are."
_TOLD = ("purpose", "pose", "times", "expected")
# Actuators stand on values of a tenth of a micrometre at best.
_PLACES = 4

_HEADS = ("run", "loads, step by step", "what is read", "conditions", "what it is expected to give")
_STEPS = ("run", "step", "time_s", *LOADS.values(), "channels")


def following(rows: list[Judged], tables: Tables) -> Section:
    """A table of configurations per purpose; where none was computed, what each finding asks for in words."""
    asked = tuple(
        ("next", f"{row.name}: {printed(row.in_short or row.then)}")
        for row in rows
        if row.then and row.verdict not in (REJECTED, NOT_TESTABLE)
    )
    loads = filled(tables, "next_loads")
    if loads is not None:
        return Section("next", _TITLE, _lead_of_loads(loads), listings=_listings_of_loads(loads), said=asked)
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
    bare = ((row[0], *("" if c == "–" else c for c in row[1:-1])) for row in rows[:MOST_ROWS])
    text = _csv(("pose", *columns), bare)
    return Listing(heads, rows, caption=caption, held_by="next_poses.parquet", csv=text)


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


def _csv(heads: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """A table for a spreadsheet, the machine or the bench."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(heads)
    writer.writerows(rows)
    return text.getvalue()


def _lead_of_loads(table: pd.DataFrame) -> str:
    """How many runs there are, and for how many purposes."""
    runs = len(table[["purpose", "run"]].drop_duplicates())
    return (
        f"{count(runs, 'run')} of loads for {count(table['purpose'].nunique(), 'purpose')}. Every run begins with a "
        "zero of its own; the CSV below each table has all steps, with times and loads."
    )


def _listings_of_loads(table: pd.DataFrame) -> tuple[Listing, ...]:
    """A table of runs per purpose."""
    return tuple(_listing_of_loads(str(purpose), own) for purpose, own in table.groupby("purpose", sort=False))


def _listing_of_loads(purpose: str, own: pd.DataFrame) -> Listing:
    rows = tuple(_row(run) for _, run in own.groupby("run", sort=False))
    caption = f"{purpose}: {count(len(rows), 'run')}{_again(own)}"
    return Listing(_HEADS, rows, caption=caption, held_by="next_loads.parquet", csv=_csv(_STEPS, _steps(own)))


def _again(own: pd.DataFrame) -> str:
    """How often a round of all of them is needed; nothing where once is enough, or no number is."""
    times = own["times"].iloc[0]
    return f", {int(times)} times each" if times == times and times > 1 else ""


def _row(run: pd.DataFrame) -> tuple[str, ...]:
    first = run.iloc[0]
    told = [
        cell(first[name]) if first[name] == first[name] and first[name] else "–" for name in ("channels", "conditions")
    ]
    return (str(first["run"]), _loads(run), *told, printed(cell(first["expected"])))


def _loads(run: pd.DataFrame) -> str:
    """The loads of every axis that is loaded, in the order applied."""
    told = [
        f"{axis} {', '.join(f'{value:g}' for value in run[column])} {LOAD_UNITS[axis]}"
        for axis, column in LOADS.items()
        if run[column].ne(0.0).any()
    ]
    return "; ".join(told) or f"none, {len(run)} steps"


def _steps(own: pd.DataFrame) -> Iterator[list[str]]:
    """Every step as it is applied."""
    for row in own[list(_STEPS)].itertuples(index=False):
        yield [cell(value) if isinstance(value, str) else f"{value:g}" for value in row]
