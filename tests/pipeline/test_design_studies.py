"""Studies of a machine by `truing design`: words, tables, page, and refusals."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.csv
import pytest

from tests.pipeline.test_design import SAMPLE, call, campaign, hexapod, sensor
from tests.report.explained import unexplained
from tests.sentences import assert_says
from tests.simulation.mechanisms.telescope import telescope
from truing.simulation.mechanisms.legs.kinematics import forward


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Studies use a run of the campaign that lies in the current folder: none does here."""
    monkeypatch.chdir(tmp_path)


def mechanism(**keys: Any) -> dict[str, Any]:
    return tomllib.loads((SAMPLE / "campaign.toml").read_text(encoding="utf-8"))["mechanism"] | keys


def test_the_accuracy_of_the_telescope_is_the_report_s(tmp_path: Path) -> None:
    place = campaign(tmp_path / "machine", mechanism=mechanism(actuator_accuracy_mm=0.001))
    done = call(place, "--accuracy", "--out", tmp_path / "found.csv")
    assert done.exit_code == 0, done.output
    assert_says(done.output, "±1 µm (mechanism.actuator_accuracy_mm)", "5.96 µm", "6.87 arcsec")
    assert_says(done.output, "Requirement along z", "10 %")
    worst = pyarrow.csv.read_csv(tmp_path / "found.csv").to_pandas().set_index("quantity")
    # the report's section 2.3: 6 um; about z 1.9e-3 degrees
    assert 5.9 < worst.loc["position", "worst"] < 6.0
    assert 6.8 < worst.loc["rz", "worst"] < 6.9
    assert worst.loc["x", "requirement"] == pytest.approx(100.0)
    assert (worst["worst"] >= worst["at_reference"]).all()
    legs = pyarrow.csv.read_csv(tmp_path / "found-legs.csv").to_pandas()
    np.testing.assert_allclose(legs.groupby("quantity")["share"].sum(), 1.0, rtol=1e-9)
    page = (tmp_path / "found.html").read_text(encoding="utf-8")
    assert all(words in page for words in ("Share of each leg", "Over the workspace", "5.96 µm"))
    assert not unexplained(page)


def test_the_map_holds_poses_within_the_limits_that_its_readings_reach(tmp_path: Path) -> None:
    place = campaign(tmp_path / "machine", mechanism=mechanism(actuator_accuracy_mm=[0.001] * 5 + [0.002]))
    assert call(place, "--accuracy", "--out", tmp_path / "found.csv").exit_code == 0
    found = pyarrow.csv.read_csv(tmp_path / "found-map.csv").to_pandas()
    limits = {"x_mm": 1.0, "y_mm": 1.0, "z_mm": 0.1, "rx_deg": 0.5, "ry_deg": 0.5}
    for name, limit in limits.items():
        assert found[name].abs().max() == pytest.approx(limit, abs=2e-6)
    rho = found[[f"rho{leg}_mm" for leg in range(1, 7)]].to_numpy()
    assert np.abs(rho - 10.0).max() <= 1.3 + 2e-6
    reached = forward(telescope(), 1e-3 * rho)
    home = forward(telescope(), telescope().rho0[None])
    np.testing.assert_allclose(1e3 * (reached.p - home.p)[:, 0], found["x_mm"], atol=1e-4)
    worst = pyarrow.csv.read_csv(tmp_path / "found.csv").to_pandas().set_index("quantity")
    assert worst.loc["position", "worst"] == pytest.approx(found["position_error_um"].max())


def test_without_a_stated_accuracy_the_noise_of_the_readings_counts(tmp_path: Path) -> None:
    place = campaign(tmp_path / "machine")
    done = call(place, "--accuracy", "--out", tmp_path / "found.csv")
    assert_says(done.output, "±1.73 µm", "√3 times noise.actuator_mm", "mechanism.actuator_accuracy_mm is absent")


def test_seven_legs_have_an_accuracy_too(tmp_path: Path) -> None:
    machine = {"type": "ups", "legs": hexapod(7), "actuator_accuracy_mm": 0.01}
    place = campaign(tmp_path / "ups", mechanism=machine, workspace={"rho_mm": 15.0, "rz_deg": 3.0}, requirement=None)
    done = call(place, "--accuracy", "--out", tmp_path / "found.parquet")
    assert done.exit_code == 0, done.output
    assert "Requirement" not in done.output


REFUSED: list[tuple[dict[str, Any], list[object], str]] = [
    ({"noise": {"point_mm": 0.005}}, ["--accuracy"], "key mechanism.actuator_accuracy_mm: expected the largest"),
    ({"mechanism": mechanism(actuator_accuracy_mm=[0.001] * 5)}, ["--accuracy"], "or 6, one per leg, not 5"),
    ({"mechanism": mechanism(actuator_accuracy_mm=-1.0)}, ["--accuracy"], "one number above 0, or a list of such"),
    ({"workspace": None}, ["--accuracy"], "key workspace: expected pose and reading limits"),
    ({"mechanism": None}, ["--accuracy"], "key mechanism.type: found 'none'; expected a mechanism"),
    ({}, ["--accuracy", "--extend", "kept.csv"], "--extend: found 'kept.csv'; expected no such option"),
    ({}, ["--uniqueness", "--avoid", "some.csv"], "--avoid: found 'some.csv'; expected no such option with --uniq"),
    ({}, ["--uniqueness", "--parameters", "a_x,l"], "--parameters: found 'a_x,l'; expected no such option with"),
    ({"workspace": {"x_mm": 1.0}}, ["--uniqueness"], "key workspace: expected pose and reading limits"),
    ({"mechanism": {"type": "ups", "legs": hexapod(4)}}, ["--uniqueness"], "key mechanism.legs: found '4'"),
    ({}, ["--accuracy", "--out", "found.xls"], "--out: found 'found.xls'; expected a file that ends in .csv"),
]


@pytest.mark.parametrize(
    ("sections", "options", "words"), REFUSED, ids=[f"{k} {words[:40]}" for k, (*_, words) in enumerate(REFUSED)]
)
def test_machines_that_cannot_be_studied_are_a_fault(
    sections: dict[str, Any], options: list[object], words: str, tmp_path: Path
) -> None:
    done = call(campaign(tmp_path / "given", **sections), *options)
    assert done.exit_code == 2, done.output
    assert words in done.output
    assert "Traceback" not in done.output


def test_a_sensor_has_no_actuators(tmp_path: Path) -> None:
    done = call(sensor(tmp_path / "bench"), "--accuracy")
    assert done.exit_code == 2, done.output
    assert "key mechanism.type: found '6-upur'" in done.output


def test_the_tolerances_of_a_sensor_have_bands_and_shares(tmp_path: Path) -> None:
    done = call(sensor(tmp_path / "bench"), "--tolerances", "--out", tmp_path / "found.csv")
    assert done.exit_code == 0, done.output
    assert_says(done.output, "sensor installation", "68 %")
    assert_says(done.output, "rms attitude error 13.1 arcsec", "95 % of sensors")
    errors = pyarrow.csv.read_csv(tmp_path / "found.csv").to_pandas()
    each = errors[errors["error_source"] != "all"]
    np.testing.assert_allclose(each.groupby("pose_part")["variance_share"].sum(), 1.0)
    assert ((errors["low"] < errors["sample_rms"]) & (errors["sample_rms"] < errors["high"])).all()
    samples = pyarrow.csv.read_csv(tmp_path / "found-samples.csv").to_pandas()
    rms = np.sqrt((samples["platform_shift_um"] ** 2).groupby(samples["error_source"]).mean())
    own = errors[errors["pose_part"] == "position"].set_index("error_source")["sample_rms"]
    np.testing.assert_allclose(rms.loc[own.index], own, rtol=1e-9)
    page = (tmp_path / "found.html").read_text(encoding="utf-8")
    assert all(words in page for words in ("Tolerances as designed", "rms to first order", "68 %"))
    assert not unexplained(page)


def test_tolerances_that_are_none_are_a_fault(tmp_path: Path) -> None:
    machine = tomllib.loads((SAMPLE.parent / "force-sensor" / "campaign.toml").read_text(encoding="utf-8"))["mechanism"]
    place = sensor(tmp_path / "bench", mechanism=machine | {"tolerance": {"stiffness": 0.02}})
    done = call(place, "--tolerances")
    assert done.exit_code == 2, done.output
    assert "key mechanism.tolerance: expected at least one of platform_radius_um" in done.output
    done = call(campaign(tmp_path / "telescope"), "--tolerances")
    assert "key mechanism.type: found '6-pus'; expected 6-upur" in done.output
    done = call(campaign(tmp_path / "both"), "--tolerances", "--accuracy")
    assert done.exit_code == 2
    assert "one study at a time" in done.output


def test_the_telescope_s_readings_determine_its_pose(tmp_path: Path) -> None:
    done = call(campaign(tmp_path / "machine"), "--uniqueness", "--out", tmp_path / "found.csv")
    assert done.exit_code == 0, done.output
    assert_says(done.output, "Proven, rigid legs (6-pus)", "never have the same readings")
    assert_says(done.output, "Proven, flexures by beam theory", "one reading closes each leg")
    statements = pyarrow.csv.read_csv(tmp_path / "found.csv").to_pandas()
    assert set(statements["state"]) == {"proven"}
    assert len(statements) == 2 * (2 + 6)
    limits = pyarrow.csv.read_csv(tmp_path / "found-range.csv").to_pandas().set_index("coordinate")
    assert limits.loc["rx_deg", "half_range"] == pytest.approx(0.5)
    assert limits.loc["rz_deg", "given_by"] == "corners"
    # the report: flexures do not bend by more than 1 degree
    path = pyarrow.csv.read_csv(tmp_path / "found-flexures.csv").to_pandas()
    assert 0.8 < path["largest_bend_deg"].iloc[0] < 1.0
    page = (tmp_path / "found.html").read_text(encoding="utf-8")
    assert all(words in page for words in ("Flexures and ideal pivots", "ideal pivot in the middle", "proven"))
    assert not unexplained(page)


def test_undecided_requirements_are_reported_and_listed(tmp_path: Path) -> None:
    limits = {"x_mm": 1.0, "y_mm": 1.0, "z_mm": 780.0, "rx_deg": 1.0, "ry_deg": 1.0, "rz_deg": 1.0}
    machine = {"type": "ups", "legs": hexapod(6)}
    done = call(
        campaign(tmp_path / "wide", mechanism=machine, workspace=limits), "--uniqueness", "--out", tmp_path / "f.csv"
    )
    assert done.exit_code == 0, done.output
    assert_says(done.output, "Not decided, rigid legs (ups)", "parts of the range left")
    assert "flexures" not in done.output
    assert not (tmp_path / "f-flexures.csv").exists()
    assert len(pyarrow.csv.read_csv(tmp_path / "f-undecided.csv")) > 0


def test_the_least_number_of_configurations_is_reported_for_each_model(tmp_path: Path) -> None:
    done = call(
        campaign(tmp_path / "machine"), "--within", "actuators", "--method", "random", "--out", tmp_path / "f.csv"
    )
    assert_says(done.output, "least number of configurations", "6-pus 7 (42 parameters", "jacobian 6 (36 parameters")
    assert_says(done.output, "beam 8 (48 parameters", "stiffness 7", "shared by the legs")
