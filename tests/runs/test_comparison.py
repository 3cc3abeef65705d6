"""Comparison of runs of one machine: changed numbers are named, unchanged ones are not, incomparable ones are
reported."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
from scipy.stats import binom, kstest
from typer.testing import CliRunner

from tests.blind.generator.effects import ActuatorGain
from tests.report.explained import unexplained
from tests.sentences import assert_says
from tests.stages.two_campaigns import fitted, gathered, longer, measured, model_text
from truing.pipeline.artifacts import Stamp, write_artifacts
from truing.pipeline.command_line import app
from truing.pipeline.problems import ExitCode
from truing.runs.comparison.steps import FALSE_ALARM, NAMES, matrix_step, mechanism_step, sensor_step
from truing.schemas.artifacts import ARTIFACTS
from truing.simulation.bench.extended_model import ExtendedSensor
from truing.simulation.mechanisms.causes.drive import ActuatorGain as Gain
from truing.simulation.mechanisms.extended_model import ExtendedModel, read_model

GAIN, LEG, LONGER_MM = 0.01, 3, 0.15
DRAWS = 80


def recorded(folder: Path, campaign: str, model: str | None, *tables: str) -> Path:
    """A run's folder with nothing in it but its model and empty tables."""
    stamp = Stamp("diagnose", "0" * 64, campaign, "0", ("qa", "model"))
    folder.mkdir()
    reported = {} if model is None else {"model": model}
    write_artifacts(folder, {name: ARTIFACTS[name].empty() for name in ("qa", *tables)} | reported, stamp, ())
    return folder


@pytest.fixture(scope="module")
def texts(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """Models of one machine: measured twice, then with a longer leg, then twice on one survey with its gain mended."""
    home = tmp_path_factory.mktemp("machine")
    hidden = ActuatorGain(GAIN * (np.arange(6) == LEG - 1))
    folders = {
        "spring": measured(home, 1, [hidden]),
        "summer": measured(home, 2, [hidden]),
        "autumn": measured(home, 3, [hidden], longer(5, LONGER_MM)),
        "mended": measured(home, 5, [], same_survey=True),
        "again": measured(home, 6, [], same_survey=True),
    }
    effects = {name: () if name in ("mended", "again") else (Gain((LEG,)),) for name in folders}
    return {name: model_text(fitted(gathered(folder), *effects[name]), name) for name, folder in folders.items()}


@pytest.fixture(scope="module")
def runs(texts: dict[str, str], tmp_path_factory: pytest.TempPathFactory) -> Path:
    home = tmp_path_factory.mktemp("runs")
    for name, text in texts.items():
        recorded(home / name, name, text)
    recorded(home / "bench", "bench", None, "readings")
    for name in ("once", "copy"):
        recorded(home / name, name, texts["spring"], "observations")
    recorded(home / "broken", "broken", texts["spring"].replace("actuator-gain", "witchcraft"))
    recorded(home / "other", "other", texts["spring"].replace('mechanism = "6-pus"', 'mechanism = "ups"'))
    started = recorded(home / "started", "started", texts["summer"])
    (started / "start.toml").write_text(texts["spring"], encoding="utf-8")
    recorded(home / "undiagnosed", "undiagnosed", None)
    (home / "empty").mkdir()
    return home


def called(runs: Path, *names: str) -> tuple[int, str, str]:
    """The command's exit code, what it said, and what it complained of."""
    done = CliRunner().invoke(app, ["compare", *(str(runs / name) for name in names)])
    return done.exit_code, done.stdout, done.stderr


def test_a_longer_leg_is_named_in_the_step_in_which_it_came(runs: Path) -> None:
    code, said, _ = called(runs, "spring", "summer", "autumn")
    assert code == ExitCode.DONE
    first = said.splitlines()[0]
    assert first.startswith("summer → autumn: 1 of ")
    assert "of leg 5 by" in first
    assert_says(said, "Nothing has changed", "chance", "spring → summer")
    table = pq.read_table(runs / "comparison" / "compared.parquet")
    assert not ARTIFACTS["compared"].faults(table)
    rows = table.to_pandas()
    assert not rows.duplicated(["place", *NAMES]).any()
    (changed,) = rows[rows["changed"]].itertuples()
    assert (changed.place, changed.leg) == (3, 5)
    # A leg that stands upright on its actuator is as well longer as it stands higher.
    assert {changed.parameter, changed.instead} in ({"l", "a_z5"}, {"a_z", "l5"})
    assert abs(changed.change - LONGER_MM) < 4 * changed.sigma_change
    assert changed.change > 20 * changed.sigma_change
    reported = rows[rows["place"] > 1].dropna(subset=["z"])
    assert np.allclose(reported["z"], reported["difference"] / reported["sigma_difference"])
    assert set(rows.loc[(rows["place"] > 1) & rows["z"].isna(), "reason"]) == {"not identifiable"}
    page = (runs / "comparison" / "comparison.html").read_text(encoding="utf-8")
    assert page.index("summer → autumn: 1 of ") < page.index("Nothing has changed beyond chance")
    assert not unexplained(page)


def test_an_effect_that_one_campaign_alone_found_is_no_change_of_the_geometry(runs: Path) -> None:
    """The effect that was mended took part of every number with it: its model is another one."""
    code, said, _ = called(runs, "spring", "mended")
    assert code == ExitCode.DONE
    assert_says(said, "Nothing has changed", "chance")
    rows = pd.read_parquet(runs / "comparison" / "compared.parquet")
    gain = rows[rows["effect_of"] == f"actuator-gain leg{LEG}"]
    assert list(gain["place"]) == [1]


def test_a_machine_that_was_rebuilt_is_not_reported_number_by_number(texts: dict[str, str]) -> None:
    before, now = (read_model(texts[name]) for name in ("spring", "summer"))
    step = mechanism_step(
        before, replace(now, shared=now.shared + np.random.default_rng(1).normal(size=len(now.shared)))
    )
    assert step.rebuilt
    assert step.rows["changed"].any()


@pytest.mark.parametrize(
    ("name", "why"),
    [
        ("undiagnosed", "undiagnosed left no extended model."),
        ("started", "started started from the model of spring, which its numbers rest on"),
    ],
)
def test_a_run_that_cannot_be_assessed_gives_the_reason(runs: Path, name: str, why: str) -> None:
    code, said, _ = called(runs, "spring", name)
    assert code == ExitCode.DONE
    assert_says(said, f"spring → {name}", "no number", why)


@pytest.mark.parametrize(
    ("names", "expected"),
    [
        (("spring",), "expected two runs or more"),
        (("spring", "summer", "spring"), "spring: expected each run once"),
        (("spring", "summer/../spring"), "spring: expected each run once"),
        (("once", "copy"), "copy: expected a run of other measurements than"),
        (("spring", "empty"), "empty: expected a folder that `truing run` has filled"),
        (("spring", "nowhere"), "nowhere: expected a folder that `truing run` has filled"),
        (("spring", "bench"), "bench: found 'a force sensor on its bench'; expected runs of the machine of"),
        (("spring", "other"), "other: found 'ups of 6 legs'; expected runs of the machine of"),
        (("spring", "broken"), "broken: expected a model.toml that `truing run` has written"),
    ],
)
def test_runs_that_cannot_be_compared_are_a_fault(runs: Path, names: tuple[str, ...], expected: str) -> None:
    code, _, errors = called(runs, *names)
    assert code == ExitCode.UNUSABLE_CAMPAIGN
    assert expected in errors


@pytest.mark.slow
def test_files_of_truing_next_to_runs_are_not_compared(runs: Path) -> None:
    """The pattern runs/* names the last comparison, and table and page of all campaigns, too."""
    called(runs, "spring", "summer")
    places = [runs / name for name in ("campaigns.html", "campaigns.parquet")]
    for place in places:
        place.touch()
    code, _, errors = called(runs, "spring", "summer", "comparison", *(place.name for place in places))
    for place in places:
        place.unlink()
    assert code == ExitCode.DONE, errors


def test_a_survey_that_both_rest_on_is_counted_once(texts: dict[str, str]) -> None:
    mended, again = (read_model(texts[name]) for name in ("mended", "again"))
    elsewhere = replace(again.model.known, shape=again.model.known.shape + 1e-6 * np.eye(3)[0])
    moved = replace(again, model=replace(again.model, known=elsewhere))
    same, other = (
        step.rows.set_index(["parameter", "leg"]).loc[["b_x", "b_y", "b_z"], "sigma_difference"].to_numpy(float)
        for step in (mechanism_step(mended, again), mechanism_step(mended, moved))
    )
    assert (same < 0.7 * other).all()


def test_a_campaign_of_another_drawing_is_not_assessed(texts: dict[str, str]) -> None:
    step = mechanism_step(*(read_model(texts["spring"].replace("a = 0.0005", f"a = {a}")) for a in (0.0005, 0.0006)))
    assert "tolerances" in step.why
    assert not len(step.rows)


def exact(text: str) -> ExtendedModel:
    """A model without effects whose survey brings no noise: tolerances are all that it shares with another one."""
    found = read_model(text)
    size = sum(len(part) for part in (found.model.nominal.a.ravel(), found.model.nominal.b.ravel())) + 18
    bare = replace(found, model=found.model.with_causes(()), survey_sigma=np.zeros_like(found.survey_sigma))
    return replace(bare, shared=found.shared[:size], covariance=found.covariance[:size, :size])


def test_no_change_is_reported_between_equal_campaigns(texts: dict[str, str]) -> None:
    """Estimates drawn to the same tolerances, of machines drawn from them: z is normal, alarms as rare as said."""
    rng = np.random.default_rng(5)
    models = [exact(texts[name]) for name in ("spring", "summer")]
    found = []
    reported = []
    for model in models:
        variances, directions = np.linalg.eigh(model.covariance)
        kept = np.minimum(variances, 1.0 - 1e-9)
        reported.append(((directions * kept) @ directions.T, (directions / np.sqrt(1 / (1 / kept - 1))) @ directions.T))
    for _ in range(DRAWS):
        truth = rng.normal(size=len(models[0].shared))
        drawn = [
            replace(
                model, shared=covariance @ root @ (root @ truth + rng.normal(size=len(truth))), covariance=covariance
            )
            for model, (covariance, root) in zip(models, reported, strict=True)
        ]
        found.append(mechanism_step(*drawn).rows)
    joints = [rows.loc[rows["parameter"].isin(["b_x", "b_y"]), "z"].to_numpy(float) for rows in found]
    assert all(kstest(z, "norm").pvalue > 1e-3 for z in np.transpose(joints))
    alarms = sum(bool(rows["changed"].any()) for rows in found)
    assert 0 < alarms <= binom.ppf(0.999, DRAWS, FALSE_ALARM)


COMPLIANCE = 1e-7 * (np.eye(6) + 0.02)
SPREAD = np.full(36, 1e-10)


def sensor(rng: np.random.Generator, changed: float = 0.0) -> ExtendedSensor:
    """A sensor identified with noise that is correlated between entries; one entry of it changed."""
    mixed = 0.6 * np.eye(36) + 0.4 / 36
    covariance = np.outer(SPREAD, SPREAD) * (mixed @ mixed.T)
    drawn = COMPLIANCE.ravel() + SPREAD * (mixed @ rng.normal(size=36)) + changed * (np.arange(36) == 7)
    ones = np.ones(6)
    return ExtendedSensor(
        drawn.reshape(6, 6), COMPLIANCE, ones, 633e-9, 20.0, effects=(), covariance=covariance, context={}
    )


def test_an_entry_of_the_compliance_that_changed_is_named() -> None:
    rng = np.random.default_rng(3)
    wide = np.full(36, 1e-8)
    wide[-1] = 0.3e-10  # less than its sigma: what the campaigns tell of this entry is what was simulated
    still = [sensor_step(sensor(rng), sensor(rng), wide).rows for _ in range(DRAWS)]
    z = np.array([rows["z"] for rows in still], float)
    assert np.isnan(z[:, -1]).all()
    assert still[0]["reason"].iloc[-1] == "not identifiable"
    assert all(kstest(column, "norm").pvalue > 1e-3 for column in z[:, :-1].T)
    alarms = sum(bool(rows["changed"].any()) for rows in still)
    assert alarms <= binom.ppf(0.999, DRAWS, FALSE_ALARM / 2)
    rows = sensor_step(sensor(rng), sensor(rng, 1e-9), wide).rows
    (named,) = rows[rows["changed"]].itertuples()
    assert named.parameter == "dy fy"
    assert abs(named.change - 1e-9) < 4 * named.sigma_change


def test_an_entry_of_the_matrix_that_changed_is_named() -> None:
    rng = np.random.default_rng(4)
    names = [f"{load} v{k}" for load in ("fx", "fy", "fz", "mx", "my", "mz") for k in range(1, 7)]

    def matrix(changed: float = 0.0) -> pd.DataFrame:
        value = 100.0 + 0.1 * rng.normal(size=36) + changed * (np.arange(36) == 4)
        named = {"group": "G_B", "effect_of": None, "leg": None, "parameter": names}
        return pd.DataFrame({**named, "value": value, "sigma": 0.1, "unit": "N/mV"})

    alarms = sum(bool(matrix_step(matrix(), matrix()).rows["changed"].any()) for _ in range(DRAWS // 2))
    assert alarms <= binom.ppf(0.999, DRAWS // 2, FALSE_ALARM / 2)
    rows = matrix_step(matrix(), matrix(2.0)).rows
    assert list(rows.loc[rows["changed"], "parameter"]) == [names[4]]
