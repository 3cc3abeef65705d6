"""Sizes of the causes that were found: what the measurements give, and what tolerances and plausible sizes do."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from stages.uncertainty_statement.statement import Statement
from truing.estimation.uncertainty_budget import Budget, Source
from truing.simulation.bench.sensor_text import is_sensor, read_sensor
from truing.simulation.cause import Cause
from truing.simulation.model_text import read_model

if TYPE_CHECKING:
    import pyarrow as pa

    from schemas.campaign import Campaign

Array = NDArray[np.float64]

_BENCH, _AXES = "tolerances of the drawing", 6
_TOLERANCES = {
    "a": "tolerance of the lower joints",
    "b": "tolerance of the upper joints",
    "u": "tolerance of the directions of the actuators",
    "l": "tolerance of the lengths of the legs",
}
_WIDE = "numbers of which nothing is declared"
_PLAUSIBLE = "sizes of causes held to be plausible"
_UNEVEN = Source("likelihood that is wider to one side", "A")
_WHOLE = Source("fit of the diagnosis as a whole", "A")


@dataclass(frozen=True)
class _Effect:
    """A cause with its values (P,) and the covariance (P, P) that each source gives to them, SI."""

    cause: Cause
    values: Array
    parts: Mapping[Source, Array]
    legs: int


def state_causes(statement: Statement, tables: Mapping[str, pa.Table], settings: Campaign) -> None:
    """State every parameter of every cause that was found."""
    table = tables.get("diagnosis")
    if table is None or not table.num_rows:
        statement.not_evaluated("cause", "all", "the diagnosis was not evaluated")
        return
    rows = table.to_pylist()
    found = [row for row in rows if row["verdict"] == "found" and row["cause"] != "unexplained"]
    if not found:
        statement.not_evaluated("cause", "all", "no cause was found, and so none has a size")
    effects = _effects(tables, settings)
    for row in found:
        subject = f"{row['cause']} {row['subject'] or ''}".strip()
        _state(statement, subject, json.loads(row["parameters"] or "{}"), effects.get((row["cause"], row["subject"])))
    open_ = [row for row in rows if row["cause"] == "unexplained" and row["verdict"] not in (None, "rejected")]
    for row in open_:
        statement.omitted("cause", f"unexplained, {row['subject'] or 'everywhere'}", str(row["explanation"]))
    if found:
        statement.omitted("cause", "which cause it is", "each budget holds if the cause is the one that was named")


def _state(statement: Statement, subject: str, parameters: dict[str, Any], effect: _Effect | None) -> None:
    told = {name: one for name, one in parameters.items() if isinstance(one, dict) and one.get("sigma") is not None}
    for name in parameters.keys() - told.keys():
        statement.not_evaluated("cause", name, "it is no measured number, or nothing bounds it", subject)
    if not told:
        return
    whole = np.array([one["sigma"] for one in told.values()], float)
    statement.state(
        "cause",
        subject,
        list(told),
        np.array([one["value"] for one in told.values()], float),
        [one["unit"] for one in told.values()],
        _budget(effect, list(told), whole),
    )


def _budget(effect: _Effect | None, names: list[str], whole: Array) -> Budget:
    """The budget of parameters as they are told; what the table's sigma has beyond its parts is of its own kind."""
    if effect is None or not effect.parts:
        return Budget((_WHOLE,), whole[None])
    parts = np.array([_told(effect, names, covariance) for covariance in effect.parts.values()])
    squares = np.sum(parts**2, axis=0)
    if not np.all(squares > 0.0):
        return Budget((_WHOLE,), whole[None])
    parts = parts * np.minimum(1.0, whole / np.sqrt(squares))
    beyond = np.sqrt(np.maximum(whole**2 - np.sum(parts**2, axis=0), 0.0))
    found = Budget(tuple(effect.parts), parts)
    return found.beside(_UNEVEN, beyond) if np.any(beyond > 1e-3 * whole) else found


def _told(effect: _Effect, names: list[str], covariance: Array) -> list[float]:
    """The standard uncertainties of the named parameters by a part of the covariance, in their units."""
    with np.errstate(all="ignore"):
        told = {one.name: one.sigma for one in effect.cause.told(effect.values, covariance, effect.legs)}
    return [float(np.nan_to_num(told.get(name) or 0.0)) for name in names]


def _effects(tables: Mapping[str, pa.Table], settings: Campaign) -> dict[tuple[str, str | None], _Effect]:
    """The effects of the extended model, by cause and subject; none where the run left no such model."""
    text = tables.get("model")
    if not isinstance(text, str) or "start" in tables:  # an earlier campaign's knowledge is no part that can be told
        return {}
    document = tomllib.loads(text)
    if "model" not in document:
        return {}
    found = _of_sensor(text, tables) if is_sensor(document) else _of_mechanism(text, tables)
    return {(one.cause.id, one.cause.subject): one for one in found}


def _of_mechanism(text: str, tables: Mapping[str, pa.Table]) -> list[_Effect]:
    found = read_model(text)
    model, covariance, level = found.model, found.covariance, found.noise_ratio**2
    groups: dict[str, list[int]] = {}
    causes = {cause.key for cause in model.causes}
    for name, part in model.layout.items():
        if name in causes:
            source = _PLAUSIBLE
        elif name in model.known.open_geometry:
            source = _WIDE
        else:
            source = _TOLERANCES.get(name, name)
        if part.stop > part.start:
            groups.setdefault(source, []).extend(range(part.start, part.stop))
    parts = _with_rest(covariance, groups, level, np.ones(len(covariance)), _freedom_of_points(tables, len(covariance)))
    effects = []
    for effect in model.effects(found.shared):
        own, scale = model.layout[effect.cause.key], model.effect_sigma(effect.cause)
        mine = {source: part[own, own] * np.outer(scale, scale) for source, part in parts.items()}
        effects.append(_Effect(effect.cause, effect.values, mine, model.leg_count))
    return effects


def _of_sensor(text: str, tables: Mapping[str, pa.Table]) -> list[_Effect]:
    found = read_sensor(text)
    covariance, first = found.covariance, len(found.covariance) - sum(len(own) for own in found.values)
    sigma = [cause.reach * np.array([p.scale for p in cause.parameters(_AXES)]) for cause in found.causes]
    precision = np.concatenate([np.zeros(first), *(own**-2.0 for own in sigma)])
    groups = {_PLAUSIBLE: list(range(first, len(covariance)))}
    freedom = _freedom_of_readings(tables, len(covariance))
    parts = _with_rest(covariance, groups, found.noise_ratio**2, precision, freedom, f" and {_BENCH}")
    effects = []
    for cause, values in zip(found.causes, found.values, strict=True):
        own = slice(first, first + len(values))
        effects.append(_Effect(cause, values, {source: part[own, own] for source, part in parts.items()}, _AXES))
        first = own.stop
    return effects


def _with_rest(
    covariance: Array, groups: dict[str, list[int]], level: float, precision: Array, dof: float, more: str = ""
) -> dict[Source, Array]:
    """The covariance (G, G) by what was known before of groups of unknowns, of such precision (G,), and by the rest.

    It is that of maximum a posteriori at ``level`` times the declared variances: knowledge of precision Q gives
    ``C Q C / level``.
    """
    parts = {
        Source(name, "B"): (covariance[:, own] * precision[own]) @ covariance[own] / level
        for name, own in groups.items()
    }
    rest = covariance - sum(parts.values(), np.zeros(()))
    return {Source(f"measurements{more}, at the noise found", "A", dof): rest, **parts}


def _freedom_of_points(tables: Mapping[str, pa.Table], unknowns: int) -> float:
    """What is left over of all coordinates by the frame and the rolls of each pose, and by what poses share."""
    residuals = tables["residuals"]
    kept = residuals.num_rows - sum(residuals.column("rejected").to_pylist())
    bodies = len(set(residuals.column("body").to_pylist()))
    poses = len(set(residuals.column("pose").to_pylist()))
    return float(max(3 * kept - (6 + max(bodies - 2, 0)) * poses - unknowns, 1))


def _freedom_of_readings(tables: Mapping[str, pa.Table], unknowns: int) -> float:
    """What is left over of all readings by the zeros of runs and channels, and by what they share."""
    rejected = tables["reading_residuals"].column("rejected").to_pylist()
    return float(max(len(rejected) - sum(rejected) - tables["run_terms"].num_rows - unknowns, 1))
