"""Positioning runs of an axis: targets approached from both sides, again and again."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from schemas.faults import Fault
from stages.ingestion.corrected_readings import Corrections, positions_at_reference
from stages.ingestion.gathered_columns import numbered, numbers, texts
from stages.ingestion.load_steps import check_once
from stages.ingestion.tables import SmallTable, as_artifact
from truing.formats.faultlog import FaultLog
from truing.formats.gather import Gathered, gather
from truing.formats.shapes import POSITIONING
from truing.formats.source import CampaignFiles

_WAYS = ("forward", "backward")
_FEWEST_CYCLES = 2
_MANY = 0.5  # of the rows: targets that are approached again are fewer


@dataclass
class PositionTable(SmallTable):
    """Approaches, and what was corrected."""

    corrections: Corrections = field(default_factory=Corrections)


def read_positions(source: CampaignFiles, settings: Any, log: FaultLog) -> PositionTable | None:
    """The approaches, ordered by run, target, direction and cycle; None where the campaign has none."""
    found = gather(source, POSITIONING, log, "run")
    if found is None:
        return None
    check_once(found, log, "run", "target_mm", "direction", "cycle")
    if not log:
        _check_whole(found, log)
    read = numbers(found, "position_mm")
    found, corrections = positions_at_reference(found, settings.interferometer, log)
    if log:
        return None
    way = np.array([_WAYS.index(name) for name in texts(found, "direction")])
    import pyarrow as pa

    table = found.table.append_column("row_order", pa.array(np.arange(1, len(way) + 1)))
    if corrections.rows:
        table = table.append_column("position_read_mm", pa.array(read))
    order = np.lexsort((numbers(found, "cycle"), way, numbers(found, "target_mm"), numbered(found, "run")))
    return PositionTable(as_artifact("positions", table.take(order)), dict(found.left_out), corrections)


def _check_whole(found: Gathered, log: FaultLog) -> None:
    """Note runs whose targets were not all approached in the same cycles, from either side, twice at least."""
    runs = texts(found, "run")
    for run in dict.fromkeys(runs):
        own = runs == run
        columns = (numbers(found, "target_mm")[own], texts(found, "direction")[own], numbers(found, "cycle")[own])
        targets, ways, cycles = (set(column.tolist()) for column in columns)
        missing = len(targets) * len(cycles) * len(_WAYS) - int(own.sum())
        if missing or ways != set(_WAYS) or len(cycles) < _FEWEST_CYCLES:
            said = f"run {run}: {len(targets)} targets, {len(cycles)} cycles, {', '.join(sorted(ways))}"
            said += f", {missing} approaches missing" if missing else ""
            expected = f"every target approached from both sides in every cycle, {_FEWEST_CYCLES} cycles at least"
            if len(targets) > _MANY * int(own.sum()) > _MANY * len(set(numbers(found, "position_mm")[own].tolist())):
                expected += "; are the columns target_mm and position_mm exchanged?"
            log.add(Fault(found.first_file, expected, column="cycle", value=said))
