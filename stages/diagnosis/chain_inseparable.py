"""Numbers of a chain that its measurements do not separate, and what would separate them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa

from truing.arrays import TableRow
from truing.calibration.chain_design import HiddenCombination, PlannedPoses, Remedy, hidden_combinations
from truing.schemas.artifacts import ARTIFACTS
from truing.simulation.mechanisms.chains.model import ChainModel
from truing.stages.common.chain_candidates import (
    JointRanges,
    conditions_of_table,
    drawn_readings,
    forbidden_poses,
    joint_ranges,
)
from truing.stages.diagnosis.next_measurement import MeasuredPoints

if TYPE_CHECKING:
    from truing.inference.fitted_model import FittedModel
    from truing.schemas.campaign import Campaign

_PROBES = 200  # poses that stand for all that could be measured
_SEED = 0
_SMALL_TURN, _SMALL_SHIFT = 0.5, 0.05  # rad and m, of a joint without a range


def inseparable_table(fitted: FittedModel, settings: Campaign, tables: Mapping[str, pa.Table]) -> pa.Table:
    """Rows of chain_inseparable.parquet: the members of each combination of numbers that the poses of a fit hide.

    Other poses are drawn over the ranges of the joints.
    """
    plain: object = fitted.model.with_causes(())
    assert isinstance(plain, ChainModel)
    ranges = _ranges(plain, settings, tables)
    instrument = MeasuredPoints(fitted.measured, fitted.fit.frames).instrument()
    nowhere = forbidden_poses(plain.tree, ranges, None, "")
    readings = drawn_readings(plain.tree, ranges, nowhere, _PROBES, np.random.default_rng(_SEED))
    table = ranges.table(readings, pose=pa.array(np.arange(len(readings))))
    possible = PlannedPoses(plain, conditions_of_table(plain, settings, table, readings), instrument)
    hidden = hidden_combinations(PlannedPoses(plain, plain.conditions, instrument), possible)
    rows: list[TableRow] = []
    for number, combination in enumerate(hidden, start=1):
        named = ranges.table(possible.conditions.readings[list(combination.poses)]).to_pylist()
        poses = ["; ".join(f"{name} {value:g}" for name, value in row.items()) for row in named]
        rows += _rows(number, combination, poses)
    return pa.Table.from_pylist(rows, schema=ARTIFACTS["chain_inseparable"].arrow_schema())


def _ranges(model: ChainModel, settings: Campaign, tables: Mapping[str, pa.Table]) -> JointRanges:
    """Return the ranges of the joints; one that stood still, and has no limits, is taken to move a little."""
    at, size = model.conditions.readings[0], np.where(model.tree.is_revolute, _SMALL_TURN, _SMALL_SHIFT)
    small = dict(zip(model.tree.readings, zip((at - size).tolist(), (at + size).tolist(), strict=True), strict=True))
    return joint_ranges(model.tree, settings, tables["joints"], tables["configurations"], small)


def _rows(number: int, combination: HiddenCombination, poses: list[str]) -> list[TableRow]:
    common: TableRow = {
        "combination_number": number,
        "remedy": _REMEDIES[combination.remedy],
        "separating_pose": poses[0] if poses else None,
    }
    return [
        {
            **common,
            "number_kind": str(unknown.kind),
            "subject": unknown.subject,
            "parameter": unknown.parameter,
            "unit": unknown.unit,
            "number_change": change,
        }
        for unknown, change in combination.members
    ]


_REMEDIES = {
    Remedy.POSES: "poses",
    Remedy.PAYLOAD: "payload",
    Remedy.BASE: "base-targets",
    Remedy.TARGETS: "target-places",
    Remedy.NOTHING: "none",
}
