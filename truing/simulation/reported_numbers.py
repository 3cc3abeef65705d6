"""What a comparison of two campaigns says number by number, under the names and in the units of the tables."""

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

# A number of which the data take away less than this share of what was not known has not been measured anew.
TOLD = 0.05
_OF_SENSOR = ("geometry", "stiffness")
_AXES = {"a": "xyz", "b": "xyz", "u": "12", "l": ("",)}


@dataclass(frozen=True)
class Number:
    """One number that both campaigns have: what the tables call it, what it belongs to, and its scale in their unit."""

    name: str
    leg: int | None
    unit: str
    scale: float
    effect_of: str | None = None

    @property
    def label(self) -> str:
        """The number as a list of several names it."""
        return self.name if self.leg is None else f"{self.name}{self.leg}"


def numbers_of(prior: CampaignPrior, model: Any) -> list[Number]:
    """Return the numbers (n,) in their order; directions of actuators as tilts."""
    causes, found = {cause.key: cause for cause in prior.causes}, []
    for part in prior.parts:
        if part.name in _AXES:
            found += _of_geometry(part, model.part_count)
        elif part.name in _OF_SENSOR:
            found += _of_sensor(part, model.known.sensor)
        else:
            cause = causes[part.name]
            for p, scale in zip(cause.parameters(model.part_count), part.scale, strict=True):
                owner = f"{cause.id} {cause.subject}".strip()
                found.append(Number(*name_and_leg(p.name), p.unit, float(scale) / p.si, owner))
    return found


def _of_geometry(part: SharedUnknowns, legs: int) -> list[Number]:
    unit, si = ("1", 1.0) if part.name == "u" else ("mm", 1e-3)
    names = [(f"{part.name}_{axis}".removesuffix("_"), leg + 1) for leg in range(legs) for axis in _AXES[part.name]]
    return [Number(*named, unit, float(scale) / si) for named, scale in zip(names, part.scale, strict=True)]


def _of_sensor(part: SharedUnknowns, sensor: UncertainSensor) -> list[Number]:
    lengths = part.name == "geometry"
    named = sensor.unknowns[: sensor.geometry_size] if lengths else sensor.unknowns[sensor.geometry_size :]
    unit, si = ("mm", 1e-3) if lengths else ("1", 1.0)
    return [Number(name, leg, unit, float(size) / si) for (leg, name), size in zip(named, part.scale, strict=True)]


@dataclass(frozen=True)
class ReportedNumbers:
    """The rows of the table: what each is called, how it follows the numbers (R, n) in its unit, nominal (R,)."""

    rows: tuple[Number, ...]
    by_numbers: NDArray
    nominal: NDArray

    @property
    def columns(self) -> dict[str, list[Any]]:
        """What the rows are called, column by column."""
        return {name: [getattr(row, name) for row in self.rows] for name in ("leg", "unit", "effect_of")} | {
            "parameter": [row.name for row in self.rows]
        }


def reported_numbers(
    prior: CampaignPrior, model: EffectsModel, shared: NDArray, covariance: NDArray
) -> ReportedNumbers:
    """The geometry as the tables tell it, or a sensor's lengths and stiffnesses, then the effects."""
    if not isinstance(model, MechanismModel):
        rows = numbers_of(prior, model)
        return ReportedNumbers(tuple(rows), np.diag([row.scale for row in rows]), np.zeros(len(rows)))
    geometry, own = identified_geometry(model, shared, covariance), prior.places(model)
    parts = {part.name for part in prior.parts}
    kept = np.array([entry.name.partition("_")[0] in parts for entry in geometry.parameters], bool)
    entries = [entry for entry, reported in zip(geometry.parameters, kept, strict=True) if reported]
    si = np.array([entry.si for entry in entries])
    effects = [number for number in numbers_of(prior, model) if number.effect_of is not None]
    lower = np.zeros((len(effects), len(own)))
    lower[:, len(own) - len(effects) :] = np.diag([number.scale for number in effects])
    rows = [Number(entry.name, entry.leg + 1, entry.unit, entry.si) for entry in entries]
    by = np.concatenate([(geometry.by_shared[kept][:, own].T / si).T, lower])
    return ReportedNumbers((*rows, *effects), by, np.concatenate([geometry.nominal[kept] / si, np.zeros(len(effects))]))


def figures(
    prior: CampaignPrior,
    reported: ReportedNumbers,
    found: NumberComparison,
    now: NDArray,
    covariance: NDArray,
    level: float = LEVEL,
) -> dict[str, Any]:
    """Each row then and now, the difference over its sigma, and which changed; now (n,) with covariance (n, n)."""
    by = reported.by_numbers
    spread = np.sqrt(np.maximum(np.diag(by @ found.covariance @ by.T), 0.0))
    beforehand = np.diag(by @ np.linalg.inv(prior.shared) @ by.T)
    measured = np.diag(by @ covariance @ by.T) < (1.0 - TOLD) * beforehand
    return {
        "before": reported.nominal + by @ prior.mean,
        "sigma_before": np.sqrt(np.diag(by @ (prior.covariance + prior.frames) @ by.T)),
        "now": reported.nominal + by @ now,
        "sigma_now": np.sqrt(np.diag(by @ covariance @ by.T)),
        "sigma_difference": spread,
        "z": np.where(measured & (spread > 0), by @ found.difference / np.where(spread > 0, spread, 1.0), np.nan),
        **_changed(reported, found, level),
    }


def _changed(reported: ReportedNumbers, found: NumberComparison, level: float) -> dict[str, list[Any]]:
    """Which rows are those that changed, by how much, and which others may have done so in their place."""
    # A direction is told by components, each of which follows one of its two tilts most.
    row_of = {int(np.abs(reported.by_numbers[row]).argmax()): row for row in range(len(reported.rows))}
    changed, count = found.changed(level), len(reported.rows)
    if changed is None:
        return {"changed": [True] * count}
    columns: dict[str, list[Any]] = {"changed": [False] * count}
    columns |= {name: [None] * count for name in ("change", "sigma_change", "instead")}
    sizes, sigmas = found.sizes(changed)
    for (place, rivals), size, sigma in zip(alternatives(found, changed), sizes, sigmas, strict=True):
        row, one = row_of[place], reported.by_numbers[row_of[place], place]  # a component may fall as its tilt grows
        others = " ".join(reported.rows[row_of[rival]].label for rival in rivals) or None
        values = {"changed": True, "change": size * one, "sigma_change": sigma * abs(one), "instead": others}
        for name, value in values.items():
            columns[name][row] = value
    return columns


def alternatives(compared: NumberComparison, changed: tuple[int, ...]) -> list[tuple[int, tuple[int, ...]]]:
    """Each changed number with those that may have changed in its place."""
    return list(zip(changed, compared.instead(changed), strict=True))
