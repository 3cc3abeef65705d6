"""Candidates for the next measurement: reachable configurations, and other conditions if a model depends on them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from truing.arrays import TableRow
from truing.estimation.design.rival_design import Fitted, PointInstrument, PoseCandidates, candidates
from truing.report.numbers import duration
from truing.schemas.covariates import own_name
from truing.simulation.bodies.causes.terms import CAME_FROM
from truing.simulation.inputs import (
    APPROACH,
    GRAVITY_IN,
    LAST_STEP,
    LOOKING_BACK,
    ORDER,
    RATE,
    RELAXING,
    STOPPED,
    TEMPERATURE,
    TIME,
)

if TYPE_CHECKING:
    from truing.schemas.campaign import Campaign
    from truing.simulation.mechanisms.legs.closures import Legs

# Numbers of candidates: corners of the reachable range, points between them, and single actuators moved alone.
_CORNERS, _BETWEEN = 36, 48
_FINEST_M = 1e-6  # proposed readings are rounded to a micrometre, or to the repeatability of the actuators
_TINY = 1e-6  # of a step: tolerance for limits on a step
_SAME = 5.0  # readings within so many of these steps are the same
_SHOWN_DIGITS = 4  # of a set value of the surroundings
# Temperatures this far from those measured are no trouble to set up, K.
_WARMER_K = 5.0
# Number of proposed attitudes of a body besides the usual one.
_ATTITUDES = 4
# A change of surroundings that moves no measurement by this many sigma does not matter to a model.
_MATTERS = 0.1


@dataclass(frozen=True)
class Level:
    """A possible value of a covariate, and its words; none for the usual value."""

    value: object
    words: str = ""


@dataclass(frozen=True)
class PossibleMeasurements:
    """Candidates: their conditions (readings (C, L), covariates by column), words on surroundings, columns that matter.

    ``repeats``: the measured pose that each repeats, None of new ones; ``instrument`` is how they would be measured;
    ``pace_s``: time from one pose of the campaign to the next, None where it is not known; ``pause_s`` (C,): the pause
    that comes before.
    """

    conditions: Any  # of the model's own type
    words: tuple[str, ...]
    matters: tuple[str, ...]
    repeats: tuple[int | str | None, ...]
    instrument: PointInstrument
    pace_s: float | None
    pause_s: NDArray

    what: ClassVar[tuple[str, str]] = ("configuration", "configurations")
    unit: ClassVar[str] = "pose"
    each: ClassVar[str] = "measurement"
    do: ClassVar[str] = "measure"
    pace: ClassVar[str] = "at the pace of this campaign"

    @property
    def settable(self) -> tuple[str, ...]:
        """Return the relevant covariates with one number per pose that can be set, so not time."""
        named = [name for name in self.matters if name not in (TIME, ORDER) and not name.startswith(CAME_FROM)]
        return tuple(name for name in named if self.conditions.covariates[name].ndim == 1)

    def linearised(self, fitted: Fitted) -> PoseCandidates:
        """Return the candidates linearised about a fitted model."""
        return candidates(fitted, self.conditions, self.instrument)

    def words_of(self, k: int) -> str:
        """Return a candidate in words: readings and other conditions."""
        readings = " ".join(f"{value * 1e3:.3f}" for value in self.conditions.readings[k])
        again = "" if self.repeats[k] is None else f"pose {self.repeats[k]} again"
        return " ".join(filter(None, (f"rho {readings} mm", again, self.words[k])))

    def rows(self, k: int) -> list[TableRow]:
        """Return the table row of a candidate with its relevant covariates; time only in words, because it cannot be
        set."""
        readings = {f"rho{leg}_mm": round(float(v * 1e3), 6) for leg, v in enumerate(self.conditions.readings[k], 1)}
        set_to = {name: float(self.conditions.covariates[name][k]) for name in self.settable}
        again = None if self.repeats[k] is None else str(self.repeats[k])
        return [{**readings, **set_to, "conditions": self.words[k] or None, "repeat_of": again}]

    def sets_conditions(self, k: int) -> bool:
        """True if covariates must be set to unusual values."""
        return bool(self.words[k]) and bool(self.settable)

    def seconds(self, times: Mapping[int, int]) -> float | None:
        """Return the duration of candidates, with repeats, at the campaign's pace and with one initial pause, s."""
        if self.pace_s is None:
            return None
        pause = max(self.pause_s[list(times)], default=0.0)
        return self.pace_s * sum(times.values()) + float(pause)


def possible(settings: Campaign, models: Sequence[Fitted], instrument: PointInstrument) -> PossibleMeasurements:
    """Return the candidates for the next measurement, to compare models."""
    rng = np.random.default_rng(0)
    measured, finest = models[0].model.conditions, _finest(settings)
    readings = _configurations(settings, measured.readings, models[0].model, finest, rng)
    step = _movement(measured.covariates.get(LAST_STEP), finest)
    levels = {name: _levels(name, value, step) for name, value in measured.covariates.items()}
    levels = {name: values for name, values in levels.items() if values}
    matters = _relevant_covariates(models, readings[_BETWEEN % len(readings)], levels, instrument)
    drawn = _drawn(levels, matters, len(readings), rng)
    covariates = {name: np.array([level.value for level in column]) for name, column in drawn.items()}
    texts = [
        ", ".join(dict.fromkeys(column[c].words for column in drawn.values() if column[c].words))
        for c in range(len(readings))
    ]
    return PossibleMeasurements(
        conditions_at(measured, readings, covariates),
        tuple(texts),
        matters,
        _repeats(readings, measured, finest),
        instrument,
        _pace(measured.covariates.get(TIME)),
        covariates[TIME] - levels[TIME][0].value if TIME in matters else np.zeros(len(readings)),
    )


def _finest(settings: Campaign) -> float:
    """Return the rounding of proposed readings, m: a power of ten, not below the actuators' repeatability."""
    sigma = settings.noise.actuator_mm * 1e-3
    return _FINEST_M if sigma <= _FINEST_M else float(10.0 ** np.ceil(np.log10(sigma)))


def _pace(time: NDArray | None) -> float | None:
    """Return the median time between poses, s; None if unknown."""
    steps = np.empty(0) if time is None else np.diff(np.sort(time[np.isfinite(time)]))
    return float(np.median(steps[steps > 0.0])) if np.any(steps > 0.0) else None


def _repeats(readings: NDArray, measured: Any, finest: float) -> tuple[int | str | None, ...]:
    """Return for each configuration (C, L) the measured pose with the same readings, or None."""
    away = np.max(np.abs(readings[:, None] - measured.readings), -1)
    nearest = np.nanargmin(np.where(np.isfinite(away), away, np.inf), 1)
    return tuple(
        measured.poses[near] if away[epoch, near] <= _SAME * finest else None for epoch, near in enumerate(nearest)
    )


def conditions_at(measured: Any, readings: NDArray, covariates: Mapping[str, NDArray]) -> Any:
    """Return conditions of new poses in place of the measured ones.

    Other quantities known pose by pose, such as body positions, are those of a measured pose.
    """
    count, rows = len(readings), np.arange(len(readings)) % len(measured.readings)
    others = {f.name: getattr(measured, f.name) for f in fields(measured) if f.name not in ("readings", "covariates")}
    values_at_rows = {name: value[rows] for name, value in others.items() if isinstance(value, np.ndarray)}
    return replace(
        measured, readings=readings, covariates=dict(covariates), poses=tuple(range(count)), **values_at_rows
    )


def _configurations(
    settings: Campaign, measured: NDArray, model: Any, finest: float, rng: np.random.Generator
) -> NDArray:
    """Return readings (C, L), m; the measured ones if no others are reachable."""
    from truing.simulation.mechanisms.legs.kinematics import reaches

    legs: Legs = model.nominal
    reach = settings.workspace.rho_mm
    half = None if reach is None else reach * 1e-3
    low, high = (measured.min(0), measured.max(0)) if half is None else (legs.rho0 - half, legs.rho0 + half)
    readings = (
        _of_six(low, high, legs.rho0, rng)
        if legs.count == 6
        else _redundant_leg_readings(settings, low - legs.rho0, high - legs.rho0, rng)
    )
    readings = finest * np.clip(
        np.round(readings / finest), np.ceil(low / finest - _TINY), np.floor(high / finest + _TINY)
    )
    readings = readings[reaches(legs, readings)]
    return readings if len(readings) and np.ptp(readings, 0).any() else measured


def _of_six(low: NDArray, high: NDArray, reference: NDArray, rng: np.random.Generator) -> NDArray:
    """Return readings of six legs between limits (6,), all independent; single ones leave the reference."""
    corners = rng.permutation(np.array(np.meshgrid(*[[0.0, 1.0]] * 6)).reshape(6, -1).T)[:_CORNERS]
    rest = np.clip(reference, low, high)
    alone = np.where(np.eye(6, dtype=bool), np.array([low, high])[:, None], rest).reshape(12, 6)
    share = np.concatenate([rng.uniform(size=(_BETWEEN, 6)), corners])
    return np.concatenate([low + share * (high - low), alone, rest[None]])


def _redundant_leg_readings(settings: Campaign, low: NDArray, high: NDArray, rng: np.random.Generator) -> NDArray:
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


def _levels(name: str, value: NDArray, step: float) -> list[Level]:
    """Return the possible values of a covariate (B,) or (B, L), the usual one first; none if it is unknown."""
    if not np.isfinite(value).all() or name == RATE:  # the machine stands still in new poses
        return []
    if name.startswith(GRAVITY_IN):
        return _attitudes(name.removeprefix(GRAVITY_IN), value)
    if name in RELAXING:  # new poses wait until the machine has relaxed
        return [Level(np.zeros(value.shape[1]))]
    if value.ndim == 2:
        return _movements(name, value.shape[1], step)
    if name.startswith(CAME_FROM):
        return _approaches(own_name(name.removeprefix(CAME_FROM)))
    low, high, middle = float(value.min()), float(value.max()), float(np.median(value))
    if name == TIME:
        return _times(value)
    if name == ORDER:
        return [Level(high + 1.0)]
    if name == TEMPERATURE:
        ends = [round(min(low, middle - _WARMER_K)), round(max(high, middle + _WARMER_K))]
        return [Level(middle), *(Level(float(end), f"at {end} °C") for end in ends)]
    texts = [f"{end:.{_SHOWN_DIGITS}g}" for end in (low, high) if end != middle]
    return [Level(middle), *(Level(float(end), f"at {own_name(name)} = {end}") for end in texts)]


def _times(value: NDArray) -> list[Level]:
    """Return the time of the next pose, and that after a pause as long as the campaign, s."""
    span = float(np.ptp(value))
    last, step = float(value.max()), span / max(len(value) - 1, 1)
    later = [Level(last + step + span, f"after a pause of {duration(span)}")] if span > 0.0 else []
    return [Level(last + step), *later]


def _approaches(drive: str) -> list[Level]:
    """Return the possible directions of approach of a drive."""
    return [Level(1.0, f"approached with growing {drive}"), Level(-1.0, f"approached with falling {drive}")]


def _attitudes(body: str, down: NDArray) -> list[Level]:
    """Return directions of gravity in a body's frame (3,), chosen from the measured ones (B, 3).

    The usual one comes first, then those farthest from it and from each other.
    """
    chosen = [int(np.argmin(np.sum((down - np.median(down, axis=0)) ** 2, axis=1)))]
    for _ in range(min(_ATTITUDES, len(np.unique(down, axis=0)) - 1)):
        squared_distance = np.min(np.sum((down[:, None] - down[chosen]) ** 2, axis=-1), axis=1)
        chosen.append(int(np.argmax(squared_distance)))
    words = [
        f"with gravity along ({', '.join(f'{x + 0.0:.2f}' for x in down[row])}) in the frame of {body}"
        for row in chosen
    ]
    return [Level(down[row], text) for row, text in zip(chosen, ["", *words[1:]], strict=True)]


def _movement(steps: NDArray | None, finest: float) -> float:
    """Return the usual movement of actuators between poses (B, L), m, in full steps; 0 without movement."""
    sizes = np.empty(0) if steps is None else np.abs(steps[np.isfinite(steps)])
    moved = sizes[sizes > _SAME * finest]
    return float(np.round(np.median(moved) / finest) * finest) if len(moved) else 0.0


def _movements(name: str, legs: int, step: float) -> list[Level]:
    """Return possible movements to a pose by ``step``, m; none if the actuators never moved so far."""
    is_state = name in (APPROACH, *STOPPED)
    if not step and not is_state:
        return [Level(np.zeros(legs))]
    size = 1.0 if is_state else step
    turns = np.where(np.arange(legs) % 2 == 0, 1.0, -1.0)
    directions = {
        "growing readings of all legs": np.ones(legs),
        "falling readings of all legs": -np.ones(legs),
        "growing readings of the odd legs and falling readings of the even legs": turns,
        "growing readings of the even legs and falling readings of the odd legs": -turns,
    }
    by = f" by {step * 1e3:.3f} mm" if step else ""
    return [Level(direction * size, f"approached with {words}{by}") for words, direction in directions.items()]


def _relevant_covariates(
    models: Sequence[Fitted], corner: NDArray, levels: Mapping[str, list[Level]], instrument: PointInstrument
) -> tuple[str, ...]:
    """Return the covariates on which any model depends at a corner of the reachable range."""
    usual = {name: distinct[0].value for name, distinct in levels.items()}
    trials = [(name, level.value) for name, distinct in levels.items() for level in distinct[1:]]
    rows = [usual, *({**usual, name: value} for name, value in trials)]
    table = {name: np.array([row[name] for row in rows]) for name in levels}
    distinct = set()
    for fitted in models:
        conditions = conditions_at(fitted.model.conditions, np.tile(corner, (len(rows), 1)), table)
        seen = candidates(fitted, conditions, instrument)
        moved = seen.without_pose_unknowns((seen.predicted - seen.predicted[0])[..., None])[1:]
        size = np.sqrt(np.sum(moved**2, (1, 2)))
        distinct |= {name for (name, _), far in zip(trials, size, strict=True) if far > _MATTERS}
    return tuple(name for name in levels if name in distinct)


def _drawn(
    levels: Mapping[str, list[Level]], matters: tuple[str, ...], count: int, rng: np.random.Generator
) -> dict[str, list[Level]]:
    """Return a level of every covariate for ``count`` candidates: the usual one if it is irrelevant.

    All covariates on the approach to a pose come from one movement.
    """
    direction_numbers = rng.integers(4, size=count)
    drawn = {}
    for name, levels_of_name in levels.items():
        places = direction_numbers if name in LOOKING_BACK else rng.integers(len(levels_of_name), size=count)
        drawn[name] = [
            levels_of_name[k % len(levels_of_name)] if name in matters else replace(levels_of_name[0], words="")
            for k in places
        ]
    return drawn
