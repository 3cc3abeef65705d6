"""Times that stages took in a run folder, from which the next run estimates its duration."""

from __future__ import annotations

import json
import platform
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path

from truing.pipeline.atomic_file import write_atomically
from truing.schemas.stage_cost import StageCost

DURATIONS_FILE = "durations.json"
_STATUS, _CLEAR = Path("/proc/self/status"), Path("/proc/self/clear_refs")
_LIKE = 1.25  # largest ratio of raw bytes of two runs whose stages take about as long


@dataclass(frozen=True)
class Duration:
    """Seconds that a stage took, bytes of the campaign's raw files, processes, name of the machine, and largest memory.

    ``memory_bytes``: of the main process; None where unknown.
    """

    seconds: float
    raw_bytes: int
    workers: int
    machine: str
    memory_bytes: int | None = None


@dataclass
class Durations:
    """Times of the stages of one run folder, for a campaign of ``raw_bytes`` with ``workers`` processes."""

    store: Path
    raw_bytes: int
    workers: int
    machine: str = field(default_factory=platform.node)

    def expected(self, stages: Iterable[str]) -> float | None:
        """Return the seconds that stages will take; None if one of them has no like run here."""
        known = self._known()
        each = [known.get(name) for name in stages]
        return sum(one.seconds for one in each if one) if each and all(map(self._is_like, each)) else None

    def costs(self, stages: Iterable[str]) -> tuple[StageCost, ...]:
        """Return the known durations of the last runs of stages in this folder."""
        known = self._known()
        return tuple(
            StageCost(name, one.seconds, one.memory_bytes, one.workers)
            for name in stages
            if (one := known.get(name)) is not None
        )

    def note(self, stage: str, seconds: float, memory_bytes: int | None = None) -> None:
        """Keep the time and memory of a stage that has just ended."""
        cost = Duration(round(seconds, 3), self.raw_bytes, self.workers, self.machine, memory_bytes)
        known = self._known() | {stage: cost}
        write_atomically(self.store, json.dumps({name: asdict(one) for name, one in known.items()}).encode())

    def _is_like(self, duration: Duration | None) -> bool:
        if duration is None or (duration.workers, duration.machine) != (self.workers, self.machine):
            return False
        low, high = sorted((duration.raw_bytes, self.raw_bytes))
        return high <= _LIKE * low

    def _known(self) -> dict[str, Duration]:
        try:
            read = json.loads(self.store.read_bytes())
            return {
                str(name): Duration(
                    *(float(one["seconds"]), int(one["raw_bytes"]), int(one["workers"]), str(one["machine"])),
                    memory_bytes=None if (memory := one.get("memory_bytes")) is None else int(memory),
                )
                for name, one in read.items()
            }
        except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
            return {}


def forget_largest_memory() -> None:
    """Let the largest memory of this process count from now on."""
    with suppress(OSError):
        _CLEAR.write_text("5")


def largest_memory() -> int | None:
    """Return the largest memory of this process, bytes; None if the system does not report it."""
    try:
        line = next(line for line in _STATUS.read_text().splitlines() if line.startswith("VmHWM"))
    except (OSError, StopIteration):
        return None
    return 1024 * int(line.split()[1])
