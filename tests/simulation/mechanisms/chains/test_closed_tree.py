"""Chains with loops: closed-form kinematics, and derivatives against differences."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.loops.delta_closure import Delta as DeltaLoops
from tests.loops.delta_generator import Delta, urdf
from tests.tolerance import assert_close
from truing.estimation.rotation import exp_so3, log_so3
from truing.formats.urdf import read_urdf
from truing.simulation.mechanisms.chains.closed_tree import ClosedTree, LoopClosure
from truing.simulation.mechanisms.chains.tree import STANDARD_GRAVITY, JointKind, Node, Tree, axis_twist
from truing.stages.ingestion.chain_campaign import tree_of_urdf

ARMS = ("arm_1", "arm_2", "arm_3")
STEP = 1e-6


def delta(folder: Path) -> ClosedTree:
    (folder / "delta.urdf").write_text(urdf(Delta()), encoding="utf-8")
    return tree_of_urdf(read_urdf(folder / "delta.urdf"), "base_link", "platform", ARMS, DeltaLoops())[0]


class FourBar(LoopClosure):
    """The end of the coupler is the end of the rocker, in the plane x z."""

    name = "four-bar"
    passive = ("at_coupler", "at_rocker")
    links = ("coupler_end", "rocker_end")

    def gaps(self, at):  # type: ignore[no-untyped-def]
        return (at["coupler_end"] - at["rocker_end"])[..., [0, 2]]


CRANK, COUPLER, ROCKER, GROUND = 0.1, 0.3, 0.25, 0.28


def four_bar(crank: float = CRANK, coupler: float = COUPLER, rocker: float = ROCKER) -> ClosedTree:
    """At reading zero the crank stands along z, the coupler lies along x; zeros of the passive joints close nearly."""
    none, kind, axis = np.eye(3), JointKind.REVOLUTE, np.array([0.0, 1.0, 0.0])
    nodes = (
        Node("", "base", -1, none, np.zeros(3)),
        Node("crank", "crank", 0, none, np.zeros(3), kind, axis, "crank"),
        Node("at_coupler", "coupler", 1, none, np.array([0.0, 0.0, crank]), kind, axis, "at_coupler"),
        Node("", "coupler_end", 2, none, np.array([coupler, 0.0, 0.0])),
        Node("at_rocker", "rocker", 0, none, np.array([GROUND, 0.0, 0.0]), kind, axis, "at_rocker"),
        Node("", "rocker_end", 4, none, np.array([0.0, 0.0, rocker])),
    )
    return ClosedTree(nodes, ("crank",), FourBar())


def test_a_delta_reaches_where_three_spheres_meet(tmp_path: Path) -> None:
    tree, q = delta(tmp_path), np.random.default_rng(1).uniform(-0.6, 1.0, (200, 3))
    found = tree.frames(q)
    assert tree.closes(q).all()
    assert_close(found.t[:, tree.links["platform"]], Delta().centres(q, np.zeros(200)), atol=1e-14, what="m")


def test_changed_sizes_reach_where_changed_spheres_meet(tmp_path: Path) -> None:
    tree, q = delta(tmp_path), np.random.default_rng(2).uniform(-0.6, 1.0, (50, 3))
    twists = np.zeros((1, tree.size, 6))
    twists[0, tree.links["forearm_end_2"], 2] = -3e-3
    twists[0, tree.links["upper_arm_3"], 4] = 0.02
    wanted = Delta(longer=np.array([0.0, 3e-3, 0.0]), zeros=np.array([0.0, 0.0, 0.02])).centres(q, np.zeros(50))
    assert_close(tree.frames(q, twists).t[:, tree.links["platform"]], wanted, atol=1e-14, what="m")


def test_a_four_bar_closes_where_two_circles_meet() -> None:
    tree, q = four_bar(), np.linspace(-1.0, 1.0, 41)[:, None]
    found = tree.frames(q)
    tip = found.t[:, tree.links["coupler_end"]]
    crank = CRANK * np.stack([np.sin(q[:, 0]), 0.0 * q[:, 0], np.cos(q[:, 0])], -1)
    assert tree.closes(q).all()
    assert_close(np.linalg.norm(tip - crank, axis=1), np.full(41, COUPLER), atol=1e-14, what="m")
    assert_close(np.linalg.norm(tip - [GROUND, 0.0, 0.0], axis=1), np.full(41, ROCKER), atol=1e-14, what="m")


@pytest.mark.slow
def test_slopes_of_points_and_rotations_are_those_of_differences(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    cases = [(delta(tmp_path), "platform", "forearm_end_2", 3), (four_bar(), "coupler", "rocker_end", 1)]
    for tree, *links, joints in cases:
        q = rng.uniform(-0.4, 0.6, (7, joints))
        twists = 1e-3 * rng.normal(size=(7, tree.size, 6))
        base = exp_so3(rng.normal(size=(7, 3))), rng.normal(size=(7, 3))
        nodes = np.array([tree.links[link] for link in links])
        frames = tree.frames(q, twists, base)
        arm = np.array([0.05, -0.02, 0.03])
        points = frames.t[:, nodes] + frames.R[:, nodes] @ arm
        by_points = tree.point_slopes(frames, nodes, points)
        by_turns = tree.rotation_slopes(frames, nodes)
        for n, c in np.ndindex(tree.size, 6):
            nudge = np.zeros_like(twists)
            nudge[:, n, c] = STEP
            high, low = tree.frames(q, twists + nudge, base), tree.frames(q, twists - nudge, base)
            moved = (high.t + high.R @ arm - low.t - low.R @ arm)[:, nodes] / (2.0 * STEP)
            turned = log_so3(high.R[:, nodes] @ np.swapaxes(low.R[:, nodes], -1, -2)) / (2.0 * STEP)
            assert_close(by_points[..., n, c], moved, atol=3e-8, what=f"points by {n} {c}")
            assert_close(by_turns[..., n, c], turned, atol=3e-8, what=f"rotations by {n} {c}")
        by_readings = tree.reading_slopes(frames, nodes, points)
        for k in range(joints):
            high, low = (tree.frames(q + sign * STEP * np.eye(joints)[k], twists, base) for sign in (1.0, -1.0))
            moved = (high.t + high.R @ arm - low.t - low.R @ arm)[:, nodes] / (2.0 * STEP)
            turned = log_so3(high.R[:, nodes] @ np.swapaxes(low.R[:, nodes], -1, -2)) / (2.0 * STEP)
            expected = np.concatenate([moved, turned], 2)
            assert_close(by_readings[..., k], expected, atol=3e-8, what=f"places and rotations by reading {k}")


def heavy(tree: ClosedTree) -> ClosedTree:
    """The tree with a mass on every link, off its origin."""
    nodes = [replace(node, mass=0.5 + k, com=np.array([0.02, -0.01 * k, 0.03])) for k, node in enumerate(tree.nodes)]
    return replace(tree, nodes=tuple(nodes))


def _moment(tree: ClosedTree, q: NDArray, twists: NDArray, payload: dict[int, tuple[NDArray, NDArray]]) -> NDArray:
    """Sum (B, 3) of masses times their places, kg m."""
    frames = tree.frames(q, twists)
    moved = [mass * (frames.t[:, k] + frames.R[:, k] @ com).T for k, mass, com in tree.weights(payload)]
    return np.sum(moved, 0).T


def test_work_of_weight_is_the_slope_of_the_potential_energy(tmp_path: Path) -> None:
    rng = np.random.default_rng(6)
    for tree, joints in ((heavy(delta(tmp_path)), 3), (heavy(four_bar()), 1)):
        q, down, com = rng.uniform(-0.4, 0.6, (5, joints)), np.array([0.3, 0.2, -0.9]), np.array([0.1, 0.0, 0.2])
        payload = {tree.size - 1: (np.linspace(1.0, 2.0, 5), com)}
        force, moment = tree.gravity_load(q, down, payload)
        work = np.concatenate([force, moment], -1)
        unit = STANDARD_GRAVITY * down / np.linalg.norm(down)
        for way in rng.normal(size=(8, 1, tree.size, 6)):
            moved = _moment(tree, q, STEP * way, payload) - _moment(tree, q, -STEP * way, payload)
            wanted = moved @ unit / (2.0 * STEP)
            assert_close(np.einsum("bnc,nc->b", work, way[0]), wanted, atol=1e-5, what="N m")
        passive = [(k, node) for k, node in enumerate(tree.nodes) if node.reading in tree.closure.passive]
        for k, node in passive:
            own = work[:, k] @ axis_twist(node)
            assert_close(own, np.zeros(5), atol=1e-12, what=f"no load on {node.joint}, which is free")


def test_loops_of_unknown_masses_carry_no_known_load() -> None:
    force, moment = four_bar().gravity_load(np.zeros((3, 1)), np.array([0.0, 0.0, -1.0]), {})
    assert force.shape == moment.shape == (3, four_bar().size, 3)
    assert not force.any()
    assert not moment.any()


def test_readings_at_which_two_circles_do_not_meet_are_reported() -> None:
    crank, coupler, rocker = 0.2, 0.3, 0.1
    tree, q = four_bar(crank, coupler, rocker), np.linspace(-1.5, 1.5, 61)[:, None]
    away = np.hypot(crank * np.sin(q[:, 0]) - GROUND, crank * np.cos(q[:, 0]))
    meet = (away < coupler + rocker) & (away > coupler - rocker)
    assert 20 < meet.sum() < 50
    assert (tree.closes(q) == meet).all()


def test_closing_modes_are_what_the_platform_shows(tmp_path: Path) -> None:
    tree = delta(tmp_path)
    none = np.zeros((tree.size, 6, 0))
    modes = tree.closing_modes(np.ones(6), none)
    q = np.random.default_rng(4).uniform(-0.5, 0.8, (60, 3))
    slopes = tree.passive_slopes(tree.frames(q)).reshape(-1, tree.size * 6)
    seen = slopes @ modes.reshape(tree.size * 6, -1)
    assert np.linalg.matrix_rank(seen, tol=1e-9) == modes.shape[-1], "none that the platform does not show"
    closing = np.zeros((tree.size, 6), bool)
    closing[[tree.links[name] for name in tree.closure.links], :3] = True
    assert np.linalg.matrix_rank(slopes[:, closing.ravel()], tol=1e-9) == modes.shape[-1], "all that it shows"


def test_zeros_of_the_arms_are_left_to_the_arms(tmp_path: Path) -> None:
    tree = delta(tmp_path)
    zeros = np.moveaxis(tree.axis_twists, 0, -1)
    modes = tree.closing_modes(np.ones(6), zeros)
    q = np.random.default_rng(4).uniform(-0.5, 0.8, (60, 3))
    slopes = tree.passive_slopes(tree.frames(q)).reshape(-1, tree.size * 6)
    both = slopes @ np.concatenate([modes, zeros], -1).reshape(tree.size * 6, -1)
    assert np.linalg.matrix_rank(both, tol=1e-9) == modes.shape[-1] + 3


def test_a_closure_without_its_joint_or_link_is_refused() -> None:
    tree = four_bar()
    with pytest.raises(ValueError, match="a joint at_rocker that moves and is not read"):
        ClosedTree(tree.nodes, ("crank", "at_rocker"), FourBar())
    renamed = tuple(replace(node, link="end") if node.link == "rocker_end" else node for node in tree.nodes)
    with pytest.raises(ValueError, match="a link rocker_end: closure four-bar needs it"):
        ClosedTree(renamed, tree.readings, FourBar())


def test_two_arms_on_an_unknown_base_each_have_their_place() -> None:
    from truing.simulation.mechanisms.chains.tree import geometry_modes

    axis = np.array([0.0, 0.0, 1.0])
    nodes = [Node("", "base", -1, np.eye(3), np.zeros(3))]
    for name, x in (("left", -0.3), ("right", 0.3)):
        nodes.append(Node(name, name, 0, np.eye(3), np.array([x, 0.0, 0.0]), JointKind.REVOLUTE, axis, name))
    modes = geometry_modes(Tree(tuple(nodes), ("left", "right")), np.ones(6), True)
    assert not modes[1].any(), "the place of the base stands for that of the first arm"
    assert np.linalg.matrix_rank(modes[2]) == 4
