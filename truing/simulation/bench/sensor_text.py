"""The extended model of a sensor as text: TOML for people and for `read_sensor`, every number to full precision.

Effects have parameters in the tables' units, and beside them ``values`` in SI. The covariance is that of the
compliance, row by row, and of the effects' values.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from schemas.settings_text import parsed_toml
from truing.simulation.bench.extended_sensor import ExtendedSensor
from truing.simulation.bench.reading_state import CHANNELS, LOADS
from truing.simulation.cause import Effect
from truing.simulation.causes import catalogue_of_readings
from truing.simulation.effect_text import (
    cause_of,
    covariance_lines,
    covariance_of,
    effect_lines,
    exact,
    toml_key,
    toml_value,
)

FORMAT = 2
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
    about = [f"{toml_key(key)} = {toml_value(value)}" for key, value in {**extended.context, **numbers}.items()]
    lines = [f"format = {FORMAT}", "", "[model]", *about, "", "[compliance]  # SI: m, rad by N, N m"]
    sigma = np.sqrt(np.diag(extended.covariance))[: _AXES * _AXES].reshape(_AXES, _AXES)
    for name, matrix in (("nominal", extended.nominal), ("identified", extended.compliance), ("sigma", sigma)):
        lines += [f"{name} = [", *(f"  {toml_value(exact(row))}," for row in matrix), "]"]
    if not np.array_equal(extended.rows, np.eye(_AXES)):
        lines += ["", "[beams]  # how channels (SI) follow dx .. rz of the platform's origin", "rows = ["]
        lines += [*(f"  {toml_value(exact(row))}," for row in extended.rows), "]"]
    first = _AXES * _AXES
    for cause, values in zip(extended.causes, extended.values, strict=True):
        part = slice(first, first + len(values))
        lines += effect_lines(Effect(cause, values), extended.covariance[part, part], _AXES)
        first = part.stop
    return "\n".join([*lines, *covariance_lines(_names(extended), extended.covariance, "SI")]) + "\n"


def is_sensor(document: dict[str, Any]) -> bool:
    """Return whether a parsed model.toml is that of a sensor."""
    about = document.get("model", {})
    return isinstance(about, dict) and about.get("mechanism") == MECHANISM


def read_sensor(text: str) -> ExtendedSensor:
    """Return the model that a text of `write_sensor` describes; raises ValueError where it does not describe one."""
    try:
        return _from_document(parsed_toml(text))
    except (KeyError, TypeError, IndexError, AttributeError) as error:
        raise ValueError(f"model: found no usable {error}, expected what `truing run` writes as model.toml") from error


def _names(extended: ExtendedSensor) -> list[str]:
    entries = [f"{channel}/{load}" for channel in CHANNELS for load in LOADS]
    return entries + [p.name for cause in extended.causes for p in cause.parameters(_AXES)]


def _from_document(document: dict[str, Any]) -> ExtendedSensor:
    if document["format"] != FORMAT:
        raise ValueError(f"model: found format {document['format']!r}, expected {FORMAT}")
    about, effects = document["model"], document.get("effects", [])
    known = catalogue_of_readings()
    values = tuple(np.array(effect["values"], float) for effect in effects)
    size = _AXES * _AXES + sum(len(own) for own in values)
    return ExtendedSensor(
        _matrix(document["compliance"]["identified"]),
        _matrix(document["compliance"]["nominal"]),
        tuple(cause_of(effect, known) for effect in effects),
        values,
        covariance_of(document["covariance"], size),
        np.array(about["largest_load"], float),
        float(about["wavelength_nm"]) * 1e-9,
        float(about["reference_temperature_c"]),
        {key: str(value) for key, value in about.items() if key not in _OWN},
        _matrix(document["beams"]["rows"]) if "beams" in document else np.eye(_AXES),
        float(about.get("common_share", _HALF)),
    )


def _matrix(rows: Any) -> NDArray:
    found = np.array(rows, float)
    if found.shape != (_AXES, _AXES):
        raise ValueError(f"model: found a matrix of shape {found.shape}, expected (6, 6)")
    return found
