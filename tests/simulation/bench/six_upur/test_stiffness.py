"""The elastic sensor: reference values, laws of elasticity, and invalid elements."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given

from tests.simulation.bench.six_upur.sensors import (
    SEEDS,
    SETS,
    crooked_joints,
    crooked_leg,
    joints_of,
    leg_of,
    levered,
    sensor_of,
    vector,
)
from tests.tolerance import assert_between, assert_close
from truing.estimation.rotation import exp_so3, skew
from truing.simulation.bench.six_upur import elements
from truing.simulation.bench.six_upur.elements import LegElement, leg_parts
from truing.simulation.bench.six_upur.geometry import JointCentres, leg_axes
from truing.simulation.bench.six_upur.influence import influence_matrix
from truing.simulation.bench.six_upur.stiffness import elastic_sensor, end_transport

TABLE_2 = 1e3 * np.repeat([1e6, 180 * 3600 / np.pi], 3)


@pytest.mark.parametrize("name", SETS)
def test_stiffness_and_table_2_are_those_of_the_reference(name: str) -> None:
    _, outputs = vector(f"eq27.{name}")
    sensor = sensor_of(name)
    K, expected = sensor.leg_stiffness.sum(-3), np.array(outputs["K"])
    assert_close(levered(K), levered(expected), atol=1e-11 * np.abs(levered(expected)).max(), what="K")
    found = TABLE_2 * np.diag(sensor.compliance)
    assert_close(found, outputs["table2_um_arcsec_per_1000"], atol=1e-9 * 230.0, what="Table 2")
    axes = np.kron(np.eye(2), leg_axes(sensor.joints.direction)[0])
    leg = axes @ sensor.parts.compliance[0].sum(0) @ axes.T
    expected = np.array(outputs["leg_compliance_1"])
    assert_close(leg, expected, atol=1e-11 * np.abs(expected).max(), what="compliance of leg 1")


@given(seed=SEEDS)
def test_compliance_is_symmetric_and_no_load_is_moved_against(seed: int) -> None:
    rng = np.random.default_rng(seed)
    sensor = elastic_sensor(crooked_joints(rng), crooked_leg(rng))
    size = np.sqrt(np.diag(sensor.compliance))
    scaled = sensor.compliance / np.outer(size, size)
    assert_close(scaled, scaled.T, atol=1e-12 / np.linalg.eigvalsh(scaled)[0], what="asymmetry")
    assert np.linalg.eigvalsh(scaled)[0] > 0.0


@given(seed=SEEDS)
def test_legs_carry_the_load_together_and_follow_the_platform(seed: int) -> None:
    """Equilibrium and compatibility, leg by leg: `J_F' u = C_i w_i` with the wrench w_i at the leg's own end."""
    rng = np.random.default_rng(seed)
    sensor, load = elastic_sensor(crooked_joints(rng), crooked_leg(rng)), rng.normal(size=6)
    carried = sensor.leg_wrenches @ load
    rounding = 1e-14 * np.linalg.cond(levered(sensor.compliance, 2.0))
    assert_close(carried.sum(0), load, atol=1e2 * rounding, what="sum of the legs")
    at_end = np.linalg.solve(sensor.leg_transport, carried[..., None])[..., 0]
    given_way = (sensor.parts.compliance.sum(1) @ at_end[..., None])[..., 0]
    follows = np.swapaxes(sensor.leg_transport, -1, -2) @ sensor.displacement(load)
    assert_close(given_way, follows, atol=1e2 * rounding * np.abs(follows).max(), what="end of the leg")


@given(seed=SEEDS)
def test_strain_energy_is_that_of_the_parts(seed: int) -> None:
    rng = np.random.default_rng(seed)
    sensor, load = elastic_sensor(crooked_joints(rng), crooked_leg(rng)), rng.normal(size=6)
    at_end = np.linalg.solve(sensor.leg_transport, (sensor.leg_wrenches @ load)[..., None])
    stored = np.sum(np.swapaxes(at_end, -1, -2)[:, None] @ sensor.parts.compliance @ at_end[:, None])
    done = load @ sensor.displacement(load)
    assert_close(stored / done, 1.0, atol=1e-12 * np.linalg.cond(levered(sensor.compliance, 2.0)), what="energy")


@given(seed=SEEDS)
def test_a_chain_may_be_cut_anywhere(seed: int) -> None:
    """Two cylinders in line are one; a rigid length within makes no difference to where the rest is."""
    rng = np.random.default_rng(seed)
    cut = rng.uniform(0.02, 0.1)
    joints, rod = crooked_joints(rng), (206e9, 0.3)

    def compliance(leg: list[LegElement]) -> np.ndarray:
        return levered(elastic_sensor(joints, leg).compliance, 2.0)

    whole = compliance([elements.cylinder(0.12, 0.012, *rod), elements.rigid()])
    parts = [elements.cylinder(cut, 0.012, *rod), elements.cylinder(0.12 - cut, 0.012, *rod), elements.rigid()]
    assert_close(compliance(parts), whole, atol=1e-9 * np.abs(whole).max(), what="cut")
    other = [*parts[:2], elements.rigid(0.05), elements.rigid()]
    assert_close(compliance(other), whole, atol=1e-9 * np.abs(whole).max(), what="rigid length")
    more = [*parts, elements.spring(axial=1e6)]
    softer = compliance(more) - whole
    assert np.linalg.eigvalsh(softer)[0] > -1e-9 * np.abs(whole).max(), "a further part makes nothing stiffer"


@given(seed=SEEDS)
def test_the_order_of_parts_matters_only_by_where_they_are(seed: int) -> None:
    rng = np.random.default_rng(seed)
    joints = joints_of("S")
    soft, sensor = elements.leaf(0.02, 0.03, 0.004, 206e9, 0.3, "s1"), elements.spring(axial=rng.uniform(1e6, 1e8))
    rest = [elements.cylinder(0.05, 0.01, 206e9, 0.3)]
    orders = ([sensor, soft, elements.rigid(), *rest], [soft, sensor, elements.rigid(), *rest])
    one, other = (levered(elastic_sensor(joints, leg).compliance) for leg in orders)
    assert_close(one, other, atol=1e-10 * np.abs(one).max(), what="an axial spring anywhere on the axis")
    moved = levered(elastic_sensor(joints, [elements.rigid(), soft, sensor, *rest]).compliance)
    assert np.abs(moved - one).max() > 1e-3 * np.abs(one).max(), "a bending part elsewhere"


def test_the_freer_the_joints_the_more_legs_have_the_forces_of_G() -> None:
    joints, free = joints_of("S"), np.diag([0.0, 0.0, 0.0, 1.0, 1.0, 1.0])
    expected, off = np.linalg.inv(influence_matrix(joints)), []
    for softness in (10.0, 100.0):  # rad/(N m)
        joint = elements.compliance(softness * free)
        found = elastic_sensor(joints, [joint, elements.rigid(), elements.spring(axial=1e7), joint])
        off.append(np.abs(found.axial_forces - expected).max())
    assert_between(off[0] / off[1], 9.9, 10.1, what="what joints take, for a tenth of their stiffness")
    assert off[1] < 1e-6


@given(seed=SEEDS)
def test_turning_the_platforms_frame_turns_the_transport(seed: int) -> None:
    rng = np.random.default_rng(seed)
    arm, axes, turn = rng.normal(size=3), exp_so3(rng.normal(size=3)), exp_so3(rng.normal(size=3))
    expected = np.kron(np.eye(2), turn) @ end_transport(arm, axes)
    assert_close(end_transport(turn @ arm, turn @ axes), expected, atol=1e-14, what="J_F")


def test_a_batch_of_sensors_gives_the_results_of_single_sensors() -> None:
    rng = np.random.default_rng(0)
    some = [crooked_joints(rng) for _ in range(3)]
    arrays = (np.stack([getattr(joints, name) for joints in some]) for name in ("lower", "arm", "origin"))
    together = elastic_sensor(JointCentres(*arrays), leg_of("S"))
    for i, joints in enumerate(some):
        alone = elastic_sensor(joints, leg_of("S"))
        assert_close(together.compliance[i], alone.compliance, atol=1e-12 * np.abs(alone.compliance).max(), what="C")
        assert_close(together.axial_forces[i], alone.axial_forces, atol=1e-9, what="axial forces")


def test_eq_24_as_printed_breaks_the_symmetry_of_K() -> None:
    """The printed J^i is the transpose of J_F; taken literally eq. 27 multiplies by its inverse."""
    sensor = sensor_of("A")
    J_F, axes = sensor.leg_transport, np.kron(np.eye(2), leg_axes(sensor.joints.direction))
    own = np.linalg.inv(sensor.parts.compliance.sum(-3))
    printed = J_F @ own @ np.linalg.inv(np.swapaxes(J_F, -1, -2))
    K = levered(printed.sum(0))
    assert np.abs(K - K.T).max() > 0.3 * np.abs(K).max()
    lever = np.block([[np.eye(3), np.zeros((3, 3))], [skew(sensor.joints.arm[0]), np.eye(3)]])
    assert_close(J_F[0], lever @ axes[0], atol=1e-15, what="J_F of leg 1")


@pytest.mark.parametrize(
    ("leg", "expected"),
    [
        ([elements.spring(axial=1e7), elements.rigid()], "is rigid"),
        ([elements.rigid()], "found rigid elements only"),
        ([elements.cylinder(0.2, 0.01, 2e11, 0.3)], "the length of each leg"),
        ([elements.cylinder(0.4, 0.01, 2e11, 0.3), elements.rigid()], "at most the shortest leg"),
        ([elements.rigid(), elements.cylinder(0.1, 0.01, 2e11, 0.3), elements.rigid()], "2 elements without length"),
    ],
)
def test_elements_that_make_no_leg_are_refused(leg: list[LegElement], expected: str) -> None:
    with pytest.raises(ValueError, match=expected):
        elastic_sensor(joints_of("S"), leg)


def test_a_matrix_that_is_no_compliance_is_refused() -> None:
    with pytest.raises(ValueError, match=r"found a matrix of shape \(5, 5\)"):
        elements.compliance(np.eye(5))
    lopsided = np.eye(6)
    lopsided[0, 1] = 0.5
    with pytest.raises(ValueError, match="expected a symmetric compliance"):
        elements.compliance(lopsided)
    with pytest.raises(ValueError, match="expected a symmetric compliance"):
        elements.compliance(np.full((6, 6), np.nan))
    with pytest.raises(ValueError, match="negative eigenvalue"):
        elements.compliance(np.diag([1.0, 1.0, -1.0, 1.0, 1.0, 1.0]))


def test_a_compliance_typed_with_four_digits_is_taken_for_its_symmetric_part() -> None:
    exact = sensor_of("A").compliance
    typed = np.array([[float(f"{value:.3e}") for value in row] for row in exact])
    typed[0, 4] *= 1.0001
    found = elements.passive(typed, "compliance_file")
    size = np.sqrt(np.diag(exact))
    assert_close(found / np.outer(size, size), exact / np.outer(size, size), atol=1e-3, what="compliance")
    assert_close(found, found.T, atol=0.0, what="asymmetry")


def test_lengths_of_a_drawing_are_met_to_their_rounding() -> None:
    joints = joints_of("S")
    length = float(joints.length[0])
    rounded = [elements.cylinder(round(length, 4), 0.01, 2e11, 0.3)]
    assert leg_parts(rounded, joints.length).compliance.shape == (6, 1, 6, 6)
