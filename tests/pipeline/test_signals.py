"""SIGINT and SIGTERM end a call soon, at any moment and in any code."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import pytest

from tests.cut_telescope import cut_telescope
from truing.pipeline.console import Recorder
from truing.pipeline.exit_status import end_all
from truing.pipeline.problems import ExitCode

PROJECT = Path(__file__).resolve().parents[2]
pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="needs POSIX signals")
EXIT_CODE = {signal.SIGINT: 130, signal.SIGTERM: 4}
MOMENTS_S = (0.15, 0.45, 0.65, 0.8, 0.9, 1.0, 1.4, 1.55)
SOON_S = 60.0  # where other work shares the processor; alone a tenth of a second


def ask(number: signal.Signals = signal.SIGTERM) -> None:
    os.kill(os.getpid(), number)


def lose(number: signal.Signals = signal.SIGTERM) -> None:
    """Be asked to end within code that discards every exception, as C extensions do while they initialise."""
    try:
        ask(number)
        time.sleep(1.0)
    except BaseException:
        pass


def wait_for_ever() -> ExitCode:
    while True:
        time.sleep(0.05)


def lost_then_waiting() -> ExitCode:
    lose()
    return wait_for_ever()


def lost_several_times() -> ExitCode:
    lose()
    for _ in range(3):
        with suppress(BaseException):
            wait_for_ever()
    return wait_for_ever()


def lost_then_broken() -> ExitCode:
    lose()
    raise ImportError("initialization failed")


def lost_then_done() -> ExitCode:
    lose()
    return ExitCode.DONE


class Finalized:
    def __del__(self) -> None:
        ask()
        time.sleep(1.0)


def lost_in_a_finalizer() -> ExitCode:
    Finalized()
    return wait_for_ever()


@pytest.mark.parametrize(
    "action", [lost_then_waiting, lost_several_times, lost_then_broken, lost_then_done, lost_in_a_finalizer]
)
def test_an_interruption_that_is_discarded_ends_the_call_all_the_same(
    action: Callable[[], ExitCode], capsys: pytest.CaptureFixture[str]
) -> None:
    recorder, started = Recorder(), time.monotonic()
    assert end_all([action, wait_for_ever], recorder) == ExitCode.ENVIRONMENT
    assert time.monotonic() - started < SOON_S
    assert [line for _, line in recorder.lines] == [
        "interrupted (SIGTERM); finished artifacts are intact; run again to resume"
    ]
    assert capsys.readouterr().err == ""


def test_ctrl_c_ends_with_130() -> None:
    assert end_all([lambda: [lose(signal.SIGINT), ExitCode.DONE][1]], Recorder()) == 130  # type: ignore[arg-type]


def test_cleaning_up_after_an_interruption_is_not_interrupted() -> None:
    tidied = []

    def interrupted() -> ExitCode:
        try:
            ask()
            return wait_for_ever()
        finally:
            for step in range(10):
                time.sleep(0.05)
                tidied.append(step)

    assert end_all([interrupted], Recorder()) == ExitCode.ENVIRONMENT
    assert tidied == list(range(10))


def test_a_signal_changes_nothing_once_it_is_answered() -> None:
    before = [signal.getsignal(number) for number in EXIT_CODE]
    assert end_all([lost_then_done], Recorder()) == ExitCode.ENVIRONMENT
    time.sleep(0.2)
    assert [signal.getsignal(number) for number in EXIT_CODE] == before
    assert end_all([lambda: ExitCode.DONE], Recorder()) == ExitCode.DONE


@pytest.fixture(scope="module")
def campaign(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return cut_telescope(tmp_path_factory.mktemp("signals") / "campaign")


@pytest.mark.parametrize("moment", MOMENTS_S)
def test_a_signal_at_any_moment_ends_a_run_that_leaves_nothing_half_written(
    moment: float, campaign: Path, tmp_path: Path
) -> None:
    number = (signal.SIGINT, signal.SIGTERM)[MOMENTS_S.index(moment) % 2]
    process = subprocess.Popen(
        [sys.executable, "-m", "pipeline", "run", str(campaign), "--out", str(tmp_path / "run")],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(PROJECT)},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )
    time.sleep(moment)
    process.send_signal(number)
    _, errors = process.communicate(timeout=SOON_S)
    if process.returncode == -number:  # Python itself was still starting
        assert not (tmp_path / "run").exists()
        return
    assert process.returncode == EXIT_CODE[number], errors
    assert errors.startswith(f"interrupted ({number.name})")
    assert errors.count("\n") == 1
    assert not list(tmp_path.rglob("*.part"))
    assert not list(tmp_path.rglob("defect.log"))


@pytest.mark.parametrize("number", EXIT_CODE)
def test_a_signal_after_the_last_word_leaves_the_exit_code(number: signal.Signals) -> None:
    code = (
        "import atexit, os, sys, time\n"
        f"atexit.register(lambda: [os.kill(os.getpid(), {int(number)}), time.sleep(1.0)])\n"
        "sys.argv = ['truing', '--version']\n"
        "from truing.pipeline.entry import main\n"
        "main()\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=PROJECT, capture_output=True, text=True, check=False, timeout=SOON_S
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.startswith("truing ")
