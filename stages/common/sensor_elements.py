"""Elements, joints and compliance of the sensor in campaign.toml, without tolerances."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa

from truing.arrays import Array
from truing.estimation.interferometry.recorded_steps import CHANNELS, LOADS
from truing.simulation.bench.six_upur import elements
from truing.simulation.bench.six_upur.geometry import JointCentres, joint_centres
from truing.simulation.bench.six_upur.plates import Plate, at_base, at_platform, sensor_with_part
from truing.simulation.bench.six_upur.stiffness import ElasticSensor, elastic_sensor
from truing.stages.common.point_arrays import number_column

if TYPE_CHECKING:
    from truing.schemas.campaign import Campaign
    from truing.schemas.mechanism import SensorElement, SensorMechanism, SensorPlate

_MM, _GPA = 1e-3, 1e9


def elastic_parts(section: SensorMechanism, joints: JointCentres | None = None) -> ElasticSensor | None:
    """Stiffness of the sensor by its elements and elastic plates, None without elements.

    ``joints``: other joint centres than the declared ones.
    Raises ValueError if they do not fit the legs.
    """
    if not section.elements:
        return None
    sensor = elastic_sensor(joints or sensor_joints(section), leg_elements(section))
    for name, plate, added in (("platform", section.platform, at_platform), ("base", section.base, at_base)):
        if plate is not None and plate.elastic:
            sensor = sensor_with_part(sensor, f"{name} youngs", added(plate_of(plate), sensor.joints))
    return sensor


def leg_elements(section: SensorMechanism) -> list[elements.LegElement]:
    """Elements of one leg, from the base to the platform."""
    return [_element(element) for element in section.elements]


def plate_of(section: SensorPlate) -> Plate:
    """A declared plate, m and Pa."""
    return Plate(section.thickness_mm * _MM, section.rigid_radius_mm * _MM, section.youngs_gpa * _GPA, section.poisson)


def plate_mass_kg(section: SensorPlate, joints_mm: float) -> float:
    """Mass of a plate: as declared, else of a full disc; 0 without density. joints_mm: radius where none is given."""
    if section.mass_kg is not None:
        return section.mass_kg
    radius = (section.outer_radius_mm or joints_mm) * _MM
    return math.pi * radius**2 * section.thickness_mm * _MM * (section.density_kg_m3 or 0.0)


def leg_mass_kg(section: SensorMechanism) -> float:
    """Mass of one leg: its elements whose mass or density is declared."""
    return sum(element.mass_kg or _volume(element) * (element.density_kg_m3 or 0.0) for element in section.elements)


def _volume(sensor_element: SensorElement) -> float:
    """Volume of a cylinder, leaf or notch, m^3; 0 for other kinds."""
    length, width = (sensor_element.length_mm or 0.0) * _MM, (sensor_element.width_mm or 0.0) * _MM
    if sensor_element.kind == "cylinder":
        return 0.25 * math.pi * ((sensor_element.diameter_mm or 0.0) * _MM) ** 2 * length
    if sensor_element.kind == "leaf":
        return length * width * (sensor_element.thickness_mm or 0.0) * _MM
    if sensor_element.kind == "notch":
        radius, web = (sensor_element.radius_mm or 0.0) * _MM, (sensor_element.web_mm or 0.0) * _MM
        return width * (2.0 * radius * (web + 2.0 * radius) - math.pi * radius**2)
    return 0.0


def sensor_joints(section: SensorMechanism) -> JointCentres:
    """The joint centres of [mechanism], unloaded, m."""
    lower, upper = (np.array([getattr(leg, name) for leg in section.legs]) * _MM for name in ("B_mm", "b_mm"))
    return joint_centres(lower, upper, section.height_mm * _MM)


def given_matrix(table: pa.Table) -> Array:
    """The (6, 6) matrix of a long table: response, load, coefficient."""
    matrix = np.full((6, 6), np.nan)
    rows = [CHANNELS.index(name) for name in table.column("response").to_pylist()]
    columns = [LOADS.index(name) for name in table.column("load").to_pylist()]
    matrix[rows, columns] = number_column(table, "coefficient")
    return matrix


def declared_compliance(tables: Mapping[str, pa.Table], settings: Campaign) -> Array | None:
    """Compliance (6, 6), SI, of compliance_file, else of the elements; None if neither is given."""
    if settings.mechanism.type != "6-upur":
        return None
    if "given_compliance" in tables:
        return given_matrix(tables["given_compliance"])
    elastic = elastic_parts(settings.mechanism)  # type: ignore[arg-type]
    return None if elastic is None else elastic.compliance


def _element(sensor_element: SensorElement) -> elements.LegElement:
    length = None if sensor_element.length_mm is None else sensor_element.length_mm * _MM
    if sensor_element.kind == "cylinder":
        return elements.cylinder(length or 0.0, _si(sensor_element.diameter_mm, _MM), *_modulus(sensor_element))
    if sensor_element.kind == "leaf":
        width, thickness = _si(sensor_element.width_mm, _MM), _si(sensor_element.thickness_mm, _MM)
        return elements.leaf(length or 0.0, width, thickness, *_modulus(sensor_element), sensor_element.soft or "s1")
    if sensor_element.kind == "notch":
        width, web, radius = (
            _si(value, _MM) for value in (sensor_element.width_mm, sensor_element.web_mm, sensor_element.radius_mm)
        )
        return elements.notch(width, web, radius, *_modulus(sensor_element), sensor_element.soft or "s1")
    if sensor_element.kind == "spring":
        return elements.spring(sensor_element.axial_n_per_m, sensor_element.torsion_n_m_per_rad, length or 0.0)
    if sensor_element.kind == "compliance":
        return elements.compliance(np.array(sensor_element.matrix), length or 0.0)
    return elements.rigid(length)


def _modulus(sensor_element: SensorElement) -> tuple[float, float]:
    return _si(sensor_element.youngs_gpa, 1e9), float(sensor_element.poisson or 0.0)


def _si(value: float | None, unit: float) -> float:
    """A number that the schema has validated, in SI."""
    assert value is not None
    return value * unit
