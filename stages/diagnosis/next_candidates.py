"""What could be measured next: configurations within reach, and other surroundings where a model depends on them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from truing.estimation.design.rival_design import Candidates, Fitted, Instrument, candidates
from truing.schemas.covariates import own_name
from truing.simulation.bodies.causes.terms import CAME_FROM

if TYPE_CHECKING:
    from truing.schemas.campaign import Campaign
    from truing.simulation.mechanisms.legs.closures import Legs

# Corners of what can be reached, places between them, and single actuators moved alone: what candidates there are.
_CORNERS, _BETWEEN = 36, 48
_OF_BODIES = 40  # candidates where no configuration is to be chosen, but surroundings alone
_DIGITS, _ROUNDING_M = 6, 1e-6  # readings are asked for to a micrometre
# Temperatures this far from those measured are no trouble to set up, K.
_WARMER_K = 5.0
# A change of surroundings that moves no measurement by this many sigma does not matter to a model.
_MATTERS = 0.1
_HOUR_S = 3600.0
APPROACH, TIME, ORDER, TEMPERATURE = "approach", "time_s", "order", "temperature_c"


@dataclass(frozen=True)
class Level:
    """A value that a covariate can be given, and how to say so; nothing to be said of what is as usual."""

    value: Any
    words: str = ""


@dataclass(frozen=True)
class Possible:
    """Candidates: their conditions (readings (C, L), covariates by column), words on surroundings, columns that matter.

    ``repeated``: whether they are configurations that were measured, for want of a range; ``instrument`` is how they
    would be measured.
    """

    conditions: Any
    words: tuple[str, ...]
    matters: tuple[str, ...]
    repeated: bool
    instrument: Instrument

    what: ClassVar[tuple[str, str]] = ("configuration", "configurations")
    unit: ClassVar[str] = "pose"
    do: ClassVar[str] = "measure"
    between: ClassVar[str] = ", "

    @property
    def settable(self) -> tuple[str, ...]:
        """Return the covariates that matter and have one number per pose to be set; time passes by itself."""
        named = [name for name in self.matters if name not in (TIME, ORDER) and not name.startswith(CAME_FROM)]
        return tuple(name for name in named if self.conditions.covariates[name].ndim == 1)

    def seen(self, fitted: Fitted) -> Candidates:
        """Return the candidates as a fitted model sees them."""
        return candidates(fitted, self.conditions, self.instrument)

    def named(self, k: int) -> str:
        """Return a candidate in words: its readings, and what else to see to."""
        readings = " ".join(f"{value * 1e3:.3f}" for value in self.conditions.readings[k])
        return " ".join(filter(None, (f"rho {readings} mm" if readings else "", self.words[k]))) or "as before"

    def rows(self, k: int) -> list[dict[str, Any]]:
        """Return the row of a candidate; of covariates those that matter, and time only in words, for it will be what
        it is."""
        readings = {f"rho{leg}_mm": round(float(v * 1e3), 6) for leg, v in enumerate(self.conditions.readings[k], 1)}
        set_to = {name: float(self.conditions.covariates[name][k]) for name in self.settable}
        return [{**readings, **set_to, "conditions": self.words[k] or None}]


def possible(settings: Campaign, models: Sequence[Fitted], instrument: Instrument) -> Possible:
    """Return what could be measured next, to judge models by."""
    rng = np.random.default_rng(0)
    measured = models[0].model.conditions
    readings, repeated = _configurations(settings, measured.readings, models[0].model, rng)
    levels = {name: _levels(name, value) for name, value in measured.covariates.items()}
    levels = {name: found for name, found in levels.items() if found}
    matters = _matters(models, readings[_BETWEEN % len(readings)], levels, instrument)
    drawn = _drawn(levels, matters, len(readings), rng)
    covariates = {name: np.array([level.value for level in column]) for name, column in drawn.items()}
    said = [", ".join(filter(None, (column[c].words for column in drawn.values()))) for c in range(len(readings))]
    return Possible(conditions_at(measured, readings, covariates), tuple(said), matters, repeated, instrument)


def conditions_at(measured: Any, readings: NDArray, covariates: Mapping[str, NDArray]) -> Any:
    """Return conditions of new poses in the place of those that were measured.

    Whatever else is known pose by pose, where bodies were found, is as at one measured pose or another.
    """
    count, rows = len(readings), np.arange(len(readings)) % len(measured.readings)
    others = {f.name: getattr(measured, f.name) for f in fields(measured) if f.name not in ("readings", "covariates")}
    there = {name: value[rows] for name, value in others.items() if isinstance(value, np.ndarray)}
    return replace(measured, readings=readings, covariates=dict(covariates), poses=tuple(range(count)), **there)


def _configurations(
    settings: Campaign, measured: NDArray, model: Any, rng: np.random.Generator
) -> tuple[NDArray, bool]:
    """Return readings (C, L), m, and whether they are those that were measured."""
    if not model.part_count:
        return np.empty((_OF_BODIES, measured.shape[1])), False
    from truing.simulation.mechanisms.legs.kinematics import reaches

    legs: Legs = model.nominal
    reach = settings.workspace.rho_mm
    half = None if reach is None else reach * 1e-3
    low, high = (measured.min(0), measured.max(0)) if half is None else (legs.rho0 - half, legs.rho0 + half)
    found = _of_six(low, high, rng) if legs.count == 6 else _of_more(settings, low - legs.rho0, high - legs.rho0, rng)
    found = np.round(found, _DIGITS)
    within = np.all((found > low - _ROUNDING_M) & (found < high + _ROUNDING_M), 1)
    found = found[within & reaches(legs, found)]
    return (found, False) if len(found) else (measured, True)


def _of_six(low: NDArray, high: NDArray, rng: np.random.Generator) -> NDArray:
    """Return readings of six legs between limits (6,), each as free as the others."""
    corners = rng.permutation(np.array(np.meshgrid(*[[0.0, 1.0]] * 6)).reshape(6, -1).T)[:_CORNERS]
    alone = np.full((12, 6), 0.5)
    alone[np.arange(12), np.arange(12) % 6] = np.repeat([0.0, 1.0], 6)
    share = np.concatenate([rng.uniform(size=(_BETWEEN, 6)), corners, alone, np.full((1, 6), 0.5)])
    return np.asarray(low + share * (high - low))


def _of_more(settings: Campaign, low: NDArray, high: NDArray, rng: np.random.Generator) -> NDArray:
    """Return readings of more legs than six, which depend on each other, about within limits (L,) from reference."""
    from truing.estimation.design.feasible_region import FeasibleRegion
    from truing.simulation.mechanisms.parameters import full_set
    from truing.simulation.mechanisms.pose_regressors import pose_regressors
    from truing.simulation.mechanisms.structures.kinematic_model import KinematicModel
    from truing.stages.common.nominal_mechanism import plain_machine

    machine, half = plain_machine(settings), np.maximum(np.abs(low), np.abs(high))
    structure, free = KinematicModel(machine.legs.closure.name), np.full(6, np.inf)
    regressors = pose_regressors(structure, machine, full_set(machine, "none"), free, half)
    nowhere = np.empty((0, 6 + len(half)))
    region = FeasibleRegion(6, regressors.quantities, np.concatenate([free, half]), nowhere, nowhere)
    corners = rng.permutation(region.corners())[:_CORNERS]
    return np.asarray(regressors.at(np.concatenate([region.draw(_BETWEEN, rng), corners, np.zeros((1, 6))])).rho)


def _levels(name: str, value: NDArray) -> list[Level]:
    """Return what a covariate (B,) or (B, L) can be set to, the usual one first; nothing where it is not known."""
    if not np.isfinite(value).all():
        return []
    if value.ndim == 2:
        return _movements(name, value)
    if name.startswith(CAME_FROM):
        return _approaches(own_name(name.removeprefix(CAME_FROM)))
    low, high, middle = float(value.min()), float(value.max()), float(np.median(value))
    if name == TIME:
        return _times(value)
    if name == ORDER:
        return [Level(high + 1.0)]
    if name == TEMPERATURE:
        low, high = min(low, middle - _WARMER_K), max(high, middle + _WARMER_K)
        return [Level(middle), Level(low, f"at {low:.0f} °C"), Level(high, f"at {high:.0f} °C")]
    said = own_name(name)
    return [Level(middle), Level(low, f"at {said} = {low:.4g}"), Level(high, f"at {said} = {high:.4g}")]


def _times(value: NDArray) -> list[Level]:
    """Return the time of the next pose and that after a pause as long as the campaign, s."""
    span = float(np.ptp(value))
    last, step = float(value.max()), span / max(len(value) - 1, 1)
    pause = f"{span / _HOUR_S:.1f} h" if span >= _HOUR_S else f"{span / 60.0:.0f} min"
    return [Level(last + step), Level(last + step + span, f"after a pause of {pause}")]


def _approaches(drive: str) -> list[Level]:
    """Return from where a drive may come."""
    return [Level(1.0, f"approached with growing {drive}"), Level(-1.0, f"approached with falling {drive}")]


def _movements(name: str, value: NDArray) -> list[Level]:
    """Return how actuators may come to a pose, from what is known of how they came to others (B, L)."""
    size = 1.0 if name == APPROACH else float(np.median(np.abs(value)))
    legs = value.shape[1]
    turns = np.where(np.arange(legs) % 2 == 0, 1.0, -1.0)
    ways = {
        "growing readings of all legs": np.ones(legs),
        "falling readings of all legs": -np.ones(legs),
        "growing readings of the odd legs and falling ones of the even": turns,
        "growing readings of the even legs and falling ones of the odd": -turns,
    }
    by = "" if name == APPROACH else f" by {size * 1e3:.2f} mm"
    return [Level(way * size, f"approached with {words}{by}") for words, way in ways.items()]


def _matters(
    models: Sequence[Fitted], corner: NDArray, levels: Mapping[str, list[Level]], instrument: Instrument
) -> tuple[str, ...]:
    """Return the covariates that any of the models depends on at a corner of what can be reached."""
    usual = {name: found[0].value for name, found in levels.items()}
    trials = [(name, level.value) for name, found in levels.items() for level in found[1:]]
    rows = [usual, *({**usual, name: value} for name, value in trials)]
    table = {name: np.array([row[name] for row in rows]) for name in levels}
    found = set()
    for fitted in models:
        conditions = conditions_at(fitted.model.conditions, np.tile(corner, (len(rows), 1)), table)
        seen = candidates(fitted, conditions, instrument)
        moved = seen.freed((seen.predicted - seen.predicted[0])[..., None])[1:]
        size = np.sqrt(np.sum(moved**2, (1, 2)))
        found |= {name for (name, _), far in zip(trials, size, strict=True) if far > _MATTERS}
    return tuple(name for name in levels if name in found)


def _drawn(
    levels: Mapping[str, list[Level]], matters: tuple[str, ...], count: int, rng: np.random.Generator
) -> dict[str, list[Level]]:
    """Return a level of every covariate for each of ``count`` candidates: the usual one where it does not matter."""
    return {
        name: [
            found[k] if name in matters else replace(found[0], words="") for k in rng.integers(len(found), size=count)
        ]
        for name, found in levels.items()
    }
