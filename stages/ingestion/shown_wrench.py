"""A sensor that shows the wrench instead of its legs' signals: what its legs must have said, by its own geometry."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from schemas.columns import COLUMNS
from schemas.faults import Fault
from stages.ingestion.gathered_columns import numbers
from truing.formats.faultlog import FaultLog
from truing.formats.gather import Gathered
from truing.formats.shapes import SHOWN

_SINGULAR = 1e12  # condition number of the leg forces' influence, N and N m
_PER_N = 1.0  # mV per N of a leg, where no sensitivity is declared


def with_leg_signals(found: Gathered, settings: Any, log: FaultLog) -> Gathered:
    """The table with signals v1_mv .. v6_mv in place of the wrench shown: its leg forces times the sensitivity."""
    import pyarrow as pa

    names = found.table.column_names
    signals = [name for name in names if COLUMNS["signal"].matches(name)]
    if signals or any(name not in names for name in SHOWN):
        expected = f"either the signals of the legs, or all of {', '.join(SHOWN)}"
        log.add(Fault(found.first_file, expected, value=", ".join([*signals, *(n for n in SHOWN if n in names)])))
    if settings.mechanism.type != "6-upur":
        expected = '[mechanism] type = "6-upur": what a sensor shows is told of its legs by their geometry'
        log.add(Fault("campaign.toml", expected, column="mechanism.type", value=settings.mechanism.type))
    if log:
        return found
    from stages.sensor.nominal_sensor import sensor_joints
    from truing.simulation.six_upur.influence import influence_matrix

    G = influence_matrix(sensor_joints(settings.mechanism))
    if np.linalg.cond(G) > _SINGULAR:
        log.add(Fault("campaign.toml", "legs that carry every load, not parallel ones", column="mechanism.legs"))
        return found
    shown = np.column_stack([numbers(found, name) for name in SHOWN])
    sensitivity = np.broadcast_to(settings.signals.sensitivity_mv_per_n or _PER_N, 6)
    told = np.linalg.solve(G, shown.T).T * sensitivity
    table = found.table.select([name for name in names if name not in SHOWN])
    for leg in range(6):
        table = table.append_column(f"v{leg + 1}_mv", pa.array(told[:, leg]))
    return replace(found, table=table)
