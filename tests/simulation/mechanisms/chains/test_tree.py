"""Kinematics of chains: transforms, derivatives, independent errors of geometry, load by gravity."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.tolerance import assert_close
from truing.estimation.rotation import exp_so3, log_so3
from truing.simulation.mechanisms.chains.notations import (
    MODIFIED,
    STANDARD,
    DenavitHartenberg,
    Screw,
    tree_of_rows,
    tree_of_screws,
)
from truing.simulation.mechanisms.chains.tree import (
    STANDARD_GRAVITY,
    JointKind,
    Node,
    Tree,
    TreeFrames,
    axis_twist,
    geometry_modes,
)

# Universal Robots UR10, as its maker gives it: three parallel axes.
UR10 = [
    DenavitHartenberg(0.0, np.pi / 2, 0.1273, 0.0),
    DenavitHartenberg(-0.612, 0.0, 0.0, 0.0),
    DenavitHartenberg(-0.5723, 0.0, 0.0, 0.0),
    DenavitHartenberg(0.0, np.pi / 2, 0.163941, 0.0),
    DenavitHartenberg(0.0, -np.pi / 2, 0.1157, 0.0),
    DenavitHartenberg(0.0, 0.0, 0.0922, 0.0),
]
NAMES = tuple(f"j{k}" for k in range(1, 7))


def matrix(R: NDArray, t: NDArray) -> NDArray:
    found = np.eye(4)
    found[:3, :3], found[:3, 3] = R, t
    return found


def about(axis: int, angle: float) -> NDArray:
    return matrix(exp_so3(angle * np.eye(3)[axis]), np.zeros(3))


def along(axis: int, distance: float) -> NDArray:
    return matrix(np.eye(3), distance * np.eye(3)[axis])


def random_rows(rng: np.random.Generator, convention: str) -> list[DenavitHartenberg]:
    kinds = [JointKind.REVOLUTE, JointKind.PRISMATIC, JointKind.REVOLUTE, JointKind.REVOLUTE]
    return [DenavitHartenberg(*rng.normal(size=4), kind, convention) for kind in kinds]


@pytest.mark.parametrize("convention", [STANDARD, MODIFIED])
def test_rows_multiply_their_four_elementary_motions(convention: str) -> None:
    rng = np.random.default_rng(3)
    rows, q = random_rows(rng, convention), rng.normal(size=4)
    expected = np.eye(4)
    for row, own in zip(rows, q, strict=True):
        theta = row.theta + own * (row.kind is JointKind.REVOLUTE)
        d = row.d + own * (row.kind is JointKind.PRISMATIC)
        joint = about(2, theta) @ along(2, d)
        link = about(0, row.alpha) @ along(0, row.a)
        expected = expected @ (joint @ link if convention == STANDARD else link @ joint)
    frames = tree_of_rows(rows, ("a", "b", "c", "d")).frames(q[None])
    assert_close(matrix(frames.R[0, -1], frames.t[0, -1]), expected, atol=1e-14)


def test_screws_and_rows_describe_the_same_arm() -> None:
    rows = tree_of_rows(UR10, NAMES)
    zero = rows.frames(np.zeros((1, 6)))
    screws = [Screw(zero.R_before[0, k] @ rows.nodes[k].axis, zero.origin[0, k]) for k in range(1, 7)]
    other = tree_of_screws(screws, (zero.R[0, -1], zero.t[0, -1]), NAMES)
    q = np.random.default_rng(1).uniform(-3, 3, (5, 6))
    assert_close(other.frames(q).t[:, -1], rows.frames(q).t[:, -1], atol=1e-14)
    assert_close(other.frames(q).R[:, -1], rows.frames(q).R[:, -1], atol=1e-14)


def branched() -> Tree:
    """A column with two arms, one of which ends in a gripper whose finger mimics another."""
    rng = np.random.default_rng(5)

    def at() -> tuple[NDArray, NDArray]:
        return exp_so3(rng.normal(size=3)), rng.normal(size=3)

    axis = exp_so3(rng.normal(size=3))[0]
    return Tree(
        (
            Node("", "base", -1, np.eye(3), np.zeros(3)),
            Node("lift", "column", 0, *at(), JointKind.PRISMATIC, axis, "lift", mass=3.0, com=rng.normal(size=3)),
            Node("left", "left arm", 1, *at(), JointKind.REVOLUTE, axis, "left", mass=2.0, com=rng.normal(size=3)),
            Node("right", "right arm", 1, *at(), JointKind.REVOLUTE, axis, "right", mass=1.0, com=rng.normal(size=3)),
            Node("finger", "finger", 3, *at(), JointKind.REVOLUTE, axis, "right", -0.5, 0.2, mass=0.5),
            Node("", "left tool", 2, *at()),
        ),
        ("lift", "left", "right"),
    )


def positions(tree: Tree, q: NDArray, twists: NDArray, nodes: NDArray, places: NDArray) -> tuple[TreeFrames, NDArray]:
    frames = tree.frames(q, twists)
    return frames, frames.t[:, nodes] + np.einsum("bkij,kj->bki", frames.R[:, nodes], places)


def test_slopes_are_those_of_points_and_rotations() -> None:
    tree, rng = branched(), np.random.default_rng(2)
    nodes, places = np.array([5, 4, 3]), rng.normal(size=(3, 3))
    q, twists = rng.normal(size=(2, 3)), 0.3 * rng.normal(size=(2, tree.size, 6))
    frames, points = positions(tree, q, twists, nodes, places)
    by_twist, turned = tree.point_slopes(frames, nodes, points), tree.rotation_slopes(frames, nodes)
    step = 1e-6
    for k in range(tree.size):
        for c in range(6):
            ahead, behind = twists.copy(), twists.copy()
            ahead[:, k, c] += step
            behind[:, k, c] -= step
            (f1, p1), (f0, p0) = (positions(tree, q, own, nodes, places) for own in (ahead, behind))
            assert_close(by_twist[..., k, c], (p1 - p0) / (2 * step), atol=1e-8)
            motion = log_so3(f1.R[:, nodes] @ np.swapaxes(f0.R[:, nodes], -1, -2)) / (2 * step)
            assert_close(turned[..., k, c], motion, atol=1e-8)


def test_a_reading_moves_its_joint_and_those_that_follow_it() -> None:
    tree, rng = branched(), np.random.default_rng(4)
    q, nodes, places = rng.normal(size=(3, 3)), np.array([4, 5]), np.ones((2, 3))
    for twists in (np.zeros((1, tree.size, 6)), 0.3 * rng.normal(size=(3, tree.size, 6))):
        frames, points = positions(tree, q, twists, nodes, places)
        slopes = tree.reading_slopes(frames, nodes, points)
        for j, step in enumerate(1e-6 * np.eye(3)):
            (f1, p1), (f0, p0) = (positions(tree, q + sign * step, twists, nodes, places) for sign in (1.0, -1.0))
            assert_close(slopes[:, :, :3, j], (p1 - p0) / 2e-6, atol=1e-8)
            turned = log_so3(f1.R[:, nodes] @ np.swapaxes(f0.R[:, nodes], -1, -2)) / 2e-6
            assert_close(slopes[:, :, 3:, j], turned, atol=1e-8)
        if not twists.any():
            by_twist = tree.point_slopes(frames, nodes, points)
            assert_close(slopes[:, :, :3], np.einsum("bkinc,jnc->bkij", by_twist, tree.axis_twists), atol=1e-12)


def test_torque_of_weight_is_the_slope_of_potential_energy() -> None:
    tree, q = branched(), np.random.default_rng(7).normal(size=(4, 3))
    down, load = np.array([0.1, -0.2, -1.0]), {5: (np.array([0.7, 0.7, 1.0, 2.0]), np.array([0.1, 0.0, 0.3]))}

    def energy(q: NDArray) -> NDArray:
        frames = tree.frames(q)
        g = STANDARD_GRAVITY * down / np.linalg.norm(down)
        return -sum(m * ((frames.t[:, k] + frames.R[:, k] @ com) @ g) for k, m, com in tree.weights(load))

    force, moment = tree.gravity_load(q, down, load)
    work = np.einsum("bni,jni->bj", force, tree.axis_twists[..., :3]) + np.einsum(
        "bni,jni->bj", moment, tree.axis_twists[..., 3:]
    )
    for j, step in enumerate(1e-5 * np.eye(3)):
        assert_close(work[:, j], -(energy(q + step) - energy(q - step)) / 2e-5, atol=1e-7)


def sensitivity(tree: Tree, columns: NDArray, q: NDArray) -> NDArray:
    """Whole motion (B 6, P) of the tip by twists (N, 6, P)."""
    frames = tree.frames(q)
    nodes = np.array([tree.size - 1])
    points = tree.point_slopes(frames, nodes, frames.t[:, nodes])
    whole = np.concatenate([points, tree.rotation_slopes(frames, nodes)], 2)[:, 0]
    return np.einsum("binc,ncp->bip", whole, columns).reshape(-1, columns.shape[-1])


@pytest.mark.parametrize("screws", [False, True])
def test_geometry_zeros_base_and_tool_explain_every_error_of_any_frame(screws: bool) -> None:
    rows = UR10 if not screws else random_rows(np.random.default_rng(9), STANDARD)
    tree = tree_of_rows(rows, NAMES[: len(rows)])
    q = np.random.default_rng(8).uniform(-2, 2, (60, len(rows)))
    every = np.eye(6 * tree.size).reshape(tree.size, 6, -1)
    ends = np.concatenate([every[..., :6], every[..., -6:]], -1)
    zeros = np.moveaxis(tree.axis_twists, 0, -1)
    own = np.concatenate([geometry_modes(tree, np.ones(6), True), zeros, ends], -1)
    rank = np.linalg.matrix_rank(sensitivity(tree, every, q), tol=1e-9)
    assert np.linalg.matrix_rank(sensitivity(tree, own, q), tol=1e-9) == rank
    revolute = sum(node.kind is JointKind.REVOLUTE for node in tree.nodes)
    prismatic = len(rows) - revolute
    assert rank == 4 * revolute + 2 * prismatic + 6


def test_with_targets_of_known_place_geometry_zeros_and_base_explain_every_error_of_a_frame() -> None:
    """A tool of known place cannot imitate motions along the last axis."""
    tree, last = tree_of_rows(UR10, NAMES), len(UR10)
    q = np.random.default_rng(8).uniform(-2, 2, (60, last))
    every = np.eye(6 * tree.size).reshape(tree.size, 6, -1)
    along = np.zeros((tree.size, 6, 2))  # the last axis; across it, the frame of the last joint is no place of the tool
    along[last, :3, 0] = along[last, 3:, 1] = tree.nodes[last].axis
    errors = np.concatenate([every[..., : 6 * last], along], -1)
    zeros = np.moveaxis(tree.axis_twists, 0, -1)
    modes = [geometry_modes(tree, np.ones(6), True, placed=placed) for placed in ((tree.size - 1,), ())]
    known, unknown = (np.concatenate([m, zeros, every[..., :6]], -1) for m in modes)
    rank = np.linalg.matrix_rank(sensitivity(tree, np.concatenate([errors, known], -1), q), tol=1e-9)
    assert np.linalg.matrix_rank(sensitivity(tree, known, q), tol=1e-9) == rank
    assert np.linalg.matrix_rank(sensitivity(tree, unknown, q), tol=1e-9) == rank - 1


@pytest.mark.parametrize("kind", [JointKind.REVOLUTE, JointKind.PRISMATIC])
@pytest.mark.parametrize("follower", [1, 2, 3])
def test_errors_of_a_joint_that_follows_another_are_among_those_of_the_geometry(kind: JointKind, follower: int) -> None:
    """A follower, such as the wrist of a palletiser, is made with errors of its own, its zero among them."""
    tree, rng = tree_of_rows(random_rows(np.random.default_rng(9), STANDARD), NAMES[:4]), np.random.default_rng(8)
    lead = NAMES[3] if follower < 3 else NAMES[0]
    nodes = [replace(node, kind=kind, reading=lead, factor=-0.7) if k == follower else node
             for k, node in enumerate(tree.nodes)]  # fmt: skip
    tree = Tree(tuple(nodes), tuple(name for k, name in enumerate(NAMES[:4], 1) if k != follower))
    q = rng.uniform(-2, 2, (60, 3))
    every = np.eye(6 * tree.size).reshape(tree.size, 6, -1)
    ends = np.concatenate([every[..., :6], every[..., -6:]], -1)
    zeros = np.moveaxis(tree.axis_twists, 0, -1)
    for known in (None, np.ones(6, bool)):
        own = np.concatenate([geometry_modes(tree, np.ones(6), True, known), zeros, ends], -1)
        rank = np.linalg.matrix_rank(sensitivity(tree, every, q), tol=1e-9)
        assert np.linalg.matrix_rank(sensitivity(tree, own, q), tol=1e-9) == rank


def test_errors_of_geometry_leave_the_zero_of_each_joint_to_its_offset() -> None:
    tree = tree_of_rows(UR10, NAMES)
    modes = geometry_modes(tree, np.array([1e-3] * 3 + [1e-4] * 3), True)
    q = np.random.default_rng(8).uniform(-2, 2, (60, 6))
    base = np.zeros((tree.size, 6, 12))
    base[0, :, :6], base[-1, :, 6:] = np.eye(6), np.eye(6)
    known = sensitivity(tree, np.concatenate([modes, base], -1), q)
    for joint in (1, 2, 3, 4):  # those of the first and the last joint are motions of base and tool
        zero = sensitivity(tree, tree.axis_twists[joint][..., None], q)
        left = zero - known @ np.linalg.lstsq(known, zero, rcond=1e-10)[0]
        assert np.linalg.norm(left) > 0.05 * np.linalg.norm(zero)


def test_modes_are_continuous_where_axes_become_parallel() -> None:
    def space(tilt: float) -> NDArray:
        rows = [DenavitHartenberg(0.5, tilt, 0.1, 0.2), DenavitHartenberg(0.4, 0.3, 0.0, 0.0)]
        modes = geometry_modes(tree_of_rows(rows, ("a", "b")), np.ones(6), True).reshape(-1, 3)
        return modes @ modes.T

    assert_close(space(1e-7), space(0.0), atol=1e-6)


def test_a_twist_of_an_axis_is_a_motion_of_the_joint() -> None:
    tree, q = tree_of_rows(UR10, NAMES), np.random.default_rng(6).normal(size=(3, 6))
    twists = np.zeros((1, tree.size, 6))
    twists[0, 3] = 0.2 * axis_twist(tree.nodes[3])
    moved = q + 0.2 * (np.arange(6) == 2)
    assert_close(tree.frames(q, twists).t[:, -1], tree.frames(moved).t[:, -1], atol=1e-14)


def test_constant_twists_are_taken_into_the_transforms() -> None:
    tree, rng = branched(), np.random.default_rng(6)
    q, twists = rng.normal(size=(3, 3)), 0.1 * rng.normal(size=(tree.size, 6))
    assert_close(tree.with_twists(twists).frames(q).t, tree.frames(q, twists[None]).t, atol=1e-13)


def test_no_tolerance_of_a_joint_is_left_out_but_that_of_its_own_zero() -> None:
    sigma, axes, kinds = np.array([2e-4] * 3 + [5e-4] * 3), np.eye(3)[[2, 1, 0]], ("revolute", "prismatic", "revolute")
    nodes = [Node("", "base", -1, np.eye(3), np.zeros(3))]
    for k, (axis, kind) in enumerate(zip(axes, kinds, strict=True)):
        place = np.array([0.1, 0.2, 0.3])
        nodes.append(Node(f"j{k}", f"link{k}", k, np.eye(3), place, JointKind(kind), axis, f"j{k}"))
    tree = Tree(tuple(nodes), ("j0", "j1", "j2"))
    modes = geometry_modes(tree, sigma, False, np.ones(6, bool))
    for k in (1, 2, 3):
        own_zero = sigma * axis_twist(tree.nodes[k])
        assert_close(modes[k] @ modes[k].T + np.outer(own_zero, own_zero), np.diag(sigma**2), atol=1e-20, what="m2")
