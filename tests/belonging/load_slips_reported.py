"""Answers of the quality stage to campaigns with a slip: the right one, another one, not detectable, or none."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tests.belonging.load_slips import Made
from tests.stages.line import run_line

RIGHT, RIVAL, OTHER, NO_NAME, HIDDEN, SILENT = "right", "among rivals", "another name", "no name", "hidden", "silent"


@dataclass(frozen=True)
class Reported:
    """Outcome of a slip's report, and the rows of the artifact ``belonging``."""

    how: str
    rows: list[dict[str, Any]]


def judge(folder: Path, made: Made) -> Reported:
    """Run the quality stage on a spoiled campaign and compare what it says with what was done."""
    rows = run_line(folder, "ingest", "qa")[0]["belonging"].to_pylist()
    failing = [row for row in rows if row["state"] == "fails"]
    named = [slip for row in failing for slip in json.loads(row["slips"])]
    rivals = [slip for row in failing for slip in json.loads(row["rivals"])]
    hidden = [slip for row in rows for slip in json.loads(row["hidden_slips"])]
    if any(is_it(slip, made) for slip in named):
        return Reported(RIGHT, rows)
    if any(is_it(slip, made) for slip in rivals):
        return Reported(RIVAL, rows)
    if failing:
        return Reported(OTHER if named else NO_NAME, rows)
    return Reported(HIDDEN if any(may_be(slip, made) for slip in hidden) else SILENT, rows)


def is_it(slip: Mapping[str, Any], made: Made) -> bool:
    """Return True if a reported slip is the one that was made: kind, quantity, size, and exactly its subjects."""
    if slip["kind"] != made.kind or (made.quantities and slip["quantity"] not in made.quantities):
        return False
    size = made.kind not in ("unit", "counted-in-fringes") or np.isclose(slip["factor"], made.factor, rtol=1e-3)
    return bool(size and slip["shift"] == made.shift and set(made.subjects) == set(slip["subjects"]))


def may_be(slip: Mapping[str, Any], made: Made) -> bool:
    """Return True if a slip declared as hidden includes the one that was made."""
    if slip["kind"] != made.kind or slip["quantity"] not in (*made.quantities, "reading", "rows"):
        return False
    whole = not made.subjects and set(slip["subjects"]) <= {"all runs", "any two in all runs"}
    runs = {name for name in made.subjects if name.startswith("run ")}
    here = bool(made.subjects) and (runs or set(made.subjects)) <= set(slip["subjects"])
    return bool((slip["factor"] == 1.0 or np.isclose(slip["factor"], made.factor, rtol=1e-3)) and (whole or here))


def counted(reported: Mapping[tuple[str, str], int]) -> str:
    """One line per slip: how often it was reported how."""
    names = dict.fromkeys(name for name, _ in reported)
    lines = []
    for name in names:
        own = Counter({how: count for (slip, how), count in reported.items() if slip == name})
        lines.append(f"{name:40s} {sum(own.values()):4d}  " + ", ".join(f"{how} {own[how]}" for how in sorted(own)))
    return "\n".join(lines)
