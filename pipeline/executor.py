"""Execution of many independent pieces of work in several processes or on a Dask cluster, with the same results.

A lost process does not end the others. A Dask cluster on this machine would start eight times slower (3.3 s, not 0.4
s). Pools of loky, joblib and the standard library break as a whole when one worker is lost.
"""

from __future__ import annotations

import logging
import multiprocessing
import os
import signal
import tempfile
import threading
from collections import Counter, deque
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import ExitStack, closing, contextmanager, suppress
from dataclasses import dataclass, field
from itertools import islice
from multiprocessing import connection
from multiprocessing.process import BaseProcess
from typing import TYPE_CHECKING, Generic, TypeVar

from truing.child_processes import safe_children
from truing.pipeline.interruption import children_without_interrupts, interruptible, raise_if_interrupted
from truing.pipeline.problems import EnvironmentProblem, Interrupted

if TYPE_CHECKING:
    from distributed import Client
    from distributed import Future as DaskFuture


Piece = TypeVar("Piece")
Result = TypeVar("Result")
# A piece is given up after this number of lost workers, because it probably ends them.
TRIES = 3
LOCAL = "local"

_SECONDS_TO_LEAVE = 10.0
# Poll interval for pending signals, s.
_SECONDS_BETWEEN_LOOKS = 0.5

_SECONDS_TO_ANSWER = 30.0
# The scheduler's limit counts the tries after the first. A worker keeps the profile of every second: megabytes each.
_DASK = {
    "distributed.scheduler.allowed-failures": TRIES - 1,
    "distributed.admin.tick.limit": "1h",
    "distributed.worker.profile.enabled": False,
}
_AHEAD = 4  # pieces submitted per thread of the workers


def processors() -> int:
    """Number of processors that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


@dataclass(frozen=True)
class Workforce:
    """Means of execution: this process, several processes of this machine, or a Dask cluster.

    ``scheduler``: address of a Dask scheduler (``tcp://host:port``), or ``local`` for a cluster on this machine;
    ``workers``: number of processes, by default one (with ``local``: one per processor).
    """

    workers: int | None = None
    scheduler: str | None = None

    @property
    def is_alone(self) -> bool:
        """True if this process does all the work."""
        return self.scheduler is None and (self.workers or 1) == 1

    def __str__(self) -> str:
        if self.scheduler is not None:
            return f"Dask, {self.scheduler}"
        return "one process" if self.is_alone else f"{self.workers} processes"


def installed(workforce: Workforce) -> Workforce:
    """The workforce; processes of this machine in place of a local cluster where Dask is not installed."""
    if workforce.scheduler != LOCAL:
        return workforce
    try:
        import distributed  # noqa: F401
    except ModuleNotFoundError:
        return Workforce(workforce.workers or processors())
    return workforce


def results(
    work: Callable[[Piece], Result],
    pieces: Sequence[Piece],
    workforce: Workforce,
    lost: Callable[[Piece], Result],
    progress: Callable[[int], None] = lambda done: None,
) -> Generator[Result]:
    """Yield the results of all pieces, in order, as soon as available.

    ``work`` and the pieces must be picklable, and ``work`` importable by the workers; its exceptions end everything. A
    piece whose worker was lost (killed, out of memory, machine gone) is repeated; after the third loss ``lost`` gives
    its result. ``progress`` receives the number done. An exception, an interruption or closing the generator ends local
    workers, and cancels what a cluster has not started.
    """
    early: dict[int, Result] = {}
    following = 0
    with closing(_completed_pieces(work, pieces, workforce, lost)) as completed:
        for done, (number, result) in enumerate(completed, start=1):
            progress(done)
            early[number] = result
            while following in early:
                yield early.pop(following)
                following += 1


def _completed_pieces(
    work: Callable[[Piece], Result],
    pieces: Sequence[Piece],
    workforce: Workforce,
    lost: Callable[[Piece], Result],
) -> Generator[tuple[int, Result]]:
    """Yield number and result of every piece, in order of completion."""
    if workforce.scheduler is not None:
        yield from _completed_on_cluster(work, pieces, workforce, lost)
    elif workforce.is_alone:
        yield from ((number, work(piece)) for number, piece in enumerate(pieces))
    else:
        yield from _completed_by_processes(work, pieces, min(workforce.workers or 1, len(pieces)), lost)


def _completed_by_processes(
    work: Callable[[Piece], Result], pieces: Sequence[Piece], workers: int, lost: Callable[[Piece], Result]
) -> Iterator[tuple[int, Result]]:
    """Yield number and result of every piece, in order of completion."""
    queue = _Queue(work, pieces, lost, deque(range(len(pieces))))
    while queue.waiting or queue.suspects:
        with _pool(workers) as pool:
            yield from queue.completed_pieces(pool, workers)


@dataclass
class _Queue(Generic[Piece, Result]):
    """Remaining pieces. Pieces in progress when a worker is lost are suspects: they are repeated one at a time, to
    identify the one that ends its workers without cost to the others."""

    work: Callable[[Piece], Result]
    pieces: Sequence[Piece]
    lost: Callable[[Piece], Result]
    waiting: deque[int]
    suspects: deque[int] = field(default_factory=deque)
    losses: Counter[int] = field(default_factory=Counter)

    def completed_pieces(self, pool: ProcessPoolExecutor, workers: int) -> Iterator[tuple[int, Result]]:
        """Yield completed pieces until none is left, or the pool has lost a worker."""
        under_way: dict[Future[Result], int] = {}
        while self._submit_pieces(pool, under_way, workers):
            done, _ = wait(under_way, timeout=_SECONDS_BETWEEN_LOOKS, return_when=FIRST_COMPLETED)
            intact = [future for future in done if not isinstance(future.exception(), BrokenProcessPool)]
            for future in intact:
                yield under_way.pop(future), future.result()
            if len(intact) < len(done):
                yield from self._suspect(list(under_way.values()))
                return

    def _submit_pieces(self, pool: ProcessPoolExecutor, under_way: dict[Future[Result], int], workers: int) -> bool:
        """Keep the workers busy; returns True if anything is in progress. A broken pool refuses all further work."""
        while self.suspects and not under_way:
            self._submit(pool, under_way, self.suspects.popleft())
        while self.waiting and not self.suspects and len(under_way) < workers and not self._is_alone(under_way):
            self._submit(pool, under_way, self.waiting.popleft())
        return bool(under_way)

    def _is_alone(self, under_way: dict[Future[Result], int]) -> bool:
        return any(self.losses[number] for number in under_way.values())

    def _submit(self, pool: ProcessPoolExecutor, under_way: dict[Future[Result], int], number: int) -> None:
        try:
            with children_without_interrupts():
                under_way[pool.submit(_in_good_order, self.work, self.pieces[number])] = number
        except BrokenProcessPool as error:  # a worker was lost before it received anything
            failed: Future[Result] = Future()
            failed.set_exception(error)
            under_way[failed] = number

    def _suspect(self, numbers: list[int]) -> Iterator[tuple[int, Result]]:
        """Put back the pieces in progress; yield the substitute result of a piece that is given up."""
        self.losses.update(numbers)
        for number in numbers:
            if self.losses[number] >= TRIES:
                yield number, self.lost(self.pieces[number])
            else:
                self.suspects.append(number)


@contextmanager
def _pool(workers: int) -> Iterator[ProcessPoolExecutor]:
    """A pool of new processes, which end with the context."""
    earlier_children = set(multiprocessing.active_children())
    context = multiprocessing.get_context("spawn")  # a fork would copy this process's locks and threads
    with safe_children():  # processes start when there is work for them
        pool = ProcessPoolExecutor(workers, mp_context=context, initializer=_become_worker)
        try:
            yield pool
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            _end([child for child in multiprocessing.active_children() if child not in earlier_children])
            raise
        pool.shutdown()


def _end(children: list[BaseProcess]) -> None:
    """Ask processes to end, and kill those that do not."""
    for ask in ("terminate", "kill"):
        for child in children:
            getattr(child, ask)()
        for child in children:
            child.join(_SECONDS_TO_LEAVE)


def _in_good_order(work: Callable[[Piece], Result], piece: Piece) -> Result:
    """Result of a piece in a worker, which cleans up on a signal to end."""
    try:
        # A pool that lost a worker asks the others to end; they were asked before and are cleaning up.
        with interruptible(once=True), raise_if_interrupted():
            return work(piece)
    except Interrupted:
        os._exit(1)


def _become_worker() -> None:
    """Leave interruptions to the parent process, and end when it ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        connection.wait([parent.sentinel])
        os._exit(1)


def _completed_on_cluster(
    work: Callable[[Piece], Result], pieces: Sequence[Piece], workforce: Workforce, lost: Callable[[Piece], Result]
) -> Iterator[tuple[int, Result]]:
    """Yield number and result of every piece, in order of completion.

    Raises EnvironmentProblem if no scheduler answers, no worker joins, or the connection breaks.
    """
    with _client(workforce) as client:
        suspects = []
        for number, future in _completed_futures(client, work, pieces, range(len(pieces))):
            if _lost_its_workers(future, workforce):
                suspects.append(number)
            else:
                yield number, future.result()
        # A scheduler blames all pieces of a lost worker; repeated alone, only the piece at fault is lost again.
        for number in suspects:
            ((_, future),) = _completed_futures(client, work, pieces, [number])
            yield number, lost(pieces[number]) if _lost_its_workers(future, workforce) else future.result()


def _completed_futures(
    client: Client, work: Callable[[Piece], Result], pieces: Sequence[Piece], numbers: Sequence[int]
) -> Iterator[tuple[int, DaskFuture]]:
    """Yield the futures of pieces as they complete; others are cancelled when the generator closes.

    Only a limited number of pieces is submitted ahead, so that the scheduler need not hold thousands.
    """
    from distributed import as_completed

    waiting: dict[DaskFuture, int] = {}
    remaining = iter(numbers)
    completed = as_completed(loop=client.loop)

    def hand_out(count: int) -> None:
        for number in islice(remaining, count):
            future = client.submit(work, pieces[number], pure=False)
            waiting[future] = number
            completed.add(future)

    try:
        hand_out(_AHEAD * max(sum(client.ncores().values()), 1))
        for future in completed:
            hand_out(max(_AHEAD * sum(client.ncores().values()) - len(waiting) + 1, 1))
            yield waiting.pop(future), future
    finally:
        client.cancel(list(waiting))


def _lost_its_workers(future: DaskFuture, workforce: Workforce) -> bool:
    """True if a piece ended because it lost its workers; raises EnvironmentProblem without a scheduler."""
    from distributed import KilledWorker

    if future.cancelled():
        raise EnvironmentProblem(f"{workforce}: the connection to the scheduler broke")
    return isinstance(future.exception(), KilledWorker)


@contextmanager
def _client(workforce: Workforce) -> Iterator[Client]:
    """A client of the cluster with at least one worker; a local cluster ends with it."""
    import dask
    from distributed import Client

    with ExitStack() as stack:
        stack.enter_context(dask.config.set(_DASK))
        address = workforce.scheduler
        if address == LOCAL:
            address = stack.enter_context(_local_cluster(workforce.workers))
        try:
            client = stack.enter_context(Client(address, timeout=_SECONDS_TO_ANSWER, set_as_default=False))
            client.wait_for_workers(1, timeout=_SECONDS_TO_ANSWER)
        except (OSError, ValueError) as error:
            raise EnvironmentProblem(f"{workforce}: no scheduler with a worker answers there ({error})") from error
        yield client


@contextmanager
def _local_cluster(workers: int | None) -> Iterator[str]:
    import dask
    from distributed import LocalCluster

    with ExitStack() as stack:
        # Dask's scratch folder would otherwise stay behind in the system's temporary folder.
        scratch = stack.enter_context(tempfile.TemporaryDirectory(prefix="truing-", ignore_cleanup_errors=True))
        stack.enter_context(dask.config.set({"temporary-directory": scratch}))
        stack.enter_context(safe_children())
        with children_without_interrupts():
            cluster = LocalCluster(
                n_workers=workers,
                threads_per_worker=1,
                processes=True,
                dashboard_address=":0",
                silence_logs=logging.CRITICAL,
                local_directory=scratch,
            )
        try:
            yield cluster.scheduler_address
        finally:
            with suppress(Exception):  # fails for a worker that was just lost and is being replaced
                cluster.close()
