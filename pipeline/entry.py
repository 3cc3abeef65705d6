"""Entry point of `truing`: handles signals from before libraries load until they are unloaded."""

from __future__ import annotations

import atexit
import gc
import os
import signal
import sys
from contextlib import suppress
from types import FrameType

from truing.pipeline.interruption import interruptible
from truing.pipeline.problems import ExitCode, Interrupted, environment_problem

_NO_MEMORY = (
    "loading the program: there is not enough memory; run it where there is more, or raise its limit (ulimit -v)\n"
)


def main() -> None:
    """Entry point of `truing` and of `python -m truing`."""
    atexit.register(_ignore)  # registered first, so called last
    code = 0
    try:
        with interruptible():
            _call()
    except Interrupted as error:
        code = _end_interrupted(error)
    except (ImportError, MemoryError, SystemError) as error:  # before any action started
        text = _problem_while_loading(error)
        if not text:
            raise
        sys.stderr.write(text)
        code = ExitCode.ENVIRONMENT
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else int(end.code is not None)
        _keep(code)
        raise
    _keep(code)
    sys.exit(code)


def _problem_while_loading(error: Exception) -> str:
    """The line on what the environment lacks; empty if it lacks nothing."""
    try:
        known = environment_problem(error, "loading the program")
        return "" if known is None else f"{known}\n"
    except MemoryError:  # too little is left even to look into the error
        return _NO_MEMORY


def _call() -> None:
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="replace")  # a console without Δ must not end a run
    # Matrices are small: threads within one product are slower, and change its last bits.
    for library in ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS"):
        os.environ.setdefault(library, "1")  # numpy reads these at its first import, later
    # Imports, tables and figures make millions of objects that live to the end: looking for garbage among them at the
    # default thresholds takes several percent of a run.
    gc.set_threshold(50_000, 20, 50)
    from truing.pipeline.command_line import COMPLETE, app

    if COMPLETE in os.environ:
        from typer.completion import completion_init

        completion_init()
    app()


def _end_interrupted(error: Interrupted) -> int:
    """Exit code of an interruption before any action started, as while libraries load."""
    from truing.pipeline.console import RunConsole
    from truing.pipeline.exit_status import end_interrupted

    return end_interrupted(error, RunConsole(quiet=False))


def _keep(code: int) -> None:
    """Keep the exit code even if a signal arrives while the interpreter closes."""

    with suppress(OSError, ValueError):
        sys.stdout.flush()

    def leave(number: int, frame: FrameType | None) -> None:
        os._exit(code)

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, leave)


def _ignore() -> None:
    """Ignore signals after Python's handlers have ended."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)
