"""Input of measured distances: their ends by link and target, checked against targets.csv."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa

from truing.formats.faultlog import FaultLog
from truing.formats.raw_tables import COORDINATES, DISTANCES, TARGETS, RawTable
from truing.formats.row_collection import collect_rows
from truing.formats.source import CampaignFiles
from truing.schemas.artifacts import ARTIFACTS
from truing.schemas.near_names import meant_by
from truing.simulation.mechanisms.chains.joint_table import STATION
from truing.stages.common.table_arrays import numbers, sigmas, texts

if TYPE_CHECKING:
    from truing.schemas.campaign import Campaign

_NAMES = RawTable(
    "targets", ("body", "target"), (*TARGETS.optional, *COORDINATES), may_be_empty=COORDINATES, partial=True
)


def read_distances(
    source: CampaignFiles, settings: Campaign, poses: pa.ChunkedArray, tip: str, log: FaultLog
) -> pa.Table:
    """Rows of distances.parquet; a target that targets.csv does not name is one of the tip. Faults go into ``log``."""
    rows = collect_rows(source, DISTANCES, log, "pose")
    empty = ARTIFACTS["distances"].empty()
    if rows is None:
        return empty
    named = collect_rows(source, _NAMES, FaultLog()) if source.entries("targets") else None
    links = {} if named is None else dict(zip(texts(named, "target"), texts(named, "body"), strict=True))
    known = set(map(str, poses.to_pylist()))
    pose = rows.table.column("pose")
    unknown = np.array([str(value) not in known for value in pose.to_pylist()], bool)
    near = meant_by([str(pose[int(unknown.argmax())].as_py())], sorted(known)) if unknown.any() else ""
    rows.fault(log, unknown, "pose", "a pose of configurations" + near)
    length = numbers(rows, "distance_mm")
    rows.fault(log, ~(length > 0.0), "distance_mm", "a distance above 0")
    ends = [texts(rows, "from"), texts(rows, "to")]
    rows.fault(log, ends[0] == ends[1], "to", "another end than from")
    sigma = sigmas(rows, ("sigma_mm",), settings.noise.point_mm, "noise.point_mm", "the distances", log)[:, 0]
    both = np.array([a.startswith(STATION) and b.startswith(STATION) for a, b in zip(*ends, strict=True)], bool)
    rows.fault(
        log, both, "to", "a target at one end at least: the distance of two stations has no information on the chain"
    )
    is_number = pa.types.is_int64(poses.type) and pa.types.is_int64(pose.type)
    columns: dict[str, object] = {"pose": pose if is_number else pose.cast(pa.string())}
    for key, end in zip(("from", "to"), ends, strict=True):
        columns[f"{key}_link"] = [None if name.startswith(STATION) else links.get(name, tip) for name in end]
        columns[f"{key}_end"] = list(end)
    columns |= {"reading_mm": length, "sigma_mm": sigma}
    schema = ARTIFACTS["distances"].arrow_schema("int64" if is_number else "string")
    return pa.table({name: columns[name] for name in schema.names}).cast(schema)
