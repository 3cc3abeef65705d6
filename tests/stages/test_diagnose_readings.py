"""The diagnosis of a loaded sensor: the sample's hidden offset is named and sized, and its model predicts."""

from __future__ import annotations

import json
import tomllib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.compute as pc
import pytest
from scipy.stats import chi2

from docs.experiments import force_sensor_campaign
from tests.blind.generator.folder import truth_path
from tests.docs.shown import assert_shown, shown
from tests.sensor_campaign import CHANNELS, campaign_toml, measured, write_campaign
from tests.stages.line import run_line
from tests.tolerance import assert_between, assert_close
from truing.schemas.campaign import read_campaign
from truing.schemas.faults import CampaignFaults
from truing.simulation.bench.extended_model import predict_readings, read_sensor, write_sensor
from truing.simulation.bench.known_readings import ReadingConditions
from truing.stages.common.belonging import reason_withheld
from truing.stages.common.reading_arrays import load_steps
from truing.stages.diagnosis.reading_points import reading_model
from truing.stages.predict import predict

SAMPLE = Path(__file__).resolve().parents[2] / "sample_data" / "force-sensor"
CERTAINTY = 0.999


@pytest.fixture(scope="module")
def tables() -> dict[str, Any]:
    return run_line(SAMPLE, "ingest", "diagnose")[0]


@pytest.fixture(scope="module")
def table() -> pa.Table:
    """The sample's load steps without what was read."""
    frame = pd.read_csv(SAMPLE / "interferometer.csv")
    return pa.Table.from_pandas(frame.drop(columns="reading"), preserve_index=False)


@pytest.mark.parametrize(("every", "known"), [(20, True), (5, False)])
def test_missing_values_of_a_column_are_interpolated_in_time(tables: dict[str, Any], every: int, known: bool) -> None:
    """Steps of which signals alone are left say nothing of the air; where many are, nor does the column."""
    settings = read_campaign(tomllib.loads((SAMPLE / "campaign.toml").read_text(encoding="utf-8")))
    name, readings = "relative_humidity_pct", tables["readings"]
    whole = reading_model(tables, settings).steps.covariates[name]
    lacks = pa.array(readings["step"].to_numpy() % every == 3)
    column = pc.if_else(lacks, None, readings[name])
    lacking = readings.set_column(readings.schema.get_field_index(name), name, column)
    found = reading_model({**tables, "readings": lacking}, settings).steps.covariates
    assert (name in found) is known
    if known:
        assert_close(found[name], whole, atol=3.0 * float(np.abs(np.diff(whole)).mean()))


def test_the_sideways_z_load_is_named_and_sized_and_nothing_else_is_found(tables: dict[str, Any]) -> None:
    found = [row for row in tables["diagnosis"].to_pylist() if row["verdict"] == "found"]
    assert [(row["cause"], row["subject"]) for row in found] == [("load-eccentricity", "load fz")]
    reported = json.loads(found[0]["parameters"])
    truth = json.loads(truth_path(SAMPLE).read_text(encoding="utf-8"))["effects"][0]["parameters"]
    pulls = [(reported[name]["value"] - truth[name]["value"]) / reported[name]["sigma"] for name in truth]
    assert float(np.sum(np.square(pulls))) < chi2.ppf(CERTAINTY, len(pulls))
    assert found[0]["unit"] == "um"
    assert found[0]["rms_before"] > 3 * found[0]["rms_after"]


def test_residuals_of_every_channel_are_noise_less_one_zero_per_run(tables: dict[str, Any]) -> None:
    errors, declared = tables["reading_errors"].to_pandas(), {"um": 0.5, "arcsec": 0.2, "mV": 0.01}
    for channel, own in errors.groupby("channel"):
        # About 126 readings of a channel, 756 of a signal; one zero per run is not in them.
        runs = own["run"].nunique()
        assert_close(own.groupby("run")["missed_after"].mean(), np.zeros(runs), atol=1e-9)
        rms = float(np.sqrt(np.sum(own["missed_after"] ** 2) / (len(own) - runs)))
        ratio, spread = rms / declared[own["unit"].iloc[0]], 1.0 / np.sqrt(2 * (len(own) - runs))
        assert_between(ratio, 1 - 4 * spread, 1 + 4 * spread, what=f"noise of {channel} over the declared one")


def test_the_noise_floor_of_a_channel_is_that_of_its_errors(tables: dict[str, Any]) -> None:
    """Errors lack one zero per run: the noise as declared is none to compare them with."""
    errors, declared = tables["reading_errors"].to_pandas(), {"um": 0.5, "arcsec": 0.2, "mV": 0.01}
    for channel, own in errors.groupby("channel"):
        runs, count = own["run"].nunique(), len(own)
        (floor,) = own["noise_floor"].unique()
        expected = declared[own["unit"].iloc[0]] * np.sqrt(1.0 - runs / count)
        drawn = 4.0 / np.sqrt(2.0 * 24 * (count - runs))  # 24 draws of all noise
        assert floor <= expected * (1.0 + drawn)  # what is fitted takes out a little more
        rms = float(np.sqrt(np.mean(own["missed_after"] ** 2)))
        spread = 4.0 / np.sqrt(2 * (count - runs))
        assert_between(rms / floor, 1.0 - spread, 1.0 + spread, what=f"rms of {channel} over its floor")


def test_the_lengths_and_stiffnesses_stay_within_their_tolerances(tables: dict[str, Any]) -> None:
    sums = tables["pull_sums"].to_pandas().set_index("model").loc["extended"]
    assert sums["p_value"] > (1 - CERTAINTY) / 2
    assert tables["pulls"].to_pandas()["identifiable"].any()


def test_the_model_predicts_what_was_read_and_text_keeps_all_of_it(tables: dict[str, Any], table: pa.Table) -> None:
    text = str(tables["model"])
    assert write_sensor(read_sensor(text)) == text
    said = predict(text, table, "loads.csv").to_pandas()
    read = pd.read_csv(SAMPLE / "interferometer.csv")["reading"]
    missed = read - said["reading"]
    missed -= missed.groupby(said["run"]).transform("mean")
    freedom = len(said) - said["run"].nunique()
    noise = said["unit"].map({"um": 0.5, "arcsec": 0.2})
    low, high = chi2.ppf([(1 - CERTAINTY) / 2, (1 + CERTAINTY) / 2], freedom)
    assert_between(float(np.sum((missed / noise) ** 2)), float(low), float(high), what="sum of squares")
    assert (said["sigma"] < noise).all()  # some 120 readings of each say more than one does


def test_beams_as_they_were_declared_go_with_the_model(tables: dict[str, Any]) -> None:
    extended, steps = read_sensor(str(tables["model"])), load_steps(tables)
    conditions = ReadingConditions(steps.run, steps.step, steps.time_s, steps.load, {})
    rows = np.eye(6) + np.outer(np.eye(6)[2], [0.02, -0.01, -3e-4, 0.03, 0.04, 0.0])
    askew = read_sensor(write_sensor(replace(extended, rows=rows)))
    expected = predict_readings(extended, conditions).value @ rows.T
    assert_close(predict_readings(askew, conditions).value, expected, atol=1e-15)


def test_uncertainty_of_a_prediction_is_that_of_the_compliance_and_the_effect(tables: dict[str, Any]) -> None:
    """Against draws of both from their joint covariance, each through the model itself."""
    extended, steps = read_sensor(str(tables["model"])), load_steps(tables)
    rows = np.flatnonzero((steps.load[:, 2] > 0) & (steps.load[:, 2] == steps.load[:, 2].max()))[:1]
    there = steps.subset(np.isin(np.arange(len(steps.run)), rows))
    conditions = ReadingConditions(there.run, there.step, there.time_s, there.load, {})
    found = predict_readings(extended, conditions)
    sigma = np.sqrt(np.diag(extended.covariance))
    values, vectors = np.linalg.eigh(extended.covariance / np.outer(sigma, sigma))
    factor = sigma[:, None] * vectors * np.sqrt(np.maximum(values, 0.0))
    draws = np.random.default_rng(3).standard_normal((400, 38)) @ factor.T
    offset = extended.effects[0].values + draws[:, 36:]
    force = there.load[0, 2]
    compliance = extended.compliance + draws[:, :36].reshape(-1, 6, 6)
    wrench = np.zeros((400, 6))
    wrench[:, 2], wrench[:, 3], wrench[:, 4] = force, offset[:, 1] * force, -offset[:, 0] * force
    scatter = np.einsum("dij,dj->di", compliance, wrench).std(0)
    assert_close(found.sigma[0] / scatter, np.ones(6), atol=4 / np.sqrt(2 * 400))


@pytest.mark.parametrize(
    ("column", "value", "said"),
    [
        ("channel", "dw", "one of dx"),
        ("load_axis", "f", "one of fx"),
        ("load", None, "a number"),
        ("step", None, "step"),
    ],
)
def test_a_table_that_cannot_be_predicted_is_refused_by_row_and_column(
    tables: dict[str, Any], table: pa.Table, column: str, value: Any, said: str
) -> None:
    frame = table.to_pandas()
    if column == "step":
        frame = frame.drop(columns="step")
    else:
        frame[column] = frame[column].astype(object)
        frame.loc[3, column] = value
    with pytest.raises(CampaignFaults, match=said) as refused:
        predict(str(tables["model"]), pa.Table.from_pandas(frame, preserve_index=False), "loads.csv")
    if column != "step":
        assert "row 5" in str(refused.value)
        assert column in str(refused.value)


def test_the_model_is_toml_that_a_person_reads(tables: dict[str, Any]) -> None:
    document = tomllib.loads(str(tables["model"]))
    assert document["effects"][0]["parameters"]["offset_x"]["unit"] == "mm"
    assert np.shape(document["compliance"]["identified"]) == (6, 6)


@pytest.mark.parametrize("name", ["found", "missed", "hidden"])
def test_the_walk_through_one_run_shows_what_comes_out(tables: dict[str, Any], name: str) -> None:
    page = force_sensor_campaign.PAGE.read_text(encoding="utf-8")
    make = force_sensor_campaign.page_tables(force_sensor_campaign.frames_of(tables))[name]
    assert_shown(shown(page, name), make(), rel=0.1)


def test_the_walk_quotes_the_first_line_of_the_page(tables: dict[str, Any]) -> None:
    page = force_sensor_campaign.PAGE.read_text(encoding="utf-8")
    lines = force_sensor_campaign.first_lines(force_sensor_campaign.frames_of(tables)).splitlines()
    reported = shown(page, "first").splitlines()
    # Its gain is reported in um or in arcsec: the offset shows in both alike.
    assert_shown(reported[0].partition(";")[0], lines[0].partition(";")[0], rel=0.1)
    assert lines[2] in reported


def test_numbers_in_another_unit_are_given_no_cause_unless_a_person_says_so(tmp_path: Path) -> None:
    readings, signals = measured(np.random.default_rng(3))
    readings.loc[readings["channel"] == "dz", "reading"] *= 1e-3
    write_campaign(tmp_path / "c", readings, signals, campaign_toml())
    made, said = run_line(tmp_path / "c", "ingest", "qa", "diagnose")
    assert said["diagnose"].why_not
    assert any(row["check"] == "units" and row["subject"] == "run 3 dz" for row in made["qa"].to_pylist())
    assert not made["diagnosis"].num_rows
    rows = [{**row, "accepted": "M. Keller: known"} for row in made["qa"].to_pylist()]
    assert not reason_withheld({"qa": pa.Table.from_pylist(rows)})


def test_runs_that_were_not_set_to_zero_are_given_no_cause(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    readings, signals = measured(rng)
    off = rng.normal(0.0, 20.0, (int(readings["run"].max()) + 1, 6))
    readings["reading"] += off[readings["run"], [CHANNELS.index(name) for name in readings["channel"]]]
    write_campaign(tmp_path / "c", readings, signals, campaign_toml())
    made, _ = run_line(tmp_path / "c", "ingest", "qa", "diagnose")
    assert not [row for row in made["diagnosis"].to_pylist() if row["verdict"] == "found"]
