"""Next measurements of an open chain: measured poses again, and new ones, with other payloads or approaches."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from numpy.typing import NDArray

from truing.arrays import Array, TableRow
from truing.estimation.design.rival_design import Fitted, PointInstrument, PoseCandidates, candidates
from truing.schemas.faults import CampaignFaults
from truing.simulation.inputs import APPROACH, LAST_STEP, MEMORY, ORDER, STOPS, TEMPERATURE, TIME
from truing.simulation.mechanisms.chains.conditions import ChainConditions
from truing.simulation.mechanisms.chains.model import ChainModel
from truing.stages.common.chain_candidates import (
    JointRanges,
    drawn_readings,
    forbidden_poses,
    joint_ranges,
    with_predicted_orientations,
)
from truing.stages.diagnosis.next_candidates import conditions_at
from truing.stages.diagnosis.next_measurement import (
    MeasuredPoints,
    NextMeasurement,
    models_to_improve,
    plan_table,
    planned,
)

if TYPE_CHECKING:
    import pyarrow as pa

    from truing.inference.selection import CauseDiagnosis
    from truing.schemas.campaign import Campaign

# Numbers of candidates: poses as measured, and new ones within the range of the measured readings.
_AGAIN, _NEW = 40, 60
_NEW_PAYLOAD_KG = 1.0  # next to none, where the campaign has no payload
_WARMER_K = 5.0
# A change that moves no measurement of some poses by this many sigma does not matter to a model.
_MATTERS, _POSES_OF_A_TEST = 0.1, 12
_DIGITS = 4
_PAYLOAD = "payload_kg"


@dataclass(frozen=True)
class PossibleChainPoses:
    """Candidates: their conditions, words on payload and surroundings, columns that matter, and what they repeat."""

    conditions: ChainConditions
    ranges: JointRanges
    words: tuple[str, ...]
    matters: tuple[str, ...]
    repeats: tuple[int | str | None, ...]
    instrument: PointInstrument
    pace_s: float | None

    what: ClassVar[tuple[str, str]] = ("pose", "poses")
    unit: ClassVar[str] = "pose"
    each: ClassVar[str] = "measurement"
    do: ClassVar[str] = "measure"
    pace: ClassVar[str] = "at the pace of this campaign"

    def linearised(self, fitted: Fitted) -> PoseCandidates:
        """Return the candidates linearised about a fitted model."""
        return candidates(fitted, self.conditions, self.instrument)

    def words_of(self, k: int) -> str:
        """Return a candidate in words: readings, payload and surroundings."""
        if self.repeats[k] is not None:
            return ", ".join(filter(None, (f"pose {self.repeats[k]} again", self.words[k])))
        readings = " ".join(f"{name} {value:g}" for name, value in self._readings(k).items())
        return ", ".join(filter(None, (readings, self.words[k])))

    def _readings(self, k: int) -> dict[str, float]:
        readings = zip(self.ranges.columns, self.conditions.readings[k], strict=True)
        return {column.name: round(float(value / column.si), _DIGITS) for column, value in readings}

    def rows(self, k: int) -> list[TableRow]:
        """Return the table row of a candidate: readings, and payload and temperature where they matter."""
        again = None if self.repeats[k] is None else str(self.repeats[k])
        row: TableRow = {**self._readings(k), "conditions": self.words[k] or None, "repeat_of": again}
        if _PAYLOAD in self.matters:
            row[_PAYLOAD] = float(self.conditions.payload_kg[k])
        if TEMPERATURE in self.matters:
            row[TEMPERATURE] = float(self.conditions.covariates[TEMPERATURE][k])
        return [row]

    def sets_conditions(self, k: int) -> bool:
        """Return True if payload or surroundings must be changed."""
        return bool(self.words[k])

    def seconds(self, times: Mapping[int, int]) -> float | None:
        """Return the duration of candidates, with repeats, at the campaign's pace, s."""
        return None if self.pace_s is None else self.pace_s * sum(times.values())


def chain_measurements_of(
    diagnosis: CauseDiagnosis, settings: Campaign, tables: Mapping[str, pa.Table]
) -> NextMeasurement | None:
    """Next poses after a diagnosis of a chain; None where no range of the joints is known."""
    final = diagnosis.final
    model: object = final.model
    assert isinstance(model, ChainModel)
    instrument = MeasuredPoints(final.measured, final.fit.frames).instrument()
    try:
        ranges = joint_ranges(model.tree, settings, tables["joints"], tables["configurations"])
    except CampaignFaults:  # a joint that was never moved, and has no limits
        return None
    candidates_for = partial(possible_poses, _within_measured(ranges, settings, model), instrument)
    plans, advice = planned(candidates_for, *models_to_improve(diagnosis))
    return NextMeasurement(plan_table("next_poses", plans), advice)


def _within_measured(ranges: JointRanges, settings: Campaign, model: ChainModel) -> JointRanges:
    """Measured ranges, where [workspace] joints gives no others: at its limits the machine may collide."""
    is_limited = np.array([column.name in settings.workspace.joints for column in ranges.columns])
    measured = model.conditions.readings
    return replace(
        ranges,
        low=np.where(is_limited, ranges.low, measured.min(0)),
        high=np.where(is_limited, ranges.high, measured.max(0)),
    )


def possible_poses(ranges: JointRanges, instrument: PointInstrument, models: Sequence[Fitted]) -> PossibleChainPoses:
    """Candidates for a comparison of models: measured poses again, and new ones, with the payloads, approaches and
    temperatures on which a model depends."""
    rng, model = np.random.default_rng(0), models[0].model
    measured: ChainConditions = model.conditions
    again = rng.permutation(len(measured.readings))[:_AGAIN]
    new = drawn_readings(model.tree, ranges, forbidden_poses(model.tree, ranges, None, ""), _NEW, rng)
    readings = np.concatenate([measured.readings[again], new])
    repeats = tuple(measured.poses[k] for k in again) + (None,) * len(new)
    levels, few = _levels(model), readings[:: max(1, len(readings) // _POSES_OF_A_TEST)]
    usual = _conditions(model, few, {})
    seen = [candidates(fitted, usual, instrument) for fitted in models]
    changed = {
        name: _conditions(model, few, {name: np.array([levels_of_name[-1][0]] * len(few))})
        for name, levels_of_name in levels.items()
    }
    matters = tuple(name for name, conditions in changed.items() if _does_matter(seen, conditions, instrument))
    choice = {name: rng.integers(len(levels[name]), size=len(readings)) for name in matters}
    drawn = {name: np.array([levels[name][k][0] for k in choice_of_name]) for name, choice_of_name in choice.items()}
    words = tuple(
        ", ".join(filter(None, (levels[name][choice[name][c]][1] for name in matters))) for c in range(len(readings))
    )
    conditions = _conditions(model, readings, drawn)
    return PossibleChainPoses(conditions, ranges, words, matters, repeats, instrument, _pace(measured))


def _levels(model: ChainModel) -> dict[str, list[tuple[object, str]]]:
    """Values that payload, approach and temperature may have, the usual one first, each in words."""
    measured, result = model.conditions, dict[str, list[tuple[object, str]]]()
    if model.known.gravity is not None:
        usual = float(np.median(measured.payload_kg))
        other = 0.0 if usual else _NEW_PAYLOAD_KG
        result[_PAYLOAD] = [(usual, ""), (other, f"with a payload of {other:g} kg")]
    count = len(model.tree.readings)
    result[APPROACH] = [
        (np.ones(count), "approached with growing readings of all joints"),
        (-np.ones(count), "approached with falling readings of all joints"),
    ]
    if (temperature := measured.covariates.get(TEMPERATURE)) is not None and np.isfinite(temperature).all():
        middle = float(np.median(temperature))
        warm = float(round(max(float(temperature.max()), middle + _WARMER_K)))
        result[TEMPERATURE] = [(middle, ""), (warm, f"at {warm:g} °C")]
    return result


def _conditions(model: ChainModel, readings: NDArray, drawn: Mapping[str, NDArray]) -> ChainConditions:
    """Conditions of new poses after the campaign, usual where nothing else was drawn."""
    measured, count = model.conditions, len(readings)
    covariates = {name: _usual(values, count) for name, values in measured.covariates.items()}
    covariates[ORDER] = np.full(count, float(np.max(measured.covariates[ORDER])) + 1.0)
    if TIME in covariates:
        covariates[TIME] = np.full(count, float(np.nanmax(measured.covariates[TIME])) + (_pace(measured) or 0.0))
    if APPROACH in covariates:
        covariates[APPROACH] = np.ones(readings.shape)
    covariates |= {name: values for name, values in drawn.items() if name != _PAYLOAD}
    if LAST_STEP in covariates:  # a movement of usual size from the side of the approach
        steps = np.abs(measured.covariates[LAST_STEP])
        size = np.array([np.median(step[step > 0.0]) if (step > 0.0).any() else 0.0 for step in steps.T])
        covariates[LAST_STEP] = covariates[APPROACH] * size
    if MEMORY in covariates:  # after a long movement from there
        covariates[MEMORY] = np.repeat(covariates[APPROACH][..., None], len(STOPS), axis=-1)
    conditions: ChainConditions = conditions_at(measured, readings, covariates)
    payload = drawn.get(_PAYLOAD, np.full(count, float(np.median(measured.payload_kg))))
    conditions = replace(conditions, payload_kg=payload)
    return with_predicted_orientations(model.with_causes(()), conditions)


def _usual(values: NDArray, count: int) -> Array:
    """Median (count, ...) of finite values (B, ...) of each column."""
    finite = np.where(np.isfinite(values), values, np.nan)
    known = np.isfinite(finite).any(0)
    middle = np.where(known, np.nanmedian(np.where(known, finite, 0.0), axis=0), np.inf)
    return np.broadcast_to(middle, (count, *values.shape[1:])).copy()


def _does_matter(usual: Sequence[PoseCandidates], changed: ChainConditions, instrument: PointInstrument) -> bool:
    """True if changed conditions change what a model predicts at candidates by more than a share of the noise.

    ``usual``: these candidates at usual conditions, by each model.
    """
    for usual_candidates in usual:
        there = candidates(usual_candidates.fitted, changed, instrument)
        gap = usual_candidates.without_pose_unknowns((there.predicted - usual_candidates.predicted)[..., None])
        if float(np.sqrt(np.max(np.sum(gap**2, (1, 2))))) > _MATTERS:
            return True
    return False


def _pace(measured: ChainConditions) -> float | None:
    """Median time between poses, s; None if unknown."""
    time = measured.covariates.get(TIME)
    steps = np.empty(0) if time is None else np.diff(np.sort(time[np.isfinite(time)]))
    return float(np.median(steps[steps > 0.0])) if (steps > 0.0).any() else None
