"""What the drawing says of a sensor: G, G' with the synthetic error, and how uncertain tolerances leave them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truing.estimation.sensor.calibration_matrix import MatrixEstimate
from truing.simulation.bench.six_upur.assembly import closed_loop_map
from truing.simulation.bench.six_upur.compliance_change import influence_change, motion_of_sources
from truing.simulation.bench.six_upur.influence import characteristic_length, influence_matrix, influence_with_error
from truing.simulation.bench.six_upur.nominal_sensor import NominalSensor
from truing.simulation.bench.six_upur.tolerances import first_order_covariances

Array = NDArray[np.float64]


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


def farthest(values: Array) -> Array:
    """Of every column of (N, K) the value farthest from zero, with its sign."""
    return values[np.abs(values).argmax(axis=0), np.arange(values.shape[1])]


def theory_of(sensor: NominalSensor, largest: Array) -> Theory:
    """Return what the drawing says; largest (6,): the largest displacement of any load case, m and rad."""
    joints = sensor.joints
    G = influence_matrix(joints)
    change = influence_change(joints, motion_of_sources(joints)).reshape(-1, G.size)
    covariance = (change.T * np.tile(sensor.length_sigma, 6) ** 2) @ change
    assembly = first_order_covariances(closed_loop_map(joints), sensor.length_sigma).sum(0)
    synthetic = np.sqrt(np.diag(assembly)) + largest
    with_error = MatrixEstimate(influence_with_error(joints, synthetic), covariance)
    with_joints = None if sensor.elastic is None else np.linalg.inv(sensor.elastic.axial_forces)
    return Theory(MatrixEstimate(G, covariance), with_error, with_joints, synthetic, float(characteristic_length(G)))
