"""How the calibrations of a sensor compare, as table rows: fitted, held out, chosen, refused."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stages.responses.tables import Rows
from stages.sensor_calibration.contenders import SensorCalibrations
from stages.sensor_calibration.recorded import Recorded
from truing.estimation.sensor.held_out_loads import HeldOut


def choice_rows(found: Recorded, fitted: SensorCalibrations) -> Rows:
    """The figures of every contender, and why others could not contend."""
    rows = Rows("sensor_choice")
    equal = fitted.choice.choice.indistinguishable
    for k, one in enumerate(fitted.choice.contenders):
        chosen = k == fitted.choice.choice.chosen
        _figures(rows, fitted, one)
        for figure, value in (("chosen", chosen), ("indistinguishable", bool(equal[k]))):
            _add(rows, one, figure, None, float(value), "1")
        if chosen:
            _loads(rows, one, "verification_rms", fitted.verification, fitted)
            _add(rows, one, "tared", None, float(found.tared), "1")
            if found.causes:
                words = " and ".join(found.causes)
                rows.add(model=one.fit.model.name, figure="loads_as_diagnosed", value=1.0, unit="1", reason=words)
            _add(rows, one, "noise_ratio", None, one.fit.noise_ratio, "1")
    for model, why in fitted.choice.refused.items():
        rows.add(model=model, figure="refused", value=1.0, unit="1", reason=why)
    return rows


def _figures(rows: Rows, fitted: SensorCalibrations, one: HeldOut) -> None:
    _loads(rows, one, "heldout_rms", one.rms, fitted)
    if one.fit.model.direction == "direct":
        _loads(rows, one, "fitted_rms", np.sqrt(np.mean(one.fit.residuals**2, axis=0)), fitted)
    _add(rows, one, "heldout_log_density", None, one.log_density, "1")
    _add(rows, one, "heldout_chi_square", None, float(one.squares.sum()), "1")
    _add(rows, one, "heldout_freedom", None, float(one.freedom.sum()), "1")
    _add(rows, one, "parameters", None, float(one.fit.matrix.size + one.fit.zeros.size), "1")


def _loads(rows: Rows, one: HeldOut, figure: str, values: NDArray, fitted: SensorCalibrations) -> None:
    for name, value in zip(fitted.table.load_names, values, strict=True):
        if np.isfinite(value):
            _add(rows, one, figure, name, float(value), "N" if name.startswith("f") else "N m")


def _add(rows: Rows, one: HeldOut, figure: str, subject: str | None, value: float, unit: str) -> None:
    finite = value if np.isfinite(value) else None
    rows.add(model=one.fit.model.name, figure=figure, subject=subject, value=finite, unit=unit)
