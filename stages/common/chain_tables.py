"""Tables of a chain: its joints as an artifact, and the readings and payload of its poses."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, cast

import numpy as np
import pyarrow as pa

from truing.arrays import Array
from truing.estimation.rotation import log_so3
from truing.schemas.artifacts import ARTIFACTS
from truing.simulation.mechanisms.chains.closed_tree import ClosedTree
from truing.simulation.mechanisms.chains.joint_table import (
    AXIS,
    CENTRE,
    PLACE,
    TURN,
    joint_columns,
    motor_column,
    tree_from_rows,
)
from truing.simulation.mechanisms.chains.tree import Tree
from truing.stages.common.point_arrays import number_column, number_columns

if TYPE_CHECKING:
    from truing.schemas.campaign import Campaign
    from truing.schemas.chain_mechanism import ChainMechanism

_MM = 1e-3


def tree_table(tree: Tree, limits: Mapping[str, tuple[float, float]]) -> pa.Table:
    """Rows of joints.parquet: every joint with the link that it moves, in order; limits by joint, rad or m."""
    rows, closure = [], {"closure": tree.closure.name} if isinstance(tree, ClosedTree) else {}
    for number, node in enumerate(tree.nodes):
        numbers = dict(zip(PLACE, node.t / _MM, strict=True)) | dict(zip(TURN, log_so3(node.R), strict=True))
        numbers |= dict(zip(AXIS, node.axis, strict=True)) | dict(zip(CENTRE, node.com / _MM, strict=True))
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
                **closure,
                "input": tree.readings.index(node.joint) if node.joint in tree.readings else -1,
            }
        )
    return pa.Table.from_pylist(rows, schema=ARTIFACTS["joints"].arrow_schema(present=tuple(closure)))


def tree_of(table: pa.Table) -> Tree:
    """The chain of a table of joints."""
    return tree_from_rows(table.to_pylist())


def joint_readings(tree: Tree, table: pa.Table) -> Array:
    """Readings (B, n), rad or m, NaN where missing; raises ValueError if a column is missing."""
    columns = joint_columns(tree, table.schema.names)
    return number_columns(table, [c.name for c in columns]) * np.array([c.si for c in columns])


def motor_readings(tree: Tree, table: pa.Table) -> dict[int, Array]:
    """Readings (B,) of the motor encoders, rad or m, by the number of the joint's reading; NaN where missing."""
    readings = {}
    for k, joint in enumerate(tree.readings):
        if (column := motor_column(tree, joint, table.schema.names)) is not None:
            readings[k] = number_column(table, column.name) * column.si
    return readings


def payload_of(settings: Campaign, table: pa.Table) -> Array:
    """Mass (B,) at the tip, kg: the column payload_kg if there is one, else that of [mechanism]."""
    if "payload_kg" in table.schema.names:
        return np.nan_to_num(number_column(table, "payload_kg"))
    return np.full(len(table), cast("ChainMechanism", settings.mechanism).payload_kg)
