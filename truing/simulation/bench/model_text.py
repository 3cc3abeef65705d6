"""The extended model of a sensor as text, see `model_text`: its compliance, and how its bench sees motion.

The covariance is that of the compliance, row by row, and of the effects' values.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from truing.simulation.bench.extended_sensor import ExtendedSensor
from truing.simulation.bench.load_steps import CHANNELS, LOADS
from truing.simulation.catalogue import catalogue_of_readings
from truing.simulation.model_text import (
    context_of,
    covariance_from,
    effects_of,
    exact,
    model_text,
    read_document,
    toml_value,
)

MECHANISM = "6-upur"
_AXES = 6
_OWN = ("mechanism", "wavelength_nm", "reference_temperature_c", "largest_load", "common_share")
_HALF = 0.5  # what was in common where a model does not say so


def write_sensor(extended: ExtendedSensor) -> str:
    """Return the model as TOML text."""
    numbers: dict[str, Any] = {
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


def is_sensor(document: dict[str, Any]) -> bool:
    """Return whether a parsed model.toml is that of a sensor."""
    about = document.get("model", {})
    return isinstance(about, dict) and about.get("mechanism") == MECHANISM


def read_sensor(text: str) -> ExtendedSensor:
    """Return the model that a text of `write_sensor` describes; raises ValueError where it does not describe one."""
    return read_document(text, _from_document)


def _from_document(document: dict[str, Any]) -> ExtendedSensor:
    about, effects = document["model"], effects_of(document, catalogue_of_readings())
    return ExtendedSensor(
        _matrix(document["compliance"]["identified"]),
        _matrix(document["compliance"]["nominal"]),
        tuple(effect.cause for effect in effects),
        tuple(effect.values for effect in effects),
        covariance_from(document, _AXES * _AXES + sum(len(effect.values) for effect in effects)),
        np.array(about["largest_load"], float),
        float(about["wavelength_nm"]) * 1e-9,
        float(about["reference_temperature_c"]),
        context_of(document, _OWN),
        _matrix(document["beams"]["rows"]) if "beams" in document else np.eye(_AXES),
        float(about.get("common_share", _HALF)),
    )


def _matrix(rows: Any) -> NDArray:
    found = np.array(rows, float)
    if found.shape != (_AXES, _AXES):
        raise ValueError(f"model: found a matrix of shape {found.shape}, expected (6, 6)")
    return found
