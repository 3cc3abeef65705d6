"""Stages that the rows of an axis allow, determined without a fit."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa

from truing.arrays import Mask
from truing.estimation.interferometry.iso230 import is_in_motion
from truing.simulation.axis.rows import AxisRows
from truing.stages.common.axis_columns import columns_of, command_sigma, targets_of
from truing.stages.common.missing_data import HELD_OUT, NO_BODIES, NO_CALIBRATION

if TYPE_CHECKING:
    from truing.schemas.campaign import Campaign

_FEWEST_ROWS, _FEWEST_TARGETS = 6, 2
FEW_TARGETS = "fewer than two commands were approached from both sides"
IN_MOTION = "recorded in motion, and the standard asks for an axis at rest at each target"


def prospects(settings: Campaign, tables: Mapping[str, pa.Table]) -> Iterator[tuple[str, str, str]]:
    """Yield for each stage its name, the reason why it evaluates nothing (else empty), and its result."""
    kind = settings.mechanism.type
    yield "pose", NO_BODIES[kind], ""
    why = NO_BODIES[kind]
    if "configurations" in tables:
        table = tables["configurations"]
        why = why_no_positioning(columns_of(settings, table).rows(table, command_sigma(settings)))
    yield "deformation", why, "positioning by ISO 230-2"
    why = why_no_diagnosis(tables, settings)
    without = "" if why else "; ".join(undetectable_causes(tables, settings))
    yield "diagnose", why, f"cannot show {without}" if without else ""
    yield "calibrate", NO_CALIBRATION[kind], ""


def why_no_diagnosis(tables: Mapping[str, pa.Table], settings: Campaign) -> str:
    """Reason why the rows of an axis allow no diagnosis; else empty."""
    if "configurations" not in tables or not tables["configurations"].num_rows:
        return "no rows of the axis"
    table = tables["configurations"]
    columns = columns_of(settings, table)
    if not columns.encoders:
        return "no encoder was recorded"
    fitted = np.isfinite(columns.deviations(table)).any(1) & ~is_held_out(table)
    if fitted.sum() < _FEWEST_ROWS:
        return f"needs at least {_FEWEST_ROWS} rows with readings that may be fitted, found {int(fitted.sum())}"
    if not np.ptp(columns.si(table, columns.command)[fitted]) > 0.0:
        return f"the command {columns.command} never changes: nothing moved"
    return ""


def why_no_positioning(rows: AxisRows) -> str:
    """Reason why the rows of an axis are no test by ISO 230-2; else empty."""
    target, number = targets_of(rows.command)
    sides = [set(rows.direction[number == k]) for k in range(len(target))]
    if sum(len(side) > 1 for side in sides) < _FEWEST_TARGETS:
        return FEW_TARGETS
    in_time = np.argsort(rows.order, kind="stable")
    return IN_MOTION if is_in_motion(rows.command[in_time], rows.time_s[in_time]) else ""


def undetectable_causes(tables: Mapping[str, pa.Table], settings: Campaign) -> tuple[str, ...]:
    """Causes that the rows cannot show, each with the reason."""
    table = tables["configurations"]
    columns = columns_of(settings, table)
    undetectable = []
    if not np.ptp(columns.rows(table, command_sigma(settings)).direction) > 0.0:
        undetectable.append("lost-motion: all rows were approached from one side")
    elif tuple(columns.encoders) == (columns.loop,):
        undetectable.append(
            f"any: only the encoder in the feedback loop ({columns.loop}) was recorded, which follows the command"
        )
    return tuple(undetectable)


def is_held_out(table: pa.Table) -> Mask:
    """Mask (N,) of the rows that are not fitted."""
    return np.array([role == HELD_OUT for role in table.column("role").to_pylist()], bool)
