"""Data are calibrated as recorded unless campaign.toml applies a finding, and what it ignores is not searched."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from typer.testing import CliRunner

from tests.blind.generator.axis import record, write
from tests.blind.generator.effects import ActuatorGain as HiddenGain
from tests.report.explained import unexplained
from tests.sensor_campaign import SIGNAL_MV
from tests.sentences import assert_says
from tests.stages.axis_campaigns import HIDDEN, axis_layout
from tests.stages.diagnosis.test_signals_alone import exchange, signals
from tests.stages.line import run_line, settings_of
from tests.stages.two_campaigns import fitted, gathered, measured
from truing.pipeline.campaign_folder import open_campaign
from truing.pipeline.command_line import app
from truing.schemas.campaign import read_campaign
from truing.schemas.faults import CampaignFaults
from truing.simulation.mechanisms.causes.drive import ActuatorGain
from truing.simulation.mechanisms.causes.leg_drift import LegDrift
from truing.simulation.mechanisms.extended_model import read_model
from truing.simulation.mechanisms.structures.catalogue import structures
from truing.stages import calibrate, diagnose
from truing.stages.common.calibration_data import assemble
from truing.stages.diagnosis.applied import applied_model, choices_table
from truing.stages.uncertainty_statement.machine import _main

CAUSE = "rows-exchanged"


def _truing(*arguments: str) -> tuple[int, str]:
    done = CliRunner().invoke(app, list(arguments))
    return done.exit_code, done.output


def _bench(**diagnosis: Any):
    """Settings of a sensor of which only signals were read."""
    head = {"name": "c", "kind": "interferometer"}
    return read_campaign({"campaign": head, "noise": {"signal_mv": SIGNAL_MV}, "diagnosis": diagnosis})


def _chosen(artifacts) -> pd.DataFrame:
    rows = artifacts["sensor_matrix"].to_pandas()
    return rows[rows["chosen"] & (rows["matrix"] == "G_B")].reset_index(drop=True)


def _calibrated(tables, **diagnosis: Any):
    return calibrate.run(tables, _bench(**diagnosis), lambda *_: None).artifacts


@pytest.fixture(scope="module")
def tables():
    """Signals as they were, and with the loads of two rows in each other's place."""
    rng = np.random.default_rng(5)
    right = signals(rng)
    wrong = exchange(right.copy(), (3, 1), (5, 3), ["fz_n", "my_nm"])
    return [{"signals": pa.Table.from_pandas(table)} for table in (right, wrong)]


def _diagnosed(tables, **diagnosis: Any):
    return {**tables, **diagnose.run(tables, _bench(**diagnosis), lambda *_: None).artifacts}


def test_a_finding_corrects_data_only_where_it_is_applied(tables) -> None:
    right, wrong = tables
    found = _diagnosed(wrong)
    assert CAUSE in [row["cause"] for row in found["diagnosis"].to_pylist() if row["verdict"] == "found"]
    assert "diagnosis_choices" not in found
    by_default, undiagnosed = _calibrated(found), _calibrated(wrong)
    for name in ("sensor_choice", "sensor_merit", "error_classes"):
        assert by_default[name].equals(undiagnosed[name])
    pd.testing.assert_frame_equal(_chosen(by_default), _chosen(undiagnosed))
    asked = _diagnosed(wrong, apply=[CAUSE])
    assert asked["diagnosis_choices"].to_pylist() == [{"cause": CAUSE, "asked": "apply", "outcome": "applied"}]
    applied = _calibrated(asked, apply=[CAUSE])
    # the loads are back in their rows, all else is as it was: the calibration is that of the right table
    pd.testing.assert_frame_equal(_chosen(applied), _chosen(_calibrated(right)))
    compared = applied["calibrations_compared"].to_pandas().set_index(["data", "quantity"])
    for quantity in ("fz", "my"):
        recorded, held = (compared.loc[(data, quantity)] for data in ("as recorded", "with findings"))
        assert recorded["rms_error"] > 10.0 * held["rms_error"]
        assert held["rms_unchanged"] <= held["largest_error"]
    assert set(compared["count"].loc["with findings"]) == {len(right["signals"])}


def test_an_ignored_cause_has_no_row_and_no_effect(tables) -> None:
    found = _diagnosed(tables[1], ignore=[CAUSE])
    assert CAUSE not in found["diagnosis"].column("cause").to_pylist()
    assert found["diagnosis_choices"].to_pylist() == [{"cause": CAUSE, "asked": "ignore", "outcome": "ignored"}]
    assert "calibrations_compared" not in _calibrated(found, ignore=[CAUSE])


def test_a_cause_that_was_not_found_or_changes_no_load_is_reported_and_not_applied() -> None:
    settings = _bench(apply=["load-eccentricity", "creep"], ignore=[CAUSE])
    found = pa.table({"cause": ["creep", "hysteresis"], "verdict": ["found", "found"]})
    reported = choices_table(settings, found, lambda cause: cause.id != "creep")
    assert reported.column("outcome").to_pylist() == ["not found", "no effect", "ignored"]
    assert choices_table(_bench(), found) is None
    assert choices_table(settings, found.slice(0, 0)).column("outcome").to_pylist()[:2] == ["not found", "not found"]


@pytest.fixture(scope="module")
def machine(tmp_path_factory: pytest.TempPathFactory):
    """A campaign whose actuator 3 goes too far: its settings, its tables, and what the diagnosis compares."""
    folder = measured(tmp_path_factory.mktemp("applied"), 21, [HiddenGain(0.06 * (np.arange(6) == 2))])
    tables, _ = run_line(folder, "ingest", "pose", "deformation")
    return settings_of(folder), tables, gathered(folder)


def test_the_applied_model_holds_the_applied_causes_alone_and_their_own_fit(machine) -> None:
    settings, _, found = machine
    gain, drift = ActuatorGain((3,)), LegDrift((5,))
    plain, alone, final = fitted(found), fitted(found, gain), fitted(found, gain, drift)
    diagnosis: Any = SimpleNamespace(plain=plain, final=final)
    rows = pa.table({"cause": [gain.id, drift.id], "verdict": ["found", "found"]})

    def applied(*names: str) -> str | None:
        asked = settings.model_copy(update={"diagnosis": settings.diagnosis.model_copy(update={"apply": names})})
        return applied_model(diagnosis, found, asked, choices_table(asked, rows, found.is_calibrated))

    assert applied() is None
    assert applied(gain.id, drift.id) is None  # that is model.toml
    text = applied(gain.id)
    assert text is not None
    (effect,) = read_model(text).effects
    assert effect.cause.id == gain.id
    value, covariance = alone.values(gain)
    assert abs(effect.values[0] - value[0]) < 0.1 * np.sqrt(covariance[0, 0])


def test_the_main_results_of_a_machine_are_those_of_the_chosen_calibration_until_a_finding_is_applied(
    machine, monkeypatch: pytest.MonkeyPatch
) -> None:
    rigid_legs_alone = structures(assemble(machine[1], machine[0]).machine)[:1]
    monkeypatch.setattr("truing.stages.calibration.run.structures", lambda machine: rigid_legs_alone)
    settings, tables, found = machine
    text = found.model_text(fitted(found, ActuatorGain((3,))), settings)
    choices = pa.table({"cause": ["actuator-gain"], "asked": ["apply"], "outcome": ["applied"]})
    asked = {**tables, "model": text}
    plain, beside, main = (
        calibrate.run(given, settings, lambda *_: None).artifacts
        for given in (tables, asked, {**asked, "diagnosis_choices": choices})
    )
    for name in ("calibration", "model_choice", "accuracy"):
        own = [
            table[name].to_pandas().query("model != 'extended'").dropna(axis=1, how="all")
            for table in (plain, beside, main)
        ]
        for other in own[1:]:
            pd.testing.assert_frame_equal(own[0].reset_index(drop=True), other.reset_index(drop=True))
    assert [key[0] for key in _main(beside)] == ["6-pus"]
    assert [key[0] for key in _main(main)] == ["extended"]
    assert "calibrations_compared" not in plain
    for artifacts, data in ((beside, "as recorded"), (main, "with findings")):
        compared = artifacts["calibrations_compared"].to_pandas()
        assert compared.loc[compared["is_main"], "data"].unique().tolist() == [data]
        assert set(compared["tested_on"]) == {"verification poses"}
        held = compared.set_index(["data", "quantity"])
        accuracy = artifacts["accuracy"].to_pandas().query("model == 'extended' and role == 'verification'")
        expected = np.sqrt(np.mean(accuracy["position_error_um"] ** 2))
        assert np.isclose(held.loc[("with findings", "position"), "rms_error"], expected)


@pytest.mark.parametrize(
    ("lines", "said"),
    [
        ('apply = ["lost-motoin"]', "key diagnosis.apply.1: found 'lost-motoin'; expected a cause that this kind of "
         "campaign knows by name; did you mean lost-motion?"),
        ('ignore = ["scale-error", "creep"]', "key diagnosis.ignore.2: found 'creep'; expected"),
        ('ignore = ["unexplained"]', "key diagnosis.ignore.1: found 'unexplained'; expected a cause"),
        ('apply = ["lost-motion"]\nignore = ["lost-motion"]', "lost-motion in apply or in ignore, not in both"),
        ('apply = "lost-motion"', "expected a list, in brackets"),
    ],
)  # fmt: skip
def test_a_name_that_is_no_cause_is_a_fault_with_what_was_meant(tmp_path: Path, lines: str, said: str) -> None:
    folder = write(record(axis_layout(), HIDDEN, np.random.default_rng(5)), tmp_path / "c")
    file = folder / "campaign.toml"
    file.write_text(f"{file.read_text()}\n[diagnosis]\n{lines}\n")
    with pytest.raises(CampaignFaults, match="diagnosis"):
        open_campaign(folder).validated()
    for command in ("check", "run"):
        code, output = _truing(command, str(folder))
        assert code == 2
        assert said in " ".join(output.split())


def test_the_page_of_a_run_shows_what_was_asked_of_causes(tmp_path: Path) -> None:
    folder = write(record(axis_layout(), HIDDEN, np.random.default_rng(5)), tmp_path / "c")
    file = folder / "campaign.toml"
    asked = 'apply = ["scale-error", "zero-shift"]\nignore = ["lost-motion"]'
    file.write_text(f"{file.read_text()}\n[diagnosis]\n{asked}\n")
    code, _ = _truing("run", str(folder), "--out", str(tmp_path / "run"), "--qa", "warn")
    assert code == 0
    causes = pq.read_table(tmp_path / "run" / "diagnosis.parquet").column("cause").to_pylist()
    assert "zero-shift" in causes
    assert "lost-motion" not in causes
    page = (tmp_path / "run" / "report.html").read_text(encoding="utf-8")
    assert not unexplained(page)
    assert_says(page, "[diagnosis] apply", "1 cause", "did not find", "scale-error")
    assert_says(page, "[diagnosis] apply", "zero-shift", "found", "no calibration")
    assert_says(page, "Not searched", "[diagnosis] ignore", "lost-motion")
