"""Identified numbers of a chain: zeros of the joints and errors of the links, with their uncertainty by source."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from truing.arrays import TableRow
from truing.schemas.artifacts import ARTIFACTS
from truing.simulation.mechanisms.chains.causes import JointOffset
from truing.simulation.mechanisms.chains.model import ChainModel
from truing.simulation.mechanisms.chains.tree import TWIST
from truing.stages.diagnosis.cause_tables import source_of

if TYPE_CHECKING:
    from truing.inference.fitted_model import FittedModel

_MM = 1e-3
_SHIFTS, _TURNS = ("dx", "dy", "dz"), ("turn_x", "turn_y", "turn_z")
# The data determine a number if they reduce its prior standard deviation to less than this share.
_DETERMINED = 0.7
# A component of a link's error that the parametrisation holds at zero, relative to the others.
_HELD = 1e-6
_LEAST = 1e-12  # m or rad: less is rounding of the modes


@dataclass(frozen=True)
class _Number:
    """One number of the chain: a linear form of the shared unknowns (G,), SI, and its standard deviation before the
    data."""

    joint: str
    parameter: str
    is_length: bool
    form: NDArray
    prior: float
    is_free: bool = False
    found_at: float | None = None  # where an offset beyond the tolerance was found, start of its linear form

    @property
    def unit(self) -> str:
        return "mm" if self.is_length else "rad"

    @property
    def si(self) -> float:
        return _MM if self.is_length else 1.0

    def sigma(self, covariance: NDArray) -> float:
        """Standard deviation, SI, at a covariance (G, G) of the shared unknowns."""
        return float(np.sqrt(max(float(self.form @ covariance @ self.form), 0.0)))


def parameters_table(fitted: FittedModel) -> pa.Table:
    """Rows of chain_parameters.parquet: zeros of the joints and errors of the links, with tolerance and sigma."""
    covariance, shared = fitted.covariance(), fitted.fit.shared
    values = [(number, float(number.form @ shared) + (number.found_at or 0.0)) for number in _numbers(fitted)]
    rows = [_row(number, value, number.sigma(covariance)) for number, value in values]
    return pa.Table.from_pylist(rows, schema=ARTIFACTS["chain_parameters"].arrow_schema())


def uncertainty_table(fitted: FittedModel) -> pa.Table:
    """Rows of chain_uncertainty.parquet: contribution of each source to every number of the chain."""
    model = _chain(fitted)
    rows: list[TableRow] = []
    numbers = tuple(_numbers(fitted))
    for given in fitted.contributions_to(slice(0, model.shared_size)):
        source = source_of(fitted, given)
        for number in numbers:
            named = {"joint": number.joint, "parameter": number.parameter, "unit": number.unit}
            rows.append(named | source | {"contribution": number.sigma(given.covariance) / number.si})
    return pa.Table.from_pylist(rows, schema=ARTIFACTS["chain_uncertainty"].arrow_schema())


def _chain(fitted: FittedModel) -> ChainModel:
    assert isinstance(fitted.model, ChainModel)
    return fitted.model


def _numbers(fitted: FittedModel) -> Iterator[_Number]:
    """Yield the zeros of the joints that have a tolerance, then the errors of each link that are not held.

    A zero holds the offset that was found beyond its tolerance.
    """
    model = _chain(fitted)
    offset_of_joint = {cause.joint: cause for cause in fitted.causes if isinstance(cause, JointOffset)}
    for index, reading in enumerate(model.free_offsets):
        name, tolerance = model.tree.readings[reading], float(model.known.offsets[reading])
        form = np.zeros(model.shared_size)
        form[model.layout["zeros"].start + index] = tolerance
        cause = offset_of_joint.get(name)
        if cause is not None:
            form[model.layout[cause.key]] = model.effect_sigma(cause)
        is_length = not model.tree.is_revolute[reading]
        yield _Number(name, "offset", is_length, form, tolerance, found_at=None if cause is None else cause.start)
    geometry = np.zeros((model.tree.size, TWIST, model.shared_size))
    geometry[..., model.layout["links"]] = model.known.modes
    geometry[..., model.layout["shape"]] = model.known.end_twists(model.tree.size)
    for node, forms in zip(model.tree.nodes, geometry, strict=True):
        priors = np.linalg.norm(forms, axis=-1).reshape(2, -1)
        free = (priors > np.maximum(_HELD * priors.max(1, initial=0.0, keepdims=True), _LEAST)).ravel()
        for c in np.flatnonzero(free):
            name, prior = (*_SHIFTS, *_TURNS)[c], float(priors.ravel()[c])
            yield _Number(node.joint, name, bool(c < TWIST // 2), forms[c], prior, not model.known.modes_known)


def _row(number: _Number, value: float, sigma: float) -> TableRow:
    """One number; its pull compares the shift with the uncertainty by tolerance and data.

    An offset that was found does not share the tolerance of its zero: both together are as far off as it is.
    """
    is_found = number.found_at is not None
    expected = np.hypot(number.prior, sigma) if is_found else np.sqrt(max(number.prior**2 - sigma**2, 0.0))
    return {
        "joint": number.joint,
        "parameter": number.parameter,
        "unit": number.unit,
        "identified": value / number.si,
        "sigma": sigma / number.si,
        "tolerance": None if number.is_free else number.prior / number.si,
        "pull": None if number.is_free or not expected > 0.0 else value / expected,
        "identifiable": is_found or sigma < _DETERMINED * number.prior,
    }
