"""Plates at the ends of the legs, and own weight, against independent integrals and limits."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import quad

from tests.simulation.bench.six_upur.sensors import sensor_of
from tests.tolerance import assert_close
from truing.schemas.faults import Unfit
from truing.simulation.bench.six_upur import elements
from truing.simulation.bench.six_upur.geometry import joint_centres, leg_axes
from truing.simulation.bench.six_upur.plates import (
    Plate,
    at_base,
    at_platform,
    own_weight,
    sector_angles,
    sector_compliances,
    sensor_with_part,
    with_plate,
)
from truing.simulation.bench.six_upur.stiffness import elastic_sensor

PLATE = Plate(0.06, 0.2, 70e9, 0.3)
RING = 0.55 * np.stack([np.cos(a := np.arange(6) * np.pi / 3), np.sin(a), 0 * a], -1)


def test_sectors_fill_the_circle_and_follow_the_gaps():
    assert_close(sector_angles(RING), np.full(6, np.pi / 3), atol=1e-12)
    pairs = np.deg2rad([350.0, 10.0, 110.0, 130.0, 230.0, 250.0])
    found = sector_angles(np.stack([np.cos(pairs), np.sin(pairs), 0 * pairs], -1))
    assert_close(found, np.full(6, np.pi / 3), atol=1e-12)
    uneven = np.deg2rad([0.0, 20.0, 120.0, 140.0, 240.0, 300.0])
    found = np.rad2deg(sector_angles(np.stack([np.cos(uneven), np.sin(uneven), 0 * uneven], -1)))
    assert_close(found, [40.0, 60.0, 60.0, 60.0, 80.0, 60.0], atol=1e-9)
    assert_close(found.sum(), 360.0, atol=1e-9)


def test_a_sector_gives_what_castigliano_integrates():
    """Deflection along the normal, tangent and radius by the energy of a tapered cantilever."""
    C = sector_compliances(PLATE, RING)
    assert_close(C, np.swapaxes(C, -1, -2), atol=1e-20)
    E, t, angle = PLATE.youngs_pa, PLATE.thickness, np.pi / 3
    normal = quad(lambda r: (0.55 - r) ** 2 * 12.0 / (E * angle * r * t**3), 0.2, 0.55)[0]
    tangent = quad(lambda r: (0.55 - r) ** 2 * 12.0 / (E * t * (angle * r) ** 3), 0.2, 0.55)[0]
    radial = quad(lambda r: 1.0 / (E * t * angle * r), 0.2, 0.55)[0]
    for k, joint in enumerate(RING):
        out = joint / 0.55
        for way, given in (([0, 0, 1.0], normal), (np.cross([0, 0, 1.0], out), tangent), (out, radial)):
            assert_close(np.array(way) @ C[k, :3, :3] @ way, given, atol=1e-6 * given)
        tilt = np.cross([0, 0, 1.0], out)  # a force upwards turns the end about the negative tangent
        assert tilt @ C[k, 3:, :3] @ [0, 0, 1.0] < 0.0


def test_a_plate_softens_every_direction_and_a_stiff_one_none():
    sensor = sensor_of("A")
    for added in (at_platform(PLATE, sensor.joints), at_base(PLATE, sensor.joints)):
        softer = np.linalg.eigvalsh(with_plate(sensor, added) - sensor.compliance)
        assert softer.min() > -1e-12 * np.abs(sensor.compliance).max()
        assert softer.max() > 0.0
    stiff = Plate(0.06, 0.2, 70e15, 0.3)
    rigid = with_plate(sensor, at_platform(stiff, sensor.joints))
    assert_close(rigid, sensor.compliance, atol=1e-5 * np.abs(sensor.compliance).max())


def test_a_base_lets_the_whole_leg_move():
    """A vertical leg on a soft base: the tilt of its lower joint moves the upper end by the leg's length."""
    lower, upper = RING, RING
    joints = joint_centres(lower, upper, 0.3)
    tilt = sector_compliances(PLATE, lower)[0, 4, 4]  # joint on x: bending turns it about y
    C = at_base(PLATE, joints)[0]
    axes = leg_axes(joints.direction)[0]
    aside = axes.T @ [1.0, 0.0, 0.0]
    own = sector_compliances(PLATE, lower)[0, 0, 0]
    assert_close(aside @ C[:3, :3] @ aside, own + tilt * 0.3**2, atol=1e-9 * tilt)


def test_a_sensor_with_the_part_has_the_same_compliance():
    sensor = sensor_of("A")
    added = at_platform(PLATE, sensor.joints)
    more = sensor_with_part(sensor, "platform youngs", added)
    assert_close(more.compliance, with_plate(sensor, added), atol=1e-9 * np.abs(sensor.compliance).max())
    assert more.parts.names == (*sensor.parts.names, "platform youngs")
    assert_close(more.leg_wrenches.sum(0), np.eye(6), atol=1e-9)


def test_bad_plates_are_refused():
    with pytest.raises(Unfit, match="rigid middle"):
        sector_compliances(Plate(0.06, 0.55, 70e9, 0.3), RING)
    with pytest.raises(Unfit, match="same direction"):
        sector_angles(np.repeat(RING[:3], 2, 0))


def test_the_weight_is_carried_by_the_legs_and_displaces_the_platform():
    parts = [elements.cylinder(0.4, 0.03, 206e9, 0.3)]
    angle = np.deg2rad([20.0, 40.0, 140.0, 160.0, 260.0, 280.0])
    lower = 0.5 * np.stack([np.cos(angle), np.sin(angle), 0 * angle], -1)
    sensor = elastic_sensor(joint_centres(lower, lower, 0.4), parts)
    found = own_weight(sensor, parts, 100.0, np.zeros(3), np.array([0.0, 0.0, 1.0]))
    assert_close(found.wrench, [0, 0, -980.665, 0, 0, 0], atol=1e-9)
    assert_close(found.tension, np.full(6, -980.665 / 6.0), atol=1e-6)
    EA = 206e9 * np.pi * 0.015**2
    assert_close(found.displacement[2], -980.665 * 0.4 / (6.0 * EA), atol=1e-15)
    offset = own_weight(sensor, parts, 100.0, np.array([0.1, 0.0, 0.0]), np.array([0.0, 0.0, 1.0]))
    assert_close(offset.wrench[4], 98.0665, atol=1e-9)


def test_the_weight_changes_the_compliance_of_leaning_legs_in_proportion():
    """Displaced geometry: twice the mass gives twice the change, and no mass none."""
    parts = [elements.cylinder(0.4, 0.03, 206e9, 0.3), elements.rigid()]
    twisted = RING @ np.array([[0.9, -0.3, 0.0], [0.3, 0.9, 0.0], [0.0, 0.0, 1.0]])
    sensor = elastic_sensor(joint_centres(RING, twisted, 0.4), parts)
    up = np.array([0.0, 0.0, 1.0])
    change = [own_weight(sensor, parts, m, np.zeros(3), up).compliance - sensor.compliance for m in (0.0, 1e2, 2e2)]
    size = np.abs(sensor.compliance).max()
    assert_close(change[0], np.zeros((6, 6)), atol=1e-12 * size)
    assert np.abs(change[1]).max() > 1e-7 * size
    assert_close(change[2], 2.0 * change[1], atol=1e-3 * np.abs(change[1]).max())
