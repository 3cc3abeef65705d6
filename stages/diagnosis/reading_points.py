"""Data of the diagnosis of a bench: readings and signals of load steps."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, cast

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from truing.arrays import TableRow
from truing.belonging.counted_times import merely_counts
from truing.estimation.interferometry.recorded_steps import CHANNELS, LOADS, READING_SI, RecordedSteps
from truing.estimation.interferometry.shared_inputs import LoadCourse
from truing.inference.blocks import BlockKind, group_numbers
from truing.inference.observations import Epochs, Frames, Observations
from truing.schemas.verdict import Relation
from truing.simulation.bench.causes.rows_exchanged import (
    RowsExchanged,
    confirmed_by_readings,
    exchanged_rows,
    scatter_of_signals,
)
from truing.simulation.bench.extended_model import changes_loads, extended_sensor, write_sensor
from truing.simulation.bench.known_readings import (
    KnownReadings,
    ReadingConditions,
    gains_of_steps,
    run_names,
    zeros_of_steps,
)
from truing.simulation.bench.model import BenchModel
from truing.simulation.bench.six_upur.uncertain_sensor import UncertainSensor
from truing.simulation.inputs import between_neighbours
from truing.stages.common.blocks import groupings_of
from truing.stages.common.declared_optics import declared_optics
from truing.stages.common.manual_decisions import excluded_words, manual_decisions, without_excluded
from truing.stages.common.nominal_sensor import nominal_sensor
from truing.stages.common.reading_arrays import LOAD_COLUMNS, load_steps
from truing.stages.diagnosis.diagnosis_data import Channels, DiagnosisData, InstrumentResults
from truing.stages.diagnosis.next_measurement import next_loads_of
from truing.stages.diagnosis.prior_campaign import changes_table
from truing.stages.diagnosis.residual_tables import errors_by_role, identified_table, plain_number, sensor_pull_tables

if TYPE_CHECKING:
    from truing.inference.fitted_model import FittedModel
    from truing.inference.selection import CauseDiagnosis
    from truing.schemas.campaign import Campaign
    from truing.schemas.mechanism import SensorMechanism
    from truing.simulation.bench.six_upur.nominal_sensor import NominalSensor
    from truing.simulation.effects_model import EffectsModel

Array = NDArray[np.float64]

_FEWEST_STEPS = 6
_MILLIVOLT = 1e-3
_MM = 1e-3


def reading_model(tables: Mapping[str, pa.Table], settings: Campaign) -> BenchModel:
    """Return the plain simulation at all load steps; raises ValueError with the reason if there is none."""
    steps = load_steps(tables)
    sensor = simulated_sensor(tables, settings, steps)
    sigma, _ = _noise(steps, settings, ())
    _, is_observed = _points(steps, sigma)
    determined = is_observed.any(1) & np.isfinite(steps.time_s)
    return BenchModel(
        _known_readings(sensor, steps, is_observed, sigma, determined, settings), _conditions(steps, determined)
    )


def assemble_readings(tables: Mapping[str, pa.Table], settings: Campaign) -> DiagnosisData:
    """Return the data of the diagnosis; raises ValueError with the reason if the campaign lacks them."""
    steps, out = without_excluded(load_steps(tables), settings)
    sensor = simulated_sensor(tables, settings, steps)
    exchanged = confirmed_by_readings(exchanged_rows(steps, ~steps.held_out), steps, sensor)
    sigma, words = _noise(steps, settings, exchanged)
    words += [text for text in (excluded_words(out),) if text]
    points, is_observed = _points(steps, sigma)
    protected = manual_decisions(steps, settings.keep, "kept").chosen
    # the load of an excluded step was still applied
    determined = (is_observed | out.chosen).any(1) & np.isfinite(steps.time_s)
    fitted, held_out = determined & ~steps.held_out, determined & steps.held_out
    if why := _why_too_little(steps, fitted, settings):
        raise ValueError(why)
    model = BenchModel(_known_readings(sensor, steps, is_observed, sigma, fitted, settings), _conditions(steps, fitted))
    applied, loaded = np.round(steps.load[fitted], 9) + 0.0, {BlockKind.RUN: steps.run[fitted]}
    groupings = groupings_of(applied, steps.time_s[fitted], None, loaded)
    units = (*(("um",) * 3), *(("arcsec",) * 3), *(("mV",) * steps.signal.shape[1]))
    return DiagnosisData(
        model,
        replace(
            _poses(steps, points, is_observed, sigma, fitted),
            kept=protected[fitted],
            repeats=group_numbers(applied),
            groupings=groupings,
        ),
        replace(_poses(steps, points, is_observed, sigma, held_out), kept=protected[held_out])
        if held_out.any()
        else None,
        "; ".join(words),
        _results,
        exchanged,
        model_text=_model_text,
        is_calibrated=changes_loads,
        shown=Channels(
            units,
            np.concatenate([READING_SI, np.full(steps.signal.shape[1], _MILLIVOLT)]),
            np.arange(len(units)) >= len(CHANNELS),
            held_out="held-out runs" if held_out.any() else _left_out_in_turn(steps.run[fitted]),
            is_noise_known=settings.noise.signal_mv is not None or bool(is_observed[:, : len(CHANNELS)].any()),
        ),
        relation=Relation.LOADS_READINGS if is_observed[:, : len(CHANNELS)].any() else Relation.LOADS_SIGNALS,
    )


def _left_out_in_turn(runs: NDArray[np.int_]) -> str:
    """Return the words for what cross-validation leaves out: runs, or parts of the only one."""
    return f"{'runs' if len(set(runs)) > 1 else 'load steps'} left out in turn"


def why_no_diagnosis_of_readings(tables: Mapping[str, pa.Table], settings: Campaign) -> str:
    """Reason why readings and signals cannot be compared with a simulation, without a fit; else empty."""
    steps, out = without_excluded(load_steps(tables), settings)
    try:
        simulated_sensor(tables, settings, steps)
    except ValueError as why:
        return str(why)
    if unknown := _without_noise(steps):
        return unknown
    moved = np.isfinite(steps.reading)
    signal = np.isfinite(steps.signal) & (settings.noise.signal_mv is not None or not moved.any())
    determined = (np.concatenate([moved, signal], 1) | out.chosen).any(1) & np.isfinite(steps.time_s)
    return _why_too_little(steps, determined & ~steps.held_out, settings)


def _without_noise(steps: RecordedSteps) -> str:
    declared = np.where(np.isfinite(steps.reading), steps.sigma, 1.0)
    unknown = [CHANNELS[k] for k in np.flatnonzero(~np.isfinite(declared).all(0))]
    return f"needs the noise of {', '.join(unknown)}: noise.linear_um, noise.angular_arcsec" if unknown else ""


def simulated_sensor(tables: Mapping[str, pa.Table], settings: Campaign, steps: RecordedSteps) -> UncertainSensor:
    """The sensor with its uncertain numbers; raises ValueError where its readings cannot be simulated.

    Signals alone need no compliance, and where they are compared with loads no geometry either.
    """
    moved = bool(np.isfinite(steps.reading).any())
    if not moved and not np.isfinite(steps.signal).any():
        raise ValueError("needs readings or signals")
    if settings.mechanism.type != "6-upur":
        if moved:
            raise ValueError("needs a [mechanism] whose compliance can be simulated")
        return UncertainSensor(None, None, np.zeros((len(LOADS), len(LOADS))))
    sensor = nominal_sensor(cast("SensorMechanism", settings.mechanism), tables.get("given_compliance"))
    if sensor.compliance is None and moved:
        raise ValueError("needs the elements of a leg, or a compliance_file")
    return _uncertain(sensor)


def _uncertain(sensor: NominalSensor) -> UncertainSensor:
    """Tolerances of the sensor: none of the elements for a given compliance, and no motion without compliance."""
    if sensor.compliance is None:
        return UncertainSensor(sensor.joints, None, np.zeros((len(LOADS), len(LOADS))), sensor.length_sigma)
    is_own_simulation = sensor.elastic is not None and sensor.compliance is sensor.elastic.compliance
    elastic, given = (sensor.elastic, None) if is_own_simulation else (None, sensor.compliance)
    return UncertainSensor(sensor.joints, elastic, given, sensor.length_sigma, sensor.stiffness_sigma)


def _why_too_little(steps: RecordedSteps, fitted: NDArray[np.bool_], settings: Campaign) -> str:
    """Reason why the number of steps or their loads are insufficient; else empty."""
    if fitted.sum() < _FEWEST_STEPS:
        return f"needs at least {_FEWEST_STEPS} load steps with readings, found {int(fitted.sum())}"
    if not (settings.signals.zero_mv is not None and steps.signal.size) and not _loads_change(steps, fitted):
        cures = "signals tared before each run ([signals] zero_mv), or one run for all files between two tarings"
        return f"needs loads that change within a run, because the zero of each run is unknown; else: {cures}"
    return ""


def _loads_change(steps: RecordedSteps, rows: NDArray[np.bool_]) -> bool:
    """True if any run has steps of different loads."""
    first = {run: np.flatnonzero(steps.run == run)[0] for run in np.unique(steps.run)}
    return bool(np.any(steps.load[rows] != steps.load[[first[run] for run in steps.run[rows]]]))


def _noise(steps: RecordedSteps, settings: Campaign, exchanged: tuple[RowsExchanged, ...]) -> tuple[Array, list[str]]:
    """One standard deviation (B, K) of every channel, m, rad, V; NaN for signals whose noise is not declared.

    Where there is nothing but signals, that is taken from their scatter.
    """
    declared = np.where(np.isfinite(steps.reading), steps.sigma, 1.0)
    if why := _without_noise(steps):
        raise ValueError(why)
    signal = settings.noise.signal_mv
    sigma = np.full(steps.signal.shape, np.nan if signal is None else signal * _MILLIVOLT)
    if signal is None and not np.isfinite(steps.reading).any():
        scatter = scatter_of_signals(steps, ~steps.held_out, exchanged)
        return np.concatenate([declared, np.broadcast_to(scatter, sigma.shape)], 1), []
    words = ["signals, whose noise is not declared"] if signal is None and steps.signal.size else []
    return np.concatenate([declared, sigma], 1), words


def _points(steps: RecordedSteps, sigma: Array) -> tuple[Array, NDArray[np.bool_]]:
    values = np.concatenate([steps.reading, steps.signal], 1)
    is_observed = np.isfinite(values) & np.isfinite(sigma)
    return np.where(is_observed, values, 0.0), is_observed


def _known_readings(
    sensor: UncertainSensor,
    steps: RecordedSteps,
    is_observed: NDArray[np.bool_],
    sigma: Array,
    fitted: NDArray[np.bool_],
    settings: Campaign,
) -> KnownReadings:
    typical = np.array(
        [
            np.median(channel_sigma[there]) if there.any() else 1.0
            for channel_sigma, there in zip(sigma.T, is_observed.T, strict=True)
        ]
    )
    noise, signals = settings.noise, settings.signals
    tared, sensitivity = signals.zero_mv, signals.sensitivity_mv_per_n
    gains = None if sensitivity is None else np.asarray(sensitivity, float) * _MILLIVOLT
    return KnownReadings(
        sensor,
        (*CHANNELS, *steps.signals),
        typical,
        largest_loads(steps, settings),
        np.array([noise.load_n] * 3 + [noise.load_nm] * 3),
        zeros_of_steps(steps, is_observed, fitted, typical, None if tared is None else tared * _MILLIVOLT),
        gains_of_steps(
            sensor, steps, is_observed[:, len(CHANNELS) :] & fitted[:, None], gains, signals.sensitivity_tolerance
        ),
        settings.interferometer.wavelength_nm * 1e-9,
        settings.mechanism.reference_temperature_c,
        declared_optics(settings.interferometer),
        {axis: tuple(_MM * part for part in arm) for axis, arm in settings.loading.units.arms_mm.items()},
    )


def largest_loads(steps: RecordedSteps, settings: Campaign) -> Array:
    """The largest load (6,) of each axis, N and N m: that of [loading], else the largest applied; 1 where none was."""
    declared = [getattr(settings.loading, name) for name in LOAD_COLUMNS]
    applied = np.abs(steps.load).max(0)
    return np.array(
        [given or (largest if largest > 0.0 else 1.0) for given, largest in zip(declared, applied, strict=True)]
    )


def _conditions(steps: RecordedSteps, rows: NDArray[np.bool_]) -> ReadingConditions:
    subset = steps.subset(rows)
    between = {name: between_neighbours(values, subset.time_s) for name, values in subset.covariates.items()}
    known = {name: values for name, values in between.items() if np.isfinite(values).all()}
    span = (float(np.nanmin(steps.time_s)), float(np.nanmax(steps.time_s)))
    is_timed = not merely_counts(steps.time_s, steps.step, steps.run)
    return ReadingConditions(run_names(subset), subset.step, subset.time_s, subset.load, known, span, is_timed)


def _poses(
    steps: RecordedSteps, points: Array, is_observed: NDArray[np.bool_], sigma: Array, rows: NDArray[np.bool_]
) -> Epochs:
    covariance = np.where(np.isfinite(sigma), sigma, 1.0)[rows] ** 2
    measured = Observations(points[rows][..., None], covariance[..., None, None], is_observed[rows])
    inputs = LoadCourse(steps.load[rows], steps.run[rows]).groups()
    return Epochs(measured, _conditions(steps, rows), Frames.of_numbers(int(rows.sum())), inputs=inputs)


def _model_text(fitted: FittedModel, settings: Campaign) -> str:
    """The extended model of a fit, as model.toml has it."""
    assert isinstance(fitted.model, BenchModel)
    context = {"campaign": settings.campaign.name}
    return write_sensor(extended_sensor(fitted.model, fitted.fit.shared, fitted.covariance(), context))


def _results(diagnosis: CauseDiagnosis, data: DiagnosisData[EffectsModel], settings: Campaign) -> InstrumentResults:
    """Errors of each reading, extended model, pulls of the sensor, changes, next loads."""
    assert isinstance(data.shown, Channels)
    final, next_measurement = diagnosis.final, next_loads_of(diagnosis, settings)
    assert isinstance(final.model, BenchModel)
    left = {
        "reading_errors": _errors_table(diagnosis, data.shown, settings),
        "model": _model_text(final, settings),
        **sensor_pull_tables(final.model.known.sensor.unknowns, diagnosis.plain, final),
        "changes": changes_table(final),
        "next_loads": next_measurement.table,
    }
    return InstrumentResults(left, next_measurement.advice)


def _errors_table(diagnosis: CauseDiagnosis, channels: Channels, settings: Campaign) -> pa.Table:
    """Rows of reading_errors.parquet: every reading without and with the findings."""
    floor = _floors(diagnosis, channels, settings)
    rows: list[TableRow] = []
    for role, before, after in errors_by_role(diagnosis):
        assert isinstance(before.model, BenchModel)
        names, conditions = before.model.channel_names, before.model.conditions
        rows += [
            {
                "run": plain_number(conditions.run[b]),
                "step": int(conditions.step[b]),
                "channel": names[k],
                "role": role,
                "missed_before": float(before.gap[b, k, 0] / channels.si[k]),
                "missed_after": float(after.gap[b, k, 0] / channels.si[k]),
                "unit": channels.units[k],
                "noise_floor": floor.get(names[k]),
            }
            for b, k in np.argwhere(before.is_observed)
        ]
    return identified_table("reading_errors", rows, "run", ("noise_floor",))


def _floors(diagnosis: CauseDiagnosis, channels: Channels, settings: Campaign) -> dict[str, float]:
    """Return the rms errors that noise alone leaves in each channel, in its unit; without signals of undeclared
    noise.

    Degrees of freedom of run zeros and fitted parameters are removed, and the noise of loads is included, as in the
    errors.
    """
    floor = diagnosis.final.floor
    declared = ~channels.signal | (settings.noise.signal_mv is not None)
    size = np.sqrt(floor.square) / channels.si
    names = diagnosis.final.model.channel_names
    return {names[k]: float(size[k]) for k in np.flatnonzero(declared & (floor.observations > 0))}
