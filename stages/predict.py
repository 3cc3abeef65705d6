"""Prediction for new inputs: poses, readings under load, or wrenches from signals."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

from truing.schemas.artifacts import ARTIFACTS
from truing.schemas.covariates import own_name
from truing.schemas.faults import CampaignFaults, Fault
from truing.schemas.settings_text import parsed_toml

if TYPE_CHECKING:
    import pyarrow as pa

    from truing.simulation.mechanisms.extended_model import ExtendedModel, PredictedPoses
    from truing.simulation.mechanisms.recording import Conditions

# What predicts by the model of a mechanism that is neither of legs nor a sensor on its bench, by its name there.
_OF_MECHANISMS = {"axis": "truing.stages.axis.prediction", "chain": "truing.stages.chain.prediction"}


def predict(model: str, inputs: pa.Table, file: str = "configurations") -> pa.Table:
    """Return the prediction of a model.toml: poses for a table of configurations, readings for one of load steps or of
    commands of an axis; of a sensor.toml, the wrenches for a table of signals.

    Raises CampaignFaults where ``file`` lacks a column that is needed or holds no number in it, ValueError where the
    model is none.
    """
    from truing.estimation.sensor.calibrated_sensor import is_calibrated_sensor, sensor_from
    from truing.simulation.bench.extended_model import is_sensor, read_sensor

    document = parsed_toml(model)
    if is_calibrated_sensor(document):
        from truing.stages.sensor.wrenches_of_signals import wrenches_of_signals

        return wrenches_of_signals(sensor_from(document), inputs, file)
    about = document.get("model", {})
    if isinstance(about, dict) and (predict_own := _OF_MECHANISMS.get(str(about.get("mechanism")))) is not None:
        predicted: pa.Table = import_module(predict_own).predicted(model, inputs, file)
        return predicted
    if is_sensor(document):
        from truing.stages.sensor.predicted_readings import predicted_readings

        return predicted_readings(read_sensor(model), inputs, file)
    return _predicted_poses(model, inputs, file)


def _predicted_poses(model: str, configurations: pa.Table, file: str) -> pa.Table:
    """Return the poses, columns of poses.parquet, for a table of actuator readings.

    Needs the columns pose, rho1_mm .. rhoL_mm and those that the model's effects follow (a temperature, the time).
    """
    from truing.simulation.mechanisms.extended_model import predict_poses, read_model

    extended = read_model(model)
    conditions = _conditions(configurations, extended, file)
    predicted = predict_poses(extended, conditions)
    return _poses_table(configurations.column("pose"), predicted)


def _conditions(configurations: pa.Table, extended: ExtendedModel, file: str) -> Conditions:
    """Return the conditions, every column that the model needs being there and holding numbers."""
    from truing.simulation.mechanisms.extended_model import acts_on_poses
    from truing.stages.common.point_arrays import pose_ids
    from truing.stages.common.pose_conditions import pose_conditions

    model, legs = extended.model, extended.model.nominal.count
    needed = {f"rho{leg}_mm": f"the reading of leg {leg}" for leg in range(1, legs + 1)}
    for cause in filter(acts_on_poses, model.causes):
        needed |= {own_name(name): f"which {cause.id} follows" for name in cause.needs(legs) if name not in needed}
    _check(configurations, needed, file)
    return pose_conditions(configurations, pose_ids(configurations), model.nominal.count, model.known.reading_sigma)


def _check(configurations: pa.Table, needed: dict[str, str], file: str) -> None:
    """Raise CampaignFaults where a needed column (name to meaning) is missing, or a row of it holds no number."""
    import numpy as np

    from truing.stages.common.point_arrays import number_column

    wanted = {"pose": "the pose's name", **needed}
    missing = {name: what for name, what in wanted.items() if name not in configurations.schema.names}
    if missing:
        raise CampaignFaults(
            Fault(file, f"a column of that name, {what}", column=name) for name, what in missing.items()
        )
    names = list(needed)
    values = np.column_stack([number_column(configurations, name) for name in names])
    rows, columns = np.nonzero(~np.isfinite(values))
    if len(rows):
        first = 2 if file.endswith(".csv") else 1  # an editor counts the line of heads too
        raise CampaignFaults(
            Fault(file, "a number", row=int(row) + first, column=names[column], value=str(values[row, column]))
            for row, column in zip(rows, columns, strict=True)
        )


def _poses_table(poses: pa.ChunkedArray, predicted: PredictedPoses) -> pa.Table:
    import numpy as np
    import pyarrow as pa

    from truing.estimation.rotation import log_so3

    count, ok = len(poses), predicted.converged
    vectors = np.column_stack([predicted.p * 1e3, log_so3(predicted.R)])
    columns: dict[str, object] = {
        "pose": poses,
        "body": ["platform"] * count,
        "parent": ["base"] * count,
        "method": ["model"] * count,
        "default": [True] * count,
    }
    names = ("px_mm", "py_mm", "pz_mm", "rx_rad", "ry_rad", "rz_rad")
    columns |= {name: pa.array(vectors[:, i], mask=~ok) for i, name in enumerate(names)}
    columns |= {
        f"cov_{i}_{j}": pa.array(predicted.covariance[:, i, j], mask=~ok) for i in range(6) for j in range(i, 6)
    }
    columns |= {
        "rms_mm": pa.nulls(count, pa.float64()),
        "n_used": [0] * count,
        "n_rejected": [0] * count,
        "status": ["ok" if converged else "not-converged" for converged in ok],
    }
    identifier = "int64" if pa.types.is_integer(poses.type) else "string"
    schema = ARTIFACTS["poses"].arrow_schema(identifier)
    return pa.table({name: columns[name] for name in schema.names}).cast(schema)
