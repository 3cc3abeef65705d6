"""The synthetic error and G': reference values, and directly displaced legs."""

from __future__ import annotations

import numpy as np
from hypothesis import given

from tests.simulation.bench.six_upur.sensors import SEEDS, crooked_joints, joints_of, sensor_of, vector
from tests.tolerance import assert_close
from truing.estimation.rotation import log_so3
from truing.simulation.bench.six_upur.influence import (
    displaced_joints,
    influence_matrix,
    influence_with_error,
    merit,
    roll_pitch_yaw,
)


def test_the_rotation_is_that_of_the_reference_and_the_printed_one_its_inverse() -> None:
    inputs, outputs = vector("eq30")
    found = roll_pitch_yaw(np.array(inputs["ddelta_rad"]))
    assert_close(found, outputs["R"], atol=1e-15, what="R")
    assert_close(found.T, outputs["printed"], atol=1e-15, what="as printed")


def test_displaced_joints_and_G_are_those_of_the_reference() -> None:
    inputs, outputs = vector("eq32")
    sensor = sensor_of("A")
    by_load = sensor.displacement(np.array(inputs["F_w"]))
    assert_close(by_load, outputs["D2"], atol=1e-12 * 2e-3, what="deformation")
    error = np.array(inputs["D1"]) + by_load
    assert_close(error, outputs["D"], atol=1e-12 * 2e-3, what="synthetic error")
    assert_close(roll_pitch_yaw(error[3:]), outputs["R"], atol=1e-14, what="R")
    moved = displaced_joints(sensor.joints, error)
    assert_close(moved.origin + moved.arm, outputs["b_displaced"], atol=1e-14, what="b'")
    G = influence_with_error(sensor.joints, error)
    assert_close(G, outputs["G_prime"], atol=1e-12, what="G'")
    assert_close(merit(G).condition, outputs["cond_G_prime"], atol=1e-10, what="condition")


@given(seed=SEEDS)
def test_small_angles_are_a_rotation_vector(seed: int) -> None:
    angles = 1e-4 * np.random.default_rng(seed).normal(size=3)
    R = roll_pitch_yaw(angles)
    assert_close(R @ R.T, np.eye(3), atol=1e-15, what="a rotation")
    assert_close(log_so3(R), angles, atol=np.sum(angles**2), what="rotation vector")


@given(seed=SEEDS)
def test_a_shift_of_everything_changes_no_G_and_a_displacement_does(seed: int) -> None:
    rng = np.random.default_rng(seed)
    joints, error = crooked_joints(rng), 1e-3 * rng.normal(size=(4, 6))
    found = influence_with_error(joints, error)
    assert found.shape == (4, 6, 6)
    assert_close(influence_with_error(joints, np.zeros(6)), influence_matrix(joints), atol=0.0, what="no error")
    alone = np.stack([influence_with_error(joints, each) for each in error])
    assert_close(found, alone, atol=1e-15, what="batch")


def test_a_tilt_moves_no_platform_sideways() -> None:
    """Eq. 31 as printed turns about the base's origin: 750 arc seconds and 0.3 m would be 1.1 mm."""
    tilt = np.array([0.0, 0.0, 0.0, 780.0, 730.0, 690.0]) * np.pi / 648000
    joints = joints_of("A")
    assert_close(displaced_joints(joints, tilt).origin, joints.origin, atol=0.0, what="platform's origin")
    printed = roll_pitch_yaw(tilt[3:]) @ joints.origin - joints.origin
    assert np.abs(printed[:2]).min() > 1.0e-3
