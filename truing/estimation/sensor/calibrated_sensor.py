"""A calibrated force sensor in use: wrenches with covariance from signals, and its calibration as a file.

Force-sensor paper, section 6: F = G_B V. The file (``sensor.toml``) holds the chosen calibration to full precision, so
that a program without truing can read it too.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from truing.arrays import Array, Mask
from truing.estimation.sensor.calibration import (
    Calibration,
    CalibrationModel,
    MatrixEstimate,
    Terms,
    calibration_matrix,
    wrenches,
)
from truing.estimation.sensor.contenders import HeldOutPredictions
from truing.estimation.sensor.load_table import LoadTable

FORMAT = 1
BEYOND = 1.05  # relative to the largest load of the calibration, beyond which its terms are untested
_STYLE = ("estimator", "direction", "zero", "drift", "gain", "powers", "ridge", "shrink")


@dataclass(frozen=True)
class Wrench:
    """Wrenches (N, W), N and N m, their covariance (N, W, W), and whether each is within the calibrated loads (N,).

    The covariance includes the noise of signals, of unloaded signals and of the calibration; not errors of the model,
    nor changes of the sensor since its calibration.
    """

    value: Array
    covariance: Array
    is_within: Mask

    @property
    def sigma(self) -> Array:
        """Standard deviations (N, W)."""
        return np.sqrt(np.einsum("nii->ni", self.covariance))


@dataclass(frozen=True)
class CalibratedSensor:
    """The chosen calibration of a sensor, for use with new signals.

    signal_cov (C, C), mV^2: of one row of signals. reference (K,): reference value of each covariate. largest (W,):
    largest load of the calibration. is_tared: whether signals are relative to unloaded ones of the same run.
    heldout_rms (W,): error of load cases outside the calibration, including model errors.
    """

    fit: Calibration
    load_names: tuple[str, ...]
    signal_names: tuple[str, ...]
    signal_cov: Array
    reference: Array
    largest: Array
    is_tared: bool
    heldout_rms: Array

    @property
    def covariate_names(self) -> tuple[str, ...]:
        """Covariates that the calibration needs, such as ``material_temperature``."""
        return self.fit.terms.covariates

    def wrench(
        self, signals: ArrayLike, covariates: ArrayLike | None = None, unloaded: ArrayLike | None = None
    ) -> Wrench:
        """Return the wrenches of signals (C,) or (N, C), mV.

        covariates (K,) or (N, K): as recorded. unloaded (M, C), mV: signals of the same run without load, whose mean is
        the zero of a tared sensor. Raises ValueError if one of the two is needed but not given, or for a wrong shape.
        """
        rows = _rows(signals, len(self.signal_names), "signals")
        known = self._covariates(covariates, len(rows))
        zero, spread = self._zero(unloaded)
        estimated = wrenches(self.fit, rows - zero, known, self.signal_cov * spread)
        within = np.all(np.abs(estimated.value) <= BEYOND * self.largest, axis=1)
        return Wrench(estimated.value, estimated.covariance, within)

    def _covariates(self, given: ArrayLike | None, count: int) -> Array:
        names = self.covariate_names
        if not names:
            return np.empty((count, 0))
        if given is None:
            raise ValueError(f"found no covariates, expected {', '.join(names)}, on which the calibration depends")
        return np.broadcast_to(_rows(given, len(names), "covariates"), (count, len(names))) - self.reference

    def _zero(self, unloaded: ArrayLike | None) -> tuple[Array, float]:
        """Return the zero (C,) and the factor by which its noise enlarges the signals' covariance."""
        if not self.is_tared:
            return np.zeros(len(self.signal_names)), 1.0
        if unloaded is None:
            raise ValueError("found no unloaded signals, expected some in each run, because zeros differ between runs")
        rows = _rows(unloaded, len(self.signal_names), "unloaded signals")
        return rows.mean(0), 1.0 + 1.0 / len(rows)

    @property
    def matrix(self) -> MatrixEstimate:
        """Return G_B (W, C), N or N m per mV, of the signals alone, with its covariance."""
        return calibration_matrix(self.fit, self.signal_cov)

    @property
    def offset(self) -> Array | None:
        """Return o (W,), N and N m, in F = G_B V + o at the reference of covariates.

        None if G_B and o are not the complete calibration: it has powers or interactions, or a zero per run.
        """
        model = self.fit.model
        if model.powers != "linear" or model.gain or model.drift or self.is_tared:
            return None
        if model.zero != "common":
            return np.zeros(len(self.load_names))
        zero = self.fit.zeros[:, 0]
        return zero if model.direction == "direct" else -self.matrix.value @ zero


def calibrated_sensor(
    held_out_predictions: HeldOutPredictions, table: LoadTable, reference_c: float, is_tared: bool
) -> CalibratedSensor:
    """Return the sensor of a fit to a table of calibration loads; raises ValueError if every case has its own zero."""
    fit = held_out_predictions.fit
    if fit.model.zero == "case":
        raise ValueError("found a calibration with a zero for every load case, expected one for all")
    if not (fit.model.drift or fit.model.gain):
        fit = replace(fit, terms=replace(fit.terms, covariates=()))
    count = table.signals.shape[1]
    noise = fit.noise if fit.model.direction == "forward" else np.zeros((count, count))
    cov = noise if table.signal_cov is None else table.signal_cov
    reference = np.full(len(fit.terms.covariates), reference_c)
    largest = np.abs(table.loads).max(axis=0)
    return CalibratedSensor(
        fit, table.load_names, table.signal_names, cov, reference, largest, is_tared, held_out_predictions.rms
    )


def sensor_text(sensor: CalibratedSensor, context: Mapping[str, str]) -> str:
    """Return a sensor as TOML; ``context``: origin of the calibration, for human readers."""
    return "\n".join([*_lines(sensor, context), ""])


def _lines(sensor: CalibratedSensor, context: Mapping[str, str]) -> Iterator[str]:
    fit, model = sensor.fit, sensor.fit.model
    direct = model.direction == "direct"
    yield "# A calibrated force sensor: N, N m and mV. Covariances are of the coefficients, row by row."
    yield "# " + ("load = coefficients . terms(signals)" if direct else "signals = coefficients . terms(load)")
    yield f"format = {FORMAT}"
    yield from ("", "[made_from]", *(f"{key} = {json.dumps(value)}" for key, value in context.items()))
    yield from ("", "[calibration]")
    yield from (f"{key} = {json.dumps(value)}" for key in _STYLE if (value := getattr(model, key)) is not None)
    yield f"is_tared = {json.dumps(sensor.is_tared)}"
    for key, names in (
        ("loads", sensor.load_names),
        ("signals", sensor.signal_names),
        ("covariates", sensor.covariate_names),
        ("terms", (*fit.terms.labels, *(("zero",) if model.zero == "common" else ()))),
    ):
        yield f"{key} = {json.dumps(list(names))}"
    for name, values in (
        ("covariate_reference", sensor.reference),
        ("largest_load", sensor.largest),
        ("heldout_rms", sensor.heldout_rms),
        ("coefficients", np.concatenate([fit.matrix, fit.zeros], axis=1)),
        ("signal_covariance", sensor.signal_cov),
        ("noise", fit.noise),
        ("covariance", fit.covariance),
    ):
        yield f"{name} = {json.dumps(np.asarray(values, float).tolist())}"
    if (offset := sensor.offset) is not None:
        yield from (
            "",
            "[matrix]  # load = G_B . signals + offset",
            f"G_B = {json.dumps(sensor.matrix.value.tolist())}",
        )
        yield f"offset = {json.dumps(offset.tolist())}"


def is_calibrated_sensor(document: Mapping[str, object]) -> bool:
    """True if a TOML document holds a calibrated sensor."""
    return isinstance(document.get("calibration"), dict)


def sensor_from(document: Mapping[str, Any]) -> CalibratedSensor:
    """Return the sensor in a TOML document; raises ValueError if there is none."""
    try:
        return _sensor(document["calibration"])
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(
            f"found no calibrated sensor ({error}), expected a sensor.toml that a run has written"
        ) from None


def _sensor(table: Mapping[str, Any]) -> CalibratedSensor:
    model = CalibrationModel(**{key: table[key] for key in _STYLE if key in table})
    loads, signals = tuple(table["loads"]), tuple(table["signals"])
    direct = model.direction == "direct"
    inputs, responses = (signals, loads) if direct else (loads, signals)
    terms = Terms(inputs, tuple(table["covariates"]), model.drift, model.gain, model.powers)
    coefficients = np.array(table["coefficients"], float).reshape(len(responses), -1)
    count = len(terms.labels)
    if coefficients.shape[1] != count + (model.zero == "common"):
        raise ValueError(f"{coefficients.shape[1]} coefficients in a row, expected {count} terms")
    size = coefficients.size
    fit = Calibration(
        model,
        terms,
        responses,
        coefficients[:, :count],
        coefficients[:, count:],
        np.array(table["covariance"], float).reshape(size, size),
        np.empty((0, len(responses))),
        np.array(table["noise"], float).reshape(len(responses), len(responses)),
        float("nan"),
        float("nan"),
    )
    cov = np.array(table["signal_covariance"], float).reshape(len(signals), len(signals))
    reference, largest, rms = (
        np.array(table[key], float) for key in ("covariate_reference", "largest_load", "heldout_rms")
    )
    return CalibratedSensor(fit, loads, signals, cov, reference, largest, bool(table["is_tared"]), rms)


def _rows(values: ArrayLike, width: int, what: str) -> NDArray[np.float64]:
    rows = np.atleast_2d(np.asarray(values, float))
    if rows.ndim != 2 or rows.shape[1] != width:
        raise ValueError(f"{what}: found shape {np.shape(values)}, expected ({width},) or (N, {width})")
    if not np.isfinite(rows).all():
        raise ValueError(f"{what}: found no number in {int((~np.isfinite(rows)).any(1).sum())} rows, expected numbers")
    return rows
