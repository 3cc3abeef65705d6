"""Chains by rows of Denavit and Hartenberg (standard or modified), and by screws."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truing.estimation.rotation import exp_so3
from truing.simulation.mechanisms.chains.tree import JointKind, Node, Tree

STANDARD, MODIFIED = "standard", "modified"
_X, _Z = np.eye(3)[0], np.eye(3)[2]


@dataclass(frozen=True)
class DenavitHartenberg:
    """One row: a and d in m, alpha and theta in rad; of a prismatic joint d, else theta, is the zero of its reading."""

    a: float
    alpha: float
    d: float
    theta: float
    kind: JointKind = JointKind.REVOLUTE
    convention: str = STANDARD


@dataclass(frozen=True)
class Screw:
    """The axis of one joint at reading zero: unit direction, and a point on it, m, in the base's frame."""

    axis: NDArray
    point: NDArray
    kind: JointKind = JointKind.REVOLUTE


def tree_of_rows(
    rows: Sequence[DenavitHartenberg], joints: Sequence[str], base: str = "base", tip: str = "tip"
) -> Tree:
    """Return the chain of some rows; its links are ``base``, ``link1`` .., ``tip``."""
    nodes = [Node("", base, -1, np.eye(3), np.zeros(3))]
    R, t = np.eye(3), np.zeros(3)
    for number, (row, joint) in enumerate(zip(rows, joints, strict=True), 1):
        ahead, behind = _parts(row)
        R, t = R @ ahead[0], R @ ahead[1] + t
        shift = row.theta if row.kind is JointKind.REVOLUTE else row.d
        nodes.append(Node(joint, f"link{number}", number - 1, R, t, row.kind, _Z, joint, 1.0, shift))
        R, t = behind
    nodes.append(Node("", tip, len(rows), R, t))
    return Tree(tuple(nodes), tuple(joints))


def _parts(row: DenavitHartenberg) -> tuple[tuple[NDArray, NDArray], tuple[NDArray, NDArray]]:
    """Return the constant transforms before and after the motion of a row's joint.

    Standard: Rot_z(theta) Trans_z(d) Trans_x(a) Rot_x(alpha). Modified: Rot_x(alpha) Trans_x(a) Rot_z(theta)
    Trans_z(d).
    """
    along = (exp_so3(row.alpha * _X), row.a * _X)
    if row.kind is JointKind.REVOLUTE:
        after, before = (np.eye(3), row.d * _Z), (np.eye(3), np.zeros(3))
    else:
        after, before = (np.eye(3), np.zeros(3)), (exp_so3(row.theta * _Z), np.zeros(3))
    if row.convention == MODIFIED:
        return _after(along, before), after
    return before, _after(after, along)


def _after(first: tuple[NDArray, NDArray], second: tuple[NDArray, NDArray]) -> tuple[NDArray, NDArray]:
    return first[0] @ second[0], first[0] @ second[1] + first[1]


def tree_of_screws(
    screws: Sequence[Screw],
    home: tuple[NDArray, NDArray],
    joints: Sequence[str],
    base: str = "base",
    tip: str = "tip",
) -> Tree:
    """Return the chain of some screws; ``home`` is R, t (m) of the tip in the base where all readings are zero."""
    nodes, below = [Node("", base, -1, np.eye(3), np.zeros(3))], np.zeros(3)
    for number, (screw, joint) in enumerate(zip(screws, joints, strict=True), 1):
        position = screw.point - below
        nodes.append(Node(joint, f"link{number}", number - 1, np.eye(3), position, screw.kind, screw.axis, joint))
        below = screw.point
    nodes.append(Node("", tip, len(screws), home[0], home[1] - below))
    return Tree(tuple(nodes), tuple(joints))
