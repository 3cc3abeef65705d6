"""Pieces of work in several processes of this machine, each of which may vanish without taking the rest along.

Dask would do it too, but a cluster on this machine takes eight times as long to start (3.3 s, not 0.4 s). Pools of loky
and joblib break as a whole when one worker vanishes, as that of the standard library does.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass, field
from multiprocessing import connection
from typing import Any

from truing.child_processes import safe_children
from truing.pipeline.interruption import children_without_interrupts, heard, interruptible
from truing.pipeline.problems import Interrupted
from truing.pipeline.workforce import TRIES, Piece, Result

_SECONDS_TO_LEAVE = 10.0
# So often a wait looks up: where a signal cannot end the waiting itself, it is heard then.
_SECONDS_BETWEEN_LOOKS = 0.5


def completed_by_processes(
    work: Callable[[Piece], Result], pieces: Sequence[Piece], workers: int, lost: Callable[[Piece], Result]
) -> Iterator[tuple[int, Result]]:
    """Yield number and result of every piece, in the order in which they are completed."""
    queue = _Queue(work, pieces, lost, deque(range(len(pieces))))
    while queue.waiting or queue.suspects:
        with _pool(workers) as pool:
            yield from queue.worked_off(pool, workers)


@dataclass
class _Queue:
    """What is left to do. Pieces that were under way when a worker vanished are suspects: they are done again one at a
    time, so that the one that ends its workers is known and costs the others nothing."""

    work: Callable[[Any], Any]
    pieces: Sequence[Any]
    lost: Callable[[Any], Any]
    waiting: deque[int]
    suspects: deque[int] = field(default_factory=deque)
    losses: Counter[int] = field(default_factory=Counter)

    def worked_off(self, pool: ProcessPoolExecutor, workers: int) -> Iterator[tuple[int, Any]]:
        """Yield what is completed until nothing is left, or the pool has lost a worker."""
        under_way: dict[Future[Any], int] = {}
        while self._hand_out(pool, under_way, workers):
            done, _ = wait(under_way, timeout=_SECONDS_BETWEEN_LOOKS, return_when=FIRST_COMPLETED)
            intact = [future for future in done if not isinstance(future.exception(), BrokenProcessPool)]
            for future in intact:
                yield under_way.pop(future), future.result()
            if len(intact) < len(done):
                yield from self._suspect(list(under_way.values()))
                return

    def _hand_out(self, pool: ProcessPoolExecutor, under_way: dict[Future[Any], int], workers: int) -> bool:
        """Keep the workers busy; returns whether anything is under way. One broken pool refuses all further work."""
        while self.suspects and not under_way:
            self._submit(pool, under_way, self.suspects.popleft())
        while self.waiting and not self.suspects and len(under_way) < workers and not self._is_alone(under_way):
            self._submit(pool, under_way, self.waiting.popleft())
        return bool(under_way)

    def _is_alone(self, under_way: dict[Future[Any], int]) -> bool:
        return any(self.losses[number] for number in under_way.values())

    def _submit(self, pool: ProcessPoolExecutor, under_way: dict[Future[Any], int], number: int) -> None:
        try:
            with children_without_interrupts():
                under_way[pool.submit(_in_good_order, self.work, self.pieces[number])] = number
        except BrokenProcessPool as error:  # a worker vanished before it was given anything
            failed: Future[Any] = Future()
            failed.set_exception(error)
            under_way[failed] = number

    def _suspect(self, numbers: list[int]) -> Iterator[tuple[int, Any]]:
        """Put back what was under way; yield what stands in the place of a piece that is given up."""
        self.losses.update(numbers)
        for number in numbers:
            if self.losses[number] >= TRIES:
                yield number, self.lost(self.pieces[number])
            else:
                self.suspects.append(number)


@contextmanager
def _pool(workers: int) -> Iterator[ProcessPoolExecutor]:
    """A pool of fresh processes; whatever ends its use ends them, too."""
    others = set(multiprocessing.active_children())
    context = multiprocessing.get_context("spawn")  # a fork would carry this process's locks and threads along
    with safe_children():  # they are started when there is work for them
        pool = ProcessPoolExecutor(workers, mp_context=context, initializer=_become_worker)
        try:
            yield pool
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            _end([child for child in multiprocessing.active_children() if child not in others])
            raise
        pool.shutdown()


def _end(children: list[Any]) -> None:
    """Ask processes to leave in good order, and end those that do not."""
    for ask in ("terminate", "kill"):
        for child in children:
            getattr(child, ask)()
        for child in children:
            child.join(_SECONDS_TO_LEAVE)


def _in_good_order(work: Callable[[Any], Any], piece: Any) -> Any:
    """The result of a piece; asked to end, a worker leaves nothing half made, and vanishes as if it had been killed."""
    try:
        # A pool that misses one worker asks the others to end, which were asked already and are tidying.
        with interruptible(once=True), heard():
            return work(piece)
    except Interrupted:
        os._exit(1)


def _become_worker() -> None:
    """Leave interruptions to the process that asked for the work, and end where that is no more."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        connection.wait([parent.sentinel])
        os._exit(1)
