"""The compliance that the simulation gives a sensor, and how uncertain its tolerances leave it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from stages.common.nominal_sensor import NominalSensor, nominal_sensor
from truing.simulation.six_upur.compliance_change import (
    change_as_a_whole,
    common_to_legs,
    compliance_change,
    compliance_covariance,
)

if TYPE_CHECKING:
    import pyarrow as pa

    from schemas.campaign import Campaign
    from schemas.sensor_mechanism import SensorMechanism

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


def simulated_compliance(settings: Campaign, given: pa.Table | None) -> SimulatedCompliance | None:
    """The simulation of [mechanism]; None where it says nothing of how the sensor gives."""
    if settings.mechanism.type != "6-upur":
        return None
    section: SensorMechanism = settings.mechanism  # type: ignore[assignment]
    sensor = nominal_sensor(section, given if given is not None and given.num_rows else None)
    if sensor.compliance is None:
        return None
    return SimulatedCompliance(sensor.compliance, _covariance(sensor))


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
