"""What the diagnosis of an axis leaves: how far each reading is missed, and the extended model."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from truing.schemas.artifacts import ARTIFACTS
from truing.simulation.axis.extended_model import extended_axis, write_axis
from truing.simulation.axis.model import AxisModel
from truing.stages.common.axis_columns import SI

if TYPE_CHECKING:
    import pyarrow as pa

    from truing.inference.prediction import PredictionError
    from truing.inference.selection import Diagnosis
    from truing.schemas.campaign import Campaign
    from truing.stages.diagnosis.shown import Channels

_HELD = "verification"


def axis_artifacts(diagnosis: Diagnosis, channels: Channels, settings: Campaign) -> dict[str, Any]:
    """Return tables and text by artifact."""
    final = diagnosis.final
    unit = settings.mechanism.unit  # type: ignore[union-attr]
    context = {"campaign": settings.campaign.name}
    assert isinstance(final.model, AxisModel)
    extended = extended_axis(final.model, final.fit.shared, final.covariance(), context)
    return {"axis_errors": _errors(diagnosis, channels, unit), "model": write_axis(extended)}


def _errors(diagnosis: Diagnosis, channels: Channels, unit: str) -> pa.Table:
    """Rows of axis_errors.parquet: every reading without and with what was found."""
    import pyarrow as pa

    plain, final = diagnosis.plain, diagnosis.final
    floor = np.sqrt(final.floor.square) / channels.si
    rows = _rows("calibration", plain.error, final.error, channels, unit)
    if diagnosis.held_out is not None and plain.held_out is not None and final.held_out is not None:
        rows += _rows(_HELD, plain.held_out, final.held_out, channels, unit)
    place = {name: float(floor[k]) for k, name in enumerate(plain.model.channel_names)}
    rows = [{**row, "noise_floor": place[row["encoder"]]} for row in rows]
    identifier = "int64" if all(isinstance(row["pose"], int) for row in rows) else "string"
    return pa.Table.from_pylist(rows, schema=ARTIFACTS["axis_errors"].arrow_schema(identifier))


def _rows(
    role: str, before: PredictionError, after: PredictionError, channels: Channels, unit: str
) -> list[dict[str, Any]]:
    assert isinstance(before.model, AxisModel)
    names, own = before.model.channel_names, before.model.rows
    return [
        {
            "pose": own.poses[b],
            "role": role,
            "encoder": names[k],
            "command": float(own.command[b] / SI[unit]),
            "command_unit": unit,
            "approach": int(own.direction[b]),
            "missed_before": float(before.gap[b, k, 0] / channels.si[k]),
            "missed_after": float(after.gap[b, k, 0] / channels.si[k]),
            "unit": channels.units[k],
        }
        for b, k in np.argwhere(before.seen & after.seen)
    ]
