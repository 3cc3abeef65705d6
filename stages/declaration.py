"""What a stage declares about itself, what it hands back, and which module does its part of a type of mechanism."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import pyarrow as pa

    from truing.schemas.campaign import Campaign

Progress = Callable[[int, int, str], None]  # done, total, what is being worked on


@dataclass(frozen=True)
class Stage:
    """A stage's name, the artifacts it reads and leaves, and the sections of campaign.toml it may read.

    A trailing ``?`` in ``reads`` or ``leaves`` marks an artifact that a campaign may do without. Which stage is
    stale, and in which order what depends on what, follows from these declarations alone.
    """

    name: str
    reads: tuple[str, ...]
    leaves: tuple[str, ...]
    settings: tuple[str, ...]
    summary: str


@dataclass(frozen=True)
class Outcome:
    """What a stage made, and the words of its closing line: what it read, what it left out and why, its main figure."""

    artifacts: Mapping[str, pa.Table | pa.RecordBatchReader | str]
    read: str
    left_out: str
    figure: str
    failed_checks: tuple[str, ...] = ()
    why_not: str = ""  # why it evaluated nothing; empty where it did

    @classmethod
    def not_evaluated(cls, left: Mapping[str, pa.Table], why: str) -> Outcome:
        """The outcome of a campaign that does not hold what a stage needs; ``left``: its tables without rows."""
        return cls(left, "nothing", "nothing", f"not evaluated: {why}", why_not=why)


def registered(modules: Mapping[str, str], settings: Campaign) -> Any:
    """Return the module that a stage lists for the campaign's type of mechanism; None where it lists none."""
    name = modules.get(settings.mechanism.type)
    return None if name is None else import_module(name)
