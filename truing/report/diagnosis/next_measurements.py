"""Next measurements: configurations for the machine, or loads for the bench."""

from __future__ import annotations

import csv
import io
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence

import pandas as pd

from truing.report.column_heads import CAUSE, Head, schema_head
from truing.report.diagnosis.assessed_causes import AssessedCause
from truing.report.diagnosis.next_steps import NextStep, next_steps
from truing.report.diagnosis.prediction_errors import part_names
from truing.report.numbers import capitalised, count_text, printed
from truing.report.page import MOST_ROWS, Listing, ReportSection
from truing.report.tables import LOAD_UNITS, LOADS, Tables, cell, table_or_none
from truing.schemas.needs import Need

_RHO = re.compile(r"rho\d+_mm")  # reading of a leg's actuator
_TITLE = "What to measure next"
_WITHOUT_MECHANISM = "No configurations were computed: without a mechanism, possible configurations are not known."
_OF_CHAIN = "No poses were computed: no finding or open question needs them, or distances were measured."
_IN_WORDS = "No poses were computed: the list says what to measure."
_UNCHECKED = "New poses lie within the range of the measured readings, or of [workspace]; check them for collisions."
_OTHER_COLUMNS = (
    *("purpose", "need", "pose", "measurements", "duration_s", "expected"),
    *("sigma_now", "sigma_expected", "unit", "odds_expected"),
)
# Actuators are set to a tenth of a micrometre at best.
_PLACES = 4

_TIMES = schema_head("times")
_CONDITIONS = schema_head("conditions")
_EXPECTED = Head("expected result", "Uncertainty or probability after this row and all rows above it are measured.")
_HEADS = (
    Head("run", "Number of the proposed run of loads."),
    _TIMES,
    Head("loads, step by step", "Loads to apply in this order; each step lasts until the readings are taken."),
    Head("channels", "Channels to read in this run."),
    _CONDITIONS,
    Head("repeats", "Measured runs that this one repeats; a dash if it repeats none."),
    _EXPECTED,
)
_KNOWN_HEADS = {
    "times": _TIMES,
    "conditions": _CONDITIONS,
    "repeat_of": Head("repeats", "Measured pose that this one repeats; a dash if it repeats none."),
}
_WHAT_TO_MEASURE = Head("what to measure", "Change of the measurement that lets this cause be tested.")
_STEPS = ("run", "step", "time_s", *LOADS.values(), "channels")
_SERVED = {
    Need.REQUIREMENT: ("requirement is undecided", "requirements are undecided"),
    Need.RIVAL: ("question is open", "questions are open"),
    Need.PRECISION: ("finding can be confirmed or refined", "findings can be confirmed or refined"),
    Need.TESTABLE: ("kind of cause could not be tested", "kinds of causes could not be tested"),
}
_CAPTION = "Not testable with these data, and what to measure for it"


def requested_measurements(rows: list[AssessedCause], tables: Tables) -> ReportSection:
    """Return the section of requested measurements by need, with a table of configurations or runs for each purpose."""
    steps = next_steps(rows, tables)
    asked = tuple(
        ("next", f"{capitalised(step.purpose)}: {step.short_text}") for step in steps if step.need != Need.TESTABLE
    )
    untested = tuple((step.purpose, step.words) for step in steps if step.need == Need.TESTABLE)
    listings = _computed(tables)
    if untested:
        listings += (Listing((CAUSE, _WHAT_TO_MEASURE), untested, (), _CAPTION, True, "next_measurements.parquet"),)
    lead = _opening_sentences(steps, tables)
    in_words = part_names(tables).is_of_readings or "joints" in tables
    state = "" if listings or (asked and in_words) else "not evaluated"
    return ReportSection("next", _TITLE, lead, listings=listings, statements=asked, state=state)


def _opening_sentences(steps: list[NextStep], tables: Tables) -> str:
    """Return the number of requests and their purposes; or why no configurations were computed."""
    counts = Counter(step.need for step in steps)
    served = [f"{counts[need]} {words[counts[need] > 1]}" for need, words in _SERVED.items() if counts[need]]
    text = f"Most urgent first: {', '.join(served)}." if served else ""
    if table_or_none(tables, "next_loads") is not None:
        begins = "Every run starts with its own zero. The CSV below each table has all steps, with times and loads."
        return f"{text} {begins}".strip()
    if table_or_none(tables, "next_poses") is not None:
        unchecked = f" {_UNCHECKED}" if "joints" in tables else ""
        return f"{text} The tables list the readings to set.{unchecked}".strip()
    legless = part_names(tables).is_of_points and "pulls" not in tables
    why = (_IN_WORDS if served else _OF_CHAIN) if "joints" in tables else _WITHOUT_MECHANISM
    return f"{text} {why if legless else part_names(tables).not_planned}".strip()


def _computed(tables: Tables) -> tuple[Listing, ...]:
    """Return a table per purpose."""
    for name, listing in (("next_loads", _listing_of_loads), ("next_poses", _listing)):
        if (table := table_or_none(tables, name)) is not None:
            return tuple(listing(str(purpose), group) for purpose, group in table.groupby("purpose", sort=False))
    return ()


def _listing(purpose: str, table: pd.DataFrame) -> Listing:
    table = table.astype({"times": "Int64"}) if "times" in table else table
    columns = _columns(table)
    rows = tuple(
        (str(r["pose"]), *(_cell(r[c]) for c in columns), printed(cell(r["expected"])))
        for r in table.to_dict("records")
    )
    heads = (Head("pose", "Number of the proposed pose."), *map(_head, columns), _EXPECTED)
    noun = "configuration" if any(_RHO.fullmatch(name) for name in columns) else "pose"  # of legs, or of joints
    caption = f"{purpose}: {count_text(len(table), noun)}{_in_all(table, 'pose', 'measurement')}"
    bare = ((row[0], *("" if c == "–" else c for c in row[1:-1])) for row in rows[:MOST_ROWS])
    text = _csv(("pose", *columns), bare)
    return Listing(heads, rows, caption=caption, held_by="next_poses.parquet", csv=text)


def _in_all(table: pd.DataFrame, unit: str, noun: str = "") -> str:
    """Return the total, ``, 91 measurements in all``; empty where each is measured once, or no number is enough."""
    total = table["measurements"].fillna(0).iloc[0] if "measurements" in table else 0
    return f", {count_text(int(total), noun or unit)} in all" if total > table[unit].nunique() else ""


def _columns(table: pd.DataFrame) -> list[str]:
    """Return columns of settings, readings first by leg, without those that need no setting."""
    names = [str(c) for c in table.columns if c not in _OTHER_COLUMNS and table[c].notna().any()]
    readings = sorted(filter(_RHO.fullmatch, names), key=lambda name: int(name[3:-3]))
    return [*(c for c in ("times",) if c in names), *readings, *(c for c in names if c not in (*readings, "times"))]


def _head(name: str) -> Head:
    """Return the head of a setting; columns of the campaign keep their names, with their units."""
    return _KNOWN_HEADS.get(name) or Head(name, "Value to set or command, in the unit at the end of the name.")


def _cell(value: object) -> str:
    """Return a setting as the machine takes it, without an exponent."""
    if isinstance(value, float):
        return f"{value:.{_PLACES}f}" if value == value else "–"
    return cell(value)


def _csv(heads: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Return a CSV table for a spreadsheet, the machine or the bench."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(heads)
    writer.writerows(rows)
    return text.getvalue()


def _listing_of_loads(purpose: str, table: pd.DataFrame) -> Listing:
    rows = tuple(_row(run) for _, run in table.groupby("run", sort=False))
    caption = f"{purpose}: {count_text(len(rows), 'different run')}{_in_all(table, 'run')}"
    return Listing(_HEADS, rows, caption=caption, held_by="next_loads.parquet", csv=_csv(_STEPS, _steps(table)))


def _row(run: pd.DataFrame) -> tuple[str, ...]:
    first = run.iloc[0]
    times = "–" if pd.isna(first["times"]) else str(int(first["times"]))
    read, how, again = (cell(first.get(name)) or "–" for name in ("channels", "conditions", "repeat_of"))
    return (str(first["run"]), times, _loads(run), read, how, again, printed(cell(first["expected"])))


def _loads(run: pd.DataFrame) -> str:
    """Return the loads of every loaded axis, in the order of application."""
    texts = [
        f"{axis} {', '.join(f'{value:g}' for value in run[column])} {LOAD_UNITS[axis]}"
        for axis, column in LOADS.items()
        if run[column].ne(0.0).any()
    ]
    return "; ".join(texts) or f"none, {len(run)} steps"


def _steps(table: pd.DataFrame) -> Iterator[list[str]]:
    """Return every step in the order of application."""
    for row in table[list(_STEPS)].itertuples(index=False):
        yield [cell(value) if isinstance(value, str) else f"{value:g}" for value in row]
