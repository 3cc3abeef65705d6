"""Positioning runs of an axis in files of Renishaw's software (.rtl): targets, then deviations."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa

from truing.formats.raw import RawBatch, Unusable, Wanted, consecutive
from truing.schemas.mapping import FileMapping

_COLUMNS = ("pass", "number", "target", "direction", "cycle", "deviation", "position")
_LARGEST = 16 << 20
_UM = 1e-3  # mm; targets are in mm, deviations in um
_ROW = re.compile(r"(\d+)\s+(\d+)\s+([-+]?\d+(?:[.,]\d*)?(?:[eE][-+]?\d+)?)")


@dataclass(frozen=True)
class _Approach:
    """One line of deviations: pass, target (from 1), and deviation of the axis, um."""

    line: int
    run: int
    number: int
    deviation: float


def read_rtl(path: Path, wanted: Wanted, entry: FileMapping) -> Iterator[RawBatch]:
    """Yield one row per approach, in the order of the file; raises Unusable for other or damaged files."""
    lines = _lines(path, entry.encoding)
    kinds = wanted(_COLUMNS, None)
    if kinds is None:
        return
    targets = _targets(lines)
    approaches = list(_approaches(lines, len(targets)))
    directions = _approach_of_pass(approaches, targets)
    at = np.array([targets[a.number - 1] for a in approaches])
    off = np.array([a.deviation for a in approaches])
    values = (
        [a.run for a in approaches],
        [a.number for a in approaches],
        at,
        [directions[a.run][0] for a in approaches],
        [directions[a.run][1] for a in approaches],
        off,
        at + off * _UM,
    )
    columns = {i: pa.array(values[i]) for i in kinds}
    yield RawBatch(columns, consecutive(0, len(approaches)))


def _lines(path: Path, encoding: str) -> list[str]:
    with path.open("rb") as stream:
        content = stream.read(_LARGEST + 1)
    lines = [line.strip() for line in content[:_LARGEST].decode(encoding, errors="replace").splitlines()]
    if len(content) > _LARGEST or "TARGET DATA::" not in lines or "DEVIATIONS::" not in lines:
        raise Unusable("a file of positioning runs with the sections TARGET DATA:: and DEVIATIONS::")
    return lines


def _targets(lines: list[str]) -> list[float]:
    """Return the target positions of the axis, mm: the numbers below ``Targets`` up to the next word."""
    first = next((i + 1 for i, line in enumerate(lines) if re.match(r"Targets\s*:", line)), None)
    if first is None:
        raise Unusable("a list Targets :", row=lines.index("TARGET DATA::") + 1)
    targets_mm: list[float] = []
    for line in lines[first:]:
        if line and not re.match(r"[-+.\d]", line):
            break
        targets_mm += [_number(word, first + 1) for word in line.split()]
    text = next((line for line in lines if line.startswith("Target-count")), "")
    count = re.search(r"\d+", text)
    if count is not None and int(count[0]) != len(targets_mm):
        raise Unusable(f"{count[0]} targets, as Target-count says", row=first + 1, value=f"{len(targets_mm)} targets")
    if not targets_mm:
        raise Unusable("at least one target", row=first + 1)
    return targets_mm


def _approaches(lines: list[str], targets: int) -> Iterator[_Approach]:
    first = lines.index("DEVIATIONS::") + 1
    for number, line in enumerate(lines[first:], start=first + 1):
        if line.endswith("::"):
            return
        if not line or line.startswith("Run Target Data"):
            continue
        row = _ROW.fullmatch(line)
        if row is None:
            raise Unusable("three numbers: pass, target, deviation", row=number, value=line[:80])
        if not 1 <= int(row[2]) <= targets:
            raise Unusable(f"a target from 1 to {targets}", row=number, value=row[2])
        yield _Approach(number, int(row[1]), int(row[2]), _number(row[3], number))


def _approach_of_pass(approaches: list[_Approach], targets: list[float]) -> dict[int, tuple[str, int]]:
    """Return direction and cycle of each pass: targets ascend or descend; cycles count per direction."""
    if not approaches:
        raise Unusable("at least one line of deviations")
    passes: dict[int, list[_Approach]] = {}
    for approach in approaches:
        passes.setdefault(approach.run, []).append(approach)
    done: Counter[str] = Counter()
    result = {}
    for run, passes_of_run in passes.items():
        steps = np.diff([targets[a.number - 1] for a in passes_of_run])
        if not len(steps) or not (np.all(steps > 0) or np.all(steps < 0)):
            expected = "targets that follow each other upwards or downwards within a pass, two at least"
            raise Unusable(expected, row=passes_of_run[0].line, value=f"pass {run}")
        direction = "forward" if steps[0] > 0 else "backward"
        done[direction] += 1
        result[run] = direction, done[direction]
    return result


def _number(word: str, row: int) -> float:
    try:
        return float(word.replace(",", "."))
    except ValueError:
        raise Unusable("a number", row=row, value=word[:40]) from None
