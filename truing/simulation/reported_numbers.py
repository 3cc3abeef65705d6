"""Comparison of two campaigns number by number, with the names and units of the tables."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from truing.inference.changes import LEVEL, NumberComparison
from truing.simulation.bench.six_upur.uncertain_sensor import UncertainSensor
from truing.simulation.effects_model import EffectsModel
from truing.simulation.mechanisms.extended_model import identified_geometry, name_and_leg
from truing.simulation.mechanisms.model import MechanismModel
from truing.simulation.prior_campaign import CampaignPrior, SharedUnknowns

# Least reduction of the prior variance by the data for a number to count as measured.
LEAST_REDUCTION = 0.05
_OF_SENSOR = ("geometry", "stiffness")
_AXES = {"a": "xyz", "b": "xyz", "u": "12", "l": ("",)}


@dataclass(frozen=True)
class Number:
    """A number that both campaigns have: name in the tables, leg, unit, and its scale in this unit."""

    name: str
    leg: int | None
    unit: str
    scale: float
    effect_of: str | None = None

    @property
    def label(self) -> str:
        """Name with the leg, for lists of several numbers."""
        return self.name if self.leg is None else f"{self.name}{self.leg}"


def numbers_of(prior: CampaignPrior, model: Any) -> list[Number]:
    """Return the n numbers in their order; directions of actuators as tilts."""
    causes, numbers = {cause.key: cause for cause in prior.causes}, []
    for part in prior.parts:
        if part.name in _AXES:
            numbers += _geometry_numbers(part, model.part_count)
        elif part.name in _OF_SENSOR:
            numbers += _sensor_numbers(part, model.known.sensor)
        else:
            cause = causes[part.name]
            for p, scale in zip(cause.parameters(model.part_count), part.scale, strict=True):
                owner = f"{cause.id} {cause.subject}".strip()
                numbers.append(Number(*name_and_leg(p.name), p.unit, float(scale) / p.si, owner))
    return numbers


def _geometry_numbers(part: SharedUnknowns, legs: int) -> list[Number]:
    unit, si = ("1", 1.0) if part.name == "u" else ("mm", 1e-3)
    names = [(f"{part.name}_{axis}".removesuffix("_"), leg + 1) for leg in range(legs) for axis in _AXES[part.name]]
    return [Number(*named, unit, float(scale) / si) for named, scale in zip(names, part.scale, strict=True)]


def _sensor_numbers(part: SharedUnknowns, sensor: UncertainSensor) -> list[Number]:
    lengths = part.name == "geometry"
    named = sensor.unknowns[: sensor.geometry_size] if lengths else sensor.unknowns[sensor.geometry_size :]
    unit, si = ("mm", 1e-3) if lengths else ("1", 1.0)
    return [Number(name, leg, unit, float(size) / si) for (leg, name), size in zip(named, part.scale, strict=True)]


@dataclass(frozen=True)
class ReportedNumbers:
    """Rows of the table: their names, derivative (R, n) by the numbers, and nominal values (R,), in the rows' units."""

    rows: tuple[Number, ...]
    by_numbers: NDArray
    nominal: NDArray

    @property
    def columns(self) -> dict[str, list[object]]:
        """Names of the rows, column by column."""
        return {name: [getattr(row, name) for row in self.rows] for name in ("leg", "unit", "effect_of")} | {
            "parameter": [row.name for row in self.rows]
        }


def reported_numbers(
    prior: CampaignPrior, model: EffectsModel, shared: NDArray, covariance: NDArray
) -> ReportedNumbers:
    """Return the rows of a machine's geometry, or of a sensor's lengths and stiffnesses, followed by the effects."""
    if not isinstance(model, MechanismModel):
        rows = numbers_of(prior, model)
        return ReportedNumbers(tuple(rows), np.diag([row.scale for row in rows]), np.zeros(len(rows)))
    geometry, indices = identified_geometry(model, shared, covariance), prior.places(model)
    parts = {part.name for part in prior.parts}
    is_geometry = np.array([entry.name.partition("_")[0] in parts for entry in geometry.parameters], bool)
    entries = [entry for entry, reported in zip(geometry.parameters, is_geometry, strict=True) if reported]
    si = np.array([entry.si for entry in entries])
    effects = [number for number in numbers_of(prior, model) if number.effect_of is not None]
    lower = np.zeros((len(effects), len(indices)))
    lower[:, len(indices) - len(effects) :] = np.diag([number.scale for number in effects])
    rows = [Number(entry.name, entry.leg + 1, entry.unit, entry.si) for entry in entries]
    by = np.concatenate([(geometry.by_shared[is_geometry][:, indices].T / si).T, lower])
    return ReportedNumbers(
        (*rows, *effects), by, np.concatenate([geometry.nominal[is_geometry] / si, np.zeros(len(effects))])
    )


def figures(
    prior: CampaignPrior,
    reported: ReportedNumbers,
    comparison: NumberComparison,
    now: NDArray,
    covariance: NDArray,
    level: float = LEVEL,
) -> dict[str, object]:
    """Return the columns of the table: each row then and now, the difference over its sigma, and the changed rows.

    ``now`` (n,) has the covariance (n, n).
    """
    by = reported.by_numbers
    spread = np.sqrt(np.maximum(np.diag(by @ comparison.covariance @ by.T), 0.0))
    beforehand = np.diag(by @ np.linalg.inv(prior.shared) @ by.T)
    measured = np.diag(by @ covariance @ by.T) < (1.0 - LEAST_REDUCTION) * beforehand
    return {
        "before": reported.nominal + by @ prior.mean,
        "sigma_before": np.sqrt(np.diag(by @ (prior.covariance + prior.frames) @ by.T)),
        "now": reported.nominal + by @ now,
        "sigma_now": np.sqrt(np.diag(by @ covariance @ by.T)),
        "sigma_difference": spread,
        "z": np.where(measured & (spread > 0), by @ comparison.difference / np.where(spread > 0, spread, 1.0), np.nan),
        **_changed(reported, comparison, level),
    }


def _changed(reported: ReportedNumbers, comparison: NumberComparison, level: float) -> dict[str, list[object]]:
    """Return the columns that mark changed rows, the sizes of the changes, and rows that may have changed instead."""
    # A direction is reported by components, each of which depends mainly on one of its two tilts.
    row_of = {int(np.abs(reported.by_numbers[row]).argmax()): row for row in range(len(reported.rows))}
    changed, count = comparison.changed(level), len(reported.rows)
    if changed is None:
        return {"changed": [True] * count}
    columns: dict[str, list[object]] = {"changed": [False] * count}
    columns |= {name: [None] * count for name in ("change", "sigma_change", "instead")}
    sizes, sigmas = comparison.sizes(changed)
    for (index, rivals), size, sigma in zip(alternatives(comparison, changed), sizes, sigmas, strict=True):
        row, one = row_of[index], reported.by_numbers[row_of[index], index]  # a component may fall as its tilt grows
        rival_labels = " ".join(reported.rows[row_of[rival]].label for rival in rivals) or None
        values = {"changed": True, "change": size * one, "sigma_change": sigma * abs(one), "instead": rival_labels}
        for name, value in values.items():
            columns[name][row] = value
    return columns


def alternatives(compared: NumberComparison, changed: tuple[int, ...]) -> list[tuple[int, tuple[int, ...]]]:
    """Return each changed number with those that may have changed instead of it."""
    return list(zip(changed, compared.alternatives_to(changed), strict=True))
