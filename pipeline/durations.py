"""Times that stages took in a run folder, from which the next run there says how long it will take."""

from __future__ import annotations

import json
import platform
from collections.abc import Iterable
from dataclasses import asdict, dataclass, field
from pathlib import Path

from truing.pipeline.whole_file import write_atomically

FILE = "durations.json"
_LIKE = 1.25  # largest ratio of raw bytes of two runs whose stages take about as long


@dataclass(frozen=True)
class Duration:
    """Seconds that a stage took, bytes of the campaign's raw files, processes, and name of the machine."""

    seconds: float
    raw_bytes: int
    workers: int
    machine: str


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

    def note(self, stage: str, seconds: float) -> None:
        """Keep the time of a stage that has just ended."""
        known = self._known() | {stage: Duration(round(seconds, 3), self.raw_bytes, self.workers, self.machine)}
        write_atomically(self.store, json.dumps({name: asdict(one) for name, one in known.items()}).encode())

    def _is_like(self, one: Duration | None) -> bool:
        if one is None or (one.workers, one.machine) != (self.workers, self.machine):
            return False
        low, high = sorted((one.raw_bytes, self.raw_bytes))
        return high <= _LIKE * low

    def _known(self) -> dict[str, Duration]:
        try:
            read = json.loads(self.store.read_bytes())
            return {
                str(name): Duration(float(one["seconds"]), int(one["raw_bytes"]), int(one["workers"]), one["machine"])
                for name, one in read.items()
            }
        except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
            return {}
