"""SIGINT and SIGTERM end a call in good order, and no library that discards exceptions can make them unheard.

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
# Workers of a pool have ten seconds to leave before they are killed; who tidies longer does not tidy.
_SECONDS_TO_TIDY = 30.0

if sys.platform == "win32":
    _AGAIN = signal.SIGBREAK

    def _nudge() -> None:
        _thread.interrupt_main(_AGAIN)
else:
    _AGAIN = signal.SIGURG  # of no use to a program without sockets' urgent data, and ignored where no handler is

    def _nudge() -> None:
        signal.pthread_kill(threading.main_thread().ident or 0, _AGAIN)


def exit_code_of(name: str) -> ExitCode:
    """Exit code of a call that a signal has ended: 130 after Ctrl-C, as of other programs, else the environment's."""
    return ExitCode.KEYBOARD if name == signal.SIGINT.name else ExitCode.ENVIRONMENT


class _Request:
    """A signal that asked this process to end, from its arrival until somebody has answered it."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.answered = False
        self._raised: weakref.ref[Interrupted] | None = None

    def error(self) -> Interrupted:
        """An exception to raise now; it counts as lost once nobody holds it any more."""
        error = Interrupted(self.name)
        self._raised = weakref.ref(error)
        return error

    @property
    def is_lost(self) -> bool:
        """Whether the exception has been discarded by code that does not know it."""
        return not self.answered and self._raised is not None and self._raised() is None

    def insist(self) -> None:
        """Raise again what is lost, until it is answered; end the process where tidying has no end."""
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
        answered()
        sys.unraisablehook = report
        for number, handler in before.items():
            signal.signal(number, handler)
        _listening = False


def _do_nothing(number: int, frame: FrameType | None) -> None:
    """Take the place of SIG_IGN, which Python reports as a race where a signal has just arrived."""


def _request_end(name: str) -> Interrupted:
    global _request
    _request = _Request(name)
    error = _request.error()
    _thread.start_new_thread(_request.insist, ())  # threading.Thread takes locks, which the main thread may hold here
    return error


def _repeat_request(number: int, frame: FrameType | None) -> None:
    if _request is not None and _request.is_lost:
        raise _request.error()


def _report_unless_interrupted(unraisable: sys.UnraisableHookArgs) -> None:
    """An interruption within a finalizer or callback is raised again elsewhere: it is no trouble to report."""
    if not isinstance(unraisable.exc_value, Interrupted):
        sys.__unraisablehook__(unraisable)


def answered() -> None:
    """The request has reached who ends the call: nothing raises it again."""
    global _request
    if _request is not None:
        _request.answered = True
        _request = None


@contextmanager
def raise_if_interrupted() -> Iterator[None]:
    """Raise Interrupted at the end where this process was asked to end meanwhile, whatever has come of it.

    An import that an interruption broke fails with an error of its own; work that lost it completes.
    """
    try:
        yield
    except Exception:
        _raise_if_requested()
        raise
    _raise_if_requested()


def _raise_if_requested() -> None:
    """Raise Interrupted where a signal has asked this process to end."""
    if _request is not None:
        raise _request.error() from None


@contextmanager
def children_without_interrupts() -> Iterator[None]:
    """Start no child that hears SIGINT: a terminal sends it to all, and one that still loads would show a traceback."""
    if sys.platform == "win32":
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
