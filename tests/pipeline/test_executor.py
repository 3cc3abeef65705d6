"""The executor gives equal results in equal order in one process, in a pool and on Dask; workers may vanish."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest

from tests.pipeline import pieces_of_work as work
from truing.pipeline.executor import LOCAL, TRIES, Workforce, results
from truing.pipeline.problems import EnvironmentProblem

PROJECT = Path(__file__).resolve().parents[2]
LOST = -1


def lost(piece: object) -> int:
    return LOST


@pytest.fixture(scope="module")
def scheduler() -> Iterator[str]:
    """A Dask cluster of two workers that somebody else has started, by its scheduler's address."""
    from distributed import LocalCluster

    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=":0", silence_logs=50) as cluster:
        yield cluster.scheduler_address


@pytest.fixture(params=["alone", "processes", "dask"])
def workforce(request: pytest.FixtureRequest) -> Workforce:
    """Each of the three ways."""
    if request.param == "dask":
        return Workforce(scheduler=request.getfixturevalue("scheduler"))
    return Workforce(1 if request.param == "alone" else 2)


def test_results_are_in_the_order_of_the_pieces(workforce: Workforce) -> None:
    done: list[int] = []
    assert list(results(work.late_if_first, range(5), workforce, lost, done.append)) == [0, 1, 2, 3, 4]
    assert done == [1, 2, 3, 4, 5]


def test_a_finished_run_repeats_no_stage(workforce: Workforce) -> None:
    assert list(results(work.square, [], workforce, lost)) == []


def test_an_exception_of_the_work_ends_everything(workforce: Workforce) -> None:
    with pytest.raises(ValueError, match="two is refused"):
        list(results(work.fail_at_two, range(4), workforce, lost))


def test_a_local_cluster_is_started_for_the_call_works_elsewhere_and_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    places = set(results(work.where, range(4), Workforce(2, LOCAL), lost))
    assert os.getpid() not in places
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("place", ["processes", "dask"])
@pytest.mark.parametrize("deaths", [1, 99])
def test_a_lost_worker_costs_only_the_result_that_kills_it(place: str, deaths: int, tmp_path: Path) -> None:
    workforce = Workforce(2) if place == "processes" else Workforce(2, LOCAL)
    pieces = [(str(tmp_path), number, deaths) for number in range(8)]
    found = list(results(work.end_own_worker, pieces, workforce, lost))
    assert found == [0, 1, 2, 3 if deaths == 1 else LOST, 4, 5, 6, 7]
    tried = len(list(tmp_path.glob("3-*")))
    assert tried == 2 if deaths == 1 else tried >= TRIES


def test_a_worker_that_is_asked_to_end_has_its_piece_done_by_another(tmp_path: Path) -> None:
    pieces = [(str(tmp_path), number) for number in range(2)]
    found: list[BaseException | None] = []

    def stop_them() -> None:
        """End whoever works, as a system does that is short of memory, until the pieces are given up."""
        ended: set[int] = set()
        while not found:
            for mark in tmp_path.glob("begun-*"):
                worker = int(mark.name.split("-")[2])
                if worker not in ended:
                    ended.add(worker)
                    os.kill(worker, signal.SIGTERM)
            time.sleep(0.02)

    thread = threading.Thread(target=stop_them)
    thread.start()
    try:
        assert list(results(work.wait_for_the_end, pieces, Workforce(2), lost)) == [LOST, LOST]
    finally:
        found.append(None)
        thread.join()
    assert {path.name for path in tmp_path.glob("tidied-*")} == {"tidied-0", "tidied-1"}


def test_closing_results_early_ends_all_workers(tmp_path: Path) -> None:
    pieces = [(str(tmp_path), number, 0) for number in range(40)]
    with closing(results(work.end_own_worker, pieces, Workforce(2), lost)) as found:
        assert next(found) == 0
    workers = {int(mark.name.split("-")[1]) for mark in tmp_path.iterdir()}
    assert workers
    assert not any(_lives(worker) for worker in workers)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_workers_end_with_the_process_that_asked_for_work(number: signal.Signals, tmp_path: Path) -> None:
    code = (
        "from truing.pipeline.executor import Workforce, results\n"
        "from truing.pipeline.interruption import interruptible\n"
        "from tests.pipeline.pieces_of_work import wait_for_the_end\n"
        "if __name__ == '__main__':\n"
        "    with interruptible():\n"
        f"        list(results(wait_for_the_end, [({str(tmp_path)!r}, k) for k in range(2)], Workforce(2), print))\n"
    )
    (tmp_path / "asks.py").write_text(code)
    environment = {**os.environ, "PYTHONPATH": str(PROJECT)}
    asking = subprocess.Popen([sys.executable, str(tmp_path / "asks.py")], env=environment, stderr=subprocess.DEVNULL)
    while len(marks := list(tmp_path.glob("begun-*"))) < 2:
        assert asking.poll() is None
        time.sleep(0.02)
    asking.send_signal(number)
    assert asking.wait(60) != 0
    workers = [int(mark.name.split("-")[2]) for mark in marks]
    until = time.monotonic() + 60
    while any(_lives(worker) for worker in workers):
        assert time.monotonic() < until
        time.sleep(0.02)
    if number != signal.SIGKILL:
        assert len(list(tmp_path.glob("tidied-*"))) == 2


def test_a_missing_scheduler_is_a_problem_of_the_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("truing.pipeline.executor._SECONDS_TO_ANSWER", 0.3)
    with pytest.raises(EnvironmentProblem, match=r"tcp://127\.0\.0\.1:9: no scheduler with a worker answers"):
        list(results(work.square, range(2), Workforce(scheduler="tcp://127.0.0.1:9"), lost))


def _lives(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    state = Path(f"/proc/{process}/stat")
    return not state.exists() or ") Z" not in state.read_text()
