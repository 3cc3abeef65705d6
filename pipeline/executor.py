"""Many independent pieces of work: here, in several processes or on a Dask cluster, with the same results."""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from contextlib import closing

from truing.pipeline.workforce import Piece, Result, Workforce


def results(
    work: Callable[[Piece], Result],
    pieces: Sequence[Piece],
    workforce: Workforce,
    lost: Callable[[Piece], Result],
    progress: Callable[[int], None] = lambda done: None,
) -> Generator[Result]:
    """Yield the result of every piece, in the order of the pieces, as soon as those before it are there.

    ``work`` and the pieces must be picklable, and ``work`` importable where it is done; its exceptions end everything.
    A piece whose worker vanished (killed, out of memory, its machine gone) is done again, and after the third time
    ``lost`` says what stands in its place. ``progress`` is told how many are done. An exception, an interruption or
    closing the generator ends the workers that were started here, and cancels what a cluster has not begun.
    """
    early: dict[int, Result] = {}
    following = 0
    with closing(_completed(work, pieces, workforce, lost)) as completed:
        for done, (number, result) in enumerate(completed, start=1):
            progress(done)
            early[number] = result
            while following in early:
                yield early.pop(following)
                following += 1


def _completed(
    work: Callable[[Piece], Result],
    pieces: Sequence[Piece],
    workforce: Workforce,
    lost: Callable[[Piece], Result],
) -> Generator[tuple[int, Result]]:
    """Yield number and result of every piece, in the order in which they are completed."""
    if workforce.scheduler is not None:
        from truing.pipeline.dask_workers import completed_on_cluster

        yield from completed_on_cluster(work, pieces, workforce, lost)
    elif workforce.is_alone:
        yield from ((number, work(piece)) for number, piece in enumerate(pieces))
    else:
        from truing.pipeline.process_workers import completed_by_processes

        yield from completed_by_processes(work, pieces, min(workforce.workers or 1, len(pieces)), lost)
