"""A chain as its description would be without a slip: lengths in another unit, rows in the other convention."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import combinations, product
from typing import TYPE_CHECKING

import numpy as np

from truing.belonging.relation import LENGTH_FACTORS, RecordSlip, SlipKind, both_ways
from truing.simulation.mechanisms.chains.notations import MODIFIED, STANDARD, DenavitHartenberg, tree_of_rows
from truing.simulation.mechanisms.chains.tree import JointKind, Node, Tree

if TYPE_CHECKING:
    from truing.schemas.chain_mechanism import ChainMechanism

_MM = 1e-3
_DH_ROWS = "rows of [mechanism] dh"
_COLUMNS = {"a": "a_mm", "alpha": "alpha_deg", "d": "d_mm", "theta": "theta_deg"}
_AXES = ("x", "y", "z")
_TINY = 1e-6  # m and rad: a number that counts as zero


def rows_of(section: ChainMechanism) -> list[DenavitHartenberg]:
    """Rows of [mechanism] dh in m and rad."""
    return [
        DenavitHartenberg(
            row.a_mm * _MM,
            np.radians(row.alpha_deg),
            row.d_mm * _MM,
            np.radians(row.theta_deg),
            JointKind(row.kind),
            row.convention,
        )
        for row in section.dh
    ]


def described_otherwise(tree: Tree, rows: Sequence[DenavitHartenberg]) -> Iterator[tuple[RecordSlip, Tree]]:
    """Yield slips in the description of a chain, each with the chain after its correction; rows: its table, or none."""
    for factor in both_ways(LENGTH_FACTORS):
        nodes = tuple(replace(node, t=factor * node.t, com=factor * node.com) for node in tree.nodes)
        yield RecordSlip(SlipKind.UNIT, "lengths of the chain's description", factor=factor), replace(tree, nodes=nodes)
    written = {row.convention for row in rows}
    for convention in sorted({STANDARD, MODIFIED} - written if len(written) == 1 else ()):
        other = _tree_like(tree, [replace(row, convention=convention) for row in rows])
        yield RecordSlip(SlipKind.CONVENTION, _DH_ROWS, (convention,)), other


def _tree_like(tree: Tree, rows: Sequence[DenavitHartenberg]) -> Tree:
    """The chain of other rows, with the names of a chain."""
    joints = [node.joint for node in tree.nodes if node.joint]
    return tree_of_rows(rows, joints, tree.nodes[0].link, tree.nodes[-1].link)


def numbers_otherwise(tree: Tree, rows: Sequence[DenavitHartenberg]) -> Iterator[tuple[RecordSlip, Tree]]:
    """Yield slips in single numbers or columns of the description, each with the chain after its correction.

    They leave a chain of rotations and lengths as plausible as before. Some are equal to slips of readings, or to zeros
    that are half a turn off.
    """
    if not rows:
        yield from _places_otherwise(tree)
        return
    for slip, other in (*_signs(rows), *_units(rows), *_exchanges(rows)):
        yield slip, _tree_like(tree, other)


def _signs(rows: Sequence[DenavitHartenberg]) -> Iterator[tuple[RecordSlip, list[DenavitHartenberg]]]:
    for name, column in _COLUMNS.items():
        if name == "theta":  # another zero of the joint
            continue
        signed = [at for at, row in enumerate(rows) if abs(getattr(row, name)) > _TINY]
        for chosen in ([at] for at in signed):
            yield _sign(column, chosen), _changed(rows, name, chosen, -1.0)
        if len(signed) > 1:
            yield _sign(column, []), _changed(rows, name, signed, -1.0)


def _sign(column: str, rows: Sequence[int]) -> RecordSlip:
    return RecordSlip(SlipKind.SIGN, f"{column} of {_DH_ROWS}", tuple(str(at + 1) for at in rows))


def _units(rows: Sequence[DenavitHartenberg]) -> Iterator[tuple[RecordSlip, list[DenavitHartenberg]]]:
    every = range(len(rows))
    for name in ("alpha", "theta"):
        quantity, factor = f"{_COLUMNS[name]} of {_DH_ROWS}", float(np.degrees(1.0))
        slip = RecordSlip(SlipKind.UNIT, quantity, factor=factor, dimension="angle")
        yield slip, _changed(rows, name, every, factor)
    for name, at in product(("a", "d"), every):
        if abs(getattr(rows[at], name)) > _TINY:
            for factor in both_ways(LENGTH_FACTORS):
                slip = RecordSlip(SlipKind.UNIT, f"{_COLUMNS[name]} of {_DH_ROWS}", (str(at + 1),), factor)
                yield slip, _changed(rows, name, [at], factor)


def _exchanges(rows: Sequence[DenavitHartenberg]) -> Iterator[tuple[RecordSlip, list[DenavitHartenberg]]]:
    for one, other in (("a", "d"), ("alpha", "theta")):
        exchanged = [replace(row, **{one: getattr(row, other), other: getattr(row, one)}) for row in rows]
        yield RecordSlip(SlipKind.COLUMNS, f"columns of {_DH_ROWS}", (_COLUMNS[one], _COLUMNS[other])), exchanged
    for first in range(len(rows) - 1):
        moved = [*rows[:first], rows[first + 1], rows[first], *rows[first + 2 :]]
        yield RecordSlip(SlipKind.ROWS_EXCHANGED, _DH_ROWS, (str(first + 1), str(first + 2))), moved


def _changed(
    rows: Sequence[DenavitHartenberg], name: str, chosen: Sequence[int], factor: float
) -> list[DenavitHartenberg]:
    """Rows with one number of the chosen rows multiplied by a factor."""
    return [replace(row, **{name: factor * getattr(row, name)}) if at in chosen else row for at, row in enumerate(rows)]


def _places_otherwise(tree: Tree) -> Iterator[tuple[RecordSlip, Tree]]:
    """Yield other axes of single joints, and other signs of a coordinate of their places."""
    for at, node in enumerate(tree.nodes):
        for axis in np.flatnonzero(np.abs(node.t) > _TINY).tolist():
            place = np.where(np.arange(3) == axis, -node.t, node.t)
            slip = RecordSlip(SlipKind.SIGN, f"{_AXES[axis]} of the place of joint", (node.joint or node.link,))
            yield slip, _with_node(tree, at, replace(node, t=place))
        for one, other in combinations(range(3), 2) if node.kind is not JointKind.FIXED else ():
            order = np.arange(3)
            order[[one, other]] = other, one
            if np.any(node.axis[order] != node.axis):
                quantity = f"components of the axis of joint {node.joint}"
                slip = RecordSlip(SlipKind.COLUMNS, quantity, (_AXES[one], _AXES[other]))
                yield slip, _with_node(tree, at, replace(node, axis=node.axis[order]))


def _with_node(tree: Tree, at: int, node: Node) -> Tree:
    return replace(tree, nodes=(*tree.nodes[:at], node, *tree.nodes[at + 1 :]))
