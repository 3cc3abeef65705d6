"""Readings brought to the refractive index of the air that each was taken in, over displacement and dead path."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from schemas.faults import Fault
from stages.ingestion.gathered_columns import numbered, numbers, texts
from truing.estimation.interferometry.readings import displacement_in_air
from truing.formats.faultlog import FaultLog
from truing.formats.gather import Gathered
from truing.simulation.air import ciddor_index, vapour_pressure_pa

Array = NDArray[np.float64]

_AIR = ("air_temperature_c", "air_pressure_hpa", "relative_humidity_pct")
_UM_PER_MM = 1e3


def compensated(found: Gathered, reading: Array, settings: Any, log: FaultLog) -> Array:
    """Displacements (N,) of readings (N,) that count wavelengths of vacuum; um or arcsec as the readings are.

    The index at the zero is that of the run's first step.
    """
    _check_air(found, log)
    if log:
        return reading
    celsius, pressure, humidity = (numbers(found, name) for name in _AIR)
    index = ciddor_index(
        1e-9 * settings.wavelength_nm, celsius, 1e2 * pressure, vapour_pressure_pa(celsius, 1e-2 * humidity)
    )
    run, step = numbered(found, "run"), numbers(found, "step")
    order = np.lexsort((step, run))
    _, first = np.unique(run[order], return_index=True)
    at_zero = index[order[first]][run]
    paths = settings.dead_path_mm
    dead = np.array([_UM_PER_MM * getattr(paths, channel, 0.0) for channel in texts(found, "channel")])
    return displacement_in_air(reading, index, at_zero, dead)


def _check_air(found: Gathered, log: FaultLog) -> None:
    why = "readings are not compensated ([interferometer] compensated = false)"
    for name in _AIR:
        if name not in found.table.column_names:
            log.add(Fault(found.first_file, f"a column {name}, as {why}", column=name))
        else:
            found.fault(log, np.isnan(numbers(found, name)), name, f"a number in every row, as {why}")
