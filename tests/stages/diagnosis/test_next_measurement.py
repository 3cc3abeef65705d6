"""Next measurements on a simulated machine whose legs warm up or drift while the temperature only rises."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import pytest

from tests.conftest import PROJECT
from tests.simulation.mechanisms.telescope import readings, sample_model, telescope
from tests.tolerance import assert_between, assert_close
from truing.estimation.design.rival_design import ChosenPoses, Fitted
from truing.estimation.rotation import exp_so3
from truing.inference.fit import Fit, fit_model
from truing.inference.observations import Frames, Observations
from truing.report.diagnosis.effect_units import plain_size
from truing.report.wordings.catalogue import confirming
from truing.report.wordings.claim import AdviceKind
from truing.schemas.artifacts import ARTIFACTS
from truing.schemas.campaign import Campaign, read_campaign
from truing.schemas.needs import Need
from truing.simulation.inputs import APPROACH, LAST_STEP, MEMORY
from truing.simulation.mechanisms.causes.deformation import LinearPlatformDeformation
from truing.simulation.mechanisms.causes.drive import ActuatorGain
from truing.simulation.mechanisms.causes.leg_drift import LegDrift
from truing.simulation.mechanisms.causes.targets import TargetsSwapped
from truing.simulation.mechanisms.causes.warmth import LegThermal
from truing.simulation.mechanisms.model import MechanismModel
from truing.simulation.mechanisms.recording import Conditions
from truing.simulation.targets import Targets, shape_unknowns
from truing.stages.diagnosis.chain_next import PossibleChainPoses
from truing.stages.diagnosis.next_candidates import PossibleMeasurements, _levels, possible
from truing.stages.diagnosis.next_loads import PossibleRuns
from truing.stages.diagnosis.next_measurement import (
    MeasuredPoints,
    MeasurementPlan,
    NextMeasurement,
    Options,
    Rivals,
    next_measurements,
)
from truing.stages.diagnosis.rows import claim_of

SIGMA_M = 5e-6
POSES = 14
SPAN_S = 7200.0
WARM, DRIFT = LegThermal(), LegDrift((), 0.0, SPAN_S)
ALPHA = 1.5e-6
DRAWS = 6


@pytest.fixture(scope="module")
def settings() -> Campaign:
    text = (PROJECT / "sample_data" / "telescope" / "campaign.toml").read_text(encoding="utf-8")
    return read_campaign(tomllib.loads(text))


@dataclass(frozen=True)
class Case:
    """A campaign, and each rival fitted to it."""

    measured: MeasuredPoints
    fitted: tuple[Fitted, Fitted]
    fits: tuple[Fit, Fit]

    def sigma(self, conditions: Conditions | None) -> float:
        """Return the uncertainty of the first's own parameter, with more poses measured where there are conditions."""
        first, after = self.fitted[0], self.fits[0]
        if conditions is not None:
            more = _measure(first.model.at(conditions), first.shared, np.random.default_rng(21))
            joined = first.model.at(_joined(first.model.conditions, conditions))
            after = _fit(joined, *_both(self.measured, more), first.shared)
        own = first.model.layout[WARM.key].start
        return float(np.sqrt(after.whitened.covariance()[own, own]) * first.model.effect_sigma(WARM)[0])

    def gain(self, conditions: Conditions, rng: np.random.Generator) -> float:
        """Return the gain in log odds of the first with more poses, its true values drawn from their estimate.

        The seats of the legs' survey frames keep their estimates: their roll is undetermined, and modelled for
        small angles only.
        """
        first = self.fitted[0]
        seat = np.arange(len(first.shared))[first.model.layout["seat"]]
        others = np.setdiff1d(np.arange(len(first.shared)), seat)
        truth = first.shared.copy()
        truth[others] += rng.multivariate_normal(np.zeros(len(others)), first.conditional_covariance(seat))
        more = _measure(first.model.at(conditions), truth, rng)
        both, frames = _both(self.measured, more)
        joined = _joined(first.model.conditions, conditions)
        after = [_fit(one.model.at(joined), both, frames, one.shared) for one in self.fitted]
        return _log_odds(after[0], after[1]) - _log_odds(*self.fits)


def _both(first: MeasuredPoints, second: MeasuredPoints) -> tuple[Observations, Frames]:
    names = ("values", "covariance", "is_observed")
    points = Observations(*(np.concatenate([getattr(first.points, n), getattr(second.points, n)]) for n in names))
    return points, Frames(*(np.concatenate([getattr(first.frames, n), getattr(second.frames, n)]) for n in "Rt"))


def _joined(first: Conditions, second: Conditions) -> Conditions:
    covariates = {name: np.concatenate([value, second.covariates[name]]) for name, value in first.covariates.items()}
    return replace(first, readings=np.concatenate([first.readings, second.readings]), covariates=covariates)


def _measure(model: MechanismModel, truth: np.ndarray, rng: np.random.Generator) -> MeasuredPoints:
    count = len(model.conditions.readings)
    points = model.points(truth, np.where(model.unpredicted, 0.01, 1.0) * rng.normal(size=(count, model.local_size)))
    R, t = exp_so3(rng.normal(0.0, 1.0, (count, 3))), rng.normal(0.0, 0.5, (count, 3))
    seen = points @ np.swapaxes(R, 1, 2) + t[:, None] + rng.normal(0.0, SIGMA_M, points.shape)
    covariance = np.broadcast_to(np.eye(3) * SIGMA_M**2, (*points.shape, 3))
    return MeasuredPoints(Observations(seen, covariance, np.ones(points.shape[:2], bool)), Frames(R, t))


def _fit(model: MechanismModel, measured: Observations, frames: Frames, shared: np.ndarray | None = None) -> Fit:
    start = np.zeros(model.shared_size) if shared is None else shared
    return fit_model(model.predict, measured, frames, start, np.zeros((len(frames.t), model.local_size)))


def _log_odds(first: Fit, second: Fit) -> float:
    """Return the log ratio of marginal likelihoods, but for what does not change with more poses."""
    both = []
    for fit in (first, second):
        w = fit.whitened
        own = np.log(np.abs(np.diagonal(w.local_factor, axis1=1, axis2=2))).sum()
        both.append(-0.5 * w.rest @ w.rest - own + 0.5 * np.linalg.slogdet(w.covariance())[1])
    return float(both[0] - both[1])


def _plain(rng: np.random.Generator, covariates: Mapping[str, np.ndarray]) -> tuple[MechanismModel, np.ndarray]:
    """Return a model and a truth that its survey belongs to."""
    model = sample_model(rng, POSES)
    model = model.at(Conditions(readings(rng, POSES), dict(covariates), tuple(range(POSES)), (0.0, SPAN_S)))
    truth = rng.normal(size=model.shared_size)
    truth[model.layout["seat"]] *= 1e-3
    shape = model.known.shape.copy()
    shape[model.targets.at_attachment] = model.legs(truth).b
    return replace(model, known=replace(model.known, shape=shape)), truth


def _case(model: MechanismModel, truth: np.ndarray, first: object, second: object, value: float) -> Case:
    right, wrong = model.with_causes((first,)), model.with_causes((second,))
    wide = model.embedded(truth, right)
    wide[right.layout[first.key]] = value / right.effect_sigma(first)
    measured = _measure(right, wide, np.random.default_rng(8))
    fits = tuple(_fit(one, measured.points, measured.frames) for one in (right, wrong))
    fitted = tuple(Fitted(one, f.shared, f.whitened.covariance()) for one, f in zip((right, wrong), fits, strict=True))
    return Case(measured, fitted, fits)


@pytest.fixture(scope="module")
def case() -> Case:
    rng = np.random.default_rng(4)
    time = np.linspace(0.0, SPAN_S, POSES)
    warmer = 20.0 + 3.0 * time / SPAN_S + rng.normal(0.0, 0.02, POSES)
    covariates = {
        "time_s": time,
        "temperature_c": warmer,
        "order": np.arange(POSES) * 1.0,
        "load": np.arange(POSES) % 3,
    }
    return _case(*_plain(rng, covariates), WARM, DRIFT, ALPHA)


@pytest.fixture(scope="module")
def stated(case: Case, settings: Campaign) -> NextMeasurement:
    return next_measurements(
        settings, case.measured, [(WARM, case.fitted[0])], [Rivals(WARM, case.fitted[0], DRIFT, case.fitted[1])]
    )


@pytest.fixture(scope="module")
def possibilities(case: Case, settings: Campaign) -> PossibleMeasurements:
    return possible(settings, case.fitted, case.measured.instrument())


def _chosen(stated: NextMeasurement, case: Case) -> Conditions:
    """Return the proposed poses as the table has them, at the time that its words ask for."""
    rows = [row for row in stated.table.to_pylist() for _ in range(row["times"])]
    rho = np.array([[row[f"rho{leg}_mm"] for leg in range(1, 7)] for row in rows]) * 1e-3
    late = np.array(["pause" in (row["conditions"] or "") for row in rows])
    time = SPAN_S * np.where(late, 2.0, 1.0) + SPAN_S / (POSES - 1)
    warm = np.array([row["temperature_c"] for row in rows])
    count = len(rows)
    return Conditions(
        rho, {"time_s": time, "temperature_c": warm, "order": np.full(count, POSES), "load": np.ones(count)}
    )


def test_the_table_is_complete_and_has_only_relevant_rows(stated: NextMeasurement) -> None:
    assert not ARTIFACTS["next_poses"].faults(stated.table)
    assert "load" not in stated.table.schema.names
    assert "temperature_c" in stated.table.schema.names
    assert {row["purpose"] for row in stated.table.to_pylist()} == {"leg-thermal against leg-drift"}


def test_warm_legs_are_distinguished_from_drifting_ones_at_another_temperature_or_time(stated: NextMeasurement) -> None:
    words = [row["conditions"] for row in stated.table.to_pylist()]
    assert all(words), words
    assert any("°C" in text or "pause" in text for text in words)
    for key, both in ((WARM.key, "leg thermal from leg drift"), (DRIFT.key, "leg drift from leg thermal")):
        assert stated.advice[key].kind == AdviceKind.SEPARATE
        assert f"To distinguish {both}, measure " in stated.advice[key].words
        odds = stated.table.column("odds_expected")[-1].as_py()
        assert odds >= 20.0
        assert f"The expected odds are then {odds:.2g}:1," in stated.advice[key].words


def test_proposed_poses_separate_rivals_as_predicted_and_repeated_poses_do_not(
    stated: NextMeasurement, case: Case, possibilities: PossibleMeasurements
) -> None:
    rng, chosen = np.random.default_rng(9), _chosen(stated, case)
    count = len(chosen.readings)
    later = SPAN_S * (1 + np.arange(1, count + 1) / POSES)
    usual = {"time_s": later, "temperature_c": 20.0 + 3.0 * later / SPAN_S}
    same = Conditions(readings(rng, count), {**chosen.covariates, **usual})
    proposed, random = (np.array([case.gain(at, rng) for _ in range(DRAWS)]) for at in (chosen, same))
    error = 4 * proposed.std(ddof=1) / np.sqrt(len(proposed))
    assert proposed.mean() > random.mean() + 2 * np.hypot(proposed.std(), random.std()) / np.sqrt(DRAWS)
    promised = stated.table.column("odds_expected")[-1].as_py()
    assert promised >= 20.0
    assert_between(float(proposed.mean()), np.log(promised) - error, np.log(promised) + error, what="log odds gained")
    assert_between(float(random.mean()), -3.0, np.log(20.0), what="log odds of more of the same")


def test_configurations_lie_within_the_workspace(possibilities: PossibleMeasurements, settings: Campaign) -> None:
    away = np.abs(possibilities.conditions.readings - telescope().rho0) * 1e3
    assert away.max() <= settings.workspace.rho_mm + 1e-3
    assert possibilities.matters == ("time_s", "temperature_c")


def test_without_a_workspace_they_lie_where_was_measured(case: Case, settings: Campaign) -> None:
    none = settings.model_copy(update={"workspace": settings.workspace.model_copy(update={"rho_mm": None})})
    found = possible(none, case.fitted, case.measured.instrument()).conditions.readings
    measured = case.fitted[0].model.conditions.readings
    assert (found >= measured.min(0) - 1e-6).all()
    assert (found <= measured.max(0) + 1e-6).all()


def test_rivals_that_no_pose_distinguishes_are_reported(settings: Campaign) -> None:
    """A gain and a deformation differ only in where the attachments are: here no target sits on any."""
    rng = np.random.default_rng(12)
    model, _ = _plain(rng, {"time_s": np.linspace(0.0, SPAN_S, POSES)})
    bare = _without(model, np.flatnonzero(model.targets.leg < 0))
    truth = rng.normal(size=bare.shared_size)
    gain, bend = ActuatorGain(), LinearPlatformDeformation()
    case = _case(bare, truth, gain, bend, 0.01)
    reported = next_measurements(settings, case.measured, [], [Rivals(gain, case.fitted[0], bend, case.fitted[1])])
    assert reported.advice[gain.key].kind == AdviceKind.ANOTHER
    assert "actuator gain from platform deformation linear" in reported.advice[gain.key].words
    assert confirming(claim_of(bend, 6)).words in reported.advice[gain.key].words
    assert len(reported.table) == 0


def _without(model: MechanismModel, kept: np.ndarray) -> MechanismModel:
    targets = Targets(model.targets.body[kept], model.targets.leg[kept])
    shape = model.known.shape[kept]
    survey = shape_unknowns(targets, shape, np.broadcast_to(np.eye(3) * SIGMA_M**2, (len(kept), 3, 3)))
    known = replace(model.known, shape=shape, survey=survey, carrying_legs=np.empty(0, int))
    return replace(model, targets=targets, known=known)


def test_a_cause_found_alone_is_to_be_known_twice_as_well(case: Case, settings: Campaign) -> None:
    reported = next_measurements(settings, case.measured, [(WARM, case.fitted[0])], [])
    assert reported.advice[WARM.key].kind == AdviceKind.SHARPEN
    sentence = reported.advice[WARM.key].words
    now, then = (reported.table.column(name)[-1].as_py() for name in ("sigma_now", "sigma_expected"))
    for size in (now, then):
        assert f"± {plain_size('alpha', size, '1/K')}" in sentence
    assert f"by a factor of {now / then:#.2g}." in sentence
    assert now / then >= 2.0
    assert {row["need"] for row in reported.table.to_pylist()} == {"precision"}


def test_the_uncertainty_promised_is_that_of_a_fit_with_the_proposed_poses(case: Case, settings: Campaign) -> None:
    """To first order: where a fit of what is drawn comes to lie changes its derivatives by some per cent."""
    reported = next_measurements(settings, case.measured, [(WARM, case.fitted[0])], [])
    now, then = (reported.table.column(name)[-1].as_py() for name in ("sigma_now", "sigma_expected"))
    conditions = _chosen(reported, case)
    (total,) = set(reported.table.column("measurements").to_pylist())
    assert total == len(conditions.readings)
    before = case.sigma(None)
    after = case.sigma(conditions)
    assert_close(before / now, 1.0, atol=1e-6, what="uncertainty now")
    assert_between(after / before, 0.95 * then / now, 1.05 * then / now, what="uncertainty after over that before")


def test_a_cause_without_a_measured_parameter_is_confirmed_as_it_says(case: Case, settings: Campaign) -> None:
    swapped = TargetsSwapped()
    fitted = replace(case.fitted[0], model=case.fitted[0].model.with_causes((WARM, swapped)))
    reported = next_measurements(settings, case.measured, [(swapped, fitted)], [])
    assert reported.advice == {swapped.key: confirming(claim_of(swapped, 6))}
    assert len(reported.table) == 0


def test_nothing_found_asks_for_nothing(case: Case, settings: Campaign) -> None:
    reported = next_measurements(settings, case.measured, [], [])
    assert not reported.advice
    assert not ARTIFACTS["next_poses"].faults(reported.table)


def _with(case: Case, **covariates: np.ndarray) -> Fitted:
    """Return the first fit with other columns."""
    model, known = case.fitted[0].model, case.fitted[0].model.conditions
    return replace(case.fitted[0], model=model.at(replace(known, covariates={**known.covariates, **covariates})))


def test_a_movement_to_a_pose_is_as_large_as_movements_were_and_never_nothing(case: Case, settings: Campaign) -> None:
    """If one actuator moves at a time, most last steps are zero; the proposed step is that of the moved ones."""
    alone = np.where(np.arange(6) == (np.arange(POSES) % 6)[:, None], 1.2345e-3, 0.0)
    still = np.zeros((POSES, 6))
    for steps, size in ((alone, 1.234e-3), (still, 0.0)):
        fitted = _with(case, **{LAST_STEP: steps, MEMORY: steps, APPROACH: np.ones((POSES, 6))})
        found = possible(settings, (fitted,), case.measured.instrument()).conditions.covariates
        for name in (LAST_STEP, MEMORY):
            assert_close(np.abs(found[name]), np.full(found[name].shape, size), atol=1e-9, what=name)
            same_way = np.sign(found[name]) == np.sign(found[APPROACH])
            assert same_way.all() or not size


def test_a_proposed_pose_that_was_measured_is_named_as_a_repeat(case: Case, settings: Campaign) -> None:
    """Within a workspace that actuators cannot resolve nothing is left but what was measured; else all is new."""
    none = settings.model_copy(update={"workspace": settings.workspace.model_copy(update={"rho_mm": 1e-6})})
    again = possible(none, case.fitted, case.measured.instrument())
    assert set(again.repeats) <= {*range(POSES)}
    assert f"pose {again.repeats[0]} again" in again.words_of(0)
    assert again.rows(0)[0]["repeat_of"] == str(again.repeats[0])
    fresh = possible(settings, case.fitted, case.measured.instrument())
    assert set(fresh.repeats) == {None}


def test_readings_are_asked_for_no_finer_than_actuators_repeat(case: Case, settings: Campaign) -> None:
    coarse = settings.model_copy(update={"noise": settings.noise.model_copy(update={"actuator_mm": 0.03})})
    found = possible(coarse, case.fitted, case.measured.instrument()).conditions.readings * 1e3
    assert_close(found, np.round(found, 1), atol=1e-9, what="readings")


def test_the_time_that_a_plan_takes_holds_the_pause_before_it(possibilities: PossibleMeasurements) -> None:
    pace = SPAN_S / (POSES - 1)
    late = next(k for k, words in enumerate(possibilities.words) if "pause" in words)
    usual = next(k for k, words in enumerate(possibilities.words) if "pause" not in words)
    assert_close(possibilities.seconds({usual: 3}), 3 * pace, atol=1e-6)
    assert_close(possibilities.seconds({usual: 3, late: 2}), 5 * pace + SPAN_S, atol=1e-6)
    assert replace(possibilities, pace_s=None).seconds({usual: 3}) is None
    warm = next(k for k, words in enumerate(possibilities.words) if "°C" in words)
    assert possibilities.sets_conditions(warm)
    plain = next(k for k, words in enumerate(possibilities.words) if not words)
    assert not possibilities.sets_conditions(plain)


def test_attitudes_are_proposed_of_those_that_were_measured_and_called_so() -> None:
    """A direction of gravity is no movement of actuators, although it has a number for each of several axes."""
    down = np.array([[0.0, 0.0, -1.0]] * 5 + [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    levels = _levels("gravity tool", down, 1e-3)
    assert levels[0].words == ""
    assert_close(levels[0].value, down[0], atol=0.0, what="usual direction")
    assert {tuple(level.value) for level in levels} == {tuple(row) for row in down}
    assert {level.words for level in levels[1:3]} == {
        "with gravity along (1.00, 0.00, 0.00) in the frame of tool",
        "with gravity along (0.00, 1.00, 0.00) in the frame of tool",
    }


@pytest.mark.parametrize(
    ("kind", "times", "repeats"),
    [
        (PossibleMeasurements, (1,), "measure this configuration."),
        (PossibleMeasurements, (3,), "measure this configuration, 3 times."),
        (PossibleMeasurements, (13,) * 6, "measure these 6 configurations, 13 times each (78 measurements in all)."),
        (PossibleChainPoses, (1, 1), "measure these 2 poses."),
        (PossibleChainPoses, (1, 2), "measure these 2 poses, 3 measurements in all (1 to 2 of each)."),
        (PossibleRuns, (15, 30), "apply these 2 load programmes, 45 runs in all (15 to 30 of each)."),
    ],
)
def test_a_request_says_how_many_measurements_it_takes(
    kind: type[Options], times: tuple[int, ...], repeats: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(kind, "seconds", lambda *_: None)
    choice = ChosenPoses(tuple(range(len(times))), times, (1.0,) * len(times), is_enough=True)
    plan = MeasurementPlan("", Need.PRECISION, kind.__new__(kind), choice, (), "So it is.")
    assert plan.request("To know it,") == f"To know it, {repeats} So it is."
