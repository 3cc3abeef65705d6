"""A campaign that starts from an earlier one of the same machine uses its results, and reports changes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import chi2

from tests.blind.generator.effects import ActuatorGain
from tests.faults import assert_fault, faults_of
from tests.stages.line import run_line
from tests.stages.two_campaigns import MACHINE, fitted, gathered, longer, measured, model_text, rows_by_name
from tests.tolerance import assert_close
from truing.schemas.artifacts import ARTIFACTS
from truing.simulation.mechanisms.causes.drive import ActuatorGain as Gain
from truing.simulation.mechanisms.causes.warmth import LegThermal
from truing.simulation.mechanisms.extended_model import identified_geometry, read_model
from truing.simulation.mechanisms.prior import mechanism_prior
from truing.stages.diagnosis import search
from truing.stages.diagnosis.prior_campaign import changes_table, started, with_prior_campaign

GAIN, LEG, LONGER_MM = 0.01, 3, 0.15


def hidden(amount: float) -> ActuatorGain:
    return ActuatorGain(amount * (np.arange(6) == LEG - 1))


@pytest.fixture(scope="module")
def home(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("machine")


@pytest.fixture(scope="module")
def earlier(home: Path) -> str:
    """The model.toml of the first campaign, whose actuator 3 goes too far."""
    return model_text(fitted(gathered(measured(home, 1, [hidden(GAIN)])), Gain((LEG,))), "first")


@pytest.fixture(scope="module")
def unchanged(home: Path, earlier: str):
    return gathered(measured(home, 2, [hidden(GAIN)])), earlier


def sigmas(stand):
    geometry = identified_geometry(stand.model, stand.fit.shared, stand.covariance())
    return geometry.sigma, geometry.values


def test_an_unchanged_machine_has_no_changes(unchanged) -> None:
    found = started(*unchanged, 0)
    assert found.left_out == unchanged[0].left_out
    stand = fitted(found)
    table = changes_table(stand)
    assert not ARTIFACTS["changes"].faults(table)
    rows = rows_by_name(table)
    assert not any(row["changed"] for row in rows.values())
    z = np.array([row["z"] for row in rows.values() if row["z"] is not None])
    assert len(z) > 40
    assert np.abs(z).max() < 4.5
    assert rows[f"gain{LEG}"]["effect_of"] == f"actuator-gain leg{LEG}"
    assert abs(rows[f"gain{LEG}"]["now"] - GAIN) < 4 * rows[f"gain{LEG}"]["sigma_now"]


def test_two_campaigns_together_have_smaller_sigmas_than_either(unchanged) -> None:
    alone, both = sigmas(fitted(unchanged[0], Gain((LEG,)))), sigmas(fitted(started(*unchanged, 0)))
    assert np.median(both[0] / alone[0]) < 0.9
    assert (both[0] < 1.02 * alone[0]).all()


def test_the_effect_of_the_earlier_campaign_is_in_the_model_from_the_beginning(unchanged) -> None:
    model = started(*unchanged, 0).model
    assert [cause.key for cause in model.causes] == [Gain((LEG,)).key]
    assert [cause.key for cause in model.with_causes((Gain((LEG,)), Gain((1,)))).causes] == [
        Gain((LEG,)).key,
        Gain((1,)).key,
    ]


def test_errors_of_both_campaigns_agree_with_the_stated_covariance(unchanged, home: Path) -> None:
    """Identified minus true over the stated covariance, in all directions that are determined: a chi-square."""
    import json

    from tests.blind.generator.folder import truth_path

    stand = fitted(started(*unchanged, 0))
    geometry = identified_geometry(stand.model, stand.fit.shared, stand.covariance())
    truth = json.loads(truth_path(home / f"campaign-{MACHINE}-2").read_text(encoding="utf-8"))["geometry"]
    true = np.array([_true(truth, entry) for entry in geometry.parameters])
    scale = np.sqrt(np.diag(geometry.prior))
    variances, directions = np.linalg.eigh(geometry.covariance / np.outer(scale, scale))
    away = directions.T @ ((geometry.values - true) / scale)
    square = float(np.sum(away**2 / variances))
    low, high = chi2.ppf([5e-4, 1 - 5e-4], len(away))
    assert low < square < high


def _true(truth, entry) -> float:
    head, _, axis = entry.name.partition("_")
    value = truth[{"a": "a_mm", "b": "b_mm", "u": "u", "l": "length_mm"}[head]][entry.leg]
    return float(value["xyz".index(axis)] if axis else value) * entry.si


def test_a_leg_that_was_exchanged_is_named(home: Path, earlier: str) -> None:
    found = gathered(measured(home, 3, [hidden(GAIN)], longer(5, LONGER_MM)))
    begun = started(found, earlier, 0)
    rows = rows_by_name(changes_table(fitted(begun)))
    # A leg that stands upright on its actuator is as well longer as it stands higher.
    named = {name: row["instead"] for name, row in rows.items() if row["changed"]}
    assert named in ({"l5": "a_z5"}, {"a_z5": "l5"})
    assert set(
        begun.left_out.removeprefix("information of first on ").removesuffix(", which changed since").split(" or ")
    ) == {
        "l5",
        "a_z5",
    }
    (size, sigma), *others = [(row["change"], row["sigma_change"]) for row in rows.values() if row["changed"]]
    assert not others
    assert abs(size - LONGER_MM) < 4 * sigma + 0.02 * LONGER_MM
    assert size > 5 * sigma


def test_a_corrected_effect_is_reported_as_changed(home: Path, earlier: str) -> None:
    begun = started(gathered(measured(home, 4, [])), earlier, 0)
    rows = rows_by_name(changes_table(fitted(begun)))
    assert [name for name, row in rows.items() if row["changed"]] == [f"gain{LEG}"]
    assert abs(rows[f"gain{LEG}"]["now"]) < 4 * rows[f"gain{LEG}"]["sigma_now"]
    assert abs(rows[f"gain{LEG}"]["before"] - GAIN) < 4 * rows[f"gain{LEG}"]["sigma_before"]


def test_a_survey_that_both_rest_on_is_counted_once(home: Path) -> None:
    """The attachments by the survey are common to both campaigns, so the prior does not contain them again."""
    first, same, other = (gathered(measured(home, seed, same_survey=seed != 7)) for seed in (5, 6, 7))
    found = read_model(model_text(fitted(first), "first"))
    common, own = (mechanism_prior(found, one.model) for one in (same, other))
    joints = common.places(same.model)
    joints = (joints >= same.model.layout["b"].start) & (joints < same.model.layout["b"].stop)
    assert np.allclose(np.diag(own.shared), 1.0)
    assert np.allclose(np.diag(common.shared)[~joints], 1.0)
    surveyed = (same.model.known.geometry["b"] / found.survey_sigma.mean()) ** 2
    assert (np.diag(common.shared)[joints] > 0.3 * surveyed).all()
    assert (np.diag(common.shared)[joints] < 3.0 * surveyed).all()


def test_before_anything_new_is_measured_the_machine_is_where_the_earlier_campaign_left_it(home: Path) -> None:
    """Tolerances, the common survey and what is handed on pull in balance there: none of them twice."""
    stand = fitted(gathered(measured(home, 8, [hidden(GAIN)])), Gain((LEG,)))
    found = read_model(model_text(stand, "first"))
    handed_on = mechanism_prior(found, stand.model.with_causes(()))
    model = with_prior_campaign(stand.model.with_causes(()), handed_on)
    own, at = handed_on.places(model), np.zeros(model.shared_size)
    at[own] = handed_on.mean
    (surveyed, slopes), (reported, by_stated) = model.survey_rows(at), handed_on.rows(model, at)
    pull = (slopes.T @ surveyed + by_stated.T @ reported - at)[own]
    curvature = np.eye(len(own)) + (slopes.T @ slopes + by_stated.T @ by_stated)[np.ix_(own, own)]
    away = np.linalg.solve(curvature, pull) / np.sqrt(np.diag(np.linalg.inv(curvature)))
    assert np.abs(handed_on.mean).max() > 1.0  # in sigmas of the tolerances: there is something to be pulled back from
    assert np.abs(away).max() < 0.1  # not zero: the noise was learned, and the survey's weight with it
    ratio = np.sqrt(np.diag(np.linalg.inv(curvature)) / np.diag(handed_on.covariance))
    assert_close(ratio, np.ones(len(own)), atol=0.02)


def test_an_effect_whose_column_is_missing_is_left_out_and_reported(unchanged) -> None:
    found = unchanged[0]
    cold = {name: values for name, values in found.model.conditions.covariates.items() if name != "temperature_c"}
    bare = replace(found, model=found.model.at(replace(found.model.conditions, covariates=cold)))
    warm = fitted(found, LegThermal())
    poses = replace(found.calibration, conditions=replace(found.calibration.conditions, covariates=cold))
    begun = started(replace(bare, calibration=poses, held_out=None), model_text(warm, "warm"), 0)
    assert begun.model.causes == ()
    assert "leg-thermal of warm, whose columns are missing here" in begun.left_out


def test_a_file_that_is_no_model_is_a_fault(unchanged) -> None:
    text = unchanged[1].replace("actuator-gain", "witchcraft")
    fault = assert_fault(faults_of(lambda: started(unchanged[0], text, 0)), file="start.toml")
    assert "witchcraft" in fault.expected


def test_the_stages_start_from_it_and_leave_what_has_changed(
    home: Path, earlier: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """From campaign.toml on: what the first campaign found is no finding of the second, and is in its model."""
    folder = measured(home, 8, [hidden(GAIN)])
    (home / "last.toml").write_text(earlier, encoding="utf-8")
    document = (folder / "campaign.toml").read_text(encoding="utf-8")
    begun = document.replace("[mechanism]\n", '[mechanism]\nmodel = "../last.toml"\n', 1)
    (folder / "campaign.toml").write_text(begun, encoding="utf-8")
    monkeypatch.setattr(search, "DRAWS", 50)
    tables, said = run_line(folder, "ingest", "pose", "diagnose")
    assert said["diagnose"].figure.startswith("nothing found"), said["diagnose"].figure
    assert [cause.key for cause in read_model(tables["model"]).model.causes] == [Gain((LEG,)).key]
    assert not any(tables["changes"]["changed"].to_pylist())
    assert {row["cause"] for row in tables["diagnosis"].to_pylist() if row["verdict"] == "found"} == set()
