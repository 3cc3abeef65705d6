"""Models fitted to one campaign predict a second one of the same machine, and their errors are reported."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
from scipy.stats import chi2
from typer.testing import CliRunner

from tests.blind.generator.axis import record, write
from tests.blind.generator.effects import ActuatorGain as HiddenGain
from tests.blind.generator.sensor.effects import LoadEccentricity as HiddenEccentricity
from tests.faults import assert_fault, faults_of
from tests.report.explained import unexplained
from tests.sentences import assert_says
from tests.stages.axis_campaigns import BACKLASH, HIDDEN, axis_layout
from tests.stages.benches import bench, layout
from tests.stages.line import run_line, settings_of
from tests.stages.two_campaigns import fitted, gathered, measured, model_text
from truing.estimation.sensor.contenders import contenders
from truing.pipeline.campaign_check import check_campaign
from truing.pipeline.campaign_folder import open_campaign
from truing.pipeline.command_line import app
from truing.schemas.faults import CampaignFaults
from truing.simulation.bench.causes.load_path import LoadEccentricity
from truing.simulation.bench.extended_model import ExtendedSensor, write_sensor
from truing.simulation.cause import Effect
from truing.simulation.mechanisms.causes.drive import ActuatorGain
from truing.simulation.mechanisms.causes.leg_drift import LegDrift
from truing.simulation.mechanisms.extended_model import persistent_part, read_model
from truing.simulation.mechanisms.structures.catalogue import structures
from truing.stages import calibrate
from truing.stages.common.calibration_data import assemble
from truing.stages.common.nominal_sensor import nominal_sensor
from truing.stages.common.recorded_signals import recorded
from truing.stages.second_campaign.compared import SecondCampaign
from truing.stages.second_campaign.errors import second_campaign_errors
from truing.stages.second_campaign.loads import _errors_by_matrix

UNLIKELY = 1e-4


def _truing(*arguments: str) -> tuple[int, str]:
    done = CliRunner().invoke(app, list(arguments))
    return done.exit_code, done.output


def _second(folder: Path, *stages: str) -> SecondCampaign:
    tables, _ = run_line(folder, *stages)
    return SecondCampaign(str(folder / "campaign.toml"), settings_of(folder), tables)


def _errors(*given) -> pd.DataFrame:
    return second_campaign_errors(*given)[0].to_pandas().set_index(["prediction_by", "quantity"])


@pytest.fixture(scope="module")
def series(tmp_path_factory: pytest.TempPathFactory):
    """The first series' folder, its tables, and its model with the gain of actuator 3; the second series."""
    home = tmp_path_factory.mktemp("series")
    hidden = [HiddenGain(0.06 * (np.arange(6) == 2))]
    first, second = (measured(home, seed, hidden) for seed in (21, 22))
    tables, _ = run_line(first, "ingest", "pose", "deformation")
    text = model_text(fitted(gathered(first), ActuatorGain((3,))), "first")
    return first, tables, text, _second(second, "ingest", "pose")


def test_the_right_model_predicts_a_second_series_to_its_noise_and_the_drawing_does_not(series) -> None:
    *_, text, second = series
    errors = _errors(text, second, {})
    assert set(errors.index.get_level_values("prediction_by")) == {"nominal", "extended"}
    for quantity in ("position", "orientation"):
        drawn, found = (errors.loc[(by, quantity)] for by in ("nominal", "extended"))
        # errors of one pose's components are correlated: a pose counts once at least
        low, high = np.sqrt(chi2.ppf([UNLIKELY, 1.0 - UNLIKELY], found["count"]) / found["count"])
        assert low < found["rms_error"] / found["noise_rms"] < high
        assert drawn["rms_error"] > 20.0 * drawn["noise_rms"]
        assert found["rms_error"] <= found["largest_error"]
    assert found["model"] == "with actuator-gain"


def test_a_calibration_read_back_from_its_tables_misses_as_it_did(series, monkeypatch: pytest.MonkeyPatch) -> None:
    first, tables, text, _ = series
    settings = settings_of(first)
    rigid_legs_alone = structures(assemble(tables, settings).machine)[:1]
    monkeypatch.setattr("truing.stages.calibration.run.structures", lambda machine: rigid_legs_alone)
    made = calibrate.run(tables, settings, lambda *_: None).artifacts
    errors = _errors(text, SecondCampaign("campaign.toml", settings, tables), made)
    accuracy = made["accuracy"].to_pandas()
    own = accuracy[accuracy["model"] + " " + accuracy["deformation"] == errors.loc[("calibrated", "position"), "model"]]
    for quantity, column in (("position", "position_error_um"), ("orientation", "orientation_error_arcsec")):
        found = errors.loc[("calibrated", quantity)]
        assert np.isclose(found["rms_error"], np.sqrt(np.mean(own[column] ** 2)), rtol=1e-6)
        assert np.isclose(found["largest_error"], own[column].max(), rtol=1e-6)


def test_only_persistent_causes_enter_the_next_campaign(series) -> None:
    first, *_ = series
    stand = fitted(gathered(first), ActuatorGain((3,)), LegDrift((5,)))
    whole = read_model(model_text(stand, "first"))
    left = persistent_part(whole)
    assert [cause.id for cause in left.model.causes] == ["actuator-gain"]
    for own in (whole, left):
        (gain,) = (effect for effect in own.effects if effect.cause.id == "actuator-gain")
        assert np.isclose(gain.values[0], stand.values(ActuatorGain((3,)))[0][0])
        assert np.isclose(own.covariance_of(gain.cause)[0, 0], whole.covariance_of(gain.cause)[0, 0])


def test_another_machine_is_refused_by_what_differs(series) -> None:
    *_, text, second = series
    legs = second.settings.mechanism.legs
    moved = legs[1].model_copy(update={"b_mm": (legs[1].b_mm[0] + 1.0, *legs[1].b_mm[1:])})
    section = second.settings.mechanism.model_copy(update={"legs": (legs[0], moved, *legs[2:])})
    other = replace(second, settings=second.settings.model_copy(update={"mechanism": section}))
    fault = assert_fault(faults_of(lambda: second_campaign_errors(text, other, {})), column="mechanism.legs.2.b_mm")
    assert_says(fault.expected, "leg 2", "1 mm", "same machine")


def test_a_sensor_predicts_readings_and_loads_of_its_next_series(tmp_path: Path) -> None:
    off = (0.012, -0.008)
    made = bench(tmp_path / "c", layout("all", signals=6), 4, [HiddenEccentricity(2, (*off, 0.0))], ("ingest", "pose"))
    settings = settings_of(made.folder)
    nominal = nominal_sensor(settings.mechanism, None).compliance
    found = ExtendedSensor(
        made.compliance,
        nominal,
        np.repeat([1e4, 5e3], 3),
        632.990577e-9,
        20.0,
        effects=(Effect(LoadEccentricity("fz"), np.array(off)),),
        covariance=1e-12 * np.eye(38),
        context={"campaign": "bench"},
    )
    text = write_sensor(found)
    tables = made.tables | {"model": text}
    tables |= calibrate.run(tables, settings, lambda *_: None).artifacts
    second = SecondCampaign("campaign.toml", settings, made.tables)
    errors = _errors(text, second, tables, settings)
    for channel in ("dx", "dy", "dz", "rx", "ry", "rz"):
        drawn, known = (errors.loc[(by, channel)] for by in ("nominal", "extended"))
        low, high = np.sqrt(chi2.ppf([UNLIKELY, 1.0 - UNLIKELY], known["count"]) / known["count"])
        zeros = np.sqrt(1.0 - len(made.frame("readings")["run"].unique()) / known["count"])
        assert low * zeros < known["rms_error"] / known["noise_rms"] < high, channel
        assert drawn["rms_error"] > 2.0 * known["rms_error"]
    compared = tables["calibrations_compared"].to_pandas().set_index(["data", "quantity"])
    for load in ("fx", "fz", "my"):
        assert errors.loc[("calibrated", load), "rms_error"] <= 1.05 * compared.loc[("as recorded", load), "rms_error"]
        assert errors.loc[("extended", load), "rms_error"] <= 1.05 * compared.loc[("with findings", load), "rms_error"]
    five = made.tables["signals"].drop_columns(["v6_mv"])
    fewer = replace(second, tables={**made.tables, "signals": five})
    faults = faults_of(lambda: second_campaign_errors(text, fewer, tables, settings))
    assert_fault(faults, column="files.signals", value="5 signals")
    rows, left_out = second_campaign_errors(text, second, made.tables, settings)
    assert left_out == "loads by signals: no G_B was calibrated in the first campaign"
    assert set(rows.column("quantity").to_pylist()) == {"dx", "dy", "dz", "rx", "ry", "rz"}
    softer = replace(found, nominal=1.01 * nominal)
    faults = faults_of(lambda: second_campaign_errors(write_sensor(softer), second, {}))
    assert_fault(faults, column="mechanism")


def test_a_calibration_needs_its_inputs_in_the_next_series(tmp_path: Path) -> None:
    made = bench(tmp_path / "c", layout("all", signals=6), 4, (), ("ingest",))
    found = recorded(made.tables, settings_of(made.folder))
    warm = replace(found, covariate=np.linspace(0.0, 1.0, len(found.signal))[:, None], covariate_names=("temperature",))
    cold = replace(found, covariate=np.empty((len(found.signal), 0)), covariate_names=())
    follows = [model.name for model in contenders(warm) if model.drift]
    with pytest.raises(ValueError, match="G_B follows temperature, which the second campaign does not hold"):
        list(_errors_by_matrix(warm, cold, follows[0], "calibrated"))
    plain = contenders(cold)[1].name
    errors = [[one.errors for one in _errors_by_matrix(own, cold, plain, "calibrated")] for own in (warm, cold)]
    assert np.allclose(errors[0], errors[1])


def _axis(folder: Path, seed: int, judge_on: str | None = None, **changes: object) -> Path:
    write(record(axis_layout(**changes), HIDDEN[:1], np.random.default_rng(seed)), folder)
    if judge_on is not None:
        file = folder / "campaign.toml"
        file.write_text(f'{file.read_text()}\n[diagnosis]\njudge_on = "{judge_on}"\n')
    return folder


def test_a_run_gives_the_errors_of_a_second_series_and_predict_gives_the_same(tmp_path: Path) -> None:
    first, _ = _axis(tmp_path / "first", 5, "../second"), _axis(tmp_path / "second", 6)
    assert _truing("run", str(first), "--out", str(tmp_path / "run"))[0] == 0
    table = pq.read_table(tmp_path / "run" / "second_campaign_errors.parquet")
    errors = table.to_pandas().set_index(["prediction_by", "quantity"])
    arcsec = BACKLASH * 3600.0
    for encoder in ("load", "measured"):
        drawn, found = (errors.loc[(by, encoder)] for by in ("nominal", "extended"))
        low, high = np.sqrt(chi2.ppf([UNLIKELY, 1.0 - UNLIKELY], found["count"]) / found["count"])
        assert 0.9 * low < found["rms_error"] / found["noise_rms"] < high
        assert 0.8 * arcsec / 2.0 < drawn["rms_error"] < 1.2 * arcsec
    page = (tmp_path / "run" / "report.html").read_text(encoding="utf-8")
    assert not unexplained(page)
    assert "A second campaign of the same machine" in page
    model = str(tmp_path / "run" / "model.toml")
    code, said = _truing("predict", model, str(tmp_path / "second"), "--out", str(tmp_path / "errors.parquet"))
    assert code == 0
    assert pq.read_table(tmp_path / "errors.parquet").to_pylist() == table.to_pylist()
    assert f"load         extended    {errors.loc[('extended', 'load'), 'rms_error']:.4g} arcsec rms" in said
    code, said = _truing("stages", str(first), "--out", str(tmp_path / "run"))
    assert [line.split()[1] for line in said.splitlines() if line.startswith("transfer")] == ["fresh"]
    raw = next(path for path in (tmp_path / "second").glob("*.csv"))
    raw.write_text(raw.read_text() + "\n")
    code, said = _truing("stages", str(first), "--out", str(tmp_path / "run"))
    (line,) = (line for line in said.splitlines() if line.startswith("transfer"))
    assert f"stale      raw file ../second/{raw.name} changed" in line


@pytest.mark.parametrize(
    ("named", "said"),
    [
        ("nowhere", "found 'nowhere'; expected the folder of a second campaign, relative to campaign.toml"),
        (".", "expected another campaign than this one"),
        ("../bodies", "mechanism.type = 'none', this one 'axis'"),
        ("../empty", "a campaign.toml in this folder"),
    ],
)
def test_an_invalid_second_campaign_is_a_fault_before_the_run(tmp_path: Path, named: str, said: str) -> None:
    for name in ("bodies", "empty"):
        (tmp_path / name).mkdir()
    (tmp_path / "bodies" / "campaign.toml").write_text('[campaign]\nname = "b"\nkind = "photogrammetry"\n')
    first = _axis(tmp_path / "first", 5, named)
    with pytest.raises(CampaignFaults) as caught:
        check_campaign(open_campaign(first))
    assert said in str(caught.value)
    for command in (("run", str(first), "--out", str(tmp_path / "run")), ("check", str(first))):
        code, reported = _truing(*command)
        assert code == 2
        assert said in " ".join(reported.split())
    assert not (tmp_path / "run" / "poses.parquet").exists()


def test_an_axis_of_another_loop_is_refused(tmp_path: Path) -> None:
    first, _ = _axis(tmp_path / "first", 5, "../second"), _axis(tmp_path / "second", 6, loop="load")
    code, said = _truing("run", str(first), "--out", str(tmp_path / "run"))
    assert code == 2
    assert "key mechanism.loop: found 'load'; expected motor: models predict a second campaign of the same" in " ".join(
        said.split()
    )
