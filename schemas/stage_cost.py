"""Time and memory that a stage of a run took."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class StageCost:
    """Cost of the last run of a stage: time, largest memory of the main process (None where unknown), processes."""

    stage: str
    seconds: float
    memory_bytes: int | None = None
    workers: int = 1
