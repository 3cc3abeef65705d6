"""What a diagnosis knows of a sensor's signals beforehand: the sensor behind them, their noise, rows exchanged."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, cast

import numpy as np
from numpy.typing import NDArray

from truing.estimation.interferometry.recorded_steps import LOADS, RecordedSteps
from truing.simulation.bench.causes.rows_exchanged import Row, RowsExchanged, SignalsExchanged, put_right
from truing.simulation.bench.six_upur.nominal_sensor import NominalSensor
from truing.simulation.bench.six_upur.uncertain_sensor import UncertainSensor
from truing.stages.common.nominal_sensor import nominal_sensor

if TYPE_CHECKING:
    import pyarrow as pa

    from truing.schemas.campaign import Campaign
    from truing.schemas.sensor_mechanism import SensorMechanism

Array = NDArray[np.float64]

_NORMAL_MEDIAN = 0.6745


def simulated_sensor(tables: Mapping[str, pa.Table], settings: Campaign, steps: RecordedSteps) -> UncertainSensor:
    """The sensor with what is not known of it; raises ValueError where what was read of it cannot be simulated.

    Signals alone need no compliance, and where they are compared with loads no geometry either.
    """
    moved = bool(np.isfinite(steps.reading).any())
    if not moved and not np.isfinite(steps.signal).any():
        raise ValueError("needs readings or signals")
    if settings.mechanism.type != "6-upur":
        if moved:
            raise ValueError("needs a [mechanism] whose compliance can be simulated")
        return UncertainSensor(None, None, np.zeros((len(LOADS), len(LOADS))))
    sensor = nominal_sensor(cast("SensorMechanism", settings.mechanism), tables.get("given_compliance"))
    if sensor.compliance is None and moved:
        raise ValueError("needs the elements of a leg, or a compliance_file")
    return _uncertain(sensor)


def _uncertain(sensor: NominalSensor) -> UncertainSensor:
    """Of a given compliance the elements are none of its business; one that nobody gave moves nothing."""
    if sensor.compliance is None:
        return UncertainSensor(sensor.joints, None, np.zeros((len(LOADS), len(LOADS))), sensor.length_sigma)
    own = sensor.elastic is not None and sensor.compliance is sensor.elastic.compliance
    elastic, given = (sensor.elastic, None) if own else (None, sensor.compliance)
    return UncertainSensor(sensor.joints, elastic, given, sensor.length_sigma, sensor.stiffness_sigma)


def told_by_readings(
    exchanged: tuple[RowsExchanged, ...], steps: RecordedSteps, sensor: UncertainSensor
) -> tuple[RowsExchanged, ...]:
    """The exchanges, those of signals alone where readings at the two steps agree with the loads as written down."""
    plain = np.zeros(sensor.geometry_size), np.zeros(sensor.stiffness_size)
    compliance = sensor.at(*plain).compliance
    return tuple(
        one if _moved_so(one, steps, compliance) else SignalsExchanged(one.rows, one.components) for one in exchanged
    )


def _moved_so(one: RowsExchanged, steps: RecordedSteps, compliance: Array) -> bool:
    """Whether the platform moved under the exchanged loads; so it is taken to have where no channel tells."""
    names: list[Row] = [(steps.runs[run], int(step)) for run, step in zip(steps.run, steps.step, strict=True)]
    rows = [names.index(row) for row in one.rows]
    motion, other = (loads[rows] @ compliance.T for loads in (steps.load, put_right(steps, (one,)).load))
    size = np.maximum(np.abs(motion), np.abs(other)).max(0)
    misses = [(steps.reading[rows] - expected) / np.where(size > 0.0, size, 1.0) for expected in (motion, other)]
    return bool(np.nansum(misses[1] ** 2) <= np.nansum(misses[0] ** 2))


def scatter_of_signals(steps: RecordedSteps, rows: NDArray[np.bool_], exchanged: tuple[RowsExchanged, ...]) -> Array:
    """The scatter (S,), V, of signals about a linear response to the loads with a zero in each run, not counting rows
    whose loads were exchanged; NaN where there are too few rows for it."""
    wrong = {row for one in exchanged for row in one.rows}
    own = np.array([(steps.runs[run], int(step)) not in wrong for run, step in zip(steps.run, steps.step, strict=True)])
    rows = rows & own & np.isfinite(steps.signal).all(1)
    if not rows.any():
        return np.full(steps.signal.shape[1], np.nan)
    zero = steps.run[rows, None] == np.unique(steps.run[rows])
    columns = np.hstack([steps.load[rows], zero])
    values, _, rank, _ = np.linalg.lstsq(columns, steps.signal[rows], rcond=None)
    freedom = int(rows.sum()) - int(rank)
    if freedom <= 0:
        return np.full(steps.signal.shape[1], np.nan)
    left = np.abs(steps.signal[rows] - columns @ values)
    spread = np.median(left, 0) / _NORMAL_MEDIAN * np.sqrt(rows.sum() / freedom)
    return np.where(spread > 0.0, spread, np.nan)
