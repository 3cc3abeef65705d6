"""Expected duration of a run, from similar runs in the same folder only."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.pipeline.fake_project import STAGES, FakeProject
from truing.pipeline.durations import Durations


@pytest.fixture
def store(tmp_path: Path) -> Path:
    known = Durations(tmp_path / "durations.json", 1000, 2, "here")
    for stage, seconds in (("pose", 4.0), ("report", 8.0)):
        known.note(stage, seconds)
    return tmp_path / "durations.json"


def test_stages_take_as_long_as_they_took(store: Path) -> None:
    known = Durations(store, 1000, 2, "here")
    assert known.expected(["pose", "report"]) == 12.0
    assert known.expected(["pose"]) == 4.0


@pytest.mark.parametrize(
    ("raw_bytes", "workers", "machine"), [(1300, 2, "here"), (1000, 1, "here"), (1000, 2, "there")]
)
def test_another_size_machine_or_number_of_processes_is_no_base(
    store: Path, raw_bytes: int, workers: int, machine: str
) -> None:
    assert Durations(store, raw_bytes, workers, machine).expected(["pose"]) is None


def test_a_stage_that_never_ran_leaves_no_estimate(store: Path) -> None:
    known = Durations(store, 1000, 2, "here")
    assert known.expected(["pose", "diagnose"]) is None
    assert known.expected([]) is None
    store.write_text("damaged")
    assert known.expected(["pose"]) is None


def test_a_run_says_its_time_once_and_only_with_a_base(fake: FakeProject) -> None:
    assert "as long as they took" not in fake.call("run", str(fake.campaign)).stdout
    store = fake.out / ".truing" / "durations.json"
    known = json.loads(store.read_bytes())
    assert known.keys() == STAGES.keys()
    for one in known.values():
        one["seconds"] = 4.0
    store.write_text(json.dumps(known))
    lines = fake.call("run", str(fake.campaign), "--force").stdout.splitlines()
    reported = f"{len(STAGES)} stages to run: about {4 * len(STAGES)} s, as long as they took here before"
    assert [line for line in lines if "as long as" in line] == [reported]
    assert lines[0] == reported
