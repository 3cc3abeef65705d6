"""A chain as rows of the table of joints, and the columns of its readings in other tables."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from truing.arrays import Array
from truing.estimation.rotation import exp_so3
from truing.simulation.mechanisms.chains.closed_tree import tree_with_loops
from truing.simulation.mechanisms.chains.tree import JointKind, Node, Tree

PLACE, TURN = ("x_mm", "y_mm", "z_mm"), ("rx_rad", "ry_rad", "rz_rad")
AXIS, CENTRE = ("axis_x", "axis_y", "axis_z"), ("com_x_mm", "com_y_mm", "com_z_mm")
# Endings of the columns of a reading, with the value of one unit in SI.
ANGLES = {"_deg": np.pi / 180.0, "_rad": 1.0}
LENGTHS = {"_mm": 1e-3, "_m": 1.0}
_MM = 1e-3
STATION = "station:"  # begins the name of a station in tables of distances
MOTOR = "_motor"  # of the column of a motor encoder, between joint and unit


@dataclass(frozen=True)
class JointColumn:
    """Column of a joint's reading, and the SI value of its unit."""

    name: str
    si: float


def tree_from_rows(rows: Iterable[Mapping[str, Any]]) -> Tree:
    """Return the chain of rows of joints.parquet; raises ValueError if its closure is not installed."""

    def three(row: Mapping[str, Any], names: tuple[str, ...]) -> Array:
        return np.array([row[name] for name in names], float)

    table = list(rows)
    nodes = tuple(
        Node(
            row["joint"] or "",
            row["link"],
            int(row["below"]),
            exp_so3(three(row, TURN)),
            three(row, PLACE) * _MM,
            JointKind(row["joint_kind"]),
            three(row, AXIS),
            row["follows_joint"] or "",
            row["factor"],
            row["zero_si"],
            row["mass_kg"],
            three(row, CENTRE) * _MM,
        )
        for row in table
    )
    read = sorted((row["input"], row["joint"]) for row in table if row["input"] >= 0)
    tree = Tree(nodes, tuple(name for _, name in read))
    return tree_with_loops(tree, str(table[0].get("closure") or ""))


def joint_column(tree: Tree, joint: str, names: Iterable[str]) -> JointColumn | None:
    """Return the column of a joint's reading among names; None if there is none of a unit that fits the joint."""
    node, known = tree.nodes[tree.node_of(tree.readings.index(joint))], set(names)
    endings = ANGLES if node.kind is JointKind.REVOLUTE else LENGTHS
    return next((JointColumn(joint + end, si) for end, si in endings.items() if joint + end in known), None)


def motor_column(tree: Tree, joint: str, names: Iterable[str]) -> JointColumn | None:
    """Return the column of a joint's motor encoder among names; None if there is none of a unit that fits the joint."""
    known = {name.replace(f"{joint}{MOTOR}", joint, 1): name for name in names if name.startswith(f"{joint}{MOTOR}_")}
    found = joint_column(tree, joint, known)
    return None if found is None else JointColumn(known[found.name], found.si)


def joint_columns(tree: Tree, names: Iterable[str]) -> list[JointColumn]:
    """Return the columns of all readings, in order; raises ValueError if one is missing."""
    known = list(names)
    found = [joint_column(tree, joint, known) for joint in tree.readings]
    if None in found:
        raise ValueError(f"needs a column of the readings of joint {tree.readings[found.index(None)]}")
    return [column for column in found if column is not None]
