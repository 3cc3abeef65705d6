"""Prediction of the tip's poses by an extended model of a chain."""

from __future__ import annotations

import numpy as np
import pyarrow as pa

from truing.estimation.rotation import log_so3
from truing.schemas.artifacts import ARTIFACTS
from truing.schemas.covariates import own_name
from truing.schemas.faults import CampaignFaults, Fault
from truing.simulation.inputs import ORDER, order_in_time
from truing.simulation.mechanisms.chains.conditions import ChainConditions, movements
from truing.simulation.mechanisms.chains.extended_model import ExtendedChain, predict_tip, read_chain
from truing.simulation.mechanisms.chains.joint_table import joint_column, joint_columns
from truing.stages.common.chain_tables import joint_readings
from truing.stages.common.point_arrays import number_column, pose_ids


def predicted(model: str, table: pa.Table, file: str) -> pa.Table:
    """Poses of the tip relative to the base, columns of poses.parquet, for a table of joint readings.

    Raises CampaignFaults where ``file`` lacks a needed column or number, ValueError where the model is none.
    """
    extended = read_chain(model)
    _check(extended, table, file)
    found = predict_tip(extended, conditions_of(extended, table))
    vectors = np.column_stack([found.p * 1e3, log_so3(found.R)])
    count = len(table)
    columns: dict[str, object] = {
        "pose": table.column("pose"),
        "body": [extended.tree.nodes[extended.tip].link] * count,
        "parent": [extended.tree.nodes[0].link] * count,
        "method": ["model"] * count,
        "default": [True] * count,
    }
    names = ("px_mm", "py_mm", "pz_mm", "rx_rad", "ry_rad", "rz_rad")
    columns |= {name: vectors[:, i] for i, name in enumerate(names)}
    columns |= {f"cov_{i}_{j}": found.covariance[:, i, j] for i in range(6) for j in range(i, 6)}
    columns |= {
        "rms_mm": pa.nulls(count, pa.float64()),
        "n_used": [0] * count,
        "n_rejected": [0] * count,
        "status": ["ok"] * count,
    }
    identifier = "int64" if pa.types.is_integer(table.schema.field("pose").type) else "string"
    schema = ARTIFACTS["poses"].arrow_schema(identifier)
    return pa.table({name: columns[name] for name in schema.names}).cast(schema)


def conditions_of(extended: ExtendedChain, table: pa.Table) -> ChainConditions:
    """Conditions of all rows: readings, covariates, and the direction from which each joint came."""
    readings = joint_readings(extended.tree, table)
    covariates = {
        field.name: number_column(table, field.name)
        for field in table.schema
        if field.name not in ("pose", "role") and str(field.type) in ("double", "int64")
    }
    covariates[ORDER] = order_in_time(covariates.get("time_s"), len(table))
    covariates |= movements(readings, covariates, np.zeros(readings.shape[1]))
    payload = covariates.get("payload_kg", np.full(len(table), extended.payload_kg))
    return ChainConditions(
        readings,
        covariates,
        pose_ids(table),
        np.zeros(len(table), np.int64),
        np.tile(np.eye(3), (len(table), 1, 1, 1)),
        payload,
        tuple(column.name for column in joint_columns(extended.tree, table.schema.names)),
    )


def _check(extended: ExtendedChain, table: pa.Table, file: str) -> None:
    names, tree = table.schema.names, extended.tree
    needed = {"pose": "the pose's name"} if "pose" not in names else {}
    for joint in tree.readings:
        if joint_column(tree, joint, names) is None:
            unit = "deg" if tree.is_revolute[tree.readings.index(joint)] else "mm"
            needed[f"{joint}_{unit}"] = f"the reading of joint {joint}"
    for effect in extended.effects:
        if effect.cause.is_persistent:
            wanted = (own_name(name) for name in effect.cause.needs(len(tree.readings)))
            needed |= {name: f"which {effect.cause.id} follows" for name in wanted if name not in names}
    if needed:
        raise CampaignFaults(
            Fault(file, f"a column of that name, {what}", column=name) for name, what in needed.items()
        )
    first = 2 if file.endswith(".csv") else 1  # an editor counts the header line too
    columns = [column.name for column in joint_columns(tree, names)]
    faults = [
        Fault(file, "a number", row=int(row) + first, column=name, value=str(table.column(name)[int(row)]))
        for name in columns
        for row in np.flatnonzero(~np.isfinite(number_column(table, name)))
    ]
    if faults:
        raise CampaignFaults(faults)
