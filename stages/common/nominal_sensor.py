"""The sensor that campaign.toml describes: joints, elements or a given compliance, and how well they are known."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from truing.estimation.interferometry.recorded_steps import CHANNELS, LOADS
from truing.simulation.bench.six_upur import elements
from truing.simulation.bench.six_upur.assembly import SOURCES
from truing.simulation.bench.six_upur.geometry import JointCentres, joint_centres
from truing.simulation.bench.six_upur.nominal_sensor import NominalSensor, SimulatedCompliance, simulated
from truing.simulation.bench.six_upur.stiffness import ElasticSensor, elastic_sensor
from truing.simulation.bench.six_upur.tolerances import sigma_of
from truing.stages.common.point_arrays import number_column

if TYPE_CHECKING:
    from truing.schemas.campaign import Campaign
    from truing.schemas.sensor_mechanism import Element, SensorMechanism

Array = NDArray[np.float64]
_MM = 1e-3


def nominal_sensor(section: SensorMechanism, given: pa.Table | None = None) -> NominalSensor:
    """The sensor of [mechanism], with the compliance of compliance_file where there is one.

    Raises ValueError where elements do not fit the legs, or leave them rigid, or a compliance cannot be one.
    """
    joints = sensor_joints(section)
    elastic = elastic_parts(section)
    compliance = elastic.compliance if elastic is not None else None
    if given is not None:
        compliance = elements.passive(given_matrix(given), "compliance_file")
    tolerance = section.tolerance
    widths = [getattr(tolerance, f"{source}_um") or 0.0 for source in SOURCES]
    return NominalSensor(joints, elastic, compliance, sigma_of(widths) * 1e-6, tolerance.stiffness)


def elastic_parts(section: SensorMechanism) -> ElasticSensor | None:
    """The sensor's stiffness by its elements, None where none are given; raises ValueError where they do not fit."""
    return elastic_sensor(sensor_joints(section), [_element(e) for e in section.elements]) if section.elements else None


def sensor_joints(section: SensorMechanism) -> JointCentres:
    """The joint centres of [mechanism], unloaded, m."""
    lower, upper = (np.array([getattr(leg, name) for leg in section.legs]) * _MM for name in ("B_mm", "b_mm"))
    return joint_centres(lower, upper, section.height_mm * _MM)


def given_matrix(table: pa.Table) -> Array:
    """The (6, 6) matrix of a long table: response, load, coefficient."""
    found = np.full((6, 6), np.nan)
    rows = [CHANNELS.index(name) for name in table.column("response").to_pylist()]
    columns = [LOADS.index(name) for name in table.column("load").to_pylist()]
    found[rows, columns] = number_column(table, "coefficient")
    return found


def _element(one: Element) -> elements.Element:
    length = None if one.length_mm is None else one.length_mm * _MM
    if one.kind == "cylinder":
        return elements.cylinder(length or 0.0, _si(one.diameter_mm, _MM), *_modulus(one))
    if one.kind == "leaf":
        width, thickness = _si(one.width_mm, _MM), _si(one.thickness_mm, _MM)
        return elements.leaf(length or 0.0, width, thickness, *_modulus(one), one.soft or "s1")
    if one.kind == "notch":
        width, web, radius = (_si(value, _MM) for value in (one.width_mm, one.web_mm, one.radius_mm))
        return elements.notch(width, web, radius, *_modulus(one), one.soft or "s1")
    if one.kind == "spring":
        return elements.spring(one.axial_n_per_m, one.torsion_n_m_per_rad, length or 0.0)
    if one.kind == "compliance":
        return elements.compliance(np.array(one.matrix), length or 0.0)
    return elements.rigid(length)


def _modulus(one: Element) -> tuple[float, float]:
    return _si(one.youngs_gpa, 1e9), float(one.poisson or 0.0)


def _si(value: float | None, unit: float) -> float:
    """A number that the schema has checked to be there, in SI."""
    assert value is not None
    return value * unit


def simulated_compliance(settings: Campaign, given: pa.Table | None) -> SimulatedCompliance | None:
    """The simulation of [mechanism]; None where it says nothing of how the sensor gives."""
    if settings.mechanism.type != "6-upur":
        return None
    section: SensorMechanism = settings.mechanism  # type: ignore[assignment]
    return simulated(nominal_sensor(section, given if given is not None and given.num_rows else None))
