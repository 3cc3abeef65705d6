"""Several joints that count in the other sense than the description, and a joint that counts from a fixed direction.

Controllers and tables of Denavit and Hartenberg choose the positive sense of each joint on their own, so several may
differ at once. A parallelogram, or a controller that counts from the horizontal, couples two joints of parallel axes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, pairwise

import numpy as np
from numpy.typing import NDArray

from truing.arrays import Array, Mask
from truing.simulation.mechanisms.chains.column_slips import ColumnSlipKind, few_poses, foreign_misfit
from truing.simulation.mechanisms.chains.conditions import ChainConditions, moved_joints
from truing.simulation.mechanisms.chains.start_values import StartValues
from truing.simulation.mechanisms.chains.tree import Tree

_MOST_JOINTS = 8  # moving joints whose senses are tried together
_AS_GOOD = 2.0  # times the least misfit, up to which fewer changes count as good
_PARALLEL = 0.999  # cosine of the angle of two axes


@dataclass(frozen=True)
class JointSenses:
    """Readings (numbers) that count in the other sense, after a coupling of two others; and the misfit, m, with both.

    ``coupling``: whether the first of ``coupled`` is to be added to the second, or subtracted; None without.
    """

    reversed_readings: tuple[int, ...]
    coupling: ColumnSlipKind | None = None
    coupled: tuple[int, ...] = ()
    after: float = np.inf

    @property
    def changes(self) -> int:
        """Number of columns to change."""
        return len(self.reversed_readings) + (self.coupling is not None)

    def corrected(self, readings: NDArray) -> Array:
        """Return readings (B, n) after the coupling, then the change of senses."""
        result = np.array(readings, float)
        if self.coupling is not None:
            first, second = self.coupled
            result[:, second] += readings[:, first] * (1.0 if self.coupling is ColumnSlipKind.ADDED else -1.0)
        result[:, list(self.reversed_readings)] *= -1.0
        return result


def senses_that_join(
    tree: Tree, conditions: ChainConditions, start_of: Callable[[Mask, ChainConditions], StartValues]
) -> JointSenses | None:
    """Return the fewest changes of senses, with one coupling or none, that join readings and measured links.

    None if no combination comes as near as a real machine does, or if as many other changes are as good. ``start_of``
    fits the places to some poses, a mask (B,), under conditions of all poses.
    """
    moving = np.flatnonzero(moved_joints(conditions.readings, tree.is_revolute)).tolist()
    if not 0 < len(moving) <= _MOST_JOINTS:
        return None
    few = few_poses(len(conditions.readings))

    def fitted(one: JointSenses) -> JointSenses:
        joined = start_of(few, replace(conditions, readings=one.corrected(conditions.readings)))
        return replace(one, after=joined.rms)

    tried = [fitted(one) for one in _combinations(moving, _parallel_neighbours(tree))]
    least = min(one.after for one in tried)
    if not least <= foreign_misfit(start_of(few, conditions)):
        return None
    good = [one for one in tried if one.after <= _AS_GOOD * least]
    fewest = min(one.changes for one in good)
    best, *others = (one for one in good if one.changes == fewest)
    return None if others else best


def _parallel_neighbours(tree: Tree) -> list[tuple[int, int]]:
    """Return the pairs of successive readings whose joints turn about parallel axes."""
    frames = tree.frames(np.zeros((1, len(tree.readings))))
    nodes = [tree.node_of(k) for k in range(len(tree.readings))]
    axes = [frames.R[0, node] @ tree.nodes[node].axis for node in nodes]
    return [
        (a, b)
        for a, b in pairwise(range(len(nodes)))
        if tree.is_revolute[[a, b]].all() and abs(axes[a] @ axes[b]) > _PARALLEL
    ]


def _combinations(moving: Sequence[int], pairs: Sequence[tuple[int, int]]) -> Iterator[JointSenses]:
    """Yield every set of reversed readings, alone and with each coupling."""
    kinds = (ColumnSlipKind.ADDED, ColumnSlipKind.SUBTRACTED)
    for count in range(len(moving) + 1):
        for joints in combinations(moving, count):
            yield JointSenses(joints)
            for kind in kinds:
                yield from (JointSenses(joints, kind, pair) for pair in pairs)
