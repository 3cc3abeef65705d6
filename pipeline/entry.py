"""Where a call of `truing` begins and ends: signals are heard before libraries load, and until they are unloaded."""

from __future__ import annotations

import atexit
import os
import signal
import sys
from contextlib import suppress
from types import FrameType

from truing.pipeline.interruption import interruptible
from truing.pipeline.problems import ExitCode, Interrupted, environment_problem


def main() -> None:
    """The entry point of `truing` and of `python -m pipeline`."""
    atexit.register(_ignore)  # registered first, called last, when nothing waits any more
    code = 0
    try:
        with interruptible():
            _call()
    except Interrupted as error:
        code = _end_interrupted(error)
    except (ImportError, MemoryError) as error:  # before any action began
        known = environment_problem(error, "loading the program")
        if known is None:
            raise
        sys.stderr.write(f"{known}\n")
        code = ExitCode.ENVIRONMENT
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else int(end.code is not None)
        _keep(code)
        raise
    _keep(code)
    sys.exit(code)


def _call() -> None:
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="replace")  # a console that lacks Δ shall not end a run
    # Matrices are small here: threads within one product cost more than they give, and change its last bits.
    for library in ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS"):
        os.environ.setdefault(library, "1")  # read when numpy is first imported, which is later
    from truing.pipeline.command_line import app

    app()


def _end_interrupted(error: Interrupted) -> int:
    """Interrupted before any action began, as while libraries load."""
    from truing.pipeline.console import RunConsole
    from truing.pipeline.exit_status import end_interrupted

    return end_interrupted(error, RunConsole(quiet=False))


def _keep(code: int) -> None:
    """Let no signal change the exit code while the interpreter closes: the call has ended."""

    with suppress(OSError, ValueError):
        sys.stdout.flush()

    def leave(number: int, frame: FrameType | None) -> None:
        os._exit(code)

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, leave)


def _ignore() -> None:
    """Outlast handlers in Python, which end before the interpreter does."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)
