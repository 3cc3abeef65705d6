"""Next loads: runs that separate causes of a bench, or improve one, with the stated effect."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pytest

from tests.blind.generator.sensor.campaign import draw_campaign
from tests.blind.generator.sensor.effects import Creep, StiffnessScale
from tests.blind.generator.sensor.folder import write_campaign
from tests.blind.generator.sensor.layout import Layout, Programme, Tolerance
from tests.stages.line import run_line, settings_of
from tests.tolerance import assert_between
from truing.estimation.design.rival_design import Fitted
from truing.inference.fit import Fit, fit_model
from truing.inference.fitted_model import FittedModel
from truing.inference.fitter import Fitter
from truing.inference.observations import Frames, Observations
from truing.inference.selection import CauseDiagnosis
from truing.report.diagnosis.effect_units import plain_size
from truing.report.numbers import approximate_duration
from truing.report.wordings.catalogue import confirming
from truing.schemas.artifacts import ARTIFACTS
from truing.schemas.campaign import Campaign
from truing.simulation.bench.causes.stiffness import Hysteresis
from truing.simulation.bench.causes.stiffness import StiffnessNonlinear as Nonlinear
from truing.simulation.bench.causes.stiffness import StiffnessScale as Scale
from truing.simulation.bench.known_readings import ReadingConditions, zeros_of
from truing.simulation.bench.model import BenchModel
from truing.stages.common.reading_arrays import LOAD_COLUMNS
from truing.stages.diagnosis.next_loads import PossibleRuns, next_run, possible_runs
from truing.stages.diagnosis.next_measurement import MeasurementPlan, Rivals, next_loads_of, planned
from truing.stages.diagnosis.rows import claim_of
from truing.stages.diagnosis.search import assembled_data, search_causes

LEVELS = (0, 300, 600, 900, 900, 900, 900, 0, 0, 0, 0)
LAYOUT = Layout(
    "held", tolerance=Tolerance(stiffness=0.02), programme=Programme(axes=("fz", "mx"), levels=LEVELS, uneven=0.0)
)
FULL_LOADS = Layout(
    "full", programme=Programme(axes=("fz", "mx"), levels=(0, 900, 0, 900, 0, -900, 0, -900, 0), uneven=0.0)
)
RIVAL = Hysteresis("fz")
DRAWS = 16


@dataclass(frozen=True)
class Case:
    """A campaign of a bench, and what was decided on it: creep, and hysteresis that shall be as good."""

    settings: Campaign
    alone: CauseDiagnosis
    diagnosis: CauseDiagnosis


@pytest.fixture(scope="module")
def case(tmp_path_factory: pytest.TempPathFactory) -> Case:
    made = draw_campaign(LAYOUT, [Creep((2,), 0.04, 900.0)], np.random.default_rng(5))
    folder = write_campaign(made, tmp_path_factory.mktemp("next") / "bench", 1)
    settings = settings_of(folder)
    gathered = assembled_data(run_line(folder, "ingest")[0], settings)
    diagnosis = search_causes(gathered, settings, lambda *_: None)
    found = diagnosis.verdicts[0]
    stand = Fitter(gathered.model, gathered.calibration, None, 0).prepared((RIVAL,))
    rival = replace(
        found,
        cause=RIVAL,
        verdict="indistinguishable",
        with_it=stand,
        rival=found.cause,
        log_odds=found.log_odds - 1.0,
    )
    alone = replace(diagnosis, verdicts=(found,))
    return Case(settings, alone, replace(diagnosis, verdicts=(found, rival)))


def test_rivals_are_distinguished_by_loads_that_the_bench_can_apply(case: Case) -> None:
    reported = next_loads_of(case.diagnosis, case.settings)
    assert not ARTIFACTS["next_loads"].faults(reported.table)
    rows = reported.table.to_pylist()
    assert {row["purpose"] for row in rows} == {"creep load fz against hysteresis load fz"}
    assert {row["channels"] for row in rows} == {"dx dy dz rx ry rz"}
    assert {name for name in LOAD_COLUMNS if any(row[name] for row in rows)} == {"fz_n"}
    assert max(abs(row["fz_n"]) for row in rows) <= 10e3
    assert {row["branch"] for row in rows} == {"unloaded", "loading", "unloading"}
    assert [row["time_s"] for row in rows if row["step"] == 0] == [0.0] * len({row["run"] for row in rows})
    creep = case.diagnosis.verdicts[0].cause
    for key, other in ((creep.key, "hysteresis (load fz)"), (RIVAL.key, "creep (load fz)")):
        assert reported.advice[key].kind == "separate"
        assert other in reported.advice[key].words
        assert "whichever of the two is right" in reported.advice[key].words
        assert f" This takes {approximate_duration(rows[0]['duration_s'])} of loading. " in reported.advice[key].words
    assert {(row["need"], row["measurements"]) for row in rows} == {("rival", 1)}
    assert min(row["odds_expected"] for row in rows if row["run"] == rows[-1]["run"]) >= 20.0


@pytest.fixture(scope="module")
def soft(tmp_path_factory: pytest.TempPathFactory) -> tuple[list[FittedModel], PossibleRuns, MeasurementPlan]:
    """A softer sensor or one that gets softer towards its range's ends, where it was only ever loaded fully."""
    made = draw_campaign(FULL_LOADS, [StiffnessScale(2, -0.01)], np.random.default_rng(6))
    folder = write_campaign(made, tmp_path_factory.mktemp("next") / "soft", 1)
    settings = settings_of(folder)
    found = assembled_data(run_line(folder, "ingest")[0], settings)
    fitter = Fitter(found.model, found.calibration, None, 0)
    causes = Scale("fz"), Nonlinear("fz")
    stands = [fitter.prepared((cause,)) for cause in causes]
    pair = Rivals(causes[0], next_run(stands[0]), causes[1], next_run(stands[1]))
    options: list[PossibleRuns] = []

    def reach(models: Sequence[Fitted]) -> PossibleRuns:
        options.append(possible_runs(settings, stands[0], models))
        return options[0]

    plan = planned(reach, [], [pair])[0][0]
    return stands, options[0], plan


def test_the_loads_distinguish_as_much_as_they_promise(
    soft: tuple[list[FittedModel], PossibleRuns, MeasurementPlan],
) -> None:
    """Both causes refitted to readings that are drawn with either of them: the odds that can be expected at least."""
    rng, (stands, options, plan) = np.random.default_rng(9), soft
    further = _conditions(options, np.repeat(plan.choice.chosen, plan.choice.times), stands[0].model)
    before = _log_odds(*(_fit(stand.model, stand.model.conditions, stands[0].measured) for stand in stands))
    after = np.array([[_odds_after(stands, options, further, n, rng) for _ in range(DRAWS)] for n in (0, 1)])
    gains = after - before * np.array([[1.0], [-1.0]])
    worse = int(np.argmin(gains.mean(1)))
    error = 4 * gains[worse].std(ddof=1) / np.sqrt(DRAWS)
    promised = float(np.log(plan.choice.final))
    assert promised >= np.log(20.0)
    assert_between(float(gains[worse].mean()), promised - error, promised + error, what="log odds")


def _conditions(options: PossibleRuns, chosen: Sequence[int], model: BenchModel) -> ReadingConditions:
    """The steps of the chosen runs, each of a name of its own."""
    whole = options.runs.conditions
    rows = [options.runs.run[k] * options.runs.steps + np.arange(options.runs.steps) for k in chosen]
    run = model.conditions.run.max() + 1 + np.repeat(np.arange(len(rows)), options.runs.steps)
    at = np.concatenate(rows)
    covariates = {name: values[at] for name, values in whole.covariates.items()}
    return ReadingConditions(run, whole.step[at], whole.time_s[at], whole.load[at], covariates, whole.span_s)


def _odds_after(
    stands: Sequence[FittedModel],
    options: PossibleRuns,
    further: ReadingConditions,
    right: int,
    rng: np.random.Generator,
) -> float:
    """The log odds of the right one after further runs, whose truth is drawn as it is known."""
    fitted, measured = next_run(stands[right]), stands[0].measured
    truth = rng.multivariate_normal(fitted.shared, fitted.covariance)
    exact = fitted.model.at(further).points(truth, np.zeros((len(further.load), 0)))[..., 0]
    sigma, zero = options.readout.sigma, options.readout.zero
    _, run = np.unique(further.run, return_inverse=True)
    read = exact + zero * rng.normal(size=(run.max() + 1, len(zero)))[run] + sigma * rng.normal(size=exact.shape)
    more = Observations(
        read[..., None], np.broadcast_to(sigma[:, None, None] ** 2, (*read.shape, 1, 1)), np.ones(read.shape, bool)
    )
    names = ("values", "covariance", "is_observed")
    both = Observations(*(np.concatenate([getattr(measured, name), getattr(more, name)]) for name in names))
    after = [_fit(stand.model, _joined(stand.model.conditions, further), both) for stand in stands]
    return _log_odds(*after) if right == 0 else -_log_odds(*after)


def _joined(first: ReadingConditions, second: ReadingConditions) -> ReadingConditions:
    covariates = {name: np.concatenate([value, second.covariates[name]]) for name, value in first.covariates.items()}
    arrays = {n: np.concatenate([getattr(first, n), getattr(second, n)]) for n in ("run", "step", "time_s", "load")}
    return replace(first, covariates=covariates, **arrays)


def _fit(model: BenchModel, conditions: ReadingConditions, measured: Observations) -> Fit:
    zeros = zeros_of(conditions.run, measured.is_observed, model.known.sigma)
    whole = replace(model, known=replace(model.known, zeros=zeros), conditions=conditions)
    local = np.zeros((len(conditions.load), whole.local_size))
    return fit_model(whole.predict, measured, Frames.of_numbers(len(local)), np.zeros(whole.shared_size), local)


def _log_odds(first: Fit, second: Fit) -> float:
    """The log ratio of marginal likelihoods."""
    both = [
        -0.5 * w.rest @ w.rest + 0.5 * np.linalg.slogdet(w.covariance())[1] for w in (first.whitened, second.whitened)
    ]
    return float(both[0] - both[1])


def test_a_cause_found_alone_keeps_its_own_words_next_to_loads_that_narrow_it_down(case: Case) -> None:
    reported = next_loads_of(case.alone, case.settings)
    rows = reported.table.to_pylist()
    assert {row["purpose"] for row in rows} == {"creep load fz: fraction"}
    assert all(row["expected"].startswith("fraction ± ") for row in rows)
    (advice,) = reported.advice.values()
    assert (advice.kind, advice.purpose) == ("confirm", "creep load fz: fraction")
    another = confirming(claim_of(case.alone.verdicts[0].cause, 6)).words
    assert advice.words.startswith(f"{another} Or apply th")
    assert f"{plain_size('fraction', rows[-1]['sigma_expected'], '1')}, by a factor of " in advice.words
    assert not advice.short


def test_loads_are_round_and_those_applied_before_are_said_to_be_repeated(
    soft: tuple[list[FittedModel], PossibleRuns, MeasurementPlan],
) -> None:
    _, options, _ = soft
    by_words = {run.loads_in_words: run for run in options.made if not run.words}
    for run in by_words.values():
        measured = set(np.abs(run.load[run.load != 0.0])) <= {9000.0} and run.load.any()
        assert bool(run.repeats) == bool(measured), run.loads_in_words


def test_a_suspected_cause_gets_no_proposed_loads(case: Case) -> None:
    doubted = replace(case.alone.verdicts[0], verdict="suspected")
    reported = next_loads_of(replace(case.alone, verdicts=(doubted,)), case.settings)
    assert len(reported.table) == 0
    assert reported.advice == {}
