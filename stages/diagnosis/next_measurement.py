"""What to measure next, ready for the machine: to tell rivals apart, or to know what was found twice as well."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from schemas.artifacts import ARTIFACTS
from stages.diagnosis.next_candidates import Possible, possible
from truing.estimation.design.rival_design import Choice, Fitted, Instrument, candidates, narrowed, told_apart
from truing.estimation.diagnosis.point_fit import Frames, MeasuredPoints

if TYPE_CHECKING:
    import pyarrow as pa

    from schemas.campaign import Campaign
    from truing.estimation.diagnosis.acceptance import Diagnosis
    from truing.estimation.diagnosis.fitted_model import Stand

ODDS = 20.0
_HALF = 0.5
# As many configurations as a person sets up in one go, and as many as a sentence holds.
_MOST, _TOLD = 8, 4
# Of a parameter's uncertainty: how far it is moved to see what follows.
_STEP = 1e-3
# Odds that are worth no measurement.
_WORTH = 1.5
# A target that was never seen tells nothing.
_UNSEEN_M2 = 1.0


@dataclass(frozen=True)
class Measured:
    """What was measured for the fit: its noise is that expected of further poses."""

    points: MeasuredPoints
    frames: Frames

    def instrument(self) -> Instrument:
        """Return how further poses would be measured: with the mean noise of each target."""
        turned = np.swapaxes(self.frames.R, 1, 2)[:, None] @ self.points.covariance @ self.frames.R[:, None]
        seen = self.points.seen[..., None, None]
        count = seen.sum(0)
        mean = np.sum(np.where(seen, turned, 0.0), 0) / np.maximum(count, 1)
        return Instrument(np.where(count > 0, mean, np.eye(3) * _UNSEEN_M2), self.frames.free)


@dataclass(frozen=True)
class Rivals:
    """Two causes that explain the data alike, each in a model without the other; log_odds: of the first against the
    second so far."""

    cause: Any
    fitted: Fitted
    other: Any
    other_fitted: Fitted
    log_odds: float = 0.0

    @property
    def legs(self) -> int:
        """Return the number of legs of the mechanism; 0 without one."""
        return int(self.fitted.model.leg_count)


@dataclass(frozen=True)
class Next:
    """What to measure next: next_poses.parquet, and by a cause's key the sentence on it."""

    table: pa.Table
    sentences: dict[str, str]


@dataclass(frozen=True)
class _Plan:
    """Configurations chosen for a purpose, what each adds, and what all of them give, in words."""

    purpose: str
    what: Possible
    choice: Choice
    expected: tuple[str, ...]
    given: str
    least: float = 0.0  # of the choice's value, to be worth measuring

    @property
    def leads(self) -> bool:
        """Return whether the configurations lead to anything at all."""
        return self.choice.times is not None or self.choice.final >= self.least

    @property
    def effort(self) -> float:
        """Return the number of poses to measure; infinite where no number gives what is wanted."""
        return np.inf if self.choice.times is None else float(self.choice.times * len(self.choice.chosen))

    def sentence(self, aim: str) -> str:
        """Return what to measure for an aim ("To ..."), and what it gives."""
        return f"{aim}, measure {self._poses}: {self.given}."

    @property
    def _poses(self) -> str:
        count, places = len(self.choice.chosen), dict.fromkeys(self.choice.chosen)
        again = "" if self.choice.times in (1, None) else f", {self.choice.times} times each"
        named = ", ".join(self._configuration(k) for k in list(places)[:_TOLD])
        more = ", .." if len(places) > _TOLD else ""
        what = "this configuration" if count == 1 else f"these {count} configurations"
        return f"{what}{again} ({named}{more})"

    def _configuration(self, k: int) -> str:
        readings = " ".join(f"{value * 1e3:.3f}" for value in self.what.conditions.readings[k])
        return " ".join(filter(None, (f"rho {readings} mm" if readings else "", self.what.words[k]))) or "as before"


def next_of(diagnosis: Diagnosis, settings: Campaign) -> Next:
    """Return what to measure after a diagnosis."""
    final = diagnosis.final
    found = {verdict.cause.key: verdict for verdict in diagnosis.verdicts if verdict.verdict == "found"}
    rivals = [
        Rivals(own.cause, _fitted(own.own), other.cause, _fitted(other.own), own.log_odds - other.log_odds)
        for other in diagnosis.verdicts
        if other.verdict == "indistinguishable" and (own := found.get(other.reason)) and own.own and other.own
    ]
    measured = Measured(final.measured, final.fit.frames)
    return next_measurements(settings, measured, [(own.cause, _fitted(final)) for own in found.values()], rivals)


def _fitted(stand: Stand) -> Fitted:
    return Fitted(stand.model, stand.fit.shared, stand.covariance())


def next_measurements(
    settings: Campaign, measured: Measured, found: Sequence[tuple[Any, Fitted]], rivals: Sequence[Rivals]
) -> Next:
    """Return what to measure next: for each found cause without rivals, and for each pair of rivals.

    ``found`` are causes with the model that holds them. A cause with several rivals is told the hardest of them.
    """
    instrument = measured.instrument()
    plans: list[_Plan] = []
    sentences: dict[str, str] = {}
    judged = [(_apart(settings, pair, instrument), pair) for pair in rivals]
    for plan, pair in sorted(judged, key=lambda found: found[0].effort):
        plans.append(plan)
        for own, other in ((pair.cause, pair.other), (pair.other, pair.cause)):
            sentences[own.key] = _told_apart(plan, other, pair.legs)
    for cause, fitted in found:
        if cause.key not in sentences:
            largest = _largest(cause, fitted)
            if largest is None:
                sentences[cause.key] = cause.confirm
                continue
            plan, sentences[cause.key] = _sharper(settings, largest, fitted, instrument)
            plans.append(plan)
    return Next(next_poses(plans), sentences)


def _apart(settings: Campaign, pair: Rivals, instrument: Instrument) -> _Plan:
    what = possible(settings, (pair.fitted, pair.other_fitted), instrument)
    both = pair.fitted, pair.other_fitted
    rivals = candidates(both[0], what.conditions, instrument), candidates(both[1], what.conditions, instrument)
    choice = told_apart(rivals, (_own(*both), _own(*both[::-1])), ODDS, _MOST, pair.log_odds)
    count = len(choice.chosen) * (choice.times or 0)
    given = (
        f"odds of {_odds(ODDS)} are expected after {count} pose{'s' * (count > 1)}, whichever of the two is right"
        if choice.times
        else f"but odds of no more than {_odds(choice.final)} are expected, however often they are repeated"
    )
    expected = tuple(f"odds of {_odds(value)}" for value in choice.values)
    purpose = f"{_name(pair.cause, pair.legs)} against {_name(pair.other, pair.legs)}"
    return _Plan(purpose, what, choice, expected, given, _WORTH)


def _own(fitted: Fitted, other: Fitted) -> NDArray:
    """Return the unknowns that a model has and another has not."""
    parts = [part for name, part in fitted.model.layout.items() if name not in other.model.layout]
    return np.concatenate([np.arange(part.start, part.stop) for part in parts])


def _told_apart(plan: _Plan, other: Any, legs: int) -> str:
    if plan.leads:
        return plan.sentence(f"To tell it from {_name(other, legs)}")
    return (
        f"No configuration within reach tells it from {_name(other, legs)}: both predict the same there. "
        f"Another kind of measurement has to decide. {other.confirm}"
    )


def _sharper(settings: Campaign, largest: _Largest, fitted: Fitted, instrument: Instrument) -> tuple[_Plan, str]:
    """Return what narrows down a parameter."""
    what = possible(settings, (fitted,), instrument)
    choice = narrowed(candidates(fitted, what.conditions, instrument), largest.direction, _HALF, _MOST)
    name, expected = largest.told.name, tuple(f"{largest.told.name} {largest.sure(value)}" for value in choice.values)
    given = f"its uncertainty then falls from {largest.sure(1.0)} to {largest.sure(choice.final)}"
    if not choice.times:
        given = f"but however often they are repeated, its uncertainty stays {largest.sure(choice.final)} or more"
    plan = _Plan(f"{_name(largest.cause, fitted.model.leg_count)}: {name}", what, choice, expected, given)
    return plan, plan.sentence(f"To know {name} twice as well")


@dataclass(frozen=True)
class _Largest:
    """The largest parameter of a cause, of those in the unit of its first, and how it follows the unknowns (G,)."""

    cause: Any
    told: Any  # a `cause.Told`
    direction: NDArray

    def sure(self, times: float) -> str:
        """Return its uncertainty times a number, in words."""
        from truing.report.diagnosis.effect_units import plain_size

        return f"± {plain_size(self.told.name, times * self.told.sigma, self.told.unit)}"


def _largest(cause: Any, fitted: Fitted) -> _Largest | None:
    """Return the largest parameter; None where the cause has none that is measured."""
    part, legs = fitted.model.layout[cause.key], fitted.model.leg_count
    scale = fitted.model.effect_sigma(cause)
    values, covariance = fitted.shared[part] * scale, fitted.covariance[part, part] * np.outer(scale, scale)
    told = cause.told(values, covariance, legs)
    measured = [k for k, entry in enumerate(told) if entry.sigma]
    alike = [k for k in measured if told[k].unit == told[measured[0]].unit]
    if not alike:
        return None
    best = max(alike, key=lambda k: abs(told[k].value))
    direction = np.zeros(len(fitted.shared))
    for place, step in enumerate(_STEP * np.sqrt(np.diag(covariance))):
        nudge = step * (np.arange(len(values)) == place)
        ahead, behind = (cause.told(values + sign * nudge, covariance, legs)[best].value for sign in (1.0, -1.0))
        direction[part.start + place] = (ahead - behind) / (2.0 * step) * scale[place]
    return _Largest(cause, told[best], direction)


def _name(cause: Any, legs: int) -> str:
    """Return what tells a cause from others in a sentence: its subject, or what it follows where it has no name."""
    follows = cause.follows(legs)
    driven = f"following {follows[0]}{f' .. {follows[-1]}' if len(follows) > 1 else ''}" if follows else ""
    return " ".join(filter(None, (cause.id, cause.subject, driven)))


def _odds(value: float) -> str:
    if value < 1.0:
        return f"1:{1.0 / value:.2g}"
    return f"{value:.2g}:1" if value < 1000.0 else "1000:1 and more"


def next_poses(plans: Sequence[_Plan]) -> pa.Table:
    """Return the configurations of all plans that lead somewhere, one row per pose of a round."""
    import pyarrow as pa

    rows = [row for plan in plans if plan.leads for row in _rows(plan)]
    present = tuple(dict.fromkeys(name for row in rows for name in row))
    return pa.Table.from_pylist(rows, schema=ARTIFACTS["next_poses"].arrow_schema(present=present))


def _rows(plan: _Plan) -> list[dict[str, Any]]:
    """Return the rows of a plan; of covariates those that matter, and time only in words, for it will be what it is."""
    found = []
    for n, (k, expected) in enumerate(zip(plan.choice.chosen, plan.expected, strict=True), 1):
        readings = {
            f"rho{leg}_mm": round(float(v * 1e3), 6) for leg, v in enumerate(plan.what.conditions.readings[k], 1)
        }
        set_to = {name: float(plan.what.conditions.covariates[name][k]) for name in plan.what.settable}
        row = {"purpose": plan.purpose, "pose": n, **readings, **set_to}
        found.append(row | {"conditions": plan.what.words[k] or None, "expected": expected})
    return found
