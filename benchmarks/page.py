"""Table of all benchmarks, and docs/benchmarks.md from the recorded rows."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import asdict
from pathlib import Path

from benchmarks.collection import BENCHMARKS, Collected, Record
from benchmarks.rows import Row
from docs.experiments import marked_tables

_PROJECT = Path(__file__).resolve().parents[1]
KEPT = _PROJECT / "docs" / "experiments" / "benchmark_rows.jsonl"
PAGE = _PROJECT / "docs" / "benchmarks.md"
_HEADS = ["what", "ours", "best peer", "ratio", "limit", "holds", "unmeasured", "time", "date", "machine"]
_NONE = "–"


def table(records: Sequence[Record]) -> str:
    """The table in Markdown, with its machines below."""
    machines = list(dict.fromkeys(record.machine for record in records))
    rows = [
        [
            *_cells(record.row),
            *(record.clock, record.date, f"{machines.index(record.machine) + 1}, load {record.load:g}"),
        ]
        for record in records
    ]
    legend = [f"{number}. {machine}" for number, machine in enumerate(machines, start=1)]
    return "\n".join([marked_tables.table(_HEADS, rows), "", "Machines:", "", *legend])


def _cells(row: Row) -> list[str]:
    best = row.best
    return [
        row.what,
        _value(row.value, row.unit),
        _NONE if best is None or best.value is None else f"{best.name}, {_value(best.value, row.unit)}",
        _NONE if best is None or best.ratio is None else f"{best.ratio:.3g}",
        _limit(row),
        str(row.holds),
        ", ".join(row.unmeasured) or _NONE,
    ]


def _limit(row: Row) -> str:
    sign = "≥" if row.more_is_better else "≤"
    limits = [] if row.limit is None else [f"{sign} {_value(row.limit, row.unit)}"]
    limits += [] if row.least_ratio is None else [f"ratio ≥ {row.least_ratio:g}"]
    return ", ".join(limits) or _NONE


def _value(value: float, unit: str) -> str:
    return f"{value:.3g} {unit}".strip() if value < 1000 else f"{value:,.0f} {unit}".strip()


def kept() -> list[Record]:
    """Rows of earlier calls."""
    lines = KEPT.read_text(encoding="utf-8").splitlines() if KEPT.exists() else []
    return [_record(line) for line in lines]


def _record(line: str) -> Record:
    written = json.loads(line)
    return Record(**{**written, "row": Row.read(written["row"])})


def renewed(before: Iterable[Record], found: Iterable[Collected]) -> list[Record]:
    """Rows with those of each benchmark in ``found`` in place of its older ones, in the order of the benchmarks."""
    new = {one.name: one.records for one in found}
    records = [record for record in before if record.benchmark not in new]
    records += [record for own in new.values() for record in own]
    return sorted(records, key=lambda record: BENCHMARKS.index(record.benchmark))


def whole(records: Sequence[Record]) -> str:
    """The table of the page, and the benchmarks that it lacks."""
    absent = [name for name in BENCHMARKS if name not in {record.benchmark for record in records}]
    note = f"\n\nNot measured for this page yet: {', '.join(absent)}." if absent else ""
    return table(records) + note


def write_page(before: Iterable[Record], found: Iterable[Collected]) -> None:
    """Keep new rows, and make the table of the page anew."""
    records = renewed(before, found)
    lines = (json.dumps(asdict(record), ensure_ascii=False) + "\n" for record in records)
    KEPT.write_text("".join(lines), encoding="utf-8")
    marked_tables.renew(PAGE, {"benchmarks": lambda: whole(records)})
