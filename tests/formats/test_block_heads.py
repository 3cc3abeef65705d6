"""Lines above blocks of rows, such as ``EPOCH 3``, whose numbers become columns of the rows below."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.formats.reading import read
from tests.pipeline.test_init_exports import init, table
from truing.formats.block_heads import heads_of_poses
from truing.formats.raw_tables import POINTS

ROWS = {1: [("A1", 1.5), ("A2", 2.5)], 2: [("A1", 3.5), ("A2", 4.5)], 7: [("A1", 5.5), ("A2", 6.5)]}
EXPECTED = [(str(pose), target, x) for pose, rows in ROWS.items() for target, x in rows]


def _lines(separator: str, head: str) -> list[str]:
    lines = ["** program 3.4", "** unit mm", ""]
    for pose, rows in ROWS.items():
        lines.append(head.format(pose))
        lines += [separator.join([target, str(x), "0.25", "-7.125"]) for target, x in rows]
        lines.append("")
    return lines


@pytest.mark.parametrize(("separator", "named"), [("  ", "whitespace"), (";", ";"), ("\t", "tab")])
@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_rows_have_the_pose_of_the_head_above_them(tmp_path: Path, separator: str, named: str, end: str) -> None:
    (tmp_path / "list.dat").write_bytes(end.join(_lines(separator, "EPOCH {}  2024-03-05")).encode())
    keys = {"path": "list.dat", "separator": named, "header": False, "skip_lines": 4, "heads": r"EPOCH (?P<pose>\d+)"}
    keys |= {"columns": {"target": 1, "x_mm": 2, "y_mm": 3, "z_mm": 4}, "constants": {"body": "b"}}
    found = read(tmp_path, "points", keys)
    assert not found.faults
    columns = (found.columns[name] for name in ("pose", "target", "x_mm"))
    assert [(str(pose), target, x) for pose, target, x in zip(*columns, strict=True)] == EXPECTED


def test_a_fault_names_the_line_of_the_file(tmp_path: Path) -> None:
    lines = _lines(" ", "EPOCH {}")
    wrong = lines.index("A2 4.5 0.25 -7.125")
    lines[wrong] = "A2 4.5 many -7.125"
    (tmp_path / "list.dat").write_text("\n".join(lines))
    keys = {"path": "list.dat", "header": False, "skip_lines": 3, "heads": r"EPOCH (?P<pose>\d+)"}
    keys |= {"columns": {"target": 1, "x_mm": 2, "y_mm": 3, "z_mm": 4}, "constants": {"body": "b"}}
    (fault,) = read(tmp_path, "points", keys).faults
    assert (fault.row, fault.value) == (wrong + 1, "many")


@pytest.mark.parametrize("head", ["EPOCH {}   2024-03-05 10:12", "# Pose: {}", "Messung Nr. {}", "--- Position {} ---"])
def test_init_takes_such_heads_for_poses(tmp_path: Path, head: str) -> None:
    (tmp_path / "list.dat").write_text("\n".join(_lines("  ", head)))
    _, document = init(tmp_path)
    found = table(tmp_path, document, POINTS).table
    columns = (found.column(name).to_pylist() for name in ("pose", "target", "x_mm"))
    assert [(str(pose), target, x) for pose, target, x in zip(*columns, strict=True)] == EXPECTED


@pytest.mark.parametrize(
    "lines",
    [
        ["EPOCH 1", "A 1 2 3", "B 1 2 3"],  # of one pose alone
        ["Position 1", "A 1 2 3", "B 1 2 3", "Position 1", "A 1 2 3"],  # a number twice names no pose
        ["pose 1 0.2 0.3", "pose 2 0.2 0.3", "pose 3 0.2 0.3"],  # rows themselves
        ["Epoch 1", "A 1 2 3", "B 1 2 3", "Set 2", "A 1 2 3", "Frame 3", "B 1 2 3"],  # of several kinds
    ],
)
def test_other_lines_number_no_blocks(lines: list[str]) -> None:
    assert heads_of_poses(lines) is None
