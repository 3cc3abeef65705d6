"""Positions in a program of FANUC (.LS): joints of each ``P[n]``, over several lines."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

from truing.formats.raw import RawBatch, Unusable, Wanted, one_batch
from truing.schemas.mapping import FileMapping

_LARGEST = 16 << 20
_POSITION = re.compile(r"P\[(\d+)(?:\s*:[^\]]*)?\]\s*\{")
_JOINT = re.compile(r"\bJ([1-9])\s*=\s*([-+]?\d*\.?\d+)\s*(deg|mm)")
_GROUP = re.compile(r"\bGP(\d+)\s*:")
_JOINTS = 6


def read_fanuc(path: Path, wanted: Wanted, entry: FileMapping) -> Iterator[RawBatch]:
    """Yield one row per position: its number as pose, J1 to J6 of the first motion group in degrees.

    Raises Unusable for a position without six joints, such as a Cartesian one.
    """
    with path.open("rb") as stream:
        content = stream.read(_LARGEST + 1)
    lines = content.decode(entry.encoding, errors="replace").splitlines()
    first = next((k for k, line in enumerate(lines) if line.strip() == "/POS"), None)
    if len(content) > _LARGEST or first is None:
        raise Unusable("a program of FANUC with the section /POS")
    rows = list(_positions(lines, first + 1))
    columns: dict[str, list[str] | list[float]] = {"pose": [pose for pose, _, _ in rows]}
    columns |= {f"J{n + 1}": [joints[n] for _, _, joints in rows] for n in range(_JOINTS)}
    yield from one_batch(columns, wanted, None, [line for _, line, _ in rows])


def _positions(lines: list[str], first: int) -> Iterator[tuple[str, int, list[float]]]:
    """Yield number, line (from 1) and joints of each position, from a line on."""
    row = first
    while row < len(lines):
        match = _POSITION.search(lines[row])
        if match is None:
            row += 1
            continue
        end = next((k for k in range(row, len(lines)) if "}" in lines[k]), len(lines) - 1)
        yield match[1], row + 1, _joints(" ".join(lines[row : end + 1]), row + 1, match[1])
        row = end + 1


def _joints(text: str, row: int, pose: str) -> list[float]:
    groups = _GROUP.split(text)
    joints_group = groups[2] if len(groups) > 2 else text  # further groups move a rail or a positioner
    found = {int(number): float(value) for number, value, unit in _JOINT.findall(joints_group) if unit == "deg"}
    if set(found) != set(range(1, _JOINTS + 1)):
        raise Unusable("J1 to J6 in deg (a Cartesian position: record it as joints)", row=row, value=f"P[{pose}]")
    return [found[number] for number in range(1, _JOINTS + 1)]
