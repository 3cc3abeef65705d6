"""Every benchmark runs in its smallest size and leaves rows; the long studies start."""

from __future__ import annotations

import math
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from benchmarks.collection import BENCHMARKS, STUDIES, collected, smallest_words, with_smallest_size
from tests.conftest import PROJECT

pytestmark = pytest.mark.slow


def test_every_module_that_is_called_has_a_smallest_size() -> None:
    called = {
        path.stem
        for path in (PROJECT / "benchmarks").glob("*.py")
        if re.search(r"^def main\(", path.read_text(encoding="utf-8"), re.MULTILINE)
    }
    assert called - {"__main__"} == set(with_smallest_size())
    assert set(STUDIES) <= called


@pytest.mark.parametrize("name", BENCHMARKS)
def test_a_benchmark_leaves_rows(name: str) -> None:
    found = collected(name, smallest=True)
    assert found.exit_code == 0
    assert found.records
    assert all(math.isfinite(record.row.value) for record in found.records)


@pytest.mark.parametrize("name", STUDIES)
def test_a_study_begins_and_keeps_its_result(name: str, tmp_path: Path) -> None:
    command = [sys.executable, "-m", f"benchmarks.{name}", *smallest_words(name)]
    done = subprocess.run(
        command,
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(PROJECT)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    (results,) = (tmp_path / "runs").glob("*.jsonl")
    assert len(results.read_text(encoding="utf-8").splitlines()) == 1
    assert "FAILED" not in done.stdout
