"""What is known of each pose beside its points: readings, covariates, and the direction from which actuators came."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from stages.point_arrays import number_column, positions
from truing.simulation.causes.unexplained import APPROACH, OWN_DRIVE, Unexplained
from truing.simulation.point_model import Conditions

if TYPE_CHECKING:
    import pyarrow as pa

# An actuator's direction of approach is that of its last movement larger than so many reading sigmas.
_MOVED = 5.0
# Degree of the polynomials that stand for any smooth dependence.
_DEGREE = 3


def pose_conditions(
    configurations: pa.Table, poses: tuple[int | str, ...], legs: int, reading_sigma: float
) -> Conditions:
    """Readings (B, L) in m and covariates by column; NaN where a pose has none; directions where poses have a time."""
    place = positions(configurations.column("pose"), poses)

    def dense(values: NDArray) -> NDArray:
        found = np.full((len(poses), *values.shape[1:]), np.nan)
        found[place[place >= 0]] = values[place >= 0]
        return found

    names = [f"rho{leg}_mm" for leg in range(1, legs + 1)]
    readings = dense(np.column_stack([number_column(configurations, name) for name in names]) * 1e-3)
    covariates = {
        field.name: dense(number_column(configurations, field.name))
        for field in configurations.schema
        if field.name not in ("pose", "role", *names) and _is_number(field.type)
    }
    if "time_s" in covariates:
        covariates[APPROACH] = approach(readings, covariates["time_s"], _MOVED * reading_sigma)
    return Conditions(readings, covariates)


def _is_number(kind: pa.DataType) -> bool:
    import pyarrow as pa

    return bool(pa.types.is_floating(kind) or pa.types.is_integer(kind))


def approach(readings: NDArray, time: NDArray, least: float) -> NDArray:
    """Direction (B, L) of each actuator's last movement larger than ``least`` (m) in time order; +1 before any."""
    order = np.argsort(time, kind="stable")
    steps = np.diff(readings[order], axis=0, prepend=readings[order][:1])
    moved = np.abs(np.nan_to_num(steps)) > least
    last = np.maximum.accumulate(np.where(moved, np.arange(len(order))[:, None], -1), axis=0)
    signs = np.take_along_axis(np.sign(steps), np.maximum(last, 0), 0)
    direction = np.ones_like(readings)
    direction[order] = np.where(last >= 0, signs, 1.0)
    return direction


def chosen(conditions: Conditions, rows: NDArray) -> Conditions:
    """The conditions of some poses."""
    return Conditions(conditions.readings[rows], {name: value[rows] for name, value in conditions.covariates.items()})


def unexplained_causes(conditions: Conditions, rho0: NDArray) -> list[Unexplained]:
    """What the legs may follow without a cause of the catalogue: own drive, direction, every covariate that varies."""
    moved = conditions.readings - rho0
    found = []
    for name, values in {OWN_DRIVE: moved, **conditions.covariates}.items():
        distinct = len(np.unique(values))
        if not np.isfinite(values).all() or distinct < 2:
            continue
        centre, half = (values.max() + values.min()) / 2, (values.max() - values.min()) / 2
        if name == OWN_DRIVE:
            centre, half = 0.0, np.abs(values).max()
        degrees = {1, min(_DEGREE, distinct - 1)}
        found += [Unexplained(name, float(centre), float(half), degree) for degree in sorted(degrees)]
    return found
