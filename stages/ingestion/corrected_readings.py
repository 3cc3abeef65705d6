"""Correction of readings for air and for expansion of the frame, and of axis positions to 20 degrees C, with sizes and
uncertainties by channel."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from truing.arrays import Array, Mask, TableRow
from truing.estimation.interferometry.recorded_steps import (
    Corrected,
    at_reference_temperature,
    displacement_in_air,
    displacement_sigma,
    without_frame_growth,
)
from truing.formats.faultlog import FaultLog
from truing.formats.row_collection import CollectedRows
from truing.schemas.faults import Fault
from truing.simulation.air import ciddor_index, edlen_slopes, index_sigma, saturation_vapour_pressure_pa
from truing.stages.common.table_arrays import numbered, numbers, texts

if TYPE_CHECKING:
    from truing.schemas.interferometer import Growth, Interferometer, SurroundingsSigma


AIR = ("air_temperature_c", "air_pressure_hpa", "relative_humidity_pct")
MATERIAL = "material_temperature_c"
_UM_PER_MM, _PA_PER_HPA = 1e3, 1e2
# Sensors of the surroundings err independently at the start of a run and at a reading, which is the worst case.
_APART = np.sqrt(2.0)


@dataclass
class Corrections:
    """Rows of ``reading_corrections``."""

    rows: list[TableRow] = field(default_factory=list)

    def add(self, subjects: NDArray[np.object_], name: str, change: Array | None, sigma: Array | None) -> None:
        """The largest change (N,) and sigma (N,) of each subject (N,), um for linear channels, else arcsec."""
        for subject in dict.fromkeys(subjects.tolist()):
            is_of_subject = subjects == subject
            largest, left = (
                None if values_given is None else _largest(values_given[is_of_subject])
                for values_given in (change, sigma)
            )
            unit = "arcsec" if subject.startswith("r") else "um"
            self.rows.append({"subject": subject, "correction": name, "largest": largest, "sigma": left, "unit": unit})


def _largest(values: Array) -> float | None:
    known = np.abs(values[np.isfinite(values)])
    return float(known.max()) if len(known) else None


def corrected(
    collected: CollectedRows, reading: Array, settings: Interferometer, log: FaultLog
) -> tuple[Array, Corrections]:
    """Return displacements (N,) from readings (N,), um or arcsec as the readings, and the corrections made.

    Air and temperature at zero are those of the run's first step.
    """
    channel, corrections = texts(collected, "channel"), Corrections()
    grows = [name for name in ("dx", "dy", "dz") if getattr(settings.material, name) and (channel == name).any()]
    if not settings.compensated:
        _check(collected, AIR, "readings are not compensated ([interferometer] compensated = false)", log)
    if grows:
        _check(collected, (MATERIAL,), "[interferometer.material] says how the frame grows", log)
    if log:
        return reading, corrections
    value = _corrected_for_air(collected, reading, channel, settings, corrections)
    for name in grows:
        value = _without_growth(
            collected, value, channel == name, getattr(settings.material, name), settings, corrections
        )
    return value, corrections


def _check(collected: CollectedRows, names: Sequence[str], why: str, log: FaultLog) -> None:
    for name in names:
        if name not in collected.table.column_names:
            log.add(Fault(collected.first_file, f"a column {name}, as {why}", column=name))
        else:
            collected.fault(log, np.isnan(numbers(collected, name)), name, f"a number in every row, as {why}")


def _relative_to_zero(collected: CollectedRows, values: Array) -> Array:
    """Return the values (N,) at the first step of each row's run."""
    run, step = numbered(collected, "run"), numbers(collected, "step")
    order = np.lexsort((step, run))
    _, first = np.unique(run[order], return_index=True)
    return np.asarray(values[order[first]][run])


def _corrected_for_air(
    collected: CollectedRows,
    reading: Array,
    channel: NDArray[np.object_],
    settings: Interferometer,
    corrections: Corrections,
) -> Array:
    """Return readings corrected for air; compensated readings unchanged, with the uncertainty of their air."""
    known = all(name in collected.table.column_names for name in AIR)
    spread = settings.surroundings_sigma
    if settings.compensated and not (known and spread):
        return reading
    celsius, pressure, humidity = (numbers(collected, name) for name in AIR)
    pascal, saturated = _PA_PER_HPA * pressure, saturation_vapour_pressure_pa(celsius)
    vapour, wavelength = 1e-2 * humidity * saturated, 1e-9 * settings.wavelength_nm
    dead = np.array([_UM_PER_MM * getattr(settings.dead_path_mm, name, 0.0) for name in channel])
    value, change = reading, None
    if not settings.compensated:
        index = ciddor_index(wavelength, celsius, pascal, vapour)
        value = displacement_in_air(reading, index, _relative_to_zero(collected, index), dead)
        change = value - reading
    sigma = None
    if spread:
        each = np.stack(
            [
                np.full_like(celsius, spread.air_temperature_c),
                np.full_like(celsius, _PA_PER_HPA * spread.air_pressure_hpa),
                1e-2 * spread.relative_humidity_pct * saturated,
            ],
            axis=-1,
        )
        slopes = edlen_slopes(wavelength, celsius, pascal, vapour)
        drift = _APART * index_sigma(slopes, each, 0.0)
        sigma = displacement_sigma(value, dead, index_sigma(slopes, each, spread.index), drift)
    corrections.add(channel, "air", change, sigma)
    return value


def _without_growth(
    collected: CollectedRows,
    reading: Array,
    rows: Mask,
    growth: Growth,
    settings: Interferometer,
    corrections: Corrections,
) -> Array:
    """Readings of one channel's rows (N,) minus the expansion of its material since the start of each run."""
    celsius = numbers(collected, MATERIAL)
    read = _APART * _read_with(settings.surroundings_sigma)
    less = without_frame_growth(
        reading[rows],
        _UM_PER_MM * growth.length_mm,
        growth.expansion_per_k,
        celsius[rows],
        _relative_to_zero(collected, celsius)[rows],
        expansion_sigma=growth.expansion_sigma_per_k,
        temperature_sigma=read,
    )
    corrections.add(texts(collected, "channel")[rows], "material", less.value - reading[rows], less.sigma)
    value = reading.copy()
    value[rows] = less.value
    return value


def _read_with(spread: SurroundingsSigma | None) -> float:
    return 0.0 if spread is None else spread.material_temperature_c


def positions_at_reference(
    collected: CollectedRows, settings: Interferometer, log: FaultLog
) -> tuple[CollectedRows, Corrections]:
    """Positions of an axis, mm, at 20 degrees C, if [interferometer.material] declares its expansion."""
    corrections, axis = Corrections(), settings.material.axis
    if axis is None:
        return collected, corrections
    _check(collected, (MATERIAL,), "[interferometer.material] says how the axis grows", log)
    if log:
        return collected, corrections
    positions = numbers(collected, "position_mm")
    less: Corrected = at_reference_temperature(
        positions,
        axis.expansion_per_k,
        numbers(collected, MATERIAL),
        expansion_sigma=axis.expansion_sigma_per_k,
        temperature_sigma=_read_with(settings.surroundings_sigma),
    )
    subject = np.full(len(positions), "axis", object)
    corrections.add(subject, "material", _UM_PER_MM * (less.value - positions), _UM_PER_MM * less.sigma)
    column = collected.table.column_names.index("position_mm")
    return replace(
        collected, table=collected.table.set_column(column, "position_mm", pa.array(less.value))
    ), corrections
