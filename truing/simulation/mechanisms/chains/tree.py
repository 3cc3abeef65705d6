"""Class `Tree`: joints and links of an open mechanism; kinematics with exact derivatives, and the load by gravity.

Every node is a joint with the link that it moves. A deviation of the machine is a twist (v, w) of a node: a shift v (m)
and a rotation vector w (rad) along the axes of the joint's frame, before the joint turns or slides. Any error of a link
or of a joint is a twist of this kind, so all derivatives follow from one matrix.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from truing.arrays import Array, Index, Mask
from truing.estimation.rotation import exp_so3, left_jacobian_so3, skew

TWIST = 6
STANDARD_GRAVITY = 9.80665  # m/s2


class JointKind(StrEnum):
    """Motion of a joint."""

    FIXED = "fixed"
    REVOLUTE = "revolute"
    PRISMATIC = "prismatic"


@dataclass(frozen=True)
class Node:
    """A joint and the link that it moves, at a transform R (3, 3), t (3,) m from its parent's link.

    ``axis`` is a unit vector in the joint's frame; the joint moves by ``factor`` times its reading plus ``shift`` (rad
    or m). ``reading`` names the joint whose reading it follows; empty for a fixed joint. ``mass`` (kg) and ``com`` (3,)
    m are those of the link, in its frame.
    """

    joint: str
    link: str
    parent: int
    R: NDArray
    t: NDArray
    kind: JointKind = JointKind.FIXED
    axis: NDArray = None  # type: ignore[assignment]
    reading: str = ""
    factor: float = 1.0
    shift: float = 0.0
    mass: float = 0.0
    com: NDArray = None  # type: ignore[assignment]

    def __post_init__(self) -> None:
        object.__setattr__(self, "axis", np.array([0.0, 0.0, 1.0]) if self.axis is None else np.asarray(self.axis))
        object.__setattr__(self, "com", np.zeros(3) if self.com is None else np.asarray(self.com))


@dataclass(frozen=True)
class TreeFrames:
    """Frames of N nodes at B poses, in the frame of the base's parent, m.

    ``R_before``, ``origin``: the joint's frame, deviations included, before the joint moves; ``R``, ``t``: the link.
    ``rotations`` (B or 1, N, 3), rad, are the rotation vectors of the twists; None without twists.
    """

    R_before: NDArray
    origin: NDArray
    R: NDArray
    t: NDArray
    rotations: NDArray | None

    @cached_property
    def slope(self) -> NDArray:
        """Rotation (B, N, 3, 3) per unit of the twist's rotation vector; only derivatives need it."""
        return self.R_before if self.rotations is None else self.R_before @ left_jacobian_so3(self.rotations)


@dataclass(frozen=True)
class Tree:
    """Nodes, each after its parent; the first is the base. ``readings`` are the joints that are read, in order."""

    nodes: tuple[Node, ...]
    readings: tuple[str, ...]

    def __post_init__(self) -> None:
        if any(node.parent >= k for k, node in enumerate(self.nodes)):
            raise ValueError("nodes: found a node before its parent, expected parents first")

    @property
    def size(self) -> int:
        """Number of nodes N."""
        return len(self.nodes)

    @cached_property
    def links(self) -> dict[str, int]:
        """Number of each link's node, by name."""
        return {node.link: k for k, node in enumerate(self.nodes)}

    @cached_property
    def input_of(self) -> Index:
        """Number (N,) of the reading that moves each node; -1 for a fixed joint."""
        index_of = {name: k for k, name in enumerate(self.readings)}
        return np.array([index_of.get(node.reading, -1) for node in self.nodes], int)

    @cached_property
    def is_revolute(self) -> Mask:
        """Mask (n,) of the readings that are angles."""
        return np.array(
            [self.nodes[self.node_of(k)].kind is JointKind.REVOLUTE for k in range(len(self.readings))], bool
        )

    def node_of(self, reading: int) -> int:
        """Return the node of the joint that is read; others may follow it."""
        name = self.readings[reading]
        return next(k for k, node in enumerate(self.nodes) if node.joint == name)

    @cached_property
    def axis_twists(self) -> Array:
        """Twist (n, N, 6) of all nodes per unit of each reading: along or about their axes."""
        result = np.zeros((len(self.readings), self.size, TWIST))
        for k, node in enumerate(self.nodes):
            if (reading := self.input_of[k]) >= 0:
                result[reading, k] = node.factor * axis_twist(node)
        return result

    @cached_property
    def above(self) -> Mask:
        """Mask (N, N): whether node j carries node k or is it, [k, j]."""
        result = np.eye(self.size, dtype=bool)
        for k, node in enumerate(self.nodes):
            if node.parent >= 0:
                result[k] |= result[node.parent]
        return result

    def moving_node(self, node: int) -> int:
        """Return this node, or the nearest below that moves; 0 for links of the base."""
        while self.nodes[node].kind is JointKind.FIXED and self.nodes[node].parent >= 0:
            node = self.nodes[node].parent
        return node

    def moving_parent(self, node: int) -> int:
        """Return the nearest node below that moves; -1 if none does."""
        k = self.nodes[node].parent
        while k >= 0 and self.nodes[k].kind is JointKind.FIXED:
            k = self.nodes[k].parent
        return k

    def relative(self, below: int, node: int) -> tuple[Array, Array]:
        """Return R, t of a node's joint frame in the link of a node below; fixed joints lie between."""
        R, t = self.nodes[node].R, self.nodes[node].t
        k = self.nodes[node].parent
        while k != below:
            R, t = self.nodes[k].R @ R, self.nodes[k].R @ t + self.nodes[k].t
            k = self.nodes[k].parent
        return np.asarray(R), np.asarray(t)

    def frames(
        self, readings: NDArray, twists: NDArray | None = None, base: tuple[NDArray, NDArray] | None = None
    ) -> TreeFrames:
        """Return the frames at readings (B, n), rad or m, with twists (B, N, 6) or (1, N, 6).

        ``base``: R (B, 3, 3), t (B, 3) of the base before its twist; the identity if absent.
        """
        count = len(readings)
        R0, t0 = (np.eye(3)[None], np.zeros((1, 3))) if base is None else base
        before, origin = np.empty((count, self.size, 3, 3)), np.empty((count, self.size, 3))
        R, t = np.empty_like(before), np.empty_like(origin)
        turned = None if twists is None else exp_so3(twists[..., 3:])
        for k, node in enumerate(self.nodes):
            below_R, below_t = (R0, t0) if node.parent < 0 else (R[:, node.parent], t[:, node.parent])
            at, after = below_t + below_R @ node.t, below_R @ node.R
            before[:, k] = after
            if twists is not None and turned is not None:
                at = at + _times(after, twists[:, k, :3])
                after = after @ turned[:, k]
            moved = 0.0 if self.input_of[k] < 0 else node.factor * readings[:, self.input_of[k]] + node.shift
            origin[:, k] = t[:, k] = at
            R[:, k] = after @ _about(*self._turns[k], moved) if node.kind is JointKind.REVOLUTE else after
            if node.kind is JointKind.PRISMATIC:
                t[:, k] += np.multiply.outer(moved, np.ones(3)) * (after @ node.axis)
        return TreeFrames(before, origin, R, t, None if twists is None else twists[..., 3:])

    @cached_property
    def _turns(self) -> tuple[tuple[Array, Array], ...]:
        """Cross-product matrix (3, 3) of each node's axis, and its square."""
        across = [skew(node.axis) for node in self.nodes]
        return tuple((one, one @ one) for one in across)

    def reading_slopes(self, frames: TreeFrames, nodes: Index, points: NDArray) -> NDArray:
        """Return the derivatives (B, K, 6, n) of places and rotations (p, theta) of the links of nodes (K,) by all
        readings, m and rad; points (B, K, 3) of the links."""
        result = np.zeros((len(self.readings), *points.shape[:2], TWIST))
        for j, node in enumerate(self.nodes):
            if (reading := self.input_of[j]) < 0:
                continue
            axis = self.above[nodes, j][:, None] * node.factor * (frames.R[:, j] @ node.axis)[:, None]
            if node.kind is JointKind.PRISMATIC:
                result[reading, ..., :3] += axis
            else:
                result[reading, ..., :3] += _crossed(axis, points - frames.origin[:, j, None])
                result[reading, ..., 3:] += axis
        return np.moveaxis(result, 0, -1)

    def point_slopes(self, frames: TreeFrames, nodes: Index, points: NDArray) -> NDArray:
        """Return the derivatives (B, K, 3, N, 6) of points (B, K, 3) on the links of nodes (K,) by all twists."""
        arms = points[:, :, None] - frames.origin[:, None]  # (B, K, N, 3)
        result = np.zeros((*points.shape, self.size, TWIST))
        carried = self.above[nodes]
        result[..., :3] = np.moveaxis(np.where(carried[..., None, None], frames.R_before[:, None], 0.0), 3, 2)
        turned = _crossed(np.swapaxes(frames.slope, -1, -2)[:, None], arms[..., None, :])  # (B, K, N, c, 3)
        result[..., 3:] = np.moveaxis(np.where(carried[..., None, None], turned, 0.0), 4, 2)
        return result

    def rotation_slopes(self, frames: TreeFrames, nodes: Index) -> NDArray:
        """Return the rotation vectors (B, K, 3, N, 6) of the links of nodes (K,) per unit of all twists."""
        result = np.zeros((len(frames.R), len(nodes), 3, self.size, TWIST))
        carried = self.above[nodes][..., None, None]
        result[..., 3:] = np.moveaxis(np.where(carried, frames.slope[:, None], 0.0), 3, 2)
        return result

    def weights(self, payload: dict[int, tuple[NDArray, NDArray]]) -> list[tuple[int, NDArray, NDArray]]:
        """Return node, mass () or (B,) in kg and centre of mass (3,) in the link's frame, m, of all that has weight."""
        masses = [(k, np.asarray(node.mass), node.com) for k, node in enumerate(self.nodes) if node.mass > 0.0]
        return masses + [(k, *load) for k, load in payload.items()]

    def gravity_load(
        self, readings: NDArray, gravity: NDArray, payload: dict[int, tuple[NDArray, NDArray]]
    ) -> tuple[Array, Array]:
        """Return force (B, N, 3), N, and moment (B, N, 3), N m, of the weight that each node carries.

        They act at the joint's origin, along the axes of the joint's frame. ``gravity`` is the direction of gravity in
        the base's frame; ``payload`` by node as in `weights`.
        """
        frames = self.frames(readings)
        down = STANDARD_GRAVITY * gravity / np.sqrt(np.sum(gravity**2))
        pulls, moments = np.zeros((2, len(readings), self.size, 3))
        for k, mass, com in self.weights(payload):
            pull = np.multiply.outer(mass, down)
            pulls[:, k] += pull
            moments[:, k] += _crossed(frames.t[:, k] + frames.R[:, k] @ com, pull)
        carried = self.above.T.astype(float)
        force = carried @ pulls
        moment = carried @ moments - _crossed(frames.origin, force)
        turn = np.swapaxes(frames.R_before, -1, -2)
        return _times(turn, force), _times(turn, moment)

    def with_twists(self, twists: NDArray) -> Tree:
        """Return the tree with constant twists (N, 6) taken into its transforms."""
        turned = exp_so3(twists[:, 3:])
        return replace(
            self,
            nodes=tuple(
                replace(node, R=node.R @ turned[k], t=node.t + node.R @ twists[k, :3])
                for k, node in enumerate(self.nodes)
            ),
        )


def axis_twist(node: Node) -> Array:
    """Return the twist (6,) of a unit motion of a joint."""
    first = 0 if node.kind is JointKind.PRISMATIC else 3
    result = np.zeros(TWIST)
    result[first : first + 3] = node.axis if node.kind is not JointKind.FIXED else 0.0
    return result


def geometry_modes(
    tree: Tree, sigma: NDArray, is_base_free: bool, known: Mask | None = None, placed: Collection[int] = ()
) -> Array:
    """Return twists (N, 6, Q) per prior sigma of all distinguishable errors of the links' geometry.

    ``sigma`` (6,) is that of the shifts, m, and of the rotations, rad. The parametrisation is complete and continuous,
    also for parallel axes: of the six numbers of each joint's frame it leaves out those that another number stands for,
    along whatever direction that is. These are the joint's own zero (its offset); motions that pass along the joint's
    axis into the next link, and the zero of the joint below. Where a link carries several joints, the first one leaves
    out that zero; the others may be turned against it. A joint that follows another has no offset: its zero is among
    its errors. Without ``is_base_free`` the base's place is known.

    ``placed``: nodes with targets of known place in their link. Motions along the axis of the joint that moves such a
    link are errors of their own, because no next link has them instead.

    ``known`` (6,) marks the entries of ``sigma`` that are tolerances. Of these only the joint's own zero is left out.
    What two numbers do alike then has the tolerances of both: a number left out would take its tolerance with it, and
    a zero within the tolerances be called off.
    """
    found: list[Array] = []
    carried: set[int] = set()
    is_base_left, free = is_base_free, np.ones(TWIST, bool) if known is None else ~known
    shown = {k if tree.nodes[k].kind is not JointKind.FIXED else tree.moving_parent(k) for k in placed}
    for j, node in enumerate(tree.nodes):
        below = tree.moving_parent(j)
        if node.kind is JointKind.FIXED or node.reading not in tree.readings:
            continue
        if below < 0 and is_base_left:  # the base's place stands for the frame of one joint on it, not of others
            is_base_left = False
            continue
        zero, passing = axis_twist(node), [twist for twist in _passing(node) if twist[free].any() and j not in shown]
        same = [zero, *passing] if node.reading == node.joint else [twist - (twist @ zero) * zero for twist in passing]
        if below >= 0 and below not in carried and free.all():
            same.append(_seen_from(tree, below, j))
            carried.add(below)
        wide = sigma > 0.0
        scaled = np.reshape(same, (-1, TWIST))[:, wide] / sigma[wide]
        complement = _complement(scaled)
        modes = np.zeros((tree.size, TWIST, complement.shape[1]))
        modes[j, wide] = sigma[wide, None] * complement
        found.append(modes)
    return np.concatenate(found, -1) if found else np.zeros((tree.size, TWIST, 0))


def _passing(node: Node) -> Sequence[NDArray]:
    """Return the twists (6,) that commute with the joint's motion, so that the next link can have them instead."""
    none = np.zeros(3)
    if node.kind is JointKind.REVOLUTE:
        return [np.r_[node.axis, none], np.r_[none, node.axis]]
    return [*(np.r_[unit, none] for unit in np.eye(3)), np.r_[none, node.axis]]


def _seen_from(tree: Tree, below: int, node: int) -> Array:
    """Return the twist (6,) of a node by a unit motion of the joint below it."""
    R, t = tree.relative(below, node)
    motion = axis_twist(tree.nodes[below])
    shift = motion[:3] + skew(motion[3:]) @ t
    return np.r_[R.T @ shift, R.T @ motion[3:]]


def _complement(rows: NDArray) -> Array:
    """Return an orthonormal basis (n, m) of the complement of rows (k, n)."""
    _, values, vectors = np.linalg.svd(rows)
    rank = int(np.sum(values > 1e-9 * max(values.max(initial=0.0), 1e-300)))
    return np.asarray(vectors[rank:].T)


def _times(matrices: NDArray, vectors: NDArray) -> Array:
    """Return the products (..., 3) of matrices (..., 3, 3) and vectors (..., 3)."""
    return np.asarray((matrices @ vectors[..., None])[..., 0])


def _crossed(first: NDArray, second: NDArray) -> Array:
    """Return cross products (..., 3); for small arrays several times faster than NumPy's, which moves axes."""
    a, b, c = first[..., 0], first[..., 1], first[..., 2]
    x, y, z = second[..., 0], second[..., 1], second[..., 2]
    along_x = b * z - c * y
    result = np.empty((*along_x.shape, 3))
    result[..., 0], result[..., 1], result[..., 2] = along_x, c * x - a * z, a * y - b * x
    return result


def _about(across: NDArray, squared: NDArray, angle: NDArray | float) -> Array:
    """Return the rotations (..., 3, 3) by angles (...), rad, about a unit axis. The cross-product matrix
    (3, 3) and its square are given (Rodrigues)."""
    sine, rest = np.sin(angle)[..., None, None], 2.0 * np.sin(0.5 * np.asarray(angle))[..., None, None] ** 2
    return np.asarray(np.eye(3) + sine * across + rest * squared)
