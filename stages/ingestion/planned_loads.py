"""Planned load steps as tables of a run, with 0 for readings that are not measured yet."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, cast

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from truing.formats.faultlog import FaultLog
from truing.formats.raw_tables import DISPLACEMENT, MOTION, PLANNED, SIGNALS
from truing.formats.row_collection import CollectedRows, collect_rows
from truing.formats.source import CampaignFiles
from truing.schemas.faults import Fault
from truing.schemas.interferometer import Material
from truing.stages.common.table_arrays import numbers
from truing.stages.ingestion.loading_tables import check_sensor, read_compliance
from truing.stages.ingestion.reading_table import reading_table
from truing.stages.ingestion.signal_table import SIGNAL, signal_table

if TYPE_CHECKING:
    from truing.schemas.campaign import Campaign
    from truing.schemas.mechanism import SensorMechanism

_LEGS = 6
_NOISE = {
    "interferometer": {"d": "linear_um", "r": "angular_arcsec"},
    "displacement": {"d": "displacement_mm", "r": "rotation_rad"},
}


def planned_loads(source: CampaignFiles, settings: Campaign) -> dict[str, pa.Table] | None:
    """Tables ``readings``, ``signals`` and ``given_compliance`` of a campaign without measurements.

    None if anything was measured, or without a table of load steps. Raises CampaignFaults with all faults of the plan.
    """
    log = FaultLog()
    if source.entries("quadrature") or source.entries("positioning"):
        return None
    shape = PLANNED if source.entries("interferometer") else DISPLACEMENT
    steps, signals = collect_rows(source, shape, log, "run"), collect_rows(source, SIGNALS, log, "run")
    values = {"interferometer": ("reading",), "displacement": MOTION}[shape.name]
    absent = steps is None and signals is None and not log
    if absent or _measured(steps, values) or _measured(signals, _signals(signals)):
        return None
    log.raise_faults()
    readings = None if steps is None else _readings(steps, shape.name, settings, log)
    planned = None if signals is None else _planned_signals(signals, settings, readings, log)
    compliance = read_compliance(source, log)
    if settings.mechanism.type == "6-upur":
        check_sensor(cast("SensorMechanism", settings.mechanism), compliance, log)
    log.raise_faults()
    tables = {"readings": readings, "signals": planned, "given_compliance": compliance}
    return {name: table for name, table in tables.items() if table is not None}


def _measured(collected: CollectedRows | None, names: Sequence[str]) -> bool:
    """Return True if any of these columns has a value."""
    if collected is None:
        return False
    return any(
        bool(np.isfinite(numbers(collected, name)).any()) for name in names if name in collected.table.column_names
    )


def _signals(collected: CollectedRows | None) -> list[str]:
    return [] if collected is None else [name for name in collected.table.column_names if SIGNAL.fullmatch(name)]


def _with_zeros(collected: CollectedRows, names: Sequence[str]) -> CollectedRows:
    table = collected.table.drop_columns([name for name in names if name in collected.table.column_names])
    for name in names:
        table = table.append_column(name, pa.array(np.zeros(len(table))))
    return replace(collected, table=table)


def _readings(collected: CollectedRows, shape: str, settings: Campaign, log: FaultLog) -> pa.Table | None:
    by_channel = "channel" in collected.table.column_names  # without, all are read at every step
    named = [name for name in MOTION if name in collected.table.column_names] or list(MOTION)
    # simulated readings are compensated and corrected
    optics = settings.interferometer.model_copy(update={"compensated": True, "material": Material()})
    table = reading_table(
        _with_zeros(collected, ["reading"] if by_channel else named),
        settings.model_copy(update={"interferometer": optics}),
        log,
        by_channel=by_channel,
    )
    if table is None:
        return None
    _check_noise(table.table, _NOISE[shape], log)
    return table.table


def _check_noise(readings: pa.Table, keys: dict[str, str], log: FaultLog) -> None:
    unknown = set(readings.filter(pc.is_null(readings.column("sigma"))).column("channel").to_pylist())
    for kind, key in keys.items():
        if channels_of_kind := sorted(channel for channel in unknown if channel.startswith(kind)):
            expected = f"the standard deviation of channels {', '.join(channels_of_kind)}, to simulate their readings"
            log.add(Fault("campaign.toml", expected, column=f"noise.{key}"))


def _planned_signals(
    collected: CollectedRows, settings: Campaign, readings: pa.Table | None, log: FaultLog
) -> pa.Table:
    names = _signals(collected) or [f"v{leg}_mv" for leg in range(1, _LEGS + 1)]
    needed = {
        "signals.sensitivity_mv_per_n": settings.signals.sensitivity_mv_per_n,
        "noise.signal_mv": settings.noise.signal_mv,
    }
    for key, value in needed.items():
        if value is None:
            log.add(
                Fault(
                    "campaign.toml", f"a number, to simulate the signals that {collected.first_file} plans", column=key
                )
            )
    if len(names) != _LEGS or settings.mechanism.type != "6-upur":
        expected = "six signals, one per leg of a 6-upur: no others can be simulated"
        log.add(Fault(collected.first_file, expected, value=", ".join(names)))
    table = signal_table(_with_zeros(collected, names), settings, readings, log)
    return None if table is None else table.table
