"""Motions that pass unchanged through joints: both sides of the joint move all measured links equally, in all poses."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np
from numpy.typing import NDArray

from truing.arrays import Array
from truing.estimation.rotation import skew
from truing.simulation.mechanisms.chains.tree import JointKind, Tree, axis_twist

# Largest bracket of a unit motion and a joint that still counts as zero, rad and m: angles of descriptions are rounded.
_ROUNDED = 1e-4


def nodes_moved_alike(tree: Tree, node: int, twist: NDArray, measured: Collection[int]) -> list[tuple[int, Array]]:
    """Return the nodes at which a motion of constant direction moves all measured links equally in every pose, from
    base to tip.

    ``twist`` (6,), m and rad, is the motion of a node in its joint's frame; each node returned has its own, of the same
    size. A motion passes through a joint with which it commutes, and through a link that carries one joint and is not
    ``measured``.
    """
    unit = twist / np.sqrt(np.sum(twist**2))
    found = [(node, unit)]
    while (below := tree.nodes[found[0][0]].parent) >= 0:
        moved = _to_parent(tree, *found[0])
        if below in measured or len(_children(tree, below)) > 1 or not _commutes(tree, below, moved):
            break
        found.insert(0, (below, moved))
    while True:
        last, moved = found[-1]
        above = _children(tree, last)
        if last in measured or len(above) != 1 or not _commutes(tree, last, moved):
            return found
        found.append((above[0], _from_parent(tree, above[0], moved)))


def _children(tree: Tree, node: int) -> list[int]:
    return [k for k, child in enumerate(tree.nodes) if child.parent == node]


def _commutes(tree: Tree, node: int, twist: NDArray) -> bool:
    """Return True if a motion (6,) in a joint's frame is the same before and after the joint moves."""
    parent = tree.nodes[node]
    if parent.kind is JointKind.FIXED:
        return True
    v, w, joint = twist[:3], twist[3:], axis_twist(parent)
    bracket = np.r_[np.cross(joint[3:], v) + np.cross(joint[:3], w), np.cross(joint[3:], w)]
    return bool(np.abs(bracket).max() < _ROUNDED)


def _to_parent(tree: Tree, node: int, twist: NDArray) -> Array:
    """Return the motion (6,) of a node in the frame of the link that carries it."""
    R, t = tree.nodes[node].R, tree.nodes[node].t
    turn = R @ twist[3:]
    return np.asarray(np.r_[R @ twist[:3] + skew(t) @ turn, turn])


def _from_parent(tree: Tree, node: int, twist: NDArray) -> Array:
    """Return a motion (6,) of the link that carries a node, in the node's frame."""
    R, t = tree.nodes[node].R, tree.nodes[node].t
    return np.asarray(np.r_[R.T @ (twist[:3] - skew(t) @ twist[3:]), R.T @ twist[3:]])
