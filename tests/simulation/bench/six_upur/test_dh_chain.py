"""The chain of a leg: reference values, derivatives, and where it must lead."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from numpy.typing import NDArray

from tests.simulation.bench.six_upur.sensors import SEEDS, SETS, STEP, crooked_joints, joints_of, vector
from tests.tolerance import assert_close
from truing.estimation.rotation import exp_so3
from truing.simulation.bench.six_upur.assembly import (
    ANGLES,
    DhChain,
    angles_between,
    dh_chain,
    follow,
    influence_coefficients,
    sensor_chains,
)

KINDS = ("a", "S", "theta", "alpha")


def crooked_chain(rng: np.random.Generator) -> DhChain:
    numbers = [rng.normal(0.0, size, 7) for size in (0.3, 0.3, 1.0, 1.0)]
    first, last = (vector / np.linalg.norm(vector) for vector in rng.normal(size=(2, 3)))
    origin, tail = rng.normal(size=(2, 3))
    return DhChain(exp_so3(rng.normal(size=3)), *numbers, origin, first, last, tail)


def test_chain_and_coefficients_are_those_of_the_reference() -> None:
    inputs, outputs = vector("eq9")
    numbers = [np.array(inputs[name]) for name in ("a_01_to_67", "S_1_to_7", "theta_1_to_7", "alpha_01_to_67")]
    links = follow(dh_chain(np.array(inputs["T0"]), *numbers))
    assert_close(links.P, outputs["P"], atol=1e-14, what="P")
    assert_close(links.T, outputs["T7"], atol=1e-14, what="T7")
    found = influence_coefficients(links)
    for kind in KINDS:
        assert_close(getattr(found, kind)[:3], outputs[f"G_{kind}_P"], atol=1e-14, what=f"G_{kind}, position")
    for kind in ("theta", "alpha"):
        assert_close(getattr(found, kind)[3:], outputs[f"G_{kind}_R"], atol=1e-14, what=f"G_{kind}, rotation")


@given(seed=SEEDS)
def test_coefficients_are_a_complex_step_of_the_chain(seed: int) -> None:
    chain = crooked_chain(np.random.default_rng(seed))
    links = follow(chain)
    found = influence_coefficients(links)
    for kind in KINDS:
        for j in range(7):
            nudged = follow(replace(chain, **{kind: getattr(chain, kind) + 1j * STEP * np.eye(7)[j]}))
            turn = nudged.T.imag @ links.T.T / STEP
            expected = np.r_[nudged.P.imag / STEP, turn[2, 1], turn[0, 2], turn[1, 0]]
            assert_close(getattr(found, kind)[:, j], expected, atol=1e-13, what=f"{kind} {j}")
            assert_close(turn, -turn.T, atol=1e-13, what="a rotation's derivative")


@given(seed=SEEDS)
def test_frames_of_a_chain_stay_rotations(seed: int) -> None:
    links = follow(crooked_chain(np.random.default_rng(seed)))
    assert_close(links.T @ links.T.T, np.eye(3), atol=1e-14, what="T")
    assert_close(np.linalg.det(links.T), 1.0, atol=1e-14, what="handedness")


@pytest.mark.parametrize("name", SETS)
def test_all_legs_of_a_sensor_lead_to_the_platforms_origin(name: str) -> None:
    joints = joints_of(name)
    P = follow(sensor_chains(joints)).P
    assert_close(P, np.broadcast_to(joints.origin, (6, 3)), atol=1e-15, what="P")


@given(seed=SEEDS)
def test_legs_of_a_crooked_sensor_lead_there_too_by_way_of_both_joints(seed: int) -> None:
    joints = crooked_joints(np.random.default_rng(seed))
    links = follow(sensor_chains(joints))
    assert_close(links.P, np.broadcast_to(joints.origin, (6, 3)), atol=1e-14, what="P")
    lower, upper = links.corner[:, 0], links.corner[:, 5]
    assert_close(lower, joints.lower, atol=1e-14, what="B")
    assert_close(upper, joints.origin + joints.arm, atol=1e-14, what="b")


def test_axes_and_normals_of_leg_1_are_those_of_the_reference() -> None:
    _, outputs = vector("eq11")
    links = follow(sensor_chains(joints_of("S")))
    for j in range(6):
        assert_close(links.axis[0, j], outputs[f"S{j + 1}"], atol=1e-15, what=f"S{j + 1}")
    for j, name in enumerate(("a12", "a23", "a34", "a45", "a56"), 1):
        assert_close(links.normal[0, j], outputs[name], atol=1e-15, what=name)
    angles = angles_between(links.normal[0, 1:6], links.axis[0, 1:5])
    expected = np.radians(list(outputs["theta_deg"].values()))
    assert_close(angles, expected, atol=1e-15, what="theta")
    assert_close(ANGLES[1:5], expected, atol=1e-15, what="theta of the chain")


@given(seed=SEEDS)
def test_batches_of_chains_are_chains_one_by_one(seed: int) -> None:
    rng = np.random.default_rng(seed)
    some = [crooked_chain(rng) for _ in range(3)]
    together = influence_coefficients(follow(_stacked(some)))
    for i, chain in enumerate(some):
        alone = influence_coefficients(follow(chain))
        for kind in KINDS:
            assert_close(getattr(together, kind)[i], getattr(alone, kind), atol=1e-14, what=kind)


def _stacked(chains: list[DhChain]) -> DhChain:
    names: list[str] = list(DhChain.__dataclass_fields__)
    arrays: list[NDArray] = [np.stack([getattr(chain, name) for chain in chains]) for name in names]
    return DhChain(*arrays)
