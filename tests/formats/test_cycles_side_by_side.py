"""Approaches of an axis with a column for each cycle: the file's name gives the direction of approach."""

from __future__ import annotations

from pathlib import Path

import pytest
from typer.testing import CliRunner

from tests.formats.reading import read
from truing.formats.sniff import sniff_file
from truing.pipeline.command_line import app

HEAD = "i;tgt_pos(i) [mm];ref_pos(i,1) [mm];ref_pos(i,2) [mm]\n"
ROWS = {"forward": "1;-20.0;-20.018;-20.019\n2;0.0;-0.009;-0.015\n", "backward": "1;-20.0;-20.049;-20.052\n2;0.0;0;0\n"}


@pytest.mark.parametrize(("name", "side"), [("x_fwd.csv", "forward"), ("x 2 Backward.csv", "backward")])
def test_the_name_of_a_file_says_the_direction_of_approach(tmp_path: Path, name: str, side: str) -> None:
    (tmp_path / name).write_text(HEAD + ROWS["forward"])
    guess = sniff_file(tmp_path / name)
    assert guess.table == "positioning"
    found = read(tmp_path, "positioning", {"path": name, **guess.mapping})
    assert found.faults == ()
    assert found.columns["direction"] == [side] * 4
    assert found.columns["target_mm"] == [-20.0, -20.0, 0.0, 0.0]
    assert found.columns["position_mm"] == [-20.018, -20.019, -0.009, -0.015]
    assert [str(cycle) for cycle in found.columns["cycle"]] == ["1", "2"] * 2


def test_without_a_direction_nothing_is_proposed(tmp_path: Path) -> None:
    (tmp_path / "cycles.csv").write_text(HEAD + ROWS["forward"])
    assert sniff_file(tmp_path / "cycles.csv").table is None


def test_files_of_both_sides_are_one_run_that_needs_no_completion(tmp_path: Path) -> None:
    for side, rows in ROWS.items():
        (tmp_path / f"{side}.csv").write_text(HEAD + rows)
    for command in ("init", "check"):
        done = CliRunner().invoke(app, [command, str(tmp_path)])
        assert done.exit_code == 0, done.output
