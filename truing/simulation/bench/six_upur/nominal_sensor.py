"""A sensor as designed: its compliance, G and G', and their uncertainty by tolerances."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truing.estimation.sensor.calibration import MatrixEstimate
from truing.simulation.bench.six_upur.assembly import closed_loop_map, influence_change, motion_of_sources
from truing.simulation.bench.six_upur.geometry import JointCentres
from truing.simulation.bench.six_upur.influence import characteristic_length, influence_matrix, influence_with_error
from truing.simulation.bench.six_upur.stiffness import ElasticSensor
from truing.simulation.bench.six_upur.tolerances import first_order_covariances
from truing.simulation.bench.six_upur.uncertain_sensor import compliance_change, compliance_covariance

Array = NDArray[np.float64]


@dataclass(frozen=True)
class SimulatedCompliance:
    """entries (6, 6), SI, and their covariance (36, 36) row by row."""

    entries: Array
    covariance: Array

    @property
    def sigma(self) -> Array:
        """Standard deviation (6, 6) of every entry."""
        return np.sqrt(np.diag(self.covariance)).reshape(6, 6)


@dataclass(frozen=True)
class NominalSensor:
    """A sensor as designed, with the standard deviations of its dimensions and stiffnesses.

    ``elastic`` is None if only a compliance is given; ``compliance`` (6, 6), SI, is None if neither is.
    ``length_sigma`` (5,), m: platform and base radius, the clearances, the sensor's installation; ``stiffness_sigma``
    is relative.
    """

    joints: JointCentres
    elastic: ElasticSensor | None
    compliance: Array | None
    length_sigma: Array
    stiffness_sigma: float


def simulated(sensor: NominalSensor) -> SimulatedCompliance | None:
    """Return the compliance of a sensor as designed, with its covariance by tolerances; None if it is unknown."""
    return None if sensor.compliance is None else SimulatedCompliance(sensor.compliance, _covariance(sensor))


def _covariance(sensor: NominalSensor) -> Array:
    """Return the covariance by length errors, and by elastic parameters with errors common to all legs and of each leg.

    Both errors count in full: only the diagnosis estimates their shares, and the result is an upper bound for any
    share.
    """
    stiffness = sensor.stiffness_sigma
    if sensor.elastic is None:
        assert sensor.compliance is not None
        return compliance_covariance(-sensor.compliance[None], np.array([stiffness]))
    change = compliance_change(sensor.elastic)
    by_leg = change.by_stiffness
    return (
        compliance_covariance(change.by_source, np.broadcast_to(sensor.length_sigma, change.by_source.shape[:2]))
        + compliance_covariance(by_leg, np.full(by_leg.shape[:2], stiffness))
        + compliance_covariance(by_leg.sum(0), np.full(by_leg.shape[1], stiffness))
    )


@dataclass(frozen=True)
class Theory:
    """G and G' (6, 6), moments about the platform's origin, with covariance by the tolerances of length.

    with_joints: G for cells whose elastic joints carry a part of the load; None without elements. synthetic (6,): the
    error for G', m and rad: one sigma of assembly plus the largest displacement under load. length_m: length at which
    moments weigh as much as forces.
    """

    nominal: MatrixEstimate
    with_error: MatrixEstimate
    with_joints: Array | None
    synthetic: Array
    length_m: float


def farthest(values: Array) -> Array:
    """Return the value farthest from zero in every column of (N, K), with its sign."""
    return values[np.abs(values).argmax(axis=0), np.arange(values.shape[1])]


def theory_of(sensor: NominalSensor, largest: Array) -> Theory:
    """Return the theory of the sensor as designed; largest (6,): the largest displacement of any load case, m and
    rad."""
    joints = sensor.joints
    G = influence_matrix(joints)
    change = influence_change(joints, motion_of_sources(joints)).reshape(-1, G.size)
    covariance = (change.T * np.tile(sensor.length_sigma, 6) ** 2) @ change
    assembly = first_order_covariances(closed_loop_map(joints), sensor.length_sigma).sum(0)
    synthetic = np.sqrt(np.diag(assembly)) + largest
    with_error = MatrixEstimate(influence_with_error(joints, synthetic), covariance)
    with_joints = None if sensor.elastic is None else np.linalg.inv(sensor.elastic.axial_forces)
    return Theory(MatrixEstimate(G, covariance), with_error, with_joints, synthetic, float(characteristic_length(G)))
