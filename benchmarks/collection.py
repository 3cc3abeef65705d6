"""Runs of benchmarks in separate processes, with the rows that they record."""

from __future__ import annotations

import importlib
import json
import os
import platform
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

from benchmarks.rows import FILE, Row
from benchmarks.timing import PROCESSOR_TIME

# They take hours and have pages of their own; the table of all leaves them out.
STUDIES = ("blind", "power_agreement")


def with_smallest_size() -> tuple[str, ...]:
    """Names of the modules that define ``SMALLEST``, which every benchmark does; none is imported."""
    files = sorted(Path(__file__).parent.glob("*.py"))
    return tuple(file.stem for file in files if "\nSMALLEST = " in file.read_text(encoding="utf-8"))


BENCHMARKS = tuple(name for name in with_smallest_size() if name not in STUDIES)


@dataclass(frozen=True)
class Record:
    """A row, with its benchmark, the day, the machine and the load of that machine before it began."""

    benchmark: str
    date: str
    machine: str
    load: float
    clock: str  # what times are of: wall, or processor
    row: Row


@dataclass(frozen=True)
class Collected:
    """One benchmark: its exit code and the rows that it left."""

    name: str
    exit_code: int
    records: tuple[Record, ...]


def smallest_words(name: str) -> tuple[str, ...]:
    """Arguments of the smallest size of a benchmark."""
    words: tuple[str, ...] = importlib.import_module(f"benchmarks.{name}").SMALLEST
    return words


def collected(
    name: str, *, smallest: bool = False, words: Sequence[str] = (), processor_time: bool = False
) -> Collected:
    """Run a benchmark in a process of its own, with its output shown."""
    print(f"\n=== {name} ===", flush=True)
    load = os.getloadavg()[0] if hasattr(os, "getloadavg") else float("nan")
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "rows.jsonl"
        given = (*(smallest_words(name) if smallest else ()), *words)
        command = [sys.executable, "-m", f"benchmarks.{name}", *given]
        further = {FILE: str(file), **({PROCESSOR_TIME: "1"} if processor_time else {})}
        code = subprocess.run(command, env={**os.environ, **further}, check=False).returncode
        lines = file.read_text(encoding="utf-8").splitlines() if file.exists() else []
    clock = "processor" if processor_time else "wall"
    date = datetime.now(UTC).date().isoformat()
    rows = [Row.read(json.loads(line)) for line in lines]
    if smallest:
        rows = [replace(row, least_ratio=None, limit=None) for row in rows]  # limits are those of full sizes
    return Collected(name, code, tuple(Record(name, date, machine(), round(load, 1), clock, row) for row in rows))


def machine() -> str:
    """Number and model of the processors that this process may use, and the version of Python."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    info = Path("/proc/cpuinfo")
    lines = info.read_text(encoding="utf-8").splitlines() if info.exists() else []
    model = next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), "")
    return f"{cores} × {model or platform.machine()}, Python {platform.python_version()}"
