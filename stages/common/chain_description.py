"""A chain as its description would be without a slip: lengths in another unit, rows in the other convention."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from truing.belonging.relation import LENGTH_FACTORS, RecordSlip, SlipKind, both_ways
from truing.simulation.mechanisms.chains.notations import MODIFIED, STANDARD, DenavitHartenberg, tree_of_rows
from truing.simulation.mechanisms.chains.tree import JointKind, Tree

if TYPE_CHECKING:
    from truing.schemas.chain_mechanism import ChainMechanism

_MM = 1e-3


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
        other = tree_of_rows(
            [replace(row, convention=convention) for row in rows],
            [node.joint for node in tree.nodes if node.joint],
            tree.nodes[0].link,
            tree.nodes[-1].link,
        )
        yield RecordSlip(SlipKind.CONVENTION, "rows of [mechanism] dh", (convention,)), other
