"""Next measurements, ready for the machine: to distinguish rivals, or to halve the uncertainty of a finding."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, ClassVar, Protocol

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from truing.arrays import TableRow
from truing.estimation.design.rival_design import (
    ChosenPoses,
    Fitted,
    PointInstrument,
    PoseCandidates,
    discriminating_poses,
    narrowed,
)
from truing.inference.observations import Frames, Observations
from truing.report.numbers import approximate_duration, count_text, rough
from truing.report.wordings.catalogue import cause_of_subject, confirming, parameter_of_cause
from truing.report.wordings.claim import Advice, AdviceKind
from truing.report.wordings.nonparametric_wordings import columns_words
from truing.schemas.artifacts import ARTIFACTS
from truing.schemas.covariates import own_name
from truing.schemas.needs import Need
from truing.simulation.cause import Cause
from truing.stages.diagnosis.next_candidates import possible
from truing.stages.diagnosis.next_loads import next_run, possible_runs
from truing.stages.diagnosis.rows import claim_of

if TYPE_CHECKING:
    from truing.inference.fitted_model import FittedModel
    from truing.inference.selection import CauseDiagnosis
    from truing.schemas.campaign import Campaign

ODDS = 20.0
_HALF = 0.5
_MOST = 8  # configurations or runs that a person can set up together
# Step for numerical derivatives, as a share of a parameter's uncertainty.
_STEP = 1e-3
# Odds too small to justify a measurement.
_WORTH = 1.5
_NAMED = 4  # as many candidates as a sentence names
# A target that was never seen gives no information.
_UNSEEN_M2 = 1.0


class Options(Protocol):
    """Candidates for the next measurement, with their names."""

    what: ClassVar[tuple[str, str]]  # noun of a candidate, singular and plural
    unit: ClassVar[str]  # noun in which candidates are counted
    each: ClassVar[str]  # noun of one measurement of a candidate
    do: ClassVar[str]  # verb of a request
    pace: ClassVar[str]  # words after a duration

    def linearised(self, fitted: Fitted) -> PoseCandidates:
        """Return the candidates linearised about a fitted model."""

    def words_of(self, k: int) -> str:
        """Return a candidate in words."""

    def rows(self, k: int) -> list[TableRow]:
        """Return a candidate as rows of its table: the requested measurements."""

    def sets_conditions(self, k: int) -> bool:
        """True if a candidate requires a change of conditions, which takes additional time."""

    def seconds(self, times: Mapping[int, int]) -> float | None:
        """Return the duration of candidates, with repeats, at the campaign's own pace, s; None if unknown."""


# Candidates for the comparison of some fitted models.
CandidatesFor = Callable[[Sequence[Fitted]], Options]


@dataclass(frozen=True)
class MeasurementPlan:
    """Candidates chosen for a purpose, table columns for each, and the expected gain of all in words."""

    purpose: str
    need: Need
    options: Options
    choice: ChosenPoses
    expected: tuple[dict[str, object], ...]
    given: str

    @property
    def has_gain(self) -> bool:
        """True if any measurement gives a gain."""
        return self.choice.is_enough or (self.need == Need.RIVAL and self.choice.final >= _WORTH)

    @property
    def effort(self) -> float:
        """Return the number of poses or runs to measure; infinite if no number is sufficient."""
        return float(self.choice.total) if self.choice.is_enough else np.inf

    @property
    def duration_s(self) -> float | None:
        """Return the total duration at the campaign's own pace, s; None if unknown."""
        if not self.choice.is_enough:
            return None
        return self.options.seconds(dict(zip(self.choice.chosen, self.choice.times, strict=True)))

    def rows(self) -> Iterator[TableRow]:
        """Yield the rows of the plan, each with the number of the pose or run that it belongs to."""
        enough = self.choice.is_enough
        whole: dict[str, object] = {"purpose": self.purpose, "need": self.need.value}
        whole |= {"measurements": self.choice.total if enough else None, "duration_s": self.duration_s}
        chosen = zip(self.choice.chosen, self.choice.times, self.expected, strict=True)
        for n, (k, times, expected) in enumerate(chosen, 1):
            common_columns = {**whole, self.options.unit: n, "times": times if enough else None}
            yield from ({**common_columns, **row, **expected} for row in self.options.rows(k))

    def advice(self, kind: AdviceKind, aim: str) -> Advice:
        """Return the advice for an aim ("To ..."); its short form does not name the candidates."""
        chosen, (singular, plural) = self.choice.chosen, self.options.what
        named = "; ".join(self.options.words_of(k) for k in chosen[:_NAMED])
        more = "; ..." if len(chosen) > _NAMED else "."
        noun, short = singular if len(chosen) == 1 else plural, self.request(f"{aim},")
        return Advice(kind, f"{short} {noun[:1].upper()}{noun[1:]}: {named}{more}", short, self.purpose)

    def request(self, first: str) -> str:
        """Return sentences that begin with some words: measurement, repeats, duration, result."""
        count_of, (singular, plural) = len(self.choice.chosen), self.options.what
        noun = f"this {singular}" if count_of == 1 else f"these {count_of} {plural}"
        return f"{first} {self.options.do} {noun}{self._repeats()}. {self._duration()}{self.given}"

    def _repeats(self) -> str:
        """``, 13 times each (78 measurements in all)`` or ``, 3 measurements in all (1 to 2 of each)``; nothing where
        each is measured once, or no number is enough."""
        few, many, total = min(self.choice.times), max(self.choice.times), self.choice.total
        if not self.choice.is_enough or many == 1:
            return ""
        if len(self.choice.times) == 1:
            return f", {many} times"
        total_words = f"{count_text(total, self.options.each)} in all"
        return f", {many} times each ({total_words})" if few == many else f", {total_words} ({few} to {many} of each)"

    def _duration(self) -> str:
        """Return the total duration as a sentence; empty if unknown."""
        if self.duration_s is None:
            return ""
        changes = any(self.options.sets_conditions(k) for k in self.choice.chosen)
        more = ", plus the time to change conditions" if changes else ""
        return f"This takes {approximate_duration(self.duration_s)} {self.options.pace}{more}. "


def plan_table(artifact: str, plans: Sequence[MeasurementPlan]) -> pa.Table:
    """Return the candidates of all plans that lead somewhere, the most urgent need first, each in its order."""
    leading = sorted((plan for plan in plans if plan.has_gain), key=lambda plan: plan.need.rank)
    rows = [row for plan in leading for row in plan.rows()]
    present = tuple(dict.fromkeys(name for row in rows for name in row))
    return pa.Table.from_pylist(rows, schema=ARTIFACTS[artifact].arrow_schema(present=present))


@dataclass(frozen=True)
class MeasuredPoints:
    """Points of the fit, whose noise is that expected of further poses."""

    points: Observations
    frames: Frames

    def instrument(self) -> PointInstrument:
        """Return the instrument for further poses, with the mean noise of each target."""
        turned = np.swapaxes(self.frames.R, 1, 2)[:, None] @ self.points.covariance @ self.frames.R[:, None]
        is_observed = self.points.is_observed[..., None, None]
        count = is_observed.sum(0)
        mean = np.sum(np.where(is_observed, turned, 0.0), 0) / np.maximum(count, 1)
        return PointInstrument(np.where(count > 0, mean, np.eye(mean.shape[-1]) * _UNSEEN_M2), self.frames.free)


@dataclass(frozen=True)
class Rivals:
    """Two causes that explain the data equally, each in a model without the other; log_odds: of the first against the
    second now."""

    cause: Cause
    fitted: Fitted
    other: Cause
    other_fitted: Fitted
    log_odds: float = 0.0

    @property
    def legs(self) -> int:
        """Return the number of legs of the mechanism; 0 without one."""
        return int(self.fitted.model.part_count)


@dataclass(frozen=True)
class NextMeasurement:
    """Next measurements: next_poses.parquet or next_loads.parquet, and advice by a cause's key."""

    table: pa.Table
    advice: dict[str, Advice]


def next_of(diagnosis: CauseDiagnosis, settings: Campaign) -> NextMeasurement:
    """Return the next measurements after a diagnosis of poses."""
    final = diagnosis.final
    return next_measurements(settings, MeasuredPoints(final.measured, final.fit.frames), *models_to_improve(diagnosis))


def next_loads_of(diagnosis: CauseDiagnosis, settings: Campaign) -> NextMeasurement:
    """Return the next loads after a diagnosis of a bench.

    A finding without rivals keeps the words of its cause, which may need more than loads; its loads are in the table.
    """
    legs = diagnosis.plain.model.part_count
    found_causes, rivals = models_to_improve(diagnosis, next_run)
    plans, advice = planned(partial(possible_runs, settings, diagnosis.final), found_causes, rivals)
    alone = {cause.key: cause for cause, _ in found_causes}
    for pair in rivals:
        alone.pop(pair.cause.key, None)
    by_purpose = {plan.purpose: plan for plan in plans if plan.has_gain}
    advice_of_cause = {
        key: _with_another(_confirming(cause, legs), by_purpose.get(advice[key].purpose))
        for key, cause in alone.items()
    }
    return NextMeasurement(plan_table("next_loads", plans), {**advice, **advice_of_cause})


def _with_another(another: Advice, plan: MeasurementPlan | None) -> Advice:
    """Advice on another kind of measurement, followed by the plan as its alternative."""
    if plan is None:
        return another
    return replace(another, words=f"{another.words} {plan.request('Or')}", purpose=plan.purpose)


def _fitted(current: FittedModel) -> Fitted:
    return Fitted(current.model, current.fit.shared, current.covariance())


def models_to_improve(
    diagnosis: CauseDiagnosis, fitted: Callable[[FittedModel], Fitted] = _fitted
) -> tuple[list[tuple[Cause, Fitted]], list[Rivals]]:
    """Return the found causes with the final fit, and those with rivals."""
    accepted = {v.cause.key: v for v in diagnosis.verdicts if v.verdict in ("found", "suspected")}
    rivals = [
        Rivals(
            chosen.cause,
            fitted(chosen.with_it),
            verdict.cause,
            fitted(verdict.with_it),
            chosen.log_odds - verdict.log_odds,
        )
        for verdict in diagnosis.verdicts
        if verdict.rival is not None
        and (chosen := accepted.get(verdict.rival.key))
        and chosen.with_it
        and verdict.with_it
    ]
    final = fitted(diagnosis.final)
    # The size of an effect matters only once its cause is certain.
    sure = [verdict.cause for verdict in accepted.values() if verdict.verdict == "found" and verdict.cause.catalogued]
    return [(cause, final) for cause in sure], rivals


def next_measurements(
    settings: Campaign, measured: MeasuredPoints, found_causes: Sequence[tuple[Cause, Fitted]], rivals: Sequence[Rivals]
) -> NextMeasurement:
    """Return the configurations to measure next; as `planned`."""
    instrument = measured.instrument()
    plans, advice = planned(lambda models: possible(settings, models, instrument), found_causes, rivals)
    return NextMeasurement(plan_table("next_poses", plans), advice)


def planned(
    candidates_for: CandidatesFor,
    found_causes: Sequence[tuple[Cause, Fitted]],
    rivals: Sequence[Rivals],
    *,
    least_known: bool = False,
) -> tuple[list[MeasurementPlan], dict[str, Advice]]:
    """Return the next measurements, and advice by a cause's key: for each found cause without rivals, and for each pair
    of rivals.

    ``found_causes``: with their model; the plan reduces the uncertainty of the largest or least known parameter. A
    cause with several rivals gets the advice for the hardest one.
    """
    plans: list[MeasurementPlan] = []
    advice: dict[str, Advice] = {}
    assessed = [(_separating_plan(candidates_for, pair), pair) for pair in rivals]
    for plan, pair in sorted(assessed, key=lambda plan_and_pair: plan_and_pair[0].effort):
        plans.append(plan)
        for cause, rival in ((pair.cause, pair.other), (pair.other, pair.cause)):
            advice[cause.key] = _separation_advice(plan, cause, rival, pair.legs)
    for cause, fitted in found_causes:
        if cause.key not in advice:
            largest = _largest(cause, fitted, least_known)
            if largest is None:
                advice[cause.key] = _confirming(cause, fitted.model.part_count)
                continue
            plan, advice[cause.key] = _sharper(candidates_for, largest, fitted)
            plans.append(plan)
    return plans, advice


def _separating_plan(candidates_for: CandidatesFor, pair: Rivals) -> MeasurementPlan:
    both = pair.fitted, pair.other_fitted
    options = candidates_for(both)
    rivals = options.linearised(both[0]), options.linearised(both[1])
    choice = discriminating_poses(
        rivals, (_unshared_unknowns(*both), _unshared_unknowns(*both[::-1])), ODDS, _MOST, pair.log_odds
    )
    given = (
        f"The expected odds are then {_odds(choice.final)}, whichever of the two is right."
        if choice.is_enough
        else f"Even {count_text(choice.total, options.unit)} give expected odds of at most {_odds(choice.final)}."
    )
    expected = tuple({"expected": f"odds of {_odds(value)}", "odds_expected": value} for value in choice.values)
    purpose = f"{_name(pair.cause, pair.legs)} against {_name(pair.other, pair.legs)}"
    return MeasurementPlan(purpose, Need.RIVAL, options, choice, expected, given)


def _unshared_unknowns(fitted: Fitted, other: Fitted) -> NDArray:
    """Return the unknowns of one model that another lacks."""
    parts = [part for name, part in fitted.model.layout.items() if name not in other.model.layout]
    return np.concatenate([np.arange(part.start, part.stop) for part in parts])


def _separation_advice(plan: MeasurementPlan, proposal: Cause, other: Cause, legs: int) -> Advice:
    both, by_another = f"{_cause_noun(proposal, legs)} from {_cause_noun(other, legs)}", _confirming(other, legs).words
    if plan.choice.is_enough:
        return plan.advice(AdviceKind.SEPARATE, f"To distinguish {both}")
    if plan.has_gain:
        given_advice = plan.advice(AdviceKind.SEPARATE, f"To distinguish {both}")
        return replace(
            given_advice, words=f"{given_advice.words} {by_another}", short=f"{given_advice.short} {by_another}"
        )
    return Advice(
        AdviceKind.ANOTHER,
        f"No possible {plan.options.what[0]} distinguishes {both}: both predict the same results. "
        f"Another kind of measurement must decide. {by_another}",
    )


def _cause_noun(cause: Cause, legs: int) -> str:
    """The noun of a cause with its subject and its inputs, for a sentence."""
    follows = columns_words(cause.inputs(legs))
    return f"{cause_of_subject(cause.id, cause.subject)}{f' with {follows}' if follows else ''}"


def _confirming(cause: Cause, legs: int) -> Advice:
    return confirming(claim_of(cause, legs), cause.confirm)


def _sharper(candidates_for: CandidatesFor, largest: _Largest, fitted: Fitted) -> tuple[MeasurementPlan, Advice]:
    """Return the plan that reduces the uncertainty of a parameter, and the advice on it."""
    options = candidates_for((fitted,))
    choice = narrowed(options.linearised(fitted), largest.direction, _HALF, _MOST)
    name, legs = largest.name, fitted.model.part_count
    before, after = largest.uncertainty_words(1.0), largest.uncertainty_words(choice.final)
    falls = f"falls from {before} to {after}, by a factor of {rough(1.0 / choice.final)}"
    expected = tuple(largest.columns(value) for value in choice.values)
    purpose = f"{_name(largest.cause, legs)}: {name}"
    plan = MeasurementPlan(
        purpose, Need.PRECISION, options, choice, expected, f"The uncertainty of {name} then {falls}."
    )
    called = parameter_of_cause(name, largest.cause.id, largest.cause.subject)
    if plan.has_gain:
        return plan, plan.advice(AdviceKind.SHARPEN, f"To determine {called} more precisely")
    noun, more = options.what[0], count_text(choice.total, options.unit)
    vain = f"No possible {noun} halves the uncertainty of {called}: it is {before} now, and still {after} after {more}."
    vain += f" {_confirming(largest.cause, legs).words}"
    return plan, Advice(AdviceKind.IN_VAIN, vain)


@dataclass(frozen=True)
class _Largest:
    """Largest parameter of a cause, among those in the unit of its first, and its dependence on the unknowns (G,)."""

    cause: Cause
    name: str
    sigma: float
    unit: str
    direction: NDArray

    def uncertainty_words(self, times: float) -> str:
        """Return its uncertainty times a number, in words."""
        from truing.report.diagnosis.effect_units import plain_size

        return f"± {plain_size(self.name, times * self.sigma, self.unit)}"

    def columns(self, times: float) -> dict[str, object]:
        """Return the columns of a row after which its uncertainty is a given multiple of the present one."""
        text = f"{self.name} {self.uncertainty_words(times)}"
        return {
            "expected": text,
            "sigma_now": self.sigma,
            "sigma_expected": times * self.sigma,
            "unit": self.unit,
        }


def _largest(cause: Cause, fitted: Fitted, least_known: bool) -> _Largest | None:
    """Return the largest parameter that is fitted, or the least known one; None if there is none."""
    part, legs = fitted.model.layout[cause.key], fitted.model.part_count
    scale = fitted.model.effect_sigma(cause)
    values, covariance = fitted.shared[part] * scale, fitted.covariance[part, part] * np.outer(scale, scale)
    reported = cause.reported(values, covariance, legs)
    sigma_of = {k: float(entry.sigma) for k, entry in enumerate(reported) if entry.sigma}
    alike = [k for k in sigma_of if reported[k].unit == reported[min(sigma_of)].unit]
    if not alike:
        return None
    size_of = sigma_of if least_known else {k: abs(float(reported[k].value)) for k in alike}
    for best in sorted(alike, key=lambda k: -size_of[k]):
        direction = np.zeros(len(fitted.shared))
        for index, step in enumerate(_STEP * np.sqrt(np.diag(covariance))):
            nudge = step * (np.arange(len(values)) == index)
            ahead, behind = (
                float(cause.reported(values + sign * nudge, covariance, legs)[best].value) for sign in (1.0, -1.0)
            )
            direction[part.start + index] = (ahead - behind) / (2.0 * step) * scale[index]
        if direction.any():  # a pitch that the readings leave open depends on no unknown
            return _Largest(cause, reported[best].name, sigma_of[best], reported[best].unit, direction)
    return None


def _name(cause: Cause, legs: int) -> str:
    """Return the name of a cause for a table: its id, its subject and its inputs."""
    follows = tuple(map(own_name, cause.inputs(legs)))
    driven = f"with {follows[0]}{f' .. {follows[-1]}' if len(follows) > 1 else ''}" if follows else ""
    return " ".join(filter(None, (cause.id, cause.subject, driven)))


def _odds(value: float) -> str:
    if value < 1.0:
        return f"1:{1.0 / value:.2g}"
    return f"{value:.2g}:1" if value < 1000.0 else "1000:1 and more"
