"""Class `ExtendedSensor`: the identified compliance of a sensor with its effects; prediction of readings, and
model.toml.

Geometry and elasticity affect readings only through the compliance. In model.toml (see `model_text`) the covariance is
that of the compliance, row by row, and of the effects' values.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from truing.schemas.settings_text import Document
from truing.simulation.bench.causes.leg_stiffness import LegStiffness
from truing.simulation.bench.causes.reading_causes import ReadingCause
from truing.simulation.bench.causes.rows_exchanged import RowsExchanged
from truing.simulation.bench.known_readings import ChannelZeros, KnownReadings, Optics, ReadingConditions, SignalGains
from truing.simulation.bench.load_steps import CHANNELS, LOADS
from truing.simulation.bench.model import BenchModel
from truing.simulation.bench.six_upur.uncertain_sensor import UncertainSensor
from truing.simulation.catalogue import catalogue_of_readings
from truing.simulation.cause import Cause, Step
from truing.simulation.model_text import (
    IdentifiedInSI,
    context_of,
    covariance_from,
    describes,
    effects_of,
    exact,
    model_text,
    read_document,
    toml_value,
)

_AXES = 6


@dataclass(frozen=True)
class ExtendedSensor(IdentifiedInSI[ReadingCause]):
    """An identified sensor: compliance (6, 6), SI, whose entries come first in the covariance, row by row.

    ``nominal`` is the simulated compliance, ``largest`` (6,) the largest load of each axis. ``rows`` (6, 6): derivative
    of the bench's channels by the motion; ``share``: part of the elastic parameters' variance that is common to all
    legs.
    """

    compliance: NDArray
    nominal: NDArray
    largest: NDArray
    wavelength_m: float
    reference_temperature_c: float
    rows: NDArray = field(default_factory=lambda: np.eye(_AXES))
    share: float = 0.5


@dataclass(frozen=True)
class PredictedReadings:
    """Readings (B, 6), m and rad, without a run's zero, and their standard deviation by the model's uncertainty."""

    value: NDArray
    sigma: NDArray


def extended_sensor(model: BenchModel, shared: NDArray, covariance: NDArray, context: dict[str, str]) -> ExtendedSensor:
    """Return the extended model of a fit; shared (G,) with covariance (G, G), in prior sigmas."""
    known = model.known
    found = model.effects(shared)
    effects = tuple(one for one in found if not (concerns_signals(one.cause) or is_of_compliance(one.cause)))
    sigmas = [np.zeros((_AXES * _AXES, len(shared)))]
    for effect in effects:
        derivative = np.zeros((len(effect.values), len(shared)))
        derivative[:, model.layout[effect.cause.key]] = np.diag(model.effect_sigma(effect.cause))
        sigmas.append(derivative)
    by_unknown = np.concatenate(sigmas)
    sensor = known.sensor
    stiffness = shared[model.layout["stiffness"]]
    for name, response in (("geometry", sensor.by_geometry), ("stiffness", sensor.by_stiffness(stiffness))):
        by_unknown[: _AXES * _AXES, model.layout[name]] = response.compliance.reshape(-1, _AXES * _AXES).T
    identified = sensor.at(shared[model.layout["geometry"]], stiffness).compliance
    for one in found:
        if isinstance(one.cause, LegStiffness) and (legs := model.steps.legs) is not None:
            ratio, slope = one.cause.ratios(legs, one.values)
            derivative = slope @ identified * model.effect_sigma(one.cause)
            by_unknown[: _AXES * _AXES] = _multiplied(ratio, by_unknown[: _AXES * _AXES])
            by_unknown[: _AXES * _AXES, model.layout[one.cause.key]] = derivative.reshape(-1, 1)
            identified = ratio @ identified
    rows = known.optics.rows_at(shared[model.layout["optics"]])
    # Angles and arms change readings in the same way as a change of the compliance.
    by_angle = np.linalg.solve(rows, known.optics.by_angle) @ identified
    angles = np.arange(len(by_angle)) + model.layout["optics"].start
    by_unknown[: _AXES * _AXES, angles] = by_angle.reshape(-1, _AXES * _AXES).T
    nominal = sensor.at(np.zeros(sensor.geometry_size), np.zeros(sensor.stiffness_size)).compliance
    return ExtendedSensor(
        identified,
        nominal,
        known.largest,
        known.wavelength_m,
        known.reference_temperature_c,
        rows,
        sensor.share,
        effects=effects,
        covariance=by_unknown @ covariance @ by_unknown.T,
        context=context,
    )


def concerns_signals(cause: ReadingCause) -> bool:
    """True if a cause concerns only signals, and no readings of displacements."""
    return cause.subject.startswith("signal")


def is_of_compliance(cause: ReadingCause) -> bool:
    """True if a cause changes only the compliance, which then contains it."""
    return isinstance(cause, LegStiffness)


def _multiplied(ratio: NDArray, rows: NDArray) -> NDArray:
    """Return rows (36, G), each column a change of a compliance, after multiplication of the compliance by a ratio."""
    return np.asarray(np.einsum("ik,kjg->ijg", ratio, rows.reshape(_AXES, _AXES, -1)).reshape(rows.shape))


def predict_readings(extended: ExtendedSensor, conditions: ReadingConditions) -> PredictedReadings:
    """Return the readings of all six channels at some load steps, with the persistent effects."""
    causes = tuple(cause for cause in extended.causes if cause.is_persistent)
    model, shared = _model_at(extended, causes, conditions)
    value = model.points(shared, np.zeros((len(conditions.load), 0)))[..., 0]
    slopes = np.concatenate(
        [_derivative_by_compliance(extended, conditions, causes, shared), _derivative_by_effects(model, shared)], -1
    )
    indices = extended.places(causes)
    covariance = extended.covariance[np.ix_(indices, indices)]
    variance = np.einsum("bkp,pq,bkq->bk", slopes, covariance, slopes)
    return PredictedReadings(value, np.sqrt(np.maximum(variance, 0.0)))


def changes_loads(cause: Cause) -> bool:
    """True if a cause implies that the load at a step differs from the recorded one."""
    return cause.step is Step.DRIVE or isinstance(cause, RowsExchanged)


def drives(extended: ExtendedSensor) -> tuple[ReadingCause, ...]:
    """Return the persistent effects that change the wrench of a recorded load."""
    return tuple(cause for cause in extended.causes if cause.step is Step.DRIVE and cause.is_persistent)


def acting_wrenches(extended: ExtendedSensor, conditions: ReadingConditions) -> NDArray:
    """Return the true wrenches (B, 6) at the recorded loads, N and N m."""
    model, shared = _model_at(extended, drives(extended), conditions)
    return model.wrenches(shared, np.zeros((len(conditions.load), 0)))


def _model_at(
    extended: ExtendedSensor, causes: Sequence[ReadingCause], conditions: ReadingConditions
) -> tuple[BenchModel, NDArray]:
    """Return the model with some of the effects at load steps, and its shared unknowns (G,)."""
    model = _model(extended, extended.compliance, conditions).with_causes(causes)
    shared = np.zeros(model.shared_size)
    model.set_effects(shared, (effect for effect in extended.effects if effect.cause in causes))
    return model, shared


def _derivative_by_compliance(
    extended: ExtendedSensor, conditions: ReadingConditions, causes: Sequence[ReadingCause], shared: NDArray
) -> NDArray:
    """Return the derivatives (B, 6, 36) of readings by the compliance; the readings are linear in it, so differences
    are exact."""
    local = np.zeros((len(conditions.load), 0))
    size = np.sqrt(np.abs(np.outer(np.diag(extended.compliance), np.diag(extended.compliance))))
    points = _model(extended, extended.compliance, conditions).with_causes(causes).points(shared, local)[..., 0]
    derivatives = []
    for i, j in np.ndindex(_AXES, _AXES):
        changed = extended.compliance.copy()
        changed[i, j] += size[i, j]
        moved = _model(extended, changed, conditions).with_causes(causes).points(shared, local)[..., 0]
        derivatives.append((moved - points) / size[i, j])
    return np.stack(derivatives, -1)


def _derivative_by_effects(model: BenchModel, shared: NDArray) -> NDArray:
    """Return the derivatives (B, 6, P) of readings by the effects' parameters, SI."""
    by_shared = model.predict(shared, np.zeros((len(model.conditions.load), 0))).by_shared[:, :, 0]
    parts = [by_shared[..., model.layout[cause.key]] / model.effect_sigma(cause) for cause in model.causes]
    return np.concatenate(parts, -1) if parts else np.zeros((*by_shared.shape[:2], 0))


def _model(extended: ExtendedSensor, compliance: NDArray, conditions: ReadingConditions) -> BenchModel:
    """Return the model of an exact sensor with this compliance (6, 6), which need not be symmetric."""
    none = np.zeros(0, int)
    known = KnownReadings(
        UncertainSensor(None, None, compliance, np.zeros(5), 0.0),
        CHANNELS,
        np.ones(_AXES),
        extended.largest,
        np.zeros(_AXES),
        ChannelZeros(none, none, np.zeros(0), none.astype(bool)),
        SignalGains.none(),
        extended.wavelength_m,
        extended.reference_temperature_c,
        replace(Optics.plain(), rows=extended.rows),
    )
    return BenchModel(known, conditions)


MECHANISM = "6-upur"
_OWN = ("mechanism", "wavelength_nm", "reference_temperature_c", "largest_load", "common_share")
_HALF = 0.5  # common share if a model does not give it


def write_sensor(extended: ExtendedSensor) -> str:
    """Return the model as TOML text."""
    numbers: dict[str, object] = {
        "mechanism": MECHANISM,
        "wavelength_nm": extended.wavelength_m * 1e9,
        "reference_temperature_c": extended.reference_temperature_c,
        "largest_load": exact(extended.largest),
        "common_share": extended.share,
    }
    tables = ["", "[compliance]  # SI: m, rad by N, N m"]
    sigma = np.sqrt(np.diag(extended.covariance))[: _AXES * _AXES].reshape(_AXES, _AXES)
    for name, matrix in (("nominal", extended.nominal), ("identified", extended.compliance), ("sigma", sigma)):
        tables += [f"{name} = [", *_rows(matrix), "]"]
    if not np.array_equal(extended.rows, np.eye(_AXES)):
        tables += ["", "[beams]  # how channels (SI) follow dx .. rz of the platform's origin"]
        tables += ["rows = [", *_rows(extended.rows), "]"]
    names = [f"{channel}/{load}" for channel in CHANNELS for load in LOADS]
    return model_text(extended, numbers, tables, (), names=names, units="SI", legs=_AXES)


def _rows(matrix: NDArray) -> list[str]:
    return [f"  {toml_value(exact(row))}," for row in matrix]


def is_sensor(document: dict[str, object]) -> bool:
    """True if a parsed model.toml is that of a sensor."""
    return describes(document, MECHANISM)


def read_sensor(text: str) -> ExtendedSensor:
    """Read the model from a text of `write_sensor`; raises ValueError if the text is no such model."""
    return read_document(text, _from_document)


def _from_document(document: Document) -> ExtendedSensor:
    about, effects = document["model"], effects_of(document, catalogue_of_readings())
    return ExtendedSensor(
        _matrix(document["compliance"]["identified"]),
        _matrix(document["compliance"]["nominal"]),
        np.array(about["largest_load"], float),
        float(about["wavelength_nm"]) * 1e-9,
        float(about["reference_temperature_c"]),
        _matrix(document["beams"]["rows"]) if "beams" in document else np.eye(_AXES),
        float(about.get("common_share", _HALF)),
        effects=effects,
        covariance=covariance_from(document, _AXES * _AXES + sum(len(effect.values) for effect in effects)),
        context=context_of(document, _OWN),
    )


def _matrix(rows: object) -> NDArray:
    matrix = np.array(rows, float)
    if matrix.shape != (_AXES, _AXES):
        raise ValueError(f"model: found a matrix of shape {matrix.shape}, expected (6, 6)")
    return matrix
