"""The influence matrix: reference values, laws of statics, and limits for six screws."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given

from tests.simulation.bench.six_upur.sensors import SEEDS, SETS, STEP, crooked_joints, joints_of, vector
from tests.tolerance import assert_close
from truing.estimation.rotation import exp_so3
from truing.simulation.bench.six_upur.geometry import JointCentres, joint_centres, leg_axes, outward
from truing.simulation.bench.six_upur.influence import (
    characteristic_length,
    force_bound,
    influence_matrix,
    merit,
    moments_about,
    per_length,
    sensitivities,
)


@pytest.mark.parametrize("name", SETS)
def test_matrix_and_merit_are_those_of_the_reference(name: str) -> None:
    _, outputs = vector(f"eq4.{name}")
    G = influence_matrix(joints_of(name))
    assert_close(G, outputs["G"], atol=1e-15, what="G")
    assert_close(merit(G).condition, outputs["cond"], atol=1e-12 * outputs["cond"], what="condition")
    assert_close(merit(G, 1e-3).condition, outputs["cond_mm"], atol=1e-11 * outputs["cond_mm"], what="in mm")
    low = merit(moments_about(G, np.array([0.0, 0.0, -0.3]))).condition
    assert_close(low, outputs["cond_moments_about_base_centre"], atol=1e-11, what="about the base's centre")
    assert_close(merit(G).sensitivity, outputs["sensitivities"], atol=1e-12, what="sensitivities")


@given(seed=SEEDS)
def test_leg_forces_balance_the_wrench(seed: int) -> None:
    """The wrench is the sum of forces f S that act at the upper joints, by their components alone."""
    rng = np.random.default_rng(seed)
    joints, force = crooked_joints(rng), rng.normal(size=6)
    acting = force[:, None] * joints.leg / np.linalg.norm(joints.leg, axis=1)[:, None]
    wrench = np.concatenate([acting.sum(0), np.cross(joints.arm, acting).sum(0)])
    assert_close(influence_matrix(joints) @ force, wrench, atol=1e-14, what="wrench")


@given(seed=SEEDS)
def test_lengthening_a_leg_moves_the_platform_as_its_dual_says(seed: int) -> None:
    """Duality: dL = G' (v; w), leg lengths by the platform's twist, as a complex step through the lengths finds it."""
    rng = np.random.default_rng(seed)
    joints, twist = crooked_joints(rng), rng.normal(size=6)
    small = 1j * STEP * twist
    moved = joints.displaced(small[:3], exp_so3(small[3:]))
    assert_close(moved.length.imag / STEP, influence_matrix(joints).T @ twist, atol=1e-13, what="lengthening")


@given(seed=SEEDS)
def test_no_six_screws_are_more_sensitive_to_forces_than_the_bound(seed: int) -> None:
    found = sensitivities(influence_matrix(crooked_joints(np.random.default_rng(seed))))
    assert force_bound(found) <= 6.0 + 1e-12
    assert found[:3].min() >= 1.0 / np.sqrt(6.0) - 1e-12


@given(seed=SEEDS)
def test_a_length_scales_moments_and_nothing_else(seed: int) -> None:
    G = influence_matrix(crooked_joints(np.random.default_rng(seed)))
    length = float(characteristic_length(G))
    raw, scaled = merit(G), merit(G, length)
    rows = per_length(G, length)
    assert_close(np.sum(rows[3:] ** 2), np.sum(rows[:3] ** 2), atol=1e-12, what="weight of the moments")
    assert_close(scaled.sensitivity[:3], raw.sensitivity[:3], atol=1e-11, what="of forces")
    assert_close(scaled.sensitivity[3:], length * raw.sensitivity[3:], atol=1e-11, what="of moments")
    assert_close(scaled.torque_isotropy, raw.torque_isotropy, atol=1e-12, what="torque isotropy")
    assert_close(scaled.isotropy * scaled.condition, 1.0, atol=1e-12, what="isotropy")
    ratio = scaled.sensitivity.max() / scaled.sensitivity.min()
    assert scaled.condition >= ratio - 1e-9, "no condition number is below the ratio of column norms"


@given(seed=SEEDS)
def test_turning_the_whole_sensor_turns_the_wrench(seed: int) -> None:
    rng = np.random.default_rng(seed)
    joints, R = crooked_joints(rng), exp_so3(rng.normal(size=3))
    turned = JointCentres(joints.lower @ R.T, joints.arm @ R.T, joints.origin @ R.T)
    assert_close(influence_matrix(turned), np.kron(np.eye(2), R) @ influence_matrix(joints), atol=1e-14, what="G")


def test_a_batch_of_sensors_gives_the_results_of_single_sensors() -> None:
    rng = np.random.default_rng(0)
    some = [crooked_joints(rng) for _ in range(4)]
    arrays = (np.stack([getattr(joints, name) for joints in some]) for name in ("lower", "arm", "origin"))
    together = influence_matrix(JointCentres(*arrays))
    for G, joints in zip(together, some, strict=True):
        assert_close(G, influence_matrix(joints), atol=0.0, what="G")
    assert merit(together).condition.shape == (4,)


def test_axes_of_a_leg_are_those_of_the_reference() -> None:
    _, outputs = vector("eq11")
    x, y, z = leg_axes(joints_of("S").direction[0]).T
    assert_close(x, outputs["S1"], atol=1e-15, what="S1")
    assert_close(-y, outputs["S2"], atol=1e-15, what="S2")
    assert_close(z, outputs["S3"], atol=1e-15, what="S3")


def test_vertical_legs_and_joints_on_the_axis_have_directions_too() -> None:
    axes = leg_axes(np.array([[0.0, 0.0, 1.0], [0.0, 0.6, 0.8]]))
    assert_close(axes[0], np.eye(3), atol=0.0, what="vertical leg")
    assert_close(np.linalg.det(axes), np.ones(2), atol=1e-15, what="handedness")
    assert_close(outward(np.array([[0.0, 0.0, 2.0], [0.0, -3.0, 1.0]])), [[1, 0, 0], [0, -1, 0]], atol=0.0)


def test_joints_that_make_no_sensor_are_refused() -> None:
    with pytest.raises(ValueError, match=r"\(5, 3\) and \(6, 3\)"):
        joint_centres(np.zeros((5, 3)), np.zeros((6, 3)), 0.3)
    lower = np.array(joints_of("S").lower)
    with pytest.raises(ValueError, match="expected joints B and b at different points"):
        joint_centres(lower, lower, 0.0)
    parallel = joint_centres(lower, lower, 0.3)
    with pytest.raises(np.linalg.LinAlgError):
        sensitivities(influence_matrix(parallel))
