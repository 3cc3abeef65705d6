"""Every processor second of a test run is counted once, also in other workers."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from tests.cpu_time import CpuTime, folder_of, processor_seconds

ROUNDING_S = 1e-9  # of differences of processor seconds


def _busy(seconds: float) -> None:
    end = processor_seconds() + seconds
    while processor_seconds() < end:
        pass


def _measured(counted: CpuTime, node: str, seconds: float) -> None:
    """Run the hook as pytest does, around a test that takes this long."""
    hook = counted.pytest_runtest_protocol(SimpleNamespace(nodeid=node))  # type: ignore[arg-type]
    next(hook)
    _busy(seconds)
    with pytest.raises(StopIteration):
        next(hook)


def test_a_folder_is_named_by_its_place_below_the_tests() -> None:
    assert folder_of("tests/stages/sensor/test_run.py::test_a[b/c]") == "stages/sensor"
    assert folder_of("tests/schemas/test_a.py::test_b") == "schemas"
    assert folder_of("tests/test_a.py::test_b") == "tests"


def test_the_seconds_of_folders_add_up_to_those_of_the_process_and_of_its_workers() -> None:
    worker, first = CpuTime(), CpuTime()
    _measured(worker, "tests/runs/test_a.py::test_b", 0.1)
    session = SimpleNamespace(config=SimpleNamespace(workeroutput={}))
    worker.pytest_sessionfinish(session)  # type: ignore[arg-type]
    own = sum(worker.folders.values())
    assert worker.folders["runs"] >= 0.1 - ROUNDING_S
    assert own == pytest.approx(processor_seconds(), abs=0.05)
    first.pytest_testnodedown(SimpleNamespace(workeroutput=session.config.workeroutput))
    first.pytest_testnodedown(SimpleNamespace(workeroutput=session.config.workeroutput))
    assert first.folders["runs"] == 2.0 * worker.folders["runs"]
    assert first.tests["tests/runs/test_a.py::test_b"] >= 0.2 - ROUNDING_S
    first.pytest_sessionfinish(SimpleNamespace(config=SimpleNamespace()))  # type: ignore[arg-type]
    assert sum(first.folders.values()) == pytest.approx(2.0 * own + processor_seconds(), abs=0.05)


def test_a_worker_that_crashed_has_no_counts_and_takes_none_away() -> None:
    counted = CpuTime()
    counted.folders["runs"] = 1.0
    counted.pytest_testnodedown(SimpleNamespace())
    assert counted.folders == {"runs": 1.0}
