"""Work for processes of a pool: silent, crashing, slow, or interrupted."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path


def square(number: int) -> int:
    return number * number


def late_if_first(number: int) -> int:
    """The first pieces come last, so that the order of completion is not that of the pieces."""
    time.sleep(0.3 if number == 0 else 0.0)
    return number


def where(_: int) -> int:
    return os.getpid()


def fail_at_two(number: int) -> int:
    if number == 2:
        raise ValueError("two is refused")
    return number


def end_own_worker(piece: tuple[str, int, int]) -> int:
    """Kills its own worker at the number 3 so often as said, and counts how often each number was tried."""
    folder, number, deaths = piece
    marks = Path(folder)
    (marks / f"{number}-{os.getpid()}-{time.monotonic_ns()}").touch()
    if number == 3 and len(list(marks.glob("3-*"))) <= deaths:
        os.kill(os.getpid(), signal.SIGKILL)
    return number


def wait_for_the_end(piece: tuple[str, int]) -> int:
    """Says that it works and does not end by itself; what is still to be tidied is tidied, which takes a moment."""
    folder, number = piece
    try:
        (Path(folder) / f"begun-{number}-{os.getpid()}").touch()
        time.sleep(120)
    finally:
        time.sleep(0.3)
        (Path(folder) / f"tidied-{number}").touch()
    return number
