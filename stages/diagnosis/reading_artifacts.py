"""What the stage diagnose leaves of readings: how far each is missed, the extended model, the pulls of the sensor."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from truing.schemas.artifacts import ARTIFACTS
from truing.simulation.bench.model import ReadingModel
from truing.stages.diagnosis.pull_tables import Belief, sensor_pull_tables

if TYPE_CHECKING:
    import pyarrow as pa

    from truing.inference.fitted_model import FittedModel
    from truing.inference.prediction import PredictionError
    from truing.inference.selection import Diagnosis
    from truing.schemas.campaign import Campaign
    from truing.stages.diagnosis.shown import Channels


def of_readings(diagnosis: Diagnosis, channels: Channels, settings: Campaign) -> dict[str, Any]:
    """Tables and text by artifact."""
    from truing.simulation.bench.extended_model import extended_sensor, write_sensor

    final = diagnosis.final
    assert isinstance(final.model, ReadingModel)
    context = {"campaign": settings.campaign.name}
    text = write_sensor(extended_sensor(final.model, final.fit.shared, final.covariance(), context))
    names = final.model.known.sensor.unknowns
    pulled = sensor_pull_tables(names, _belief(diagnosis.plain), _belief(final))
    return {"reading_errors": _errors_table(diagnosis, channels, settings), "model": text, **pulled}


def _belief(stand: FittedModel) -> Belief:
    """How far the sensor's unknowns moved in a fit."""
    layout = stand.model.layout
    own = np.r_[layout["geometry"], layout["stiffness"]]
    return Belief(stand.fit.shared[own], stand.covariance()[np.ix_(own, own)])


def _errors_table(diagnosis: Diagnosis, channels: Channels, settings: Campaign) -> pa.Table:
    """Rows of reading_errors.parquet: every reading without and with what was found."""
    import pyarrow as pa

    plain, final = diagnosis.plain, diagnosis.final
    rows = _rows("calibration", plain.error, final.error, channels)
    if diagnosis.held_out is not None and plain.held_out is not None and final.held_out is not None:
        rows += _rows("verification", plain.held_out, final.held_out, channels)
    floor = _floors(diagnosis, channels, settings)
    rows = [{**row, "noise_floor": floor.get(row["channel"])} for row in rows]
    identifier = "int64" if all(isinstance(row["run"], int) for row in rows) else "string"
    schema = ARTIFACTS["reading_errors"].arrow_schema(identifier, present=("noise_floor",))
    return pa.Table.from_pylist(rows, schema=schema)


def _floors(diagnosis: Diagnosis, channels: Channels, settings: Campaign) -> dict[str, float]:
    """What declared noise alone leaves in the errors of each channel, in its unit; without signals of undeclared noise.

    One zero per run and the fitted numbers are taken out of it, and the noise of loads is in it, as in the errors.
    """
    floor = diagnosis.final.floor
    declared = ~channels.signal | (settings.noise.signal_mv is not None)
    size = np.sqrt(floor.square) / channels.si
    names = diagnosis.final.model.channel_names
    return {names[k]: float(size[k]) for k in np.flatnonzero(declared & (floor.seen > 0))}


def _rows(role: str, before: PredictionError, after: PredictionError, channels: Channels) -> list[dict[str, Any]]:
    assert isinstance(before.model, ReadingModel)
    names, conditions = before.model.channel_names, before.model.conditions
    return [
        {
            "run": conditions.run[b].item() if hasattr(conditions.run[b], "item") else conditions.run[b],
            "step": int(conditions.step[b]),
            "channel": names[k],
            "role": role,
            "missed_before": float(before.gap[b, k, 0] / channels.si[k]),
            "missed_after": float(after.gap[b, k, 0] / channels.si[k]),
            "unit": channels.units[k],
        }
        for b, k in np.argwhere(before.seen)
    ]
