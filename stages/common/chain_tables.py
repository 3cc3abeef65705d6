"""Tables of a chain: its joints as an artifact, and the columns of their readings."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa

from truing.arrays import Array
from truing.estimation.rotation import exp_so3, log_so3
from truing.schemas.artifacts import ARTIFACTS
from truing.simulation.mechanisms.chains.tree import JointKind, Node, Tree
from truing.stages.common.point_arrays import number_column, number_columns

# Endings of the columns of a reading, with the value of one unit in SI.
ANGLES = {"_deg": np.pi / 180.0, "_rad": 1.0}
LENGTHS = {"_mm": 1e-3, "_m": 1.0}
_PLACE, _TURN = ("x_mm", "y_mm", "z_mm"), ("rx_rad", "ry_rad", "rz_rad")
_AXIS, _CENTRE = ("axis_x", "axis_y", "axis_z"), ("com_x_mm", "com_y_mm", "com_z_mm")
_MM = 1e-3


@dataclass(frozen=True)
class JointColumn:
    """Column of a joint's reading, and the SI value of its unit."""

    name: str
    si: float


def tree_table(tree: Tree, limits: Mapping[str, tuple[float, float]]) -> pa.Table:
    """Rows of joints.parquet: every joint with the link that it moves, in order; limits by joint, rad or m."""
    rows = []
    for number, node in enumerate(tree.nodes):
        numbers = dict(zip(_PLACE, node.t / _MM, strict=True)) | dict(zip(_TURN, log_so3(node.R), strict=True))
        numbers |= dict(zip(_AXIS, node.axis, strict=True)) | dict(zip(_CENTRE, node.com / _MM, strict=True))
        low, high = limits.get(node.joint, (None, None)) if node.joint else (None, None)
        rows.append(
            {
                "node": number,
                "joint": node.joint,
                "link": node.link,
                "below": node.parent,
                "joint_kind": str(node.kind),
                **{name: float(value) for name, value in numbers.items()},
                "follows_joint": node.reading,
                "factor": node.factor,
                "zero_si": node.shift,
                "mass_kg": node.mass,
                "lower_si": low,
                "upper_si": high,
                "input": tree.readings.index(node.joint) if node.joint in tree.readings else -1,
            }
        )
    return pa.Table.from_pylist(rows, schema=ARTIFACTS["joints"].arrow_schema())


def tree_of(table: pa.Table) -> Tree:
    """The chain of a table of joints."""
    rows = table.to_pylist()

    def three(row: dict[str, Any], names: tuple[str, ...]) -> Array:
        return np.array([row[name] for name in names], float)

    nodes = tuple(
        Node(
            row["joint"],
            row["link"],
            row["below"],
            exp_so3(three(row, _TURN)),
            three(row, _PLACE) * _MM,
            JointKind(row["joint_kind"]),
            three(row, _AXIS),
            row["follows_joint"],
            row["factor"],
            row["zero_si"],
            row["mass_kg"],
            three(row, _CENTRE) * _MM,
        )
        for row in rows
    )
    read = sorted((row["input"], row["joint"]) for row in rows if row["input"] >= 0)
    return Tree(nodes, tuple(name for _, name in read))


def joint_column(tree: Tree, joint: str, names: list[str]) -> JointColumn | None:
    """The column of a joint's reading among names; None if there is none of a unit that fits the joint."""
    node = tree.nodes[tree.node_of(tree.readings.index(joint))]
    endings = ANGLES if node.kind is JointKind.REVOLUTE else LENGTHS
    return next((JointColumn(joint + end, si) for end, si in endings.items() if joint + end in names), None)


def joint_columns(tree: Tree, names: list[str]) -> list[JointColumn]:
    """The columns of all readings, in order; raises ValueError if one is missing."""
    found = [joint_column(tree, joint, names) for joint in tree.readings]
    if None in found:
        raise ValueError(f"needs a column of the readings of joint {tree.readings[found.index(None)]}")
    return [column for column in found if column is not None]


def joint_readings(tree: Tree, table: pa.Table) -> Array:
    """Readings (B, n), rad or m, NaN where missing; raises ValueError if a column is missing."""
    columns = joint_columns(tree, table.schema.names)
    return number_columns(table, [c.name for c in columns]) * np.array([c.si for c in columns])


def payload_of(settings: Any, table: pa.Table) -> Array:
    """Mass (B,) at the tip, kg: the column payload_kg if there is one, else that of [mechanism]."""
    if "payload_kg" in table.schema.names:
        return np.nan_to_num(number_column(table, "payload_kg"))
    return np.full(len(table), float(settings.mechanism.payload_kg))
