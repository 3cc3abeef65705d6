"""Tables of a design: readings of given configurations, and the chosen ones in order of measurement."""

from __future__ import annotations

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from truing.calibration.configuration_search import AssessedConfigurations, DesignProblem, assessed
from truing.estimation.design.pose_order import PoseOrder
from truing.schemas.faults import CampaignFaults, Fault
from truing.stages.common.point_arrays import number_columns
from truing.stages.common.reading_arrays import LOAD_COLUMNS
from truing.stages.configurations.chosen import DesignOptions

STEPS_PER_RUN = 10  # loads between two readings without load, to determine zero and drift of every run


def readings_of(table: pa.Table, legs: int, file: str) -> NDArray:
    """Readings (N, L), m, of all poses except those for verification; raises CampaignFaults for faulty ones."""
    names = [f"rho{leg + 1}_mm" for leg in range(legs)]
    missing = [name for name in names if name not in table.schema.names]
    if missing:
        raise CampaignFaults(Fault(file, "a column of that name", column=name) for name in missing)
    if "role" in table.schema.names:
        role = table.column("role").cast(pa.string())
        table = table.filter(pc.fill_null(pc.not_equal(role, "verification"), True))
    try:
        values = number_columns(table, names) * 1e-3
    except ValueError:
        raise CampaignFaults([Fault(file, "numbers", column="rho1_mm ..")]) from None
    if not np.isfinite(values).all():
        raise CampaignFaults([Fault(file, "a reading of every actuator in every pose")])
    return values


def existing_configurations(problem: DesignProblem, table: pa.Table | None) -> AssessedConfigurations | None:
    """The campaign's own calibration poses, evaluated by the same measure; None if impossible."""
    if table is None:
        return None
    try:
        rho = readings_of(table, problem.legs, "configurations")
        return assessed(problem, rho) if len(rho) >= len(problem.names) else None
    except (CampaignFaults, ValueError):
        return None


def configurations_table(
    rho: NDArray, order: PoseOrder, reference_rho: NDArray | None, options: DesignOptions, extend: pa.Table | None
) -> pa.Table:
    """Configurations in the order of measurement, without times, after ``reference_rho`` (L,), m, if given."""
    roles = np.repeat(["calibration", "verification"], [options.poses, options.verification])[order.order].tolist()
    values, first = rho[order.order], first_number(extend)
    if reference_rho is not None:
        roles, values, first = ["reference", *roles], np.concatenate([reference_rho[None], values]), 0
    columns: dict[str, object] = {
        "pose": pa.array(np.arange(len(values)) + first),
        "role": pa.array(roles, pa.string()),
        "time_s": pa.nulls(len(values), pa.float64()),
    }
    return pa.table(columns | {f"rho{i + 1}_mm": np.round(column * 1e3, 6) for i, column in enumerate(values.T)})


def first_number(extend: pa.Table | None) -> int:
    """First free number of a pose."""
    if extend is None or "pose" not in extend.schema.names or not pa.types.is_integer(extend.schema.field("pose").type):
        return 1
    return int(pc.max(extend.column("pose")).as_py() or 0) + 1


def loads_table(loads: NDArray, check: NDArray) -> pa.Table:
    """Runs of some loads each, loads (N, 6) and then those for verification (V, 6), without load before and after;
    times still empty."""
    none = np.zeros((1, loads.shape[1]))
    parts, roles = [], []
    for role, values in (("calibration", loads), ("verification", check)):
        for first in range(0, len(values), STEPS_PER_RUN):
            parts.append(np.concatenate([none, values[first : first + STEPS_PER_RUN], none]))
            roles += [role] * len(parts[-1])
    columns: dict[str, object] = {
        "run": pa.array(np.repeat(np.arange(len(parts)) + 1, [len(part) for part in parts]), pa.int64()),
        "step": pa.array(np.concatenate([np.arange(len(part)) for part in parts]), pa.int64()),
        "time_s": pa.nulls(len(roles), pa.float64()),
        "role": pa.array(roles, pa.string()),
    }
    rounded = np.round(np.concatenate(parts), 6) + 0.0
    return pa.table(columns | dict(zip(LOAD_COLUMNS, rounded.T, strict=True)))
