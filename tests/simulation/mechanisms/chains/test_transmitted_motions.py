"""A motion that passes through a joint may belong to either link, and link frames may lie anywhere on an axis."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.sentences import assert_says
from tests.simulation.mechanisms.chains.made_arms import campaign
from tests.simulation.mechanisms.chains.test_tree import UR10
from tests.tolerance import assert_close
from truing.report.wordings.catalogue import clause
from truing.report.wordings.claim import Claim
from truing.simulation.mechanisms.chains.causes import ChainScene, JointOffset
from truing.simulation.mechanisms.chains.conditions import ChainInputs
from truing.simulation.mechanisms.chains.link_causes import LinkGrowth
from truing.simulation.mechanisms.chains.notations import Screw, tree_of_rows, tree_of_screws
from truing.simulation.mechanisms.chains.transmitted_motions import nodes_moved_alike
from truing.simulation.mechanisms.chains.tree import JointKind, Tree, axis_twist

Z, X = np.eye(3)[2], np.eye(3)[0]
SLIDE, TURN = JointKind.PRISMATIC, JointKind.REVOLUTE


def tip_motion(tree: Tree, q: NDArray, node: int, twist: NDArray) -> NDArray:
    """Derivatives (B * 6) of the tip's place and orientation by a motion of a node."""
    frames, tip = tree.frames(q), np.array([tree.size - 1])
    places = tree.point_slopes(frames, tip, frames.t[:, tip])[:, 0, :, node] @ twist
    return np.concatenate([places, tree.rotation_slopes(frames, tip)[:, 0, :, node] @ twist]).ravel()


def reproduced(tree: Tree, q: NDArray, node: int, motion: NDArray) -> float:
    """Share of a motion of the tip that no constant motion of a node reproduces."""
    basis = np.stack([tip_motion(tree, q, node, unit) for unit in np.eye(6)], 1)
    rest = motion - basis @ np.linalg.lstsq(basis, motion, rcond=None)[0]
    return float(np.linalg.norm(rest) / np.linalg.norm(motion))


@pytest.mark.parametrize(
    ("node", "twist", "expected"),
    [
        (6, (0.0, 1.0, 0.0, 0.0, 0.0, 0.0), [5, 6]),  # link 5 ends along the axis of joint 5
        (3, (0.0, 0.0, 1.0, 0.0, 0.0, 0.0), [2, 3, 4, 5]),  # along three parallel axes
        (3, (1.0, 0.0, 0.0, 0.0, 0.0, 0.0), [3]),
        (4, (0.0, 0.0, 0.0, 0.0, 0.0, 1.0), [4, 5]),  # the turn about axis 4, as seen from link 4
    ],
)
def test_motions_pass_exactly_through_the_joints_that_leave_them(
    node: int, twist: tuple[float, ...], expected: list[int]
) -> None:
    tree = tree_of_rows(UR10, ("j1", "j2", "j3", "j4", "j5", "j6"))
    q = np.random.default_rng(4).uniform(-3.0, 3.0, (12, 6))
    motion = tip_motion(tree, q, node, np.array(twist))
    alike = nodes_moved_alike(tree, node, np.array(twist), {tree.size - 1})
    assert [k for k, _ in alike] == expected
    for k, own in alike:
        assert_close(tip_motion(tree, q, k, own), motion, atol=1e-12)
    others = [reproduced(tree, q, k, motion) for k in range(1, tree.size) if k not in expected]
    assert min(others) > 0.1


def test_a_measured_link_and_a_second_joint_hold_a_motion_back() -> None:
    tree = tree_of_rows(UR10, ("j1", "j2", "j3", "j4", "j5", "j6"))
    along = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
    assert [k for k, _ in nodes_moved_alike(tree, 3, along, {7, 3})] == [2, 3]
    branched = Tree((*tree.nodes, replace(tree.nodes[-1], link="second", parent=3)), tree.readings)
    assert [k for k, _ in nodes_moved_alike(branched, 3, along, {7})] == [2, 3]


def screwed(shift: float) -> ChainInputs:
    """An arm of which the point of joint 4 lies elsewhere on its axis, which changes the description alone."""
    points = [(0.0, 0.0, 0.0), (0.2, 0.0, 0.5), (0.2, 0.0, 1.4), (0.2 + shift, 0.0, 1.5), (1.0, 0.0, 1.5)]
    axes = [Z, np.array([0.0, 1.0, 0.0]), np.array([0.0, 1.0, 0.0]), X, np.array([0.0, 1.0, 0.0])]
    screws = [Screw(axis, np.array(point)) for axis, point in zip(axes, points, strict=True)]
    tree = tree_of_screws(screws, (np.eye(3), np.array([1.2, 0.0, 1.6])), ("j1", "j2", "j3", "j4", "j5"))
    return replace(campaign(np.random.default_rng(2), 30).machine, tree=tree)


def effects_along(machine: ChainInputs, joint: str) -> list[tuple[NDArray, frozenset[str]]]:
    """Unit effects on the tip of candidate growths along a joint's axis, with the links to which the length belongs."""
    found, scene, tree = [], ChainScene(machine), machine.tree
    frames, tip = tree.frames(machine.readings), np.array([tree.size - 1])
    slopes = tree.point_slopes(frames, tip, frames.t[:, tip])[:, 0]
    for cause in LinkGrowth().candidates(scene):
        shared = cause.shared_with(scene)
        if shared.get("between") == [f"joint {joint}"]:
            effect = np.einsum("binc,bncp->bi", slopes, cause.twists(machine)).ravel()
            found.append((effect / np.linalg.norm(effect), frozenset([cause.subject, *shared["alike"]])))
    return found


def test_growth_along_an_axis_is_one_effect_of_two_links_wherever_the_description_ends_them() -> None:
    one, other = effects_along(screwed(0.0), "j4"), effects_along(screwed(0.5), "j4")
    assert len(one) == len(other) == 1
    assert one[0][1] == other[0][1] == {"link link3", "link link4"}
    assert_close(np.abs(one[0][0] @ other[0][0]), 1.0, atol=1e-12)
    words = clause(Claim(cause="link-growth", subject="link link4", settings=settings_of(screwed(0.0), "link4")))
    assert_says(words, "link4", "link3", "grows")
    assert_says(words, "length", "axis of joint j4", "either", "link4")
    assert " or " not in clause(
        Claim(cause="link-growth", subject="link link2", settings=settings_of(screwed(0.0), "link2"))
    )


def settings_of(machine: ChainInputs, link: str) -> dict[str, object]:
    cause = LinkGrowth(link=link)
    return {**cause.settings(), **cause.shared_with(ChainScene(machine))}


def test_zeros_of_parallel_slides_are_one_motion_unless_a_turn_lies_between() -> None:
    machine = campaign(np.random.default_rng(2), 30).machine
    kinds, axes = [SLIDE, TURN, SLIDE, TURN, SLIDE], [Z, Z, Z, X, Z]
    screws = [
        Screw(axis, np.array([0.1 * k, 0.0, 0.2]), kind) for k, (axis, kind) in enumerate(zip(axes, kinds, strict=True))
    ]
    tree = tree_of_screws(screws, (np.eye(3), np.ones(3)), ("j1", "j2", "j3", "j4", "j5"))
    scene = ChainScene(replace(machine, tree=tree))
    shared = {name: JointOffset(name, tree.is_revolute[k]).shared_with(scene) for k, name in enumerate(tree.readings)}
    assert shared["j1"] == {"alike": ["joint j3"]}
    assert shared["j3"] == {"alike": ["joint j1"]}
    assert shared["j2"] == shared["j4"] == shared["j5"] == {}
    parallel = ChainScene(replace(machine, tree=tree_of_rows(UR10[:5], tree.readings)))  # three turns, apart
    assert not any(JointOffset(name).shared_with(parallel) for name in tree.readings)
    q = np.random.default_rng(3).uniform(-1.0, 1.0, (9, 5))
    first, third, fifth = (tip_motion(tree, q, k, axis_twist(tree.nodes[k])) for k in (1, 3, 5))
    assert_close(first, third, atol=1e-12)
    assert np.linalg.norm(fifth - first) > 0.1
