"""Fourteen layouts of arms, their lengths drawn: serial ones as rows, the others as trees of joints."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from tests.blind.generator.arms.arm import Arm, Joint, Link, Row, serial
from tests.blind.generator.arms.delta import DeltaLoops
from tests.blind.generator.arms.transforms import Array, X, Y, Z, about, motion

HALF = np.pi / 2.0
Rows = tuple[Row, ...]


def _turn(degrees: float) -> tuple[float, float]:
    return -float(np.radians(degrees)), float(np.radians(degrees))


def industrial_6r(rng: np.random.Generator) -> Rows:
    """Six joints with a spherical wrist."""
    shoulder, upper, elbow = rng.uniform(0.1, 0.35), rng.uniform(0.5, 1.1), rng.uniform(0.03, 0.2)
    return (
        Row(shoulder, -HALF, rng.uniform(0.3, 0.7), limits=_turn(160)),
        Row(upper, 0.0, 0.0, -HALF, limits=_turn(70)),
        Row(elbow, -HALF, 0.0, limits=_turn(70)),
        Row(0.0, HALF, rng.uniform(0.5, 1.2), limits=_turn(170)),
        Row(0.0, -HALF, 0.0, limits=_turn(110)),
        Row(0.0, 0.0, rng.uniform(0.08, 0.2), limits=_turn(175)),
    )


def offset_wrist_6r(rng: np.random.Generator) -> Rows:
    """Six joints, the second to the fourth parallel, the wrist offset."""
    size = rng.uniform(0.7, 1.5)
    return (
        Row(0.0, HALF, 0.09 * size, limits=_turn(175)),
        Row(-0.425 * size, 0.0, 0.0, -HALF, limits=_turn(80)),
        Row(-0.392 * size, 0.0, 0.0, limits=_turn(130)),
        Row(0.0, HALF, 0.11 * size, -HALF, limits=_turn(150)),
        Row(0.0, -HALF, 0.095 * size, limits=_turn(150)),
        Row(0.0, 0.0, 0.082 * size, limits=_turn(175)),
    )


def redundant_7r(rng: np.random.Generator) -> Rows:
    """Seven joints, alternately along and across the arm."""
    lengths = (rng.uniform(0.3, 0.4), 0.0, rng.uniform(0.35, 0.45), 0.0, rng.uniform(0.35, 0.45), 0.0, 0.13)
    angles = (-HALF, HALF, HALF, -HALF, -HALF, HALF, 0.0)
    return tuple(
        Row(0.0, a, float(d), limits=_turn(100 if n % 2 else 160))
        for n, (a, d) in enumerate(zip(angles, lengths, strict=True))
    )


def scara(rng: np.random.Generator) -> Rows:
    """Two parallel vertical joints, a vertical slide, a last turn."""
    return (
        Row(rng.uniform(0.2, 0.45), 0.0, rng.uniform(0.2, 0.4), limits=_turn(130)),
        Row(rng.uniform(0.2, 0.35), np.pi, 0.0, limits=_turn(140)),
        Row(0.0, 0.0, 0.05, kind="prismatic", limits=(0.0, 0.2)),
        Row(0.0, 0.0, rng.uniform(0.02, 0.08), limits=_turn(175)),
    )


def palletiser_4r(rng: np.random.Generator) -> Rows:
    """A vertical joint, two horizontal parallel ones, a last joint across the forearm."""
    return (
        Row(rng.uniform(0.1, 0.35), -HALF, rng.uniform(0.5, 0.9), limits=_turn(160)),
        Row(rng.uniform(0.7, 1.2), 0.0, 0.0, -HALF, limits=_turn(60)),
        Row(rng.uniform(0.7, 1.2), -HALF, 0.0, HALF, limits=_turn(60)),
        Row(0.0, 0.0, rng.uniform(0.1, 0.25), limits=_turn(175)),
    )


def bench_5r(rng: np.random.Generator) -> Rows:
    """A small bench arm: waist, shoulder, elbow, wrist pitch, roll."""
    return (
        Row(rng.uniform(0.0, 0.05), HALF, rng.uniform(0.2, 0.4), limits=_turn(150)),
        Row(rng.uniform(0.2, 0.3), 0.0, 0.0, HALF, limits=_turn(70)),
        Row(rng.uniform(0.2, 0.3), 0.0, 0.0, limits=_turn(120)),
        Row(0.0, HALF, 0.0, HALF, limits=_turn(110)),
        Row(0.0, 0.0, rng.uniform(0.1, 0.2), limits=_turn(175)),
    )


def cylindrical(rng: np.random.Generator) -> Rows:
    """A turn about the vertical, a vertical slide, a radial slide."""
    return (
        Row(0.0, 0.0, rng.uniform(0.2, 0.5), limits=_turn(160)),
        Row(rng.uniform(0.0, 0.1), -HALF, rng.uniform(0.2, 0.4), kind="prismatic", limits=(0.0, 0.8)),
        Row(0.0, 0.0, rng.uniform(0.2, 0.4), kind="prismatic", limits=(0.0, 0.6)),
    )


def planar_wrist(rng: np.random.Generator) -> Rows:
    """Two parallel joints, and a wrist across them."""
    return (
        Row(rng.uniform(0.3, 0.6), 0.0, rng.uniform(0.1, 0.3), limits=_turn(120)),
        Row(rng.uniform(0.25, 0.5), HALF, 0.05, limits=_turn(140)),
        Row(0.0, 0.0, rng.uniform(0.08, 0.2), limits=_turn(175)),
    )


def anthropomorphic_4r(rng: np.random.Generator) -> Rows:
    """Waist, shoulder, elbow, and the roll of the forearm."""
    return (
        Row(0.0, HALF, rng.uniform(0.3, 0.6), limits=_turn(160)),
        Row(rng.uniform(0.3, 0.6), 0.0, rng.uniform(-0.1, 0.1), HALF, limits=_turn(80)),
        Row(rng.uniform(0.02, 0.06), HALF, 0.0, HALF, limits=_turn(120)),
        Row(0.0, 0.0, rng.uniform(0.3, 0.6), limits=_turn(170)),
    )


class Tree:
    """Collects links and joints; a joint is placed by the point (3,) and rotation (3, 3) in its parent's frame."""

    def __init__(self) -> None:
        self.links = [Link("base_link")]
        self.joints: list[Joint] = []
        self.count = 0

    def add(
        self,
        name: str,
        parent: str,
        child: str,
        point: tuple[float, float, float],
        axis: Array | None = None,
        limits: tuple[float, float] | None = None,
        kind: str = "revolute",
        follows: int | None = None,
        turned: Array | None = None,
    ) -> None:
        """Add a joint and its child link; without an axis it is fixed."""
        above = [link.name for link in self.links].index(parent)
        origin = motion(np.eye(3) if turned is None else turned, np.array(point, float))
        self.links.append(Link(child))
        if axis is None:
            self.joints.append(Joint(name, above, len(self.links) - 1, origin, kind="fixed"))
            return
        source = self.count if follows is None else follows
        self.count += follows is None
        travel = limits or (-np.pi, np.pi)
        self.joints.append(Joint(name, above, len(self.links) - 1, origin, axis, kind, source, limits=travel))

    def arm(self, *tips: str) -> Arm:
        """The arm with its tips."""
        names = [link.name for link in self.links]
        return Arm(tuple(self.links), tuple(self.joints), tuple(names.index(tip) for tip in tips))


def gantry(rng: np.random.Generator) -> Arm:
    """Three slides and a turn about the vertical."""
    tree, rise = Tree(), float(rng.uniform(0.8, 1.4))
    tree.add("x_axis", "base_link", "bridge", (0.0, 0.0, rise), X, (0.0, 1.5), "prismatic")
    tree.add("y_axis", "bridge", "carriage", (0.1, 0.0, 0.15), Y, (0.0, 1.0), "prismatic")
    tree.add("z_axis", "carriage", "quill", (0.12, 0.0, -0.1), -Z, (0.0, 0.6), "prismatic")
    tree.add("c_axis", "quill", "spindle", (0.0, 0.0, -0.3), -Z, _turn(170))
    tree.add("flange", "spindle", "tool0", (0.08, 0.0, -0.12), turned=about(X, np.pi))
    return tree.arm("tool0")


def on_rail(rng: np.random.Generator) -> Arm:
    """Six joints with a spherical wrist on a linear rail."""
    robot = serial(industrial_6r(rng), prefix="axis")
    tree = Tree()
    tree.add("rail", "base_link", "carriage", (0.0, 0.0, 0.2), Y, (-1.5, 1.5), "prismatic")
    tree.add("bolts", "carriage", "robot_base", (0.05, 0.0, 0.1), turned=about(Z, float(rng.uniform(-0.5, 0.5))))
    links = [*tree.links, *robot.links[1:]]
    moved = [
        replace(
            joint, parent=joint.parent + 2, child=joint.child + 2, source=joint.source + 1 if joint.source >= 0 else -1
        )
        for joint in robot.joints
    ]
    return Arm(tuple(links), (*tree.joints, *moved), (len(links) - 1,))


def two_tips(rng: np.random.Generator) -> Arm:
    """A turning trunk with two arms of three joints each."""
    tree, upper, lower = Tree(), float(rng.uniform(0.3, 0.45)), float(rng.uniform(0.25, 0.4))
    tree.add("trunk_joint", "base_link", "trunk", (0.0, 0.0, 0.4), Z, _turn(120))
    for side, way in (("left", 1.0), ("right", -1.0)):
        tree.add(f"{side}_shoulder", "trunk", f"{side}_clavicle", (0.05, way * 0.2, 0.5), way * Y, _turn(100))
        tree.add(f"{side}_abduction", f"{side}_clavicle", f"{side}_upper_arm", (0.0, way * 0.08, 0.0), X, _turn(70))
        tree.add(f"{side}_elbow", f"{side}_upper_arm", f"{side}_forearm", (0.0, 0.0, -upper), Y, _turn(110))
        tree.add(f"{side}_hand", f"{side}_forearm", f"{side}_tip", (0.02, 0.0, -lower))
    return tree.arm("left_tip", "right_tip")


def column_lift(rng: np.random.Generator) -> Arm:
    """A column of two stages, the second of which follows the first, and three joints on top."""
    tree = Tree()
    tree.add("lift", "base_link", "stage_1", (0.0, 0.0, 0.3), Z, (0.0, 0.4), "prismatic")
    tree.add("lift_inner", "stage_1", "stage_2", (0.0, 0.0, 0.2), Z, (0.0, 0.4), "prismatic", follows=0)
    tree.add("waist", "stage_2", "turret", (0.0, 0.0, 0.1), Z, _turn(160))
    tree.add("shoulder", "turret", "upper_arm", (0.1, 0.0, 0.15), Y, _turn(80))
    tree.add("elbow", "upper_arm", "forearm", (float(rng.uniform(0.3, 0.6)), 0.0, 0.0), Y, _turn(120))
    tree.add("flange", "forearm", "tool0", (float(rng.uniform(0.25, 0.5)), 0.05, 0.0), turned=about(Y, HALF))
    return tree.arm("tool0")


def delta(rng: np.random.Generator) -> Arm:
    """Three arms, each with two parallel rods to a platform that stays level; it slides along x, y and z.

    Half of the mass of the rods is at the elbow and half on the platform, which is exact for even rods.
    """
    tree, size = Tree(), float(rng.uniform(0.7, 1.4))
    base, upper, rod, wide = size * rng.uniform([0.18, 0.22, 0.5, 0.05], [0.22, 0.28, 0.6, 0.07])
    low = -float(np.sqrt(rod**2 - (base + upper - wide) ** 2))
    ways = [about(Z, k * 2.0 * np.pi / 3.0) for k in range(3)]
    for k, way in enumerate(ways, 1):
        place = tuple(way @ np.array([base, 0.0, 0.0]))
        tree.add(f"arm_{k}", "base_link", f"upper_arm_{k}", place, Y, (-0.5, 0.9), turned=way)
        tree.add(f"elbow_{k}", f"upper_arm_{k}", f"forearm_{k}", (upper, 0.0, 0.0))
        tree.add(f"length_{k}", f"forearm_{k}", f"forearm_end_{k}", (0.0, 0.0, -rod))
    tree.add("platform_x", "base_link", "slide_x", (0.0, 0.0, low), X, (-1.0, 1.0), "prismatic", follows=-1)
    tree.add("platform_y", "slide_x", "slide_y", (0.0, 0.0, 0.0), Y, (-1.0, 1.0), "prismatic", follows=-1)
    tree.add("platform_z", "slide_y", "platform", (0.0, 0.0, 0.0), Z, (-1.0, 1.0), "prismatic", follows=-1)
    for k, way in enumerate(ways, 1):
        tree.add(f"seat_{k}", "platform", f"ball_{k}", tuple(way @ np.array([wide, 0.0, 0.0])))
    arm, rods = tree.arm("platform"), float(rng.uniform(0.3, 0.8))
    mass = {"platform": float(rng.uniform(1.0, 2.0)) + 1.5 * rods}
    for k in range(1, 4):
        mass |= {f"upper_arm_{k}": float(rng.uniform(1.0, 4.0)), f"forearm_{k}": rods / 2.0}
    middle = np.array([upper / 2.0, 0.0, 0.0])
    links = [
        Link(link.name, round(mass.get(link.name, 0.0), 3), middle * link.name.startswith("upper_arm"))
        for link in arm.links
    ]
    return replace(arm, links=tuple(links), loops=DeltaLoops.of(arm))


ROWS: dict[str, Callable[[np.random.Generator], Rows]] = {
    "industrial-6r": industrial_6r,
    "offset-wrist-6r": offset_wrist_6r,
    "redundant-7r": redundant_7r,
    "scara": scara,
    "palletiser-4r": palletiser_4r,
    "bench-5r": bench_5r,
    "cylindrical": cylindrical,
    "planar-wrist": planar_wrist,
    "anthropomorphic-4r": anthropomorphic_4r,
}
TREES: dict[str, Callable[[np.random.Generator], Arm]] = {
    "gantry": gantry,
    "rail-6r": on_rail,
    "two-tips": two_tips,
    "column-lift": column_lift,
    "delta": delta,
}
LAYOUTS = (*ROWS, *TREES)


def with_masses(arm: Arm, rng: np.random.Generator) -> Arm:
    """The arm with the mass of each link drawn from its length, its centre near the middle of it."""
    links = [arm.links[0]]
    for number, link in enumerate(arm.links[1:], start=1):
        ends = [arm.joints[n].origin[:3, 3] for n in arm.children(number)]
        middle = np.mean(ends, axis=0) / 2.0 if ends else np.zeros(3)
        mass = (1.0 + 15.0 * 2.0 * np.linalg.norm(middle)) * rng.uniform(0.5, 1.5) if ends else 0.2
        links.append(Link(link.name, round(float(mass), 3), np.round(middle + rng.normal(0.0, 0.01, 3), 5)))
    return replace(arm, links=tuple(links))


def with_other_frames(arm: Arm, rng: np.random.Generator) -> Arm:
    """The same arm, the frames of its inner links turned by quarters, so that axes are x, y or z of either sign."""
    turns = [np.eye(3)] * len(arm.links)
    for joint in arm.joints:
        if joint.source >= 0 and joint.child not in arm.tips:
            turns[joint.child] = about(np.eye(3)[rng.integers(3)], HALF * float(rng.integers(4)))
    joints = [
        replace(
            joint,
            origin=motion(turns[joint.parent].T, np.zeros(3)) @ joint.origin @ motion(turns[joint.child], np.zeros(3)),
            axis=np.round(turns[joint.child].T @ joint.axis, 12) + 0.0,
        )
        for joint in arm.joints
    ]
    links = [replace(link, com=turns[n].T @ link.com) for n, link in enumerate(arm.links)]
    return replace(arm, joints=tuple(joints), links=tuple(links))
