"""Displacement against load, axis by axis: measured and simulated side by side."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from stages.point_arrays import number_column
from stages.responses.tables import Rows
from stages.sensor.reading_arrays import CHANNELS, LOAD_COLUMNS, LOADS, READING_SI

if TYPE_CHECKING:
    import pyarrow as pa

    from stages.sensor.simulated_compliance import SimulatedCompliance

_MOVED = (*((f"d{axis}_mm", 1e-3) for axis in "xyz"), *((f"r{axis}_rad", 1.0) for axis in "xyz"))


def axis_curve_rows(displacement: pa.Table, simulated: SimulatedCompliance | None) -> Rows:
    """Cases whose load is along one axis alone, or none: every component that was measured (force-sensor paper,
    figures 12-17)."""
    load = np.nan_to_num(np.column_stack([number_column(displacement, name) for name in LOAD_COLUMNS]))
    moved = np.column_stack([number_column(displacement, name) * unit for name, unit in _MOVED])
    sigma = np.sqrt(np.column_stack([number_column(displacement, f"cov_{k}_{k}") for k in range(6)]))
    case = displacement.column("case").to_numpy()
    branch = np.array(displacement.column("branch").to_pylist(), object)
    rows = Rows("axis_curves")
    for a, axis in enumerate(LOADS):
        alone = (np.delete(load, a, axis=1) == 0.0).all(axis=1)
        if not np.any(load[alone, a]):
            continue
        for k, channel in enumerate(CHANNELS):
            at = np.flatnonzero(alone & np.isfinite(moved[:, k]))
            if not np.any(load[at, a]):
                continue
            model = {} if simulated is None else {
                "simulated": simulated.entries[k, a] * load[at, a] / READING_SI[k],
                "simulated_sigma": simulated.sigma[k, a] * np.abs(load[at, a]) / READING_SI[k],
            }  # fmt: skip
            rows.add(
                load=axis,
                channel=channel,
                case=case[at],
                branch=branch[at],
                applied=load[at, a],
                measured=moved[at, k] / READING_SI[k],
                sigma=sigma[at, k] / READING_SI[k],
                unit="um" if k < 3 else "arcsec",
                **model,
            )
    return rows
