"""What the drawing says of a sensor: G, G' with the synthetic error, and how uncertain tolerances leave them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from stages.common.nominal_sensor import nominal_sensor
from stages.common.point_arrays import number_column
from stages.common.reading_arrays import LOAD_COLUMNS
from truing.simulation.bench.six_upur.nominal_sensor import NominalSensor
from truing.simulation.bench.six_upur.theory import Theory, farthest, theory_of

if TYPE_CHECKING:
    import pyarrow as pa

    from schemas.campaign import Campaign
    from schemas.sensor_mechanism import SensorMechanism

Array = NDArray[np.float64]

_MOVED = (*((f"d{axis}_mm", 1e-3) for axis in "xyz"), *((f"r{axis}_rad", 1.0) for axis in "xyz"))


def theory(settings: Campaign, tables: Mapping[str, pa.Table]) -> Theory | None:
    """The theory of [mechanism]; None where it is no such sensor."""
    if settings.mechanism.type != "6-upur":
        return None
    section: SensorMechanism = settings.mechanism  # type: ignore[assignment]
    given = tables.get("given_compliance")
    sensor = nominal_sensor(section, given if given is not None and given.num_rows else None)
    return theory_of(sensor, _largest(sensor, tables))


def _largest(sensor: NominalSensor, tables: Mapping[str, pa.Table]) -> Array:
    """The largest displacement (6,) of any load case: measured, else simulated, else none."""
    found = np.zeros(6)
    cases = tables.get("displacement")
    load = None
    if cases is not None and cases.num_rows:
        load = _loads(cases)
        moved = np.column_stack([number_column(cases, name) * unit for name, unit in _MOVED])
        found = np.where(np.isfinite(moved).any(0), farthest(np.nan_to_num(moved)), np.nan)
    elif "signals" in tables:
        load = _loads(tables["signals"])
    if load is not None and sensor.compliance is not None:
        found = np.where(np.isfinite(found) & (found != 0.0), found, farthest(load @ sensor.compliance.T))
    return np.nan_to_num(found)


def _loads(table: pa.Table) -> Array:
    return np.nan_to_num(np.column_stack([number_column(table, name) for name in LOAD_COLUMNS]))
