"""What the drawing says of a sensor: G, G' with the synthetic error, and how uncertain tolerances leave them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from stages.common.nominal_sensor import NominalSensor, nominal_sensor
from stages.common.point_arrays import number_column
from stages.common.reading_arrays import LOAD_COLUMNS
from truing.estimation.sensor.calibration_matrix import MatrixEstimate
from truing.simulation.six_upur.assembly import closed_loop_map
from truing.simulation.six_upur.compliance_change import influence_change, motion_of_sources
from truing.simulation.six_upur.influence import characteristic_length, influence_matrix
from truing.simulation.six_upur.synthetic_error import influence_with_error
from truing.simulation.six_upur.tolerances import first_order_covariances

if TYPE_CHECKING:
    import pyarrow as pa

    from schemas.campaign import Campaign
    from schemas.sensor_mechanism import SensorMechanism

Array = NDArray[np.float64]

_MOVED = (*((f"d{axis}_mm", 1e-3) for axis in "xyz"), *((f"r{axis}_rad", 1.0) for axis in "xyz"))


@dataclass(frozen=True)
class Theory:
    """G and G' (6, 6), moments about the platform's origin, with covariance by the tolerances of length.

    with_joints: what cells see where joints resist and carry a part of the load past them; None without elements.
    synthetic (6,): the error that G' is at, m and rad: assembly, one sigma, and the largest displacement under load.
    length_m: at which moments weigh as much as forces.
    """

    nominal: MatrixEstimate
    with_error: MatrixEstimate
    with_joints: Array | None
    synthetic: Array
    length_m: float


def theory(settings: Campaign, tables: Mapping[str, pa.Table]) -> Theory | None:
    """The theory of [mechanism]; None where it is no such sensor."""
    if settings.mechanism.type != "6-upur":
        return None
    section: SensorMechanism = settings.mechanism  # type: ignore[assignment]
    given = tables.get("given_compliance")
    sensor = nominal_sensor(section, given if given is not None and given.num_rows else None)
    joints = sensor.joints
    G = influence_matrix(joints)
    change = influence_change(joints, motion_of_sources(joints)).reshape(-1, G.size)
    covariance = (change.T * np.tile(sensor.length_sigma, 6) ** 2) @ change
    assembly = first_order_covariances(closed_loop_map(joints), sensor.length_sigma).sum(0)
    synthetic = np.sqrt(np.diag(assembly)) + _largest(sensor, tables)
    with_error = MatrixEstimate(influence_with_error(joints, synthetic), covariance)
    with_joints = None if sensor.elastic is None else np.linalg.inv(sensor.elastic.axial_forces)
    return Theory(MatrixEstimate(G, covariance), with_error, with_joints, synthetic, float(characteristic_length(G)))


def _largest(sensor: NominalSensor, tables: Mapping[str, pa.Table]) -> Array:
    """The largest displacement (6,) of any load case: measured, else simulated, else none."""
    found = np.zeros(6)
    cases = tables.get("displacement")
    load = None
    if cases is not None and cases.num_rows:
        load = _loads(cases)
        moved = np.column_stack([number_column(cases, name) * unit for name, unit in _MOVED])
        found = np.where(np.isfinite(moved).any(0), _farthest(np.nan_to_num(moved)), np.nan)
    elif "signals" in tables:
        load = _loads(tables["signals"])
    if load is not None and sensor.compliance is not None:
        found = np.where(np.isfinite(found) & (found != 0.0), found, _farthest(load @ sensor.compliance.T))
    return np.nan_to_num(found)


def _loads(table: pa.Table) -> Array:
    return np.nan_to_num(np.column_stack([number_column(table, name) for name in LOAD_COLUMNS]))


def _farthest(values: Array) -> Array:
    """Of every column of (N, K) the value farthest from zero, with its sign."""
    return values[np.abs(values).argmax(axis=0), np.arange(values.shape[1])]
