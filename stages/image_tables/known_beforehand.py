"""What is known of a network before it is adjusted: which code is which target, scale bars, known points."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from truing.formats.faultlog import FaultLog
from truing.formats.gather import Gathered, gather
from truing.formats.shapes import IMAGE_TARGETS, KNOWN_POINTS, SCALE_BARS
from truing.formats.source import CampaignFiles
from truing.schemas.artifacts import ARTIFACTS
from truing.schemas.faults import Fault
from truing.schemas.photographs import FAMILIES, RINGS
from truing.stages.common.gathered import SmallTable, check_sigma, once
from truing.stages.image_tables.point_names import own_names

if TYPE_CHECKING:
    import pyarrow as pa


def read_image_targets(source: CampaignFiles, boards: tuple[str, ...], log: FaultLog) -> SmallTable | None:
    """Which code is which target; None where no table says so. Codes that are looked for in photographs have to exist,
    or to be corners of one of the ``boards``."""
    found = gather(source, IMAGE_TARGETS, log)
    if found is None or lacks(found, IMAGE_TARGETS.required):
        return None
    if source.entries("images"):
        check_codes(found, boards, log)
    once(found, log, ("family", "code"))
    once(found, log, ("body", "target"))
    return SmallTable(_as_artifact("image_targets", found.table), dict(found.left_out))


def read_scale_bars(source: CampaignFiles, targets: pa.Table | None, log: FaultLog) -> SmallTable | None:
    """The calibrated lengths, their ends by the names that points have; None where there are none."""
    import pyarrow as pa

    found = gather(source, SCALE_BARS, log, "pose")
    if found is None or lacks(found, SCALE_BARS.required):
        return None
    once(found, log, ("pose", "bar") if "pose" in found.table.column_names else ("bar",))
    found.fault(log, _numbers(found.table, "length_mm") <= 0.0, "length_mm", "a number above 0")
    check_sigma(found, _numbers(found.table, "sigma_mm"), "sigma_mm", "mm", log)
    if "repeat_sigma_mm" in found.table.column_names:
        check_sigma(found, _numbers(found.table, "repeat_sigma_mm"), "repeat_sigma_mm", "mm", log, or_zero=True)
    table = found.table
    ends = [_named(table, name, targets) for name in ("first", "second")]
    found.fault(log, ends[0] == ends[1], "second", "another point than the first")
    for name, values in zip(("first", "second"), ends, strict=True):
        table = table.set_column(table.column_names.index(name), name, pa.array(values, pa.string()))
    table = _filled(table, "repeat_sigma_mm", 0.0, pa.float64())
    table = _filled(table, "serves", "scale", pa.string())
    return SmallTable(_as_artifact("scale_bars", table), dict(found.left_out))


def read_known_points(source: CampaignFiles, targets: pa.Table | None, log: FaultLog) -> SmallTable | None:
    """Points whose coordinates are known, with their standard deviations; None where there are none."""
    import pyarrow as pa

    found = gather(source, KNOWN_POINTS, log, "pose")
    if found is None or lacks(found, KNOWN_POINTS.required):
        return None
    table = found.table
    point = _named(table, "point", targets)
    if {"body", "target"} <= set(table.column_names):
        both = zip(table.column("body").to_pylist(), table.column("target").to_pylist(), strict=True)
        named = np.array([f"{body}/{target}" if body and target else "" for body, target in both], dtype=object)
        point = np.where(named != "", named, point)
    found.fault(log, point == "", "point", "the name of a point, or body and target")
    if "point" in table.column_names:
        table = table.drop_columns("point")
    table = table.append_column("point", pa.array(point, pa.string()))
    for name in ("sigma_x_mm", "sigma_y_mm", "sigma_z_mm"):
        if name not in table.column_names or table.column(name).null_count:
            log.add(Fault(found.first_file, "a standard deviation in every row", column=name))
            return None
        check_sigma(found, _numbers(table, name), name, "mm", log)
    table = table.drop_columns([name for name in ("body", "target") if name in table.column_names])
    return SmallTable(_as_artifact("known_points", table), dict(found.left_out))


def lacks(found: Gathered, required: tuple[str, ...]) -> bool:
    """Whether columns are missing, which was told when the file was read."""
    return any(name not in found.table.column_names for name in required)


def _named(table: pa.Table, column: str, targets: pa.Table | None) -> NDArray[np.object_]:
    """Points by their own names, where a column may call them by their codes."""
    if column not in table.column_names:
        return np.full(len(table), "", dtype=object)
    return own_names(np.array([name or "" for name in table.column(column).to_pylist()], dtype=object), targets)[0]


def _numbers(table: pa.Table, name: str) -> NDArray[np.float64]:
    return np.asarray(table.column(name).to_numpy(zero_copy_only=False), dtype=float)


def _filled(table: pa.Table, name: str, value: object, kind: pa.DataType) -> pa.Table:
    import pyarrow as pa

    constant = pa.scalar(value, kind)
    if name not in table.column_names:
        return table.append_column(name, pa.repeat(constant, len(table)))
    return table.set_column(table.column_names.index(name), name, table.column(name).cast(kind).fill_null(constant))


def _as_artifact(name: str, table: pa.Table) -> pa.Table:
    """A table in the artifact's columns and types; what is wrong with it has been noted elsewhere."""
    import pyarrow as pa

    artifact = ARTIFACTS[name]
    names = [key for key in (*artifact.columns, *artifact.optional) if key in table.column_names]
    text = "pose" in names and pa.types.is_string(table.schema.field("pose").type)
    schema = artifact.arrow_schema("string" if text else "int64", tuple(names))
    return table.select(schema.names).cast(pa.schema([field.with_nullable(True) for field in schema]))


def check_codes(found: Gathered, boards: tuple[str, ...], log: FaultLog) -> None:
    """A fault at every family that no photograph is searched for, and at every code that its family does not have."""
    families = [family or "" for family in found.table.column("family").to_pylist()]
    codes = [code or "" for code in found.table.column("code").to_pylist()]
    named = ("circle", *FAMILIES, *boards)
    unknown = np.array([family not in named for family in families], dtype=bool)
    found.fault(log, unknown, "family", f"one of {', '.join(FAMILIES)}, or the name of a board")
    for family in sorted(set(families) & set(FAMILIES)):
        own = np.array([one == family for one in families], dtype=bool)
        absent = np.array([code not in _codes(family) for code in codes], dtype=bool)
        found.fault(log, own & absent, "code", f"one of the {len(_codes(family))} codes of {family}")


@cache
def _codes(family: str) -> frozenset[str]:
    if family in RINGS:
        from truing.estimation.image_targets.ring_codes import family_of_rings

        return frozenset(map(str, family_of_rings(family).numbers))
    from truing.estimation.image_targets.marker_codes import codes_of

    return frozenset(map(str, range(codes_of(family))))
