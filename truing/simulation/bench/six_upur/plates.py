"""Effects that a model of six elastic legs leaves out: elastic plates at their ends, and the sensor's own weight.

A plate is estimated as six radial beams: it is cut between neighbouring joints, and each sector is clamped at a rigid
middle. Sectors do not support each other, which makes the estimate softer than a whole plate for a joint in the middle
of its sector.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truing.estimation.rotation import exp_so3
from truing.schemas.faults import Unfit
from truing.simulation.bench.six_upur.elements import (
    Flexibility,
    LegElement,
    LegParts,
    cantilever,
    moved_along,
    rectangle_torsion,
)
from truing.simulation.bench.six_upur.geometry import JointCentres, leg_axes, outward
from truing.simulation.bench.six_upur.stiffness import ElasticSensor, elastic_sensor, end_transport

Array = NDArray[np.float64]
_UP = np.array([0.0, 0.0, 1.0])
_GRAVITY = 9.80665  # m/s^2, standard
_NODES = 64
_NARROWEST = 1e-3  # rad: joints closer together than that have no sector of their own


@dataclass(frozen=True)
class Plate:
    """A plate of constant thickness, m, with a rigid middle of a radius, m; moduli in Pa."""

    thickness: float
    rigid_radius: float
    youngs_pa: float
    poisson: float


def sector_angles(joints: Array) -> Array:
    """Return the angle (6,), rad, of each joint's sector about the z axis: half of the gaps to its neighbours.

    joints: (6, 3). Raises Unfit for two joints in the same direction.
    """
    angle = np.arctan2(joints[:, 1], joints[:, 0])
    order = np.argsort(angle)
    gaps = np.diff(angle[order], append=angle[order[0]] + 2.0 * np.pi)
    if gaps.min() < _NARROWEST:
        raise Unfit("plate", "two joints in the same direction from the middle", "a sector for each joint")
    angles = np.empty(len(angle))
    angles[order] = 0.5 * (gaps + np.roll(gaps, 1))
    return angles


def sector_compliances(plate: Plate, joints: Array) -> Array:
    """Return the compliance (6, 6, 6) of each sector at its joint (6, 3), m from the plate's middle, in fixed axes.

    Raises Unfit if a joint is within the rigid middle.
    """
    radius = np.linalg.norm(joints[:, :2], axis=1)
    if radius.min() <= plate.rigid_radius:
        found = f"a rigid middle of {plate.rigid_radius:g} m"
        raise Unfit("plate", found, f"one smaller than the joints' radius, {radius.min():g} m")
    parts = [cantilever(_sector(plate, r, a)) for r, a in zip(radius, sector_angles(joints), strict=True)]
    along = outward(joints)
    axes = np.stack([np.cross(_UP, along), np.broadcast_to(_UP, along.shape), along], -1)
    return _turned(np.stack(parts), axes)


def _sector(plate: Plate, radius: float, angle: float) -> Flexibility:
    """Return the flexibility of a sector from the rigid middle to a radius; y of the beam is the plate's normal."""
    x, weight = np.polynomial.legendre.leggauss(_NODES)
    half = 0.5 * (radius - plate.rigid_radius)
    at, step = plate.rigid_radius + half * (1.0 + x), half * weight
    width, thickness, beyond = angle * at, plate.thickness, radius - at
    shear_pa = plate.youngs_pa / (2.0 * (1.0 + plate.poisson))
    torsion = np.sum(step / rectangle_torsion(width, np.full_like(width, thickness))) / shear_pa
    axial = np.sum(step / width) / (plate.youngs_pa * thickness)
    out_of_plane, in_plane = 12.0 / (width * thickness**3), 12.0 / (thickness * width**3)

    def integrals(curvature: Array) -> tuple[float, float, float]:
        integrand = step * curvature / plate.youngs_pa
        return float(integrand.sum()), float((integrand * beyond).sum()), float((integrand * beyond**2).sum())

    return Flexibility(float(axial), float(torsion), integrals(out_of_plane), integrals(in_plane))


def at_platform(plate: Plate, joints: JointCentres) -> Array:
    """Return the sectors' compliances (6, 6, 6) of a platform at the outer ends of the legs, in their axes."""
    return _turned(sector_compliances(plate, joints.arm), np.swapaxes(leg_axes(joints.direction), -1, -2))


def at_base(plate: Plate, joints: JointCentres) -> Array:
    """Return the sectors' compliances (6, 6, 6) of a base at the outer ends of the legs, in their axes."""
    compliance = _turned(sector_compliances(plate, joints.lower), np.swapaxes(leg_axes(joints.direction), -1, -2))
    return moved_along(compliance, joints.length)


def with_plate(sensor: ElasticSensor, added: Array) -> Array:
    """Return the compliance (6, 6) of a sensor with more compliance (6, 6, 6) at the outer ends of its legs."""
    transport = end_transport(sensor.joints.arm, leg_axes(sensor.joints.direction))
    stiffness = np.linalg.inv(sensor.parts.compliance.sum(-3) + added)
    return np.asarray(np.linalg.inv((transport @ stiffness @ np.swapaxes(transport, -1, -2)).sum(0)))


def sensor_with_part(sensor: ElasticSensor, name: str, added: Array) -> ElasticSensor:
    """Return a sensor whose legs have one more flexible part (6, 6, 6) at their outer ends."""
    parts, none = sensor.parts, np.zeros_like(added)[:, None]
    every = LegParts(
        (*parts.names, name),
        np.concatenate([parts.compliance, added[:, None]], 1),
        np.concatenate([parts.by_installed, none], 1),
        np.concatenate([parts.by_middle, none], 1),
    )
    transport = sensor.leg_transport
    stiffness = transport @ np.linalg.inv(every.compliance.sum(-3)) @ np.swapaxes(transport, -1, -2)
    return ElasticSensor(sensor.joints, every, transport, stiffness, np.linalg.inv(stiffness.sum(0)))


@dataclass(frozen=True)
class OwnWeight:
    """State of a sensor under its own weight.

    wrench (6,) at the platform's origin, N and N m; displacement (6,), m and rad; tension (6,) of the legs, N;
    compliance (6, 6) at the displaced platform.
    """

    wrench: Array
    displacement: Array
    tension: Array
    compliance: Array


def own_weight(
    sensor: ElasticSensor, elements: list[LegElement], mass_kg: float, centre: Array, up: Array
) -> OwnWeight:
    """Return the state under a mass with its centre (3,), m from the platform's origin; up (3,) is a unit vector.

    The compliance is that of the geometry that the weight displaces. Readings are counted from it, so that weight
    changes them only in this way.
    """
    force = -_GRAVITY * mass_kg * up
    wrench = np.concatenate([force, np.cross(centre, force)])
    displacement = sensor.displacement(wrench)
    moved = sensor.joints.displaced(displacement[:3], exp_so3(displacement[3:]))
    return OwnWeight(wrench, displacement, sensor.axial_forces @ wrench, elastic_sensor(moved, elements).compliance)


def _turned(compliance: Array, axes: Array) -> Array:
    """Return compliances (..., 6, 6) of axes (..., 3, 3), columns, in the axes that these refer to."""
    Q = np.zeros((*axes.shape[:-2], 6, 6))
    Q[..., :3, :3] = Q[..., 3:, 3:] = axes
    return np.asarray(Q @ compliance @ np.swapaxes(Q, -1, -2))
