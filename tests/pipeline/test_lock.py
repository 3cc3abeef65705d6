"""The lock of a run folder: one holder, who is named to others; locks of dead processes are void."""

from __future__ import annotations

import os
import re
from pathlib import Path

import pytest

from truing.pipeline.problems import EnvironmentProblem
from truing.pipeline.run_folder import PRIVATE, hold, locked_folder


def test_a_second_run_reports_the_process_that_holds_the_lock(tmp_path: Path) -> None:
    with hold(tmp_path / "lock"):
        expected = rf"in use by another run: process {os.getpid()} on \S+, since \d{{4}}-\d\d-\d\d \d\d:\d\d:\d\d"
        with pytest.raises(EnvironmentProblem, match=expected), hold(tmp_path / "lock"):
            pass
    with hold(tmp_path / "lock"):
        pass


def test_a_lock_file_without_a_living_holder_holds_nobody_up(tmp_path: Path) -> None:
    (tmp_path / "lock").write_text('{"pid": 1, "host": "gone", "since": "long ago"}')
    with hold(tmp_path / "lock"):
        assert re.search(rf'"pid": {os.getpid()}', (tmp_path / "lock").read_text())


def test_a_folder_that_received_nothing_vanishes_with_the_parents_it_brought(tmp_path: Path) -> None:
    (tmp_path / "runs").mkdir()
    with locked_folder(tmp_path / "runs" / "a" / "b"):
        assert (tmp_path / "runs" / "a" / "b" / PRIVATE / "lock").exists()
    assert [path.name for path in tmp_path.rglob("*")] == ["runs"]


def test_a_folder_that_received_something_stays(tmp_path: Path) -> None:
    with locked_folder(tmp_path / "a"):
        (tmp_path / "a" / PRIVATE / "ledger.json").write_text("{}")
    assert (tmp_path / "a" / PRIVATE / "ledger.json").exists()
