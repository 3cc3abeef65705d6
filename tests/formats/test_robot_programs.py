"""Positions in programs of robots: joint readings of each pose, in their unit."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.formats.reading import read
from truing.formats.sniff import sniff_file

READINGS = [[2.5, -29.5, 6.125, 34.75, -47.375, 35.5], [21.75, 1.5, -16.625, 77.5, -56.5, -13.875]]
RADIANS = ", ".join(f"{-0.25 * k}" for k in range(1, 7))
PROGRAMS = {
    "kuka": "DECL E6AXIS XP{pose}={{A1 {0},A2 {1},A3 {2},A4 {3},A5 {4},A6 {5},E1 0.0}}",
    "abb": "CONST jointtarget p{pose}:=[[{0},{1},{2},{3},{4},{5}],[9E9,9E9,9E9,9E9,9E9,9E9]];",
    "rokae": "LOCAL VAR jointtarget j{pose} = j:{{{0},{1},{2},{3},{4},{5}\t\t ,0\t}}\t{{EJ 0,0,0,0,0,0}}",
}


@pytest.mark.parametrize("controller", sorted(PROGRAMS))
def test_joint_readings_of_a_program_are_read_with_their_poses(tmp_path: Path, controller: str) -> None:
    lines = [PROGRAMS[controller].format(*row, pose=pose) for pose, row in enumerate(READINGS, 1)]
    (tmp_path / "program.txt").write_text("\n".join(["MODULE here", *lines, "ENDMODULE"]) + "\n")
    columns = _read(tmp_path, "deg")
    assert columns["pose"] == [1, 2]
    assert np.array_equal(np.transpose([columns[f"joint{k}_deg"] for k in range(1, 7)]), READINGS)


def test_positions_of_moves_are_in_radians_and_in_their_order(tmp_path: Path) -> None:
    moves = [f"  movej([{RADIANS}], a=1.2, v=0.5)", "  sleep(1.0)", "  movej([0, 0.5, 0, 0, 0, 1], r=0)"]
    (tmp_path / "program.txt").write_text("\n".join(["def main():", *moves, "end"]) + "\n")
    columns = _read(tmp_path, "rad")
    assert columns["pose"] == [1, 2]
    assert columns["joint2_rad"] == [-0.5, 0.5]


LOGS = {
    "kuka": "MP{pose:03d} $AXIS_ACT={{A1 {0},A2 {1},A3 {2},A4 {3},A5 {4},A6 {5},E1 0.0}}",
    "abb": "2026-11-26 10:0{pose}:05  jpos{pose:02d} := [[{0},{1},{2},{3},{4},{5}],[9E+09,9E+09,9E+09,9E9,9E9,9E9]]",
}


@pytest.mark.parametrize("controller", sorted(LOGS))
@pytest.mark.parametrize("first", [1, 7])
def test_lines_of_a_log_of_joints_are_read_with_the_numbers_of_their_names(
    tmp_path: Path, controller: str, first: int
) -> None:
    lines = [LOGS[controller].format(*row, pose=pose) for pose, row in enumerate(READINGS, first)]
    (tmp_path / "program.txt").write_text("\n".join(["; log of 27.11.2026 08:00", *lines]) + "\n")
    columns = _read(tmp_path, "deg")
    assert columns["pose"] == [first, first + 1]
    assert np.array_equal(np.transpose([columns[f"joint{k}_deg"] for k in range(1, 7)]), READINGS)


def test_lines_of_a_log_without_names_are_poses_in_their_order(tmp_path: Path) -> None:
    lines = ["{" + ", ".join(f"A{k} {value}" for k, value in enumerate(row, 1)) + "}" for row in READINGS]
    (tmp_path / "program.txt").write_text("\n".join(lines) + "\n")
    columns = _read(tmp_path, "deg")
    assert columns["pose"] == [1, 2]
    assert columns["joint6_deg"] == [row[5] for row in READINGS]


def test_cartesian_targets_of_a_program_are_no_joints(tmp_path: Path) -> None:
    line = "p{0} := [[100.5,20.25,300.0],[1,0,0,0],[0,0,0,0],[9E+09,9E+09,9E+09,9E+09,9E+09,9E+09]]"
    (tmp_path / "program.txt").write_text("\n".join(line.format(k) for k in (1, 2, 3)) + "\n")
    assert sniff_file(tmp_path / "program.txt").table is None


LS = """/PROG  CALIB
/ATTR
COMMENT = "";
/MN
   1:J P[1] 10% FINE    ;
/POS
{}/END
"""
POSITION = """P[{pose}:"home"]{{
   GP1:
\tUF : 0, UT : 1,\t
\tJ1= {0:9.3f} deg,\tJ2= {1:9.3f} deg,\tJ3= {2:9.3f} deg,
\tJ4= {3:9.3f} deg,\tJ5= {4:9.3f} deg,\tJ6= {5:9.3f} deg
   GP2:
\tUF : 0, UT : 1,\t
\tJ1=   500.000 mm
}};
"""


def test_positions_of_a_fanuc_program_are_on_several_lines(tmp_path: Path) -> None:
    """A second group moves a rail, and is no joint of the arm."""
    positions = [POSITION.format(*row, pose=pose) for pose, row in enumerate(READINGS, 1)]
    (tmp_path / "program.txt").write_text(LS.format("".join(positions)))
    columns = _read(tmp_path, "deg")
    assert columns["pose"] == [1, 2]
    assert np.array_equal(np.transpose([columns[f"joint{k}_deg"] for k in range(1, 7)]), READINGS)


def test_a_cartesian_position_among_joints_is_a_fault_with_its_line(tmp_path: Path) -> None:
    cartesian = "P[2]{\n   GP1:\n\tX = 10.0 mm, Y = 0.0 mm, Z = 5.0 mm\n};\n"
    (tmp_path / "program.txt").write_text(LS.format(POSITION.format(*READINGS[0], pose=1) + cartesian))
    guess = sniff_file(tmp_path / "program.txt")
    found = read(tmp_path, "configurations", {"path": "program.txt", **guess.mapping})
    assert [(fault.row, fault.value) for fault in found.faults] == [(16, "P[2]")]


def _read(folder: Path, unit: str) -> dict[str, list[float]]:
    guess = sniff_file(folder / "program.txt")
    assert guess.table == "configurations"
    found = read(folder, guess.table, {"path": "program.txt", **guess.mapping})
    assert found.faults == ()
    assert {f"joint{k}_{unit}" for k in range(1, 7)} <= set(found.columns)
    return found.columns
