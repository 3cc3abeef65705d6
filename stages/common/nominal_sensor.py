"""The sensor of campaign.toml: joints, elements or a given compliance, and tolerances."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pyarrow as pa

from truing.simulation.bench.six_upur import elements
from truing.simulation.bench.six_upur.assembly import SOURCES
from truing.simulation.bench.six_upur.nominal_sensor import NominalSensor, SimulatedCompliance, simulated
from truing.simulation.bench.six_upur.tolerances import sigma_of
from truing.stages.common.sensor_elements import elastic_parts, given_matrix, sensor_joints

if TYPE_CHECKING:
    from truing.schemas.campaign import Campaign
    from truing.schemas.mechanism import SensorMechanism


def nominal_sensor(section: SensorMechanism, compliance_table: pa.Table | None = None) -> NominalSensor:
    """Sensor of [mechanism], with the compliance of compliance_file if given.

    Raises ValueError for elements that do not fit the legs or are all rigid, and for an impossible compliance.
    """
    joints = sensor_joints(section)
    elastic = elastic_parts(section)
    compliance = elastic.compliance if elastic is not None else None
    if compliance_table is not None:
        compliance = elements.passive(given_matrix(compliance_table), "compliance_file")
    tolerance = section.tolerance
    widths = [getattr(tolerance, f"{source}_um") or 0.0 for source in SOURCES]
    return NominalSensor(joints, elastic, compliance, sigma_of(widths) * 1e-6, tolerance.stiffness)


def simulated_compliance(settings: Campaign, compliance_table: pa.Table | None) -> SimulatedCompliance | None:
    """Simulation of [mechanism]; None without elasticity."""
    if settings.mechanism.type != "6-upur":
        return None
    section: SensorMechanism = settings.mechanism  # type: ignore[assignment]
    return simulated(
        nominal_sensor(
            section, compliance_table if compliance_table is not None and compliance_table.num_rows else None
        )
    )
