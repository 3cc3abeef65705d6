"""Declaration and outcome of a stage, and choice of its module by type of mechanism."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import pyarrow as pa

    from truing.schemas.campaign import Campaign

Progress = Callable[[int, int, str], None]  # done, total, current item


@dataclass(frozen=True)
class Stage:
    """Name of a stage, artifacts that it reads and writes, and sections of campaign.toml that it may read.

    A trailing ``?`` in ``reads`` or ``leaves`` marks an optional artifact. Freshness and order of stages follow from
    these declarations alone. ``streams``: tables among ``reads`` that are passed as StoredTable, to be read in batches.
    """

    name: str
    reads: tuple[str, ...]
    leaves: tuple[str, ...]
    settings: tuple[str, ...]
    summary: str
    streams: tuple[str, ...] = ()


@dataclass(frozen=True)
class Outcome:
    """Artifacts of a stage, and its closing line: data read, data left out with reasons, main figure."""

    artifacts: Mapping[str, pa.Table | pa.RecordBatchReader | str]
    read: str
    left_out: str
    figure: str
    failed_checks: tuple[str, ...] = ()
    why_not: str = ""  # reason for evaluating nothing; else empty

    @classmethod
    def not_evaluated(cls, left: Mapping[str, pa.Table], why: str) -> Outcome:
        """Outcome of a campaign without the needed data; ``left``: its tables without rows."""
        return cls(left, "nothing", "nothing", f"not evaluated: {why}", why_not=why)


def registered(modules: Mapping[str, str], settings: Campaign) -> ModuleType | None:
    """Return the module of a stage for the campaign's type of mechanism, or None."""
    name = modules.get(settings.mechanism.type)
    return None if name is None else import_module(name)
