"""Who does independent pieces of work: this process, several processes of this machine or a Dask cluster."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import TypeVar

Piece = TypeVar("Piece")
Result = TypeVar("Result")
# A piece whose workers vanish so often is given up: it is what ends them.
TRIES = 3
LOCAL = "local"


def processors() -> int:
    """How many processors this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


@dataclass(frozen=True)
class Workforce:
    """Who does the work: this process alone, several processes of this machine, or a Dask cluster.

    ``scheduler`` is a Dask scheduler's address (``tcp://host:port``), or ``local`` for a cluster on this machine;
    ``workers`` is how many processes, one where absent (with ``local``: one per processor).
    """

    workers: int | None = None
    scheduler: str | None = None

    @property
    def is_alone(self) -> bool:
        """Whether this process does everything itself."""
        return self.scheduler is None and (self.workers or 1) == 1

    def __str__(self) -> str:
        if self.scheduler is not None:
            return f"Dask, {self.scheduler}"
        return "one process" if self.is_alone else f"{self.workers} processes"
