"""Loads of one instrument next to signals of another: rows joined by their order, by run and step, or by time."""

from __future__ import annotations

import numpy as np
import pyarrow as pa

from truing.formats.faultlog import FaultLog
from truing.formats.raw_tables import LOADS_APART, WRENCH
from truing.formats.row_collection import CollectedRows, collect_rows
from truing.formats.source import CampaignFiles
from truing.report.numbers import count_text, quantity
from truing.schemas.faults import Fault
from truing.stages.common.rows import Rows
from truing.stages.ingestion.joined_rows import by_key, by_order, by_time, check_clocks, with_columns

_LOADS = (*WRENCH, "load_axis", "load")
_TAKEN = (*_LOADS, "role")
_KEYS = 'joined_by = "step" or "time"'
_WAYS = f'joined_by = "rows", or a key: {_KEYS}'
_WORDS = {"rows": "by their order", "step": "by run and step", "time": "by the nearest time"}


def with_joined_loads(
    signals: CollectedRows | None, source: CampaignFiles, log: FaultLog
) -> tuple[CollectedRows | None, pa.Table | None]:
    """Return the signals with the loads of [files.loads], and one row on how they were joined; None without such loads.

    Signals without a row of loads are left out and counted. Nothing is joined unless the mapping declares it.
    """
    loads = collect_rows(source, LOADS_APART, log, "run")
    if loads is None:
        return signals, None
    (way, *others) = {entry.joined_by for entry in source.entries(LOADS_APART.name)}
    if signals is None:
        log.add(Fault(loads.first_file, "signals of the same load steps: [files.signals]"))
        return None, None
    if both := [name for name in _LOADS if name in signals.table.column_names]:
        log.add(Fault(signals.first_file, "loads in one file: here, or in [files.loads]", value=", ".join(both)))
    if way is None or others:
        log.add(Fault("campaign.toml", f"how rows of loads belong to those of signals: {_WAYS}", column="files.loads"))
    if log:
        return None, None
    return _joined(signals, loads, way or "", source, log)


def _joined(
    signals: CollectedRows, loads: CollectedRows, way: str, source: CampaignFiles, log: FaultLog
) -> tuple[CollectedRows | None, pa.Table | None]:
    table = Rows("loads_joined")
    about: dict[str, float] = {}
    place = np.full(len(signals.table), -1)
    if way == "rows":
        place = by_order(signals, loads, _KEYS, log)
    elif way == "step":
        key = ("run", "step") if "run" in loads.table.column_names else ("step",)
        place = by_key(signals, loads, key, "each load once", log)
    else:
        check_clocks(signals, loads, source, ("signals", LOADS_APART.name), log)
        place, about = (place, about) if log else by_time(signals, loads, log)
    if not log and (place < 0).all():
        log.add(Fault(loads.first_file, f"rows that belong to those of {signals.first_file}", column=_key(way)))
    if log:
        return None, None
    found = {"signal_rows": len(place), "load_rows": len(loads.table), "rows_matched": int((place >= 0).sum())}
    table.add(joined_by=way, **found, **about)
    names = [name for name in _TAKEN if name in loads.table.column_names]
    return with_columns(signals, loads, place, names, "signals without a row of loads"), table.table()


def _key(way: str) -> str | None:
    return {"step": "step", "time": "time_s"}.get(way)


def words_on_join(joined: pa.Table) -> str:
    """Return the numbers of joined rows of signals and loads, and the key by which they were joined."""
    (row,) = joined.to_pylist()
    text = f"loads of {row['rows_matched']:,} of {count_text(row['signal_rows'], 'row')} of signals"
    text += f" ({count_text(row['load_rows'], 'row')} of loads), joined {_WORDS[row['joined_by']]}"
    if row.get("largest_apart_s") is not None:
        text += f", at most {quantity(row['largest_apart_s'], 's')} apart"
    return text
