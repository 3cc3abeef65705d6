"""Identified parameters of a chain: zeros of joints and errors of links, with the uncertainty from each source."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from truing.arrays import TableRow
from truing.inference.pulls import pulls
from truing.schemas.artifacts import ARTIFACTS
from truing.simulation.mechanisms.chains.causes import JointOffset
from truing.simulation.mechanisms.chains.model import ChainModel
from truing.simulation.mechanisms.chains.tree import TWIST
from truing.stages.common.rows import Rows
from truing.stages.diagnosis.cause_tables import source_of

if TYPE_CHECKING:
    from truing.inference.fitted_model import FittedModel

_MM = 1e-3
_SHIFTS, _TURNS = ("dx", "dy", "dz"), ("turn_x", "turn_y", "turn_z")
# The data determine a parameter if they reduce its prior standard deviation to less than this share.
_DETERMINED = 0.7
# A component of a link's error that the parametrisation holds at zero, relative to the others.
_HELD_SHARE = 1e-6
_LEAST = 1e-12  # m or rad: less is rounding of the modes


@dataclass(frozen=True)
class _Parameter:
    """Zero of a joint, or component of a link's error: a linear form of the shared unknowns (G,), SI.

    ``prior`` is its standard deviation before the data.
    """

    joint: str
    name: str
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
    values = [
        (parameter, float(parameter.form @ shared) + (parameter.found_at or 0.0)) for parameter in _parameters(fitted)
    ]
    rows = [_row(parameter, value, parameter.sigma(covariance)) for parameter, value in values]
    return pa.Table.from_pylist(rows, schema=ARTIFACTS["chain_parameters"].arrow_schema())


def pull_sums_table(before: FittedModel, after: FittedModel) -> pa.Table | None:
    """Rows of pull_sums.parquet: all numbers of the chain against their tolerances; None where none is declared.

    Numbers that only together are determined, such as the lengths of two links along one axis, count together. A zero
    whose offset was found beyond its tolerance does not count.
    """
    rows = Rows("pull_sums")
    for name, fitted in (("plain", before), ("extended", after)):
        known = _toleranced(fitted)
        if not len(known):
            return None
        posterior = fitted.fit.whitened.covariance()[np.ix_(known, known)]
        found = pulls(fitted.fit.shared[known], np.eye(len(known)), posterior)
        band = {"lower": found.lower, "upper": found.upper, "p_value": found.p_value}
        rows.add(model=name, chi_square=found.chi_square, freedom=found.freedom, **band)
    return rows.table()


def _toleranced(fitted: FittedModel) -> NDArray[np.int64]:
    """Places of the shared unknowns, in tolerances, that are zeros of joints or errors of links."""
    model = _chain(fitted)
    found = {cause.joint for cause in fitted.causes if isinstance(cause, JointOffset)}
    first = model.layout["zeros"].start
    zeros = [first + k for k, reading in enumerate(model.free_offsets) if model.tree.readings[reading] not in found]
    links = model.layout["links"] if model.known.modes_known else slice(0)
    return np.array([*zeros, *range(links.start or 0, links.stop)], int)


def uncertainty_table(fitted: FittedModel) -> pa.Table:
    """Rows of chain_uncertainty.parquet: contribution of each source to every parameter of the chain."""
    model = _chain(fitted)
    rows: list[TableRow] = []
    parameters = tuple(_parameters(fitted))
    for contribution in fitted.contributions_to(slice(0, model.shared_size)):
        source = source_of(fitted, contribution)
        for parameter in parameters:
            columns = {"joint": parameter.joint, "parameter": parameter.name, "unit": parameter.unit}
            rows.append(columns | source | {"contribution": parameter.sigma(contribution.covariance) / parameter.si})
    return pa.Table.from_pylist(rows, schema=ARTIFACTS["chain_uncertainty"].arrow_schema())


def _chain(fitted: FittedModel) -> ChainModel:
    assert isinstance(fitted.model, ChainModel)
    return fitted.model


def _parameters(fitted: FittedModel) -> Iterator[_Parameter]:
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
        yield _Parameter(name, "offset", is_length, form, tolerance, found_at=None if cause is None else cause.start)
    geometry = np.zeros((model.tree.size, TWIST, model.shared_size))
    geometry[..., model.layout["links"]] = model.known.modes
    geometry[..., model.layout["shape"]] = model.known.end_twists(model.tree.size)
    for node, forms in zip(model.tree.nodes, geometry, strict=True):
        priors = np.linalg.norm(forms, axis=-1).reshape(2, -1)
        free = (priors > np.maximum(_HELD_SHARE * priors.max(1, initial=0.0, keepdims=True), _LEAST)).ravel()
        for c in np.flatnonzero(free):
            name, prior = (*_SHIFTS, *_TURNS)[c], float(priors.ravel()[c])
            yield _Parameter(node.joint, name, bool(c < TWIST // 2), forms[c], prior, not model.known.modes_known)


def _row(parameter: _Parameter, value: float, sigma: float) -> TableRow:
    """Row of one parameter. Its pull is the identified value over the standard deviation expected for it.

    That is sqrt(prior^2 - sigma^2) where the tolerance is the prior. The size of an offset that was accepted as a cause
    is free, so it is compared with sqrt(prior^2 + sigma^2).
    """
    is_found = parameter.found_at is not None
    expected = np.hypot(parameter.prior, sigma) if is_found else np.sqrt(max(parameter.prior**2 - sigma**2, 0.0))
    return {
        "joint": parameter.joint,
        "parameter": parameter.name,
        "unit": parameter.unit,
        "identified": value / parameter.si,
        "sigma": sigma / parameter.si,
        "tolerance": None if parameter.is_free else parameter.prior / parameter.si,
        "pull": None if parameter.is_free or not expected > 0.0 else value / expected,
        "identifiable": is_found or sigma < _DETERMINED * parameter.prior,
    }
