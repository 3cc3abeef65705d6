"""Class `ClosedTree`: a tree of joints some of which are not read, because loops of links determine them.

The closure of a lab's package defines closed loops as a function of the places of some links. All derivatives follow
from those of the tree, by the implicit function theorem.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from truing.arrays import Array, Index, Mask
from truing.schemas.installed import with_installed
from truing.simulation.mechanisms.chains.tree import STANDARD_GRAVITY, TWIST, JointKind, Tree, TreeFrames
from truing.simulation.mechanisms.legs.kinematics import bounded_steps

# A lab's package names its own closures under this group: `"my-loops" = "my_package.loops:MyLoops"`.
ENTRY_POINTS = "truing.loops"
_ROUNDS, _ROUNDS_OF_PART = 30, 3
_PARTS = 4  # of the way from zero readings
_MOST_KNOWN = 8  # sets of readings with known passive joints
_CLOSED = 1e-12  # largest last step, rad and m
_LONGEST = 0.3  # of a step, rad and m: farther the linearisation means little
_COMPLEX_STEP = 1e-30
# Poses about zero that show which errors of the closing links matter, and their readings, rad or m.
_TRIALS, _ABOUT_ZERO = 24, 0.2
_SEEN = 1e-6  # least derivative of the joints, relative to the largest, that counts


class LoopClosure:
    """Conditions that close the loops of a chain; a lab's class defines all four members.

    ``name``: value of `[mechanism] closure`. ``passive``: joints that are not read, as many as conditions.
    ``links``: links whose origins the conditions use.
    """

    name: str = ""
    passive: tuple[str, ...] = ()
    links: tuple[str, ...] = ()

    def gaps(self, at: Mapping[str, NDArray]) -> NDArray:
        """Return the conditions (..., G), zero if closed, for the origins (..., 3), m, of ``links`` in the base.

        Complex numbers must pass through: no `abs`, `np.linalg.norm` or `arctan2`.
        """
        raise NotImplementedError


def loop_closures() -> dict[str, LoopClosure]:
    """Return the closures of installed packages by name; raises ValueError if two have the same."""
    none: tuple[LoopClosure, ...] = ()
    return with_installed(none, ENTRY_POINTS, "closure of loops", lambda closure: closure.name)


def tree_with_loops(tree: Tree, closure: str) -> Tree:
    """Return the tree with the loops that a closure of this name closes; the tree itself for an empty name.

    Raises ValueError if no installed closure has the name, or the tree lacks its links or joints.
    """
    if not closure:
        return tree
    known = loop_closures()
    if closure not in known:
        raise ValueError(f"a closure of an installed package, of {', '.join(known) or 'which there is none'}")
    return ClosedTree(tree.nodes, tree.readings, known[closure])


@dataclass(frozen=True)
class ClosedTree(Tree):
    """A tree whose passive joints follow from the readings by a closure; zero is where they are searched from."""

    closure: LoopClosure

    def __post_init__(self) -> None:
        super().__post_init__()
        joints = {node.joint: node for node in self.nodes if node.kind is not JointKind.FIXED}
        for name in self.closure.passive:
            if name not in joints or name in self.readings:
                raise ValueError(f"a joint {name} that moves and is not read: closure {self.closure.name} needs it")
        for name in self.closure.links:
            if name not in self.links:
                raise ValueError(f"a link {name}: closure {self.closure.name} needs it")

    @cached_property
    def opened(self) -> Tree:
        """The tree with its passive joints as readings behind the measured ones."""
        return Tree(self.nodes, (*self.readings, *self.closure.passive))

    @cached_property
    def _closing(self) -> Index:
        return np.array([self.links[name] for name in self.closure.links], int)

    def frames(
        self, readings: NDArray, twists: NDArray | None = None, base: tuple[NDArray, NDArray] | None = None
    ) -> TreeFrames:
        """Return the frames with closed loops; where they do not close, those of the last step."""
        passive = self._nominal(readings)[0]
        if twists is not None:
            passive, _ = self._newton(readings, twists, passive, _ROUNDS)
        return self.opened.frames(np.concatenate([readings, passive], 1), twists, base)

    def closes(self, readings: NDArray) -> Mask:
        """Return the mask (B,) of the readings (B, n), rad or m, at which the loops of the nominal tree close."""
        return self._nominal(readings)[1]

    def _nominal(self, readings: NDArray) -> tuple[Array, Mask]:
        """Return the passive joints (B, S), rad or m, of the nominal tree, and the mask (B,) of closed poses.

        They are followed from zero readings on, so that all poses have the same assembly.
        """
        key = readings.tobytes()
        if key not in self._known:
            passive = np.zeros((len(readings), len(self.closure.passive)))
            for part in range(_PARTS):
                passive, closed = self._newton(part / _PARTS * readings, None, passive, _ROUNDS_OF_PART)
            passive, closed = self._newton(readings, None, passive, _ROUNDS)
            if len(self._known) >= _MOST_KNOWN:
                self._known.clear()
            self._known[key] = passive, closed
        return self._known[key]

    @cached_property
    def _known(self) -> dict[bytes, tuple[Array, Mask]]:
        return {}

    def _newton(self, readings: NDArray, twists: NDArray | None, passive: NDArray, rounds: int) -> tuple[Array, Mask]:
        """Return the passive joints after steps of Newton's method, and the mask (B,) of closed poses."""
        length = np.full(len(readings), np.inf)
        for _ in range(rounds):
            frames = self.opened.frames(np.concatenate([readings, passive], 1), twists)
            gaps, by_place = self._gaps(frames)
            moved = self._by_passive(frames, self._closing, frames.t[:, self._closing])
            step, length = bounded_steps(np.einsum("bgli,blis->bgs", by_place, moved), -gaps)
            passive = passive + step * np.minimum(1.0, _LONGEST / np.maximum(length, _LONGEST))[:, None]
            if np.all((length < _CLOSED) | (length == np.inf)):
                break
        return passive, length < _CLOSED

    def _gaps(self, frames: TreeFrames) -> tuple[Array, Array]:
        """Return the conditions (B, G), and their derivatives (B, G, L, 3) by the closing places, outer frame."""
        R0, t0 = frames.R[:, 0], frames.t[:, 0]
        positions = np.einsum("bji,blj->bli", R0, frames.t[:, self._closing] - t0[:, None])
        size = 3 * len(self._closing)
        nudged = positions + _COMPLEX_STEP * 1j * np.eye(size).reshape(size, 1, -1, 3)
        found = self.closure.gaps({name: nudged[:, :, k] for k, name in enumerate(self.closure.links)})
        slopes = np.moveaxis(found.imag / _COMPLEX_STEP, 0, -1).reshape(*found.shape[1:], len(self._closing), 3)
        return np.asarray(found[0].real), np.asarray(np.einsum("bij,bglj->bgli", R0, slopes))

    def _by_passive(self, frames: TreeFrames, nodes: Index, points: NDArray, turns: bool = False) -> Array:
        """Return the derivatives (B, K, 3, S) by the passive joints of points (B, K, 3), or of rotations, of links."""
        result = np.zeros((*points.shape, len(self.closure.passive)))
        for k, node in enumerate(self.nodes):
            if node.reading not in self.closure.passive:
                continue
            axis = node.factor * (frames.R[:, k] @ node.axis)[:, None]
            if node.kind is JointKind.PRISMATIC:
                moved = np.zeros_like(points) if turns else np.broadcast_to(axis, points.shape)
            else:
                around = np.cross(axis, points - frames.origin[:, k, None])
                moved = np.broadcast_to(axis, points.shape) if turns else around
            is_above = self.above[nodes, k][:, None]
            result[..., self.closure.passive.index(node.reading)] += np.where(is_above, moved, 0.0)
        return result

    def passive_slopes(self, frames: TreeFrames) -> Array:
        """Return the derivatives (B, S, N, 6) of the passive joints, rad or m, by all twists."""
        slopes = super().point_slopes(frames, self._closing, frames.t[:, self._closing])
        slopes[:, :, :, 0] = 0.0  # the conditions hold in the frame of the base
        found = self._passive_by(frames, slopes.reshape(*slopes.shape[:3], -1))
        return found.reshape(*found.shape[:2], self.size, TWIST)

    def _passive_by(self, frames: TreeFrames, slopes: NDArray) -> Array:
        """Return the derivatives (B, S, P) of the passive joints, given those (B, L, 3, P) of the closing places."""
        _, by_place = self._gaps(frames)
        by_passive = self._by_passive(frames, self._closing, frames.t[:, self._closing])
        closed = np.einsum("bgli,blis->bgs", by_place, by_passive)
        return -np.asarray(np.linalg.solve(closed, np.einsum("bgli,blip->bgp", by_place, slopes)))

    def point_slopes(self, frames: TreeFrames, nodes: Index, points: NDArray) -> NDArray:
        """Return the derivatives (B, K, 3, N, 6) of points by all twists, the loops closed."""
        moved = self._by_passive(frames, nodes, points)
        slopes = super().point_slopes(frames, nodes, points)
        return slopes + np.einsum("bkis,bsnc->bkinc", moved, self.passive_slopes(frames))

    def rotation_slopes(self, frames: TreeFrames, nodes: Index) -> NDArray:
        """Return the rotation vectors (B, K, 3, N, 6) of links per unit of all twists, the loops closed."""
        moved = self._by_passive(frames, nodes, frames.t[:, nodes], turns=True)
        return super().rotation_slopes(frames, nodes) + np.einsum(
            "bkis,bsnc->bkinc", moved, self.passive_slopes(frames)
        )

    def reading_slopes(self, frames: TreeFrames, nodes: Index, points: NDArray) -> NDArray:
        """Return the derivatives (B, K, 6, n) of places and rotations of links by all readings, the loops closed."""
        turned = self._by_passive(frames, nodes, points, turns=True)
        moved = np.concatenate([self._by_passive(frames, nodes, points), turned], 2)
        closing = super().reading_slopes(frames, self._closing, frames.t[:, self._closing])[:, :, :3]
        passive = self._passive_by(frames, closing)[:, None]
        return super().reading_slopes(frames, nodes, points) + moved @ passive

    def gravity_load(
        self, readings: NDArray, gravity: NDArray, payload: dict[int, tuple[NDArray, NDArray]]
    ) -> tuple[Array, Array]:
        """Return force (B, N, 3), N, and moment (B, N, 3), N m, of weight on each node, the loops closed.

        They are the work of all weights per unit of the node's twist (principle of virtual work). That is what the node
        carries if the loops transmit no more than their conditions ask, and joints that are not read have no friction.
        Arguments, axes and origins are those of `Tree.gravity_load`.
        """
        frames, weights = self.frames(readings), self.weights(payload)
        if not weights:
            return np.zeros((len(readings), self.size, 3)), np.zeros((len(readings), self.size, 3))
        down = STANDARD_GRAVITY * gravity / np.sqrt(np.sum(gravity**2))
        nodes = np.array([k for k, _, _ in weights], int)
        coms = np.stack([com for *_, com in weights])
        masses = np.stack([np.broadcast_to(mass, len(readings)) for _, mass, _ in weights], -1)
        positions = frames.t[:, nodes] + np.einsum("bkij,kj->bki", frames.R[:, nodes], coms)
        work = np.einsum("bk,i,bkinc->bnc", masses, down, self.point_slopes(frames, nodes, positions))
        return work[..., :3], work[..., 3:]

    def closing_modes(self, sigma: NDArray, others: NDArray) -> Array:
        """Return twists (N, 6, Q) per prior sigma: shifts of fixed closing links that the passive joints show.

        Lengths and places in the loops are among them. ``sigma`` (6,) as for `geometry_modes`; what ``others``
        (N, 6, P) do to the passive joints as well is left out.
        """
        fixed = [k for k in self._closing if self.nodes[k].kind is JointKind.FIXED and self.nodes[k].parent >= 0]
        readings = _ABOUT_ZERO * np.sin(np.outer(np.arange(1, _TRIALS + 1), 1.0 + np.arange(len(self.readings))))
        slopes = self.passive_slopes(self.frames(readings[self.closes(readings)]))
        columns = (slopes[:, :, fixed, :3] * sigma[:3]).reshape(-1, 3 * len(fixed))
        by_others = np.tensordot(slopes, others, 2).reshape(len(columns), -1)
        if others.shape[-1]:
            left, values, _ = np.linalg.svd(by_others, full_matrices=False)
            left = left[:, values > _SEEN * values.max(initial=0.0)]
            columns = columns - left @ (left.T @ columns)
        largest = np.abs(slopes[..., :3]).max(initial=0.0) * np.sqrt(len(columns)) * sigma[:3].max()
        _, values, vectors = np.linalg.svd(columns, full_matrices=False)
        shown = vectors[values > _SEEN * largest].T.reshape(len(fixed), 3, -1)
        result = np.zeros((self.size, 6, shown.shape[-1]))
        result[fixed, :3] = sigma[:3, None] * shown
        return result
