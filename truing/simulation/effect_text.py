"""Effects as text of a model: what people read of them, what tells them to the model, and their covariance."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from truing.simulation.cause import Cause, Effect, Told


def told_parameters(cause: Cause, values: NDArray, covariance: NDArray, legs: int) -> dict[str, Told]:
    """Return an effect's parameters by name, as the tables tell them, from values (P,) and covariance (P, P) in SI."""
    return {told.name: told for told in cause.told(values, covariance, legs)}


def effect_lines(effect: Effect, covariance: NDArray, legs: int) -> list[str]:
    """Return an accepted effect: what people read of its parameters, and what tells it to the model."""
    cause = effect.cause
    settings = {name: value for name, value in cause.settings().items() if value is not None}
    lines = ["", "[[effects]]", f"cause = {toml_value(cause.id)}", f"subject = {toml_value(cause.subject)}"]
    lines += [
        f"settings = {toml_value(settings)}",
        f"values = {toml_value(exact(effect.values))}",
        "[effects.parameters]",
    ]
    for name, told in told_parameters(cause, effect.values, covariance, legs).items():
        value = float(f"{told.value:.10g}") if isinstance(told.value, float) else told.value
        sigma = {} if told.sigma is None else {"sigma": float(f"{told.sigma:.4g}")}
        lines.append(f"{toml_key(name)} = {toml_value({'value': value, **sigma, 'unit': told.unit})}")
    return lines


def cause_of(effect: dict[str, Any], known: Mapping[str, Cause]) -> Cause:
    """Return the cause that a text describes; raises ValueError where no installed package brings it."""
    if effect["cause"] not in known:
        raise ValueError(f"model: found cause {effect['cause']!r}, expected one of {', '.join(known)}")
    return known[effect["cause"]].with_settings(**{name: _frozen(v) for name, v in effect["settings"].items()})


def covariance_lines(names: list[str], covariance: NDArray, units: str) -> list[str]:
    """Return the covariance of unknowns, in units of which ``units`` tells, as lines of a table."""
    head = f"[covariance]  # of the unknowns in {units}, lower triangle"
    rows = [f"  {toml_value(row[: i + 1])}," for i, row in enumerate(covariance)]
    return ["", head, f"names = {toml_value(names)}", "rows = [", *rows, "]"]


def covariance_of(table: dict[str, Any], size: int) -> NDArray:
    lower = np.zeros((size, size))
    if len(table["rows"]) != size:
        raise ValueError(f"model: found {len(table['rows'])} rows of covariance, expected {size}")
    for i, row in enumerate(table["rows"]):
        lower[i, : i + 1] = row
    return lower + np.tril(lower, -1).T


def exact(values: NDArray) -> list[float]:
    """Return numbers without the digit that changes when they are scaled and scaled back."""
    return [float(f"{value:.15g}") for value in values]


def toml_key(name: str) -> str:
    return name if re.fullmatch(r"[A-Za-z0-9_-]+", name) else json.dumps(name, ensure_ascii=False)


def toml_value(value: Any) -> str:
    """Return a value as TOML."""
    if isinstance(value, bool | np.bool_):
        return str(bool(value)).lower()
    if isinstance(value, str):
        return json.dumps(str(value), ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, dict):
        return f"{{ {', '.join(f'{toml_key(key)} = {toml_value(item)}' for key, item in value.items())} }}"
    if isinstance(value, list | tuple) or np.ndim(value):
        return f"[{', '.join(toml_value(item) for item in value)}]"
    return repr(int(value)) if isinstance(value, int | np.integer) else repr(float(value))


def _frozen(value: Any) -> Any:
    return tuple(_frozen(item) for item in value) if isinstance(value, list) else value
