"""SIGINT and SIGTERM end a run in good order: parts discarded, lock released, exit code 4."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from types import FrameType

from pipeline.problems import Interrupted

_SIGNALS = (signal.SIGINT, signal.SIGTERM)


@contextmanager
def interruptible(again: signal.Handlers = signal.SIG_DFL) -> Iterator[None]:
    """Let the first SIGINT or SIGTERM raise Interrupted; a second one ends the process, or does what ``again`` says."""
    if threading.current_thread() is not threading.main_thread():
        yield  # only the main thread may receive signals
        return
    before = {number: signal.signal(number, partial(_interrupt, again)) for number in _SIGNALS}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _interrupt(again: signal.Handlers, number: int, frame: FrameType | None) -> None:
    for each in _SIGNALS:
        signal.signal(each, again)
    raise Interrupted(signal.Signals(number).name)
