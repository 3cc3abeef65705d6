"""Poses in blocks of limited memory, computed on all processors, in order."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TypeVar

S = TypeVar("S")
T = TypeVar("T")

# Points of a block: matrices of so many fit into the processor's cache, and calls on them take longer than their start.
POINTS_AT_ONCE = 40_000
_MOST_THREADS, _AHEAD = 4, 1


def available_processors() -> int:
    """Return the number of processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def pose_blocks(poses: int, targets: int, points: int = POINTS_AT_ONCE) -> list[slice]:
    """Return the blocks of ``poses`` with so many ``targets`` each, at least one block, of about ``points`` points."""
    step = max(1, points // max(targets, 1))
    return [slice(first, min(first + step, poses)) for first in range(0, max(poses, 1), step)]


def in_order(function: Callable[[S], T], items: Sequence[S]) -> Iterator[T]:
    """Yield the function's results over the items in order, computed in threads with few items at a time."""
    workers = min(_MOST_THREADS, available_processors(), len(items))
    if workers < 2:
        yield from map(function, items)
        return
    pending: deque[Future[T]] = deque()
    with ThreadPoolExecutor(workers) as pool:
        for item in items:
            pending.append(pool.submit(function, item))
            if len(pending) > workers + _AHEAD:
                yield pending.popleft().result()
        while pending:
            yield pending.popleft().result()
