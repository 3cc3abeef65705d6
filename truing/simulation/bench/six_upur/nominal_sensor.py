"""A sensor as it was designed, the compliance that this gives it, and how uncertain its tolerances leave that."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truing.simulation.bench.six_upur.compliance_change import (
    change_as_a_whole,
    common_to_legs,
    compliance_change,
    compliance_covariance,
)
from truing.simulation.bench.six_upur.geometry import JointCentres
from truing.simulation.bench.six_upur.stiffness import ElasticSensor

Array = NDArray[np.float64]


@dataclass(frozen=True)
class SimulatedCompliance:
    """entries (6, 6), SI, and their covariance (36, 36) row by row."""

    entries: Array
    covariance: Array

    @property
    def sigma(self) -> Array:
        """One standard deviation (6, 6) of every entry."""
        return np.sqrt(np.diag(self.covariance)).reshape(6, 6)


@dataclass(frozen=True)
class NominalSensor:
    """A sensor as it was designed, and one standard deviation of what may differ from that.

    ``elastic`` is None where only a compliance is given; ``compliance`` (6, 6), SI, is None where neither is.
    ``length_sigma`` (5,), m: platform and base radius, the clearances, the sensor's installation; ``stiffness_sigma``
    relative.
    """

    joints: JointCentres
    elastic: ElasticSensor | None
    compliance: Array | None
    length_sigma: Array
    stiffness_sigma: float


def simulated(sensor: NominalSensor) -> SimulatedCompliance | None:
    """Return the compliance of a sensor as designed, with what its tolerances leave open; None where none is known."""
    return None if sensor.compliance is None else SimulatedCompliance(sensor.compliance, _covariance(sensor))


def _covariance(sensor: NominalSensor) -> Array:
    """By the legs' length errors, and by elastic parameters that are off in all legs together and in each alone.

    Both in full: how legs share their tolerance is told by the diagnosis alone, and this holds whatever the share.
    """
    stiffness = sensor.stiffness_sigma
    if sensor.elastic is None:
        assert sensor.compliance is not None
        return compliance_covariance(change_as_a_whole(sensor.compliance), np.array([stiffness]))
    change = compliance_change(sensor.elastic)
    by_leg = change.by_stiffness
    return (
        compliance_covariance(change.by_source, np.broadcast_to(sensor.length_sigma, change.by_source.shape[:2]))
        + compliance_covariance(by_leg, np.full(by_leg.shape[:2], stiffness))
        + compliance_covariance(common_to_legs(by_leg), np.full(by_leg.shape[1], stiffness))
    )
