"""An arm: links and joints of a tree, in m, rad and kg; its base link is link 0."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from tests.blind.generator.arms.transforms import Array, Z, about, motion

STANDARD_GRAVITY = 9.80665


@dataclass(frozen=True)
class Joint:
    """Joint between two links: its place (4, 4) in the parent's frame, its unit axis in its own frame.

    ``source`` is the index of the actuated joint that it follows (its own, -1 if fixed or moved by loops), by
    ``factor`` and ``shift``.
    """

    name: str
    parent: int
    child: int
    origin: Array
    axis: Array = field(default_factory=lambda: Z.copy())
    kind: str = "revolute"
    source: int = -1
    factor: float = 1.0
    shift: float = 0.0
    limits: tuple[float, float] = (-np.pi, np.pi)


@dataclass(frozen=True)
class Link:
    """Link with its mass, kg, and centre of mass (3,), m, in its own frame."""

    name: str
    mass: float = 0.0
    com: Array = field(default_factory=lambda: np.zeros(3))


class Loops(Protocol):
    """Loops of links: the joints that they move, and the fixed joints whose places are lengths within them."""

    @property
    def closure(self) -> str:
        """Name of the class of loops that campaigns give."""

    @property
    def passive(self) -> tuple[int, ...]:
        """Indices of joints that the loops move."""

    @property
    def lengths(self) -> tuple[int, ...]:
        """Indices of fixed joints that may be shifted."""

    def values(self, arm: Arm, turned: Array, moved: Array, growth: Array) -> Array:
        """Values (N, S), m or rad, of the passive joints, of links (N, L) that are placed already."""

    def pulls(self, arm: Arm, moved: Array, weight: float) -> tuple[Array, Array]:
        """Links (F,) on which the loops pull under a weight, N, of what they carry, and the pulls (N, F, 3), N."""


@dataclass(frozen=True)
class Arm:
    """Joints stand in an order in which parents come first; ``actuated`` are the indices of joints with a column."""

    links: tuple[Link, ...]
    joints: tuple[Joint, ...]
    tips: tuple[int, ...]
    gravity: Array = field(default_factory=lambda: -Z)
    payload: float = 0.0
    payload_com: Array = field(default_factory=lambda: np.zeros(3))
    loops: Loops | None = None

    @property
    def passive(self) -> tuple[int, ...]:
        """Indices of joints that loops move."""
        return () if self.loops is None else self.loops.passive

    @property
    def actuated(self) -> list[int]:
        """Indices of joints that have a column of their own."""
        return [n for n, joint in enumerate(self.joints) if joint.source >= 0 and not self.mimics(n)]

    def mimics(self, number: int) -> bool:
        """Return True if a joint follows another one."""
        mine = self.joints[number].source
        return mine >= 0 and any(joint.source == mine for joint in self.joints[:number])

    def names(self) -> list[str]:
        """Names of the actuated joints in the order of their columns."""
        return [self.joints[n].name for n in self.actuated]

    def link(self, name: str) -> int:
        """Index of a link."""
        return [link.name for link in self.links].index(name)

    def outboard(self, number: int) -> list[int]:
        """Indices of all links that a joint carries."""
        carried = [self.joints[number].child]
        for joint in self.joints[number + 1 :]:
            if joint.parent in carried:
                carried.append(joint.child)
        return carried

    def children(self, link: int) -> list[int]:
        """Indices of joints that stand on a link."""
        return [n for n, joint in enumerate(self.joints) if joint.parent == link]


@dataclass(frozen=True)
class Row:
    """One row of Denavit and Hartenberg, standard convention, with the travel of its joint; m and rad."""

    a: float
    alpha: float
    d: float
    theta: float = 0.0
    kind: str = "revolute"
    limits: tuple[float, float] = (-np.pi, np.pi)


def after_joint(row: Row) -> Array:
    """Constant part (4, 4) of a standard row, outboard of the joint."""
    return (
        motion(about(Z, row.theta), np.array([0.0, 0.0, row.d]))
        @ motion(np.eye(3), np.array([row.a, 0.0, 0.0]))
        @ motion(about(np.eye(3)[0], row.alpha), np.zeros(3))
    )


def around_joint(row: Row) -> tuple[Array, Array]:
    """Constant parts (4, 4) of a modified row: alpha and a inboard of the joint, theta and d outboard."""
    inboard = motion(about(np.eye(3)[0], row.alpha), np.array([row.a, 0.0, 0.0]))
    return inboard, motion(about(Z, row.theta), np.array([0.0, 0.0, row.d]))


def modified(rows: tuple[Row, ...]) -> tuple[Row, ...]:
    """Rows of the modified convention of an arm whose last standard row has neither ``a`` nor ``alpha``."""
    if rows[-1].a or rows[-1].alpha:
        raise ValueError("the last standard row must have a = alpha = 0 to be written as a modified one")
    before = (Row(0.0, 0.0, 0.0), *rows[:-1])
    return tuple(Row(p.a, p.alpha, r.d, r.theta, r.kind, r.limits) for p, r in zip(before, rows, strict=True))


def serial(rows: tuple[Row, ...], convention: str = "standard", prefix: str = "joint") -> Arm:
    """Arm of rows: link ``link1`` lies between the first and the second joint; the last row ends at ``tool0``."""
    count = len(rows)
    if convention == "standard":
        places = [np.eye(4), *(after_joint(row) for row in rows)]
    else:
        inboard, outboard = zip(*map(around_joint, rows), strict=True)
        places = [inboard[0], *(d @ a for d, a in zip(outboard, inboard[1:], strict=False)), outboard[-1]]
    links = tuple(Link(name) for name in ("base_link", *(f"link{n + 1}" for n in range(count)), "tool0"))
    joints = [
        Joint(f"{prefix}{n + 1}", n, n + 1, places[n], kind=row.kind, source=n, limits=row.limits)
        for n, row in enumerate(rows)
    ]
    joints.append(Joint("flange", count, count + 1, places[count], kind="fixed"))
    return Arm(links, tuple(joints), (count + 1,))
