"""A sensor within its tolerances answers as the sensors that it stands for."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.simulation.bench.six_upur.sensors import TOLERANCES_UM, joints_of, sensor_of
from tests.tolerance import assert_close
from truing.simulation.bench.six_upur.assembly import influence_change, motion_of_sources
from truing.simulation.bench.six_upur.influence import influence_matrix
from truing.simulation.bench.six_upur.uncertain_sensor import UncertainSensor, compliance_change

SIGMA = np.array(TOLERANCES_UM) * 1e-6 / 6.0
EACH = 0.05 * np.sqrt(0.5)  # half of the variance is that of all legs, half a leg's own


@pytest.mark.parametrize("name", ["A", "N"])
def test_derivatives_are_those_of_the_sensor(name: str) -> None:
    sensor = sensor_of(name)
    own = UncertainSensor(sensor.joints, sensor, None, SIGMA, 0.05)
    known, parts = compliance_change(sensor), len(sensor.parts.names)
    by_geometry, by_stiffness = own.by_geometry, own.by_stiffness(np.zeros(own.stiffness_size))
    size = np.abs(sensor.compliance).max()
    expected = (known.by_source * SIGMA[:, None, None]).reshape(-1, 6, 6)
    assert_close(by_geometry.compliance, expected, atol=1e-12 * np.abs(expected).max())
    legs = known.by_stiffness.reshape(-1, 6, 6) * EACH
    assert_close(by_stiffness.compliance[parts:], legs, atol=1e-12 * size)
    assert_close(by_stiffness.compliance[:parts], known.by_stiffness.sum(0) * EACH, atol=1e-12 * size)
    G = influence_matrix(sensor.joints)
    turned = influence_change(sensor.joints, motion_of_sources(sensor.joints)) * np.tile(SIGMA, 6)[:, None, None]
    passive = -np.linalg.inv(G) @ turned @ np.linalg.inv(G)
    assert_close(by_geometry.forces[:, 0], passive, atol=1e-11 * np.abs(passive).max())


def test_a_stiffer_part_is_not_linearised() -> None:
    sensor = sensor_of("A")
    own = UncertainSensor(sensor.joints, sensor, None, np.zeros(5), 0.3)
    pulls = np.zeros(own.stiffness_size)
    pulls[2], pulls[len(sensor.parts.names) * 4 + 2] = 1.0, -0.5  # the third part: in all legs, and in the fourth
    softer = sensor.parts.compliance.copy()
    softer[:, 2] *= np.exp(-0.3 * np.sqrt(0.5))
    softer[3, 2] *= np.exp(0.15 * np.sqrt(0.5))
    stiffness = sensor.leg_transport @ np.linalg.inv(softer.sum(1)) @ np.swapaxes(sensor.leg_transport, -1, -2)
    compliance = np.linalg.inv(stiffness.sum(0))
    found = own.at(np.zeros(0), pulls)
    assert_close(found.compliance, compliance, atol=1e-12 * np.abs(compliance).max())
    same = replace(sensor, leg_stiffness=stiffness, compliance=compliance)
    assert_close(found.forces[1], same.axial_forces, atol=1e-12)


def test_a_given_compliance_takes_the_place_of_the_legs() -> None:
    given = sensor_of("A").compliance * 1.1
    alone = UncertainSensor(joints_of("A"), None, given, SIGMA, 0.05)
    assert (alone.stiffness_size, alone.models) == (7, 2)
    assert_close(alone.at(np.zeros(30), np.eye(7)[0]).compliance, given * np.exp(-EACH), atol=1e-18)
    beside = UncertainSensor(joints_of("A"), sensor_of("A"), given, SIGMA, 0.05)
    assert (beside.stiffness_size, beside.models) == (7, 2)
    assert_close(beside.at(np.zeros(30), np.zeros(7)).compliance, given, atol=1e-18)
    # Legs that are alike and do not lengthen under what bends them: how they lengthen tells what runs along them.
    along = alone.at(np.zeros(30), np.zeros(7)).forces[1]
    truth = sensor_of("A").axial_forces
    assert_close(along * (truth[0, 0] / along[0, 0]), truth, atol=1e-9)
    with pytest.raises(ValueError, match="found neither elements nor a compliance"):
        UncertainSensor(None)


@pytest.mark.parametrize("name", ["A", "N", "S"])
def test_the_legs_of_a_given_compliance_are_found(name: str) -> None:
    sensor = sensor_of(name)
    of_legs = UncertainSensor(sensor.joints, sensor, None, SIGMA, 0.05)
    of_file = UncertainSensor(sensor.joints, None, sensor.compliance, SIGMA, 0.05)
    parts, size = len(sensor.parts.names), np.abs(sensor.compliance).max()
    expected = of_legs.by_stiffness(np.zeros(of_legs.stiffness_size)).compliance[parts:]
    expected = expected.reshape(6, parts, 6, 6).sum(1)  # all parts of one leg softer alike
    found = of_file.by_stiffness(np.zeros(of_file.stiffness_size)).compliance
    assert_close(found[1:], expected, atol=0.03 * np.abs(expected).max())
    assert_close(found[:1], -EACH * sensor.compliance[None], atol=1e-12 * size)
    geometry = of_legs.by_geometry.compliance
    # To first order in what the legs' own bending adds, which a file does not tell.
    assert_close(of_file.by_geometry.compliance, geometry, atol=0.25 * np.abs(geometry).max())
    unknown = UncertainSensor(sensor.joints, None, np.zeros((6, 6)), SIGMA, 0.05)
    assert unknown.stiffness_size == 1
    assert not unknown.at(np.zeros(30), np.ones(1)).compliance.any()
