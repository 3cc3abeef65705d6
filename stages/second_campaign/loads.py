"""Readings and loads of a second bench campaign, predicted by simulation, G_B and extended model."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, cast

import numpy as np
import pyarrow as pa

from truing.estimation.interferometry.recorded_steps import (
    CHANNELS,
    LOADS,
    READING_SI,
    READING_UNITS,
    RecordedSteps,
)
from truing.estimation.sensor.calibrate import fit_calibration
from truing.estimation.sensor.contenders import contenders, predicted_loads
from truing.schemas.covariates import own_name
from truing.simulation.bench.extended_model import ExtendedSensor, predict_readings, read_sensor
from truing.simulation.bench.known_readings import ReadingConditions, run_names
from truing.stages.common.applied_findings import applied_findings
from truing.stages.common.manual_decisions import without_excluded
from truing.stages.common.nominal_sensor import nominal_sensor
from truing.stages.common.reading_arrays import load_steps
from truing.stages.common.recorded_signals import recorded, recorded_elsewhere, recorded_with_other_loads
from truing.stages.second_campaign.compared import CALIBRATED, EXTENDED, NOMINAL, PredictionErrors, SecondCampaign

if TYPE_CHECKING:
    from truing.estimation.sensor.load_table import RecordedLoads
    from truing.schemas.campaign import Campaign
    from truing.schemas.mechanism import SensorMechanism

_SAME = 1e-6  # relative, of the compliance
_UNITS = {"f": "N", "m": "N m"}


def predicted_readings(text: str, second: SecondCampaign) -> Iterator[PredictionErrors]:
    """Yield errors of displacements (um, arcsec), each run and channel counted from its own mean, by simulation and
    extended model.

    Raises CampaignFaults where the second campaign is of another sensor, ValueError where it holds no load step.
    """
    extended = read_sensor(text)
    steps, _ = without_excluded(load_steps(second.tables), second.settings)
    if not np.isfinite(steps.reading).any():
        return
    _check(extended, second)
    size = extended.compliance.size
    alone = replace(extended, compliance=extended.nominal, effects=(), covariance=extended.covariance[:size, :size])
    names = [cause.id for cause in extended.causes if cause.is_persistent]
    words = f"with {', '.join(dict.fromkeys(names))}" if names else "compliance as identified"
    for by, model, sentence in ((NOMINAL, alone, "compliance as simulated"), (EXTENDED, extended, words)):
        missed = _without_zeros(steps.reading - predict_readings(model, _conditions(model, steps)).value, steps)
        for k, channel in enumerate(CHANNELS):
            sigma = steps.sigma[np.isfinite(missed[:, k]), k]
            noise = float(np.sqrt(np.mean(sigma**2)) / READING_SI[k]) if len(sigma) else None
            yield PredictionErrors(by, sentence, channel, READING_UNITS[k], missed[:, k] / READING_SI[k], noise)


def _check(extended: ExtendedSensor, second: SecondCampaign) -> None:
    """Raise CampaignFaults where the simulated compliance is not that of the model."""
    compliance = second.tables.get("given_compliance")
    section = cast("SensorMechanism", second.settings.mechanism)
    own_value = None
    if section.type == "6-upur":
        own_value = nominal_sensor(
            section, compliance if compliance is not None and compliance.num_rows else None
        ).compliance
    if own_value is None:
        raise second.refuse("mechanism", "the elements of a leg, or a compliance_file, as the first campaign has them")
    scale = np.sqrt(np.abs(np.outer(np.diag(extended.nominal), np.diag(extended.nominal))))
    if np.any(np.abs(own_value - extended.nominal) > _SAME * scale):
        raise second.refuse("mechanism", "the sensor of the model, with the same simulated compliance")


def _conditions(model: ExtendedSensor, steps: RecordedSteps) -> ReadingConditions:
    """Conditions of the steps; raises ValueError where a column is missing that an effect follows."""
    known = {name: values for name, values in steps.covariates.items() if np.isfinite(values).all()}
    needed = {name for cause in model.causes if cause.is_persistent for name in cause.needs(len(CHANNELS))}
    used_columns = {"time_s", *LOADS, *steps.covariates}
    if missing := sorted(own_name(name) for name in needed - used_columns):
        raise ValueError(f"the extended model follows {', '.join(missing)}, which the second campaign does not hold")
    span = (float(np.nanmin(steps.time_s)), float(np.nanmax(steps.time_s)))
    return ReadingConditions(run_names(steps), steps.step, steps.time_s, steps.load, known, span)


def _without_zeros(missed: np.ndarray, steps: RecordedSteps) -> np.ndarray:
    """Return errors (B, 6) minus the mean of their run and channel, which is the run's zero."""
    left = missed.copy()
    for run in np.unique(steps.run):
        rows_of_run = steps.run == run
        is_observed = np.isfinite(left[rows_of_run])
        count = np.maximum(is_observed.sum(0), 1)
        left[rows_of_run] -= np.where(is_observed, left[rows_of_run], 0.0).sum(0) / count
    return left


def predicted_by_matrix(
    tables: Mapping[str, pa.Table], settings: Campaign, second: SecondCampaign
) -> Iterator[PredictionErrors]:
    """Yield errors of loads (N, N m) by the calibration of the data as recorded, and with findings applied.

    The latter is compared with the loads that act by the persistent findings. Raises CampaignFaults where
    the second campaign is of another sensor, ValueError with the reason where G_B predicts nothing of it.
    """
    if not all(
        "signals" in tables_of_campaign and tables_of_campaign["signals"].num_rows
        for tables_of_campaign in (tables, second.tables)
    ):
        return
    main, beside = recorded(tables, settings), recorded_with_other_loads(tables, settings)
    models = _chosen_models(tables)
    for loads in (one for one in (main, beside) if one is not None):
        name = models["main" if loads is main else "beside"]
        text = applied_findings(tables).text if loads.causes else None
        by = EXTENDED if loads.causes else CALIBRATED
        loads_of_second = recorded_elsewhere(second.tables, second.settings, text, loads.tared)
        if loads_of_second.signal.shape[1] != loads.signal.shape[1]:
            wanted = f"{loads.signal.shape[1]} signals, as the first campaign has them"
            raise second.refuse("files.signals", wanted, f"{loads_of_second.signal.shape[1]} signals")
        yield from _errors_by_matrix(loads, loads_of_second, name, by)


def _chosen_models(tables: Mapping[str, pa.Table]) -> dict[str, str]:
    """Return the names of the chosen models: of the main calibration, and of the alternative one."""
    rows = tables["sensor_matrix"].to_pylist() if "sensor_matrix" in tables else []
    main = next((row["model"] for row in rows if row["chosen"] and row["matrix"] == "G_B"), None)
    if main is None:
        raise ValueError("no G_B was calibrated in the first campaign")
    compared = tables["calibrations_compared"].to_pylist() if "calibrations_compared" in tables else []
    beside = next((row["model"] for row in compared if not row["is_main"]), main)
    return {"main": cast("str", main), "beside": cast("str", beside)}


def _errors_by_matrix(
    recorded_loads: RecordedLoads, loads_of_second: RecordedLoads, name: str, by: str
) -> Iterator[PredictionErrors]:
    model = next(model for model in contenders(recorded_loads) if model.name == name)
    if loads_of_second.covariate_names != recorded_loads.covariate_names:
        if model.drift or model.gain:
            raise ValueError(
                f"G_B follows {recorded_loads.covariate_names[0]}, which the second campaign does not hold"
            )
        unused = np.zeros((len(loads_of_second.steps.run), recorded_loads.covariate.shape[1]))
        loads_of_second = replace(loads_of_second, covariate=unused, covariate_names=recorded_loads.covariate_names)
    table = recorded_loads.table(~recorded_loads.steps.held_out, recorded_loads.steps.run)
    asked = loads_of_second.table(np.ones(len(loads_of_second.steps.run), bool), loads_of_second.steps.run)
    missed = asked.loads - predicted_loads(fit_calibration(table, model), asked).value
    words = (
        f"{name}, against the loads that act with {' and '.join(recorded_loads.causes)}"
        if recorded_loads.causes
        else name
    )
    for k, load in enumerate(table.load_names):
        yield PredictionErrors(by, words, load, _UNITS[load[0]], missed[:, k])
