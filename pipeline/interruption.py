"""SIGINT and SIGTERM end a call cleanly, even if a library discards exceptions.

The first signal raises Interrupted where the main thread stands. Code that discards exceptions loses it there: C
extensions while they initialise, callbacks, finalizers. So the request is a fact that stays, and a thread of its own
raises it again wherever the exception has been lost. Library errors that follow from a lost one count as interruption.
"""

from __future__ import annotations

import _thread
import os
import signal
import sys
import threading
import time
import weakref
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

from truing.pipeline.problems import ExitCode, Interrupted

_SIGNALS = (signal.SIGINT, signal.SIGTERM)
_SECONDS_BETWEEN_LOOKS = 0.02
# Workers of a pool have ten seconds to end before they are killed.
_SECONDS_TO_TIDY = 30.0

if sys.platform == "win32":
    _AGAIN = signal.SIGBREAK

    def _nudge() -> None:
        _thread.interrupt_main(_AGAIN)
else:
    _AGAIN = signal.SIGURG  # unused by programs without urgent socket data, and ignored by default

    def _nudge() -> None:
        signal.pthread_kill(threading.main_thread().ident or 0, _AGAIN)


def exit_code_of(name: str) -> ExitCode:
    """Exit code of a call ended by a signal: 130 after Ctrl-C, as usual, else that of the environment."""
    return ExitCode.KEYBOARD if name == signal.SIGINT.name else ExitCode.ENVIRONMENT


class _Request:
    """A signal to end this process, from its arrival until it is handled."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.answered = False
        self._raised: weakref.ref[Interrupted] | None = None

    def error(self) -> Interrupted:
        """An exception to raise now; it counts as lost once nothing refers to it."""
        error = Interrupted(self.name)
        self._raised = weakref.ref(error)
        return error

    @property
    def is_lost(self) -> bool:
        """True if other code has discarded the exception."""
        return not self.answered and self._raised is not None and self._raised() is None

    def raise_until_answered(self) -> None:
        """Raise a lost exception again until it is answered; end the process if cleaning up takes too long."""
        until = time.monotonic() + _SECONDS_TO_TIDY
        while not self.answered:
            if time.monotonic() > until:
                os._exit(exit_code_of(self.name))
            if self.is_lost:
                _nudge()
            time.sleep(_SECONDS_BETWEEN_LOOKS)


_request: _Request | None = None
_listening = False


@contextmanager
def interruptible(*, once: bool = False) -> Iterator[None]:
    """Let the first SIGINT or SIGTERM raise Interrupted; a second one ends the process, or does nothing (``once``).

    Within another such context, and in other threads than the main one, this changes nothing.
    """
    global _listening
    if _listening or threading.current_thread() is not threading.main_thread():
        yield
        return
    _listening = True

    def ask(number: int, frame: FrameType | None) -> None:
        for each in _SIGNALS:
            signal.signal(each, _do_nothing if once else signal.SIG_DFL)
        raise _request_end(signal.Signals(number).name)

    before = {number: signal.signal(number, ask) for number in _SIGNALS}
    before[_AGAIN] = signal.signal(_AGAIN, _repeat_request)
    report, sys.unraisablehook = sys.unraisablehook, _report_unless_interrupted
    try:
        yield
    finally:
        mark_answered()
        sys.unraisablehook = report
        for number, handler in before.items():
            signal.signal(number, handler)
        _listening = False


def _do_nothing(number: int, frame: FrameType | None) -> None:
    """Replacement of SIG_IGN, which Python reports as a race if a signal has just arrived."""


def _request_end(name: str) -> Interrupted:
    global _request
    _request = _Request(name)
    error = _request.error()
    _thread.start_new_thread(
        _request.raise_until_answered, ()
    )  # threading.Thread needs locks, which the main thread may hold here
    return error


def _repeat_request(number: int, frame: FrameType | None) -> None:
    if _request is not None and _request.is_lost:
        raise _request.error()


def _report_unless_interrupted(unraisable: sys.UnraisableHookArgs) -> None:
    """Report errors of finalizers and callbacks except interruptions, which are raised again elsewhere."""
    if not isinstance(unraisable.exc_value, Interrupted):
        sys.__unraisablehook__(unraisable)


def mark_answered() -> None:
    """Mark the request as received by the caller, so that it is not raised again."""
    global _request
    if _request is not None:
        _request.answered = True
        _request = None


@contextmanager
def raise_if_interrupted() -> Iterator[None]:
    """Raise Interrupted at the end if a signal to end arrived meanwhile, whatever the outcome.

    An interrupted import fails with an error of its own; work that lost the exception completes.
    """
    try:
        yield
    except Exception:
        _raise_if_requested()
        raise
    _raise_if_requested()


def _raise_if_requested() -> None:
    """Raise Interrupted if a signal to end this process has arrived."""
    if _request is not None:
        raise _request.error() from None


@contextmanager
def children_without_interrupts() -> Iterator[None]:
    """Start child processes that ignore SIGINT.

    A terminal sends it to all processes, and a child that still loads would show a traceback.
    """
    if sys.platform == "win32":
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
