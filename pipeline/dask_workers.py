"""Pieces of work on a Dask cluster: a scheduler that is there already, or a cluster on this machine for this call."""

from __future__ import annotations

import logging
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from itertools import islice
from typing import TYPE_CHECKING

from truing.child_processes import safe_children
from truing.pipeline.interruption import children_without_interrupts
from truing.pipeline.problems import EnvironmentProblem
from truing.pipeline.workforce import LOCAL, TRIES, Piece, Result, Workforce

if TYPE_CHECKING:
    from distributed import Client, Future

_SECONDS_TO_ANSWER = 30.0
_AHEAD = 4  # pieces handed out per thread of the workers


def completed_on_cluster(
    work: Callable[[Piece], Result], pieces: Sequence[Piece], workforce: Workforce, lost: Callable[[Piece], Result]
) -> Iterator[tuple[int, Result]]:
    """Yield number and result of every piece, in the order in which they are completed.

    Raises EnvironmentProblem where no scheduler answers, no worker joins, or the connection breaks.
    """
    with _client(workforce) as client:
        suspects = []
        for number, future in _futures(client, work, pieces, range(len(pieces))):
            if _lost_its_workers(future, workforce):
                suspects.append(number)
            else:
                yield number, future.result()
        # A scheduler blames all that a vanished worker had in hand; done alone, only the guilty piece is lost again.
        for number in suspects:
            ((_, future),) = _futures(client, work, pieces, [number])
            yield number, lost(pieces[number]) if _lost_its_workers(future, workforce) else future.result()


def _futures(
    client: Client, work: Callable[[Piece], Result], pieces: Sequence[Piece], numbers: Sequence[int]
) -> Iterator[tuple[int, Future]]:
    """Yield pieces' futures as they are completed; what is not cannot begin any more once nobody waits for it.

    Only some pieces ahead of the workers are handed out, so that a scheduler need not hold thousands.
    """
    from distributed import as_completed

    waiting: dict[Future, int] = {}
    left = iter(numbers)
    completed = as_completed(loop=client.loop)

    def hand_out(count: int) -> None:
        for number in islice(left, count):
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


def _lost_its_workers(future: Future, workforce: Workforce) -> bool:
    """Whether a piece is done for want of a worker that survives it; raises EnvironmentProblem without a scheduler."""
    from distributed import KilledWorker

    if future.cancelled():
        raise EnvironmentProblem(f"{workforce}: the connection to the scheduler broke")
    return isinstance(future.exception(), KilledWorker)


@contextmanager
def _client(workforce: Workforce) -> Iterator[Client]:
    """A client of the cluster, with at least one worker; a local cluster ends with it."""
    import dask
    from distributed import Client

    with ExitStack() as stack:
        # A scheduler's own word for "given up" counts the tries after the first.
        quiet = {"distributed.scheduler.allowed-failures": TRIES - 1, "distributed.admin.tick.limit": "1h"}
        stack.enter_context(dask.config.set(quiet))
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
        # Dask's scratch folder would stay behind where everybody's temporary files are.
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
            with suppress(Exception):  # it stumbles over a worker that vanished a moment ago and is being replaced
                cluster.close()
