"""What to measure next on a bench: runs of loads, a row each, with all of their steps for whoever takes them along."""

from __future__ import annotations

import csv
import io
from typing import TYPE_CHECKING

from truing.report.load_steps import LOAD_UNITS, LOADS
from truing.report.numbers import count, printed
from truing.report.page import Listing
from truing.report.tables import cell

if TYPE_CHECKING:
    import pandas as pd

_HEADS = ("run", "loads, step by step", "what is read", "conditions", "what it is expected to give")
_STEPS = ("run", "step", "time_s", *LOADS.values(), "channels")


def lead_of_loads(table: pd.DataFrame) -> str:
    """How many runs there are, and for how many purposes."""
    runs = len(table[["purpose", "run"]].drop_duplicates())
    return (
        f"{count(runs, 'run')} of loads for {count(table['purpose'].nunique(), 'purpose')}. Every run begins with a "
        "zero of its own; the CSV below each table has all steps, with times and loads."
    )


def listings_of_loads(table: pd.DataFrame) -> tuple[Listing, ...]:
    """A table of runs per purpose."""
    return tuple(_listing(str(purpose), own) for purpose, own in table.groupby("purpose", sort=False))


def _listing(purpose: str, own: pd.DataFrame) -> Listing:
    rows = tuple(_row(run) for _, run in own.groupby("run", sort=False))
    caption = f"{purpose}: {count(len(rows), 'run')}{_again(own)}"
    return Listing(_HEADS, rows, caption=caption, held_by="next_loads.parquet", csv=_csv(own))


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


def _csv(own: pd.DataFrame) -> str:
    """The steps, for a spreadsheet or the bench."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(_STEPS)
    writer.writerows(
        [cell(value) if isinstance(value, str) else f"{value:g}" for value in row]
        for row in own[list(_STEPS)].itertuples(index=False)
    )
    return text.getvalue()
