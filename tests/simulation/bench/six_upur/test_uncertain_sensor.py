"""A sensor within its tolerances: derivatives part by part, against sensors with changed dimensions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from numpy.typing import NDArray

from tests.simulation.bench.six_upur.sensors import (
    SEEDS,
    STEP,
    TOLERANCES_UM,
    crooked_joints,
    crooked_leg,
    joints_of,
    leg_of,
    levered,
    sensor_of,
)
from tests.tolerance import assert_between, assert_close
from truing.estimation.rotation import exp_so3
from truing.schemas.mechanism import SensorTolerance
from truing.simulation.bench.six_upur import elements
from truing.simulation.bench.six_upur.assembly import SOURCES, influence_change, motion_of_sources
from truing.simulation.bench.six_upur.elements import LegElement, moved_along
from truing.simulation.bench.six_upur.geometry import JointCentres, leg_axes, outward
from truing.simulation.bench.six_upur.influence import influence_matrix
from truing.simulation.bench.six_upur.stiffness import elastic_sensor, end_transport
from truing.simulation.bench.six_upur.tolerances import assembled
from truing.simulation.bench.six_upur.uncertain_sensor import UncertainSensor, compliance_change, compliance_covariance

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


_, _, LOW, MIDDLE, INSTALLED = range(5)


def as_assembled(joints: JointCentres, errors: NDArray) -> JointCentres:
    """The joints where legs with errors (6, 5) close: by the closure itself, not by its linear map."""
    found = assembled(joints, errors[None])[0]
    lower = joints.lower + outward(joints.lower) * errors[:, 1:2]
    arm = joints.arm + outward(joints.arm) * errors[:, :1]
    return JointCentres(lower, arm @ exp_so3(found[3:]).T, joints.origin + found[:3])


def compliance_with(
    joints: JointCentres, leg: list[LegElement], seat: int, errors: NDArray, soften: NDArray
) -> NDArray:
    """The compliance of a sensor with length errors (6, 5) and parts softened by factors (6, P), put together anew.

    Parts lie where the unloaded sensor has them, but for what the clearances and the installation insert.
    """
    stands = as_assembled(joints, errors)
    ends = end_transport(stands.arm, leg_axes(stands.direction))
    rest = joints.length - sum(element.length or 0.0 for element in leg)
    K = np.zeros((6, 6), complex)
    for i in range(6):
        C, part, beyond = np.zeros((6, 6), complex), len(soften[i]), -errors[i, MIDDLE]
        for j in reversed(range(len(leg))):
            inserted = errors[i, INSTALLED] if j < seat else 0.0
            for _, local in reversed(leg[j].gives):
                part -= 1
                C = C + soften[i, part] * moved_along(local, np.array(beyond + inserted))
            beyond = beyond + (rest[i] if leg[j].length is None else leg[j].length)
        K = K + ends[i] @ np.linalg.inv(C) @ ends[i].T
    return np.linalg.inv(K)


@given(seed=SEEDS)
def test_derivatives_are_a_complex_step_of_the_assembled_sensor(seed: int) -> None:
    rng = np.random.default_rng(seed)
    joints, leg = crooked_joints(rng), crooked_leg(rng)
    sensor = elastic_sensor(joints, leg)
    parts, change = len(sensor.parts.names), compliance_change(sensor)
    errors, soften = rng.normal(size=(6, 5)), rng.normal(size=(6, parts))
    rounding = 1e-13 * np.linalg.cond(levered(sensor.compliance, 2.0))
    moved = compliance_with(joints, leg, 4, 1j * STEP * errors, np.ones((6, parts)))
    _same(np.einsum("ik,ikpq->pq", errors, change.by_source), moved.imag / STEP, rounding)
    _same(sensor.compliance, moved.real, rounding)
    stiffer = compliance_with(joints, leg, 4, np.zeros((6, 5)), 1.0 - 1j * STEP * soften)
    _same(np.einsum("ik,ikpq->pq", soften, change.by_stiffness), stiffer.imag / STEP, rounding)


def test_without_a_force_sensor_the_installation_is_at_the_middle_of_the_leg() -> None:
    rod = (206e9, 0.3)
    leg = [
        elements.cylinder(0.1, 0.012, *rod),
        elements.rigid(),
        elements.leaf(0.02, 0.03, 0.006, *rod, "s1"),
        elements.cylinder(0.08, 0.016, *rod),
    ]
    joints, errors = joints_of("A"), np.zeros((6, 5))
    errors[:, INSTALLED] = np.arange(1.0, 7.0)
    found = np.einsum("ik,ikpq->pq", errors, compliance_change(elastic_sensor(joints, leg)).by_source)
    middle, further_out = (
        compliance_with(joints, leg, seat, 1j * STEP * errors, np.ones((6, 3))).imag / STEP for seat in (1, 3)
    )
    _same(found, middle, 1e-9)
    assert np.abs(levered(middle - further_out)).max() > 1e-3 * np.abs(levered(middle)).max()


def test_a_vertical_leg_turns_as_any_other() -> None:
    """Derivatives agree with differences of assembled sensors; round rods do not show jumps of the axes of their
    legs."""
    rod, plain = (206e9, 0.3), joints_of("A")
    leg = [elements.cylinder(0.1, 0.012, *rod), elements.rigid(), elements.cylinder(0.08, 0.016, *rod)]
    lower = plain.lower.copy()
    lower[[0, 3], :2] = plain.arm[[0, 3], :2]
    joints, errors, step = replace(plain, lower=lower), np.random.default_rng(3).normal(size=(6, 5)), 1e-6
    assert np.count_nonzero(joints.direction[:, 2] == 1.0) == 2
    ahead, behind = (compliance_with(joints, leg, 1, by * errors, np.ones((6, 2))).real for by in (step, -step))
    found = np.einsum("ik,ikpq->pq", errors, compliance_change(elastic_sensor(joints, leg)).by_source)
    _same(found, (ahead - behind) / (2.0 * step), 1e-7)


def _same(found: NDArray, expected: NDArray, rounding: float) -> None:
    found, expected = levered(found, 2.0), levered(expected, 2.0)
    assert_close(found, expected, atol=rounding * np.abs(expected).max())


@given(seed=SEEDS)
def test_the_compliance_is_homogeneous_of_degree_minus_one_in_all_moduli(seed: int) -> None:
    """Euler: the compliance is homogeneous of degree -1 in all elastic parameters together."""
    rng = np.random.default_rng(seed)
    sensor = elastic_sensor(crooked_joints(rng), crooked_leg(rng))
    common = compliance_change(sensor).by_stiffness.sum(0)
    rounding = 1e-13 * np.linalg.cond(levered(sensor.compliance, 2.0))
    _same(common.sum(0), -sensor.compliance, rounding)
    for part in common:
        assert np.linalg.eigvalsh(-levered(part, 2.0))[0] > -rounding * np.abs(levered(sensor.compliance, 2.0)).max()


@given(seed=SEEDS)
def test_the_influence_matrix_follows_the_sources_too(seed: int) -> None:
    rng = np.random.default_rng(seed)
    joints, errors = crooked_joints(rng), rng.normal(size=(6, 5))
    found = np.einsum("p,pqi->qi", errors.ravel(), influence_change(joints, motion_of_sources(joints)))
    expected = influence_matrix(as_assembled(joints, 1j * STEP * errors)).imag / STEP
    assert_close(found, expected, atol=1e-12 * np.abs(expected).max(), what="G")


def test_covariances_are_those_of_sampled_sensors() -> None:
    """Each draw with its own radii, clearances and moduli; a chi-square bound on the variance of 300 of them."""
    rng, count = np.random.default_rng(5), 300
    joints, leg, sensor = joints_of("A"), leg_of("A"), sensor_of("A")
    sigma, spread = np.array([155.0, 130.0, 36.0, 36.0, 87.0]) / 6e6, 1e-3
    change, parts = compliance_change(sensor), len(sensor.parts.names)
    C = compliance_covariance(change.by_source, sigma) + compliance_covariance(change.by_stiffness, spread)
    drawn = [
        compliance_with(joints, leg, 2, sigma * rng.normal(size=(6, 5)), np.exp(spread * rng.normal(size=(6, parts))))
        for _ in range(count)
    ]
    off = np.array(drawn).real - sensor.compliance
    for place in ((0, 0), (1, 1), (2, 2), (3, 3), (4, 4), (5, 5)):
        flat = 6 * place[0] + place[1]
        ratio = float(np.mean(off[:, *place] ** 2) / C[flat, flat])
        assert_between(ratio, 1 - 5 * np.sqrt(2 / count), 1 + 5 * np.sqrt(2 / count), what=f"variance of {place}")


def test_displacements_follow_as_the_compliance_does() -> None:
    sensor, load = sensor_of("A"), np.array([9e3, 0, 0, 0, 1e2, 0])
    change = compliance_change(sensor).by_stiffness
    found = change @ load
    assert found.shape == (6, len(sensor.parts.names), 6)
    assert_close(found.sum((0, 1)), -sensor.displacement(load), atol=1e-12, what="all parts together")


def test_a_given_compliance_is_known_as_well_as_its_one_stiffness() -> None:
    C = sensor_of("A").compliance
    variance = np.diag(compliance_covariance(-C[None], 0.05)).reshape(6, 6)
    assert_close(np.sqrt(variance), 0.05 * np.abs(C), atol=1e-20, what="sigma")


def test_sources_have_the_names_of_the_campaign() -> None:
    assert [f"{name}_um" for name in SOURCES] == list(SensorTolerance.model_fields)[:5]
