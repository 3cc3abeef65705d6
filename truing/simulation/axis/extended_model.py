"""Class `ExtendedAxis`: an identified axis with its effects; its model.toml, and prediction of encoder readings."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from truing.simulation.axis.causes import AxisCause
from truing.simulation.axis.model import AxisModel
from truing.simulation.axis.rows import Axis, AxisRows
from truing.simulation.catalogue import catalogue_of_axes
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

MECHANISM = "axis"
_OWN = ("mechanism", "kind", "loop", "least_move", "encoders")


@dataclass(frozen=True)
class ExtendedAxis(IdentifiedInSI[AxisCause]):
    """An identified axis with its encoders' zeros (K,), rad or m, which come first in the covariance."""

    axis: Axis
    zeros: NDArray


def extended_axis(model: AxisModel, shared: NDArray, covariance: NDArray, context: dict[str, str]) -> ExtendedAxis:
    """Convert a fit, unknowns (G,) with covariance (G, G) in prior sigmas, to the extended model in SI."""
    scale = np.empty(model.shared_size)
    scale[model.layout["zero"]] = model.zero_sigma
    for cause in model.causes:
        scale[model.layout[cause.key]] = model.effect_sigma(cause)
    zeros, covariance = shared[model.layout["zero"]] * model.zero_sigma, covariance * np.outer(scale, scale)
    return ExtendedAxis(model.axis, zeros, effects=model.effects(shared), covariance=covariance, context=context)


def predict_axis(extended: ExtendedAxis, rows: AxisRows) -> tuple[NDArray, NDArray]:
    """Return predicted encoder readings (B, K), rad or m, and their standard deviation by the model's uncertainty.

    Effects that end with the campaign, such as a zero shift, are omitted.
    """
    count, encoders = len(rows.command), len(extended.axis.encoders)
    slopes = [np.broadcast_to(np.eye(encoders), (count, encoders, encoders))]
    reading = rows.command[:, None] + extended.zeros
    for effect in extended.effects:
        derivative = effect.cause.slopes_at(rows, extended.axis, effect.values)
        slopes.append(derivative if effect.cause.is_persistent else np.zeros_like(derivative))
        if effect.cause.is_persistent:
            reading = reading + effect.cause.shift(rows, extended.axis, effect.values)
    design = np.concatenate(slopes, -1)
    variance = np.einsum("bki,ij,bkj->bk", design, extended.covariance, design)
    return reading, np.sqrt(np.maximum(variance, 0.0))


def write_axis(extended: ExtendedAxis) -> str:
    """Return the model as TOML text."""
    axis = extended.axis
    numbers: dict[str, Any] = {"mechanism": MECHANISM, "kind": axis.kind, "loop": axis.loop}
    numbers |= {"least_move": axis.least_move, "encoders": axis.encoders}
    zeros = zip(axis.encoders, exact(extended.zeros), strict=True)
    tables = ["", "[zeros]  # reading minus command, rad or m", *(f"{name} = {toml_value(z)}" for name, z in zeros)]
    return model_text(extended, numbers, tables, (), names=axis.encoders, units="SI", legs=0)


def is_axis(document: dict[str, Any]) -> bool:
    """True if a parsed model.toml is that of an axis."""
    return describes(document, MECHANISM)


def read_axis(text: str) -> ExtendedAxis:
    """Read the model from a text of `write_axis`; raises ValueError if the text is no such model."""
    return read_document(text, _from_document)


def _from_document(document: dict[str, Any]) -> ExtendedAxis:
    about, effects = document["model"], effects_of(document, catalogue_of_axes())
    axis = Axis(str(about["kind"]), tuple(about["encoders"]), str(about["loop"]), float(about["least_move"]))
    zeros = np.array([document["zeros"][name] for name in axis.encoders], float)
    size = len(zeros) + sum(len(effect.values) for effect in effects)
    covariance, context = covariance_from(document, size), context_of(document, _OWN)
    return ExtendedAxis(axis, zeros, effects=effects, covariance=covariance, context=context)
