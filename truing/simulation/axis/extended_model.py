"""Class `ExtendedAxis`: an identified axis with its effects; its model.toml, and prediction of encoder readings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truing.schemas.settings_text import Document
from truing.simulation.axis.causes import AxisCause
from truing.simulation.axis.model import AxisModel
from truing.simulation.axis.rows import Axis, AxisRows
from truing.simulation.catalogue import catalogue_of_axes
from truing.simulation.cause import Effect
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
    errors, design = _errors(extended, rows, [effect.cause.is_persistent for effect in extended.effects])
    return rows.command[:, None] + errors, _sigmas(design, extended.covariance)


def positioning_errors(extended: ExtendedAxis, rows: AxisRows, origin: int) -> tuple[NDArray, NDArray]:
    """Return errors (B, K), rad or m, of the encoders' readings against the command, less those of the row ``origin``,
    and their standard deviations.

    Errors by the position and how it was reached alone: effects that end with the campaign, or depend on further
    columns such as a temperature, are omitted.
    """
    errors, design = _errors(extended, rows, [depends_on_path(effect) for effect in extended.effects])
    return errors - errors[origin], _sigmas(design - design[origin], extended.covariance)


def depends_on_path(effect: Effect[AxisCause]) -> bool:
    """True if an effect stays with the axis, and depends on the position and how it was reached alone."""
    return effect.cause.is_persistent and not effect.cause.needs(0)


def _errors(extended: ExtendedAxis, rows: AxisRows, included: Sequence[bool]) -> tuple[NDArray, NDArray]:
    """Return readings less command (B, K), and their derivatives (B, K, G) by zeros and effects."""
    count, encoders = len(rows.command), len(extended.axis.encoders)
    slopes = [np.broadcast_to(np.eye(encoders), (count, encoders, encoders))]
    errors = np.tile(extended.zeros, (count, 1))
    for effect, is_included in zip(extended.effects, included, strict=True):
        if is_included:
            slopes.append(effect.cause.slopes_at(rows, extended.axis, effect.values))
            errors += effect.cause.shift(rows, extended.axis, effect.values)
        else:
            slopes.append(np.zeros((count, encoders, len(effect.values))))
    return errors, np.concatenate(slopes, -1)


def _sigmas(design: NDArray, covariance: NDArray) -> NDArray:
    return np.sqrt(np.maximum(np.einsum("bki,ij,bkj->bk", design, covariance, design), 0.0))


def write_axis(extended: ExtendedAxis) -> str:
    """Return the model as TOML text."""
    axis = extended.axis
    numbers: dict[str, object] = {"mechanism": MECHANISM, "kind": axis.kind, "loop": axis.loop}
    numbers |= {"least_move": axis.least_move, "encoders": axis.encoders}
    zeros = zip(axis.encoders, exact(extended.zeros), strict=True)
    tables = ["", "[zeros]  # reading minus command, rad or m", *(f"{name} = {toml_value(z)}" for name, z in zeros)]
    return model_text(extended, numbers, tables, (), names=axis.encoders, units="SI", legs=0)


def is_axis(document: dict[str, object]) -> bool:
    """True if a parsed model.toml is that of an axis."""
    return describes(document, MECHANISM)


def read_axis(text: str) -> ExtendedAxis:
    """Read the model from a text of `write_axis`; raises ValueError if the text is no such model."""
    return read_document(text, _from_document)


def _from_document(document: Document) -> ExtendedAxis:
    about, effects = document["model"], effects_of(document, catalogue_of_axes())
    axis = Axis(str(about["kind"]), tuple(about["encoders"]), str(about["loop"]), float(about["least_move"]))
    zeros = np.array([document["zeros"][name] for name in axis.encoders], float)
    size = len(zeros) + sum(len(effect.values) for effect in effects)
    covariance, context = covariance_from(document, size), context_of(document, _OWN)
    return ExtendedAxis(axis, zeros, effects=effects, covariance=covariance, context=context)
